"""What a training of a policy is made of."""

from dataclasses import dataclass

import numpy as np

from surefoot.calibration.checks import check_count
from surefoot.experiments.policy.tasks import SENSORS, task_named

__all__ = ["TRAINING_SEEDS", "TrainOptions"]

TRAINING_SEEDS = 1_000_000_000
"""Training draws seeds from here on; evaluation takes those below."""

LARGEST_SEVERITY = 2.0
"""Severity of the worst sensors of a randomised training."""

REWARD_SCALE = 0.05
"""What rewards are multiplied by, so that returns are of the order of ten."""


@dataclass(frozen=True)
class TrainOptions:
    """A training; the same options give the same policy, also if it was stopped and resumed on its way.

    Attributes:
        task: One of :data:`surefoot.experiments.policy.tasks.TASKS`.
        sensors: One of :data:`surefoot.experiments.policy.tasks.SENSORS`.
        steps: Decisions of the policy, of four steps each, in all environments together.
        seed: Of everything random, 0 to 999.
        environments: Environments that are stepped in turn.
        rollout: Decisions in each environment between two updates.
        every: Updates from one checkpoint to the next.
        learning_rate: Of Adam at the start; it falls linearly to a twentieth.
        discount: Per decision, every 1/20 s: rewards 1.6 s ahead count about a third.
        epochs: Passes over a rollout in one update.
        batch: Samples of one gradient step.
        hidden: Width of both hidden layers.
        initial_log_std: Logarithm of the standard deviation of the exploration's weights at the start.
        explore: Decisions after which the exploration is drawn again (gSDE; Raffin, Kober and Stulp, 2022).
            Between them it is a function of what is seen: the robot sways slowly and does not shake, for
            feet that shake measure nothing.

    Raises:
        ValueError: If an option is out of its range, naming it.
    """

    task: str = "balance"
    sensors: str = "true"
    steps: int = 160_000
    seed: int = 0
    environments: int = 8
    rollout: int = 256
    every: int = 8
    learning_rate: float = 1e-3
    discount: float = 0.97
    epochs: int = 8
    batch: int = 512
    hidden: int = 64
    initial_log_std: float = -2.5
    explore: int = 8

    def __post_init__(self) -> None:
        """Raise ValueError at what cannot be trained."""
        task_named(self.task)
        if self.sensors not in SENSORS:
            raise ValueError(f"'sensors' must be one of {SENSORS}, got {self.sensors!r}.")
        check_count(self, "steps", "environments", "rollout", "every", "epochs", "batch", "hidden", "explore")
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
        """Return the severity of each environment's sensors, evenly from none to the worst."""
        if self.sensors == "true":
            return [1.0] * self.environments
        return [float(severity) for severity in np.linspace(0.0, LARGEST_SEVERITY, self.environments)]

    def segment_seed(self, update: int) -> int:
        """Return the seed of what follows the checkpoint after some updates."""
        return TRAINING_SEEDS + self.seed * 1_000_000 + update * self.environments
