"""A task as a policy sees it: which feet it stands on, and which numbers go in and out.

What is fed back as the centre of pressure is named by a *feed*. Encoders and IMU are the robot's own in all
of them, so that feeds differ by nothing but the feet.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.calibration._setup import method_name
from surefoot.controllers.posture import PostureDrive, posture_matrix
from surefoot.envs.robots.nao import motor_of_joint
from surefoot.experiments.policy.tasks import Task, task_named
from surefoot.experiments.walks.walkers import TruthTap
from surefoot.wrappers.foot_sensors import FootSensors
from surefoot.wrappers.self_calibration import SelfCalibration

__all__ = [
    "EXPECTED_LOADS",
    "FEEDS",
    "PARTS",
    "PolicyView",
    "TrueCop",
    "input_matrix",
    "input_names",
    "make_feed",
]

EXPECTED_LOADS: Mapping[str, float] = MappingProxyType({"mass_change": 0.08, "com_change": 0.015})
"""Options that tell a calibration what loads the robot is to expect, never which one it gets."""

FEEDS: Mapping[str, Mapping[str, Any] | None] = MappingProxyType(
    {
        "true": None,
        "none": {"method": "none"},
        "bench": {"method": "none", "initial": "calibrated"},
        "quasi-static": {"method": "quasi-static"},
        "window": {"method": "window"},
        "moment": {"method": "moment", **EXPECTED_LOADS},
    }
)
"""What a policy may be given for the centre of pressure, and the options of :class:`SelfCalibration`."""

PARTS = ("state", "cop", "cop_valid")
"""Parts of an observation that a policy looks at, in this order."""

_LEGS = 12
"""Hinge joints of both legs, which come first."""

_JOINT_SCALE, _COP_SCALE, _ERROR_SCALE = 0.1, 0.03, 0.01


class TrueCop(gym.Wrapper[Any, Any, Any, Any]):
    """Show the true centre of pressure beside what sensors say of joints and tilt: for training and bounds.

    Args:
        env: FootSensors around a tap.
        tap: Sees the truth beneath its sensors.
    """

    def __init__(self, env: gym.Env[Any, Any], tap: TruthTap) -> None:
        super().__init__(env)
        self._tap = tap
        shown, truth = env.observation_space, tap.observation_space
        assert isinstance(shown, spaces.Dict)
        assert isinstance(truth, spaces.Dict)
        self._keys = ("foot_force", "cop_foot", "cop", "cop_valid")
        self.observation_space = spaces.Dict(dict(shown.spaces) | {key: truth[key] for key in self._keys})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset, and show the truth."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._with_truth(observation), info

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Step, and show the truth."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._with_truth(observation), float(reward), terminated, truncated, info

    def _with_truth(self, observation: dict[str, Any]) -> dict[str, Any]:
        return observation | {key: self._tap.seen[key] for key in self._keys}


def make_feed(
    feed: str, *, severity: float = 1.0, task: str = "balance", **env_options: Any
) -> tuple[gym.Env[Any, Any], TruthTap]:
    """Put the robot on feet of a kind.

    Args:
        feed: One of :data:`FEEDS`.
        severity: Factor of all errors of the feet's sensors.
        task: One of :data:`surefoot.experiments.policy.tasks.TASKS`.
        **env_options: Of the task's environment.

    Returns:
        The environment to step, and the tap that sees the truth beneath its sensors.

    Raises:
        ValueError: If there is no such feed or task, or an option is refused.
    """
    feed = method_name(feed)
    if feed not in FEEDS:
        raise ValueError(f"There is no feed '{feed}'. Available: {', '.join(map(repr, FEEDS))}.")
    tap = TruthTap(gym.make(task_named(task).env_id, disable_env_checker=True, **env_options))
    sensors = FootSensors(tap, "hx711-load-cells", severity=severity, fresh=True)
    options = FEEDS[feed]
    return (TrueCop(sensors, tap) if options is None else SelfCalibration(sensors, **options)), tap


def input_matrix(
    state_layout: Mapping[str, slice], standing: NDArray[np.float64], task: Task
) -> NDArray[np.float64]:
    """Say which numbers of an observation a policy looks at, and in which units.

    Legs' joints, the parts of the state that the task names, the felt centre of pressure, its difference to
    the commanded one, and whether it is felt. Not the joints' velocities, which encoders tell badly, nor arms
    and head.

    Args:
        state_layout: Where the parts of the state lie.
        standing: Hinge joints of the standing posture in rad, shape (J,).
        task: Says which parts of the state are looked at.

    Returns:
        Inputs = matrix @ (state, cop, cop_valid, 1), shape (N, S + 6).
    """
    size = max(where.stop for where in state_layout.values())
    cop, valid, one = size, size + 2, size + 5
    rows: list[NDArray[np.float64]] = []

    def row(*entries: tuple[int, float]) -> None:
        line = np.zeros(size + 6)
        for column, factor in entries:
            line[column] = factor
        rows.append(line)

    joints = state_layout["joint_position"].start
    for joint in range(_LEGS):
        row((joints + joint, 1.0 / _JOINT_SCALE), (one, -standing[joint] / _JOINT_SCALE))
    for name, scale in task.scales.items():
        for column in range(state_layout[name].start, state_layout[name].stop):
            row((column, 1.0 / scale))
    reference = state_layout["cop_reference"].start
    for axis in (0, 1):
        row((cop + axis, 1.0 / _COP_SCALE))
        row((cop + axis, 1.0 / _ERROR_SCALE), (reference + axis, -1.0 / _ERROR_SCALE))
    for flag in range(3):
        row((valid + flag, 1.0), (one, -1.0))
    return np.array(rows)


def input_names(task: Task) -> list[str]:
    """Name a task's inputs in words, in their order."""
    return [
        f"joint_position of the {_LEGS} leg joints",
        *task.scales,
        "cop, and cop less cop_reference",
        "cop_valid",
    ]


def _flat(observation: Mapping[str, Any]) -> NDArray[np.float64]:
    """Put the parts that a policy looks at, and a one, into one vector."""
    return np.concatenate([np.ravel(observation[part]).astype(np.float64) for part in PARTS] + [[1.0]])


class PolicyView(gym.Wrapper[Any, Any, Any, Any]):
    """Show a policy its inputs as one vector, and let it command speeds of postures.

    The observation becomes ``Box(-inf, inf, (N,))`` of scaled numbers (see :func:`input_matrix`), the action
    ``Box(-1, 1, (4,))``, the speeds of :data:`surefoot.controllers.posture.POSTURES`.

    Args:
        env: A feed of :func:`make_feed`.
        task: The task that the feed is of.
        reward_scale: What rewards are multiplied by.
        hold: Steps of the environment for which an action holds, in place of the task's; their rewards are
            added up.

    Attributes:
        task: As given.
        inputs: Matrix that makes inputs of an observation, shape (N, S + 6).
        drive: Turns actions into residuals.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        task: str = "balance",
        *,
        reward_scale: float = 1.0,
        hold: int | None = None,
    ) -> None:
        super().__init__(env)
        self.task = task_named(task)
        self.hold = self.task.hold if hold is None else hold
        bare: Any = env.unwrapped
        standing = bare.model.key("stand").ctrl[motor_of_joint(bare.model)]
        self.inputs = input_matrix(bare.state_layout, standing, self.task)
        self.drive = PostureDrive(posture_matrix(), self.task.speed, self.task.memory, bare.dt)
        self._reward_scale = reward_scale
        self.observation_space = spaces.Box(-np.inf, np.inf, (len(self.inputs),), dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (self.drive.size,), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Reset, with the pattern's posture."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.drive.reset()
        return self.seen(observation), info

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Let the posture move on for the steps that an action holds."""
        total = 0.0
        for _ in range(self.hold):
            observation, reward, terminated, truncated, info = self.env.step(self.drive(action))
            total += float(reward)
            if terminated or truncated:
                break
        return self.seen(observation), self._reward_scale * total, terminated, truncated, info

    def seen(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Make the inputs of an observation, shape (N,)."""
        seen: NDArray[np.float32] = (self.inputs @ _flat(observation)).astype(np.float32)
        return seen
