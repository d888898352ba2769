r"""Spikes: single readings that are off, at any time, in any channel.

They come as a Poisson process of the rate :math:`r` in each channel, so that a reading which stands for the
time :math:`\Delta t` is off with the probability :math:`1 - e^{-r \Delta t}`, and by a normal number: a few
are far out and some hide in the noise, which is what makes them hard to gate. A fault of the kind
``"spiking"`` (:mod:`surefoot.sensors.faults.channels`) is a wire gone bad: one channel, on a schedule, by one
size,
within the converter's range.
"""

from math import expm1
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from surefoot.sensors._arrays import Table, limit, round_off
from surefoot.sensors.corruption import Array, Corruption, Rng, check_not_negative
from surefoot.sensors.randomness import normal
from surefoot.sensors.transport.rare import change_at_random


def spikes(
    rate: float, size: ArrayLike, *, code_range: tuple[ArrayLike, ArrayLike] | None = None
) -> Corruption[tuple[()]]:
    """Add spikes at random.

    Args:
        rate: Mean number of spikes of a channel in a second in 1/s; 0 adds none.
        size: Standard deviation of a spike in the unit of the readings, a number or shape (K,).
        code_range: Lowest and highest code of a converter, numbers or shapes (K,), to which what is off is
            clipped and rounded; ``None`` for readings that are no codes.

    Raises:
        ValueError: If an argument is negative.
    """
    check_not_negative(rate=rate)
    sizes = np.asarray(size, dtype=np.float64)
    if not np.all((sizes >= 0.0) & np.isfinite(sizes)):
        raise ValueError(f"'size' must be finite and not negative, got {size!r}.")
    tables = [Table(values) for values in (sizes, *(code_range or ()))]

    def init(shape: tuple[int, ...], rng: Rng, dtype: Any = None) -> tuple[()]:
        return ()

    def apply(reading: Array, state: tuple[()], rng: Rng, dt: float) -> tuple[Array, tuple[()]]:
        def spike(few: Array, spread: Array, *ends: Array) -> Array:
            off = few + spread * normal(rng, tuple(few.shape), few.dtype)
            return round_off(limit(off, *ends)) if ends else off

        values = (table.like(reading) for table in tables)
        return change_at_random(reading, -expm1(-rate * dt), spike, rng, *values), state

    return Corruption(init, apply)
