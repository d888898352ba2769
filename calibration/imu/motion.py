"""The motion of a limb at an F/T sensor, from an IMU anywhere on the limb.

An IMU at p in the sensor's frame reads the specific force f = a_imu - g. For a rigid limb

    a_imu = a + alpha x p + omega x (omega x p)

with the acceleration a of the sensor's origin. The limb's weight at the sensor is proportional to g - a, and

    g - a = -R_sensor_imu f + alpha x p + omega x (omega x p).

The angular acceleration alpha is the derivative of the gyroscope's rate by local polynomials
(Savitzky-Golay), a zero-phase filter for logs. At rest this is g = -R f for any position of the IMU.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.calibration.imu.static import savitzky_golay


class ImuMotion(NamedTuple):
    """A limb's motion in the sensor's frame at the sensor's origin.

    Attributes:
        gravity: g - a in m/s^2, pointing down at rest, shape (n, 3).
        angular_velocity: In rad/s, shape (n, 3).
        angular_acceleration: In rad/s^2, shape (n, 3).
    """

    gravity: Floats
    angular_velocity: Floats
    angular_acceleration: Floats


def gravity_from_imu(
    specific_force: ArrayLike,
    angular_velocity: ArrayLike,
    *,
    dt: float,
    position_imu: ArrayLike = (0.0, 0.0, 0.0),
    R_sensor_imu: ArrayLike | None = None,
    window: int = 15,
    order: int = 3,
) -> ImuMotion:
    """Transfer an IMU's log to the sensor's origin.

    Args:
        specific_force: Calibrated readings of the accelerometer in the IMU's frame in m/s^2, shape (n, 3).
        angular_velocity: Readings of the gyroscope minus its bias in the IMU's frame in rad/s, shape (n, 3).
        dt: Time between samples in s, which must be constant.
        position_imu: Position of the accelerometer in the sensor's frame in m, shape (3,).
        R_sensor_imu: Rotation from the IMU's frame to the sensor's frame, shape (3, 3), by default the
            identity.
        window: Window of the derivative in samples, odd. The noise of alpha decreases with its power of 3/2,
            and motion that is faster than about the window is attenuated.
        order: Order of the polynomials of the derivative.

    Returns:
        The motion at the sensor's origin.

    Raises:
        ValueError: If shapes do not match, ``R_sensor_imu`` is not a rotation, the log is shorter than the
            window, or the gyroscope's log is not finite. Accelerometer samples may be NaN.

    >>> motion = gravity_from_imu(np.tile([0.0, 0.0, 9.81], (40, 1)), np.zeros((40, 3)), dt=0.01)
    >>> motion.gravity[0] + 0.0
    array([ 0.  ,  0.  , -9.81])
    """
    f, omega = np.asarray(specific_force, dtype=np.float64), np.asarray(angular_velocity, dtype=np.float64)
    if f.ndim != 2 or f.shape[1] != 3:
        raise ValueError(f"'specific_force' must have shape (n, 3), got {f.shape}.")
    if omega.shape != f.shape:
        raise ValueError(f"'angular_velocity' must have shape {f.shape}, got {omega.shape}.")
    p = np.asarray(position_imu, dtype=np.float64)
    if p.shape != (3,) or not np.isfinite(p).all():
        raise ValueError(f"'position_imu' must be three finite numbers, got {position_imu!r}.")
    R = np.eye(3) if R_sensor_imu is None else np.asarray(R_sensor_imu, dtype=np.float64)
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0.0:
        raise ValueError(f"'R_sensor_imu' must be a rotation of shape (3, 3), got {R.tolist()}.")
    omega_sensor = omega @ R.T
    alpha = savitzky_golay(omega_sensor, window, order, derivative=1, dt=dt)
    carried = np.cross(alpha, p) + np.cross(omega_sensor, np.cross(omega_sensor, p))
    return ImuMotion(-f @ R.T + carried, omega_sensor, alpha)
