"""A robot's beliefs as flat numbers, and the ground force that they require.

A reference is laid out flat because a control loop pays for every operation: one check, one choice between
the new and the last good one. The equations are those of :mod:`surefoot.calibration.cop` and
:mod:`surefoot.calibration.centroidal`; tests hold them together.

The order is that of :class:`MotionColumns`.
"""

from typing import NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.arrays import Array, in_a_row
from surefoot.calibration.checks import check_shape
from surefoot.calibration.cop import level_rows
from surefoot.calibration.reference import MomentumReference, Reference, reference_shapes
from surefoot.calibration.setup import OnlineSetup

LARGEST_REFERENCE = 1e6  # magnitude, in any unit, beyond which a value of a reference is taken for an error
FARTHEST = 5.0  # distance of the centre of mass from a sole in m, along an axis, that no robot on feet has
LARGEST_WEIGHTS = 5.0  # vertical force, in body weights, beyond which a reference is taken for an error
LARGEST_REACH = 10.0
"""Distance of a reference's centre of pressure from a sole, in foot lengths, taken for an error."""


class MotionColumns(NamedTuple):
    """Where the parts of a flat reference lie: 3 numbers each, 3 F of the soles, 9 F of their rotations."""

    com: slice
    com_acceleration: slice
    angular_momentum_rate: slice
    accelerometer: slice
    gyroscope: slice
    position_sole: slice
    R_level_sole: slice

    @classmethod
    def of(cls, feet: int) -> "MotionColumns":
        """Return the columns of a robot with some feet."""
        return cls(*in_a_row(3, 3, 3, 3, 3, 3 * feet, 9 * feet))

    @property
    def size(self) -> int:
        """Length of a flat reference, R."""
        return int(self.R_level_sole.stop)

    def soles(self, motion: Array) -> tuple[Array, Array]:
        """Return the soles of one flat reference: positions (F, 3) and rotations (F, 3, 3).

        Those of n samples, shape (n, R), have n first.
        """
        position, R = motion[..., self.position_sole], motion[..., self.R_level_sole]
        each = (*motion.shape[:-1], position.shape[-1] // 3)
        return position.reshape(*each, 3), R.reshape(*each, 3, 3)


class Motions:
    """The flat references of one setup.

    ``quasi_static`` leaves the motion out (Han): Fz = M g at (x, y); without ``imu`` accelerometer and
    gyroscope need not be sound; with ``momentum`` a
    :class:`~surefoot.calibration.reference.MomentumReference` is taken as well, whose velocity and momentum
    stand in the columns of their rates. ``taken`` are the kinds of references that are taken, ``columns``
    where the parts of a flat one lie, ``shapes`` those of each field; ``resting`` has the soles level at the
    origin, (R,).
    """

    def __init__(
        self, setup: OnlineSetup, *, quasi_static: bool = False, imu: bool = True, momentum: bool = False
    ) -> None:
        self._quasi_static, self.imu = quasi_static, imu
        self.taken: tuple[type[Reference] | type[MomentumReference], ...] = (Reference,)
        if momentum:
            self.taken = Reference, MomentumReference
        self._feet, self._wrench_map = len(setup.layout.feet), setup.layout.wrench_map
        self._threshold, self._weight, self._mass = setup.force_threshold, setup.weight, setup.mass
        self._gravity = setup.gravity
        self.reach = LARGEST_REACH * setup.length
        self.columns = MotionColumns.of(self._feet)
        self.shapes = reference_shapes(self._feet)
        level = np.tile(np.eye(3).ravel(), self._feet)
        self.resting: Floats = np.concatenate([np.zeros(self.columns.R_level_sole.start), level])

    def check(self, reference: Reference | MomentumReference) -> None:
        """Raise ValueError if a field has another shape or contacts are no booleans, or TypeError."""
        if not isinstance(reference, self.taken):
            names = " or a ".join(kind.__name__ for kind in self.taken)
            raise TypeError(f"'reference' must be a {names}, got {type(reference).__name__}.")
        for field, value in zip(reference._fields, reference, strict=True):
            check_shape(value, self.shapes[field], f"reference.{field}")
        for field, value in (("stance", reference.stance), ("swing", reference.swing)):
            if value.dtype != np.bool:
                raise ValueError(f"'reference.{field}' must hold booleans, got dtype {value.dtype}.")

    def flatten(self, reference: Reference | MomentumReference) -> Array:
        """Return the numbers of a reference side by side, in float64, shape (R,)."""
        felt = np.zeros(3), np.zeros(3)
        if self.imu and isinstance(reference, Reference):
            felt = reference.accelerometer, reference.gyroscope
        parts = (
            *reference[:3],
            *felt,
            reference.position_sole.reshape(-1),
            reference.R_level_sole.reshape(-1),
        )
        return np.concatenate(parts, dtype=np.float64)

    def is_sound(self, motion: Array) -> bool:
        """Return whether a flat reference, (R,), is finite and of a robot's size: no millimetres."""
        com, soles = motion[self.columns.com], motion[self.columns.position_sole].reshape(-1, 3)
        finite = (np.abs(motion) <= LARGEST_REFERENCE).all()
        return bool(finite and (np.abs(soles - com) <= FARTHEST).all())

    def unflatten(self, motion: Array, stance: Array, swing: Array) -> Reference:
        """Return a flat motion as a reference again, with contacts of its own."""
        columns = self.columns
        position_sole, R_level_sole = columns.soles(motion)
        return Reference(
            com=motion[columns.com],
            com_acceleration=motion[columns.com_acceleration],
            angular_momentum_rate=motion[columns.angular_momentum_rate],
            position_sole=position_sole,
            R_level_sole=R_level_sole,
            stance=stance,
            swing=swing,
            accelerometer=motion[columns.accelerometer],
            gyroscope=motion[columns.gyroscope],
        )

    def ground(self, motion: Array) -> tuple[float, Array, bool]:
        """Compute the ground reaction that a flat reference, (R,), needs, and whether a robot can do that.

        Vertical force in N (Eq. 9, or M g), and centre of pressure in m (Eqs. 10, 11, or (x, y)), shape (2,).
        """
        columns, mass = self.columns, self._mass
        com, soles = motion[columns.com], motion[columns.position_sole].reshape(-1, 3)
        if self._quasi_static:
            vgrf, cop = self._weight, com[:2]
        else:
            ax, ay, az = motion[columns.com_acceleration]
            rate_x, rate_y, _ = motion[columns.angular_momentum_rate]
            # The lower sole is on the ground whatever the robot believes of its contacts.
            lever = mass * (com[2] - soles[:, 2].min())
            vgrf = mass * (az + self._gravity)  # Eq. 9
            moment = np.array([lever * ax + rate_y, lever * ay - rate_x])
            cop = com[:2] - moment / (vgrf if vgrf > self._threshold else self._weight)  # Eqs. 10, 11
        near = (np.abs(soles[:, :2] - cop) <= self.reach).all()
        return vgrf, cop, bool(near and self._threshold < vgrf < LARGEST_WEIGHTS * self._weight)

    def rows(self, motion: Array) -> Array:
        """Return rows, (F, 3, K), by which a flat reference, (R,), has (Fz, Fz px, Fz py) of each foot."""
        return level_rows(self._wrench_map, *self.columns.soles(motion))
