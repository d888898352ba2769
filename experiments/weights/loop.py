r"""Estimate hysteresis and zero drift of a cell from the order in which weights were put on and taken off.

Under a load F, readings in N (by the cell's line or curve) are

.. math:: y = m_F + h\, L(F) + d\, t + n

with one mean per load, so that the shape of the curve does not matter. L is the hysteresis of the emulated
cells (:mod:`surefoot.sensors.stages.hysteresis`) per unit of its share, and t is the position of the row in
the table, from 0 to 1. Student's t tests h and d jointly.
"""

from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from surefoot.arrays import Floats
from surefoot.sensors.stages.hysteresis import hysteresis
from surefoot.sensors.stages.mechanics import SMALLEST_LOOP

UNIT = 1e-3  # share of hysteresis for which loops are computed; they are proportional to it
ALARM = 1e-4  # probability of reporting hysteresis or drift of a cell without them
WIDER = 2.0 ** np.arange(0.0, 1.0, 0.125)
"""Full scales of loops, in units of the largest load. From 2 on the loops repeat."""
SHAPE = 0.1
"""Share of the width of a loop that appears as drift, from simulated curved cells with loops of 5 %."""
LEAST = 5e-4
"""Share of the full scale from which hysteresis is reported: the specification of cheap load cells."""


class Memory(NamedTuple):
    """Effects of the order of weighings on the readings of a cell."""

    hysteresis: float  # width of the loop at half the largest load, in shares of that load
    hysteresis_std: float
    drift: float  # of the zero from the first row to the last in N
    drift_std: float
    reach: float  # number of standard deviations from which hysteresis or drift are significant

    @property
    def loops(self) -> bool:
        """Whether hysteresis is significant and large enough to be reported."""
        return abs(self.hysteresis) > max(self.reach * self.hysteresis_std, LEAST)

    @property
    def drifts(self) -> bool:
        """Whether the drift of the zero is significant."""
        return abs(self.drift) > self.reach * self.drift_std


def memory_of(load: Floats, force: Floats, rounding: float) -> Memory | None:
    """Find hysteresis and drift of one cell; ``None`` with too few readings.

    Hysteresis is zero and unknown unless loads were reached from below and from above.

    Loads in N, (n,), are in the order of weighing; readings, (n,), are newtons by the cell's own line or
    curve, and their rounding has a standard deviation in N.
    """
    full, values = float(np.abs(load).max()), np.unique(load)
    free = len(load) - len(values) - 2
    if free < 1:
        return None
    loops = loop_of(np.tile(load[:, None], len(WIDER)), full * WIDER)
    rest = np.column_stack([loops, np.linspace(0.0, 1.0, len(load)), force])
    for one in values:
        rest[load == one] -= rest[load == one].mean(axis=0)
    fits, y = [], rest[:, -1]
    for k in range(len(WIDER)):
        A = rest[:, [k, -2]]
        information = A.T @ A
        # The loop must differ by more than a drift does, from row to row.
        left = information[0, 0] - information[0, 1] ** 2 / max(information[1, 1], 1e-300)
        if not left > 1e-6 * full**2:
            return _drift_alone(rest[:, -2], y, free + 1, rounding)
        covariance = np.linalg.inv(information)
        theta = covariance @ (A.T @ y)
        variance = max(float(np.sum((y - A @ theta) ** 2)) / free, rounding**2)
        fits.append((theta, variance * np.diagonal(covariance), variance))
    means, variances, noise = (np.array(part) for part in zip(*fits, strict=True))
    # Each shape counts by its likelihood.
    weight = np.exp(-0.5 * free * np.log(noise / noise.min()))[:, None] / np.ones((1, 2))
    weight /= weight.sum(axis=0)
    mean = (weight * means).sum(axis=0)
    std = np.sqrt((weight * (variances + (means - mean) ** 2)).sum(axis=0))
    reach = float(student.ppf(1.0 - 0.5 * ALARM, free))
    # A loop has a slope of its own, so that newtons are known to its share.
    own = float(np.hypot(std[0], mean[0] ** 2))
    drifted = float(np.hypot(std[1], SHAPE * mean[0] * full))
    return Memory(float(mean[0]), own, float(mean[1]), drifted, reach)


def loop_of(load: Floats, capacity: Floats) -> Floats:
    """Return the hysteresis of loads in N, (N, K), per unit of its share, for K capacities in N."""
    element, rng = hysteresis(UNIT, capacity, smallest=SMALLEST_LOOP), np.random.default_rng(0)
    turns = np.flatnonzero(np.concatenate([[True], (np.diff(load, axis=0) != 0.0).any(axis=1)]))
    state, loops = element.init(load.shape[1:], rng), []
    for row in load[turns]:
        reading, state = element.apply(row, state, rng, 0.0)
        loops.append((reading - row) / UNIT)
    return np.repeat(np.array(loops), np.diff(np.append(turns, len(load))), axis=0)


def _drift_alone(time: Floats, force: Floats, free: int, rounding: float) -> Memory | None:
    """Find the drift of a cell whose loads were all reached from the same side."""
    information = float(time @ time)
    if information <= 0.0:
        return None
    drift = float(time @ force) / information
    variance = max(float(np.sum((force - drift * time) ** 2)) / free, rounding**2)
    reach = float(student.ppf(1.0 - 0.5 * ALARM, free))
    return Memory(0.0, np.inf, drift, float(np.sqrt(variance / information)), reach)
