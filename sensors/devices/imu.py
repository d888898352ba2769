"""An accelerometer and a gyroscope in one chip: six channels (ax, ay, az, wx, wy, wz) in its own axes."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.sensors.configuration import Error, NotNegative, check_fields
from surefoot.sensors.corruption import Corruption, Rng, check_channels, device, limit
from surefoot.sensors.randomness import normal

NO_STEP = 2.0**-60
"""Step of a sensor that does not round beside one that does: far below the resolution of any float."""


@dataclass(frozen=True)
class Imu:
    """An inertial measurement unit; the defaults are a NAO V5's, at a resolution read off a real log.

    Noise, biases and walks are typical of consumer chips; a bias is the rest after the usual
    zeroing of the gyroscope at rest.
    """

    accelerometer_noise: Error = 2.0e-3
    """Noise density of the specific force in m/s^2/sqrt(Hz)."""

    gyroscope_noise: Error = 5.0e-4
    """Noise density of the angular velocity in rad/s/sqrt(Hz)."""

    accelerometer_bias_std: Error = 0.05
    """Standard deviation of the bias at power-up in m/s^2."""

    gyroscope_bias_std: Error = 1.0e-3
    """Standard deviation of the bias at power-up in rad/s."""

    accelerometer_walk: Error = 2.0e-4
    """Random walk of the bias in m/s^2/sqrt(s)."""

    gyroscope_walk: Error = 5.0e-5
    """Random walk of the bias in rad/s/sqrt(s)."""

    accelerometer_resolution: NotNegative = 0.0096
    """Smallest step in m/s^2; 0 does not round."""

    gyroscope_resolution: NotNegative = 2.7e-4
    """Smallest step in rad/s; 0 does not round."""

    accelerometer_range: NotNegative = 2.0 * 9.81
    """Largest specific force in m/s^2; 0 does not clip."""

    gyroscope_range: NotNegative = 8.72665
    """Largest angular velocity in rad/s (500 degrees/s); 0 does not clip."""

    accelerometer_scale_std: Error = 0.0
    """Standard deviation of the relative error of each accelerometer's scale, constant from power-up; 0.01 to
    0.03 is typical of consumer chips."""

    gyroscope_scale_std: Error = 0.0
    """The same for each gyroscope; 0.01 to 0.03 as well."""

    misalignment_std: Error = 0.0
    """Standard deviation of the angles by which each sensor's axis is tilted towards the two others, in rad,
    constant from power-up; 0.01 is a chip's by its data sheet, mounting on a robot adds as much."""

    averaged: bool = True
    """Whether a sample is the mean since the sample before, as the chip's own anti-alias filter makes
    it, and so stands for the middle of that time; ``False`` takes the value of the instant."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value is impossible."""
        check_fields(self)


class ImuState(NamedTuple):
    """An IMU in use."""

    bias: Floats  # (ax, ay, az) in m/s^2 and (wx, wy, wz) in rad/s, shape (6,)
    matrix: Any = ()
    """Readings of the accelerometers and the gyroscopes of the three components (row: the sensor, column: the
    component), shape (2, 3, 3), constant from power-up; ``()`` for axes that are right."""


def _pair(accelerometer: float, gyroscope: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.repeat([accelerometer, gyroscope], 3)


@device
def imu(config: Imu) -> Corruption[ImuState]:
    """Build an IMU: axes a little off, a drifting bias, and samples that are noisy, clipped and rounded.

    Angles are small: an axis tilted by e reads its own component in full and the share e of another.

    Readings are specific force in m/s^2 and angular velocity in rad/s, shape (6,).
    """
    walk = _pair(config.accelerometer_walk, config.gyroscope_walk)
    noise = _pair(config.accelerometer_noise, config.gyroscope_noise)
    bias_std = _pair(config.accelerometer_bias_std, config.gyroscope_bias_std)
    resolution = _pair(config.accelerometer_resolution, config.gyroscope_resolution)
    rounds = bool(resolution.any())
    step = np.where(resolution > 0.0, resolution, NO_STEP)
    most = _pair(config.accelerometer_range, config.gyroscope_range)
    clips = bool(most.any())
    highest = np.where(most > 0.0, most, np.inf)
    scales = np.array([config.accelerometer_scale_std, config.gyroscope_scale_std])[:, None, None]
    axes = np.eye(3)
    spread = scales * axes + config.misalignment_std * (1.0 - axes)
    skewed = bool(spread.any())

    def init(shape: tuple[int, ...], rng: Rng) -> ImuState:
        check_channels(shape, 6)
        bias = bias_std * normal(rng, shape)
        return ImuState(bias, axes + spread * normal(rng, (2, 3, 3)) if skewed else ())

    def apply(reading: Floats, state: ImuState, rng: Rng, dt: float) -> tuple[Floats, ImuState]:
        of_walk, of_noise = normal(rng, (2, 6))
        bias = state.bias + dt**0.5 * walk * of_walk
        felt = (state.matrix * reading.reshape(2, 1, 3)).sum(axis=2).ravel() if skewed else reading
        measured = felt + bias + dt**-0.5 * noise * of_noise
        if clips:
            measured = limit(measured, -highest, highest)
        if rounds:
            measured = np.rint(measured / step) * step
        return measured, ImuState(bias, state.matrix)

    return Corruption(init, apply)
