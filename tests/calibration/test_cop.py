"""The centre of pressure of cells, feet and both feet."""

from operator import call

import numpy as np
import pytest
from _refusals import refusals
from hypothesis import given, settings
from hypothesis import strategies as st

from surefoot.calibration.cop import (
    cop_is_valid,
    cop_of_cells,
    cop_of_feet,
    cop_of_wrench,
    level_moments,
    moment_rows,
    sole_wrenches,
)
from surefoot.calibration.layout import FeetLayout, nao_shoe_layout

LAYOUT = nao_shoe_layout()
CELLS = LAYOUT.feet[0].position_cell_sole


def rotation(axis, angle):
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def yaw(angle):
    return rotation(np.array([0.0, 0.0, 1.0]), angle)


def feet(rng, series=(), tilt=0.0):
    """Forces of both feet and poses of their soles."""
    force = rng.uniform(1.0, 20.0, (*series, 8))
    position = rng.uniform(-1.0, 1.0, (*series, 2, 3))
    R = np.empty((*series, 2, 3, 3))
    for index in np.ndindex(*series, 2):
        lean = rotation(rng.standard_normal(3) * (1.0, 1.0, 0.0), tilt)
        R[index] = yaw(rng.uniform(-3.0, 3.0)) @ lean
    return force, position, R


@settings(deadline=None, derandomize=True, max_examples=100)
@given(seed=st.integers(0, 10**6), size=st.floats(1.0, 4.0))
def test_is_the_balance_point(seed, size):
    rng = np.random.default_rng(seed)
    force = rng.uniform(0.5, 1.0, 4) * 10.0**size
    cop = cop_of_cells(force, CELLS)
    residual = np.sum((CELLS[:, :2] - cop) * force[:, None], axis=0)
    np.testing.assert_allclose(residual, 0.0, atol=1e-13 * force.sum())
    assert (cop >= CELLS[:, :2].min(axis=0)).all()
    assert (cop <= CELLS[:, :2].max(axis=0)).all()


@settings(deadline=None, derandomize=True, max_examples=50)
@given(seed=st.integers(0, 10**6), factor=st.floats(1.0, 100.0), dx=st.floats(-2.0, 2.0))
def test_moves_with_the_places_and_not_with_the_units(seed, factor, dx):
    force = np.random.default_rng(seed).uniform(2.0, 20.0, 4)
    cop = cop_of_cells(force, CELLS)
    np.testing.assert_allclose(cop_of_cells(factor * force, CELLS), cop, atol=1e-14)
    shift = np.array([dx, 0.0, 0.0])
    np.testing.assert_allclose(cop_of_cells(force, CELLS + shift), cop + shift[:2], atol=1e-14)


def test_there_is_none_at_or_below_the_threshold():
    force = np.array([[1.25] * 4, [1.2500001] * 4, [0.0] * 4, [-20.0] * 4, [5.0, -5.0, 5.0, -5.0]])
    cop = cop_of_cells(force, CELLS)
    np.testing.assert_array_equal(np.isfinite(cop).all(axis=-1), [False, True, False, False, False])
    lower = cop_of_cells(force, CELLS, threshold=0.0)
    np.testing.assert_array_equal(np.isfinite(lower).all(axis=-1), [True, True, False, False, False])


@pytest.mark.parametrize("threshold", [-1.0, np.nan])
def test_a_threshold_is_not_negative(threshold):
    with pytest.raises(ValueError, match=f"'threshold' must not be negative, got {threshold} N"):
        cop_of_cells(np.ones(4), CELLS, threshold=threshold)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_cell_without_a_finite_force_leaves_none_and_no_warning(bad):
    force = np.array([10.0, bad, 10.0, 10.0])
    assert np.isnan(cop_of_cells(force, CELLS)).all()
    wrench = sole_wrenches(np.concatenate([force, np.full(4, 5.0)]), LAYOUT)
    assert np.isnan(cop_of_wrench(wrench)[0]).all()
    np.testing.assert_allclose(wrench[1, 2], 20.0)
    assert np.isfinite(cop_of_wrench(wrench)[1]).all()
    poses = np.zeros((2, 3)), np.stack([np.eye(3)] * 2)
    assert np.isnan(cop_of_feet(wrench, *poses)).all()
    infinite = np.where(np.isnan(wrench), bad, wrench)
    assert np.isnan(cop_of_feet(infinite, *poses)).all()


def test_validity_needs_a_finite_force():
    np.testing.assert_array_equal(
        cop_is_valid(np.array([5.0, 5.1, np.nan, np.inf, -9.0])), [False, True, False, False, False]
    )


def test_a_foot_agrees_with_its_cells():
    force = np.random.default_rng(2).uniform(1.0, 20.0, (7, 8))
    wrench = sole_wrenches(force, LAYOUT)
    for foot, where in enumerate(LAYOUT.slices):
        position = LAYOUT.feet[foot].position_cell_sole
        np.testing.assert_allclose(
            cop_of_wrench(wrench[:, foot]), cop_of_cells(force[:, where], position), atol=1e-14
        )


def test_feet_agree_with_all_cells_in_the_world():
    rng = np.random.default_rng(3)
    force, position, R = feet(rng, (20,))
    cells = np.stack([foot.position_cell_sole for foot in LAYOUT.feet])
    cells_world = position[:, :, None] + np.einsum("nfij,fkj->nfki", R, cells)

    np.testing.assert_allclose(
        cop_of_feet(sole_wrenches(force, LAYOUT), position, R),
        cop_of_cells(force, cells_world.reshape(20, 8, 3)),
        atol=1e-13,
    )


def test_level_moments_agree_with_forces_at_points():
    rng = np.random.default_rng(4)
    # A tilted sole with all six components, against cross products about the plane of its origin.
    point_sole = rng.uniform(-0.1, 0.1, (6, 3))
    force_sole = rng.uniform(-10.0, 30.0, (6, 3))
    wrench = np.concatenate([force_sole.sum(axis=0), np.cross(point_sole, force_sole).sum(axis=0)])
    _, position, R = feet(rng, tilt=0.3)
    fz, moment = level_moments(np.stack([wrench, np.zeros(6)]), position, R)

    force = force_sole @ R[0].T
    torque = np.cross(point_sole @ R[0].T, force).sum(axis=0)
    np.testing.assert_allclose(fz, [force[:, 2].sum(), 0.0], rtol=1e-13)
    # The point (px, py) of the plane z = position_z about which the horizontal torque vanishes.
    p = moment[0] / fz[0]
    lever = np.array([p[0] - position[0, 0], p[1] - position[0, 1], 0.0])
    np.testing.assert_allclose((torque - np.cross(lever, force.sum(axis=0)))[:2], 0.0, atol=1e-12)


def test_rows_are_the_moments_as_a_linear_map():
    force, position, R = feet(np.random.default_rng(5), (4, 3), tilt=0.2)
    fz, moment = level_moments(sole_wrenches(force, LAYOUT), position, R)
    by_rows = (moment_rows(LAYOUT, position, R) @ force[..., None, :, None])[..., 0]
    np.testing.assert_allclose(by_rows[..., 0], fz, rtol=1e-13)
    np.testing.assert_allclose(by_rows[..., 1:], moment, atol=1e-12)


@settings(deadline=None, derandomize=True, max_examples=30)
@given(seed=st.integers(0, 10**6), angle=st.floats(-3.0, 3.0))
def test_turns_with_the_level_frame(seed, angle):
    force, position, R = feet(np.random.default_rng(seed))
    wrench = sole_wrenches(force, LAYOUT)
    turn = yaw(angle)
    np.testing.assert_allclose(
        cop_of_feet(wrench, position @ turn.T, turn @ R),
        turn[:2, :2] @ cop_of_feet(wrench, position, R),
        atol=1e-13,
    )


def test_a_series_is_its_samples_and_arguments_stay_untouched():
    force, position, R = feet(np.random.default_rng(6), (6,))
    force[0, 0] = np.nan
    kept = force.copy(), position.copy(), R.copy()
    wrench = sole_wrenches(force, LAYOUT)
    cop = cop_of_feet(wrench, position, R)
    for index in range(6):
        alone = cop_of_feet(sole_wrenches(force[index], LAYOUT), position[index], R[index])
        np.testing.assert_allclose(cop[index], alone, atol=1e-14)
    for before, after in zip(kept, (force, position, R), strict=True):
        np.testing.assert_array_equal(before, after)
    # One position for a whole series of forces.
    shared = cop_of_cells(force[:, :4], CELLS)
    assert shared.shape == (6, 2)


def test_a_force_plate_is_a_foot_alone():
    plate = FeetLayout((LAYOUT.feet[0],))
    force, position, R = np.array([[4.0, 3.0, 2.0, 1.0]]), np.full((1, 1, 3), 0.5), np.eye(3)[None, None]
    cop = cop_of_feet(sole_wrenches(force, plate), position, R)
    np.testing.assert_allclose(cop, cop_of_cells(force, CELLS) + 0.5, rtol=1e-14)
    assert moment_rows(plate, position, R).shape == (1, 1, 3, 4)


test_refuses_shapes_that_do_not_belong_together = refusals(
    call,
    (
        lambda: cop_of_cells(np.ones(4), np.ones((3, 2))),
        "'force' holds 4 cells on its last axis but 'position' places 3: got shapes (4,) and (3, 2).",
    ),
    (
        lambda: cop_of_cells(np.ones(4), np.ones((4, 5))),
        "'force' must have shape (..., cells) and 'position' (..., cells, 2) or (..., cells, 3), "
        "got (4,) and (4, 5).",
    ),
    (
        lambda: cop_of_cells(np.ones(4, dtype=int), np.ones((4, 2))),
        "'force' must hold floating-point numbers, got dtype int64.",
    ),
    (lambda: cop_of_cells([1.0] * 4, np.ones((4, 2))), "'force' must be an array, got list."),
    (lambda: cop_of_wrench(np.ones(5)), "'wrench' must have shape (..., 6), got (5,)."),
    (
        lambda: cop_of_feet(np.ones((2, 6)), np.ones((3, 2)), np.ones((2, 3, 3))),
        "'position_sole' must have shape (..., 2, 3), got (3, 2).",
    ),
    (
        lambda: cop_of_feet(np.ones((2, 6)), np.ones((2, 3)), np.ones((3, 3))),
        "'R_level_sole' must have shape (..., 2, 3, 3), got (3, 3).",
    ),
    (lambda: sole_wrenches(np.ones(6), LAYOUT), "'force' must hold one reading for each of the 8 channels"),
    plain=True,
)
