"""The ground's force from the robot's motion, against mechanics written down another way."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surefoot.calibration.centroidal import ground_height, ground_reference
from surefoot.calibration.reference import GRAVITY, Reference

SERIES = (6,)


def beliefs(com, acceleration, rate, height=0.0):
    """A reference with both feet on level ground at a height."""
    series = com.shape[:-1]
    position = np.zeros((*series, 2, 3))
    position[..., 1] = (0.05, -0.05)
    position[..., 2] = np.asarray(height)[..., None]
    still = np.zeros((*series, 3))
    return Reference(
        com=com,
        com_acceleration=acceleration,
        angular_momentum_rate=rate,
        position_sole=position,
        R_level_sole=np.broadcast_to(np.eye(3), (*series, 2, 3, 3)),
        stance=np.ones((*series, 2), dtype=bool),
        swing=np.zeros((*series, 2), dtype=bool),
        accelerometer=still,
        gyroscope=still,
    )


def moving(rng, series=SERIES):
    com = rng.uniform((-1.0, -1.0, 0.5), (1.0, 1.0, 2.5), (*series, 3))
    acceleration = rng.uniform(-2.0, 2.0, (*series, 3))
    rate = rng.uniform(-3.0, 3.0, (*series, 3))
    return beliefs(com, acceleration, rate, np.full(series, 0.1))


@settings(deadline=None, derandomize=True, max_examples=100)
@given(seed=st.integers(0, 10**6), height=st.floats(-1.0, 1.0), size=st.floats(-1.0, 2.0))
def test_recovers_the_forces_that_make_the_motion(seed, height, size):
    rng = np.random.default_rng(seed)
    mass = 5.0 * 10.0**size
    point = np.column_stack([rng.uniform(-0.3, 0.3, (8, 2)), np.full(8, height)])
    force = rng.uniform(-1.0, 1.0, (8, 3)) * mass + np.array([0.0, 0.0, mass * GRAVITY / 6])
    com = rng.uniform(-0.2, 0.2, 3) + np.array([0.0, 0.0, height + 0.3])
    acceleration = force.sum(axis=0) / mass - (0.0, 0.0, GRAVITY)
    rate = np.cross(point - com, force).sum(axis=0)

    found = ground_reference(beliefs(com, acceleration, rate, height), mass)

    cop = np.sum(point[:, :2] * force[:, 2:], axis=0) / force[:, 2].sum()
    np.testing.assert_allclose(found.vgrf, force[:, 2].sum(), rtol=1e-12)
    np.testing.assert_allclose(found.cop, cop, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.moment, cop * force[:, 2].sum(), rtol=1e-11, atol=1e-11 * mass)


def test_agrees_with_the_zero_moment_point_of_moving_masses():
    rng = np.random.default_rng(8)
    masses = rng.uniform(0.2, 1.0, 7)
    centre = rng.uniform((-0.2, -0.2, 0.2), (0.2, 0.2, 0.6), (7, 3))
    amplitude, frequency = rng.uniform(-0.05, 0.05, (7, 3)), rng.uniform(2.0, 6.0, (7, 3))

    def position(t):
        return centre + amplitude * np.sin(frequency * t)

    def velocity(t):
        return amplitude * frequency * np.cos(frequency * t)

    def acceleration(t):
        return -amplitude * frequency**2 * np.sin(frequency * t)

    def mean(values):
        return masses @ values / masses.sum()

    def angular_momentum(t):
        arm = position(t) - mean(position(t))
        return np.cross(arm, masses[:, None] * (velocity(t) - mean(velocity(t)))).sum(axis=0)

    h, step, height = 0.37, 1e-5, 0.02
    rate = (angular_momentum(h + step) - angular_momentum(h - step)) / (2 * step)
    found = ground_reference(
        beliefs(mean(position(h)), mean(acceleration(h)), rate, height), float(masses.sum())
    )

    # Each mass's inertial force taken to the ground by itself (Vukobratovic): no centre of mass, no L.
    inertial = masses[:, None] * (acceleration(h) + np.array([0.0, 0.0, GRAVITY]))
    arm = position(h) - (0.0, 0.0, height)
    moment = np.cross(arm, inertial).sum(axis=0)
    total = inertial.sum(axis=0)
    np.testing.assert_allclose(found.vgrf, total[2], rtol=1e-13)
    np.testing.assert_allclose(found.cop, [-moment[1] / total[2], moment[0] / total[2]], atol=1e-8)


def test_a_linear_inverted_pendulum_rolls_over_its_pivot():
    # Standing on a point, x'' = g / h (x - p): the centre of pressure is that point.
    pivot, height = np.array([0.03, -0.02]), 0.3
    com = np.array([0.05, 0.01, height])
    acceleration = np.array([*(GRAVITY / height * (com[:2] - pivot)), 0.0])
    found = ground_reference(beliefs(com, acceleration, np.zeros(3)), 5.3)
    np.testing.assert_allclose(found.cop, pivot, atol=1e-15)


def test_quasi_static_leaves_the_motion_out():
    reference = moving(np.random.default_rng(9))
    found = ground_reference(reference, 5.3, quasi_static=True)
    np.testing.assert_allclose(found.vgrf, 5.3 * GRAVITY)
    np.testing.assert_allclose(found.cop, reference.com[..., :2], rtol=1e-14)
    still = reference._replace(
        com_acceleration=np.zeros_like(reference.com), angular_momentum_rate=np.zeros_like(reference.com)
    )
    for ours, theirs in zip(ground_reference(still, 5.3), found, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-13)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(seed=st.integers(0, 10**6), angle=st.floats(-3.0, 3.0), x=st.floats(-5.0, 5.0), z=st.floats(-5.0, 5.0))
def test_does_not_care_about_the_level_frame(seed, angle, x, z):
    reference = moving(np.random.default_rng(seed))
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([x, -x / 2, z])
    moved = reference._replace(
        com=reference.com @ turn.T + shift,
        com_acceleration=reference.com_acceleration @ turn.T,
        angular_momentum_rate=reference.angular_momentum_rate @ turn.T,
        position_sole=reference.position_sole @ turn.T + shift,
    )
    here, there = ground_reference(reference, 5.3), ground_reference(moved, 5.3)
    np.testing.assert_allclose(there.vgrf, here.vgrf, rtol=1e-14)
    np.testing.assert_allclose(there.cop, here.cop @ turn[:2, :2].T + shift[:2], atol=1e-12)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(factor=st.floats(0.3, 100.0))
def test_a_heavier_robot_of_the_same_shape_presses_at_the_same_place(factor):
    reference = moving(np.random.default_rng(10))
    heavier = reference._replace(angular_momentum_rate=factor * reference.angular_momentum_rate)
    one, other = ground_reference(reference, 5.3), ground_reference(heavier, 5.3 * factor)
    np.testing.assert_allclose(other.vgrf, factor * one.vgrf, rtol=1e-13)
    np.testing.assert_allclose(other.cop, one.cop, atol=1e-12)


def test_there_is_no_centre_of_pressure_in_free_fall():
    reference = moving(np.random.default_rng(11))
    acceleration = reference.com_acceleration.copy()
    acceleration[0, 2] = -GRAVITY
    acceleration[1, 2] = np.nan
    found = ground_reference(reference._replace(com_acceleration=acceleration), 5.3)
    np.testing.assert_array_equal(np.isnan(found.cop).all(axis=-1), [True, True] + [False] * 4)
    np.testing.assert_allclose(found.vgrf[0], 0.0, atol=1e-12)
    assert np.isfinite(found.moment[0]).all()


def test_the_ground_is_under_the_lower_sole():
    reference = beliefs(np.zeros((5, 3)), np.zeros((5, 3)), np.zeros((5, 3)))
    height = np.array([[0.1, 0.3]] * 4 + [[0.1, np.nan]])
    position = reference.position_sole.copy()
    position[..., 2] = height
    found = ground_height(reference._replace(position_sole=position))
    np.testing.assert_allclose(found, position[..., 2].min(axis=-1))
    given_height = ground_reference(reference, 5.3, height=np.full(5, -2.0))
    np.testing.assert_allclose(given_height.cop, 0.0, atol=1e-15)


def test_a_series_is_its_samples():
    reference = moving(np.random.default_rng(12))
    kept = [field.copy() for field in reference]
    found = ground_reference(reference, 5.3)
    for i in range(*SERIES):
        alone = ground_reference(Reference(*(field[i] for field in reference)), 5.3)
        for together, single in zip(found, alone, strict=True):
            np.testing.assert_allclose(together[i], single, rtol=1e-14)
    for before, after in zip(kept, reference, strict=True):
        np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("field", ["com", "com_acceleration", "angular_momentum_rate", "position_sole"])
def test_refuses_fields_of_another_shape(field):
    reference = moving(np.random.default_rng(14))._replace(**{field: np.zeros((6, 5))})
    with pytest.raises(ValueError, match=re.escape(f"'{field}' must have shape (..., ")):
        ground_reference(reference, 5.3)
