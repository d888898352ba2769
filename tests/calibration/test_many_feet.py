"""Robots on more or fewer feet than two, on one axis a foot or three: a trot, and a tripod's gait of six."""

import numpy as np
import pytest

from surefoot.calibration import FeetLayout, FootLayout, MomentumReference, Reference, replay
from surefoot.calibration.reference import GRAVITY

DT, SECONDS, MASS = 0.01, 16.0, 12.0
WEIGHT, SAMPLES = MASS * GRAVITY, round(SECONDS / DT)
PLACES = {
    1: [(0.0, 0.0)],
    2: [(0.0, 0.05), (0.0, -0.05)],
    3: [(0.2, 0.0), (-0.2, 0.13), (-0.2, -0.13)],
    4: [(0.2, 0.13), (0.2, -0.13), (-0.2, 0.13), (-0.2, -0.13)],
    6: [(0.2, 0.13), (0.2, -0.13), (0.0, 0.16), (0.0, -0.16), (-0.2, 0.13), (-0.2, -0.13)],
}
PLACES |= {feet: [(0.1 * i - 0.4, 0.15 * (-1) ** i) for i in range(feet)] for feet in (8, 9)}
TOGETHER = {2: [0, 1], 3: [0, 1, 1], 4: [0, 1, 1, 0], 6: [0, 1, 1, 0, 0, 1]} | {
    feet: [i % 2 for i in range(feet)] for feet in (8, 9)
}
"""Which feet stand together while the others swing; one foot alone stays down."""


def layout_of(feet, axes="z"):
    return FeetLayout(tuple(FootLayout.point(f"foot {i}", axes) for i in range(feet)))


def move(feet, seed):
    """Forces of the ground (N, F) in N of a robot whose groups of feet stand in turn, and its references."""
    rng, time = np.random.default_rng(seed), np.arange(SAMPLES) * DT
    phase = (1.6 * time) % 1.0
    # Both groups stand between two swings; a foot takes up its load in 0.04 s.
    lifts = np.clip(np.minimum(phase, 0.46 - phase) / 0.06, 0.0, 1.0)
    swings = np.stack(
        [lifts, np.interp((phase + 0.5) % 1.0, np.sort(phase), lifts[np.argsort(phase)])], axis=1
    )
    share = np.ones((SAMPLES, 1)) if feet == 1 else 1.0 - swings[:, TOGETHER[feet]]
    swing = share <= 0.0
    lean = np.sin(2.0 * np.pi * rng.uniform(0.15, 0.4, feet) * time[:, None] + rng.uniform(0.0, 6.0, feet))
    share = share * (1.0 + 0.3 * lean)
    height = 0.3 + 0.01 * np.sin(2.0 * np.pi * 3.2 * time)
    velocity = np.gradient(height, DT)
    # What momentum changes by in an interval is what the forces add up to in it.
    rate = np.diff(velocity, prepend=velocity[0]) / DT
    force = share / share.sum(axis=1, keepdims=True) * MASS * (GRAVITY + rate)[:, None]
    place = np.array(PLACES[feet])
    moment = force @ place
    zero = np.zeros(SAMPLES)
    turning = np.stack([moment[:, 1], -moment[:, 0], zero], axis=1)
    up = np.stack([zero, zero, velocity], axis=1)
    soles = np.broadcast_to(np.column_stack([place, np.zeros(feet)]), (SAMPLES, feet, 3))
    level = np.broadcast_to(np.eye(3), (SAMPLES, feet, 3, 3))
    com = np.stack([zero, zero, height], axis=1)
    return force, MomentumReference(
        com=com, com_velocity=up, angular_momentum=np.cumsum(turning, axis=0) * DT, position_sole=soles,
        R_level_sole=level, stance=~swing & (share > 0.5), swing=swing,
    )  # fmt: skip


def read(force, seed, axes=1):
    """Readings of cells that are off, shape (N, F axes)."""
    rng = np.random.default_rng([seed, 1])
    load = np.zeros((*force.shape, axes))
    load[..., -1] = force
    load = load.reshape(len(force), -1)
    scale, offset = (
        1.0 + 0.12 * rng.standard_normal(load.shape[1]),
        0.03 * WEIGHT * rng.standard_normal(load.shape[1]),
    )
    return (load - offset) / scale + 1e-3 * WEIGHT * rng.standard_normal(load.shape)


def errors(force, expected):
    """Of each foot in N, over the second half."""
    return np.sqrt(np.mean((force - expected)[SAMPLES // 2 :] ** 2, axis=0))


def accelerations(momentum):
    """The same motion as a reference of older kind."""
    zero = np.zeros((SAMPLES, 3))
    rates = (np.gradient(part, DT, axis=0) for part in (momentum.com_velocity, momentum.angular_momentum))
    return Reference(
        momentum.com, *rates, momentum.position_sole, momentum.R_level_sole, momentum.stance, momentum.swing,
        accelerometer=zero, gyroscope=zero,
    )  # fmt: skip


def calibrate(layout, method, raw, reference):
    return replay(layout, method, raw, reference, DT, mass=MASS, initial=None, lag=0, foot_length=0.4)


@pytest.mark.parametrize("feet", [4, 6])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_each_foots_error_is_less_than_half(feet, seed):
    force, reference = move(feet, seed)
    raw, layout = read(force, seed), layout_of(feet)
    found = errors(calibrate(layout, "moment", raw, reference).vgrf, force)
    assert (found < 0.5 * errors(raw, force)).all()
    assert found.max() < 0.01 * WEIGHT


def test_three_axes_a_foot():
    force, reference = move(4, 3)
    raw, layout = read(force, 3, axes=3), layout_of(4, "xyz")
    before = errors(raw[:, 2::3], force)
    estimate = calibrate(layout, "moment", raw, reference)
    assert estimate.wrench.shape == (SAMPLES, 4, 6)
    assert (errors(estimate.vgrf, force) < before).all()
    tared = calibrate(layout, "tare", raw, accelerations(reference))
    assert errors(tared.vgrf, force).mean() < before.mean()


def test_a_point_has_its_own_place_and_all_feet_one_centre_of_pressure():
    force, reference = move(4, 0)
    estimate = calibrate(layout_of(4), "none", force, accelerations(reference))
    loaded = force > 5.0
    np.testing.assert_array_equal(estimate.cop_foot_valid, loaded)
    np.testing.assert_array_equal(estimate.cop_foot[loaded], 0.0)
    expected = force @ np.array(PLACES[4]) / force.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(estimate.cop, expected, atol=1e-12)


@pytest.mark.parametrize("axes", ["", "zx", "w", "zz"])
def test_axes_that_are_none_are_refused(axes):
    with pytest.raises(ValueError, match="must be some of 'xyz' in this order"):
        FootLayout.point("left", axes)


def test_old_references_do_as_well():
    force, momentum = move(4, 5)
    raw = read(force, 5)
    estimate = calibrate(layout_of(4), "moment", raw, accelerations(momentum))
    assert errors(estimate.vgrf, force).mean() < 0.5 * errors(raw, force).mean()
