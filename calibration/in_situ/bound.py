r"""What no estimator of an in-situ calibration can go below, and whether one is as sure as it is right.

With white noise of known covariance N on the readings r = A M(m, c) g + o_j + n, the information on the 40
unknowns of response and limb and the 6 of each set's offset is the sum of the squared slopes over all
samples, :math:`F = \sum_i J_i^\top N^{-1} J_i` at the true values, and no unbiased estimator has a smaller
covariance than :math:`F^{-1}` (Cramér and Rao). The slopes are linear in (g, 1), so that the second moments
of these four numbers stand for all samples of a set.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import skew
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.fit import InSituFit, Limb
from surefoot.calibration.in_situ.model import STATIC

__all__ = ["cramer_rao", "normalised_error", "offset_bounds"]

Matrix = NDArray[np.float64]


def cramer_rao(sets: Sequence[InSituSet], response: Matrix, limb: Limb, noise: Matrix) -> Matrix:
    """Return the bound on the covariance of (A row by row, m, m c, the offsets of the sets).

    Args:
        sets: Of which gravity and the added masses are used, which must be exact.
        response: The true A in counts per N and N m, shape (k, 6).
        limb: The true limb.
        noise: Covariance of a sample's noise in counts^2, shape (k, k).

    Returns:
        In the square of the unknowns' units, shape (6 k + 4 + J k, 6 k + 4 + J k).

    Raises:
        ValueError: If the sets leave an unknown open.
    """
    k = len(response)
    first = 6 * k + STATIC
    weight = np.linalg.inv(noise)
    information = np.zeros((first + len(sets) * k, first + len(sets) * k))
    for j, data in enumerate(sets):
        slopes = np.zeros((4, k, len(information)))
        M = _gravity_map(
            limb.mass + data.added_mass, limb.mass_com + data.added_mass * np.asarray(data.added_com)
        )
        parts = [_gravity_map(*unit) for unit in _units()]
        for axis in range(3):
            # d(A M e) / dA, and A (dM / dphi) e, for gravity along one axis.
            slopes[axis, :, : 6 * k] = np.kron(np.eye(k), M[:, axis])
            slopes[axis, :, 6 * k : first] = np.stack([response @ part[:, axis] for part in parts], axis=1)
        slopes[3, :, first + j * k : first + (j + 1) * k] = np.eye(k)
        u = np.column_stack([data.gravity, np.ones(len(data.gravity))])
        information += np.einsum("cd,ckp,kl,dlq->pq", u.T @ u, slopes, weight, slopes, optimize=True)
    scale = np.sqrt(np.diag(information))
    unit = information / np.outer(scale, scale) if np.all(scale > 0.0) else np.zeros((1, 1))
    if np.linalg.cond(unit) > 1e14:
        raise ValueError("The sets leave some unknown open, so that there is no bound on it; add sets.")
    return np.asarray(np.linalg.inv(unit) / np.outer(scale, scale))


def offset_bounds(bound: Matrix, response: Matrix, sets: int) -> Matrix:
    """Return the bound of each set's offset as a wrench, C P C', in N^2 and (N m)^2, shape (J, 6, 6).

    Args:
        bound: Of :func:`cramer_rao`.
        response: The true A, shape (k, 6).
        sets: Their number J.
    """
    k = len(response)
    C = np.linalg.pinv(response)
    first = 6 * k + STATIC
    places = [slice(first + j * k, first + (j + 1) * k) for j in range(sets)]
    return np.array([C @ bound[place, place] @ C.T for place in places])


def normalised_error(fit: InSituFit, response: Matrix, offset: Matrix, limb: Limb) -> float:
    """Return the squared error of (C, the last offset, limb) by the covariance of the fit (NEES).

    Args:
        fit: What was fitted.
        response: The true A in counts per N and N m, shape (k, 6).
        offset: The true last offset in counts, shape (k,).
        limb: The true limb.

    Returns:
        A draw of chi-square with ``len(fit.covariance)`` degrees of freedom, if the fit knows itself.
    """
    error = np.concatenate(
        [
            (fit.matrix - np.linalg.pinv(response)).ravel(),
            fit.offset - offset,
            [fit.limb.mass - limb.mass],
            fit.limb.mass_com - limb.mass_com,
        ]
    )
    scale = np.sqrt(np.diag(fit.covariance))
    unit = fit.covariance / np.outer(scale, scale)
    return float(error / scale @ np.linalg.solve(unit, error / scale))


def _gravity_map(mass: float, mass_com: NDArray[np.float64]) -> Matrix:
    """Return M with w = M g (in-situ paper, Eqs. 3-5), shape (6, 3)."""
    return np.vstack([mass * np.eye(3), skew(mass_com)])


def _units() -> list[tuple[float, NDArray[np.float64]]]:
    return [(1.0, np.zeros(3)), *((0.0, axis) for axis in np.eye(3))]
