"""A robot's knowledge of its own motion without its feet's sensors, on their timeline.

Encoders and IMU come at 100 Hz or faster, numbered and late with jitter. Single packets that were lost are
filled in by linear interpolation, and packets of a faster link are joined into one of 10 ms, with the mean
of the IMU and the last angles. The mean delay is known and subtracted. The numbers are the robot's own even
clock, so that the jitter averages out. Between two packets n-1 and n, at their middle, the nominal model
gives the centre of mass c, the soles and the angular momentum L from the mean and the difference of both
encoder readings, and the attitude filter (:mod:`surefoot.robot.beliefs.strapdown`) gives the rotation R of
the torso. With the specific force f, less its believed bias, and the place p_imu of the IMU,

    c'' = R f - g e_z + d^2/dt^2 [ R (c - p_imu) ],        L' = d/dt [ R L ]

in level axes whose heading follows the gyroscope (*odometry* axes). Differences are centred, so that they
delay nothing. The results are kept, and interpolated linearly at the times of the feet's samples, some
samples ago (``lag``), when the packets that are needed have come.

An error of the tilt does little harm to these accelerations: the ground's force points along f from the
centre of mass, whatever way is up, so that in Eqs. 10 and 11 a common tilt cancels to first order.
"""

from collections.abc import Iterator
from functools import partial
from math import floor, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration import Reference
from surefoot.robot.beliefs.believed import Believed, nothing
from surefoot.robot.beliefs.contacts import Kinematics, Plan, Upright
from surefoot.robot.beliefs.lag import HISTORY
from surefoot.robot.beliefs.nominal import NominalModel
from surefoot.robot.beliefs.strapdown import Strapdown
from surefoot.sensors.telemetry.computer import TelemetryLayout
from surefoot.sensors.transport.link import Packet, Packets

SLOPE = 3  # packets over which the soles' velocities are taken
FURTHEST = 8.0  # how many packets ahead soles are assumed to keep their velocities

CLOCK_MEMORY = 256
"""Packets over which arrival times are averaged to find the robot's clock on the host's."""

LARGEST_VALUE = 1e3
"""Largest number in rad, rad/s or m/s^2 that a packet may hold. Beyond it, or with NaN, it counts as lost."""

FILLED_TIME = 0.1
"""Longest gap in s that is filled in by interpolation: a tenth of a stride, over which joints and gyroscope
change almost evenly. Over a longer gap the attitude is kept, and becomes uncertain."""

COM, IMU = 0, 1
"""Rows of every :class:`Rows` that do not depend on the number of feet."""


class Rows(NamedTuple):
    """Which vectors of three a row holds, of a robot on F feet, in odometry axes from the torso's origin.

    The centre of mass and the IMU in m are the first two; the others follow.
    """

    soles: slice  # places of the soles in m
    axes: slice  # the soles' axes x, y and z
    momentum: int  # angular momentum about the centre of mass in kg m^2/s
    force: int  # specific force in m/s^2
    acceleration: int  # of the centre of mass in m/s^2, which follows from the row's neighbours in time
    momentum_rate: int  # in N m, likewise
    ground: int  # normal of the ground
    accelerometer: int  # the measurement, in the IMU's own axes, in m/s^2
    gyroscope: int  # likewise, in rad/s
    width: int  # number of the vectors

    @classmethod
    def of(cls, feet: int) -> "Rows":
        """Return those of a robot on so many feet."""
        own = 2 + 4 * feet
        return cls(slice(2, 2 + feet), slice(2 + feet, own), *range(own, own + 8))


class Posture(NamedTuple):
    """The robot at the middle between two packets, in the torso's axes, from its origin.

    Its arrays are the model's own, until that evaluates another one.
    """

    com: Floats  # centre of mass in m, shape (3,)
    momentum: Floats  # angular momentum about it in kg m^2/s, shape (3,)
    sites: Floats  # IMU and soles in m, shape (1 + F, 3)
    axes: Floats  # the soles' axes x, y and z, shape (3 F, 3)
    com_velocity: Floats  # velocity of the centre of mass relative to the torso in m/s, shape (3,)
    twist: Floats  # angular velocities and velocities of IMU and soles relative to it, shape (1 + F, 6)
    R: Floats  # rotation from the torso's to the level axes, shape (3, 3)
    velocity: Floats  # of the IMU in level axes in m/s, shape (3,)


class Beliefs(Believed):
    """Makes references of telemetry, on the timeline of the feet's samples.

    Args:
        model: The robot as it believes itself to be.
        layout: Columns of a packet.
        period: Time between packets in s.
        delay: Mean delay of the link in s, as the robot knows it.
        averaged: Whether a sample of the IMU is the mean since the sample before.
        lag: How many samples of the feet ago :meth:`sample` is about.
        dt: Time between these samples in s.
        joined: How many packets become one.
        touching: The parts of each foot that may touch: centres in the sole frames and radii in m, shape
            (F, n, 4); ``None`` for the soles' origins.
        rolls: Whether feet are round, so that they stand on any of their sides.

    Attributes:
        believed: The result of the last :meth:`sample`.
        layout: Columns of a packet.
        period: Time between joined packets in s.
        dt: Time between the feet's samples in s.
        delay: As passed in, like ``averaged``, ``lag`` and ``joined``.
        feet: Number of the feet, F.
        rows: Columns of a row.
        ring: A row for each of the last packets by number, shape (HISTORY, rows.width, 3).
        ground: Normal of the ground in the axes of the last :meth:`reference`, shape (3,).
        newest: The last packet as it came, or ``None``.
        last: The last joined packet, or ``None``.
        run: Joined packets without a long gap up to it.
        seen: Packets so far.
        clock: Time on the host's clock in s at which packet 0 left.
        touching: The parts of each foot that may touch, shape (F, n, 4).
        rolls: Whether feet are round.
        parts: Packets that are being joined so far.
        sum: Of their IMU.
        strapdown: The attitude, the velocity and the ground.
        filled: Longest gap that is filled in, in packets.
        plan: Contacts by the plan.
        kinematics: Contacts by kinematics.
        upright: Whether it is.
    """

    believed: Reference

    def __init__(
        self,
        model: NominalModel,
        layout: TelemetryLayout,
        period: float,
        delay: float,
        averaged: bool,
        *,
        lag: int = 0,
        dt: float = 1.0 / 80.0,
        joined: int = 1,
        touching: Floats | None = None,
        rolls: bool = False,
    ) -> None:
        own: dict[str, Any] = {"lag": lag, "dt": dt, "joined": joined, "rolls": rolls}
        self._begin = partial(Beliefs, model, layout, period, delay, averaged, touching=touching, **own)
        self.model = model
        self.layout = layout
        self.period, self.delay, self.averaged = joined * period, delay, averaged or joined > 1
        self.joined, self.parts, self.sum = joined, 0, (0.0,) * 6
        self.feet, self.rows, self.rolls = model.feet, Rows.of(model.feet), rolls
        self.touching = np.zeros((self.feet, 1, 4)) if touching is None else touching
        self.ring = np.zeros((HISTORY, self.rows.width, 3))
        self._local = np.zeros((self.rows.force + 1, 3))
        self.strapdown = Strapdown(self.period, model.gravity, self.touching, rolls)
        self.ground = np.array([0.0, 0.0, 1.0])
        self._packet_period, self.filled = period, max(1, round(FILLED_TIME / period))
        self.newest: Packet | None = None
        self.last: Packet | None = None
        self.run = 0
        self.clock, self.seen = 0.0, 0
        self.lag, self.dt = lag, dt
        self.plan, self.kinematics, self.upright = (
            Plan(lag, self.feet),
            Kinematics(self.touching, rolls, model.gravity),
            Upright(dt, model.gravity),
        )
        self.believed = nothing(self.feet)

    def begin_episode(self) -> "Beliefs":
        """Return beliefs of the same robot at an episode's start."""
        return self._begin()

    def update(self, packets: Packets) -> None:
        """Take in packets of telemetry, in order."""
        for packet in self.join(packets):
            self.take(packet)

    def join(self, packets: Packets) -> Iterator[Packet]:
        """Yield sound packets, with lost ones filled in, and joined as many as they are to be."""
        for packet in packets:
            if np.abs(packet.values).max() <= LARGEST_VALUE:
                for part in self._fill(packet):
                    whole = self._combine(part)
                    if whole is not None:
                        yield whole

    def _fill(self, packet: Packet) -> Iterator[Packet]:
        """Yield a packet after those that were lost before it; nothing for one that comes late or twice."""
        if self.newest is not None:
            number, _, values = self.newest
            lost = packet.number - number - 1
            if -self.filled <= lost < 0:
                return
            for left in range(lost if lost <= self.filled else 0, 0, -1):
                values = values + (packet.values - values) / (left + 1)
                yield Packet(packet.number - left, packet.arrival - left * self._packet_period, values)
        self.newest = packet
        yield packet

    def take(self, packet: Packet) -> Posture | None:
        """Take in one joined packet; return the posture since the last one, ``None`` if it is not known."""
        self._synchronise(packet)
        before, self.last = self.last, packet
        if before is None or packet.number != before.number + 1:
            self.run = 0
            if before is not None:
                self.strapdown.coast((packet.number - before.number) * self.period)
            return None
        posture = self._find_posture(before.values, packet.values)
        if not self.strapdown.known:
            self.run = 0
            return None
        self.run += 1
        self._keep(posture, packet.number)
        if self.run >= 3:
            self._differentiate(packet.number)
        return posture

    def _combine(self, packet: Packet) -> Packet | None:
        """Join packets: a group's last angles and mean IMU; ``None`` before its end, or if one is missing."""
        if self.joined == 1:
            return packet
        number, part = divmod(packet.number, self.joined)
        if part == 0:
            self.parts, self.sum = 0, (0.0,) * 6
        if part != self.parts:
            self.parts = self.joined
            return None
        where, values = self.layout, packet.values
        measured = (*values[where.accelerometer].tolist(), *values[where.gyroscope].tolist())
        self.sum = tuple(a + b for a, b in zip(self.sum, measured, strict=True))
        self.parts += 1
        if self.parts < self.joined:
            return None
        values = values.copy()
        mean = np.array(self.sum) / self.joined
        values[where.accelerometer], values[where.gyroscope] = mean[:3], mean[3:]
        return Packet(number, packet.arrival, values)

    def _synchronise(self, packet: Packet) -> None:
        """Average the packets' lateness: the time on the host's clock at which number 0 left."""
        self.seen += 1
        left = packet.arrival - self.delay - packet.number * self.period
        self.clock += (left - self.clock) * max(1.0 / self.seen, 1.0 / CLOCK_MEMORY)

    def _find_posture(self, before: Floats, after: Floats) -> Posture:
        """Find the posture at the middle between two packets."""
        where, period = self.layout, self.period
        start, end = before[where.joint_position], after[where.joint_position]
        if self.averaged:
            force, spin = after[where.accelerometer], after[where.gyroscope]
        else:
            force = 0.5 * (before[where.accelerometer] + after[where.accelerometer])
            spin = 0.5 * (before[where.gyroscope] + after[where.gyroscope])
        com, momentum, sites, axes = self.model.evaluate(0.5 * (start + end), (end - start) / period, spin)
        com_velocity, twist = self.model.velocities()
        R, velocity = self.strapdown.advance(force, spin, sites, axes, twist)
        self._measured = force, spin
        return Posture(com, momentum, sites, axes, com_velocity, twist, R, velocity)

    def _keep(self, posture: Posture, number: int) -> None:
        """Fill the row at the middle between a packet and the one before."""
        force, spin = self._measured
        local, at, strapdown = self._local, self.rows, self.strapdown
        local[COM] = posture.com
        local[IMU : at.soles.stop] = posture.sites
        local[at.axes] = posture.axes
        local[at.momentum] = posture.momentum
        local[at.force] = force - strapdown.force_bias
        row = self.ring[number % HISTORY]
        np.matmul(local, posture.R.T, out=row[: at.force + 1])
        row[at.force, 2] -= strapdown.vertical_bias
        row[at.ground] = posture.R @ strapdown.ground
        row[at.accelerometer] = force
        row[at.gyroscope] = spin

    def _differentiate(self, number: int) -> None:
        """Fill in the rates one middle before a packet's, from its neighbours."""
        ring, period, at = self.ring, self.period, self.rows
        before, row, after = (ring[(number - i) % HISTORY] for i in (2, 1, 0))
        bent = before + after - 2.0 * row
        acceleration = row[at.force] + (bent[COM] - bent[IMU]) / period**2
        acceleration[2] -= self.model.gravity
        row[at.acceleration] = acceleration
        row[at.momentum_rate] = (after[at.momentum] - before[at.momentum]) / (2.0 * period)

    def sample(self, time: float, command: Any, hold: bool = False) -> bool:
        """Find the robot's beliefs for one sample of its feet.

        It is NaN while nothing is known, while the robot is not upright, and while it is held.

        Args:
            time: The moment that the reference describes in s of the host's clock.
            command: The present plan, with ``stance`` and ``swing``, shape (F,) each; or ``None`` for a
                robot that plans nothing, whose contacts are found by kinematics.
            hold: Whether beliefs are not to be used.

        Returns:
            Whether the robot was upright until this moment, and no longer is.
        """
        fell = self.find(time, command, hold)
        if command is None and self.known:
            stance, swing = self.kinematics.at(self.believed, self.ground)
            self.believed = self.believed._replace(stance=stance, swing=swing)
        return fell

    def find(self, time: float, command: Any, hold: bool) -> bool:
        """Find beliefs whose contacts are those of the plan, none without one; as :meth:`sample`."""
        nobody = np.zeros(self.feet, dtype=bool)
        contacts = nobody, nobody
        if command is not None:
            contacts = self.plan.at(command.stance, command.swing)
        self.believed = nothing(self.feet)
        if hold:
            return False
        reference = self.reference(time, *contacts)
        if not self.upright.at(reference, self.ground):
            return self.upright.fell
        self.believed = reference
        return False

    def reference(self, time: float, stance: NDArray[np.bool_], swing: NDArray[np.bool_]) -> Reference:
        """Return the robot's believed motion at a moment.

        Before enough packets have come it is NaN, which calibrators know to leave alone.

        Args:
            time: The moment in s of the host's clock.
            stance: Feet that are sure to stand then, shape (F,).
            swing: Feet that are sure to be in the air then, shape (F,).
        """
        if self.run < 3:
            return nothing(self.feet)._replace(stance=stance, swing=swing)
        rows, at = self._at(time), self.rows
        R_level_odometry, origin = _level(rows[at.soles], rows[at.axes])
        level = rows[: at.ground + 1] @ R_level_odometry.T
        self.ground = level[at.ground]
        level[: at.soles.stop] -= origin
        return Reference(
            level[COM],
            level[at.acceleration],
            level[at.momentum_rate],
            level[at.soles],
            level[at.axes].reshape(-1, 3, 3).swapaxes(1, 2),
            stance,
            swing,
            rows[at.accelerometer],
            rows[at.gyroscope],
        )

    def soles(self, time: float) -> Floats:
        """Return where the soles are at a moment later than the newest packet, at their last velocities.

        Args:
            time: The moment in s of the host's clock.

        Returns:
            Seen from above in the level frame of that moment, the place of each sole (of a round foot its
            lowest point) in m and its heading, a
            unit vector: x, y, forward x, forward y of each one, shape (F, 4).
        """
        last = self.last
        if last is None or self.run < 1 + SLOPE:
            return np.array([(0.0, 0.0, 1.0, 0.0)] * self.feet)
        newest, before = self.ring[last.number % HISTORY], self.ring[(last.number - SLOPE) % HISTORY]
        ahead = (time - self._middle(last.number)) / self.period
        ahead = min(max(ahead, 0.0), FURTHEST) / SLOPE
        poses = slice(self.rows.soles.start, self.rows.axes.stop)
        rows = newest[poses]
        rows = rows + ahead * (rows - before[poses])
        place, axes = rows[: self.feet, :2], rows[self.feet :].reshape(-1, 3, 3)
        forward, middle = axes[:, 0, :2], place.mean(axis=0)
        if self.rolls:
            arm = self.touching[..., :3] @ axes
            lowest = np.argmin(arm[..., 2] - self.touching[..., 3], axis=1)
            place = place + arm[range(self.feet), lowest, :2]
        x, y = forward.sum(axis=0).tolist()
        norm = 1.0 / sqrt(x * x + y * y)
        R = norm * np.array([[x, -y], [y, x]])
        return np.hstack([(place - middle) @ R, forward @ R])

    def _middle(self, number: int) -> float:
        """Time on the host's clock of the middle between a packet and the one before."""
        return self.clock + (number - 0.5) * self.period

    def _at(self, time: float) -> Floats:
        """Interpolate the rows that are complete, shape (ROWS, 3); at their ends, take the end."""
        last = self.last
        assert last is not None
        low, high = last.number - min(self.run, HISTORY - 1) + 2, last.number - 1
        return self.interpolate(self.ring, time, low, high)

    def interpolate(self, ring: Floats, time: float, low: int, high: int) -> Floats:
        """Interpolate a ring of rows, of the middles before packets, (HISTORY, ...), at a moment in s.

        Rows are used from the packet of number ``low`` to that of ``high``.
        """
        index = (time - self.clock) / self.period + 0.5
        index = min(max(index, low), high)
        number = min(floor(index), high - 1) if high > low else low
        row = ring[number % HISTORY]
        part = index - number
        rows: Floats = row + part * (ring[(number + 1) % HISTORY] - row)
        return rows


def _level(soles: Floats, axes: Floats) -> tuple[Floats, Floats]:
    """Find the level frame: its rotation from the odometry frame, and its origin in its own axes.

    It is midway between the soles, shape (F, 3) in m, at the height of the lowest one, and heads as they do
    on the whole; their axes x, y and z have shape (3 F, 3).
    """
    x, y, _ = axes[::3].sum(axis=0).tolist()
    norm = 1.0 / sqrt(x * x + y * y)
    x, y = x * norm, y * norm
    mx, my, _ = soles.mean(axis=0).tolist()
    R = np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]])
    return R, np.array([x * mx + y * my, x * my - y * mx, float(soles[:, 2].min())])
