"""Ellipsoids and weighings against bodies that are known to the last digit."""

from dataclasses import replace

import numpy as np
import pytest
from _in_situ import SENSORS, moving_sets
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surefoot.calibration import GRAVITY
from surefoot.calibration.in_situ import InSituSet, Limb, calibrate_in_situ
from surefoot.experiments.force_torque.validation import (
    added_mass,
    force_ellipsoid,
    motion_wrench,
    normalise_error,
    offset_of_set,
)

LIMB = Limb(4.7, 4.7 * np.array([0.012, 0.001, 0.19]))


def pulls(n: int = 200, spread: float = 1.0, seed: int = 3) -> NDArray[np.float64]:
    """Gravity in n directions; a small spread leaves them about z."""
    rng = np.random.default_rng(seed)
    towards = np.array([0.0, 0.0, 1.0]) + spread * rng.standard_normal((n, 3))
    return GRAVITY * towards / np.linalg.norm(towards, axis=1)[:, None]


def mixed(seed: int = 4) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A matrix with known singular values, 12, 9 and 5."""
    left, right = Rotation.random(2, random_state=seed).as_matrix()
    return left @ np.diag([12.0, 9.0, 5.0]) @ right, np.array([12.0, 9.0, 5.0])


@pytest.mark.parametrize("spread", [0.1, 0.5, 3.0])
def test_semi_axes_are_gravity_times_the_singular_values(spread: float) -> None:
    K, values = mixed()
    gravity = pulls(spread=spread)
    force = gravity @ K.T + np.array([30.0, -200.0, 4.0])
    ellipsoid = force_ellipsoid(force, gravity)
    np.testing.assert_allclose(ellipsoid.semi_axes, GRAVITY * values, rtol=1e-9)
    np.testing.assert_allclose(ellipsoid.centre, (30.0, -200.0, 4.0), atol=1e-9)
    assert ellipsoid.ratio == pytest.approx(12.0 / 5.0)


def test_every_point_lies_on_the_ellipsoid_that_is_drawn() -> None:
    K, _ = mixed()
    gravity = pulls(spread=2.0)
    points = gravity @ K.T + 7.0
    ellipsoid = force_ellipsoid(points, gravity)
    on_sphere = np.linalg.solve(ellipsoid.axes, (points - ellipsoid.centre).T)
    np.testing.assert_allclose(np.linalg.norm(on_sphere, axis=0), 1.0, rtol=1e-8)


def test_semi_axes_do_not_depend_on_the_frame() -> None:
    K, _ = mixed()
    gravity = pulls()
    force = gravity @ K.T
    R = Rotation.from_rotvec([0.3, -1.0, 0.4]).as_matrix()
    turned, plain = force_ellipsoid(force @ R.T, gravity @ R.T), force_ellipsoid(force, gravity)
    np.testing.assert_allclose(turned.semi_axes, plain.semi_axes, rtol=1e-10)


def test_missing_samples_are_left_out() -> None:
    K, values = mixed()
    gravity = pulls()
    force = gravity @ K.T
    force[5, 1] = gravity[9, 0] = np.nan
    np.testing.assert_allclose(force_ellipsoid(force, gravity).semi_axes, GRAVITY * values, rtol=1e-9)


def test_what_draws_no_ellipsoid_is_refused() -> None:
    gravity = pulls()
    planar = gravity.copy()
    planar[:, 1] = 0.0
    with pytest.raises(ValueError, match=r"Gravity stays in a plane .* turn the limb about a second axis"):
        force_ellipsoid(planar, planar)
    with pytest.raises(ValueError, match="Only 3 rows are finite, and four are the least"):
        force_ellipsoid(gravity[:3], gravity[:3])


@pytest.mark.parametrize("mass", [0.703, 0.05, -0.1])
def test_an_added_mass_is_weighed_and_located(mass: float) -> None:
    gravity, place = pulls(spread=0.3), np.array([0.22, 0.108, 0.37])
    first = LIMB.mass_com + mass * place
    wrench = np.concatenate([(LIMB.mass + mass) * gravity, np.cross(first, gravity)], axis=1)
    wrench[3] = np.nan
    found = added_mass(wrench, gravity, LIMB)
    assert found.mass == pytest.approx(mass, rel=1e-9)
    np.testing.assert_allclose(found.position, place, rtol=1e-8)


def test_one_direction_does_not_locate_a_mass() -> None:
    found = added_mass(np.ones((9, 6)), np.tile([0.0, 0.0, 9.81], (9, 1)), LIMB)
    assert np.isnan(found.position).all()
    assert np.isfinite(found.mass)


def test_a_limb_at_rest_has_no_wrench_of_motion() -> None:
    data = InSituSet(np.zeros((4, 6)), pulls(4), added_mass=0.5, added_com=(0.1, 0.0, 0.3))
    np.testing.assert_array_equal(motion_wrench(data, LIMB), 0.0)


def test_an_offset_is_found_without_knowing_what_hangs_there() -> None:
    rng = np.random.default_rng(6)
    gravity, A = pulls(spread=0.3), rng.standard_normal((8, 6)) * np.repeat([30.0, 900.0], 3)
    wrench = np.concatenate([5.2 * gravity, np.cross((0.3, 0.1, 0.9), gravity)], axis=1)
    offset = 1e4 * rng.standard_normal(8)
    raw = wrench @ A.T + offset
    raw[7, 2] = np.nan
    for noise in (None, np.diag(np.arange(1.0, 9.0))):
        np.testing.assert_allclose(offset_of_set(raw, gravity, A, noise), offset, rtol=1e-8)


def test_a_limb_that_turns_slowly_is_no_point():
    # At 2 deg/s its inertia about its centre of mass moves the answer by more than the noise does.
    matrix, mass, com, _ = SENSORS["leg"]
    nees = []
    for seed in range(3):
        sets, _ = moving_sets(np.random.default_rng(seed), 0.2, slower=15.0)
        still = [replace(one, angular_velocity=None, angular_acceleration=None) for one in sets]
        fit, sure = calibrate_in_situ(still), calibrate_in_situ(sets)
        square = normalise_error(fit, np.linalg.inv(matrix), np.full(6, 500.0), Limb(mass, mass * com))
        nees.append(square / len(fit.covariance))
    # As a point it were 6.
    assert 0.5 < np.mean(nees) < 2.5
    assert sure.limb_mass_std < 0.5 * fit.limb_mass_std
