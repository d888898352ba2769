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

_LARGE = 1e30
"""Stands for infinity where it is multiplied by nothing."""


class Weights(NamedTuple):
    """What residuals are measured in.

    Attributes:
        force: sqrt(w_F) / (M g), per N.
        cop: sqrt(w_P) / L, per m.
        threshold: Vertical force in N that a sample must exceed for its rows to count.
    """

    force: float
    cop: float
    threshold: float


class Linearised(NamedTuple):
    """The problem around one theta.

    Attributes:
        residual: (r_F, r_Px, r_Py), zero where a sample does not count, shape (..., N, 3).
        jacobian: Its derivative by theta over the spread that was given, shape (..., N, 3, 2K).
    """

    residual: Array
    jacobian: Array


def linearise(
    theta: Array, phi: Array, vgrf: Array, use: Array, weights: Weights, spread: Array | float = 1.0
) -> Linearised:
    """Evaluate the data's residuals of Eq. 14 and differentiate them.

    Args:
        theta: Parameters, shape (..., 2K).
        phi: Rows of (Fz, n_x, n_y), shape (..., N, 3, 2K).
        vgrf: Fz_ref in N, shape (..., N).
        use: Weight of each sample, 0 or 1, shape (..., N).
        weights: What residuals are measured in.
        spread: Unit of each parameter in the derivative, shape (2K,).
    """
    return _linearise(theta, phi, phi * spread, vgrf, use, weights)


def _linearise(
    theta: Array, phi: Array, scaled: Array, vgrf: Array, use: Array, weights: Weights
) -> Linearised:
    flat = phi.reshape(*phi.shape[:-3], -1, phi.shape[-1])
    moment = (flat @ theta[..., None]).reshape(phi.shape[:-1])
    fz = moment[..., :1]
    counts = (fz > weights.threshold) & (use[..., None] > 0.5)
    mask = counts.astype(np.float64)
    per_force = mask / np.where(counts, fz, 1.0)
    cop_error = moment[..., 1:] * per_force
    by_force = weights.force * mask
    residual = np.concatenate([by_force * (fz - vgrf[..., None]), weights.cop * cop_error], axis=-1)
    vertical = scaled[..., :1, :]
    lever = scaled[..., 1:, :] - cop_error[..., None] * vertical
    jacobian = np.concatenate(
        [by_force[..., None] * vertical, (weights.cop * per_force)[..., None] * lever], axis=-2
    )
    return Linearised(residual, jacobian)


class WindowSolution(NamedTuple):
    """What came of the iterations.

    Attributes:
        theta: Parameters, shape (..., 2K).
        solvable: Whether the normal equations could be solved safely (bool), shape (...).
    """

    theta: Array
    solvable: Array


def gauss_newton(
    last: Array,
    phi: Array,
    vgrf: Array,
    use: Array,
    weights: Weights,
    *,
    spread: Array,
    bound: Array,
    identity: Array,
    iterations: int,
) -> WindowSolution:
    """Minimise Eq. 14 by Gauss-Newton steps of bounded length.

    In units of the spread, phi = (theta - theta_last) / s, the normal equations are (H + I) dphi = -g:
    their smallest eigenvalue is one at least, so that one plus the trace of H bounds their condition
    number.

    Args:
        last: Parameters of the last update, shape (..., 2K).
        phi: Rows, shape (..., N, 3, 2K).
        vgrf: Fz_ref in N, shape (..., N).
        use: Weight of each sample, 0 or 1, shape (..., N).
        weights: What residuals are measured in.
        spread: s, shape (2K,).
        bound: Largest change of each parameter in one iteration, shape (2K,).
        identity: The identity matrix, shape (2K, 2K).
        iterations: How many steps to take.
    """
    batch, unknowns = last.shape[:-1], last.shape[-1]
    largest = 0.01 / np.finfo(np.float64).eps
    scaled = phi * spread
    theta, solvable = last, None
    for _ in range(iterations):
        r, J = _linearise(theta, phi, scaled, vgrf, use, weights)
        J = J.reshape(*batch, -1, unknowns)
        Jt = J.mT
        H = Jt @ J
        g = Jt @ r.reshape(*batch, -1, 1) + ((theta - last) / spread)[..., None]
        if solvable is None:
            solvable = 1.0 + (H * identity).sum(axis=(-2, -1)) < largest
        safe = solvable[..., None, None]
        change = np.linalg.solve(np.where(safe, H, 0.0) + identity, np.where(safe, g, 0.0))[..., 0]
        theta = theta - shorten(spread * change, bound)
    return WindowSolution(theta, solvable)


def shorten(change: Array, bound: Array) -> Array:
    """Scale a change down, its direction kept, until every parameter's part is within its bound."""
    excess = (np.abs(change) / bound).max(axis=-1)
    return change / np.where(excess > 1.0, excess, 1.0)[..., None]


def typical_square(square: Array, use: Array) -> Array:
    """Estimate the variance of residuals from the median of their squares, which outliers hardly move.

    Args:
        square: Mean squares of each sample's three residuals, shape (..., N).
        use: Weight of each sample, 0 or 1, shape (..., N).

    Returns:
        Variance, zero where nothing is used, shape (...).
    """
    count = use.sum(axis=-1)[..., None]
    ordered = np.sort(np.where(use > 0.5, square, _LARGE), axis=-1)
    rank = np.arange(ordered.shape[-1])
    middle = (rank <= 0.5 * (count - 1.0)) & (rank > 0.5 * (count - 1.0) - 1.0)
    return np.where(middle, ordered, 0.0).sum(axis=-1) / _MEDIAN_OF_SQUARE
