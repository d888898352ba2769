"""Correcting the centre of pressure with weights at known holes."""

import re

import numpy as np
import pytest
from _refusals import refusals

from surefoot.calibration.cop import cop_of_cells
from surefoot.calibration.layout import nao_shoe_layout
from surefoot.calibration.results import CalibrationRefused, FitResult
from surefoot.calibration.weights.cop_correction import fit_cop_correction

CELLS = nao_shoe_layout().feet[0].position_cell_sole[:, :2]
WEIGHTS = np.array([10.0, 20.0, 40.0])


def basis(cop, force):
    x, y = cop.T
    return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y, force])


def free_cells(rng, n=80):
    """Forces that no rigid plate would make: every combination of the cells is excited."""
    force = rng.uniform(2.0, 20.0, (n, 4))
    return force, force.sum(axis=1), cop_of_cells(force, CELLS)


def plate(rng, weights=WEIGHTS, holes=30):
    """Weights at holes of a rigid plate on equal cells."""
    hole = rng.uniform(-1.0, 1.0, (holes, 2)) * (0.08, 0.045) + CELLS.mean(axis=0)
    hole, load = np.repeat(hole, len(weights), axis=0), np.tile(weights, holes)
    arm = CELLS - CELLS.mean(axis=0)
    share = 0.25 + (hole - CELLS.mean(axis=0)) @ (arm / np.sum(arm**2, axis=0)).T
    return share * load[:, None], load, hole


def coefficients(rng):
    units = np.array([1e-3, 1e-2, 1e-2, 0.1, 0.1, 0.1, 1e-5, 1e-5, 1e-5, 1e-5])
    return units * rng.uniform(-1.0, 1.0, (2, 10))


@pytest.mark.parametrize("seed", range(5))
def test_recovers_the_coefficients_without_noise(seed):
    rng = np.random.default_rng([31, seed])
    force, load, cop = free_cells(rng)
    true = coefficients(rng)
    hole = cop + basis(cop, force) @ true.T
    fit = fit_cop_correction(force, load, hole, CELLS)
    assert fit.result is FitResult.DETERMINED
    assert fit.stats.rank == 10
    np.testing.assert_allclose(fit.value, true, rtol=1e-9, atol=1e-9 * np.abs(true).max(axis=0).min())
    np.testing.assert_allclose(fit.cop(force), hole, atol=1e-12)
    assert fit.stats.residual_rms < 1e-12


def test_a_plate_leaves_one_combination_of_cells_unseen():
    rng = np.random.default_rng(32)
    force, load, _ = plate(rng)
    true = coefficients(rng)
    true[:, 6:] -= true[:, 6:].mean(axis=1, keepdims=True)
    cop = cop_of_cells(force, CELLS)
    target = cop + basis(cop, force) @ true.T
    fit = fit_cop_correction(force, load, target, CELLS)
    assert fit.stats.rank == 9
    assert fit.stats.condition == np.inf
    assert fit.result is FitResult.PARTLY_DETERMINED
    np.testing.assert_allclose(fit.cop(force), target, atol=1e-12)
    # The share that nobody saw stays at zero, and so does the claim about it.
    warp = np.array([1.0, -1.0, -1.0, 1.0])
    np.testing.assert_allclose(fit.value[:, 6:] @ warp, 0.0, atol=1e-15)
    np.testing.assert_allclose(warp @ fit.covariance[:, 6:, 6:] @ warp, 0.0, atol=1e-20)


def test_exact_cells_need_no_correction():
    force, load, hole = plate(np.random.default_rng(33))
    fit = fit_cop_correction(force, load, hole, CELLS)
    np.testing.assert_allclose(fit.cop(force), cop_of_cells(force, CELLS), atol=1e-12)
    assert np.abs(fit.value).max() < 1e-9


def test_covariance_agrees_with_the_errors():
    rng = np.random.default_rng(35)
    force, load, cop = free_cells(rng)
    nees = []
    for _ in range(400):
        noisy = cop + 1e-3 * rng.standard_normal(cop.shape)
        fit = fit_cop_correction(force, load, noisy, CELLS)
        nees += [row @ np.linalg.solve(c, row) for row, c in zip(fit.value, fit.covariance, strict=True)]
    free = len(force) - 10
    np.testing.assert_allclose(np.mean(nees) / 10.0, free / (free - 2), rtol=0.06)


def test_light_weights_and_missing_values_are_counted_and_left_out():
    rng = np.random.default_rng(36)
    force, load, hole = plate(rng)
    light_force, light_load, light_hole = plate(rng, weights=np.array([0.1, 4.9]), holes=4)
    dropped = force[:3].copy()
    dropped[0, 1], dropped[1, 2], dropped[2, 3] = np.nan, np.inf, -np.inf
    fit = fit_cop_correction(
        np.concatenate([force, light_force + 0.01, dropped]),
        np.concatenate([load, light_load, load[:3]]),
        np.concatenate([hole, light_hole, hole[:3]]),
        CELLS,
    )
    alone = fit_cop_correction(force, load, hole, CELLS)
    np.testing.assert_allclose(fit.value, alone.value, atol=1e-15)
    assert (fit.stats.samples, fit.stats.gated, fit.stats.dropped) == (len(force), 8, 3)


def test_prediction_is_batched_and_gated():
    rng = np.random.default_rng(37)
    force, load, cop = free_cells(rng)
    fit = fit_cop_correction(force, load, cop + basis(cop, force) @ coefficients(rng).T, CELLS)
    batch = force.reshape(4, 20, 4).copy()
    batch[0, 0], batch[1, 1, 2], batch[2, 2, 0] = 1.0, np.nan, np.inf
    found = fit.cop(batch)
    np.testing.assert_array_equal(np.argwhere(np.isnan(found).all(axis=-1)), [[0, 0], [1, 1], [2, 2]])
    np.testing.assert_allclose(found[3, 5], fit.cop(batch[3, 5]), atol=1e-15)


def refused(call):
    with pytest.raises(CalibrationRefused) as refusal:
        call()
    return refusal.value


def test_refuses_a_single_weight():
    force, load, hole = plate(np.random.default_rng(38), weights=np.array([20.0]))
    no = refused(lambda: fit_cop_correction(force, load, hole, CELLS))
    assert no.reason.startswith("All placements bore the same weight of 20 N")
    assert no.cure == "Repeat holes with a second weight."


def test_refuses_too_few_placements_and_says_what_was_gated():
    force, load, hole = plate(np.random.default_rng(39), weights=np.array([1.0, 4.0, 30.0]), holes=9)
    no = refused(lambda: fit_cop_correction(force, load, hole, CELLS))
    assert (
        "Only 9 usable placements for 10 coefficients (18 did not exceed the threshold of 5 N)." in no.reason
    )
    assert "Place weights above the threshold at more holes." in no.cure


def test_refuses_too_few_holes():
    force, load, hole = plate(np.random.default_rng(40), holes=5)
    no = refused(lambda: fit_cop_correction(force, load, hole, CELLS))
    assert "stood at 5 different holes, and a polynomial of second order needs six" in no.reason


def test_refuses_holes_on_one_line():
    force, load, hole = plate(np.random.default_rng(41))
    # Turning each plate's pair of left and right cells into their mean puts every weight on the middle line.
    force = 0.5 * (force + force[:, [1, 0, 3, 2]])
    hole[:, 1] = CELLS[:, 1].mean()
    no = refused(lambda: fit_cop_correction(force, load, hole, CELLS))
    assert re.match(r"The placements determine \d of the correction's 10 coefficients\.", no.reason)
    assert "at least three rows and three columns" in no.cure


PLACED = {
    "force": np.ones((5, 4)), "load": np.ones(5), "position_weight": np.ones((5, 2)), "position_cell": CELLS,
}  # fmt: skip

test_refuses_shapes_that_do_not_belong_together = refusals(
    lambda change: fit_cop_correction(**PLACED | change),
    ({"force": np.ones((5, 3))}, "'force' must have shape (placements, 4) for 4 cells, got (5, 3)."),
    ({"load": np.ones(4)}, "'load' must have shape (5,) like 'force', got (4,)."),
    ({"position_weight": np.ones((5, 3))}, "'position_weight' must have shape (5, 2) like 'force'"),
    ({"position_cell": np.ones(4)}, "'position_cell' must have shape (cells, 2) or (cells, 3)"),
    plain=True,
)
