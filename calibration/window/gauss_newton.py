r"""The least-squares problem of the sliding window and its Gauss-Newton steps.

With theta = (a_1, ..., a_K, b_1, ..., b_K / (M g)) the moments of a sample k about its reference centre of
pressure p_ref are linear, with rows Phi_k of shape (3, 2K),

    (Fz, n_x, n_y)_k = Phi_k theta,     n = Fz (p - p_ref),

so that the paper's residuals (Eq. 14, normalised) and their derivatives are

    r_F = sqrt(w_F) (Fz - Fz_ref) / (M g)        dr_F / dtheta = sqrt(w_F) Phi_0 / (M g)
    r_P = sqrt(w_P) n / (Fz L)                   dr_P / dtheta = sqrt(w_P) (Phi_xy - (n / Fz) Phi_0) / (Fz L)
    r_S = (theta - theta_last) / s

with s the standard deviation of a parameter's change between two updates, so that w_S = 1 / s^2.
"""

from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array

_MEDIAN_OF_SQUARE = 0.79
"""Median of the mean of three squared normal deviates: what makes a median comparable with a variance."""


class Weights(NamedTuple):
    """The unit of residuals."""

    force: float  # sqrt(w_F) / (M g), per N
    cop: float  # sqrt(w_P) / L, per m
    threshold: float  # vertical force in N that a sample must exceed for its rows to count


class Linearised(NamedTuple):
    """The problem of N samples around one theta."""

    residual: Array  # (r_F, r_Px, r_Py), zero where a sample does not count, shape (N, 3)
    jacobian: Array  # its derivative by theta over the spread that was given, shape (N, 3, 2K)


def linearise(
    theta: Array, phi: Array, vgrf: Array, use: Array, weights: Weights, spread: Array | float = 1.0
) -> Linearised:
    """Evaluate the data's residuals of Eq. 14 and differentiate them.

    Of parameters, (2K,), rows of (Fz, n_x, n_y), (N, 3, 2K), Fz_ref in N and weights of the samples, 0 or 1,
    (N,) each; ``spread`` is the unit of each parameter in the derivative, (2K,).
    """
    moment, scaled = phi @ theta, phi * spread
    fz = moment[:, :1]
    counts = (fz > weights.threshold) & (use[:, None] > 0.5)
    by_force = weights.force * counts
    per_force = counts / np.where(counts, fz, 1.0)
    cop_error = moment[:, 1:] * per_force
    residual = np.hstack([by_force * (fz - vgrf[:, None]), weights.cop * cop_error])
    vertical = scaled[:, :1]
    lever = scaled[:, 1:] - cop_error[:, :, None] * vertical
    by_cop = (weights.cop * per_force)[:, :, None] * lever
    return Linearised(residual, np.concatenate([by_force[:, :, None] * vertical, by_cop], axis=1))


class WindowSolution(NamedTuple):
    """The result of the iterations."""

    theta: Array  # parameters, shape (2K,)
    solvable: bool  # whether the normal equations could be solved safely


def gauss_newton(
    last: Array,
    phi: Array,
    vgrf: Array,
    use: Array,
    weights: Weights,
    *,
    spread: Array,
    bound: Array,
    iterations: int,
) -> WindowSolution:
    """Minimise Eq. 14 by Gauss-Newton steps of bounded length, from the parameters of the last update, (2K,).

    In units of the spread s, (2K,), phi = (theta - theta_last) / s, the normal equations are (H + I) dphi =
    -g: their smallest eigenvalue is one at least, so that one plus the trace of H bounds their condition
    number. Rows ``phi``, (N, 3, 2K), and Fz_ref in N, (N,), are used where ``use``, (N,), is 1 and not 0;
    ``bound`` is the largest change in one iteration, (2K,).
    """
    unknowns, largest = len(last), 0.01 / np.finfo(np.float64).eps
    theta = last
    for iteration in range(iterations):
        r, J = linearise(theta, phi, vgrf, use, weights, spread)
        J = J.reshape(-1, unknowns)
        H = J.T @ J
        g = J.T @ r.reshape(-1) + (theta - last) / spread
        if iteration == 0 and not 1.0 + np.trace(H) < largest:
            return WindowSolution(last, False)
        change = np.linalg.solve(H + np.eye(unknowns), g)
        theta = theta - shorten(spread * change, bound)
    return WindowSolution(theta, True)


def shorten(change: Array, bound: Array) -> Array:
    """Scale a change down, its direction kept, until every parameter's part is within its bound."""
    return change / max(1.0, (np.abs(change) / bound).max())


def typical_square(square: Array, use: Array) -> float:
    """Estimate the variance of residuals from the median of their squares, which outliers hardly move.

    Mean squares of each sample's three residuals, and their weights, 0 or 1, have shape (N,).
    """
    used = np.sort(square[use > 0.5])
    return float(used[(len(used) - 1) // 2]) / _MEDIAN_OF_SQUARE if len(used) else 0.0
