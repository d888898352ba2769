r"""The filter of a converter: a mean over the last readings, once or several times over.

A sigma-delta converter averages its modulator's bits over a conversion, and again over conversions: a
cascade of :math:`m` means over :math:`n` readings each, a sinc filter of order :math:`m`,

.. math:: |H(f)| = \left| \frac{\sin(\pi f n T)}{n \sin(\pi f T)} \right|^m .

Its response at rest is one and vanishes at the multiples of :math:`1 / (n T)`. Every frequency has the same
group delay :math:`m (n - 1) T / 2`, and a step has settled after :math:`m (n - 1) + 1` readings
(Hogenauer, 1981, of which this is the impulse response). An HX711 settles in four conversions by its data
sheet, 50 ms at 80 SPS, as :math:`n = 4` does at its conversion rate and :math:`m (n - 1) \approx 4 T_c / T`
on substeps of the length :math:`T` of a conversion's :math:`T_c`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.sensors.configuration import check_whole
from surefoot.sensors.corruption import Array, Corruption, Rng


class MovingAverageState(NamedTuple):
    """The state of a filter.

    Attributes:
        window: The readings before, the oldest first, shape (L, K) with L = m (n - 1); NaN before the first,
            which then counts as having been there for ever.
    """

    window: Array


def moving_average(count: int, order: int = 1, *, blocks: bool = False) -> Corruption[MovingAverageState]:
    """Average over the last readings, which must be equally far apart in time.

    A reading that is not finite makes its own output NaN and spoils no other: the one before it, or at the
    start the one after it, takes its place.

    Args:
        count: Over how many readings n; 1 changes nothing.
        order: How many times m.
        blocks: Whether a reading is a block of substeps, shape (S, K), as a stage with a clock takes it:
            each substep is filtered and the result is a block again, so that the filter can stand before load
            cells or :mod:`~surefoot.sensors.stages.clock`.

    Raises:
        ValueError: If a number is not a positive whole one.

    >>> import numpy as np
    >>> mean, rng = moving_average(4), np.random.default_rng(0)
    >>> state, read = mean.init((1,), rng), []
    >>> for load in (0.0, 8.0, 8.0, 8.0, 8.0):
    ...     reading, state = mean.apply(np.array([load]), state, rng, 0.0125)
    ...     read.append(float(reading[0]))
    >>> read
    [0.0, 2.0, 4.0, 6.0, 8.0]
    """
    check_whole(count=count, order=order)
    kernel = np.ones(1)
    for _ in range(order):
        kernel = np.convolve(kernel, np.full(count, 1.0 / count))
    weights = kernel.tolist()
    length = len(weights) - 1

    def init(shape: tuple[int, ...], rng: Rng) -> MovingAverageState:
        return MovingAverageState(np.full((length, *shape), np.nan))

    def apply(
        reading: Array, state: MovingAverageState, rng: Rng, dt: float
    ) -> tuple[Array, MovingAverageState]:
        if not length:
            return reading + 0.0, state
        block = reading if blocks else reading[None]
        window, came = state.window, np.isfinite(block)
        if not came.all():
            block = _fill_gaps(block, came, window[-1])
        rows = np.concatenate([np.where(np.isnan(window), block[:1], window), block])
        # The kernel is its own mirror image: the oldest row comes first either way.
        averaged = weights[0] * rows[: len(block)]
        for number, weight in enumerate(weights[1:], start=1):
            averaged = averaged + weight * rows[number : number + len(block)]
        averaged = np.where(came, averaged, np.nan)
        kept = MovingAverageState(rows[len(block) :])
        return (averaged if blocks else averaged[0]), kept

    return Corruption(init, apply)


def _fill_gaps(block: Array, came: NDArray[np.bool_], before: Array) -> Array:
    """Replace each reading that did not come by the one before it, or at the start by the one after it."""
    rows = []
    for row, here in zip(block, came, strict=True):
        before = np.where(here, row, before)
        rows.append(before)
    for index in range(len(rows) - 2, -1, -1):
        rows[index] = np.where(np.isnan(rows[index]), rows[index + 1], rows[index])
    return np.stack(rows)
