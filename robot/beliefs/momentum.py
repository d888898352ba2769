r"""What a robot knows of its momentum: velocity increments of its IMU, held by the legs that stand.

In axes that are level and whose heading follows the gyroscope, the IMU's velocity and the torso's rotation
follow from its own increments, and from what the points of soles that touch the ground say,

    V' = R (f - b) - g e_z + k_1 e,          e = V_legs - V
    R' = R [w - b_w]x + [k_2 e_z x e]x R,    b_w' = -k_2 R' (e_z x e) / T_b,     b_z' = -k_1 e_z / T_b

with the specific force f and the angular velocity w. A tilt that is off by a small angle drives V sideways by
g per second and rad, which is how the legs show it; the poles of the tilt's loop lie together at 1 / (2 s).
A sole's lowest points stand still: V_legs is what they ask for. Nothing is differentiated but encoders.

A row is of the middle between two packets; rows are read by linear interpolation.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import MomentumReference
from surefoot.calibration.arrays import skew
from surefoot.robot.beliefs.lag import HISTORY
from surefoot.robot.beliefs.nominal import NominalModel
from surefoot.robot.beliefs.odometry import FREE_FALL
from surefoot.robot.beliefs.references import Beliefs, Believed, Posture
from surefoot.sensors.transport.link import Packets

if TYPE_CHECKING:
    from surefoot.envs.instrumentation.drawing import RobotDrawing

Floats = NDArray[np.float64]

LEG_TIME = 1.0
"""1 / k_1 in s: a step or two, over which the rolling of soles averages out."""

TILT_RATE = 0.5
"""Where both poles of a tilt lie, in rad/s, which with k_1 = 1 / s makes k_2 the square of it over g."""

BIAS_TIME = 20.0
"""T_b in s: biases follow ten times slower than what shows them."""

TOUCH = 0.003
"""Height in m above the lowest point of the soles at which a point no longer counts as touching: encoders
that are off by 1e-3 rad make 1 to 3 mm of it over a leg."""

COM, SOLES, AXES, VELOCITY, MOMENTUM = 0, slice(1, 3), slice(3, 9), 9, 10
"""In the axes above: centre of mass and soles in m, both soles' axes x, y and z, velocity of the centre of
mass in m/s and angular momentum about it in kg m^2/s."""

ROWS = 11
"""Number of the vectors."""


class StrapdownConstants(NamedTuple):
    """Constants by their names in C; module constants of the same names say what they are.

    Attributes:
        points: Number of each sole's points that may touch, n.
        corners: These points in the sole frames in m, shape (2, n, 3).
    """

    points: int
    corners: Floats
    leg_time: float = LEG_TIME
    tilt_rate: float = TILT_RATE
    bias_time: float = BIAS_TIME
    touch: float = TOUCH
    free_fall: float = FREE_FALL


class Strapdown:
    """The IMU's velocity and the torso's rotation.

    Args:
        period: Time between packets in s.
        gravity: Acceleration of free fall in m/s^2.

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
        """Begin with what the specific force of a robot at rest shows of up."""
        up = force / np.linalg.norm(force)
        forward = np.array([1.0, 0.0, 0.0]) - up[0] * up
        forward /= np.linalg.norm(forward)
        self.R = np.array([forward, np.cross(up, forward), up])

    def advance(self, force: Floats, spin: Floats, legs: Floats, imu: Floats) -> tuple[Floats, Floats]:
        """Go on by one packet.

        Args:
            force: Mean specific force since the last packet in the torso's axes in m/s^2, shape (3,).
            spin: Mean angular velocity in rad/s, shape (3,).
            legs: Velocity of the torso's origin in its axes in m/s, if the points that touch stand still,
                shape (3,).
            imu: Velocity of the IMU relative to that origin, shape (3,).

        Returns:
            Rotation and velocity of the IMU at the middle since the last packet, shapes (3, 3) and (3,).
        """
        period, before, start = self._period, self.velocity, self.R
        turn = (spin - self.spin_bias) * period
        middle, end = start @ _rotation(0.5 * turn), start @ _rotation(turn)
        rise = middle @ force
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


class MomentumBeliefs(Believed):
    """Makes references that hold momentum; contacts, and whether it stands upright, are those of ``beliefs``.

    Args:
        beliefs: Those that hold accelerations.
        corners: Points of each sole that may touch, in the sole frames in m, shape (2, n, 3).

    Attributes:
        beliefs: Those that hold accelerations.
        believed: What the last :meth:`sample` found.
        corners: The same.
        ring: A row for each of the last packets by number, shape (HISTORY, ROWS, 3).
        strapdown: Velocity and attitude.
        run: Rows in a row.
        number: Of the last packet.
    """

    def __init__(self, beliefs: Beliefs, corners: Floats) -> None:
        self.beliefs, self.corners = beliefs, corners
        self.ring = np.zeros((HISTORY, ROWS, 3))
        self.strapdown = Strapdown(beliefs.period, beliefs.model.gravity)
        self.run, self.number = 0, 0
        self.believed = unknown()

    def begun(self) -> "MomentumBeliefs":
        """Return beliefs of the same robot at an episode's start."""
        return MomentumBeliefs(self.beliefs.begun(), self.corners)

    @property
    def constants(self) -> StrapdownConstants:
        """Constants, by their names in C."""
        return StrapdownConstants(self.corners.shape[1], self.corners)

    @property
    def model(self) -> NominalModel:
        """The robot as it believes itself to be."""
        return self.beliefs.model

    def soles(self, time: float) -> Floats:
        """Return where the soles are at a moment later than the newest packet; as :meth:`Beliefs.soles`."""
        return self.beliefs.soles(time)

    def update(self, packets: Packets) -> None:
        """Take in packets of telemetry, in order."""
        for packet in self.beliefs.join(packets):
            posture, self.number = self.beliefs.take(packet), packet.number
            if posture is not None:
                self.run += 1
                self._advance(posture)
            else:
                self.run = 0
                self.strapdown = Strapdown(self.beliefs.period, self.model.gravity)
                self.strapdown.begin(packet.values[self.beliefs.layout.accelerometer])

    def _advance(self, posture: Posture) -> None:
        """Fill the row at the middle before the newest packet."""
        com, momentum, sites, axes, force, spin = posture
        com_velocity, twist = self.model.velocities()
        down = self.strapdown.R[2]
        legs = -touching(sites[1:], axes.reshape(2, 3, 3), twist[1:], self.corners, down)
        R, velocity = self.strapdown.advance(force, spin, legs, twist[0, 3:])
        row = self.ring[self.number % HISTORY]
        row[COM], row[SOLES], row[AXES], row[MOMENTUM] = com, sites[1:], axes, momentum
        row[VELOCITY] = com_velocity - twist[0, 3:]
        np.matmul(row, R.T, out=row)
        row[VELOCITY] += velocity
        row[: SOLES.stop] += self.strapdown.place

    def sample(self, time: float, command: Any, hold: bool = False) -> bool:
        """Find what the robot believes for one sample of its feet; as :meth:`Beliefs.sample`."""
        fell = self.beliefs.sample(time, command, hold)
        found, self.believed = self.beliefs.believed, unknown()
        if self.beliefs.known and self.run > 1:
            # A reading stands for the middle of its interval, a momentum for the end.
            low = self.number - min(self.run, HISTORY - 1) + 1
            end = time + 0.5 * self.beliefs.dt
            rows = self.beliefs.interpolate(self.ring, end, low, self.number)
            self.believed = MomentumReference(
                com=rows[COM],
                com_velocity=rows[VELOCITY],
                angular_momentum=rows[MOMENTUM],
                position_sole=rows[SOLES],
                R_level_sole=rows[AXES].reshape(2, 3, 3).swapaxes(1, 2),
                stance=found.stance,
                swing=found.swing,
            )
        return fell


def sole_corners(drawing: "RobotDrawing") -> Floats:
    """Return points of the soles that may touch, (2, n, 3): their cells, or their origins without any."""
    places = drawing.position_cell_sole
    return np.zeros((2, 1, 3)) if places is None else places


def touching(sites: Floats, axes: Floats, twist: Floats, corners: Floats, up: Floats) -> Floats:
    """Return the mean velocity of the soles' points that touch the ground, relative to the torso, shape (3,).

    Args:
        sites: Origins of the soles in m, shape (2, 3).
        axes: Their axes x, y and z, shape (2, 3, 3).
        twist: Their angular velocities and velocities, shape (2, 6).
        corners: Points in the sole frames in m, shape (2, n, 3).
        up: Unit vector against gravity, shape (3,); like all others in the torso's axes.
    """
    arm = corners @ axes
    velocity = twist[:, None, 3:] + np.cross(twist[:, None, :3], arm)
    height = (sites[:, None] + arm) @ up
    weight = np.exp(-(height - height.min()) / TOUCH)
    mean: Floats = np.einsum("fn,fnx->x", weight, velocity) / weight.sum()
    return mean


def unknown() -> MomentumReference:
    """Return the reference of a robot that knows nothing: NaN, and no foot in stance or swing."""
    vectors, soles, unsure = np.full((3, 3), np.nan), np.full((2, 4, 3), np.nan), np.zeros((2, 2), bool)
    return MomentumReference(
        com=vectors[0],
        com_velocity=vectors[1],
        angular_momentum=vectors[2],
        position_sole=soles[:, 3],
        R_level_sole=soles[:, :3],
        stance=unsure[0],
        swing=unsure[1],
    )


def _rotation(turn: Floats) -> Floats:
    """Return the rotation by a small angle, to second order, shape (3, 3)."""
    cross = skew(turn)
    rotation: Floats = np.eye(3) + cross + 0.5 * cross @ cross
    return rotation


def _orthonormal(R: Floats) -> Floats:
    """Return the rotation next to a matrix that is almost one."""
    rotation: Floats = 1.5 * R - 0.5 * R @ R.T @ R
    return rotation
