"""Six-axis sensors: their matrices, zeros, noise and drift, and the map that undoes them."""

from dataclasses import replace

import numpy as np
import pytest
from _refusals import refusals

from surefoot.sensors import ForceTorque, force_torque, preset
from surefoot.sensors.devices.force_torque import true_matrix
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE

CONFIG = ForceTorque()
QUIET = replace(
    CONFIG,
    noise_force=0.0,
    noise_torque=0.0,
    scale_drift=0.0,
    offset_drift_force=0.0,
    offset_drift_torque=0.0,
    resolution_force=0.0,
    resolution_torque=0.0,
)
EQUAL_AT_POWER_UP = {
    "initial_scale_std": 0.0,
    "initial_offset_force_std": 0.0,
    "initial_offset_torque_std": 0.0,
}
WRENCH = np.array([4.0, -3.0, 52.0, 1.2, -0.8, 0.3] * 2)


def test_a_quiet_sensor_is_an_affine_map():
    rng = np.random.default_rng(0)
    sensor = force_torque(QUIET)
    state = sensor.init((12,), rng)

    def read(wrench):
        return sensor.apply(wrench, state, rng, 0.01)[0]

    zero = read(np.zeros(12))
    matrix = np.stack([read(row) - zero for row in np.eye(12)], axis=1)
    np.testing.assert_allclose(read(WRENCH), matrix @ WRENCH + zero, rtol=1e-12)
    # One sensor feels nothing of the other.
    assert not matrix[:6, 6:].any()
    assert not matrix[6:, :6].any()
    C, o = true_matrix(QUIET, state)
    assert (C.shape, o.shape) == ((2, 6, 6), (2, 6))
    for sensor_number in range(2):
        part = slice(6 * sensor_number, 6 * sensor_number + 6)
        np.testing.assert_allclose(C[sensor_number] @ matrix[part, part], np.eye(6), atol=1e-12)
        np.testing.assert_allclose(o[sensor_number], zero[part])


def test_the_true_matrix_undoes_the_errors_of_the_moment():
    """w = C (s - o) up to half a count (in-situ paper, Eq. 2), while everything drifts."""
    rng = np.random.default_rng(1)
    config = replace(CONFIG, noise_force=0.0, noise_torque=0.0, scale_drift=0.02, offset_drift_force=0.5)
    sensor = force_torque(config)
    state = sensor.init((12,), rng)
    for _ in range(300):
        counts, state = sensor.apply(WRENCH, state, rng, 0.01)
        C, o = true_matrix(config, state)
        wrench = np.einsum("sij,sj->si", C, counts.reshape(2, 6) - o).ravel()
        half = 0.5 * np.abs(C).sum(axis=2).ravel()
        assert (np.abs(wrench - WRENCH) <= half + 1e-9).all()
    np.testing.assert_array_equal(counts, np.round(counts))


def test_errors_at_power_up_have_their_spread():
    state = force_torque(replace(CONFIG, sensors=8000)).init((48_000,), np.random.default_rng(2))
    diagonal = np.diagonal(state.error, axis1=1, axis2=2)
    beside = state.error[:, ~np.eye(6, dtype=bool)]
    assert diagonal.std() == pytest.approx(0.08, rel=0.02)
    assert beside.std() == pytest.approx(0.01, rel=0.02)
    assert state.offset[:, :3].std() == pytest.approx(5.0, rel=0.02)
    assert state.offset[:, 3:].std() == pytest.approx(0.1, rel=0.02)


def test_cross_talk_is_a_share_of_the_full_scales():
    """A full force reads as cross-talk times the full torque, and the other way round."""
    config = replace(QUIET, sensors=2000, **EQUAL_AT_POWER_UP)
    sensor, rng = force_torque(config), np.random.default_rng(3)
    state = sensor.init((12_000,), rng)
    force = np.zeros((2000, 6))
    force[:, 2] = config.full_scale_force
    read = sensor.apply(force.ravel(), state, rng, 0.01)[0].reshape(2000, 6)
    np.testing.assert_allclose(read[:, 2], config.full_scale_force)
    assert read[:, 3:6].std() == pytest.approx(0.01 * config.full_scale_torque, rel=0.05)
    assert read[:, :2].std() == pytest.approx(0.01 * config.full_scale_force, rel=0.05)


@pytest.mark.parametrize("steps", [6, 60])
def test_drift_depends_on_time_and_not_on_the_step(steps):
    rng = np.random.default_rng(4)
    config = replace(CONFIG, sensors=4000, **EQUAL_AT_POWER_UP)
    sensor = force_torque(config)
    state = sensor.init((24_000,), rng)
    talk = state.error[:, ~np.eye(6, dtype=bool)]
    for _ in range(steps):
        _, state = sensor.apply(np.zeros(24_000), state, rng, 60.0 / steps)
    diagonal = np.diagonal(state.error, axis1=1, axis2=2)
    assert diagonal.std() == pytest.approx(0.002, rel=0.03)
    assert state.offset[:, :3].std() == pytest.approx(0.2, rel=0.03)
    assert state.offset[:, 3:].std() == pytest.approx(0.004, rel=0.03)
    np.testing.assert_array_equal(state.error[:, ~np.eye(6, dtype=bool)], talk)
    assert config.offset_drift_force == pytest.approx(0.2 * PER_SQRT_MINUTE)


def test_noise_and_steps_are_those_seen_on_a_real_robot():
    rng = np.random.default_rng(5)
    sensor = force_torque(CONFIG)
    state = sensor.init((12,), rng)
    read = np.array([sensor.apply(WRENCH, state, rng, 0.01)[0] for _ in range(4000)]) * CONFIG.nominal_scale
    spread = read.std(axis=0).reshape(2, 2, 3)
    # The step adds its own uniform error, and one step of the walk 2 mN.
    np.testing.assert_allclose(spread[:, 0], np.hypot(0.12, 0.06 / np.sqrt(12.0)), rtol=0.06)
    np.testing.assert_allclose(spread[:, 1], np.hypot(0.0025, 0.0011 / np.sqrt(12.0)), rtol=0.06)


def test_the_makers_matrix_knows_no_error():
    np.testing.assert_allclose(CONFIG.nominal_matrix[1], np.diag([0.06] * 3 + [0.0011] * 3))
    np.testing.assert_allclose(QUIET.nominal_matrix[0], np.eye(6))


def test_counts_end_at_full_scale():
    rng = np.random.default_rng(6)
    sensor = force_torque(CONFIG)
    read, _ = sensor.apply(np.full(12, 1e5), sensor.init((12,), rng), rng, 0.01)
    np.testing.assert_array_equal(read, CONFIG.code_range[1])
    np.testing.assert_allclose(read * CONFIG.nominal_scale, CONFIG.full_scale, rtol=1e-3)


def test_a_perfect_sensor_has_a_perfect_map():
    config = preset("perfect", ForceTorque)
    C, o = true_matrix(config, force_torque(config).init((12,), np.random.default_rng(7)))
    np.testing.assert_array_equal(C, np.tile(np.eye(6), (2, 1, 1)))
    np.testing.assert_array_equal(o, 0.0)


test_impossible_values_are_refused = refusals(
    lambda fields: ForceTorque(**fields),
    ({"sensors": 0}, "ForceTorque.sensors must be a whole number from 1 on, got 0"),
    ({"noise_force": -0.1}, "ForceTorque.noise_force must be finite and not negative, got -0.1"),
    ({"full_scale_torque": 0.0}, "ForceTorque.full_scale_torque must be finite and positive, got 0.0"),
    ({"resolution_force": 0.0}, "ForceTorque.resolution_torque must be zero if and only if"),
    ({"cross_talk_std": 0.1}, "ForceTorque.cross_talk_std must keep .* within 0.25, .* got 0.1"),
)


def test_wrong_channels_are_refused():
    with pytest.raises(ValueError, match=r"must hold the 12 channels, got shape \(6,\); give \(12,\)"):
        force_torque(CONFIG).init((6,), np.random.default_rng(8))
