"""Estimate a robot's motion without its foot sensors, at the sample times of these sensors.

Packets with encoder and IMU data arrive at 100 Hz or faster. They are numbered, delayed and subject to
jitter. Single lost packets are filled in by linear interpolation. Packets of a faster link are joined into
one packet per 10 ms, with the mean of the IMU and the last joint angles. The mean delay is known and
subtracted. The packet numbers are an even clock, so the jitter averages out.

All quantities refer to the midpoint between two packets n-1 and n. The nominal model computes the centre of
mass c, the soles and the angular momentum L from the mean and the difference of both encoder readings. The
attitude filter (:mod:`surefoot.robot.beliefs.strapdown`) computes the rotation R of the torso. With the
specific force f, corrected by its estimated bias, and the position p_imu of the IMU,

    c'' = R f - g e_z + d^2/dt^2 [ R (c - p_imu) ],        L' = d/dt [ R L ]

in level axes whose heading follows the gyroscope (*odometry* axes). Differences are centred, so they add no
delay. The results are stored. Once the required packets have arrived, they are interpolated linearly at the
time of an earlier foot sample, ``lag`` samples ago.

These accelerations are not sensitive to tilt errors. The ground reaction force points along f from the centre
of mass, whichever way is up, so a common tilt cancels to first order in Eqs. 10 and 11.
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

SLOPE = 3  # packets over which the velocities of the soles are measured
FURTHEST = 8.0  # largest number of packets over which the soles are extrapolated at constant velocity

CLOCK_MEMORY = 256
"""Packets over which arrival times are averaged to synchronise the robot's clock with that of the host."""

LARGEST_VALUE = 1e3
"""Largest value in rad, rad/s or m/s^2 of a packet. A packet with larger values or NaN counts as lost."""

FILLED_TIME = 0.1
"""Longest gap in s that is filled in by interpolation: a tenth of a stride, in which joint angles and angular
velocity change almost linearly. Over a longer gap the attitude is kept, and its covariance increases."""

COM, IMU = 0, 1
"""Indices of the first two vectors of a row, which are the same for any number of feet."""


class Rows(NamedTuple):
    """Layout of a stored row of 3-vectors for a robot with F feet, in odometry axes from the torso's origin.

    The first two vectors are the positions of the centre of mass and the IMU in m. The fields are the indices
    of the others.
    """

    soles: slice  # positions of the soles in m
    axes: slice  # the soles' axes x, y and z
    momentum: int  # angular momentum about the centre of mass in kg m^2/s
    force: int  # specific force in m/s^2
    acceleration: int  # of the centre of mass in m/s^2, computed from the neighbouring rows in time
    momentum_rate: int  # in N m, computed in the same way
    ground: int  # normal of the ground
    accelerometer: int  # measurement in the axes of the IMU in m/s^2
    gyroscope: int  # measurement in the axes of the IMU in rad/s
    width: int  # number of vectors per row

    @classmethod
    def of(cls, feet: int) -> "Rows":
        """Return the layout for a robot with this number of feet."""
        own = 2 + 4 * feet
        return cls(slice(2, 2 + feet), slice(2 + feet, own), *range(own, own + 8))


class Posture(NamedTuple):
    """The robot midway between two packets, in the torso's axes and from its origin.

    The arrays belong to the model, whose next evaluation overwrites them.
    """

    com: Floats  # centre of mass in m, shape (3,)
    momentum: Floats  # angular momentum about it in kg m^2/s, shape (3,)
    sites: Floats  # IMU and soles in m, shape (1 + F, 3)
    axes: Floats  # the soles' axes x, y and z, shape (3 F, 3)
    com_velocity: Floats  # velocity of the centre of mass relative to the torso in m/s, shape (3,)
    twist: Floats  # angular velocities and velocities of IMU and soles, relative to the torso, (1 + F, 6)
    R: Floats  # rotation from the torso's to the level axes, shape (3, 3)
    velocity: Floats  # velocity of the IMU in level axes in m/s, shape (3,)


class Beliefs(Believed):
    """Computes references from telemetry at the sample times of the foot sensors.

    Args:
        model: Nominal model of the robot.
        layout: Columns of a packet.
        period: Time between packets in s.
        delay: Nominal mean delay of the link in s.
        averaged: Whether an IMU sample is the mean since the previous sample.
        lag: Age, in foot samples, of the time that :meth:`sample` describes.
        dt: Time between foot samples in s.
        joined: Number of packets that are joined into one.
        touching: Parts of each foot that may touch the ground: centres in the sole frames and radii in m,
            shape (F, n, 4). ``None`` stands for the origins of the soles.
        rolls: Whether the feet are round and can stand on any of their sides.

    Attributes:
        believed: The result of the last :meth:`sample`.
        layout: Columns of a packet.
        period: Time between joined packets in s.
        dt: Time between foot samples in s.
        delay: As passed in, as are ``averaged``, ``lag`` and ``joined``.
        feet: Number of feet, F.
        rows: Layout of a row.
        ring: Ring buffer with one row per packet, indexed by number, shape (HISTORY, rows.width, 3).
        ground: Normal of the ground in the axes of the last :meth:`reference`, shape (3,).
        newest: The last packet as received, or ``None``.
        last: The last joined packet, or ``None``.
        run: Number of joined packets since the last long gap.
        seen: Number of joined packets so far.
        clock: Time in s, on the host's clock, at which packet 0 was sent.
        touching: Parts of each foot that may touch the ground, shape (F, n, 4).
        rolls: Whether the feet are round.
        parts: Number of packets in the group that is being joined.
        sum: Sum of their IMU measurements.
        strapdown: Filter for the attitude, the velocity and the ground.
        filled: Longest gap in packets that is filled in.
        plan: Contacts from the plan.
        kinematics: Contacts from kinematics.
        upright: Detector of whether the robot is upright.
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
        """Return a new estimator for the same robot at the start of an episode."""
        return self._begin()

    def update(self, packets: Packets) -> None:
        """Process telemetry packets in order."""
        for packet in self.join(packets):
            self.take(packet)

    def join(self, packets: Packets) -> Iterator[Packet]:
        """Yield joined packets, after removing invalid packets and filling in lost ones."""
        for packet in packets:
            if np.abs(packet.values).max() <= LARGEST_VALUE:
                for part in self._fill(packet):
                    whole = self._combine(part)
                    if whole is not None:
                        yield whole

    def _fill(self, packet: Packet) -> Iterator[Packet]:
        """Yield the lost packets before a packet, then the packet. Ignore late and repeated packets."""
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
        """Process one joined packet. Return the posture between the last packet and this one, or ``None``."""
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
        """Join a group of packets into one with the last angles and the mean IMU measurements.

        Returns ``None`` before the end of the group, or if one of its packets is missing.
        """
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
        """Update the average time, on the host's clock, at which packet 0 was sent."""
        self.seen += 1
        left = packet.arrival - self.delay - packet.number * self.period
        self.clock += (left - self.clock) * max(1.0 / self.seen, 1.0 / CLOCK_MEMORY)

    def _find_posture(self, before: Floats, after: Floats) -> Posture:
        """Compute the posture midway between two packets."""
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
        """Store the row midway between a packet and the previous one."""
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
        """Compute the rates in the row before that of a packet, from the neighbouring rows."""
        ring, period, at = self.ring, self.period, self.rows
        before, row, after = (ring[(number - i) % HISTORY] for i in (2, 1, 0))
        bent = before + after - 2.0 * row
        acceleration = row[at.force] + (bent[COM] - bent[IMU]) / period**2
        acceleration[2] -= self.model.gravity
        row[at.acceleration] = acceleration
        row[at.momentum_rate] = (after[at.momentum] - before[at.momentum]) / (2.0 * period)

    def sample(self, time: float, command: Any, hold: bool = False) -> bool:
        """Update :attr:`believed` for one sample of the foot sensors.

        The estimate is NaN while it is unknown, while the robot is not upright, and while ``hold`` is set.

        Args:
            time: Time in s, on the host's clock, that the reference describes.
            command: The current plan, with ``stance`` and ``swing``, shape (F,) each. ``None`` for a robot
                without a plan, whose contacts are determined from kinematics.
            hold: Whether the estimate must not be used.

        Returns:
            Whether the robot was upright until this time and is not any more.
        """
        fell = self.find(time, command, hold)
        if command is None and self.known:
            stance, swing = self.kinematics.at(self.believed, self.ground)
            self.believed = self.believed._replace(stance=stance, swing=swing)
        return fell

    def find(self, time: float, command: Any, hold: bool) -> bool:
        """Update as :meth:`sample` does, but without contacts if there is no plan."""
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
        """Return the robot's estimated motion at a time.

        The motion is NaN until enough packets have arrived. Calibrators ignore such references.

        Args:
            time: Time in s on the host's clock.
            stance: Feet that are certainly in stance at this time, shape (F,).
            swing: Feet that are certainly in swing at this time, shape (F,).
        """
        if self.run < 3:
            return nothing(self.feet)._replace(stance=stance, swing=swing)
        rows, at = self._at(time), self.rows
        if np.isnan(rows[COM, 0]):
            return nothing(self.feet)._replace(stance=stance, swing=swing)
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
        """Extrapolate the poses of the soles beyond the newest packet at constant velocity.

        Args:
            time: Time in s on the host's clock.

        Returns:
            Position and heading of each sole in the horizontal plane of the level frame at that time: x and y
            in m (for a round foot, of its lowest point), and x and y of the unit vector that points forward,
            shape (F, 4).
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
        """Return the time, on the host's clock, midway between a packet and the previous one."""
        return self.clock + (number - 0.5) * self.period

    def _at(self, time: float) -> Floats:
        """Interpolate the complete rows, shape (rows.width, 3)."""
        last = self.last
        assert last is not None
        low, high = last.number - min(self.run, HISTORY - 1) + 2, last.number - 1
        return self.interpolate(self.ring, time, low, high)

    def interpolate(self, ring: Floats, time: float, low: int, high: int) -> Floats:
        """Interpolate a ring buffer of rows, shape (HISTORY, ...), at a time in s.

        Each row belongs to the midpoint before the packet with its number. Only rows of packets ``low`` to
        ``high`` are used. A time outside their range takes the nearest row, because a packet may be late, but
        not beyond the longest gap that is filled in. Beyond that gap the result is NaN.
        """
        wanted = (time - self.clock) / self.period + 0.5
        index = min(max(wanted, low), high)
        if not abs(wanted - index) * self.joined <= self.filled:
            return np.full_like(ring[0], np.nan)
        number = min(floor(index), high - 1) if high > low else low
        row = ring[number % HISTORY]
        part = index - number
        rows: Floats = row + part * (ring[(number + 1) % HISTORY] - row)
        return rows


def _level(soles: Floats, axes: Floats) -> tuple[Floats, Floats]:
    """Return the level frame: its rotation from the odometry frame, and its origin in its own axes.

    The origin is midway between the soles, at the height of the lowest one. The heading is the mean heading
    of the soles.

    Args:
        soles: Positions of the soles in m, shape (F, 3).
        axes: Axes x, y and z of the soles, shape (3 F, 3).
    """
    x, y, _ = axes[::3].sum(axis=0).tolist()
    norm = 1.0 / sqrt(x * x + y * y)
    x, y = x * norm, y * norm
    mx, my, _ = soles.mean(axis=0).tolist()
    R = np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]])
    return R, np.array([x * mx + y * my, x * my - y * mx, float(soles[:, 2].min())])
