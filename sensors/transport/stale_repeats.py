"""Stale repeats: a reader that finds no new value hands out the last one again.

A reader that polls its chips in turn, and a bus that misses one, keep what they have: in a log of a NAO's
feet 73 % of the values repeat the one before. With the probability p a reading is a repeat, each time anew,
so that a value stays for 1 / (1 - p) readings in the mean, in geometric runs. A fault of the kind
``"stuck"`` (:mod:`surefoot.sensors.faults.channels`) freezes one channel from a time on;
:func:`~surefoot.sensors.sample_and_hold` repeats because clocks differ, at times that follow from them.
"""

from typing import Any, NamedTuple

from surefoot.sensors._arrays import cast_like
from surefoot.sensors.corruption import Array, Corruption, Rng
from surefoot.sensors.randomness import filled, uniform
from surefoot.sensors.transport.rare import RARE, replace_where


class RepeatState(NamedTuple):
    """What a reader handed out last.

    Attributes:
        held: Shape (..., K); NaN before the first.
    """

    held: Array


def stale_repeats(probability: float, *, each: bool = False) -> Corruption[RepeatState]:
    """Repeat the last value now and then.

    Where there is none, before the first reading and after one that was lost, the new one passes.

    Args:
        probability: Probability that a reading is a repeat; 0 repeats nothing.
        each: Whether each channel repeats on its own; otherwise those of a robot do so together.

    Raises:
        ValueError: If the probability does not lie in [0, 1).
    """
    if not 0.0 <= probability < 1.0:
        raise ValueError(f"'probability' must lie in [0, 1), got {probability}.")

    def init(shape: tuple[int, ...], rng: Rng, dtype: Any = None) -> RepeatState:
        return RepeatState(filled(rng, float("nan"), shape, dtype))

    def apply(reading: Array, state: RepeatState, rng: Rng, dt: float) -> tuple[Array, RepeatState]:
        held = cast_like(state.held, reading)
        shape = tuple(reading.shape) if each else (*reading.shape[:-1], 1)
        stale = uniform(rng, 0.0, 1.0, shape, reading.dtype) < probability
        read = replace_where(reading, held, stale, probability <= RARE)
        return read, RepeatState(read)

    return Corruption(init, apply)
