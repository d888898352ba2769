"""Which way is up and ahead, by a gyroscope that soles on a level floor hold upright.

Kept are two unit vectors in the torso's axes: u, which points up, and h, level, whose heading in the room
follows the gyroscope alone. A fixed direction d obeys d' = -w x d in axes that turn with w. The upright g by
the soles that are down pulls u with the time constant T, and the lasting part of the pull is the bias b of
the gyroscope:

    u' = -(w - b) x u + (g - u) / T,        b' = (u x g) / (T T_b).

Vectors of three are handled as plain floats, which is several times faster than NumPy.
"""

from math import sqrt

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY

TILT_TIME = 0.3  # T in s: how fast the soles hold the tilt upright
SPIN_BIAS_TIME = 3.0  # T_b in s: how fast they find the gyroscope's bias

REST_TIME = 10.0
"""Time in s over which the specific force must point up and be g, for the robot does not go on getting
faster: what is left is the accelerometer's bias."""

FREE_FALL = 0.5
"""Specific force as a share of gravity below which a robot falls freely, which says nothing of an
accelerometer's bias."""

SOLE_HEIGHT = 0.003
"""Height in m above the lower sole at which the other one no longer shows what is level."""

Vector = tuple[float, float, float]


class Odometry:
    """Turns the torso on from one middle between packets to the next, a period in s; gravity is in m/s^2.

    Attributes:
        up: Unit vector against gravity in the torso's axes.
        forward: Unit vector ahead, level, likewise.
        spin: Angular velocity at the last middle in rad/s.
        count: Middles so far.
        force_bias: Excess of the accelerometer in m/s^2, in its own axes, shape (3,).
        spin_bias: Excess of the gyroscope in rad/s, shape (3,).
    """

    def __init__(self, period: float, gravity: float = GRAVITY) -> None:
        self._period, self._gravity = period, gravity
        self.forward: Vector = (1.0, 0.0, 0.0)
        self.spin: Vector = (0.0, 0.0, 0.0)
        self.count = 0
        self.up: Vector = (0.0, 0.0, 1.0)
        self.force_bias = self.spin_bias = np.zeros(3)

    def turn(self, spin: Floats, force: Floats, sites: Floats, axes: Floats) -> Floats:
        """Take in one middle between packets.

        Args:
            spin: Angular velocity in the torso's axes in rad/s, shape (3,).
            force: Specific force in the torso's axes in m/s^2, shape (3,).
            sites: Places of the IMU and of the F soles in the torso's frame in m, shape (1 + F, 3).
            axes: Axes x, y and z of each sole in the torso's, shape (3 F, 3).

        Returns:
            The rotation from the torso's to the odometry axes, shape (3, 3).
        """
        period, gravity = self._period, self._gravity
        self.count += 1
        wx, wy, wz = spin.tolist()
        (sx, sy, sz), (bx, by, bz) = self.spin, self.spin_bias.tolist()
        self.spin = (wx, wy, wz)
        tx, ty, tz = (
            (0.5 * (wx + sx) - bx) * period,
            (0.5 * (wy + sy) - by) * period,
            (0.5 * (wz + sz) - bz) * period,
        )
        gx, gy, gz = self._upright(sites, axes)
        x, y, z = self.up
        x, y, z = x - (ty * z - tz * y), y - (tz * x - tx * z), z - (tx * y - ty * x)
        share = period / (TILT_TIME * SPIN_BIAS_TIME)
        pull = y * gz - z * gy, z * gx - x * gz, x * gy - y * gx
        self.spin_bias = np.array((bx + share * pull[0], by + share * pull[1], bz + share * pull[2]))
        # The first middles are averaged: nothing was known before.
        share = max(1.0 / self.count, period / TILT_TIME)
        x, y, z = x + share * (gx - x), y + share * (gy - y), z + share * (gz - z)
        norm = 1.0 / sqrt(x * x + y * y + z * z)
        x, y, z = self.up = x * norm, y * norm, z * norm

        u, v, w = self.forward
        u, v, w = u - (ty * w - tz * v), v - (tz * u - tx * w), w - (tx * v - ty * u)
        along = u * x + v * y + w * z
        u, v, w = u - along * x, v - along * y, w - along * z
        norm = 1.0 / sqrt(u * u + v * v + w * w)
        u, v, w = self.forward = u * norm, v * norm, w * norm

        R = np.array(((u, v, w), (y * w - z * v, z * u - x * w, x * v - y * u), (x, y, z)))
        fx, fy, fz = force.tolist()
        if fx * fx + fy * fy + fz * fz > (FREE_FALL * gravity) ** 2:
            share = max(1.0 / self.count, period / REST_TIME)
            bx, by, bz = self.force_bias.tolist()
            bx, by = bx + share * (fx - gravity * x - bx), by + share * (fy - gravity * y - by)
            self.force_bias = np.array((bx, by, bz + share * (fz - gravity * z - bz)))
        return R

    def _upright(self, sites: Floats, axes: Floats) -> list[float]:
        """Return which way is up by the lowest sole, or by those that are level with each other.

        A sole counts by the product of the odds for it against each other one: 1/2 for two at one height,
        1 for one that is lower by :data:`SOLE_HEIGHT`, and nothing for the other.
        """
        height = sites[1:] @ self.up
        beats = 0.5 * np.clip(1.0 - (height[:, None] - height) / SOLE_HEIGHT, 0.0, 2.0)
        np.fill_diagonal(beats, 1.0)
        weight = beats.prod(axis=1)
        up: list[float] = (weight @ axes[2::3] / weight.sum()).tolist()
        return up
