"""Fixed gains and offsets: what turns a load into a voltage and a voltage into a count."""

from typing import Any, NamedTuple

from numpy.typing import ArrayLike

from surefoot.sensors._arrays import cast_like
from surefoot.sensors.corruption import Array, Corruption, Rng
from surefoot.sensors.randomness import constant


class FixedState(NamedTuple):
    """A number (or one a channel) that stays as it is."""

    value: Array


def _fixed_init(value: ArrayLike) -> Any:
    def init(shape: tuple[int, ...], rng: Rng, dtype: Any = None) -> FixedState:
        return FixedState(constant(rng, value, dtype))

    return init


def gain(value: ArrayLike) -> Corruption[FixedState]:
    """Multiply readings by a number.

    Args:
        value: Reported units per unit read: one number, or one a channel.
    """

    def apply(reading: Array, state: FixedState, rng: Rng, dt: float) -> tuple[Array, FixedState]:
        return reading * cast_like(state.value, reading), state

    return Corruption(_fixed_init(value), apply)


def offset(value: ArrayLike) -> Corruption[FixedState]:
    """Add a number to readings.

    Args:
        value: In the unit of the readings: one number, or one a channel.
    """

    def apply(reading: Array, state: FixedState, rng: Rng, dt: float) -> tuple[Array, FixedState]:
        return reading + cast_like(state.value, reading), state

    return Corruption(_fixed_init(value), apply)
