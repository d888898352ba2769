r"""The covariance of an in-situ calibration, and of its noise.

The curvature of the fit, :math:`(J' J)^{-1}` in whitened readings, is the covariance if the noise is white.
Hysteresis, drift and a limb that is not quite rigid are not, so it is raised by the largest of three ratios:
one; how much more the scores of long stretches scatter than white noise would let them; and how much more the
sets disagree with each other than their samples' noise lets them (Birge, 1932). A sensor with hysteresis has
no one slope; what that leaves open of its matrix comes on top.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from surefoot.calibration.arrays import skew
from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.fit import FitColumns
from surefoot.calibration.in_situ.model import AXES, DIRECT, STATIC
from surefoot.calibration.in_situ.solve import (
    ROUNDING,
    Problem,
    Solution,
    loop_shares,
    of_unit_length,
    transforms,
)

__all__ = [
    "fit_covariance",
    "inflation",
    "persistence",
    "pooled_noise",
    "weighted_inverse",
    "whitening",
    "with_rows",
]

Matrix = NDArray[np.float64]

_CHANCE = 0.01
"""Probability by white noise alone from which on a ratio means nothing."""

_STRETCHES = (10, 30, 100)
"""Into how many stretches a set is cut to see how its noise hangs together ..."""

_ROWS_EACH = 10
"""... if that leaves so many rows in each."""

_IN_USE = 0.5
"""Length below which a column of the orthonormal signals is one that never varied."""

_NOISE_FLOOR = 1e-10
"""Noise counts as at least this share of a channel's spread: a simulation may have none."""


def pooled_noise(sets: Sequence[CompressedSet]) -> Matrix:
    """Return the covariance of a sample's noise, shape (k, k); few samples bring it near to diagonal."""
    scatter = np.sum([part.rr.T @ part.rr for part in sets], axis=0)
    freedom = max(sum(part.freedom for part in sets), 1)
    S = scatter / freedom
    share = len(S) / (freedom + len(S))
    spread = np.sum([part.ur.T @ part.ur for part in sets], axis=0) / sum(part.samples for part in sets)
    diagonal = np.diag(np.diag(S))
    return np.asarray((1.0 - share) * S + share * diagonal + _NOISE_FLOOR**2 * np.diag(np.diag(spread)))


def whitening(sets: Sequence[CompressedSet]) -> Matrix:
    """Return W of the pooled noise, shape (k, k): W Sigma W' = 1."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(pooled_noise(sets))))


def inflation(problem: Problem, solution: Solution, freedom: int) -> float:
    """Return the factor on the covariance; a ratio that chance explains counts as one.

    ``freedom`` is the number of rows of the sets less that of unknowns.
    """
    sets = float(np.sum(solution.residual**2)) / max(freedom, 1)
    between = sets if _beyond_chance(sets, freedom) else 1.0
    return max(between, persistence(problem.sets, problem.whitening))


def persistence(sets: Sequence[CompressedSet], whitening: Matrix) -> float:
    """Return how many times more than white noise the noise weighs; 1 if chance explains it."""
    ratios = [_between_stretches(sets, whitening, stretches) for stretches in _STRETCHES]
    return max([1.0, *(ratio for ratio, terms in ratios if _beyond_chance(ratio, terms))])


def _beyond_chance(ratio: float, terms: int) -> bool:
    return terms > 0 and ratio * terms > chdtri(terms, _CHANCE)


def _between_stretches(sets: Sequence[CompressedSet], whitening: Matrix, stretches: int) -> tuple[float, int]:
    """Return the scatter of the scores of stretches over that of white noise, and its degrees of freedom."""
    scatter, expected, terms = 0.0, 0.0, 0
    for part in sets:
        if part.rows < _ROWS_EACH * stretches:
            continue
        score = part.score[:, np.linalg.norm(part.score, axis=0) > _IN_USE]
        white = part.residual @ whitening.T
        edges = np.linspace(0, part.rows, stretches + 1).astype(int)
        for first, last in pairwise(edges):
            piece = score[first:last]
            scatter += float(np.sum((piece.T @ white[first:last]) ** 2))
            # A stretch of white noise has its share of the signals, less what the fit has taken away.
            share = piece.T @ piece
            expected += float(np.trace(share) - np.sum(share**2)) * white.shape[1]
        terms += score.shape[1] * white.shape[1] * (stretches - 1)
    return (scatter / expected, terms) if terms else (1.0, 0)


def weighted_inverse(response: Matrix, noise: Matrix) -> Matrix:
    """Return C of least variance, (A' S^-1 A)^-1 A' S^-1, shape (6, k): C A = 1."""
    weighted = np.linalg.solve(noise, response)
    return np.asarray(np.linalg.solve(response.T @ weighted, weighted.T))


def fit_covariance(problem: Problem, solution: Solution, noise: Matrix, factor: float) -> Matrix:
    """Return the covariance of (C row by row, the last set's offset at its end, m, m c), (7 k + 4, 7 k + 4).

    Args:
        problem: The problem.
        solution: Its solution.
        noise: Covariance of a sample, shape (k, k).
        factor: The inflation.
    """
    channels, inputs = solution.response.shape
    columns = FitColumns.of(channels)
    unit, size = of_unit_length(solution.jacobian)
    _, singular, right = np.linalg.svd(unit, full_matrices=False)
    root = right.T / np.maximum(singular, ROUNDING * singular[0]) / size[:, None]
    linear = channels * inputs
    # From W A to A, row by row.
    unwhiten = np.kron(np.linalg.inv(problem.whitening), np.eye(inputs))
    root[:linear] = unwhiten @ root[:linear]
    to_output = _derivatives(problem, solution, noise)
    root = to_output @ root
    covariance = root @ root.T
    last = problem.sets[-1]
    leverage = last.leverage(last.end)
    covariance[columns.offset, columns.offset] += noise * (leverage @ leverage)
    covariance = factor * covariance
    if problem.hysteresis or problem.channel_lags:
        of_matrix, of_offset = _slope_doubt(problem, solution, noise)
        covariance[columns.matrix, columns.matrix] += of_matrix
        covariance[columns.offset, columns.offset] += of_offset
    return np.asarray(covariance)


def with_rows(covariance: Matrix, rows: Matrix) -> Matrix:
    """Return a fit's covariance with others of the matrix's rows, shape (6, k, k), in their place."""
    changed, columns = covariance.copy(), FitColumns.of(rows.shape[1])
    for axis, row in enumerate(rows):
        place = columns.row(axis)
        changed[place] = changed[:, place] = 0.0
        changed[place, place] = row
    return changed


def _slope_doubt(problem: Problem, solution: Solution, noise: Matrix) -> tuple[Matrix, Matrix]:
    """Return covariances of C and o for want of one slope: an axis gives by s more for twice the swing."""
    A = solution.A
    C = weighted_inverse(A, noise)
    channels = len(A)
    last = problem.sets[-1]
    lever = last.lever(last.end)
    load = (transforms(problem, solution)[-1] @ lever)[:AXES]
    shares = loop_shares(problem, solution)
    if problem.hysteresis:
        changes = [share * np.outer(A[:, a], np.eye(AXES)[a]) for a, share in enumerate(shares)]
    else:
        changes = [share * np.outer(np.eye(channels)[c], A[c]) for c, share in enumerate(shares)]
    of_matrix, of_offset = np.zeros((C.size, C.size)), np.zeros((channels, channels))
    for dA in changes:
        dC = (C @ dA @ C).ravel()
        of_matrix += np.outer(dC, dC)
        of_offset += np.outer(dA @ load, dA @ load)
    return of_matrix, of_offset


def _derivatives(problem: Problem, solution: Solution, noise: Matrix) -> Matrix:
    """Return d(C, o, m, m c) by d(A row by row, phi, rotation)."""
    A, channels = solution.A, len(solution.response)
    inputs, columns = problem.inputs, FitColumns.of(channels)
    of_phi = channels * inputs
    of_rotation = of_phi + problem.parameters
    C = weighted_inverse(A, noise)
    weighted = np.linalg.solve(noise, A)
    steep = np.linalg.solve(A.T @ weighted, np.eye(AXES))
    beyond = np.linalg.solve(noise, np.eye(channels) - A @ C)
    slopes = np.zeros((columns.limb.stop, of_phi + problem.outer))
    last = problem.sets[-1]
    lever = last.lever(last.end)
    T = transforms(problem, solution)[-1]
    for i in range(channels):
        for a in range(inputs):
            column = i * inputs + a
            if a < AXES:
                dC = -np.outer(C[:, i], C[a]) + np.outer(steep[:, a], beyond[i])
                slopes[columns.matrix, column] = dC.ravel()
            slopes[columns.offset.start + i, column] = -(T @ lever)[a]
    signals = lever[: problem.basis.shape[2]].copy()
    signals[DIRECT] = solution.rotation @ signals[DIRECT]
    for p, of_parameter in enumerate(problem.basis):
        slopes[columns.offset, of_phi + p] = -A @ of_parameter @ signals
    if problem.rotation:
        M = np.einsum("p,pws->ws", solution.limb + problem.added[-1], problem.basis[..., DIRECT])
        for axis in range(3):
            turned = skew(np.eye(3)[axis]) @ signals[DIRECT]
            slopes[columns.offset, of_rotation + axis] = -A @ M @ turned
    slopes[columns.limb, of_phi : of_phi + STATIC] = np.eye(STATIC)
    return slopes
