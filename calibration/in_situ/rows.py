r"""A set as rows: means over windows in which the limb hardly turns, of the samples that take part.

Samples that are missing, or that disagree with all others, take no part. The offset's basis b(t) stands
before the signals u and the readings r in each row, weighted by the root of its number of samples.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from surefoot.calibration.arrays import MAD_TO_STD
from surefoot.calibration.in_situ.data import InSituSet

__all__ = ["FLOOR", "SetRows", "disagreeing", "means", "rows_of"]

Matrix = NDArray[np.float64]

_GATE = 1e-9
"""Probability that a sample of nothing but noise is left out."""

_SLIGHT = 0.05
"""Share of a channel's spread by which a sample must be off to be left out: 1 % of hysteresis leaves up to
0.04 at the turns of a limb that takes postures, and is seen by these."""

FLOOR = 1e-9
"""Deviations below this share of a channel's spread are rounding, not noise."""

_ROUNDS = 12
"""Times that the weights are computed at most ..."""

_SETTLED = 1e-3
"""... until they change by less than this."""

_ROWS, _ROWS_MOVING = 2000, 200
"""Windows to whose means a set is reduced, if its limb turns slowly enough ..."""

_WITHIN, _WITHIN_MOVING = 1e-3, 0.1
"""... so that this share of the signals' spread is lost within them. A gyroscope's noise grows with the
frequency as it is differentiated, and signals with noise are less than they seem: what is faster than the
motion is left out."""

_LEAST_DURATION = 8.0
"""Time in s that a set must last for each cosine of its offset."""


class SetRows(NamedTuple):
    """A set in rows of nearly equal weight, in the order of time."""

    name: str
    used: NDArray[np.bool_]
    rejected: NDArray[np.bool_]
    columns: Matrix
    """(b, u, r), weighted, shape (m, d + s + k)."""
    terms: int
    """d."""
    inputs: int
    """s."""
    ends: Matrix
    """b at the middle and at the end, shape (2, d)."""
    weight: NDArray[np.float64]
    place: NDArray[np.float64]
    width: int
    spacing: float
    timed: bool

    @property
    def signals(self) -> Matrix:
        """u, not weighted, shape (m, s)."""
        return np.asarray(self.columns[:, self.terms : self.terms + self.inputs] / self.weight[:, None])


def rows_of(
    data: InSituSet,
    u: Matrix,
    used: NDArray[np.bool_],
    rejected: NDArray[np.bool_],
    drift: int,
    timed: bool,
) -> SetRows:
    """Return a set in rows.

    Args:
        data: The set.
        u: Its signals, shape (n, s).
        used: Which samples take part, shape (n,).
        rejected: Which were left out for disagreeing with all others, shape (n,).
        drift: Cosines that the offset may follow at most.
        timed: Whether the rows' spacing is in s rather than in samples.
    """
    mean = _averages(u, data.raw, used, data.moves)
    basis, ends = _offset_basis(data, mean.place, drift)
    spacing = float(mean.width)
    if timed and data.time is not None and len(data.time) > 1:
        spacing *= float(data.time[-1] - data.time[0]) / (len(data.time) - 1)
    columns = mean.weight[:, None] * np.concatenate([basis, mean.signals, mean.raw], axis=1)
    return SetRows(
        data.name,
        used,
        rejected,
        columns,
        basis.shape[1],
        u.shape[1],
        ends,
        mean.weight,
        mean.place,
        mean.width,
        spacing,
        timed,
    )


def disagreeing(u: Matrix, raw: Matrix, whole: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which samples are off a linear response and an offset that may bend a little, shape (n,)."""
    rejected = np.zeros_like(whole)
    if not whole.any():
        return rejected
    varies = np.ptp(u[whole], axis=0) > 0.0
    span = np.linspace(-1.0, 1.0, len(u))
    u = u[:, varies]
    standard = (u - u[whole].mean(axis=0)) / u[whole].std(axis=0)
    columns = np.column_stack([np.ones(len(u)), span, span**2, standard])[whole]
    if len(columns) > 2 * columns.shape[1]:
        rejected[whole] = _outliers(columns, raw[whole])
    return rejected


class _Averages(NamedTuple):
    """Means over windows of the samples that take part, m of them."""

    signals: Matrix
    raw: Matrix
    weight: NDArray[np.float64]
    """Square roots of the numbers of samples, shape (m,)."""
    place: NDArray[np.float64]
    """Mean place of the samples in the set, shape (m,)."""
    width: int
    """Samples of a window."""


def _averages(signals: Matrix, raw: Matrix, used: NDArray[np.bool_], moves: bool) -> _Averages:
    """Return means over windows, as wide as the signals hardly change; the model is linear and follows."""
    place = np.flatnonzero(used)
    columns = np.concatenate([signals, raw], axis=1)
    columns = columns if len(place) == len(columns) else columns[place]
    inputs = signals.shape[1]
    width = _window(columns[:, :inputs], moves)
    mean = means(columns, width)
    count = np.full(len(mean), width)
    count[-1] = len(place) - width * (len(mean) - 1)
    return _Averages(
        signals=mean[:, :inputs],
        raw=mean[:, inputs:],
        weight=np.sqrt(count),
        place=means(place[:, None].astype(np.float64), width)[:, 0],
        width=width,
    )


def _window(signals: Matrix, moves: bool) -> int:
    """Return the longest window within which the signals hardly change."""
    rows, within = (_ROWS_MOVING, _WITHIN_MOVING) if moves else (_ROWS, _WITHIN)
    width = max(len(signals) // rows, 1)
    total = np.var(signals, axis=0)
    moving = total > 0.0
    while width > 1 and np.max(1.0 - np.var(means(signals, width), axis=0)[moving] / total[moving]) > within:
        width //= 2
    return width


def means(columns: Matrix, width: int) -> Matrix:
    """Return means of windows of rows; the last window takes what is left over."""
    windows = max(len(columns) // width, 1)
    whole = columns[: (windows - 1) * width].reshape(windows - 1, width, columns.shape[1])
    rest = columns[(windows - 1) * width :]
    return np.concatenate([whole.mean(axis=1), rest.mean(axis=0, keepdims=True)])


def _outliers(columns: Matrix, raw: Matrix) -> NDArray[np.bool_]:
    """Return which samples disagree with all others, shape (n,).

    Least squares with Cauchy's weights finds what most samples agree on; what is left is held against its own
    median. A clean set needs one look and no weights. ``columns``, shape (n, c), explain the readings.
    """
    weight = np.ones(len(columns))
    limit = float(chdtri(raw.shape[1], _GATE))
    spread = np.std(raw, axis=0)
    floor = FLOOR * spread + np.finfo(float).tiny
    distance = np.zeros(len(columns))
    for i in range(_ROUNDS):
        root = weight[:, None]
        residual = raw - columns @ np.linalg.solve(columns.T @ (root * columns), columns.T @ (root * raw))
        deviation = np.maximum(MAD_TO_STD * np.median(np.abs(residual), axis=0), floor)
        distance = np.sum((residual / deviation) ** 2, axis=1)
        if i == 0 and not (distance > limit).any():
            break
        before, weight = weight, 1.0 / (1.0 + distance / raw.shape[1])
        if np.max(np.abs(weight - before)) < _SETTLED:
            break
    return np.asarray((distance > limit) & (np.abs(residual) > _SLIGHT * spread).any(axis=1))


def _offset_basis(data: InSituSet, index: NDArray[np.float64], drift: int) -> tuple[Matrix, Matrix]:
    """Return b at places in the set, shape (m, d), and at the middle and the end of it, shape (2, d).

    There are ``drift`` cosines at most, fewer in a short set and none without times.
    """
    share = np.zeros(len(index))
    modes = 0
    if data.time is not None and len(data.time) > 1:
        duration = data.time[-1] - data.time[0]
        modes = min(drift, int(duration / _LEAST_DURATION))
        share = (np.interp(index, np.arange(len(data.time)), data.time) - data.time[0]) / duration
    places = np.concatenate([share, [0.5, 1.0]])
    basis = np.cos(np.pi * places[:, None] * np.arange(modes + 1))
    return basis[:-2], basis[-2:]
