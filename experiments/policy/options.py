"""What a training of a policy is made of."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from surefoot.experiments.policy.tasks import task_named

__all__ = ["SENSORS", "TRAINING_SEEDS", "TrainOptions"]

SENSORS = ("true", "randomised")
"""What a policy may be trained on: the true centre of pressure, or drifting sensors of every severity."""

TRAINING_SEEDS = 1_000_000_000
"""Training draws seeds from here on; evaluation takes those below."""

LARGEST_SEVERITY = 2.0
"""Severity of the worst sensors of a randomised training."""

REWARD_SCALE = 0.05
"""What rewards are multiplied by, so that returns are of the order of ten."""


@dataclass(frozen=True)
class TrainOptions:
    """A training; the same options give the same policy, also if it was stopped and resumed on its way.

    Raises:
        ValueError: If an option is out of its range, naming it.
    """

    task: str = "balance"
    """One of :data:`surefoot.experiments.policy.tasks.TASKS`."""

    sensors: str = "true"
    """One of :data:`SENSORS`."""

    steps: int = 160_000
    """Decisions of the policy, of four steps each, in all environments together."""

    seed: int = 0
    """Of everything random."""

    environments: int = 8
    """Environments that are stepped in turn."""

    rollout: int = 256
    """Decisions in each environment between two updates."""

    every: int = 8
    """Updates from one checkpoint to the next."""

    learning_rate: float = 1e-3
    """Of Adam at the start; it falls linearly to a twentieth."""

    discount: float = 0.97
    """Per decision, every 1/20 s: rewards 1.6 s ahead count about a third."""

    epochs: int = 8
    """Passes over a rollout in one update."""

    batch: int = 512
    """Samples of one gradient step."""

    hidden: int = 64
    """Width of both hidden layers."""

    initial_log_std: float = -2.5
    """Logarithm of the standard deviation of the exploration's weights at the start."""

    explore: int = 8
    """Decisions after which the exploration is drawn anew (gSDE; Raffin, Kober and Stulp, 2022): between them
    it is a function of what is seen, a sway and not a shiver, for shivering feet tell nothing."""

    def __post_init__(self) -> None:
        """Refuse what cannot be trained."""
        task_named(self.task)
        if self.sensors not in SENSORS:
            raise ValueError(f"'sensors' must be one of {SENSORS}, got {self.sensors!r}.")
        for name in ("steps", "environments", "rollout", "every", "epochs", "batch", "hidden", "explore"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, got {getattr(self, name)}.")
        if not 0 <= self.seed < 1000:
            raise ValueError(f"'seed' must lie in 0 to 999, got {self.seed}.")
        if self.rollout * self.environments < 2:
            raise ValueError("An update needs two steps; raise 'rollout' or 'environments'.")

    @property
    def steps_per_update(self) -> int:
        """Decisions of all environments between two updates."""
        return self.rollout * self.environments

    @property
    def updates(self) -> int:
        """Number of updates, rounded up."""
        return -(-self.steps // self.steps_per_update)

    def severities(self) -> list[float]:
        """Severity of each environment's sensors, evenly from none to the worst."""
        if self.sensors == "true":
            return [1.0] * self.environments
        spread = np.linspace(0.0, LARGEST_SEVERITY, self.environments)
        return [float(severity) for severity in spread]

    def segment_seed(self, update: int) -> int:
        """Seed of what follows the checkpoint after some updates."""
        return TRAINING_SEEDS + self.seed * 1_000_000 + update * self.environments

    def to_json(self) -> dict[str, Any]:
        """Hand them out as plain numbers and names."""
        return asdict(self)
