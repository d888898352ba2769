"""IMU and encoders against their own specification."""

from dataclasses import replace
from math import tau

import numpy as np
import pytest

from surefoot.sensors import Encoders, Imu, encoders, imu, preset

MANY = 20_000
QUIET = Imu(
    accelerometer_bias_std=0.0,
    gyroscope_bias_std=0.0,
    accelerometer_walk=0.0,
    gyroscope_walk=0.0,
    accelerometer_noise=0.0,
    gyroscope_noise=0.0,
)


def read(config: Imu, value: list[float], steps: int = 1, dt: float = 0.01, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    stage = imu(config)
    state = stage.init((MANY, 6), rng)
    truth = np.tile(np.array(value), (MANY, 1))
    for _ in range(steps):
        sample, state = stage.apply(truth, state, rng, dt)
    return sample


def test_samples_are_whole_steps_within_the_range() -> None:
    sample = read(QUIET, [0.005, -30.0, 30.0, 1e-4, -9.0, 9.0])[0]
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
    for dt in (0.01, 0.1):
        sample = read(config, [0.0] * 6, steps=round(1.0 / dt), dt=dt)
        np.testing.assert_allclose(sample.std(axis=0), [2e-3] * 3 + [5e-4] * 3, rtol=0.03)


def test_noise_follows_its_density() -> None:
    config = replace(QUIET, accelerometer_noise=2e-3, gyroscope_noise=5e-4)
    config = replace(config, accelerometer_resolution=0.0, gyroscope_resolution=0.0)
    for dt in (0.01, 0.0025):
        sample = read(config, [0.0] * 6, dt=dt)
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


def test_encoders_have_a_constant_zero_and_fresh_noise() -> None:
    rng = np.random.default_rng(2)
    stage = encoders(Encoders(bits=0))
    state = stage.init((MANY,), rng)
    rows = []
    for _ in range(2):
        reading, state = stage.apply(np.zeros(MANY), state, rng, 0.01)
        rows.append(reading)
    assert rows[0].std() == pytest.approx((1e-3**2 + 3e-4**2) ** 0.5, rel=0.03)
    assert (rows[1] - rows[0]).std() == pytest.approx(3e-4 * 2**0.5, rel=0.03)


def test_perfect_instruments_have_no_resolution() -> None:
    assert preset("perfect", Encoders).resolution == 0.0
    assert preset("perfect", Imu).averaged is False
