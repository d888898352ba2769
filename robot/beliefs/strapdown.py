r"""Attitude and velocity of a robot from its IMU and its stance legs, by one filter for the whole episode.

In level axes, whose heading follows the gyroscope, the velocity V of the IMU and the rotation R of the torso
follow the specific force f and the angular velocity w that the IMU measures,

    V' = R (f - b_f) - (g + b_z) e_z,        R' = R [w - b_w]x.

The lowest points of the feet do not move, which yields a second velocity V_legs and the innovation
e = V_legs - V. A tilt error of phi accelerates V sideways by g phi, and an error beta of the gyroscope's bias
tilts R at this rate. Along each horizontal axis the errors therefore obey

    v' = g phi,        phi' = beta,        beta' = 0,        e = v + noise,

and a Kalman filter estimates v, phi and beta. Its covariance is the same along both axes. If the robot moves
at the start, the first sample of the accelerometer may be wrong by twenty degrees. The filter therefore
starts with an uncertain tilt, and within a second its gains decrease to those of a slow filter. The filter is
never reset. Lost packets are interpolated. A longer gap only increases the covariance, and so does a specific
force that contradicts the first sample of a robot at rest.

Flat soles show the normal u of the ground. If the ground is level, the mean excess e = f - g u is the
accelerometer's error. A slope has the same effect, but it is often larger and does not last. The bias b_s
therefore follows e with a weight that decreases with their distance,

    b_s' = (e - b_s) / (1 + |e - b_s|^2 / A^2)^2 / T,        b_f = b_s / (1 + |b_s|^2 / B^2),

and b_f is the bias that is subtracted. Both norms are those of the components along the ground.
"""

from math import cos, sin, sqrt
from typing import NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.arrays import skew
from surefoot.robot.beliefs.contacts import FREE_FALL

LEGS_SPEED = 0.05  # standard deviation in m/s of the legs' velocity, due to soles that roll and yield

LEGS_NOISE = 1.5e-3
"""Spectral density of that error in m^2/s, for a correlation time of about a third of a second."""

OUTLYING = 2.0
"""Innovation in standard deviations above which its weight is reduced, for legs that slip, hang or hit the
ground. The innovation's noise is then assumed to be half as large as the innovation."""

VELOCITY_NOISE = 0.5 * LEGS_NOISE  # m^2/s^3: 0.03 m/s in a second, from vibrations of the accelerometer
TILT_NOISE = 0.0375 * LEGS_NOISE  # times 1/g^2 in rad^2/s: 0.04 degrees in a second, for low-cost gyroscopes
BIAS_NOISE = 1.56e-4 * LEGS_NOISE
"""Times 1/g^2 in rad^2/s^3. With these three densities the filter converges to a velocity gain of 1 / s, two
tilt poles at 0.5 / s, and a time constant of 20 s for the bias."""

FIRST_VELOCITY, FIRST_TILT, FIRST_BIAS = 0.5, 0.3, 0.005
"""Initial standard deviations in m/s, rad and rad/s. They hold for a robot that is being put down or already
walks, and for a gyroscope that was zeroed at rest and has since warmed up by 20 K, at 0.015 degrees/s per K
(data sheet of the Bosch BMI088). With 0.02 rad/s the gains would be several times larger for ten seconds, and
the noise of the legs' velocity would tilt the attitude of a walking robot."""

STILL_VELOCITY, STILL_TILT = 0.05, 0.01
"""The first two if the robot starts at rest with an accelerometer bias of 0.1 m/s^2. With 0.03 rad a robot
that settles on the ground tilts the attitude by most of a degree, which takes two seconds to decay."""

STILL_SPIN, STILL_SPEED, STILL_FORCE = 0.1, 0.05, 0.05
"""Upper limits for a robot at rest: angular velocity in rad/s, velocity of the legs in m/s, and deviation of
the specific force from gravity, as a fraction of gravity."""

CONTRADICTION = 0.15
"""Angle in rad between specific force and vertical above which the first sample counts as wrong. It applies
to a robot at rest for less than :data:`FIRST_TIME`. A swaying robot looks at rest at its turning points,
where it accelerates by up to 1 m/s^2 (0.1 rad)."""

TURNED = 0.3  # tilt rate in rad/s that a walking robot may have while packets are missing

KNOWN_TILT = 0.1  # standard deviation in rad below which the attitude is good enough for a reference

VERTICAL_BIAS_TIME = 20.0  # time constant in s of the vertical bias, far longer than a step

GROUND_TIME = 0.3  # time constant in s of the correction of the ground's normal by the soles

REST_TIME = 2.0  # time constant in s of the excess: several steps, so that accelerations average out

FIRST_TIME = 1.0  # weight in s of the prior of zero bias; s in which the first sample may be revised

FORCE_BIAS_TIME = 10.0  # longest time constant in s of the bias, many steps

OTHER_GROUND = 0.15
"""A in m/s^2: change of the excess above which the ground has probably changed (a slope of 0.9 degrees)."""

ZERO_OFFSET = 0.1
"""B in m/s^2: 10 mg, twice the bias of accelerometers in robots after a calibration. A slope of more than
half a degree resembles a larger bias, and the estimate is reduced accordingly. Calibrators allow for the
rest: :meth:`surefoot.calibration.moment.model.Model.allow_for_tilt`."""

TOUCH = 0.003
"""Height in m above the lowest point of the soles over which the weight of a contact point decays. Encoder
errors of 1e-3 rad cause errors of 1 to 3 mm along a leg."""

NO_NORMAL = 0.1  # length of the soles' mean normal below which they contradict and are not used

SMALL = 1e-3  # rad up to which a rotation is computed to second order, with an error of 1e-10

SOLE_HEIGHT = 0.003  # height in m above a lower sole at which a sole is not used for the ground's normal


class StrapdownConstants(NamedTuple):
    """Constants under their names in C. The module constants of the same names document them."""

    points: int  # number of each foot's parts that may touch, n
    corners: Floats  # their centres in the sole frames in m, shape (F, n, 3)
    radius: Floats  # their radii in m, shape (F, n); 0 for points
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
        """Return the constants for contact points with these centres and radii, shape (F, n, 4)."""
        return cls(places.shape[1], places[..., :3], places[..., 3])


class Strapdown:
    """Estimates the attitude, the velocity and the ground of one robot.

    Args:
        period: Time between packets in s.
        gravity: Acceleration of free fall in m/s^2.
        touching: The parts of each foot that may touch: centres in the sole frames and radii in m, shape
            (F, n, 4).
        rolls: Whether feet are round, so that their soles do not show the ground's normal.

    Attributes:
        R: Rotation from the torso's to the level axes, shape (3, 3).
        velocity: Velocity of the IMU in m/s, shape (3,).
        place: Position of the torso in m by leg odometry alone, shape (3,).
        spin_bias: Bias of the gyroscope in rad/s, shape (3,).
        vertical_bias: Bias of the vertical acceleration in m/s^2.
        ground: Normal of the ground in the torso's axes, shape (3,).
        excess: Mean specific force minus gravity along the ground's normal in m/s^2, shape (3,).
        sole_bias: The part of the excess that does not change with the ground, b_s, shape (3,).
        force_bias: The estimated error of the accelerometer, b_f, shape (3,).
        covariance: Covariance of velocity, tilt and gyroscope bias errors along a horizontal axis, (3, 3).
        count: Number of packets so far.
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
        """Keep the attitude over a gap in the data, and increase the covariance.

        A negative duration means that the attitude is unknown.
        """
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
        """Advance the filter to the next packet.

        Args:
            force: Mean specific force since the last packet in the torso's axes in m/s^2, shape (3,).
            spin: Mean angular velocity in rad/s, shape (3,).
            sites: Places of the IMU and of the F soles in m, shape (1 + F, 3).
            axes: Axes x, y and z of each sole, shape (3 F, 3).
            twist: Angular velocities and velocities of the IMU and the soles, shape (1 + F, 6). Like all
                arguments, they are relative to the torso and in its axes.

        Returns:
            Rotation of the torso and velocity of the IMU midway between the last packet and this one, shapes
            (3, 3) and (3,).
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
        """Set the covariance of a robot at rest: at the start, or if the attitude contradicts gravity."""
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
        """Update the accelerometer bias from the ground's normal, unless the feet are round."""
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
        """Return the squared component of a specific force along the ground, which a slope may cause."""
        return float(force @ force - (force @ self.ground) ** 2)

    def _find_ground(self, turn: Floats, soles: Floats, axes: Floats) -> None:
        """Rotate the ground's normal with the torso, and correct it by the lowest soles along it.

        The weight of a sole is the product of one factor for each other sole. The factor is 1/2 at equal
        height, 1 if this sole is lower by :data:`SOLE_HEIGHT`, and 0 if it is higher by as much.
        """
        if self._rolls:
            self.ground = self.R[2]
            return
        ground = self.ground - np.cross(turn, self.ground)
        height = soles @ ground
        beats = 0.5 * np.clip(1.0 - (height[:, None] - height) / SOLE_HEIGHT, 0.0, 2.0)
        np.fill_diagonal(beats, 1.0)
        weight = beats.prod(axis=1)
        # The first packets are averaged, because there is no earlier estimate.
        share = max(1.0 / max(self.count, 1), self._period / GROUND_TIME)
        ground = ground + share * (weight @ axes[2::3] / weight.sum() - ground)
        length = np.linalg.norm(ground)
        if length > NO_NORMAL:
            self.ground = ground / length


def touching(
    sites: Floats, axes: Floats, twist: Floats, corners: Floats, up: Floats, radius: Floats | float = 0.0
) -> Floats:
    """Return the mean velocity, relative to the torso, of the points that touch the ground, shape (3,).

    Args:
        sites: Origins of the soles in m, shape (F, 3).
        axes: Axes x, y and z of the soles, shape (F, 3, 3).
        twist: Angular velocities and velocities of the soles, shape (F, 6).
        corners: Points in the sole frames in m, shape (F, n, 3).
        up: Normal of the ground in the torso's axes, as are the sites, axes and twists, shape (3,).
        radius: Radii in m of spheres around these points, shape (F, n). Their lowest points touch the ground.
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
    """Return the rotation of a torso at rest, where the specific force points up, shape (3, 3)."""
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
    """Return the rotation closest to a matrix that is almost a rotation."""
    rotation: Floats = 1.5 * R - 0.5 * R @ R.T @ R
    return rotation
