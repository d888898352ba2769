r"""Forces of now, from readings that are some milliseconds old.

A chip on its own clock is read up to a conversion late, and a filter or a wire adds to that. The mean age
:math:`\alpha` of its readings is known from data sheets; the phase of its clock is not. A force is carried on
with the slope that it had over the last :math:`n = 3` samples,

.. math:: \delta_i = \alpha_i \frac{F_i(k) - F_i(k - n)}{n \Delta t} .

The feet's vertical force stays as it was read. While a robot shifts its weight the sum hardly changes, and
its slope is mostly that chips are read at different moments. With :math:`v_i` the share of a newton on a
channel adds to the vertical force, least squares relative to the :math:`\delta` themselves give

.. math:: \delta_i \leftarrow \delta_i - v_i \delta_i^2 \frac{\sum_j v_j \delta_j}{\sum_j v_j^2 \delta_j^2} .
"""

from dataclasses import replace

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.arrays import Array
from surefoot.calibration.setup import OnlineSetup

SLOPE_SAMPLES = 3  # samples over which a slope is taken: shorter ones are noisier, longer ones later
_LONGEST = 4.0  # samples by which a force is carried on at most: that it helps for longer has not been seen


def extrapolation_time(setup: OnlineSetup) -> Floats:
    """Return by how long each channel is carried on in s, shape (K,)."""
    age = np.asarray(setup.age, dtype=np.float64)
    return np.minimum(age, _LONGEST * setup.dt) + np.zeros(setup.layout.channels)


def as_read(setup: OnlineSetup) -> OnlineSetup:
    """Return a setup whose readings are not carried on."""
    return replace(setup, age=0.0)


def change_since_reading(history: Array, clean: int, time: Array, interval: float) -> Array:
    """Return by how much forces are expected to have changed since they were read, in N, shape (K,).

    That is nothing where a reading at an end of the slope did not come, or a sample between was not good:
    fewer than enough ``clean`` ones came since the last bad one. ``history`` has the last n samples, the
    newest at the end: F0 and whether it was read, shape (n, 2K), an interval in s apart; each channel is
    carried on by a time in s, shape (K,).
    """
    K = len(time)
    if clean < SLOPE_SAMPLES:
        return np.zeros(K)
    newest, before = history[-1], history[-1 - SLOPE_SAMPLES]
    there = (newest[K:] > 0.5) & (before[K:] > 0.5)
    slope = (newest[:K] - before[:K]) / (SLOPE_SAMPLES * interval)
    return np.where(there, time * slope, 0.0)


def with_total_kept(change: Array, up: Array) -> Array:
    """Return changes of forces in N, (K,), that leave the vertical force, ``up`` by a newton, as it is."""
    by = up * change * change
    room = (by * up).sum()
    if not room > 0.0:
        return np.zeros_like(change)
    return change - by * ((up * change).sum() / room)
