r"""A set of thousands of samples as one small triangle.

A set becomes rows: means over windows in which the limb hardly turns, of the samples that take part; those
that are missing, or that disagree with all others, do not. Its readings follow :math:`r = A T u + o + e`: the
response A to the wrench T u, an offset, and noise, which hangs together in time where the offset walks. Rows
are weighted against that (:mod:`~surefoot.calibration.in_situ.solver.colour`): a signal that looks like drift
counts for as little as such a drift leaves of it. One orthogonal triangularisation

.. math::
    Q' [1 \; u \; r] =
    \begin{bmatrix} R_{11} & R_{1u} & R_{1r} \\ & R_{uu} & R_{ur} \\ & & R_{rr} \end{bmatrix}

keeps all that least squares can ever ask of the set: :math:`R_{uu} T' A' = R_{ur}` are three rows in place of
thousands (the inertial parameters in T are unknown, but constant), :math:`R_{rr}` is the part that no A or T
explains, and the offset is a weighted sum of rows (:class:`OffsetAt`). Nothing is squared, so no digits are
lost.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.special import chdtri, fdtri

from surefoot.calibration.arrays import MAD_TO_STD, orthonormal, triangle
from surefoot.calibration.in_situ.data import InSituOptions, InSituSet, Matrix, Vector
from surefoot.calibration.in_situ.model import DIRECT, SPREAD_ROUNDING, signals
from surefoot.calibration.in_situ.solver.colour import Colour, Spectrum, likeliest_colour, motion_frequency

_GATE = 1e-9  # probability that a sample of nothing but noise is left out

_MEDIAN = 0.37  # efficiency of the median deviation: the share of the rows that it is worth

_SLIGHT = 0.05
"""Share of a channel's spread by which a sample must be off to be left out: 1 % of hysteresis leaves up to
0.04 at the turns of a limb that takes postures, and is seen by these."""

_ROUNDS = 12  # times that the weights are computed at most

_SETTLED = 1e-3  # change of the weights below which they have settled
_LOOKED = 10_000  # samples of a set, or up to twice as many, that say what most agree on

_ROWS, _ROWS_MOVING = 1000, 200  # windows to whose means a set is reduced, if its limb turns slowly enough
_WITHIN, _WITHIN_MOVING = 1e-3, 0.1
"""... so that this share of the signals' spread is lost within them. A gyroscope's noise grows with the
frequency as it is differentiated, and noise makes signals look larger than they are: frequencies above
those of the motion are left out."""


class SetRows(NamedTuple):
    """A set in rows of nearly equal weight, in the order of time."""

    name: str  # the set's
    used: NDArray[np.bool_]  # which samples take part, shape (n,)
    rejected: NDArray[np.bool_]  # which were left out for disagreeing with all others, shape (n,)
    columns: Matrix  # (1, u, r), weighted, shape (m, 1 + s + k)
    inputs: int  # s
    weight: Vector  # square roots of the numbers of samples, shape (m,)
    places: Vector  # mean places of the samples in the set, shape (m,)
    width: int  # samples of a window
    spacing: float  # between rows in s, or in samples where some set has no times
    walks: bool  # whether the offset may walk at random

    @property
    def signals(self) -> Matrix:
        """u, not weighted, shape (m, s)."""
        return np.asarray(self.columns[:, 1 : 1 + self.inputs] / self.weight[:, None])

    def with_signals(self, u: Matrix) -> "SetRows":
        """Return the rows with other signals, shape (m, s)."""
        first = 1 + self.inputs
        parts = (self.columns[:, :1], self.weight[:, None] * u, self.columns[:, first:])
        return self._replace(columns=np.concatenate(parts, axis=1), inputs=u.shape[1])


def _rows_of(data: InSituSet, u: Matrix, robust: bool, walks: bool, timed: bool) -> SetRows:
    """Return a set in rows: means over windows, as wide as the signals u, shape (n, s), hardly change."""
    whole = np.asarray(np.isfinite(u).all(axis=1) & np.isfinite(data.raw).all(axis=1))
    rejected = _reject(u, data.raw, whole) if robust else np.zeros_like(whole)
    used = whole & ~rejected
    place = np.flatnonzero(used)
    columns = np.concatenate([u, data.raw], axis=1)
    columns = columns if len(place) == len(columns) else columns[place]
    width = _window(columns[:, : u.shape[1]], data.moves)
    mean = means(columns, width)
    count = np.full(len(mean), width)
    count[-1] = len(place) - width * (len(mean) - 1)
    weight = np.sqrt(count)
    spacing = float(width)
    if timed and data.time is not None and len(data.time) > 1:
        spacing *= float(data.time[-1] - data.time[0]) / (len(data.time) - 1)
    columns = weight[:, None] * np.concatenate([np.ones((len(mean), 1)), mean], axis=1)
    places = means(place[:, None].astype(np.float64), width)[:, 0]
    return SetRows(data.name, used, rejected, columns, u.shape[1], weight, places, width, spacing, walks)


def _reject(u: Matrix, raw: Matrix, whole: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which samples are off a linear response and an offset that may bend a little, shape (n,)."""
    rejected = np.zeros_like(whole)
    if not whole.any():
        return rejected
    varies = np.ptp(u[whole], axis=0) > 0.0
    span = np.linspace(-1.0, 1.0, len(u))
    u = u[:, varies]
    standard = (u - u[whole].mean(axis=0)) / u[whole].std(axis=0)
    # Gravity that turns along a line or in a plane leaves columns that depend on each other.
    columns, _ = orthonormal(
        np.column_stack([np.ones(len(u)), span, span**2, standard])[whole], SPREAD_ROUNDING
    )
    if len(columns) > 2 * columns.shape[1]:
        rejected[whole] = _outliers(columns, raw[whole])
    return rejected


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
    """Return means of windows of rows; the last window takes the rest."""
    windows = max(len(columns) // width, 1)
    whole = columns[: (windows - 1) * width].reshape(windows - 1, width, columns.shape[1])
    rest = columns[(windows - 1) * width :]
    return np.concatenate([whole.mean(axis=1), rest.mean(axis=0, keepdims=True)])


def _outliers(columns: Matrix, raw: Matrix) -> NDArray[np.bool_]:
    """Return which samples disagree with all others, shape (n,).

    Least squares with Cauchy's weights finds the map that most samples agree on; residuals are compared with
    their own median. A clean set needs one look and no weights. ``columns``, shape (n, c), explain the
    readings.
    """
    stride = max(len(raw) // _LOOKED, 1)
    some, readings = columns[::stride], raw[::stride]
    # The spread comes from the same rows, so that the distances follow an F distribution.
    free = max(_MEDIAN * (len(some) - some.shape[1]), 1.0)
    limit = raw.shape[1] * float(fdtri(raw.shape[1], free, 1.0 - _GATE))
    rounding = np.array([_converter_step(channel) for channel in raw.T]) / np.sqrt(12.0)
    weight = np.ones(len(some))
    spread = np.std(readings, axis=0)
    floor = SPREAD_ROUNDING * spread + np.finfo(float).tiny
    for i in range(_ROUNDS):
        weighted = weight[:, None] * some
        map_ = np.linalg.solve(weighted.T @ some, weighted.T @ readings)
        left = readings - some @ map_
        deviation = np.maximum(np.hypot(MAD_TO_STD * np.median(np.abs(left), axis=0), rounding), floor)
        distance = np.sum((left / deviation) ** 2, axis=1)
        if i == 0 and not (distance > float(chdtri(raw.shape[1], _GATE))).any():
            break
        before, weight = weight, 1.0 / (1.0 + distance / raw.shape[1])
        if np.max(np.abs(weight - before)) < _SETTLED:
            break
    residual = left if stride == 1 else raw - columns @ map_
    distance = np.sum((residual / deviation) ** 2, axis=1)
    return np.asarray((distance > limit) & (np.abs(residual) > _SLIGHT * spread).any(axis=1))


def _converter_step(counts: Vector) -> float:
    """Return the smallest difference between two values of a channel: one count of its converter, or less."""
    values = np.unique(counts)
    return float(np.min(np.diff(values))) if len(values) > 1 else 0.0


class OffsetAt(NamedTuple):
    """The offset at one time: readings less the response to signals, weighed over rows."""

    weights: Vector  # of the rows before they were weighted against drift, shape (m,)
    signals: Vector  # so weighed, shape (s,): by them an error of the response moves the offset
    raw: Vector  # so weighed, shape (k,)
    variance: float  # of the offset by noise, over that of the white noise of a sample

    def by(self, predicted: Matrix) -> Vector:
        """Return the offset, shape (k,), by A T, shape (k, s)."""
        return np.asarray(self.raw - predicted @ self.signals)


@dataclass(frozen=True, eq=False)
class CompressedSet:
    """A set, compressed."""

    source: SetRows  # the rows before they were weighted against drift
    colour: Colour  # of the noise that the rows are weighted by
    uu: Matrix  # R_uu, shape (s, s) for s signals
    ur: Matrix  # R_ur, shape (s, k)
    rr: Matrix  # R_rr, shape (k, k)
    middle: OffsetAt  # the offset at the middle of the set's time
    end: OffsetAt  # the offset at its end
    mean: Vector  # of the signals, shape (s,)
    spread: float
    """Sum of the squares of the readings about their mean in counts^2, for as many samples, of the set in
    which they spread most."""
    gram: Matrix
    """Covariance of a channel's rows of :attr:`ur` over the variance of a row's noise, shape (s, s)."""
    score: Matrix  # signals less their mean, orthonormal, of the m rows, shape (m, s)
    residual: Matrix  # part of the rows' readings that no linear map of the signals explains, (m, k)

    @cached_property
    def whiten(self) -> Matrix:
        """Matrix that gives the rows of :attr:`ur` the variance of a row's noise, shape (s, s)."""
        values, vectors = self._gram
        return np.asarray((vectors / np.where(values > 0.0, np.sqrt(values), np.inf)) @ vectors.T)

    @cached_property
    def unwhiten(self) -> Matrix:
        """The inverse of :attr:`whiten` where signals varied, shape (s, s)."""
        values, vectors = self._gram
        return np.asarray((vectors * np.sqrt(values)) @ vectors.T)

    @property
    def _gram(self) -> tuple[Vector, Matrix]:
        values, vectors = np.linalg.eigh(self.gram)
        return np.where(values > SPREAD_ROUNDING * np.max(values, initial=0.0), values, 0.0), vectors

    @property
    def samples(self) -> int:
        """Samples that take part."""
        return int(np.sum(self.source.used))

    @property
    def power(self) -> Vector:
        """Power of the weighted rows' noise in the modes of their cosine transform, of mean one, (m,)."""
        return self.colour.power_after(self.rows, self.source.spacing)

    def weigh(self, columns: Matrix) -> Matrix:
        """Weight columns at the rows against drift, shape (m, c)."""
        return self.colour.weigh(columns, self.source.spacing)

    def centre(self, columns: Matrix) -> Matrix:
        """Weight columns at the rows as the rows are, less their means, shape (m, c)."""
        weight = self.source.weight[:, None]
        white = self.weigh(np.hstack([weight, weight * columns]))
        mean, rest = white[:, :1], white[:, 1:]
        return np.asarray(rest - mean @ (mean.T @ rest) / np.sum(mean**2))

    @property
    def rows(self) -> int:
        """Rows, each the weighted mean of some samples."""
        return len(self.residual)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residual in each channel."""
        return max(self.rows - 1 - int(np.linalg.matrix_rank(self.uu)), 0)

    @property
    def affine_residual(self) -> float:
        """Share of the readings' spread outside the three-space of Lemma 1, by its square root."""
        singular = np.linalg.svd(np.concatenate([self.ur, self.rr]), compute_uv=False)
        return float(np.linalg.norm(singular[3:]) / np.linalg.norm(singular))

    @property
    def response(self) -> Matrix:
        """B = A T of least squares on this set alone, shape (k, s)."""
        return np.asarray(np.linalg.lstsq(self.uu, self.ur, rcond=None)[0].T)

    @property
    def turned(self) -> Matrix:
        """A root of the squares of gravity, summed over rows, beside all other signals, shape (3, 3)."""
        order = np.roll(np.arange(len(self.uu)), -DIRECT.stop)
        return triangle(self.uu[:, order])[-DIRECT.stop :, -DIRECT.stop :]

    def at_rows(self, columns: Matrix) -> Matrix:
        """Return the means over rows, shape (m, q), of columns of the set, shape (n, q)."""
        return means(columns[self.source.used], self.source.width)

    def level(self, columns: Matrix) -> float:
        """Return the mean variance of noise along orthonormal columns, shape (m, c), over that of a row."""
        return float(np.mean(self.power @ dct(columns, norm="ortho", axis=0) ** 2))


def compress(
    sets: Sequence[InSituSet], options: InSituOptions, moving: bool, temperature: bool
) -> tuple[CompressedSet, ...]:
    """Return sets as triangles, without the samples that are missing or disagree with all others.

    With the signals of a limb that is ``moving``, and with the ``temperature`` as one more signal.
    """
    timed = all(data.time is not None for data in sets)
    rows = []
    for data in sets:
        u = signals(data, moving)
        if temperature and data.temperature is not None:
            u = np.concatenate([u, data.temperature[:, None]], axis=1)
        # Without times the order of the samples has no meaning, and no drift shows.
        rows.append(_rows_of(data, u, options.robust, options.drift and timed, timed))
    return _compress_rows(rows)


def add_signals(
    parts: Sequence[CompressedSet], columns: Sequence[Matrix], place: int | None = None
) -> tuple[CompressedSet, ...]:
    """Return compressed sets with more signals, at their rows, shape (m, q) each.

    They stand behind the first ``place`` signals, or behind all.
    """
    wide = []
    for part, more in zip(parts, columns, strict=True):
        u = part.source.signals
        wide.append(np.insert(u, [u.shape[1] if place is None else place], more, axis=1))
    return change_signals(parts, wide)


def change_signals(parts: Sequence[CompressedSet], signals: Sequence[Matrix]) -> tuple[CompressedSet, ...]:
    """Return compressed sets with other signals, (m, s) each, of the same samples in the same windows."""
    return _compress_rows([part.source.with_signals(u) for part, u in zip(parts, signals, strict=True)])


def _compress_rows(rows: Sequence[SetRows]) -> tuple[CompressedSet, ...]:
    colour = _colour(rows)
    parts = [_triangularise(one, colour) for one in rows]
    widest = max(part.spread / max(part.samples, 1) for part in parts)
    return tuple(replace(part, spread=widest * part.samples) for part in parts)


def _colour(rows: Sequence[SetRows]) -> Colour:
    """Return the colour of residuals of a linear map of the signals."""
    found, spread = [], 0.0
    for one in rows:
        first = 1 + one.inputs
        explaining, readings = one.columns[:, :first], one.columns[:, first:]
        basis, _ = orthonormal(explaining)
        residual = readings - basis @ (basis.T @ readings)
        found.append((residual, basis, one.spacing))
        spread += float(np.sum((readings - readings.mean(axis=0)) ** 2))
    scatter = sum(residual.T @ residual for residual, _, _ in found)
    size, turn = np.linalg.eigh(scatter)
    independent = turn[:, size > SPREAD_ROUNDING**2 * spread]
    if independent.shape[1] == 0:
        return Colour()
    spectra = [Spectrum.of(residual @ independent, basis, spacing) for residual, basis, spacing in found]
    return likeliest_colour(spectra, motion_of(rows), rows[0].walks)[0]


def motion_of(rows: Sequence[SetRows]) -> float:
    """Return the frequency of the limb's motion in sets."""
    motions = [motion_frequency(one.columns[:, 1:][:, DIRECT], one.spacing) for one in rows]
    return float(np.median(motions))


def _triangularise(rows: SetRows, colour: Colour) -> CompressedSet:
    first = 1 + rows.inputs
    white = colour.weigh(rows.columns, rows.spacing)
    R = triangle(white)
    uu, ur = R[1:first, 1:first], R[1:first, first:]
    centred = white[:, 1:] - white[:, :1] * (R[0, 1:] / R[0, 0])
    mean = rows.weight @ rows.columns / np.sum(rows.weight**2)
    readings = rows.columns[:, first:] - rows.weight[:, None] * mean[first:]
    middle, end = _offsets(rows, colour, white[:, 0] / R[0, 0] ** 2)
    score = centred[:, : rows.inputs] @ np.linalg.pinv(uu)
    slope = np.linalg.lstsq(uu, ur, rcond=None)[0]
    residual = centred[:, rows.inputs :] - centred[:, : rows.inputs] @ slope
    power = colour.power_after(len(white), rows.spacing)
    # Noise that depends on the load is nowhere less than on average.
    modes = np.sqrt(np.maximum(power, 1.0))[:, None] * dct(score, norm="ortho", axis=0)
    return CompressedSet(
        source=rows,
        colour=colour,
        uu=uu,
        ur=ur,
        rr=R[first:, first:],
        middle=middle,
        end=end,
        mean=mean[1:first],
        spread=float(np.sum(readings**2)),
        gram=modes.T @ modes,
        score=score,
        residual=residual,
    )


def _offsets(rows: SetRows, colour: Colour, mean: Vector) -> list[OffsetAt]:
    """Return the offset at the middle and at the end; by ``mean`` of weighted rows it is one, shape (m,)."""
    first = 1 + rows.inputs
    drifts, variances = colour.slow(len(rows.columns), rows.spacing, (0.5, 1.0))
    # The noise of a row is that of a sample; drift is larger there by the root of the samples of a row.
    per_row = float(np.sqrt(np.mean(rows.weight**2)))
    steady = colour.weigh(mean[:, None], rows.spacing)[:, 0]
    own = float(mean @ mean)
    found = []
    for drift, variance in zip(drifts / per_row, variances / per_row**2, strict=True):
        left = 1.0 - float(drift @ rows.columns[:, 0])
        weights = drift + left * steady
        seen = weights @ rows.columns
        found.append(OffsetAt(weights, seen[1:first], seen[first:], left**2 * own + float(variance)))
    return found
