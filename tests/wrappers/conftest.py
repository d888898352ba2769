"""Environments that several tests wrap; planning a walk is done once."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import pytest

import surefoot  # noqa: F401


def _make(name: str = "surefoot/NaoWalk-v0", **options: Any) -> gym.Env[Any, Any]:
    if "Walk" in name:
        options = {"speed": 0.04, "duration": 12.0, **options}
    return gym.make(name, **options)


@pytest.fixture
def make_bare() -> Callable[..., gym.Env[Any, Any]]:
    """Make a bare environment; by default a walk of 12 s."""
    return _make
