r"""Readings in time: each is of its own moment, which is some milliseconds ago.

A chip on its own clock averages the load over a conversion, and is read up to another conversion later. A
filter or a wire adds to that. The mean age :math:`\alpha_i` of a channel's readings is known from data
sheets. Where the device reports when each conversion ended, the deviation :math:`\lambda_i(k)` of a reading
from that age is known as well, and reading k is the load at :math:`t_k - \alpha_i - \lambda_i(k)`.

**Aligned.** The loads of all channels at one common moment, a whole number of samples ago, are interpolated
linearly between the readings before and after it. Nothing is extrapolated, so that an aligned centre of
pressure has no error of different clocks.

**Now.** For the centre of pressure of all feet together a force is extrapolated with the slope that it had
over the last :math:`n = 3` samples,

.. math::
    \delta_i = (\alpha_i + \lambda_i)
    \frac{F_i(k) - F_i(k - n)}{n \Delta t - \lambda_i(k) + \lambda_i(k - n)} .

The feet's vertical force stays as it was read. While a robot shifts its weight the sum hardly changes, and
its slope is mostly that chips are read at different moments. With :math:`v_i` the share of a newton on a
channel adds to the vertical force, least squares relative to the :math:`\delta` themselves give

.. math:: \delta_i \leftarrow \delta_i - v_i \delta_i^2 \frac{\sum_j v_j \delta_j}{\sum_j v_j^2 \delta_j^2} .

Single feet are reported as they were read: extrapolation made their centres of pressure worse by 15 % on
average (six robots that walk, sway or squat).
"""

from math import ceil

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.arrays import Array
from surefoot.calibration.setup import OnlineSetup

SLOPE_SAMPLES = 3  # samples over which a slope is taken: shorter ones are noisier, longer ones later
_LONGEST = 4.0  # samples by which a force is extrapolated at most: no benefit was measured beyond that


def mean_age(setup: OnlineSetup) -> Floats:
    """Return the mean age of each channel's readings in s, shape (K,)."""
    return np.asarray(setup.age, dtype=np.float64) + np.zeros(setup.layout.channels)


def extrapolation_time(setup: OnlineSetup) -> Floats:
    """Return by how long each channel is extrapolated in s, shape (K,)."""
    return np.minimum(mean_age(setup), _LONGEST * setup.dt)


def alignment_lag(setup: OnlineSetup) -> int:
    """Return how many samples ago the moment of aligned forces was.

    It is the least number for which readings on both sides of that moment have usually arrived: readings of a
    chip are older than the mean by up to half a sample.
    """
    return max(1, ceil(float(mean_age(setup).max()) / setup.dt + 0.5 - 1e-9))


def change_since_reading(history: Array, clean: int, time: Array, interval: float) -> Array:
    """Return by how much forces are expected to have changed since they were read, in N, shape (K,).

    That is zero where a reading at an end of the slope did not come, or a sample between was not good: fewer
    than enough ``clean`` ones came since the last bad one. ``history`` has the last n samples, the newest at
    the end: F0, whether it was read, and how much older than usual it was in s, shape (n, 3K), an interval in
    s apart. Each channel is extrapolated by a time in s, shape (K,).
    """
    K = len(time)
    if clean < SLOPE_SAMPLES:
        return np.zeros(K)
    (force, read, late), (force_before, read_before, late_before) = (
        row.reshape(3, K) for row in (history[-1], history[-1 - SLOPE_SAMPLES])
    )
    there = (read > 0.5) & (read_before > 0.5) & (time > 0.0)
    passed = np.maximum(SLOPE_SAMPLES * interval - late + late_before, interval)
    return np.where(there, (time + late) * ((force - force_before) / passed), 0.0)


def force_at(history: Array, back: int, delay: Array, interval: float) -> Array:
    """Return the forces some samples ago in N, shape (K,), interpolated between the readings around then.

    Where all readings are on one side of that moment, the nearest of them counts. A channel that was not read
    at all keeps the value held at that sample.

    Args:
        history: As of :func:`change_since_reading`, shape (n, 3K).
        back: How many samples before the newest one.
        delay: How long after that sample the moment is in s, shape (K,).
        interval: Time between samples in s.
    """
    K, newest = len(delay), len(history) - 1
    moment = -float(back) * interval + delay
    force = history[newest - back, :K].copy()
    found, later, force_later = np.zeros(K, dtype=bool), np.full(K, np.inf), np.zeros(K)
    for row in range(newest, -1, -1):
        read_force, read, late = history[row].reshape(3, K)
        time = (row - newest) * interval - late
        usable = (read > 0.5) & ~found
        before, after = usable & (time <= moment), usable & (time > moment)
        share = np.where(before & np.isfinite(later), (moment - time) / (later - time), 0.0)
        force = np.where(before, read_force + share * (force_later - read_force), force)
        found |= before
        later, force_later = np.where(after, time, later), np.where(after, read_force, force_later)
    return np.where(~found & np.isfinite(later), force_later, force)


def with_total_kept(change: Array, up: Array) -> Array:
    """Return changes of forces in N, (K,), that leave the vertical force, ``up`` by a newton, as it is."""
    by = up * change * change
    room = (by * up).sum()
    if not room > 0.0:
        return np.zeros_like(change)
    return change - by * ((up * change).sum() / room)
