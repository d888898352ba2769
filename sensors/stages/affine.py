"""Scale and offset, fixed or drifting: the map from a load to a voltage, and a voltage into a count.

The drifting ones are random walks, b_{k+1} = b_k + sigma sqrt(dt) w_k with w_k ~ N(0, 1): their spread
depends on the time that has passed and not on how finely that time was stepped.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.sensors.configuration import check_not_negative
from surefoot.sensors.corruption import Corruption, Rng, stateless
from surefoot.sensors.randomness import normal

PER_SQRT_MINUTE = 60.0**-0.5
"""Turns a density "per square root of a minute" into one per square root of a second."""


class WalkState(NamedTuple):
    """Where a random walk stands."""

    error: Floats  # one number a channel, shape (K,)


def scale(value: ArrayLike) -> Corruption[tuple[()]]:
    """Multiply readings by a number, or one a channel: reported units per unit read."""
    factor = np.asarray(value, dtype=np.float64)
    return stateless(lambda reading, rng, dt: reading * factor)


def offset(value: ArrayLike) -> Corruption[tuple[()]]:
    """Add a number, or one a channel, in the unit of the readings."""
    added = np.asarray(value, dtype=np.float64)
    return stateless(lambda reading, rng, dt: reading + added)


def scale_drift(initial_std: float = 0.0, density: float = 0.0) -> Corruption[WalkState]:
    r"""Multiply readings by one plus an error that starts anywhere and drifts.

    The relative error has a standard deviation at power-up and a spread of its walk per :math:`\sqrt{s}`.
    """
    return _walk(initial_std, density, lambda reading, error: reading * (1.0 + error))


def drift(initial_std: float = 0.0, density: float = 0.0) -> Corruption[WalkState]:
    r"""Add an offset that starts anywhere and drifts.

    Standard deviation at power-up, and spread of the walk per :math:`\sqrt{s}`, in the unit of the readings.
    """
    return _walk(initial_std, density, lambda reading, error: reading + error)


def _walk(
    initial_std: float, density: float, read: Callable[[Floats, Floats], Floats]
) -> Corruption[WalkState]:
    """Make a corruption of ``read(reading, error)`` with an error that drifts."""
    check_not_negative(initial_std=initial_std, density=density)

    def init(shape: tuple[int, ...], rng: Rng) -> WalkState:
        return WalkState(initial_std * normal(rng, shape))

    def apply(reading: Floats, state: WalkState, rng: Rng, dt: float) -> tuple[Floats, WalkState]:
        error = state.error
        if density:
            error = error + density * dt**0.5 * normal(rng, error.shape)
        return read(reading, error), WalkState(error)

    return Corruption(init, apply)
