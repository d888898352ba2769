"""Scale and offset, fixed or drifting: the map from a load to a voltage, and a voltage into a count.

The drifting ones are random walks, b_{k+1} = b_k + sigma sqrt(dt) w_k with w_k ~ N(0, 1): their spread
depends on the time that has passed and not on how finely that time was stepped.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.sensors.configuration import check_not_negative
from surefoot.sensors.corruption import Array, Corruption, Rng
from surefoot.sensors.randomness import normal

PER_SQRT_MINUTE = 60.0**-0.5
"""Turns a density "per square root of a minute" into one per square root of a second."""


class FixedState(NamedTuple):
    """A number that stays as it is.

    Attributes:
        value: One number, or one a channel.
    """

    value: Array


class WalkState(NamedTuple):
    """Where a random walk stands.

    Attributes:
        error: One number a channel, shape (K,).
    """

    error: Array


def scale(value: ArrayLike) -> Corruption[FixedState]:
    """Multiply readings by a number.

    Args:
        value: Reported units per unit read: one number, or one a channel.
    """

    def apply(reading: Array, state: FixedState, rng: Rng, dt: float) -> tuple[Array, FixedState]:
        return reading * state.value, state

    return Corruption(_constant_init(value), apply)


def offset(value: ArrayLike) -> Corruption[FixedState]:
    """Add a number to readings.

    Args:
        value: In the unit of the readings: one number, or one a channel.
    """

    def apply(reading: Array, state: FixedState, rng: Rng, dt: float) -> tuple[Array, FixedState]:
        return reading + state.value, state

    return Corruption(_constant_init(value), apply)


def scale_drift(initial_std: float = 0.0, density: float = 0.0) -> Corruption[WalkState]:
    r"""Multiply readings by one plus an error that starts anywhere and drifts.

    Args:
        initial_std: Standard deviation of the relative error of the scale at power-up.
        density: Spread of its walk per :math:`\sqrt{s}`.

    Raises:
        ValueError: If an argument is negative.
    """
    check_not_negative(initial_std=initial_std, density=density)

    def apply(reading: Array, state: WalkState, rng: Rng, dt: float) -> tuple[Array, WalkState]:
        error = _walk_step(state.error, density, rng, dt)
        return reading * (1.0 + error), WalkState(error)

    return Corruption(_walk_init(initial_std), apply)


def drift(initial_std: float = 0.0, density: float = 0.0) -> Corruption[WalkState]:
    r"""Add an offset that starts anywhere and drifts.

    Args:
        initial_std: Standard deviation of the offset at power-up, in the unit of the readings.
        density: Spread of the walk, in the unit of the readings per :math:`\sqrt{s}`.

    Raises:
        ValueError: If an argument is negative.
    """
    check_not_negative(initial_std=initial_std, density=density)

    def apply(reading: Array, state: WalkState, rng: Rng, dt: float) -> tuple[Array, WalkState]:
        error = _walk_step(state.error, density, rng, dt)
        return reading + error, WalkState(error)

    return Corruption(_walk_init(initial_std), apply)


def _constant_init(value: ArrayLike) -> Callable[[tuple[int, ...], Rng], FixedState]:
    def init(shape: tuple[int, ...], rng: Rng) -> FixedState:
        return FixedState(np.asarray(value, dtype=np.float64))

    return init


def _walk_init(initial_std: float) -> Callable[[tuple[int, ...], Rng], WalkState]:
    def init(shape: tuple[int, ...], rng: Rng) -> WalkState:
        return WalkState(initial_std * normal(rng, shape))

    return init


def _walk_step(error: Array, density: float, rng: Rng, dt: float) -> Array:
    if density == 0.0:
        return error
    walked: Array = error + density * dt**0.5 * normal(rng, error.shape)
    return walked
