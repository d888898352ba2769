r"""The filter of a converter: a mean over the last readings.

A sigma-delta converter averages its modulator's bits over a conversion, and again over :math:`n` conversions,

.. math:: |H(f)| = \left| \frac{\sin(\pi f n T)}{n \sin(\pi f T)} \right| .

Its response at rest is one and vanishes at the multiples of :math:`1 / (n T)`. Every frequency has the same
group delay :math:`(n - 1) T / 2`, and a step has settled after :math:`n` readings (Hogenauer, 1981). An HX711
settles in four conversions by its data sheet, 50 ms at 80 SPS.
"""

from typing import NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.checks import check_count
from surefoot.sensors.corruption import Corruption, Rng


class MovingAverageState(NamedTuple):
    """The state of a filter."""

    window: Floats
    """The n - 1 readings before, the oldest first, shape (n - 1, K); NaN before the first, which then counts
    as having been there for ever."""


def moving_average(count: int) -> Corruption[MovingAverageState]:
    """Average over the last readings, which must be equally far apart in time.

    A reading that is not finite makes its own output NaN and spoils no other: the one before it takes its
    place.

    Args:
        count: Over how many readings n; 1 changes nothing.

    Raises:
        ValueError: If it is not a positive whole number.

    >>> import numpy as np
    >>> mean, rng = moving_average(4), np.random.default_rng(0)
    >>> state, read = mean.init((1,), rng), []
    >>> for load in (0.0, 8.0, 8.0, 8.0, 8.0):
    ...     reading, state = mean.apply(np.array([load]), state, rng, 0.0125)
    ...     read.append(float(reading[0]))
    >>> read
    [0.0, 2.0, 4.0, 6.0, 8.0]
    """
    check_count("count", count)
    weight = 1.0 / count

    def init(shape: tuple[int, ...], rng: Rng) -> MovingAverageState:
        return MovingAverageState(np.full((count - 1, *shape), np.nan))

    def apply(
        reading: Floats, state: MovingAverageState, rng: Rng, dt: float
    ) -> tuple[Floats, MovingAverageState]:
        if count == 1:
            return reading + 0.0, state
        window, came = state.window, np.isfinite(reading)
        newest = np.where(came, reading, window[-1])
        rows = np.concatenate([np.where(np.isnan(window), newest, window), newest[None]])
        averaged = weight * rows[0]
        for row in rows[1:]:
            averaged = averaged + weight * row
        return np.where(came, averaged, np.nan), MovingAverageState(rows[1:])

    return Corruption(init, apply)
