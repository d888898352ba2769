r"""How sure an in-situ calibration is; private.

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
from scipy.stats import chi2

from surefoot.calibration._vectors import skew
from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.model import STATIC
from surefoot.calibration.in_situ.solve import Problem, Solution, loop_shares, of_unit_length, transforms

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
"""A ratio that white noise exceeds at least this often says nothing."""

_STRETCHES = (10, 30, 100)
"""Into how many stretches a set is cut to see how its noise hangs together."""

_NOISE_FLOOR = 1e-10
"""Noise counts as at least this share of a channel's spread: a simulation may have none."""


def pooled_noise(sets: Sequence[CompressedSet]) -> Matrix:
    """Covariance of a sample's noise, pooled over the sets, nearer to diagonal the fewer they are, (k, k)."""
    scatter = np.sum([part.rr.T @ part.rr for part in sets], axis=0)
    freedom = max(sum(part.freedom for part in sets), 1)
    S = scatter / freedom
    share = len(S) / (freedom + len(S))
    spread = np.sum([part.ur.T @ part.ur for part in sets], axis=0) / sum(part.samples for part in sets)
    diagonal = np.diag(np.diag(S))
    return np.asarray((1.0 - share) * S + share * diagonal + _NOISE_FLOOR**2 * np.diag(np.diag(spread)))


def whitening(sets: Sequence[CompressedSet]) -> Matrix:
    """Compute W of the pooled noise, shape (k, k): W Sigma W' = 1."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(pooled_noise(sets))))


def inflation(problem: Problem, solution: Solution, freedom: int) -> float:
    """By how much the covariance is to be raised; a ratio that chance explains counts as one.

    Args:
        problem: What was solved.
        solution: What came out.
        freedom: Rows of the sets less unknowns.
    """
    sets = float(np.sum(solution.residual**2)) / max(freedom, 1)
    between = sets if _beyond_chance(sets, freedom) else 1.0
    return max(between, persistence(problem.sets, problem.whitening))


def persistence(sets: Sequence[CompressedSet], whitening: Matrix) -> float:
    """By how much noise that hangs together in time weighs more than white noise; 1 if chance explains it.

    Args:
        sets: Compressed.
        whitening: W, shape (k, k).
    """
    ratios = [_between_stretches(sets, whitening, stretches) for stretches in _STRETCHES]
    return max([1.0, *(ratio for ratio, terms in ratios if _beyond_chance(ratio, terms))])


def _beyond_chance(ratio: float, terms: int) -> bool:
    return terms > 0 and ratio * terms > chi2.isf(_CHANCE, terms)


def _between_stretches(sets: Sequence[CompressedSet], whitening: Matrix, stretches: int) -> tuple[float, int]:
    """Scatter of the scores of stretches of time over that of white noise, and its degrees of freedom."""
    scatter, expected, terms = 0.0, 0.0, 0
    for part in sets:
        if part.rows < 10 * stretches:
            continue
        score = part.score[:, np.linalg.norm(part.score, axis=0) > 0.5]
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
    """C of least variance, (A' S^-1 A)^-1 A' S^-1, shape (6, k): C A = 1."""
    weighted = np.linalg.solve(noise, response)
    return np.asarray(np.linalg.solve(response.T @ weighted, weighted.T))


def fit_covariance(problem: Problem, solution: Solution, noise: Matrix, factor: float) -> Matrix:
    """Covariance of (C row by row, the last set's offset at its end, m, m c), shape (7 k + 4, 7 k + 4).

    Args:
        problem: What was solved.
        solution: What came out.
        noise: Covariance of a sample, shape (k, k).
        factor: The inflation.
    """
    channels, inputs = solution.response.shape
    unit, size = of_unit_length(solution.jacobian)
    _, singular, right = np.linalg.svd(unit, full_matrices=False)
    root = right.T / np.maximum(singular, 1e-13 * singular[0]) / size[:, None]
    linear = channels * inputs
    # From W A to A, row by row.
    unwhiten = np.kron(np.linalg.inv(problem.whitening), np.eye(inputs))
    root[:linear] = unwhiten @ root[:linear]
    to_output = _derivatives(problem, solution, noise)
    root = to_output @ root
    covariance = root @ root.T
    last = problem.sets[-1]
    leverage = last.leverage(last.end)
    first = 6 * channels
    covariance[first : first + channels, first : first + channels] += noise * (leverage @ leverage)
    covariance = factor * covariance
    if problem.hysteresis or problem.channel_lags:
        covariance[: first + channels, : first + channels] += _slope_doubt(problem, solution, noise)
    return np.asarray(covariance)


def with_rows(covariance: Matrix, rows: Matrix) -> Matrix:
    """Put covariances of the matrix's rows, shape (6, k, k), in the place of those that a fit had."""
    changed, k = covariance.copy(), rows.shape[1]
    for axis, row in enumerate(rows):
        place = slice(axis * k, (axis + 1) * k)
        changed[place] = changed[:, place] = 0.0
        changed[place, place] = row
    return changed


def _slope_doubt(problem: Problem, solution: Solution, noise: Matrix) -> Matrix:
    """Covariance of (C, o) for want of one slope: an axis gives way by s more for a swing twice as large."""
    A = solution.response[:, :6]
    C = weighted_inverse(A, noise)
    channels = len(A)
    doubt = np.zeros((7 * channels, 7 * channels))
    last = problem.sets[-1]
    lever = last.lever(last.end)
    load = (transforms(problem, solution.limb, solution.rotation)[-1] @ lever)[:6]
    shares = loop_shares(problem, solution)
    if problem.hysteresis:
        changes = [share * np.outer(A[:, a], np.eye(6)[a]) for a, share in enumerate(shares)]
    else:
        changes = [share * np.outer(np.eye(channels)[c], A[c]) for c, share in enumerate(shares)]
    for dA in changes:
        of_matrix = (C @ dA @ C).ravel()
        doubt[: 6 * channels, : 6 * channels] += np.outer(of_matrix, of_matrix)
        doubt[6 * channels :, 6 * channels :] += np.outer(dA @ load, dA @ load)
    return doubt


def _derivatives(problem: Problem, solution: Solution, noise: Matrix) -> Matrix:
    """d(C, o, m, m c) by d(A row by row, phi, rotation)."""
    A, channels = solution.response[:, :6], len(solution.response)
    inputs, outer = problem.inputs, problem.outer
    C = weighted_inverse(A, noise)
    weighted = np.linalg.solve(noise, A)
    steep = np.linalg.solve(A.T @ weighted, np.eye(6))
    beyond = np.linalg.solve(noise, np.eye(channels) - A @ C)
    D = np.zeros((7 * channels + STATIC, channels * inputs + outer))
    last = problem.sets[-1]
    lever = last.lever(last.end)
    T = transforms(problem, solution.limb, solution.rotation)[-1]
    first = 6 * channels
    for i in range(channels):
        for a in range(inputs):
            column = i * inputs + a
            if a < 6:
                dC = -np.outer(C[:, i], C[a]) + np.outer(steep[:, a], beyond[i])
                D[:first, column] = dC.ravel()
            D[first + i, column] = -(T @ lever)[a]
    signals = lever[: problem.basis.shape[2]].copy()
    signals[:3] = solution.rotation @ signals[:3]
    for p, d in enumerate(problem.basis):
        D[first : first + channels, channels * inputs + p] = -A @ d @ signals
    if problem.rotation:
        M = np.einsum("p,pws->ws", solution.limb + problem.added[-1], problem.basis[..., :3])
        for axis in range(3):
            turned = skew(np.eye(3)[axis]) @ signals[:3]
            D[first : first + channels, -3 + axis] = -A @ M @ turned
    for p in range(STATIC):
        D[first + channels + p, channels * inputs + p] = 1.0
    return D
