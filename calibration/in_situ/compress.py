r"""A set of thousands of samples as one small triangle.

The readings of a set follow :math:`r = A T u + \Gamma b(t) + e`: the response A to the wrench T u, an
offset :math:`\Gamma b(t)`, and noise, which hangs together in time where the offset walks. Rows are
weighted against that (:mod:`~surefoot.calibration.in_situ.colour`): what a drift could feign counts for as
little as such a drift leaves of it. Where that is asked for, the offset is free to follow the slowest
cosines over the set's time as well, :math:`b_k(t) = \cos(\pi k t / T)`. One orthogonal triangularisation

.. math::
    Q' [b \; u \; r] =
    \begin{bmatrix} R_{bb} & R_{bu} & R_{br} \\ & R_{uu} & R_{ur} \\ & & R_{rr} \end{bmatrix}

keeps all that least squares can ever ask of the set: :math:`R_{uu} T' A' = R_{ur}` are three rows in place of
thousands (the inertial parameters in T are unknown, but constant), :math:`R_{rr}` is what no A or T explains,
and the offset is a weighted sum of rows (:class:`OffsetAt`). Nothing is squared, so no digits are lost.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.linalg import solve_triangular

from surefoot.calibration.in_situ.colour import Colour, Spectrum, likeliest_colour, motion_frequency
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.model import DIRECT, signals
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.calibration.in_situ.rows import FLOOR, SetRows, disagreeing, means, rows_of

__all__ = ["UNUSED", "CompressedSet", "compress", "triangle", "with_signals"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

UNUSED = 1e-9
"""Share of the largest variance of a set's rows below which a signal never varied."""

_RANK = 1e-12
"""Singular values at or below this share of the largest, for columns of unit length, are rounding."""


class OffsetAt(NamedTuple):
    """The offset at one time: readings less the response to signals, weighed over rows.

    Attributes:
        weights: Of the rows before they were weighted against drift, shape (m,).
        signals: So weighed, shape (s,): by them an error of the response moves the offset.
        raw: So weighed, shape (k,).
        variance: Of the offset by noise, over that of the white noise of a sample.
    """

    weights: NDArray[np.float64]
    signals: NDArray[np.float64]
    raw: NDArray[np.float64]
    variance: float

    def by(self, predicted: Matrix) -> NDArray[np.float64]:
        """Return the offset, shape (k,), by A T, shape (k, s)."""
        return np.asarray(self.raw - predicted @ self.signals)


@dataclass(frozen=True, eq=False)
class CompressedSet:
    """A set, compressed.

    Attributes:
        name: The set's.
        used: Which samples take part, shape (n,).
        rejected: Which were left out for disagreeing with all others, shape (n,).
        uu: R_uu, shape (s, s) for s signals.
        ur: R_ur, shape (s, k).
        rr: R_rr, shape (k, k).
        middle: The offset at the middle of the set's time.
        end: The offset at its end.
        mean: Of the signals, shape (s,).
        spread: Sum of the squares of the readings about their mean in counts^2.
        gram: Covariance of a channel's rows of :attr:`ur` over the variance of a row's noise, shape (s, s).
        score: Signals less what is like b, orthonormal, of the m rows, shape (m, s).
        scatter: Squares of the residual, over the power that its modes have, shape (k, k).
        residual: What of the rows' readings no linear map of the signals explains, (m, k).
        index: Mean place in the set of the samples that made a row, shape (m,).
        width: Samples that made a row.
        colour: Of the noise that the rows are weighted by.
        source: The rows before they were weighted against drift.
    """

    name: str
    used: NDArray[np.bool_]
    rejected: NDArray[np.bool_]
    uu: Matrix
    ur: Matrix
    rr: Matrix
    middle: OffsetAt
    end: OffsetAt
    mean: NDArray[np.float64]
    spread: float
    gram: Matrix
    score: Matrix
    scatter: Matrix
    residual: Matrix
    index: NDArray[np.float64]
    width: int
    colour: Colour
    source: SetRows

    @cached_property
    def whiten(self) -> Matrix:
        """What makes rows of :attr:`ur` ones of the variance of a row's noise, shape (s, s)."""
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
        return np.where(values > UNUSED * np.max(values, initial=0.0), values, 0.0), vectors

    @property
    def spacing(self) -> float:
        """Time between rows in s, or samples where there are no times."""
        return self.source.spacing

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
        return max(self.rows - self.source.terms - int(np.linalg.matrix_rank(self.uu)), 0)

    @property
    def log_colour(self) -> float:
        """The sum of the logarithms of the power of the rows' noise, before they were weighted."""
        left, weights = (of(self.rows, self.spacing) for of in (self.colour.left, self.colour.weights))
        return float(np.sum(np.log(left) - np.log(weights)))

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
        return means(columns[self.used], self.width)

    def level(self, columns: Matrix) -> float:
        """Return the mean variance of noise along orthonormal columns, shape (m, c), over that of a row."""
        power = self.colour.left(self.rows, self.spacing)
        return float(np.mean(power @ dct(columns, norm="ortho", axis=0) ** 2))


def compress(
    sets: Sequence[InSituSet], options: InSituOptions, moving: bool, temperature: bool
) -> tuple[CompressedSet, ...]:
    """Return sets as triangles, without the samples that are missing or disagree with all others.

    Args:
        sets: The sets.
        options: Whether to leave samples out, and how offsets may drift.
        moving: Whether to use the signals of a moving limb.
        temperature: Whether the temperature is one more signal.
    """
    timed = all(data.time is not None for data in sets)
    rows = []
    for data in sets:
        u = signals(data, moving)
        if temperature and data.temperature is not None:
            u = np.concatenate([u, data.temperature[:, None]], axis=1)
        whole = np.asarray(np.isfinite(u).all(axis=1) & np.isfinite(data.raw).all(axis=1))
        out = disagreeing(u, data.raw, whole) if options.robust else np.zeros_like(whole)
        rows.append(rows_of(data, u, whole & ~out, out, options.drift or 0, timed))
    return _compressed(rows, options)


def with_signals(
    parts: Sequence[CompressedSet],
    columns: Sequence[Matrix],
    options: InSituOptions,
    *,
    first: int | None = None,
) -> tuple[CompressedSet, ...]:
    """Return compressed sets with more signals; the same samples take part, in the same windows.

    Args:
        parts: The sets.
        columns: At their rows, shape (m, q) each.
        options: How offsets may drift.
        first: Number of the signals before which they stand; behind all by default.
    """
    rows = []
    for part, more in zip(parts, columns, strict=True):
        source = part.source
        place = source.terms + (source.inputs if first is None else first)
        wide = np.insert(source.columns, [place], source.weight[:, None] * more, axis=1)
        rows.append(source._replace(columns=wide, inputs=source.inputs + more.shape[1]))
    return _compressed(rows, options)


def _compressed(rows: Sequence[SetRows], options: InSituOptions) -> tuple[CompressedSet, ...]:
    colour = _colour(rows, walks=options.drift is None)
    return tuple(_triangularise(one, colour) for one in rows)


def _colour(rows: Sequence[SetRows], walks: bool) -> Colour:
    """Return the colour of residuals of a linear map of the signals; ``walks``: whether offsets may walk."""
    found, spread = [], 0.0
    for one in rows:
        first = one.terms + one.inputs
        explaining, readings = one.columns[:, :first], one.columns[:, first:]
        left, singular, _ = np.linalg.svd(_scaled(explaining), full_matrices=False)
        basis = left[:, singular > _RANK * singular[0]]
        residual = readings - basis @ (basis.T @ readings)
        found.append((residual, basis, one.spacing))
        spread += float(np.sum((readings - readings.mean(axis=0)) ** 2))
    scatter = sum(residual.T @ residual for residual, _, _ in found)
    size, turn = np.linalg.eigh(scatter)
    independent = turn[:, size > FLOOR**2 * spread]
    if independent.shape[1] == 0:
        return Colour()
    motions = [motion_frequency(one.columns[:, one.terms :][:, DIRECT], one.spacing) for one in rows]
    return likeliest_colour(
        [Spectrum.of(residual @ independent, basis, spacing) for residual, basis, spacing in found],
        float(np.median(motions)),
        walks,
    )


def _scaled(columns: Matrix) -> Matrix:
    size = np.linalg.norm(columns, axis=0)
    return np.asarray(columns / np.where(size > 0.0, size, 1.0))


def _triangularise(rows: SetRows, colour: Colour) -> CompressedSet:
    d, first = rows.terms, rows.terms + rows.inputs
    white = colour.weigh(rows.columns, rows.spacing)
    R = triangle(white)
    uu, ur = R[d:first, d:first], R[d:first, first:]
    slope = np.linalg.lstsq(uu, ur, rcond=None)[0]
    centred = white[:, d:first] - white[:, :d] @ solve_triangular(R[:d, :d], R[:d, d:first])
    residual = white[:, first:] - white[:, :d] @ solve_triangular(R[:d, :d], R[:d, first:])
    square = np.sum(rows.weight**2)
    mean = rows.weight @ rows.columns / square
    readings = rows.columns[:, first:] - rows.weight[:, None] * mean[first:]
    middle, end = _offsets(rows, colour, white[:, :d], R[:d, :d])
    score = centred @ np.linalg.pinv(uu)
    residual = residual - centred @ slope
    power = colour.left(len(white), rows.spacing)
    modes = dct(residual, norm="ortho", axis=0) / np.sqrt(power)[:, None]
    of_signals = dct(score, norm="ortho", axis=0)
    scatter = modes.T @ modes
    # Noise that depends on the load is nowhere less than on average.
    modes = np.sqrt(np.maximum(power, 1.0))[:, None] * of_signals
    return CompressedSet(
        name=rows.name,
        used=rows.used,
        rejected=rows.rejected,
        uu=uu,
        ur=ur,
        rr=R[first:, first:],
        middle=middle,
        end=end,
        mean=mean[d:first],
        spread=float(np.sum(readings**2)),
        gram=modes.T @ modes,
        score=score,
        scatter=scatter,
        residual=residual,
        index=rows.place,
        width=rows.width,
        colour=colour,
        source=rows,
    )


def _offsets(rows: SetRows, colour: Colour, white: Matrix, bb: Matrix) -> tuple[OffsetAt, OffsetAt]:
    """Return the offset at the middle and at the end; ``white`` is b of the weighted rows, shape (m, d)."""
    d, first = rows.terms, rows.terms + rows.inputs
    drifts, variances = colour.slow(len(rows.columns), rows.spacing, (0.5, 1.0))
    # The noise of a row is that of a sample; what drifts is larger there by the root of the samples of a row.
    per_row = float(np.sqrt(np.mean(rows.weight**2)))
    found = []
    for drift, variance, basis in zip(drifts / per_row, variances / per_row**2, rows.ends, strict=True):
        taken = solve_triangular(bb, basis - drift @ rows.columns[:, :d], trans=1)
        steady = white @ solve_triangular(bb, taken)
        weights = drift + colour.weigh(steady[:, None], rows.spacing)[:, 0]
        seen = weights @ rows.columns
        found.append(OffsetAt(weights, seen[d:first], seen[first:], float(taken @ taken + variance)))
    return found[0], found[1]


def triangle(columns: Matrix) -> Matrix:
    """Return R of a QR decomposition with as many rows as columns, also of fewer samples."""
    width = columns.shape[1]
    if len(columns) < width:
        columns = np.concatenate([columns, np.zeros((width - len(columns), width))])
    return np.asarray(np.linalg.qr(columns, mode="r"))
