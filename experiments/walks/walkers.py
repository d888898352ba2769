"""One robot on different feet: the same task, pattern and controller on another feed of its CoP."""

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from surefoot.calibration.online import METHODS
from surefoot.controllers import zero_action
from surefoot.experiments.arrays import Floats
from surefoot.names import plain_name
from surefoot.sensors import LoadCells
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers.foot_sensors import FootSensors
from surefoot.wrappers.self_calibration import SelfCalibration

_FIRST: Mapping[str, Mapping[str, Any] | None] = MappingProxyType(
    {
        "true": None,
        "none": {"method": "none"},
        "weights": {"method": "none", "initial": "calibrated"},
        **{name: {"method": name} for name in reversed(METHODS) if name != "none"},
    }
)


class _Feeds(Mapping[str, Mapping[str, Any] | None]):
    """The feeds above, and methods that were registered since, or are by their module."""

    def __getitem__(self, name: str) -> Mapping[str, Any] | None:
        if name in _FIRST:
            return _FIRST[name]
        if plain_name(name) not in METHODS:
            raise KeyError(name)
        return {"method": name}

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*_FIRST, *METHODS)))

    def __len__(self) -> int:
        return len(list(iter(self)))


FEEDS: Mapping[str, Mapping[str, Any] | None] = _Feeds()
"""Sources of a controller's CoP, with options of SelfCalibration: the truth; drifting readings by the
nominal map, or by that which known weights gave just before the episode; and each calibration method, those
that users register among them, also as ``"module:name"``."""

STAND_TIME = 4.0  # s of standing before a walk: a standing start needs three, the filters a while


def check_feed(name: str) -> str:
    """Return the name of a feed, or raise ValueError with their names."""
    if name not in FEEDS:
        raise ValueError(f"There is no feed '{name}'. Available: {', '.join(map(repr, FEEDS))}.")
    return name


class TruthTap(gym.Wrapper[Any, Any, Any, Any]):
    """Keep the last true observation, ``seen``, for who scores; nothing that is observed changes."""

    def reset(self, **options: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Keep the first observation."""
        self.seen, info = self.env.reset(**options)
        return self.seen, info

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Keep the observation."""
        self.seen, *rest = self.env.step(action)
        return self.seen, *rest


class TrueCop(gym.ObservationWrapper[Any, Any, Any]):
    """Show the true centre of pressure, of a tap, beside the sensors' joints and tilt: for bounds."""

    def __init__(self, env: gym.Env[Any, Any], tap: TruthTap) -> None:
        super().__init__(env)
        self._tap = tap
        shown, truth = env.observation_space, tap.observation_space
        assert isinstance(shown, spaces.Dict)
        assert isinstance(truth, spaces.Dict)
        self._keys = ("foot_force", "cop_foot", "cop", "cop_valid")
        self.observation_space = spaces.Dict(dict(shown.spaces) | {key: truth[key] for key in self._keys})

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Show the truth."""
        return observation | {key: self._tap.seen[key] for key in self._keys}


def put_on_feet(
    bare: gym.Env[Any, Any],
    calibration: Mapping[str, Any] | None,
    cells: str | LoadCells = HX711_LOAD_CELLS,
    sensors: Mapping[str, Any] | None = MappingProxyType({}),
) -> tuple[gym.Env[Any, Any], TruthTap]:
    """Return an environment behind sensors and a calibration, and the tap that sees its truth.

    Studies make theirs in this one way. Options are those of :class:`SelfCalibration`, ``None`` for the true
    centre of pressure, and of :class:`FootSensors`, ``None`` for no sensors at all, where joints and tilt are
    true as well. Raises ValueError if one is refused, or there is nothing to calibrate.
    """
    tap = TruthTap(bare)
    if sensors is None:
        if calibration is not None:
            raise ValueError(
                "Without sensors there is nothing to calibrate; give 'sensors' or no 'calibration'."
            )
        return tap, tap
    worn = FootSensors(tap, cells, **sensors)
    return (TrueCop(worn, tap) if calibration is None else SelfCalibration(worn, **calibration)), tap


G1_FEET = ("left_ankle_roll_link", "right_ankle_roll_link")


def make_g1(policy: str) -> gym.Env[Any, Any]:
    """Make the Unitree G1 that walks by a published policy, ``"ppo_g1_29dof"`` or ``"fastsac_g1_29dof"``.

    It is no part of this package, and lies in the folder that the variable ``SUREFOOT_STRANGERS`` names.
    """
    sys.path.insert(1, os.environ.get("SUREFOOT_STRANGERS_CODE", os.environ["SUREFOOT_STRANGERS"]))
    walker: gym.Env[Any, Any] = import_module("g1_policy").G1Walk(policy)
    return walker


class Moment(NamedTuple):
    """An episode after one control step."""

    time: float  # since the reset in s
    bare: Any  # the environment beneath all wrappers
    observation: dict[str, Any]
    true_observation: dict[str, Any]  # without sensors in between
    fell: bool  # the episode ends then
    action: Any = None  # answered to the observation before
    reward: float = 0.0
    asked: bool = True  # the controller was, and not the quiet stand's zero action

    @property
    def cop_error(self) -> float:
        """Distance between the fed and the true centre of pressure in m; NaN where there is none."""
        if not self.true_observation["cop_valid"][0]:
            return float("nan")
        fed, true = self.observation["cop"].astype(np.float64), self.true_observation["cop"]
        return float(np.linalg.norm(fed - true))

    @property
    def tracking(self) -> float:
        """Distance between the true centre of pressure and the planned one in m, both in level frames."""
        if not self.true_observation["cop_valid"][0]:
            return float("nan")
        planned = self.true_observation["state"][self.bare.state_layout["cop_reference"]]
        return float(np.linalg.norm(self.true_observation["cop"].astype(np.float64) - planned))

    @property
    def true_cop_world(self) -> Floats:
        """The true centre of pressure in the world in m, shape (2,); NaN where there is none."""
        cop: Floats = self.bare.truth.cop_world()
        return cop

    @property
    def fed_cop_world(self) -> Floats:
        """The fed centre of pressure, placed under the true soles, in the world in m, shape (2,)."""
        sole = self.bare.truth.position_sole[-1, :, :2].mean(axis=0)
        ahead = self.bare.truth.R_world_sole[-1, :, :2, 0].sum(axis=0)
        x, y = ahead / np.linalg.norm(ahead)
        placed: Floats = sole + np.array([[x, -y], [y, x]]) @ self.observation["cop"]
        return placed


def moments(
    env: gym.Env[Any, Any],
    tap: TruthTap,
    controller: Callable[[dict[str, Any]], Any],
    seed: int,
    settle: float = 0.0,
    change: Callable[[dict[str, Any]], dict[str, Any]] = lambda observation: observation,
) -> Iterator[Moment]:
    """Run an episode by control steps, and close it; ``settle`` s of quiet stand come before control."""
    bare: Any = env.unwrapped
    waiting, steps, done = round(settle / bare.dt), 0, False
    try:
        observation, _ = env.reset(seed=seed)
        while not done:
            if steps == waiting and hasattr(controller, "reset"):
                controller.reset()
            asked = steps >= waiting
            action = np.asarray(controller(change(observation)) if asked else zero_action(observation))
            observation, reward, fell, truncated, _ = env.step(action)
            steps += 1
            done = fell or truncated
            yield Moment(steps * bare.dt, bare, observation, tap.seen, fell, action, float(reward), asked)
    finally:
        env.close()
