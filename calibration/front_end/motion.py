"""A robot's beliefs as flat numbers, and what they say of the ground; private.

A reference is laid out flat because a control loop pays for every operation: one check, one choice between
the new and the last good one. The equations are those of :mod:`surefoot.calibration.cop` and
:mod:`surefoot.calibration.centroidal`; tests hold them together.

The order is com, com_acceleration, angular_momentum_rate, accelerometer, gyroscope (3 each), position_sole
(3 F), R_level_sole (9 F).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration._constants import Constants, namespace_of, shaped
from surefoot.calibration._setup import OnlineSetup
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.reference import GRAVITY, Reference

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""

LARGEST_REFERENCE = 1e6
"""Magnitude, in any unit, beyond which a value of a reference is taken for an error."""

LARGEST_WEIGHTS = 5.0
"""Vertical force, in body weights, beyond which a reference is taken for an error."""

LARGEST_REACH = 10.0
"""Distance of a reference's centre of pressure from a sole, in foot lengths, taken for an error."""


class Motions:
    """The flat references of one setup.

    Args:
        setup: What the method was told about the robot.
        quasi_static: Whether the reference leaves the motion out (Han): Fz = M g at (x, y).

    Attributes:
        tails: The shape of each field of a reference behind its batch dimensions.
        resting: A flat reference with the soles level at the origin, shape (R,).
    """

    def __init__(self, setup: OnlineSetup, *, quasi_static: bool = False) -> None:
        self._quasi_static = quasi_static
        self._feet, self._channels = len(setup.layout.feet), setup.layout.channels
        self._threshold, self._weight, self._mass = setup.force_threshold, setup.weight, setup.mass
        self._reach = LARGEST_REACH * setup.length
        self._soles = 15 + 3 * self._feet
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
        self.resting: NDArray[np.float64] = np.concatenate([np.zeros(self._soles), level])
        quarter_turn = [[0.0, -1.0], [1.0, 0.0], [0.0, 0.0]]
        self._constants = Constants(_row_map(setup.layout), quarter_turn)

    def check(self, reference: Reference, batch: tuple[int, ...], boolean: Any) -> None:
        """Refuse a reference that does not fit.

        Args:
            reference: The reference.
            batch: The batch shape that it must have.
            boolean: The dtype of booleans.

        Raises:
            ValueError: If a field has another shape, or contacts are no booleans.
            TypeError: If it is no reference.
        """
        if not isinstance(reference, Reference):
            raise TypeError(f"'reference' must be a Reference, got {type(reference).__name__}.")
        for field, value in zip(Reference._fields, reference, strict=True):
            shape = batch + self.tails[field]
            if getattr(value, "shape", None) != shape:
                found = tuple(value.shape) if hasattr(value, "shape") else type(value).__name__
                raise ValueError(f"'reference.{field}' must have shape {shape}, got {found}.")
        for field, value in (("stance", reference.stance), ("swing", reference.swing)):
            if value.dtype != boolean:
                raise ValueError(f"'reference.{field}' must hold booleans, got dtype {value.dtype}.")

    def flatten(self, reference: Reference, like: Array) -> Array:
        """Lay the numbers of a reference side by side, in the dtype of the readings, shape (..., R)."""
        xp, batch = namespace_of(like), tuple(like.shape[:-1])
        parts = (
            reference.com,
            reference.com_acceleration,
            reference.angular_momentum_rate,
            reference.accelerometer,
            reference.gyroscope,
            shaped(reference.position_sole, (*batch, 3 * self._feet)),
            shaped(reference.R_level_sole, (*batch, 9 * self._feet)),
        )
        if any(part.dtype != like.dtype for part in parts):
            # Clipped before they are converted, as what overflows would warn; it is refused all the same.
            limit = 2 * LARGEST_REFERENCE
            parts = tuple(xp.astype(xp.clip(part, -limit, limit), like.dtype) for part in parts)
        return xp.concat(parts, axis=-1)

    def unflatten(self, motion: Array, stance: Array, swing: Array) -> Reference:
        """Say a flat motion as a reference again, with contacts of its own."""
        feet, soles = self._feet, self._soles
        xp, batch = namespace_of(motion), tuple(motion.shape[:-1])
        return Reference(
            com=motion[..., 0:3],
            com_acceleration=motion[..., 3:6],
            angular_momentum_rate=motion[..., 6:9],
            position_sole=xp.reshape(motion[..., 15:soles], (*batch, feet, 3)),
            R_level_sole=xp.reshape(motion[..., soles:], (*batch, feet, 3, 3)),
            stance=stance,
            swing=swing,
            accelerometer=motion[..., 9:12],
            gyroscope=motion[..., 12:15],
        )

    def ground(self, motion: Array) -> tuple[Array, Array, Array]:
        """Compute what a motion asks of the ground.

        Args:
            motion: Flat references, shape (..., R).

        Returns:
            Vertical force in N (Eq. 9, or M g), shape (...); centre of pressure in m (Eqs. 10, 11, or (x,
            y)), shape (..., 2); and whether a robot can do that at all (bool), shape (...).
        """
        xp, (_, quarter_turn) = namespace_of(motion), self._constants.like(motion)
        threshold, mass, weight, feet = self._threshold, self._mass, self._weight, self._feet
        soles = shaped(motion[..., 15 : self._soles], (*motion.shape[:-1], feet, 3))
        com_xy = motion[..., :2]
        if self._quasi_static:
            vgrf, cop = 0.0 * motion[..., 2] + weight, com_xy
        else:
            vgrf = mass * (motion[..., 5] + GRAVITY)  # Eq. 9
            safe_vgrf = xp.where(vgrf > threshold, vgrf, weight)
            # The lower sole is on the ground whatever the robot believes of its contacts.
            height = mass * (motion[..., 2] - xp.min(soles[..., 2], axis=-1))
            moment = height[..., None] * motion[..., 3:5] + xp.matmul(motion[..., 6:9], quarter_turn)
            cop = com_xy - moment / safe_vgrf[..., None]  # Eqs. 10, 11
        reach = xp.abs(soles[..., :2] - cop[..., None, :])
        near = xp.all(reach <= self._reach, axis=(-2, -1))
        return vgrf, cop, near & (vgrf > threshold) & (vgrf < LARGEST_WEIGHTS * weight)

    def rows(self, motion: Array) -> Array:
        """Write (Fz, Fz px, Fz py) of each foot as rows by channel in the level frame.

        Args:
            motion: Flat references, shape (..., R).

        Returns:
            Shape (..., F, 3, K).
        """
        xp, (row_map, _) = namespace_of(motion), self._constants.like(motion)
        batch, feet = tuple(motion.shape[:-1]), self._feet
        position = shaped(motion[..., 15 : self._soles], (*batch, feet, 3))
        rotation = shaped(motion[..., self._soles :], (*batch, feet, 9))
        up = rotation[..., 6:9]
        lever = shaped(position[..., :2, None] * up[..., None, :], (*batch, feet, 6))
        features = xp.concat([up, lever, rotation[..., :6]], axis=-1)
        rows = xp.matmul(shaped(features, (*batch, 15 * feet)), row_map)
        return shaped(rows, (*batch, feet, 3, self._channels))


def _row_map(layout: FeetLayout) -> NDArray[np.float64]:
    """Map each foot's (up, px up, py up, ex, ey) to its rows (Fz, Fz px, Fz py) by channel.

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
    return row_map.reshape(15 * feet, 3 * feet * channels)
