r"""A set of thousands of samples as one small triangle.

The readings of a set follow :math:`r = A T u + \Gamma b(t) + e`: the response A to the wrench T u, an offset
:math:`\Gamma b(t)` that drifts, and noise. The offset is a sum of the slowest cosines over the set's time,
:math:`b_k(t) = \cos(\pi k t / T)`, the likeliest shapes of a random walk; faster ones would be taken for the
limb's turning. One orthogonal triangularisation

.. math::
    Q' [b \; u \; r] =
    \begin{bmatrix} R_{bb} & R_{bu} & R_{br} \\ & R_{uu} & R_{ur} \\ & & R_{rr} \end{bmatrix}

keeps all that least squares can ever ask of the set: :math:`R_{uu} T' A' = R_{ur}` are three rows in place of
thousands (the inertial parameters in T are unknown, but constant), :math:`R_{rr}` is what no A or T explains,
and :math:`R_{bb}, R_{bu}, R_{br}` give the offset afterwards. Nothing is squared, so no digits are lost.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import chdtri

from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.model import signals
from surefoot.calibration.in_situ.options import InSituOptions

__all__ = ["CompressedSet", "compress", "triangle"]

Matrix = NDArray[np.float64]

_GATE = 1e-9
"""Probability that a sample of nothing but noise is left out."""

_FLOOR = 1e-9
"""Deviations below this share of a channel's spread are rounding, not noise."""

_ROUNDS = 12
"""Times that the weights are computed at most ..."""

_SETTLED = 1e-3
"""... until they change by less than this."""

_MAD_TO_STD = 1.4826
"""Standard deviations in a median absolute deviation of normal noise."""

_ROWS = 2000
"""Windows to whose means a set is reduced, if its limb turns slowly enough."""

_WITHIN = 1e-3
"""Share of the signals' spread that may be lost within windows."""

_LEAST_DURATION = 8.0
"""Time in s that a set must last for each cosine of its offset."""


@dataclass(frozen=True, eq=False)
class CompressedSet:
    """A set, compressed.

    Attributes:
        name: The set's.
        used: Which samples take part, shape (n,).
        rejected: Which were left out for disagreeing with all others, shape (n,).
        bb: R_bb, shape (d, d) for d terms of the offset.
        bu: R_bu, shape (d, s) for s signals.
        br: R_br, shape (d, k).
        uu: R_uu, shape (s, s).
        ur: R_ur, shape (s, k).
        rr: R_rr, shape (k, k).
        middle: b at the middle of the set's time, shape (d,).
        end: b at its end, shape (d,).
        score: Signals less what is like b, orthonormal, of the m rows, shape (m, s).
        residual: What of the rows' readings no linear map of the signals explains, (m, k).
        index: Mean place in the set of the samples that made a row, shape (m,).
        width: Samples that made a row.
    """

    name: str
    used: NDArray[np.bool_]
    rejected: NDArray[np.bool_]
    bb: Matrix
    bu: Matrix
    br: Matrix
    uu: Matrix
    ur: Matrix
    rr: Matrix
    middle: NDArray[np.float64]
    end: NDArray[np.float64]
    score: Matrix
    residual: Matrix
    index: NDArray[np.float64]
    width: int

    @property
    def samples(self) -> int:
        """Samples that take part."""
        return int(np.sum(self.used))

    @property
    def rows(self) -> int:
        """Rows, each the weighted mean of some samples."""
        return len(self.residual)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residual in each channel."""
        return max(self.rows - len(self.bb) - int(np.linalg.matrix_rank(self.uu)), 0)

    @property
    def affine_residual(self) -> float:
        """Share of the readings' spread outside the three-space of Lemma 1, by its square root."""
        singular = np.linalg.svd(np.concatenate([self.ur, self.rr]), compute_uv=False)
        return float(np.linalg.norm(singular[3:]) / np.linalg.norm(singular))

    @property
    def response(self) -> Matrix:
        """B = A T of least squares on this set alone, shape (k, s)."""
        return np.asarray(np.linalg.lstsq(self.uu, self.ur, rcond=None)[0].T)

    def leverage(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return R_bb'^-1 b, shape (d,): what an offset at a time takes from the rows; ``at`` is b then."""
        return np.asarray(solve_triangular(self.bb, at, trans=1))

    def lever(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the signals, shape (s,), by which an error of the response moves the offset at a time."""
        return np.asarray(self.bu.T @ self.leverage(at))

    def offset(self, predicted: Matrix, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the offset at a time, shape (k,), by A T, shape (k, s)."""
        return np.asarray(at @ solve_triangular(self.bb, self.br - self.bu @ predicted.T))


def compress(
    sets: Sequence[InSituSet],
    options: InSituOptions,
    moving: bool,
    temperature: bool,
    *,
    lags: Sequence[Matrix] | None = None,
    channel_lags: Sequence[Matrix] | None = None,
    like: Sequence["CompressedSet"] | None = None,
) -> tuple[CompressedSet, ...]:
    """Return sets as triangles, without the samples that are missing or disagree with all others.

    Args:
        sets: The sets.
        options: Whether to leave samples out, and how offsets may drift.
        moving: Whether to use the signals of a moving limb.
        temperature: Whether the temperature is one more signal.
        lags: Signals of the hysteresis of loads, shape (n, 6) each, or none.
        channel_lags: Those of the hysteresis of channels, shape (n, k) each, or none.
        like: The same sets, compressed before: the same samples take part, in the same windows.
    """
    parts = []
    for j, data in enumerate(sets):
        u = signals(data, moving)
        if lags is not None:
            u = np.concatenate([u, lags[j]], axis=1)
        if temperature and data.temperature is not None:
            u = np.concatenate([u, data.temperature[:, None]], axis=1)
        if channel_lags is not None:
            u = np.concatenate([u, channel_lags[j]], axis=1)
        whole = np.asarray(np.isfinite(u).all(axis=1) & np.isfinite(data.raw).all(axis=1))
        width = None if data.time is not None else 1
        if like is not None:
            out, width = like[j].rejected, like[j].width
        else:
            out = _rejected(u, data.raw, whole) if options.robust else np.zeros_like(whole)
        parts.append(_triangularise(data, u, whole & ~out, out, options.drift, width))
    return tuple(parts)


def _triangularise(
    data: InSituSet,
    u: Matrix,
    used: NDArray[np.bool_],
    rejected: NDArray[np.bool_],
    drift: int,
    width: int | None,
) -> CompressedSet:
    mean = _averages(u, data.raw, used, width)
    basis, middle, end = _offset_basis(data, mean.place, drift)
    weighted = mean.weight[:, None] * np.concatenate([basis, mean.signals, mean.raw], axis=1)
    R = triangle(weighted)
    d = basis.shape[1]
    first = d + u.shape[1]
    uu, ur = R[d:first, d:first], R[d:first, first:]
    slope = np.linalg.lstsq(uu, ur, rcond=None)[0]
    centred = weighted[:, d:first] - weighted[:, :d] @ solve_triangular(R[:d, :d], R[:d, d:first])
    residual = weighted[:, first:] - weighted[:, :d] @ solve_triangular(R[:d, :d], R[:d, first:])
    return CompressedSet(
        name=data.name,
        used=used,
        rejected=rejected,
        bb=R[:d, :d],
        bu=R[:d, d:first],
        br=R[:d, first:],
        uu=uu,
        ur=ur,
        rr=R[first:, first:],
        middle=middle,
        end=end,
        score=centred @ np.linalg.pinv(uu),
        residual=residual - centred @ slope,
        index=mean.place,
        width=mean.width,
    )


def _rejected(u: Matrix, raw: Matrix, whole: NDArray[np.bool_]) -> NDArray[np.bool_]:
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


def triangle(columns: Matrix) -> Matrix:
    """Return R of a QR decomposition with as many rows as columns, also of fewer samples."""
    width = columns.shape[1]
    if len(columns) < width:
        columns = np.concatenate([columns, np.zeros((width - len(columns), width))])
    return np.asarray(np.linalg.qr(columns, mode="r"))


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


def _averages(signals: Matrix, raw: Matrix, used: NDArray[np.bool_], width: int | None) -> _Averages:
    """Return means over windows in which the signals hardly change; the model is linear, so they follow it.

    Without a width, windows are as wide as the signals allow.
    """
    place = np.flatnonzero(used)
    columns = np.concatenate([signals, raw], axis=1)
    columns = columns if len(place) == len(columns) else columns[place]
    inputs = signals.shape[1]
    if width is None:
        width = _window(columns[:, :inputs])
    mean = _means(columns, width)
    count = np.full(len(mean), width)
    count[-1] = len(place) - width * (len(mean) - 1)
    return _Averages(
        signals=mean[:, :inputs],
        raw=mean[:, inputs:],
        weight=np.sqrt(count),
        place=_means(place[:, None].astype(np.float64), width)[:, 0],
        width=width,
    )


def _window(signals: Matrix) -> int:
    """Return the longest window within which the signals hardly change."""
    width = max(len(signals) // _ROWS, 1)
    total = np.var(signals, axis=0)
    moving = total > 0.0
    while (
        width > 1 and np.max(1.0 - np.var(_means(signals, width), axis=0)[moving] / total[moving]) > _WITHIN
    ):
        width //= 2
    return width


def _means(columns: Matrix, width: int) -> Matrix:
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
    floor = _FLOOR * np.std(raw, axis=0) + np.finfo(float).tiny
    weight = np.ones(len(columns))
    limit = float(chdtri(raw.shape[1], _GATE))
    distance = np.zeros(len(columns))
    for i in range(_ROUNDS):
        root = weight[:, None]
        residual = raw - columns @ np.linalg.solve(columns.T @ (root * columns), columns.T @ (root * raw))
        deviation = np.maximum(_MAD_TO_STD * np.median(np.abs(residual), axis=0), floor)
        distance = np.sum((residual / deviation) ** 2, axis=1)
        if i == 0 and not (distance > limit).any():
            break
        before, weight = weight, 1.0 / (1.0 + distance / raw.shape[1])
        if np.max(np.abs(weight - before)) < _SETTLED:
            break
    return np.asarray(distance > limit)


def _offset_basis(
    data: InSituSet, index: NDArray[np.float64], drift: int
) -> tuple[Matrix, NDArray[np.float64], NDArray[np.float64]]:
    """Return b at places in the set, shape (m, d), and at the middle and the end of it, (d,) each.

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
    return basis[:-2], basis[-2], basis[-1]
