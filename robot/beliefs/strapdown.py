r"""Attitude and velocity of a robot: one filter from the first packet on, of its IMU and the legs that stand.

In level axes, whose heading follows the gyroscope, the velocity V of the IMU and the rotation R of the torso
follow the specific force f and the angular velocity w that the IMU measures,

    V' = R (f - b_f) - (g + b_z) e_z,        R' = R [w - b_w]x.

The lowest points of the feet stand still, which gives a second velocity V_legs and the innovation
e = V_legs - V. A tilt error of phi accelerates V sideways by g phi, and an error beta of the gyroscope's bias
tilts R at this rate. Along each horizontal axis the errors therefore obey

    v' = g phi,        phi' = beta,        beta' = 0,        e = v + noise,

of which a Kalman filter estimates all three. Its covariance is the same along both axes. A robot that moves
starts with a tilt that may be wrong by twenty degrees, as the first sample of the accelerometer is while the
robot settles, and its gains fall within a second to those of a slow filter. It never starts again: lost
packets are filled in, and a longer gap, or a specific force that contradicts the first sample of a robot at
rest, only makes it less certain.

Flat soles show the normal u of the ground. If the ground is level, the mean excess e = f - g u is the
accelerometer's error. A slope looks the same, but is often larger, and comes and goes. So the bias b_s
follows e with a weight that falls with their distance, b_s' = (e - b_s) / (1 + |e - b_s|^2 / A^2)^2 / T,
and of it b_f = b_s / (1 + |b_s|^2 / B^2) is believed, with the norms of the parts along the ground.
"""

from math import cos, sin, sqrt
from typing import NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.arrays import skew
from surefoot.robot.beliefs.contacts import FREE_FALL

LEGS_SPEED = 0.05  # standard deviation in m/s of the legs' velocity, as soles that roll and yield make it

LEGS_NOISE = 1.5e-3
"""Spectral density of that error in m^2/s: it changes every third of a second."""

OUTLYING = 2.0
"""Standard deviations of the innovation beyond which it counts for less, as of legs that slip, hang or hit
the ground. Its noise is then taken to be half as large as itself."""

VELOCITY_NOISE = 0.5 * LEGS_NOISE  # m^2/s^3: 0.03 m/s in a second, from vibrations of the accelerometer
TILT_NOISE = 0.0375 * LEGS_NOISE  # times 1/g^2 in rad^2/s: 0.04 degrees in a second, of cheap gyroscopes
BIAS_NOISE = 1.56e-4 * LEGS_NOISE
"""Times 1/g^2 in rad^2/s^3. With these three the filter settles at a gain of 1 / s on the velocity, at two
poles of the tilt of 0.5 / s, and at a bias that follows in 20 s."""

FIRST_VELOCITY, FIRST_TILT, FIRST_BIAS = 0.5, 0.3, 0.005
"""Standard deviations at the start in m/s, rad and rad/s, of a robot that is put down or already walks, and
of a gyroscope that was zeroed at rest and has since become 20 K warmer, at 0.015 degrees/s per K (data sheet
of the Bosch BMI088). With 0.02 rad/s the gains are several times larger for the first ten seconds, in which
the noise of the legs' velocity then tilts the attitude of a robot that walks."""

STILL_VELOCITY, STILL_TILT = 0.05, 0.03
"""The first two of a robot that is at rest at the start, by an accelerometer with a bias of 0.3 m/s^2."""

STILL_SPIN, STILL_SPEED, STILL_FORCE = 0.1, 0.05, 0.05
"""Largest angular velocity in rad/s, velocity of the legs in m/s, and difference of the specific force from
gravity, as a share of it, of a robot that is at rest."""

CONTRADICTION = 5.0 * STILL_TILT
"""Angle in rad between the specific force and the vertical, of a robot that has been at rest for less than
:data:`FIRST_TIME`, beyond which its first sample was wrong: five standard deviations of that sample. A robot
that sways seems to be at rest where it turns round, while it accelerates by up to 1 m/s^2 (0.1 rad)."""

TURNED = 0.3  # rad/s by which a robot that walks tilts unseen while packets are missing

KNOWN_TILT = 0.1  # standard deviation in rad from which on the attitude is good enough for a reference

VERTICAL_BIAS_TIME = 20.0  # time constant in s of the vertical bias, far longer than a step

GROUND_TIME = 0.3  # time constant in s with which the soles correct the normal of the ground

REST_TIME = 2.0  # time constant in s of the excess: some steps, over which accelerations average out

FIRST_TIME = 1.0  # s of the start: a bias of zero counts as so much data, and a first sample may be revised

FORCE_BIAS_TIME = 10.0  # longest time constant in s of the bias: many steps

OTHER_GROUND = 0.3
"""Change of the excess in m/s^2, 1.8 degrees of slope, beyond which the ground has probably changed."""

ZERO_OFFSET = 0.2
"""B in m/s^2: 20 mg, which data sheets of accelerometers in robots promise. Ground that leans by more than a
degree looks like a larger bias, and is believed the less the more it leans."""

TOUCH = 0.003
"""Height in m above the lowest point of the soles at which a point no longer counts as touching: encoders
that are off by 1e-3 rad make 1 to 3 mm of it over a leg."""

NO_NORMAL = 0.1  # length below which a mean of the soles' normals shows nothing, because they contradict

SMALL = 1e-3  # rad up to which a rotation is taken to second order; its error is 1e-10

SOLE_HEIGHT = 0.003  # height in m above a lower sole at which a sole no longer shows the ground's normal


class StrapdownConstants(NamedTuple):
    """Constants by their names in C; module constants of the same names explain them."""

    points: int  # number of each foot's parts that may touch, n
    corners: Floats  # their centres in the sole frames in m, shape (F, n, 3)
    radius: Floats  # their radii in m, shape (F, n); 0 of points
    legs_noise: float = LEGS_NOISE
    legs_speed: float = LEGS_SPEED
    outlying: float = OUTLYING
    velocity_noise: float = VELOCITY_NOISE
    tilt_noise: float = TILT_NOISE
    bias_noise: float = BIAS_NOISE
    first_velocity: float = FIRST_VELOCITY
    first_tilt: float = FIRST_TILT
    first_bias: float = FIRST_BIAS
    still_velocity: float = STILL_VELOCITY
    still_tilt: float = STILL_TILT
    still_spin: float = STILL_SPIN
    still_speed: float = STILL_SPEED
    still_force: float = STILL_FORCE
    contradiction: float = CONTRADICTION
    turned: float = TURNED
    known_tilt: float = KNOWN_TILT
    vertical_bias_time: float = VERTICAL_BIAS_TIME
    ground_time: float = GROUND_TIME
    rest_time: float = REST_TIME
    first_time: float = FIRST_TIME
    force_bias_time: float = FORCE_BIAS_TIME
    zero_offset: float = ZERO_OFFSET
    other_ground: float = OTHER_GROUND
    touch: float = TOUCH
    no_normal: float = NO_NORMAL
    sole_height: float = SOLE_HEIGHT

    @classmethod
    def of(cls, places: Floats) -> "StrapdownConstants":
        """Return those of feet; places: centres and radii, shape (F, n, 4)."""
        return cls(places.shape[1], places[..., :3], places[..., 3])


class Strapdown:
    """The attitude, the velocity and the ground of one robot.

    Args:
        period: Time between packets in s.
        gravity: Acceleration of free fall in m/s^2.
        touching: The parts of each foot that may touch: centres in the sole frames and radii in m, shape
            (F, n, 4).
        rolls: Whether feet are round, so that their soles do not show the ground's normal.

    Attributes:
        R: Rotation from the torso's to the level axes, shape (3, 3).
        velocity: Of the IMU in m/s, shape (3,).
        place: Of the torso in m, by the legs alone, shape (3,).
        spin_bias: Of the gyroscope in rad/s, shape (3,).
        vertical_bias: Of the vertical acceleration in m/s^2.
        ground: Normal of the ground in the torso's axes, shape (3,).
        excess: Specific force less gravity along the ground's normal in m/s^2, in the mean, shape (3,).
        sole_bias: Its part that does not change with the ground, b_s, shape (3,).
        force_bias: The believed error of the accelerometer, b_f, shape (3,).
        covariance: Of the errors of velocity, tilt and gyroscope bias along a horizontal axis, shape (3, 3).
        count: Packets so far.
    """

    def __init__(self, period: float, gravity: float, touching: Floats, rolls: bool = False) -> None:
        self._period, self._gravity, self._rolls = period, gravity, rolls
        self._corners, self._radius = touching[..., :3], touching[..., 3]
        self.R = np.eye(3)
        self.velocity, self.place = np.zeros(3), np.zeros(3)
        self.spin_bias, self.vertical_bias = np.zeros(3), 0.0
        self.ground = np.array([0.0, 0.0, 1.0])
        self.excess, self.sole_bias, self.force_bias = np.zeros((3, 3))
        self.count = 0
        noise = np.array([VELOCITY_NOISE, TILT_NOISE / gravity**2, BIAS_NOISE / gravity**2])
        self._noise = np.diag(period * noise)
        drift = period * gravity
        self._transition = np.array([[1.0, drift, 0.5 * drift * period], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
        self.covariance = np.diag(np.square([FIRST_VELOCITY, FIRST_TILT, FIRST_BIAS]))

    def coast(self, seconds: float) -> None:
        """Keep the attitude over a gap of unknown motion, and become less certain; negative is any time."""
        turned = TURNED * seconds if seconds > 0.0 else np.inf
        tilt = min(self.covariance[1, 1] + turned**2, FIRST_TILT**2)
        self.covariance = np.diag([FIRST_VELOCITY**2, tilt, self.covariance[2, 2]])

    @property
    def known(self) -> bool:
        """Whether the attitude is good enough for references."""
        return bool(self.covariance[1, 1] < KNOWN_TILT**2)

    def advance(
        self, force: Floats, spin: Floats, sites: Floats, axes: Floats, twist: Floats
    ) -> tuple[Floats, Floats]:
        """Take in the middle between two packets.

        Args:
            force: Mean specific force since the last packet in the torso's axes in m/s^2, shape (3,).
            spin: Mean angular velocity in rad/s, shape (3,).
            sites: Places of the IMU and of the F soles in m, shape (1 + F, 3).
            axes: Axes x, y and z of each sole, shape (3 F, 3).
            twist: Angular velocities and velocities of the IMU and the soles, shape (1 + F, 6); like all
                others relative to the torso and in its axes.

        Returns:
            Rotation and velocity of the IMU at that middle, shapes (3, 3) and (3,).
        """
        period, carried = self._period, bool(force @ force > (FREE_FALL * self._gravity) ** 2)
        self.count += carried
        if carried and self.count == 1:
            self.R = _upright(force)
        turn = (spin - self.spin_bias) * period
        self._find_ground(turn, sites[1:], axes)
        middle, end = self.R @ _rotation(0.5 * turn), self.R @ _rotation(turn)
        legs = -touching(
            sites[1:], axes.reshape(-1, 3, 3), twist[1:], self._corners, self.ground, self._radius
        )
        self._judge(force, spin, legs)
        by_legs = middle @ legs
        velocity = by_legs + middle @ twist[0, 3:]
        rise = middle @ (force - self.force_bias)
        rise[2] -= self._gravity + self.vertical_bias
        before = self.velocity if self.count > 1 else velocity - 0.5 * period * rise
        after = before + rise * period
        P = self._transition @ self.covariance @ self._transition.T + self._noise
        if carried:
            off = velocity - 0.5 * (before + after)
            usual = 3.0 * (P[0, 0] + LEGS_SPEED**2)
            doubt = max(float(off @ off) / (OUTLYING**2 * usual), 1.0)
            gain = P[0] / (P[0, 0] + doubt * LEGS_NOISE / period)
            P = P - np.outer(gain, P[0])
            after = after + gain[0] * off
            across = np.array([-off[1], off[0], 0.0])
            end = _rotation(gain[1] * across) @ end
            self.spin_bias = self.spin_bias - gain[2] * (middle.T @ across)
            self.vertical_bias -= gain[0] / VERTICAL_BIAS_TIME * off[2]
            self._find_bias(force)
        self.velocity, self.R, self.covariance = after, _orthonormal(end), P
        self.place = self.place + by_legs * period
        return middle, 0.5 * (before + after)

    def _judge(self, force: Floats, spin: Floats, legs: Floats) -> None:
        """Set how certain the attitude is where the robot is at rest: at the start, and if it contradicts."""
        length = sqrt(force @ force)
        still = (
            spin @ spin < STILL_SPIN**2
            and legs @ legs < STILL_SPEED**2
            and abs(length - self._gravity) < STILL_FORCE * self._gravity
        )
        if not still:
            return
        if self.count == 1:
            self.covariance = np.diag(np.square([STILL_VELOCITY, STILL_TILT, FIRST_BIAS]))
        elif (
            self.known
            and self.count * self._period < FIRST_TIME
            and self.R[2] @ force < cos(CONTRADICTION) * length
        ):
            self.coast(-1.0)

    def _find_bias(self, force: Floats) -> None:
        """Compare the specific force with the normal of the ground, if soles show it."""
        if self._rolls:
            return
        period, bias = self._period, self.sole_bias
        excess = force - self._gravity * self.ground
        self.excess = self.excess + max(1.0 / self.count, period / REST_TIME) * (excess - self.excess)
        off = self.excess - bias
        weight = 1.0 / (1.0 + self._slope(off) / OTHER_GROUND**2) ** 2
        share = period / min(FIRST_TIME + self.count * period, FORCE_BIAS_TIME)
        self.sole_bias = bias = bias + share * weight * off
        self.force_bias = bias / (1.0 + self._slope(bias) / ZERO_OFFSET**2)

    def _slope(self, force: Floats) -> float:
        """Return the square of the part of a specific force along the ground, which a slope may cause."""
        return float(force @ force - (force @ self.ground) ** 2)

    def _find_ground(self, turn: Floats, soles: Floats, axes: Floats) -> None:
        """Turn the ground's normal on, and correct it by the soles that are lowest along it.

        A sole counts by the product of its odds against each other one: 1/2 for two at one height, 1 for one
        that is lower by :data:`SOLE_HEIGHT`, and nothing for the other.
        """
        if self._rolls:
            self.ground = self.R[2]
            return
        ground = self.ground - np.cross(turn, self.ground)
        height = soles @ ground
        beats = 0.5 * np.clip(1.0 - (height[:, None] - height) / SOLE_HEIGHT, 0.0, 2.0)
        np.fill_diagonal(beats, 1.0)
        weight = beats.prod(axis=1)
        # The first ones are averaged: nothing was known before.
        share = max(1.0 / max(self.count, 1), self._period / GROUND_TIME)
        ground = ground + share * (weight @ axes[2::3] / weight.sum() - ground)
        length = np.linalg.norm(ground)
        if length > NO_NORMAL:
            self.ground = ground / length


def touching(
    sites: Floats, axes: Floats, twist: Floats, corners: Floats, up: Floats, radius: Floats | float = 0.0
) -> Floats:
    """Return the mean velocity of the feet's points that touch the ground, relative to the torso, shape (3,).

    Args:
        sites: Origins of the soles in m, shape (F, 3).
        axes: Their axes x, y and z, shape (F, 3, 3).
        twist: Their angular velocities and velocities, shape (F, 6).
        corners: Points in the sole frames in m, shape (F, n, 3).
        up: Normal of the ground, shape (3,); like all others in the torso's axes.
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


def _upright(force: Floats) -> Floats:
    """Return the rotation of a torso at rest, whose specific force points up, shape (3, 3)."""
    up = force / sqrt(force @ force)
    axis = 0 if abs(up[0]) < 0.9 else 2  # the heading is arbitrary; the torso may lie on its back
    forward = np.eye(3)[axis] - up[axis] * up
    forward /= sqrt(forward @ forward)
    return np.array([forward, np.cross(up, forward), up], dtype=np.float64)


def _rotation(turn: Floats) -> Floats:
    """Return the rotation by a vector in rad (Rodrigues), shape (3, 3)."""
    cross, angle = skew(turn), sqrt(turn @ turn)
    first, second = (sin(angle) / angle, (1.0 - cos(angle)) / angle**2) if angle > SMALL else (1.0, 0.5)
    rotation: Floats = np.eye(3) + first * cross + second * cross @ cross
    return rotation


def _orthonormal(R: Floats) -> Floats:
    """Return the rotation next to a matrix that is almost one."""
    rotation: Floats = 1.5 * R - 0.5 * R @ R.T @ R
    return rotation
