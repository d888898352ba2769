"""A robot's state estimate at one sample, with which the foot sensors are compared.

It is computed from encoders, an IMU and a model of the robot, never from the foot sensors. Positions are in
any *level* frame: z is opposite to gravity, and the origin and heading are free as long as all fields of a
sample share them, because calibrators only use differences.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.calibration.arrays import Array

GRAVITY = 9.81
"""Standard acceleration of free fall used throughout, in m/s^2."""

_DIGITS = 2e-3  # tolerance in units of 0.981 N: newtons written with three decimals


def look_like_newtons(masses: ArrayLike) -> bool:
    """Return whether nonzero masses in kg look like weights in newtons of whole tenths of a kilogram."""
    different = np.unique(masses)
    tenths = 10.0 / GRAVITY * different[different != 0.0]
    whole = np.maximum(np.rint(tenths), 1.0)
    return len(tenths) > 1 and np.allclose(tenths, whole, atol=_DIGITS, rtol=0.0)


class Reference(NamedTuple):
    """One sample of a robot's state estimate. In a log, each field has the samples on its first axis.

    Attributes:
        com: Centre of mass in the level frame in m, shape (3,).
        com_acceleration: Its acceleration without gravity in m/s^2, shape (3,).
        angular_momentum_rate: Rate of the centroidal angular momentum in N m, shape (3,).
        position_sole: Origins of the sole frames in the level frame in m, shape (F, 3).
        R_level_sole: Rotations from the sole frames to the level frame, shape (F, 3, 3).
        stance: Whether each foot is certainly on the ground (bool), shape (F,).
        swing: Whether each foot is certainly in the air (bool), shape (F,). During a transition a foot is
            neither.
        accelerometer: Specific force at the IMU in its own axes in m/s^2, shape (3,).
        gyroscope: Angular velocity of the IMU in its own axes in rad/s, shape (3,).
    """

    com: Array
    com_acceleration: Array
    angular_momentum_rate: Array
    position_sole: Array
    R_level_sole: Array
    stance: Array
    swing: Array
    accelerometer: Array
    gyroscope: Array


class MomentumReference(NamedTuple):
    """One sample of a robot's state estimate as momentum, for the method ``"moment"``.

    A robot measures velocities, not accelerations. All fields describe the *end* of the interval that the
    reading covers, in a level frame that does not move with the robot: a stance sole does not move in it.
    The frame may drift, as odometry does, within the noise of the velocity. In a log, each field has the
    samples on its first axis.

    Attributes:
        com: Centre of mass in m, shape (3,).
        com_velocity: Its velocity in m/s, shape (3,).
        angular_momentum: Angular momentum about the centre of mass in kg m^2/s, shape (3,).
        position_sole: Origins of the sole frames in m, shape (F, 3).
        R_level_sole: Rotations from the sole frames to that frame, shape (F, 3, 3).
        stance: See :class:`Reference`, shape (F,).
        swing: See :class:`Reference`, shape (F,).
    """

    com: Array
    com_velocity: Array
    angular_momentum: Array
    position_sole: Array
    R_level_sole: Array
    stance: Array
    swing: Array


def reference_shapes(feet: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the fields of both kinds of reference by name, for a number of feet."""
    vectors = "com", "com_acceleration", "angular_momentum_rate", "com_velocity", "angular_momentum"
    return dict.fromkeys((*vectors, "accelerometer", "gyroscope"), (3,)) | {
        "position_sole": (feet, 3),
        "R_level_sole": (feet, 3, 3),
        "stance": (feet,),
        "swing": (feet,),
    }
