"""Which way is up, by a gyroscope that an accelerometer holds upright.

The complementary filter with bias correction of Mahony, Hamel and Pflimlin (2008, Sec. IV), reduced to the
one direction that both sensors see: the unit vector u that points up, in the IMU's axes. With the measured
angular velocity w, the bias b and the direction v of the specific force,

    e  = u x v
    u' = u x (w - b) + k_P e x u
    b' = k_I e

for u' = -w x u is the motion of a fixed direction in turning axes, and e x u turns u towards v. On a walking
robot the specific force points up on average only, so that the gains are slow. Three numbers are handled as
plain floats, which for arrays this small is several times faster than NumPy.
"""

from math import asin, atan2, sqrt
from typing import NamedTuple

PROPORTIONAL_GAIN = 0.3
"""k_P in 1/s: slow against a gait, whose swaying tilts the belief, fast against a gyroscope's bias."""

INTEGRAL_GAIN = 0.02  # k_I in 1/s^2

LEAST_SQUARE, MOST_SQUARE = 24.0, 217.0
"""Squares of the specific force in m^2/s^4 between which an accelerometer shows what is up, 0.5 to 1.5 g: not
in free fall, not in an impact."""

LARGEST_SPIN_SQUARE = 1e12
"""Square of an angular velocity in rad^2/s^2 that is none, as after a simulation blew up."""

Vector = tuple[float, float, float]


class Attitude(NamedTuple):
    """The state of the filter."""

    up: Vector  # unit vector against gravity in the IMU's axes
    bias: Vector  # bias of the gyroscope in rad/s

    @property
    def roll(self) -> float:
        """Roll of the torso in rad."""
        return atan2(self.up[1], self.up[2])

    @property
    def pitch(self) -> float:
        """Pitch of the torso in rad."""
        return -asin(max(-1.0, min(1.0, self.up[0])))


UPRIGHT = Attitude((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))


def update(attitude: Attitude, gyroscope: Vector, accelerometer: Vector, dt: float) -> Attitude:
    """Turn on by one sample, ``dt`` s after the one before.

    Of the mean angular velocity over dt in rad/s and the specific force in m/s^2, three numbers each.
    """
    (x, y, z), (bx, by, bz) = attitude
    wx, wy, wz = gyroscope
    wx, wy, wz = wx - bx, wy - by, wz - bz
    # NaN compares as false.
    if not wx * wx + wy * wy + wz * wz < LARGEST_SPIN_SQUARE:
        return attitude
    ax, ay, az = accelerometer
    square = ax * ax + ay * ay + az * az
    ex = ey = ez = 0.0
    if LEAST_SQUARE < square < MOST_SQUARE:
        weight = 1.0 / sqrt(square)
        ax, ay, az = ax * weight, ay * weight, az * weight
        ex, ey, ez = y * az - z * ay, z * ax - x * az, x * ay - y * ax
        gain = INTEGRAL_GAIN * dt
        bx, by, bz = bx + gain * ex, by + gain * ey, bz + gain * ez
    # Angle by which u turns, including its second-order term: (1 + [t]x + [t]x^2 / 2) u.
    tx = (PROPORTIONAL_GAIN * ex - wx) * dt
    ty = (PROPORTIONAL_GAIN * ey - wy) * dt
    tz = (PROPORTIONAL_GAIN * ez - wz) * dt
    dx, dy, dz = ty * z - tz * y, tz * x - tx * z, tx * y - ty * x
    x += dx + 0.5 * (ty * dz - tz * dy)
    y += dy + 0.5 * (tz * dx - tx * dz)
    z += dz + 0.5 * (tx * dy - ty * dx)
    norm = 1.0 / sqrt(x * x + y * y + z * z)
    return Attitude((x * norm, y * norm, z * norm), (bx, by, bz))
