"""One robot on different feet: the same task, pattern and controller on another feed of its CoP."""

import os
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any

import gymnasium as gym

from surefoot.calibration.online import METHODS
from surefoot.names import plain_name

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


G1_FEET = ("left_ankle_roll_link", "right_ankle_roll_link")


def make_g1(policy: str) -> gym.Env[Any, Any]:
    """Make the Unitree G1 that walks by a published policy, ``"ppo_g1_29dof"`` or ``"fastsac_g1_29dof"``.

    It is no part of this package: ``g1_policy.py`` lies in the folder that ``SUREFOOT_STRANGERS`` names.
    """
    sys.path.append(os.environ["SUREFOOT_STRANGERS"])
    walker: gym.Env[Any, Any] = import_module("g1_policy").G1Walk(policy)
    return walker
