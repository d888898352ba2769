"""A robot's knowledge of its momentum: velocity increments of its IMU, held by the legs that stand.

The IMU's velocity and the torso's rotation are those of :mod:`surefoot.robot.beliefs.strapdown`, in axes that
are level and whose heading follows the gyroscope. Only encoders are differentiated.

A row describes the middle between two packets. Rows are interpolated linearly.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration import MomentumReference, Reference
from surefoot.robot.beliefs.believed import Believed, unknown
from surefoot.robot.beliefs.lag import HISTORY
from surefoot.robot.beliefs.nominal import NominalModel
from surefoot.robot.beliefs.references import Beliefs, Posture
from surefoot.sensors.transport.link import Packets

if TYPE_CHECKING:
    from surefoot.envs.instrumentation.drawing import RobotDrawing


COM = 0  # row of the centre of mass in every MomentumRows


class MomentumRows(NamedTuple):
    """Which vectors of three a row holds, of a robot on F feet.

    Axes are level, with a heading that follows the gyroscope. The centre of mass in m is the first one; the
    others follow.
    """

    soles: slice  # places of the soles in m
    axes: slice  # the soles' axes x, y and z
    velocity: int  # of the centre of mass in m/s
    momentum: int  # angular momentum about it in kg m^2/s
    width: int  # number of the vectors

    @classmethod
    def of(cls, feet: int) -> "MomentumRows":
        """Return those of a robot on so many feet."""
        own = 1 + 4 * feet
        return cls(slice(1, 1 + feet), slice(1 + feet, own), own, own + 1, own + 2)


class MomentumBeliefs(Believed):
    """Makes references that hold momentum; attitude, contacts and upright posture are those of ``beliefs``.

    Attributes:
        beliefs: Those that hold accelerations.
        believed: The result of the last :meth:`sample`.
        rows: Columns of a row.
        ring: A row for each of the last packets by number, shape (HISTORY, rows.width, 3).
    """

    def __init__(self, beliefs: Beliefs) -> None:
        self.beliefs = beliefs
        self.rows = MomentumRows.of(beliefs.feet)
        self.ring = np.zeros((HISTORY, self.rows.width, 3))
        self.believed = unknown(beliefs.feet)

    def begin_episode(self) -> "MomentumBeliefs":
        """Return beliefs of the same robot at an episode's start."""
        return MomentumBeliefs(self.beliefs.begin_episode())

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
            posture = self.beliefs.take(packet)
            if posture is not None:
                self._keep(posture, packet.number)

    def _keep(self, posture: Posture, number: int) -> None:
        """Fill the row at the middle before the newest packet."""
        row, at = self.ring[number % HISTORY], self.rows
        row[COM], row[at.soles], row[at.axes] = posture.com, posture.sites[1:], posture.axes
        row[at.momentum] = posture.momentum
        row[at.velocity] = posture.com_velocity - posture.twist[0, 3:]
        np.matmul(row, posture.R.T, out=row)
        row[at.velocity] += posture.velocity
        row[: at.soles.stop] += self.beliefs.strapdown.place

    def sample(self, time: float, command: Any, hold: bool = False) -> bool:
        """Find the robot's beliefs for one sample of its feet; as :meth:`Beliefs.sample`."""
        fell, found = self.beliefs.sample(time, command, hold), self.beliefs.believed
        self.believed = unknown(self.beliefs.feet)
        if self.beliefs.known:
            self.believed = self.momentum(time, found.stance, found.swing)
        return fell

    def reference(self, time: float, stance: NDArray[np.bool_], swing: NDArray[np.bool_]) -> Reference:
        """Return accelerations at a moment; as :meth:`Beliefs.reference`."""
        return self.beliefs.reference(time, stance, swing)

    def momentum(self, time: float, stance: NDArray[np.bool_], swing: NDArray[np.bool_]) -> MomentumReference:
        """Return the momentum at the end of an interval of which a moment is the middle, as a reading's is.

        Arguments are those of :meth:`Beliefs.reference`.
        """
        beliefs, at = self.beliefs, self.rows
        if beliefs.last is None or beliefs.run < 2:
            return unknown(beliefs.feet)._replace(stance=stance, swing=swing)
        newest = beliefs.last.number
        low = newest - min(beliefs.run, HISTORY - 1) + 1
        rows = beliefs.interpolate(self.ring, time + 0.5 * beliefs.dt, low, newest)
        return MomentumReference(
            com=rows[COM],
            com_velocity=rows[at.velocity],
            angular_momentum=rows[at.momentum],
            position_sole=rows[at.soles],
            R_level_sole=rows[at.axes].reshape(-1, 3, 3).swapaxes(1, 2),
            stance=stance,
            swing=swing,
        )


class Touching(NamedTuple):
    """The parts of each foot that may touch the ground."""

    places: Floats  # centres in the sole frames and radii in m, shape (F, n, 4); radii are 0 of points
    rolls: bool  # whether feet stand on any of their sides, so that a sole does not show the level

    @classmethod
    def of(cls, drawing: "RobotDrawing") -> "Touching":
        """Return that of a robot; two feet without area are taken for flat, and touch at their origins."""
        if drawing.flaw and len(drawing.feet) == 2:
            return cls(np.zeros((2, 1, 4)), False)
        return cls(drawing.touching, bool(drawing.flaw))
