"""The IMU on a limb: its errors, the limb's motion, and smoothing of slow motion."""

from surefoot.calibration.imu.accelerometer import (
    AccelerometerFit,
    AccelerometerModel,
    calibrate_accelerometer,
)
from surefoot.calibration.imu.motion import ImuMotion, gravity_from_imu
from surefoot.calibration.imu.static import savitzky_golay

__all__ = [
    "AccelerometerFit",
    "AccelerometerModel",
    "ImuMotion",
    "calibrate_accelerometer",
    "gravity_from_imu",
    "savitzky_golay",
]
