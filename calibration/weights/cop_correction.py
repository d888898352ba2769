"""Correction of a foot's centre of pressure from known weights at known holes.

A plate that bends, cells that are not where the drawing has them and cells that are not quite linear leave an
error that a weight at a known hole shows (CoP paper, Eqs. 3 to 5):

    p_cal = p + a0 + a1 x + a2 y + a3 x^2 + a4 x y + a5 y^2 + sum_i b_i F_i,      per axis,

with p = (x, y) the centre of pressure of the cells (Eq. 8). It is linear in (a, b): no iterations are needed,
though the paper names nonlinear least squares. Three things that the paper leaves out:

* A rigid plate on k cells loads them in a three-dimensional family only, (Fz, tx, ty): with four cells one
  combination of the b_i is never seen. It stays at zero (the smallest correction that fits), and the rank
  shows it.
* With a single weight the sum of the forces is constant and b_i cannot be separated from a0, a1, a2: refused.
* Weights at or below the threshold (5 N, 510 g) have no centre of pressure: a few millinewtons of noise would
  move it by centimetres. They are counted as gated and take no part here; they serve the channels' fit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.calibration.arrays import Array
from surefoot.calibration.cop import FORCE_THRESHOLD, cop_of_cells
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats


@dataclass(frozen=True, eq=False)
class CopCorrectionFit:
    """The correction of a foot's centre of pressure (CoP paper, Eqs. 3 to 5)."""

    value: Floats  # (a0, ..., a5, b1, ..., bk) of each axis, shape (2, 6 + k): m, 1, 1, 1/m, 1/m, 1/m, m/N
    covariance: Floats
    """Of each axis's coefficients from the scatter of the residuals, shape (2, 6 + k, 6 + k); zero along the
    directions that were left at zero."""
    result: FitResult  # whether all coefficients were determined
    stats: FitStats  # of the fit; the residual is the length of the error of the centre of pressure in m
    position_cell_sole: Floats  # places of the cells in m, shape (k, 2)
    threshold: float  # force in N at or below which there is no centre of pressure

    def cop(self, force: Array) -> Array:
        """Find the corrected centre of pressure on the sole in m, (..., 2), of forces in N, shape (..., k).

        NaN below the threshold (CoP paper, Eqs. 3, 4). The polynomial holds where weights stood; beyond the
        outermost holes it is a guess.
        """
        raw_cop = cop_of_cells(force, self.position_cell_sole, self.threshold)
        known_force = np.where(np.isfinite(raw_cop[..., :1]), force, np.zeros_like(force))
        basis = _correction_basis(raw_cop, known_force)
        return raw_cop + (basis[..., None, :] @ self.value.T)[..., 0, :]


def _correction_basis(cop: Array, force: Array) -> Array:
    """Evaluate (1, x, y, x^2, x y, y^2, F_1, ..., F_k) of CoP paper, Eq. 4, shape (..., 6 + k)."""
    x, y = cop[..., 0], cop[..., 1]
    polynomial = np.stack([np.ones_like(x), x, y, x**2, x * y, y**2], axis=-1)
    return np.concatenate([polynomial, force], axis=-1)


def fit_cop_correction(
    force: ArrayLike,
    load: ArrayLike,
    position_weight: ArrayLike,
    position_cell: ArrayLike,
    *,
    threshold: float = FORCE_THRESHOLD,
    tolerance: float = 1e-4,
) -> CopCorrectionFit:
    """Fit the correction of a foot's centre of pressure to weights at known holes (CoP paper, Eqs. 3 to 5).

    Args:
        force: Forces of the foot's cells in N, one row a placement, shape (n, k).
        load: The weights in N, shape (n,).
        position_weight: Where they stood in the sole frame in m, shape (n, 2).
        position_cell: Where the cells are in the sole frame in m, shape (k, 2) or (k, 3).
        threshold: Sum of forces in N that a placement must exceed to take part.
        tolerance: Singular values below this share of the largest, with columns scaled to one length, count
            as not excited; it should lie above the noise's share of the forces.

    Raises:
        ValueError: If the shapes do not belong together.
        CalibrationRefused: If there were too few placements, holes or weights.
    """
    every_force, every_load = np.asarray(force, dtype=np.float64), np.asarray(load, dtype=np.float64)
    every_hole = np.asarray(position_weight, dtype=np.float64)
    cell = np.asarray(position_cell, dtype=np.float64)[..., :2]
    _check_shapes(every_force, every_load, every_hole, cell)

    finite = np.isfinite(np.column_stack([every_force, every_load, every_hole])).all(axis=1)
    cell_force, weight, hole = every_force[finite], every_load[finite], every_hole[finite]
    cop = cop_of_cells(cell_force, cell, threshold)
    kept = np.isfinite(cop).all(axis=1)
    unknowns, gated = 6 + len(cell), int(np.sum(~kept))
    _check_placements(weight[kept], hole[kept], unknowns, gated, threshold)

    basis = _correction_basis(cop[kept], cell_force[kept])
    target = hole[kept] - cop[kept]
    coefficients, to_coefficients, rank, condition = _solve(basis, target, tolerance)
    residual = target - basis @ coefficients
    free = len(target) - rank
    variance = np.sum(residual**2, axis=0) / free if free else np.full(2, np.nan)
    return CopCorrectionFit(
        value=coefficients.T,
        covariance=variance[:, None, None] * (to_coefficients @ to_coefficients.T),
        result=FitResult.DETERMINED if rank == unknowns else FitResult.PARTLY_DETERMINED,
        stats=FitStats(
            samples=int(np.sum(kept)),
            dropped=int(np.sum(~finite)),
            gated=gated,
            residual_rms=float(np.sqrt(np.mean(np.sum(residual**2, axis=1)))),
            rank=rank,
            unknowns=unknowns,
            condition=condition,
        ),
        position_cell_sole=cell,
        threshold=threshold,
    )


def _solve(basis: Floats, target: Floats, tolerance: float) -> tuple[Floats, Floats, int, float]:
    """Return coefficients, the map from unit errors to them, rank and condition; refuse too low a rank."""
    # To one length, or the cut-off would be a matter of units; cells alike, so that none is preferred.
    length, unknowns = np.linalg.norm(basis, axis=0), basis.shape[1]
    length[6:] = np.sqrt(np.mean(length[6:] ** 2))
    left, singular, right = np.linalg.svd(basis / length, full_matrices=False)
    rank = int(np.sum(singular > tolerance * singular[0]))
    if rank < unknowns - 1:
        raise CalibrationRefused(
            f"The placements determine {rank} of the correction's {unknowns} coefficients.",
            "Use holes in at least three rows and three columns, and two weights over the same holes.",
        )
    to_coefficients = (right[:rank].T / singular[:rank]) / length[:, None]
    condition = float(singular[0] / singular[-1]) if rank == unknowns else np.inf
    return to_coefficients @ (left[:, :rank].T @ target), to_coefficients, rank, condition


def _check_shapes(force: Floats, load: Floats, hole: Floats, cell: Floats) -> None:
    """Raise ValueError if arrays are not of the same placements and cells."""
    if cell.ndim != 2 or cell.shape[1] != 2:
        raise ValueError(f"'position_cell' must have shape (cells, 2) or (cells, 3), got {cell.shape}.")
    if force.ndim != 2 or force.shape[1] != len(cell):
        raise ValueError(
            f"'force' must have shape (placements, {len(cell)}) for {len(cell)} cells, got {force.shape}."
        )
    wanted = (("load", load, (len(force),)), ("position_weight", hole, (len(force), 2)))
    for what, array, shape in wanted:
        if array.shape != shape:
            raise ValueError(f"'{what}' must have shape {shape} like 'force', got {array.shape}.")


def _check_placements(load: Floats, hole: Floats, unknowns: int, gated: int, threshold: float) -> None:
    """Raise CalibrationRefused if the placements do not determine the coefficients, with the missing data."""
    if len(load) < unknowns:
        raise CalibrationRefused(
            f"Only {len(load)} usable placements for {unknowns} coefficients "
            f"({gated} did not exceed the threshold of {threshold:g} N).",
            "Place weights above the threshold at more holes.",
        )
    holes = len(np.unique(np.round(hole, 6), axis=0))
    if holes < 6:
        raise CalibrationRefused(
            f"The weights stood at {holes} different holes, and a polynomial of second order needs six.",
            "Use holes in at least three rows and three columns.",
        )
    if np.ptp(load) <= 1e-9 * np.max(np.abs(load)):
        raise CalibrationRefused(
            f"All placements bore the same weight of {load[0]:g} N, so that the cells' own share (b) "
            "cannot be separated from the polynomial.",
            "Repeat holes with a second weight.",
        )
