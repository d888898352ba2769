r"""Two clocks: by how much an IMU is late against the readings.

Gravity that is late by :math:`\tau` makes readings lead it,

.. math:: r(t) = B\, g(t) + o = B\, \big(g_m(t) + \tau\, \dot g_m(t) + \dots\big) + o,

so that what is left of them follows :math:`B \dot g_m` with one number for all channels and sets. Each step
shifts gravity by what is found and looks again. Readings that lag behind gravity instead are those of a
sensor with hysteresis, as far as a log can show: only what leads is taken for a clock's.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.model import signals
from surefoot.calibration.in_situ.rows import means

__all__ = ["synchronise"]

Matrix = NDArray[np.float64]

_ROWS = 1500
"""Rows of a set in which a delay is looked for."""

_DRIFT = 6
"""Cosines over a set's time that an offset may follow meanwhile."""

_ROUNDS, _SETTLED = 6, 1e-4
"""Steps at most, and the last one in s."""

_LONGEST = 1.0
"""Delay in s beyond which it is none."""

_SHORTEST = 1e-3
"""Delay in s below which nothing is shifted: half of a sample at 500 Hz."""

_EXPLAINS = 0.5
"""Share of the residual's square that a delay leaves at most: a turned IMU or hysteresis leave more."""


def synchronise(
    sets: tuple[InSituSet, ...], moving: bool
) -> tuple[tuple[InSituSet, ...], float, list[Finding]]:
    """Return sets with gravity at the times of the readings, how late it was in s, and what to say."""
    if any(data.time is None or len(data.raw) < 8 * _DRIFT for data in sets):
        return sets, 0.0, []
    delay, shifted = 0.0, sets
    before = after = None
    for _ in range(_ROUNDS):
        found = [_slope(data, moving) for data in shifted]
        left = sum(one[0] for one in found)
        before = left if before is None else before
        after = left
        step = sum(one[1] for one in found) / max(sum(one[2] for one in found), np.finfo(float).tiny)
        if not np.isfinite(step) or abs(delay + step) > _LONGEST:
            return sets, 0.0, []
        if abs(step) < (_SETTLED if delay else _SHORTEST):
            break
        delay += float(step)
        shifted = tuple(_shift(data, delay) for data in sets)
    if delay < _SHORTEST or after is None or before is None or after > _EXPLAINS * before:
        return sets, 0.0, []
    words = f"The IMU is late by {1e3 * delay:.1f} ms against the readings: it was shifted by that."
    return shifted, delay, [Finding("clock", words, value=delay, limit=_SHORTEST, refuses=False)]


def _slope(data: InSituSet, moving: bool) -> tuple[float, float, float]:
    """Return the square that a set's linear fit leaves, and its products with B dg/dt and of that alone."""
    assert data.time is not None
    u = signals(data, moving)
    whole = np.isfinite(u).all(axis=1) & np.isfinite(data.raw).all(axis=1)
    width = max(int(np.sum(whole)) // _ROWS, 1)
    rows = means(np.column_stack([data.time, u, data.raw])[whole], width)
    time, u, raw = rows[:, 0], rows[:, 1 : 1 + u.shape[1]], rows[:, 1 + u.shape[1] :]
    share = (time - time[0]) / max(float(time[-1] - time[0]), np.finfo(float).tiny)
    offset = np.cos(np.pi * share[:, None] * np.arange(_DRIFT))
    size = np.maximum(np.std(u, axis=0), np.finfo(float).tiny)
    columns = np.concatenate([u / size, offset], axis=1)
    left, singular, right = np.linalg.svd(columns, full_matrices=False)
    kept = singular > 1e-9 * singular[0]
    left = left[:, kept]
    slope = (right[kept].T / singular[kept]) @ (left.T @ raw)
    residual = raw - left @ (left.T @ raw)
    rate = np.gradient(u, time, axis=0) / size @ slope[: u.shape[1]]
    rate -= left @ (left.T @ rate)
    noise = np.linalg.pinv(residual.T @ residual / len(raw), rcond=1e-9, hermitian=True)
    return (
        float(np.sum(residual**2 / np.maximum(np.var(raw, axis=0), np.finfo(float).tiny))),
        float(np.sum((rate @ noise) * residual)),
        float(np.sum((rate @ noise) * rate)),
    )


def _shift(data: InSituSet, delay: float) -> InSituSet:
    """Return a set with gravity and motion as they were read later by the delay; the ends drop out."""
    time = data.time
    assert time is not None
    kept = (time + delay >= time[0]) & (time + delay <= time[-1])

    def later(values: Matrix) -> Matrix:
        return np.stack([np.interp(time[kept] + delay, time, one) for one in values.T], axis=1)

    rate, acceleration = data.angular_velocity, data.angular_acceleration
    return replace(
        data,
        raw=data.raw[kept],
        time=time[kept],
        temperature=None if data.temperature is None else data.temperature[kept],
        gravity=later(data.gravity),
        angular_velocity=None if rate is None else later(rate),
        angular_acceleration=None if acceleration is None else later(acceleration),
    )
