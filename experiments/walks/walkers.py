"""One robot on different feet: the same task, pattern and controller on another feed of its CoP."""

import os
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any

import gymnasium as gym
from gymnasium import spaces

from surefoot.calibration.online import METHODS
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

    It is no part of this package: ``g1_policy.py`` lies in the folder that ``SUREFOOT_STRANGERS`` names.
    """
    sys.path.append(os.environ["SUREFOOT_STRANGERS"])
    walker: gym.Env[Any, Any] = import_module("g1_policy").G1Walk(policy)
    return walker
