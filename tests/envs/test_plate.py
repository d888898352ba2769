"""Statics of a rigid plate on four springs."""

import numpy as np
import pytest
from _refusals import refusals
from hypothesis import given
from hypothesis import strategies as st

from surefoot.envs.instrumentation.plate import SolePlate

RECTANGLE = np.array([(0.085, 0.049), (0.085, -0.049), (-0.085, 0.049), (-0.085, -0.049)])
RECTANGLE += np.array([0.024, 0.007])
stiffnesses = st.lists(st.floats(-2.0, 2.0).map(lambda x: 10.0**x), min_size=4, max_size=4)
loads = st.tuples(st.floats(-100.0, 100.0), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))


@given(stiffnesses, loads)
def test_cells_carry_the_load_and_nothing_else(stiffness, load):
    plate = SolePlate(RECTANGLE, stiffness)
    force = plate.share @ load
    x, y = RECTANGLE.T
    np.testing.assert_allclose([force.sum(), y @ force, -x @ force], load, atol=1e-9)
    np.testing.assert_allclose(plate.load_of_cells @ force, load, atol=1e-9)


def test_horizontal_forces_add_up_and_turn_evenly():
    load, (x, y) = np.array([20.0, -7.0, 1.3]), RECTANGLE.T
    along = SolePlate(RECTANGLE, [1.2, 0.9, 0.8, 1.1]).across @ load
    fx, fy = along[:4], along[4:]
    np.testing.assert_allclose([fx.sum(), fy.sum(), (x * fy - y * fx).sum()], load, atol=1e-12)
    # Equally stiff cells move with a rigid plate: by a shift, and by a turn about their middle.
    arms = RECTANGLE - RECTANGLE.mean(axis=0)
    turned = np.column_stack([fx - fx.mean(), fy - fy.mean()])
    np.testing.assert_allclose((turned * arms).sum(axis=1), 0.0, atol=1e-12)


@given(stiffnesses, loads)
def test_the_constraint_is_zero_under_any_load(stiffness, load):
    plate = SolePlate(RECTANGLE, stiffness)
    assert plate.constraint @ (plate.share @ load) == pytest.approx(0.0, abs=1e-8)
    assert np.linalg.norm(plate.constraint) == pytest.approx(1.0)


def test_the_share_stores_the_least_energy_in_the_springs():
    """Castigliano: of all forces that carry the load, the elastic ones minimise sum F^2 / k."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        k = rng.uniform(0.5, 2.0, 4)
        load = rng.normal(size=3) * (40.0, 1.0, 1.0)
        plate = SolePlate(RECTANGLE, k)
        # The minimiser of |K^-1/2 F| under W F = w is K^1/2 (W K^1/2)^+ w.
        least = np.sqrt(k) * (np.linalg.pinv(plate.load_of_cells * np.sqrt(k)) @ load)
        np.testing.assert_allclose(plate.share @ load, least, atol=1e-9)


def test_equal_cells_on_a_rectangle_never_warp():
    plate = SolePlate(RECTANGLE, np.ones(4))
    np.testing.assert_allclose(plate.constraint, [0.5, -0.5, -0.5, 0.5], atol=1e-12)
    np.testing.assert_allclose(np.array([1, -1, -1, 1]) @ plate.share, 0.0, atol=1e-12)


def test_unequal_cells_warp():
    plate = SolePlate(RECTANGLE, [1.2, 0.9, 0.8, 1.1])
    assert abs(np.array([1, -1, -1, 1]) @ plate.share @ (40.0, 0.0, -1.0)) > 1.0


def test_only_the_ratios_of_stiffnesses_matter():
    k = np.array([1.2, 0.9, 0.8, 1.1])
    np.testing.assert_allclose(SolePlate(RECTANGLE, k).share, SolePlate(RECTANGLE, 3e5 * k).share, rtol=1e-9)


def test_positions_may_have_a_height():
    flat, high = SolePlate(RECTANGLE, np.ones(4)), np.column_stack([RECTANGLE, np.full(4, 0.01)])
    np.testing.assert_array_equal(SolePlate(high, np.ones(4)).share, flat.share)


test_bad_plates_are_refused = refusals(
    SolePlate,
    (RECTANGLE[:3], np.ones(4), "four cells"),
    (np.full((4, 2), np.nan), np.ones(4), "finite positions"),
    (RECTANGLE, [1.0, 1.0, 1.0, 0.0], "four positive finite stiffnesses"),
    (np.column_stack([np.arange(4.0), np.arange(4.0)]), np.ones(4), "on one line"),
)
