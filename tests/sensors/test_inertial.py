"""IMU and encoders against their own specification."""

from dataclasses import replace
from math import tau

import numpy as np
import pytest
from _streams import stream

from surefoot.sensors import Encoders, Imu, encoders, imu, preset

MANY = 10_000
QUIET = Imu(
    accelerometer_bias_std=0.0,
    gyroscope_bias_std=0.0,
    accelerometer_walk=0.0,
    gyroscope_walk=0.0,
    accelerometer_noise=0.0,
    gyroscope_noise=0.0,
)


def read(config: Imu, value: list[float], count: int = MANY) -> np.ndarray:
    """Return the first sample of many IMUs, shape (N, 6)."""
    rng, stage, truth = np.random.default_rng(0), imu(config), np.array(value)
    return np.array([stage.apply(truth, stage.init((6,), rng), rng, 0.01)[0] for _ in range(count)])


def test_samples_are_whole_steps_within_the_range() -> None:
    sample = read(QUIET, [0.005, -30.0, 30.0, 1e-4, -9.0, 9.0], count=1)[0]
    assert sample[0] == pytest.approx(0.0096)
    assert sample[1:3] == pytest.approx([-19.62, 19.62], abs=0.0096)
    assert sample[3] == 0.0
    assert sample[4:] == pytest.approx([-8.72665, 8.72665], abs=2.7e-4)


def test_biases_have_their_spread_and_walk() -> None:
    config = replace(
        QUIET, accelerometer_bias_std=0.05, gyroscope_bias_std=1e-3, accelerometer_resolution=0.0
    )
    config = replace(config, gyroscope_resolution=0.0)
    sample = read(config, [0.0] * 6)
    np.testing.assert_allclose(sample.std(axis=0), [0.05] * 3 + [1e-3] * 3, rtol=0.03)
    config = replace(config, accelerometer_bias_std=0.0, gyroscope_bias_std=0.0)
    config = replace(config, accelerometer_walk=2e-3, gyroscope_walk=5e-4)
    for steps in (1, 5):
        sample = stream(imu(config), np.zeros((MANY * steps, 6)), dt=1.0 / steps)
        walked = np.diff(sample[::steps], axis=0)
        np.testing.assert_allclose(walked.std(axis=0), [2e-3] * 3 + [5e-4] * 3, rtol=0.03)


def test_noise_follows_its_density() -> None:
    config = replace(QUIET, accelerometer_noise=2e-3, gyroscope_noise=5e-4)
    config = replace(config, accelerometer_resolution=0.0, gyroscope_resolution=0.0)
    for dt in (0.01, 0.0025):
        sample = stream(imu(config), np.zeros((MANY, 6)), dt=dt)
        np.testing.assert_allclose(sample.std(axis=0), np.repeat([2e-3, 5e-4], 3) / dt**0.5, rtol=0.03)


def test_encoders_have_12_bits_a_turn() -> None:
    rng = np.random.default_rng(1)
    config = Encoders(bias_std=0.0, noise_std=0.0)
    stage = encoders(config)
    angle = np.linspace(-1.0, 1.0, 5001)
    reading, _ = stage.apply(angle, stage.init(angle.shape, rng), rng, 0.01)
    assert config.resolution == pytest.approx(tau / 4096)
    np.testing.assert_allclose(reading / config.resolution, np.round(reading / config.resolution), atol=1e-9)
    assert np.abs(reading - angle).max() <= 0.5 * config.resolution + 1e-12


def test_encoders_have_a_constant_offset_and_fresh_noise() -> None:
    rows = stream(encoders(Encoders(bits=0)), np.zeros((2, MANY)), seed=2, dt=0.01)
    assert rows[0].std() == pytest.approx((1e-3**2 + 3e-4**2) ** 0.5, rel=0.03)
    assert (rows[1] - rows[0]).std() == pytest.approx(3e-4 * 2**0.5, rel=0.03)


def test_perfect_instruments_have_no_resolution() -> None:
    assert preset("perfect", Encoders).resolution == 0.0
    assert preset("perfect", Imu).accelerometer_resolution == 0.0


def test_scales_and_axes_are_off_by_their_spreads_and_stay_so() -> None:
    config = replace(
        preset("perfect", Imu), accelerometer_scale_std=0.02, gyroscope_scale_std=0.05, misalignment_std=0.01
    )
    truth = [9.0, 0.0, 0.0, 0.0, 2.0, 0.0]
    off = read(config, truth) - truth
    expected = [0.02 * 9.0, 0.01 * 9.0, 0.01 * 9.0, 0.01 * 2.0, 0.05 * 2.0, 0.01 * 2.0]
    np.testing.assert_allclose(off.std(axis=0), expected, rtol=0.03)
    assert np.abs(np.corrcoef(off.T) - np.eye(6)).max() < 0.03
    later = stream(imu(config), np.tile(truth, (20, 1)))
    np.testing.assert_array_equal(later, np.tile(later[0], (20, 1)))


def test_a_misaligned_axis_feels_the_others_of_its_own_sensor_alone() -> None:
    rng = np.random.default_rng(3)
    stage = imu(replace(preset("perfect", Imu), misalignment_std=0.1))
    state = stage.init((6,), rng)
    response = np.stack([stage.apply(row, state, rng, 0.01)[0] for row in np.eye(6)], axis=1)
    np.testing.assert_array_equal(response[:3, 3:], 0.0)
    np.testing.assert_array_equal(response[3:, :3], 0.0)
    np.testing.assert_array_equal(np.diag(response), 1.0)
    np.testing.assert_array_equal(response[:3, :3], state.matrix[0])


def test_a_range_clips_what_a_wrong_scale_reads() -> None:
    config = replace(preset("perfect", Imu), accelerometer_scale_std=0.3, accelerometer_range=10.0)
    sample = read(config, [9.0] * 6)
    assert sample[:, :3].max() == 10.0
    assert sample[:, 3:].max() == 9.0


def test_an_imu_with_true_axes_draws_what_it_drew_before() -> None:
    rng = np.random.default_rng(4)
    state = imu(Imu()).init((6,), rng)
    again = np.random.default_rng(4)
    spread = np.repeat([0.05, 1e-3], 3)
    np.testing.assert_array_equal(state.bias, spread * again.standard_normal(6))
    assert state.matrix == ()
    assert rng.random() == again.random()
