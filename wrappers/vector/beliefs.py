"""What N robots can know of their own motion: :mod:`surefoot.wrappers.beliefs`, written for all at once.

Packets come once a control step and a whole number of steps late (:mod:`surefoot.wrappers.vector.telemetry`),
so that where to read between them never changes. A packet that no robot can have measured counts as lost, as
it does there: the one before is held in its place, and nothing is known until rows that touch it are past.
"""

from math import ceil

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY, Reference
from surefoot.wrappers.beliefs import (
    ACCELERATION,
    ACCELEROMETER,
    AXES,
    COM,
    FORCE,
    FURTHEST,
    GYROSCOPE,
    IMU,
    LARGEST_VALUE,
    MOMENTUM,
    MOMENTUM_RATE,
    ROWS,
    SLOPE,
    SOLES,
)
from surefoot.wrappers.telemetry import TelemetryLayout
from surefoot.wrappers.vector.nominal import BatchNominal, Postures
from surefoot.wrappers.vector.odometry import BatchOdometry

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SITES = slice(IMU, SOLES.stop)
_POSES = slice(SOLES.start, AXES.stop)


class BatchBeliefs:
    """Makes references of the telemetry of N robots with two feet.

    Args:
        model: The robots as they believe themselves to be.
        layout: What a packet holds.
        period: Duration of a control step, which is the time between packets, in s.
        delay: By how many steps packets are late.
        averaged: Whether a sample of the IMU is the mean since the sample before.
        age: How long before now the moment of a reference is, in s.

    Raises:
        ValueError: If packets that are needed for it come later than that.
    """

    def __init__(
        self,
        model: BatchNominal,
        layout: TelemetryLayout,
        period: float,
        delay: int,
        averaged: bool,
        age: float,
    ) -> None:
        count = len(model.mass)
        self._model, self._layout = model, layout
        self._period, self._delay, self._averaged = period, delay, averaged
        self._odometry = BatchOdometry(count, period)
        behind = age / period - delay - 0.5
        if behind < 1.0 - 1e-9:
            least = ceil(delay + 1.5 - 1e-9) * period
            raise ValueError(
                f"A reference of {age:g} s ago needs packets that have not come; over this link it must be "
                f"at least {least:g} s: choose a longer 'lag'."
            )
        # Rows lie in the ring by age: the newest is row 0, and rates are complete from row 1 on.
        self._older = max(ceil(behind - 1e-9), 1)
        self._part = self._older - behind
        self._length = max(self._older, SLOPE) + 1
        self._ring: Floats = np.zeros((self._length, count, ROWS, 3))
        self._now = 0
        self._before: Floats | None = None
        self._unsure = np.zeros(count, dtype=np.int64)

    @property
    def force_bias(self) -> Floats:
        """What the robots take for errors of their accelerometers in m/s^2, shape (N, 3)."""
        return self._odometry.force_bias

    def update(self, packet: Floats, starting: Mask | None = None) -> None:
        """Take in one packet of each robot.

        Args:
            packet: Shape (N, C).
            starting: Robots whose episode starts, shape (N,), with a packet of one at rest.
        """
        if self._before is None:
            starting = np.ones(len(packet), dtype=bool)
            self._before = np.zeros_like(packet)
        before = self._before
        # NaN compares as false.
        lost = ~(np.abs(packet).max(axis=1) <= LARGEST_VALUE)
        self._unsure = np.maximum(self._unsure - 1, 0)
        if starting is not None:
            self._unsure[starting] = 0
        if lost.any():
            packet = np.where(lost[:, None], before, packet)
            # Rates of two rows on either side of it follow from it, and a reference lies between two rows.
            self._unsure[lost] = self._older + 3
        if starting is not None:
            before = np.where(starting[:, None], packet, before)
            self._odometry.begin_episode(starting)
        self._now = (self._now + 1) % self._length
        row = self._ring[self._now]
        self._posture(before, packet, row)
        self._before = packet.copy()
        if starting is not None:
            self._ring[:, starting] = row[starting]
        self._differentiate(starting)

    def begin_episode(self, packet: Floats, mask: Mask) -> None:
        """Start episodes of some robots between two packets.

        Args:
            packet: Shape (N, C), those of ``mask`` of robots at rest.
            mask: These robots, shape (N,).
        """
        if self._before is None:
            self._before = packet.copy()
        self._unsure[mask] = 0
        index, layout = np.flatnonzero(mask), self._layout
        angle = packet[:, layout.joint_position]
        force, spin = packet[:, layout.accelerometer], packet[:, layout.gyroscope]
        postures = self._model.evaluate(angle, np.zeros_like(angle), spin)
        alone, row = BatchOdometry(len(index), self._period), np.zeros((len(index), ROWS, 3))
        self._write(Postures(*(part[index] for part in postures)), force[index], spin[index], alone, row)
        self._ring[:, index] = row
        self._odometry.take(index, alone)
        self._before[index] = packet[index]

    def _row(self, older: int) -> Floats:
        row: Floats = self._ring[(self._now - older) % self._length]
        return row

    def _posture(self, before: Floats, after: Floats, row: Floats) -> None:
        """Fill the newest row: the middle between two packets."""
        layout = self._layout
        start, end = before[:, layout.joint_position], after[:, layout.joint_position]
        force, spin = after[:, layout.accelerometer], after[:, layout.gyroscope]
        if not self._averaged:
            force = 0.5 * (before[:, layout.accelerometer] + force)
            spin = 0.5 * (before[:, layout.gyroscope] + spin)
        postures = self._model.evaluate(0.5 * (start + end), (end - start) / self._period, spin)
        self._write(postures, force, spin, self._odometry, row)

    def _write(
        self, postures: Postures, force: Floats, spin: Floats, odometry: BatchOdometry, row: Floats
    ) -> None:
        """Write a row of shape (n, ROWS, 3) of what follows from kinematics, in odometry axes."""
        sites, axes = postures.sites, postures.axes
        R_odometry_torso = odometry.turn(spin, force, sites[:, 1:], axes[:, 2::3])
        local = np.empty((len(row), FORCE + 1, 3))
        local[:, COM], local[:, _SITES], local[:, AXES] = postures.com, sites, axes
        local[:, MOMENTUM], local[:, FORCE] = postures.momentum, force - odometry.force_bias
        np.matmul(local, R_odometry_torso.swapaxes(1, 2), out=row[:, : FORCE + 1])
        row[:, ACCELEROMETER] = force
        row[:, GYROSCOPE] = spin

    def _differentiate(self, starting: Mask | None) -> None:
        """Fill in the rates one row before the newest, from its neighbours."""
        before, row, after, period = self._row(2), self._row(1), self._row(0), self._period
        bent = before + after
        bent -= 2.0 * row
        row[:, ACCELERATION] = row[:, FORCE] + (bent[:, COM] - bent[:, IMU]) / period**2
        row[:, ACCELERATION, 2] -= GRAVITY
        row[:, MOMENTUM_RATE] = (after[:, MOMENTUM] - before[:, MOMENTUM]) / (2.0 * period)
        if starting is not None:
            self._ring[:, starting, ACCELERATION : MOMENTUM_RATE + 1] = 0.0

    def reference(self, stance: Mask, swing: Mask, unknown: Mask) -> Reference:
        """Return what the robots believed to do at the moment that references are about.

        Args:
            stance: Feet that are sure to stand then, shape (N, 2).
            swing: Feet that are sure to be in the air then, shape (N, 2).
            unknown: Robots whose reference is to be NaN, which calibrators know to leave alone, shape (N,);
                it also is for robots with a packet that was lost of late.
        """
        unknown = unknown | (self._unsure > 0)
        older = self._row(self._older)
        rows = older + self._part * (self._row(self._older - 1) - older)
        R_level_odometry, origin = _level(rows)
        level = rows[:, : MOMENTUM_RATE + 1] @ R_level_odometry.swapaxes(1, 2)
        level[:, : SOLES.stop] -= origin[:, None]
        if unknown.any():
            level[unknown] = np.nan
        return Reference(
            level[:, COM],
            level[:, ACCELERATION],
            level[:, MOMENTUM_RATE],
            level[:, SOLES],
            level[:, AXES].reshape(-1, 2, 3, 3).swapaxes(-1, -2),
            stance,
            swing,
            rows[:, ACCELEROMETER],
            rows[:, GYROSCOPE],
        )

    def soles(self) -> tuple[Floats, Floats]:
        """Return where the soles are now, later than the newest packet, at their last velocities.

        Returns:
            In the level frames of now: places of the soles in m and their headings, unit vectors, shape
            (N, 2, 2) each, seen from above.
        """
        ahead = min(self._delay + 0.5, FURTHEST) / SLOPE
        newest = self._row(0)[:, _POSES, :2]
        poses = newest + ahead * (newest - self._row(SLOPE)[:, _POSES, :2])
        heading = poses[:, 2::3]
        turn = _heading(heading)
        half = 0.5 * (poses[:, :1] - poses[:, 1:2])
        place = np.concatenate([half, -half], axis=1)
        return _turned(turn, place), _turned(turn, heading)


def _level(rows: Floats) -> tuple[Floats, Floats]:
    """Find the level frames: rotations from the odometry frames, and origins in their own axes."""
    turn = _heading(rows[:, AXES, :2][:, ::3])
    R = np.zeros((len(rows), 3, 3))
    R[:, 0, :2] = turn
    R[:, 1, 0], R[:, 1, 1] = -turn[:, 1], turn[:, 0]
    R[:, 2, 2] = 1.0
    soles = rows[:, SOLES]
    origin = np.empty((len(rows), 3))
    origin[:, :2] = _turned(turn, 0.5 * (soles[:, :1, :2] + soles[:, 1:, :2]))[:, 0]
    origin[:, 2] = np.minimum(soles[:, 0, 2], soles[:, 1, 2])
    return R, origin


def _heading(axes: Floats) -> Floats:
    """Find the mean of two headings, shape (N, 2, 2) to (N, 2)."""
    both = axes[:, 0] + axes[:, 1]
    heading: Floats = both / np.sqrt(np.einsum("ni,ni->n", both, both))[:, None]
    return heading


def _turned(turn: Floats, vector: Floats) -> Floats:
    """Return vectors, shape (N, n, 2), in axes of which the first is ``turn``, shape (N, 2)."""
    x, y = turn[:, None, 0], turn[:, None, 1]
    return np.stack(
        [x * vector[..., 0] + y * vector[..., 1], x * vector[..., 1] - y * vector[..., 0]], axis=-1
    )
