"""A robot's beliefs as flat numbers, and what they ask of the ground.

A reference is laid out flat because a control loop pays for every operation: one check, one choice between
the new and the last good one. The equations are those of :mod:`surefoot.calibration.cop` and
:mod:`surefoot.calibration.centroidal`; tests hold them together.

The order is that of :class:`MotionColumns`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array, in_a_row
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.reference import GRAVITY, Reference
from surefoot.calibration.setup import OnlineSetup

LARGEST_REFERENCE = 1e6
"""Magnitude, in any unit, beyond which a value of a reference is taken for an error."""

_FEATURES = 15
"""Numbers of a foot that its rows are linear in: up, px up, py up, ex, ey, 3 each."""

LARGEST_WEIGHTS = 5.0
"""Vertical force, in body weights, beyond which a reference is taken for an error."""

LARGEST_REACH = 10.0
"""Distance of a reference's centre of pressure from a sole, in foot lengths, taken for an error."""

_QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
"""Takes (x, y, z) to (y, -x)."""


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
        """Return the soles of flat references: positions (..., F, 3) and rotations (..., F, 3, 3)."""
        position, R = motion[..., self.position_sole], motion[..., self.R_level_sole]
        each = (*motion.shape[:-1], position.shape[-1] // 3)
        return position.reshape(*each, 3), R.reshape(*each, 3, 3)


class Motions:
    """The flat references of one setup.

    Args:
        setup: The robot.
        quasi_static: Whether the reference leaves the motion out (Han): Fz = M g at (x, y).
        imu: Whether accelerometer and gyroscope are used; what is not used need not be sound.

    Attributes:
        imu: The same.
        columns: Where the parts of a flat reference lie.
        tails: The shape of each field of a reference behind its batch dimensions.
        resting: A flat reference with the soles level at the origin, shape (R,).
    """

    def __init__(self, setup: OnlineSetup, *, quasi_static: bool = False, imu: bool = True) -> None:
        self._quasi_static, self.imu = quasi_static, imu
        self._feet, self._channels = len(setup.layout.feet), setup.layout.channels
        self._threshold, self._weight, self._mass = setup.force_threshold, setup.weight, setup.mass
        self._reach = LARGEST_REACH * setup.length
        self.columns = MotionColumns.of(self._feet)
        self.tails: dict[str, tuple[int, ...]] = {
            "com": (3,),
            "com_acceleration": (3,),
            "angular_momentum_rate": (3,),
            "position_sole": (self._feet, 3),
            "R_level_sole": (self._feet, 3, 3),
            "stance": (self._feet,),
            "swing": (self._feet,),
            "accelerometer": (3,),
            "gyroscope": (3,),
        }
        level = np.tile(np.eye(3).ravel(), self._feet)
        self.resting: NDArray[np.float64] = np.concatenate([np.zeros(self.columns.R_level_sole.start), level])
        self._row_map = _row_map(setup.layout)

    def check(self, reference: Reference, batch: tuple[int, ...]) -> None:
        """Raise an error if a reference does not fit.

        Args:
            reference: The reference.
            batch: The batch shape that it must have.

        Raises:
            ValueError: If a field has another shape, or contacts are no booleans.
            TypeError: If it is no reference.
        """
        if not isinstance(reference, Reference):
            raise TypeError(f"'reference' must be a Reference, got {type(reference).__name__}.")
        for field, value in zip(Reference._fields, reference, strict=True):
            shape = batch + self.tails[field]
            if getattr(value, "shape", None) != shape:
                found = value.shape if hasattr(value, "shape") else type(value).__name__
                raise ValueError(f"'reference.{field}' must have shape {shape}, got {found}.")
        for field, value in (("stance", reference.stance), ("swing", reference.swing)):
            if value.dtype != np.bool:
                raise ValueError(f"'reference.{field}' must hold booleans, got dtype {value.dtype}.")

    def flatten(self, reference: Reference) -> Array:
        """Return the numbers of a reference side by side, in float64, shape (..., R)."""
        batch = reference.com.shape[:-1]
        parts = (
            reference.com,
            reference.com_acceleration,
            reference.angular_momentum_rate,
            reference.accelerometer if self.imu else np.zeros_like(reference.com),
            reference.gyroscope if self.imu else np.zeros_like(reference.com),
            reference.position_sole.reshape(*batch, 3 * self._feet),
            reference.R_level_sole.reshape(*batch, 9 * self._feet),
        )
        return np.concatenate(parts, axis=-1, dtype=np.float64)

    def unflatten(self, motion: Array, stance: Array, swing: Array) -> Reference:
        """Return a flat motion as a reference again, with contacts of its own."""
        columns = self.columns
        position_sole, R_level_sole = columns.soles(motion)
        return Reference(
            com=motion[..., columns.com],
            com_acceleration=motion[..., columns.com_acceleration],
            angular_momentum_rate=motion[..., columns.angular_momentum_rate],
            position_sole=position_sole,
            R_level_sole=R_level_sole,
            stance=stance,
            swing=swing,
            accelerometer=motion[..., columns.accelerometer],
            gyroscope=motion[..., columns.gyroscope],
        )

    def ground(self, motion: Array) -> tuple[Array, Array, Array]:
        """Return what a motion asks of the ground.

        Args:
            motion: Flat references, shape (..., R).

        Returns:
            Vertical force in N (Eq. 9, or M g), shape (...); centre of pressure in m (Eqs. 10, 11, or (x,
            y)), shape (..., 2); and whether a robot can do that at all (bool), shape (...).
        """
        columns = self.columns
        threshold, mass, weight = self._threshold, self._mass, self._weight
        soles = motion[..., columns.position_sole].reshape(*motion.shape[:-1], self._feet, 3)
        com = motion[..., columns.com]
        if self._quasi_static:
            vgrf, cop = 0.0 * com[..., 2] + weight, com[..., :2]
        else:
            acceleration = motion[..., columns.com_acceleration]
            rate = motion[..., columns.angular_momentum_rate]
            vgrf = mass * (acceleration[..., 2] + GRAVITY)  # Eq. 9
            safe_vgrf = np.where(vgrf > threshold, vgrf, weight)
            # The lower sole is on the ground whatever the robot believes of its contacts.
            height = mass * (com[..., 2] - soles[..., 2].min(axis=-1))
            moment = height[..., None] * acceleration[..., :2] + rate @ _QUARTER_TURN
            cop = com[..., :2] - moment / safe_vgrf[..., None]  # Eqs. 10, 11
        reach = np.abs(soles[..., :2] - cop[..., None, :])
        near = (reach <= self._reach).all(axis=(-2, -1))
        return vgrf, cop, near & (vgrf > threshold) & (vgrf < LARGEST_WEIGHTS * weight)

    def rows(self, motion: Array) -> Array:
        """Return rows by channel that give (Fz, Fz px, Fz py) of each foot in the level frame.

        Args:
            motion: Flat references, shape (..., R).

        Returns:
            Shape (..., F, 3, K).
        """
        columns, batch, feet = self.columns, motion.shape[:-1], self._feet
        position = motion[..., columns.position_sole].reshape(*batch, feet, 3)
        rotation = motion[..., columns.R_level_sole].reshape(*batch, feet, 9)
        axes, up = rotation[..., :6], rotation[..., 6:]
        lever = (position[..., :2, None] * up[..., None, :]).reshape(*batch, feet, 6)
        features = np.concatenate([up, lever, axes], axis=-1)
        rows = features.reshape(*batch, _FEATURES * feet) @ self._row_map
        return rows.reshape(*batch, feet, 3, self._channels)


def _row_map(layout: FeetLayout) -> NDArray[np.float64]:
    """Return what maps each foot's (up, px up, py up, ex, ey) to its rows (Fz, Fz px, Fz py) by channel.

    ``ex``, ``ey`` and ``up`` are the rows of R_level_sole, so that with f and t the sole's force and torque

        Fz = up . f,    Fz px = px up . f - ey . t,    Fz py = py up . f + ex . t.

    Returns:
        Shape (15 F, 3 F K).
    """
    feet, channels = len(layout.feet), layout.channels
    row_map = np.zeros((feet, 5, 3, feet, 3, channels))
    for foot, wrench_map in enumerate(layout.wrench_map):
        force, torque = wrench_map[:3], wrench_map[3:]
        for row in range(3):
            row_map[foot, row, :, foot, row] = force
        row_map[foot, 4, :, foot, 1] = -torque
        row_map[foot, 3, :, foot, 2] = torque
    return row_map.reshape(_FEATURES * feet, 3 * feet * channels)
