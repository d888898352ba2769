r"""Spikes: single readings that are off, at any time, in any channel.

They come as a Poisson process of the rate :math:`r` in each channel, so that a reading which stands for the
time :math:`\Delta t` is off with the probability :math:`1 - e^{-r \Delta t}`, and by a normal number: a few
are far out and some hide in the noise, which is what makes them hard to gate. A fault of the kind
``"spiking"`` (:mod:`surefoot.sensors.faults`) is a wire gone bad: one channel, on a schedule, by one size,
within the converter's range.
"""

from math import expm1
from typing import Any

from surefoot.sensors._arrays import namespace
from surefoot.sensors.corruption import Array, Corruption, Rng, check_not_negative
from surefoot.sensors.randomness import normal, uniform


def spikes(rate: float, size: float) -> Corruption[tuple[()]]:
    """Add spikes at random.

    Args:
        rate: Mean number of spikes of a channel in a second in 1/s; 0 adds none.
        size: Standard deviation of a spike in the unit of the readings.

    Raises:
        ValueError: If an argument is negative.
    """
    check_not_negative(rate=rate, size=size)

    def init(shape: tuple[int, ...], rng: Rng, dtype: Any = None) -> tuple[()]:
        return ()

    def apply(reading: Array, state: tuple[()], rng: Rng, dt: float) -> tuple[Array, tuple[()]]:
        shape = tuple(reading.shape)
        hit = uniform(rng, 0.0, 1.0, shape, reading.dtype) < -expm1(-rate * dt)
        spike = size * normal(rng, shape, reading.dtype)
        return namespace(reading).where(hit, reading + spike, reading), state

    return Corruption(init, apply)
