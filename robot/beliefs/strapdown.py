r"""Velocity of a robot's IMU and rotation of its torso: increments of its IMU, held by the legs that stand.

In axes that are level and whose heading follows the gyroscope, the IMU's velocity and the torso's rotation
follow from its own increments, and from the points of feet that touch the ground,

    V' = R (f - b_f) - g e_z + k_1 e,        e = V_legs - V
    R' = R [w - b_w]x + [k_2 e_z x e]x R,    b_w' = -k_2 R' (e_z x e) / T_b,     b_z' = -k_1 e_z / T_b

with the specific force f and the angular velocity w. Soles that lie on a level floor show what both are wrong
by, the accelerometer by b_s; of that b_f = b_s / (1 + (b_s / B)^2) is believed, as floors may lean. A tilt
that is off by a small angle drives V sideways by g per second and rad, which is how the legs show it; the
poles of the tilt's loop lie together at 1 / (2 s). The lowest points of feet stand still: V_legs is the
velocity that this requires.
"""

from typing import NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.arrays import skew
from surefoot.robot.beliefs.nominal import NominalModel
from surefoot.robot.beliefs.odometry import FREE_FALL

LEG_TIME = 1.0  # 1 / k_1 in s: a step or two, over which the rolling of soles averages out

TILT_RATE = 0.5
"""Where both poles of a tilt lie, in rad/s, which with k_1 = 1 / s makes k_2 the square of it over g."""

ZERO_OFFSET = 0.2
"""B in m/s^2: 20 mg, which data sheets of accelerometers in robots promise. A floor that leans by more than a
degree looks like more, and is believed the less the more it does."""

BIAS_TIME = 20.0  # T_b in s: biases follow ten times slower than what shows them

TOUCH = 0.003
"""Height in m above the lowest point of the soles at which a point no longer counts as touching: encoders
that are off by 1e-3 rad make 1 to 3 mm of it over a leg."""


class StrapdownConstants(NamedTuple):
    """Constants by their names in C; module constants of the same names explain them."""

    points: int  # number of each foot's parts that may touch, n
    corners: Floats  # their centres in the sole frames in m, shape (F, n, 3)
    radius: Floats  # their radii in m, shape (F, n); 0 of points
    leg_time: float = LEG_TIME
    tilt_rate: float = TILT_RATE
    zero_offset: float = ZERO_OFFSET
    bias_time: float = BIAS_TIME
    touch: float = TOUCH

    @classmethod
    def of(cls, places: Floats) -> "StrapdownConstants":
        """Return those of feet; places: centres and radii, shape (F, n, 4)."""
        return cls(places.shape[1], places[..., :3], places[..., 3])


class Strapdown:
    """The IMU's velocity and the torso's rotation; packets are a period in s apart, and gravity is in m/s^2.

    Attributes:
        R: Rotation from the torso's to the level axes, shape (3, 3).
        velocity: Of the IMU in m/s, shape (3,).
        place: Of the torso in m, by the legs alone, shape (3,).
        spin_bias: Of the gyroscope in rad/s, shape (3,).
        vertical_bias: Of the vertical acceleration in m/s^2.
        count: Packets that the legs had a say in.
    """

    def __init__(self, period: float, gravity: float) -> None:
        self._period, self._gravity, self.count = period, gravity, 0
        self.R = np.eye(3)
        self.velocity, self.place = np.zeros(3), np.zeros(3)
        self.spin_bias, self.vertical_bias = np.zeros(3), 0.0

    def begin(self, force: Floats) -> None:
        """Begin with up as the specific force of a robot at rest shows it."""
        up = force / np.linalg.norm(force)
        forward = np.array([1.0, 0.0, 0.0]) - up[0] * up
        forward /= np.linalg.norm(forward)
        self.R = np.array([forward, np.cross(up, forward), up])

    def advance(
        self, force: Floats, spin: Floats, legs: Floats, imu: Floats, force_bias: Floats
    ) -> tuple[Floats, Floats]:
        """Go on by one packet.

        Args:
            force: Mean specific force since the last packet in the torso's axes in m/s^2, shape (3,).
            spin: Mean angular velocity in rad/s, less what soles show of the gyroscope's error, shape (3,).
            legs: Velocity of the torso's origin in its axes in m/s, if the points that touch stand still,
                shape (3,).
            imu: Velocity of the IMU relative to that origin, shape (3,).
            force_bias: What soles on a level floor show of the accelerometer's error in m/s^2, shape (3,).

        Returns:
            Rotation and velocity of the IMU at the middle since the last packet, shapes (3, 3) and (3,).
        """
        period, before, start = self._period, self.velocity, self.R
        turn = (spin - self.spin_bias) * period
        middle, end = start @ _rotation(0.5 * turn), start @ _rotation(turn)
        believed = force_bias / (1.0 + (force_bias @ force_bias) / ZERO_OFFSET**2)
        rise = middle @ (force - believed)
        rise[2] -= self._gravity + self.vertical_bias
        velocity = before + rise * period
        by_legs = middle @ legs
        if force @ force > (FREE_FALL * self._gravity) ** 2:
            self.count += 1
            off = by_legs + middle @ imu - 0.5 * (before + velocity)
            # The first packets are averaged: nothing was known before.
            velocity = velocity + max(1.0 / self.count, period / LEG_TIME) * off
            tilt = TILT_RATE**2 / self._gravity * period * np.array([-off[1], off[0], 0.0])
            end = _rotation(tilt) @ end
            self.spin_bias = self.spin_bias - middle.T @ tilt / BIAS_TIME
            self.vertical_bias -= period / (LEG_TIME * BIAS_TIME) * off[2]
        self.velocity, self.R = velocity, _orthonormal(end)
        self.place = self.place + by_legs * period
        return middle, 0.5 * (before + velocity)


def touching(
    sites: Floats, axes: Floats, twist: Floats, corners: Floats, up: Floats, radius: Floats | float = 0.0
) -> Floats:
    """Return the mean velocity of the feet's points that touch the ground, relative to the torso, shape (3,).

    Args:
        sites: Origins of the soles in m, shape (F, 3).
        axes: Their axes x, y and z, shape (F, 3, 3).
        twist: Their angular velocities and velocities, shape (F, 6).
        corners: Points in the sole frames in m, shape (F, n, 3).
        up: Unit vector against gravity, shape (3,); like all others in the torso's axes.
        radius: Radii of spheres about these points in m, whose lowest points touch, shape (F, n).
    """
    arm = corners @ axes
    if np.any(radius):
        arm = arm - np.multiply.outer(radius, up)
    velocity = twist[:, None, 3:] + np.cross(twist[:, None, :3], arm)
    height = (sites[:, None] + arm) @ up
    weight = np.exp(-(height - height.min()) / TOUCH)
    mean: Floats = np.einsum("fn,fnx->x", weight, velocity) / weight.sum()
    return mean


class RollingOdometry:
    """Turns the torso of a robot on round feet on, as :class:`Odometry` does by the soles of flat ones.

    A round foot does not show the level by the way in which it is turned; its lowest point stands
    still. The accelerometer's excess along the ground is part of the tilt. Parts that may touch have
    centres in the sole frames, shape (F, n, 3), and radii, shape (F, n), in m; packets are ``period`` s
    apart.

    Attributes:
        force_bias: Zeros: nothing is taken for an error of the accelerometer, shape (3,).
        spin_bias: Zeros as well: the legs show what the gyroscope's is.
        strapdown: Velocity and attitude.
        count: Middles between packets so far.
    """

    def __init__(self, model: NominalModel, period: float, corners: Floats, radius: Floats) -> None:
        self._model, self._corners, self._radius = model, corners, radius
        self.strapdown, self.count = Strapdown(period, model.gravity), 0
        self.force_bias = self.spin_bias = np.zeros(3)

    def turn(self, spin: Floats, force: Floats, sites: Floats, axes: Floats) -> Floats:
        """Take in one middle between packets; as :meth:`Odometry.turn`."""
        if not self.count:
            self.strapdown.begin(force)
        self.count += 1
        _, twist = self._model.velocities()
        up = self.strapdown.R[2]
        soles = sites[1:], axes.reshape(-1, 3, 3), twist[1:]
        legs = -touching(*soles, self._corners, up, self._radius)
        R, _ = self.strapdown.advance(force, spin, legs, twist[0, 3:], self.force_bias)
        return R


def _rotation(turn: Floats) -> Floats:
    """Return the rotation by a small angle, to second order, shape (3, 3)."""
    cross = skew(turn)
    rotation: Floats = np.eye(3) + cross + 0.5 * cross @ cross
    return rotation


def _orthonormal(R: Floats) -> Floats:
    """Return the rotation next to a matrix that is almost one."""
    rotation: Floats = 1.5 * R - 0.5 * R @ R.T @ R
    return rotation
