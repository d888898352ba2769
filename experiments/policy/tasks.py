"""Tasks that a policy can be trained for, how it is trained, and the policies that are shipped."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.abc import Traversable
from importlib.resources import as_file, files
from types import MappingProxyType
from typing import Any

import numpy as np

from surefoot.calibration.checks import check_counts
from surefoot.controllers.policy import PolicyNetwork

SENSORS = ("true", "randomised")
"""Feet of the policies that come with the package: the true centre of pressure, or drifting sensors of every
severity."""


@dataclass(frozen=True)
class Task:
    """A task, a policy's view of it, and its training."""

    name: str  # for files and the command
    env_id: str
    title: str  # of a policy for it
    scales: Mapping[str, float]  # of parts of the state that are seen besides the legs' joints: divisors
    training: Mapping[str, Any]  # options while training: a short stand, fewer pushes
    most: float  # largest reward of one step
    limits: str  # what a policy for it cannot do
    speed: float = 1.5  # change of a posture per second at a full command
    memory: float = 1.0  # time constant in s with which a posture returns
    hold: int = 4  # steps for which an action holds: 20 Hz, about as fast as a body can follow
    easier: str = ""  # whose policies are let in too, and serve where none is shipped for this one
    imitates: bool = False  # whether a policy is linear, acts directly, and imitates the environment's expert


_SEEN = {"tilt": 0.1, "gyroscope": 0.5, "cop_reference": 0.03, "com_reference_velocity": 0.05}

_BALANCE = Task(
    "balance",
    "surefoot/NaoBalance-v0",
    "A balance policy",
    MappingProxyType(_SEEN),
    MappingProxyType({"stand_time": 0.25, "duration": 8.0, "payload_time": (0.1, 1.5), "push_interval": 8.0}),
    most=3.0,
    limits="standing on both feet on flat ground, the loads and pushes of its task, and nothing\n"
    "  else. It does not step, and a push that needs a step is a fall.",
)

_WALK = Task(
    "walk",
    "surefoot/NaoCarry-v0",
    "A walking policy",
    MappingProxyType({**_SEEN, "com_reference": 0.03, "stance": 1.0, "phase": 1.0}),
    MappingProxyType(
        {"stand_time": 0.5, "duration": 10.0, "payload_time": (0.5, 4.0), "push_interval": 10.0}
    ),
    most=6.0,
    speed=0.5,
    memory=2.0,
    limits="walking ahead on flat ground, the loads and pushes of its task, and nothing\n"
    "  else. Its feet go where the pattern puts them: a push that needs another step is a fall.",
)

_BALANCE_HARD = replace(
    _BALANCE,
    name="balance-hard",
    env_id="surefoot/NaoBalanceHard-v0",
    training=MappingProxyType({**_BALANCE.training, "payload_time": (0.1, 4.0)}),
    easier="balance",
)

_WALK_HARD = replace(_WALK, name="walk-hard", env_id="surefoot/NaoCarryHard-v0", easier="walk")

_LEAN = Task(
    "lean",
    "surefoot/G1Lean-v0",
    "A leaning policy",
    MappingProxyType({"offset": 0.03, "offset_speed": 0.1, "com_error": 0.01, "tilt": 0.01}),
    MappingProxyType({"marches": 0, "reaches": 2, "wait": 2.0}),
    most=1.0 / 550.0,  # the steps of two reaches
    limits="standing on both feet on flat ground, loads of the task, and nothing else. It does\n  not step.",
    hold=5,
    imitates=True,
)

TASKS: Mapping[str, Task] = MappingProxyType(
    {task.name: task for task in (_BALANCE, _WALK, _BALANCE_HARD, _WALK_HARD, _LEAN)}
)
"""All tasks by name; the first is the default."""


def find_task(name: str) -> Task:
    """Return the task of a name, or raise ValueError with their names."""
    if name not in TASKS:
        raise ValueError(f"There is no task '{name}'. Available: {', '.join(map(repr, TASKS))}.")
    return TASKS[name]


def task_in(env_id: Any) -> Task | None:
    """Return the task of an environment, by its id; ``None`` if there is none in it."""
    return next((task for task in TASKS.values() if task.env_id == env_id), None)


def policy_file(task: str, sensors: str, seed: int = 0) -> Traversable:
    """Return the file of a policy that comes with the package: for the task, or for the easier one.

    ``"lean"`` has those of the training seeds 0 to 4.
    """
    folder = files("surefoot.experiments.policy").joinpath("files")
    own = folder.joinpath(f"{task}-{sensors}" + (f"-{seed}" if seed else ""), "policy.npz")
    easier = find_task(task).easier
    return own if own.is_file() or not easier else policy_file(easier, sensors)


def shipped_policy(sensors: str = "true", task: str = "balance") -> PolicyNetwork:
    """Return the policy that comes with the package for a task, trained on one of :data:`SENSORS`.

    ValueError if there is no such policy.
    """
    if sensors not in SENSORS:
        available = ", ".join(map(repr, SENSORS))
        raise ValueError(
            f"There is no shipped policy '{sensors}' for the task '{task}'. Available: {available}."
        )
    with as_file(policy_file(find_task(task).name, sensors)) as path:
        return PolicyNetwork.load(path)


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
        """Raise ValueError at a task that cannot be trained."""
        find_task(self.task)
        if self.sensors not in SENSORS:
            raise ValueError(f"'sensors' must be one of {SENSORS}, got {self.sensors!r}.")
        check_counts(
            self, "steps", "environments", "rollout", "every", "epochs", "batch", "hidden", "explore"
        )
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
        """Return the seed of the training after a checkpoint at some updates."""
        return TRAINING_SEEDS + self.seed * 1_000_000 + update * self.environments
