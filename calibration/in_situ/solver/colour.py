r"""The colour of a sensor's noise: white, or stronger the slower it is, as where an offset walks.

The residuals of a set, in the order of their rows, have by their cosine transform (DCT-II) the power

.. math:: S(f_k) = \sigma^2 \left(N + (f_d / f_k)^2\right), \qquad
    N = 1 + \min(f_k / f_0, 1)^2 (f_c / \max(f_k, f_0))^\alpha, \qquad f_k = k / 2 T,

at its mode k: white noise, a **drift**, by which the offset walks at random, and the rest of the
**hysteresis**, which is hardly slower than the limb's own motion (:math:`f_0`). The parameters are those of
the largest likelihood (Whittle, 1953); a mode that the signals also explain counts for the share that they
do not explain. Each part must be worth its parameters (Schwarz, 1978).

Rows that are weighted by the root of :math:`N / (N + (f_d / f)^2)` are free of drift: a signal that looks
like drift has the weight that such a drift leaves it. The colour N that the rows still have changes the
covariance but not the fit: hysteresis is not independent of the load, and weights against it would only raise
the part of it that is fast. The constant is the offset, which is free.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

_WALK, _LAGS = 2.0, (1.0, 2.0, 3.0)  # exponent of a random walk, and those of hysteresis that are tried
_CORNERS, _KNEES, _ROUNDS = 40, 12, 3
"""... with so many corners and frequencies below which hysteresis grows no more, one part after the other."""

_PARAMETERS = {"drift": 1.0, "hysteresis": 3.0}  # of each part, for Schwarz's penalty
_PER_OCTAVE = 6  # bands an octave in which modes are counted together
_SEEN = 0.1  # share of the widest signal's spread that a signal must have to count
_SLOWER = 0.5  # share of the motion's frequency below which hysteresis falls off
_NONE = 1e-200  # stands for a corner or a power of zero in a logarithm
_LEAST_MODES = 24  # modes below which a set shows no colour
_FREE = 0.05  # share of a mode that the signals must leave for it to show the noise


class Part(NamedTuple):
    """A power of (corner / max(f, knee))^exponent, over that of white noise; a corner of 0 is none.

    Below the knee it falls with the square of the frequency.

    Frequencies are in Hz, or per sample for sets without times.
    """

    corner: float = 0.0
    exponent: float = 2.0
    knee: float = 0.0

    def power(self, frequency: Vector) -> Vector:
        """Return the power at frequencies above zero."""
        return np.asarray(_powers(np.array([self]), frequency)[0])


@dataclass(frozen=True)
class Colour:
    """The power of noise over its white part, 1 + drift + hysteresis."""

    drift: Part = field(default_factory=Part)
    hysteresis: Part = field(default_factory=Part)

    def weights(self, rows: int, spacing: float) -> Vector:
        """Compute weights, (rows,), at most one, that take the drift off the modes 0, 1, ... of a set.

        The constant is the offset, which no drift makes less sure. The spacing is in s, or in samples.
        """
        frequency = _frequencies(rows, spacing)
        beside = 1.0 + self.hysteresis.power(frequency)
        weights = beside / (beside + self.drift.power(frequency))
        weights[0] = 1.0
        return np.asarray(weights)

    def power_after(self, rows: int, spacing: float) -> Vector:
        """Power of the weighted rows, of mean one, shape (rows,)."""
        power = 1.0 + self.hysteresis.power(_frequencies(rows, spacing))
        return np.asarray(power / np.mean(power))

    def weigh(self, columns: Matrix, spacing: float) -> Matrix:
        """Weight the modes of columns against drift, shape (rows, c)."""
        if self.drift.corner == 0.0:
            return columns
        root = np.sqrt(self.weights(len(columns), spacing))
        return np.asarray(idct(root[:, None] * dct(columns, norm="ortho", axis=0), norm="ortho", axis=0))

    def slow(self, rows: int, spacing: float, at: Sequence[float]) -> tuple[Matrix, Vector]:
        """Compute weights that estimate a drift at places, and their variance over a weighted row's.

        Places ``at``, (p,), lie between the first row, 0, and the last, 1; the coefficients are of the
        unweighted rows, (p, rows).
        """
        places = np.asarray(at)
        if self.drift.corner == 0.0:
            return np.zeros((len(places), rows)), np.zeros(len(places))
        share = 1.0 - self.weights(rows, spacing)
        row = places * (rows - 1)
        modes = np.cos(np.pi * (row[:, None] + 0.5) / rows * np.arange(rows)) * np.sqrt(2.0 / rows)
        variance = modes**2 @ (share * self.power_after(rows, spacing))
        return np.asarray(idct(share * modes, norm="ortho", axis=1)), np.asarray(variance)


def motion_frequency(signals: Matrix, spacing: float) -> float:
    """Return the frequency at which the fastest of signals, (m, s), has half its power, in Hz or a sample."""
    power = dct(signals, norm="ortho", axis=0)[1:] ** 2
    total = power.sum(axis=0)
    power = power[:, total > _SEEN**2 * total.max(initial=0.0)]
    if power.size == 0:
        return 0.0
    half = np.argmax(np.cumsum(power, axis=0) >= 0.5 * power.sum(axis=0), axis=0)
    return float(np.max(half) + 1) / (2.0 * len(signals) * spacing)


def _frequencies(rows: int, spacing: float) -> Vector:
    return np.asarray(np.maximum(np.arange(rows), 1) / (2.0 * rows * spacing))


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The residuals of one set by their frequency."""

    frequency: Vector  # of each mode that shows noise in Hz, or per sample, shape (b,)
    left: Vector  # share of it that the signals do not explain, shape (b,)
    modes: Matrix  # the residuals' amplitudes, shape (b, k)

    @classmethod
    def of(cls, residual: Matrix, explained: Matrix, spacing: float) -> "Spectrum":
        """Return the spectrum of residuals, (m, k), beside an orthonormal basis of the explained, (m, c)."""
        rows = len(residual)
        left = 1.0 - np.sum(dct(explained, norm="ortho", axis=0) ** 2, axis=1)
        seen = np.flatnonzero(left > _FREE)
        seen = seen[seen > 0]
        return cls(seen / (2.0 * rows * spacing), left[seen], dct(residual, norm="ortho", axis=0)[seen])


def likeliest_colour(
    spectra: Sequence[Spectrum], motion: float, walks: bool = True, floor: float = 0.0
) -> tuple[Colour, float]:
    """Return the colour that explains residuals best, and its deviance with Schwarz's penalty.

    It is white unless another is worth its parameters. Spectra are of channels none of which follows from the
    others; ``walks`` says whether offsets may walk at random, ``floor`` is the least variance of a channel's
    white noise.
    """
    spectra = [one for one in spectra if len(one.left) >= _LEAST_MODES]
    if not spectra:
        return Colour(), np.nan
    frequency, left, power = _bands(spectra)
    power += floor * left[:, None, None] * np.eye(power.shape[1])
    total, channels = float(np.sum(left)), power.shape[1]
    # The likeliest covariance goes with the channels, so that their units and mixture change nothing.
    overall = np.sum(power, axis=0)
    root = np.linalg.inv(np.linalg.cholesky(overall))
    power = (root @ power @ root.T).reshape(len(power), -1)
    corners = np.geomspace(frequency[0] / 4.0, frequency[-1], _CORNERS)
    slowest = max(_SLOWER * motion, 2.0 * float(frequency[0]))
    knees = np.geomspace(slowest, max(2.0 * slowest, float(frequency[-1])), _KNEES)
    lags = [part for part in product(corners, _LAGS, knees) if part[2] < part[0]]
    tried = {
        "drift": np.array([Part(), *(product(corners, (_WALK,), (0.0,)) if walks else ())]),
        "hysteresis": np.array([Part(), *lags]),
    }
    powers = {name: _powers(grid, frequency) for name, grid in tried.items()}

    def costs(shape: Matrix) -> Vector:
        """Minus twice the log-likelihood, with the likeliest covariance of the channels' white noise."""
        white = ((1.0 / shape) @ power).reshape(-1, channels, channels)
        return np.asarray(total * np.linalg.slogdet(white)[1] + channels * np.log(shape) @ left)

    found = []
    for order in (("drift", "hysteresis"), ("hysteresis", "drift")):
        best, cost = {"drift": 0, "hysteresis": 0}, np.inf
        for _ in range(_ROUNDS):
            for name, other in (order, order[::-1]):
                cost_of = costs(1.0 + powers[name] + powers[other][best[other]])
                worth = _PARAMETERS[name] * np.log(total * channels)
                cost_of[0] -= worth
                best[name] = int(np.argmin(cost_of))
                cost = float(cost_of[best[name]] + (worth if best[name] == 0 else 0.0))
        found.append((cost + _penalty(best, total * channels), best))
    cost, best = min(found, key=lambda one: one[0])
    drift, hysteresis = (Part(*map(float, tried[name][best[name]])) for name in ("drift", "hysteresis"))
    return Colour(drift, hysteresis), cost + total * float(np.linalg.slogdet(overall)[1])


def _powers(grid: Matrix, frequency: Vector) -> Matrix:
    """Return the power of parts, one a row of ``grid``, at frequencies above zero."""
    corner, exponent, knee = (column[:, None] for column in grid.T)
    slow = np.minimum(frequency / np.maximum(knee, _NONE), 1.0) ** 2
    return np.asarray(
        slow * np.exp(exponent * np.log(np.maximum(corner, _NONE) / np.maximum(frequency, knee)))
    )


def _penalty(best: dict[str, int], count: float) -> float:
    return sum(_PARAMETERS[name] * float(np.log(count)) for name, place in best.items() if place > 0)


def _bands(spectra: Sequence[Spectrum]) -> tuple[Vector, Vector, Matrix]:
    """Return mean frequencies of bands, the slowest first, the modes' worth in each, and their covariance.

    The last is summed over modes, shape (bands, k, k).
    """
    frequency = np.concatenate([one.frequency for one in spectra])
    left = np.concatenate([one.left for one in spectra])
    modes = np.concatenate([one.modes for one in spectra])
    band = np.round(_PER_OCTAVE * np.log2(frequency)).astype(int)
    order = np.argsort(band, kind="stable")
    _, first = np.unique(band[order], return_index=True)
    count = np.add.reduceat(left[order], first)
    middle = np.exp(np.add.reduceat((left * np.log(frequency))[order], first) / count)
    power = [one.T @ one for one in np.split(modes[order], first[1:])]
    return middle, count, np.array(power)
