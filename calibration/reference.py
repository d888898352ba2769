"""A robot's beliefs about itself at one sample: the side that sensors are held against.

Everything here comes from encoders, an IMU and a model of the robot; nothing comes from the feet's
sensors. Positions are given in any *level* frame: z against gravity, the origin and the heading as the
robot likes, as long as all fields of one sample share them (a calibrator only ever takes differences).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.calibration.arrays import Array

GRAVITY = 9.81
"""Standard acceleration of free fall used throughout, in m/s^2."""

_DIGITS = 2e-3  # of a tenth of a kilogram's weight: newtons with three decimals


def look_like_newtons(masses: ArrayLike) -> bool:
    """Return whether masses in kg, zeros aside, are several weights in newtons of tenths of a kilogram."""
    different = np.unique(masses)
    tenths = 10.0 / GRAVITY * different[different != 0.0]
    whole = np.maximum(np.rint(tenths), 1.0)
    return len(tenths) > 1 and np.allclose(tenths, whole, atol=_DIGITS, rtol=0.0)


class Reference(NamedTuple):
    """One sample of a robot's beliefs; a log of N samples has N first in each field.

    Attributes:
        com: Centre of mass in the level frame in m, shape (3,).
        com_acceleration: Its acceleration without gravity in m/s^2, shape (3,).
        angular_momentum_rate: Rate of the centroidal angular momentum in N m, shape (3,).
        position_sole: Origins of the sole frames in the level frame in m, shape (F, 3).
        R_level_sole: Rotations from the sole frames to the level frame, shape (F, 3, 3).
        stance: Feet that the robot is sure to have on the ground (bool), shape (F,).
        swing: Feet that the robot is sure to have in the air (bool), shape (F,). A foot in a
            transition is neither.
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
    """One sample of a robot's beliefs as momentum, for method ``"moment"``; a log has N first in all.

    A robot measures velocities, not accelerations. All fields are of the *end* of the interval that the
    reading covers, in one level frame that neither turns nor moves with the robot: a sole that stands stays
    where it is. That frame may drift, as odometry does, as far as the noise of the velocity allows.

    Attributes:
        com: Centre of mass in m, shape (3,).
        com_velocity: Its velocity in m/s, shape (3,).
        angular_momentum: Angular momentum about the centre of mass in kg m^2/s, shape (3,).
        position_sole: Origins of the sole frames in m, shape (F, 3).
        R_level_sole: Rotations from the sole frames to that frame, shape (F, 3, 3).
        stance: As of :class:`Reference`, shape (F,).
        swing: As of :class:`Reference`, shape (F,).
    """

    com: Array
    com_velocity: Array
    angular_momentum: Array
    position_sole: Array
    R_level_sole: Array
    stance: Array
    swing: Array


def reference_shapes(feet: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the fields of both kinds of reference, of a robot on so many feet."""
    vectors = "com", "com_acceleration", "angular_momentum_rate", "com_velocity", "angular_momentum"
    return dict.fromkeys((*vectors, "accelerometer", "gyroscope"), (3,)) | {
        "position_sole": (feet, 3),
        "R_level_sole": (feet, 3, 3),
        "stance": (feet,),
        "swing": (feet,),
    }
