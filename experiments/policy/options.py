"""What a training of a policy is made of."""

from dataclasses import dataclass

import numpy as np

from surefoot.calibration.checks import check_count
from surefoot.experiments.policy.tasks import SENSORS, task_named

TRAINING_SEEDS = 1_000_000_000  # training draws seeds from here on; evaluation takes those below
LARGEST_SEVERITY = 2.0  # severity of the worst sensors of a randomised training
REWARD_SCALE = 0.05  # what rewards are multiplied by, so that returns are of the order of ten


@dataclass(frozen=True)
class TrainOptions:
    """A training; the same options give the same policy, also if it was stopped and resumed on its way.

    Raises ValueError with the option that is out of range. Exploration is gSDE (Raffin et al., 2022).
    """

    task: str = "balance"
    sensors: str = "true"
    steps: int = 160_000  # decisions of the policy in all environments together
    seed: int = 0  # of everything random, 0 to 999
    environments: int = 8  # that are stepped in turn
    rollout: int = 256  # decisions in each environment between two updates
    every: int = 8  # updates from one checkpoint to the next
    learning_rate: float = 1e-3  # of Adam at the start; it falls linearly to a twentieth
    discount: float = 0.97  # per decision, every 1/20 s: rewards 1.6 s ahead count about a third
    epochs: int = 8  # passes over a rollout in one update
    batch: int = 512  # samples of one gradient step
    hidden: int = 64  # width of both hidden layers
    initial_log_std: float = -2.5  # of the exploration's weights at the start
    explore: int = 8  # decisions until it is drawn again (gSDE): feet that shake measure nothing

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
