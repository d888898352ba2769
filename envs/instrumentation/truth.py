"""The measurements of an instrumented robot's sensors of its feet; signs and frames are defined here.

A row is a substep: the forces that acted in it and the poses at its beginning, and, where all substeps of a
control step are read, angles and gyroscope at its end. MuJoCo's force and torque sensors measure the load
that the parent exerts on the child, its contact sensor the load of the first body on the other; both change
sign, so that all wrenches here go up into the robot.

The cells are springs under a massless plate that covers the sole (:class:`SolePlate`): they
share the ground's force, and their centre of pressure is that of the contacts.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.instrumentation.robot import RowLayout

CONTACT_FORCE = 5.0  # vertical force in N above which a centre of pressure is defined


class _Part:
    """A part of rows whose columns have its name."""

    def __init__(self, text: str) -> None:
        self.__doc__ = text

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, truth: Any, owner: type | None = None) -> Any:
        return self if truth is None else truth.rows[..., getattr(truth.columns, self._name)]


class FeetTruth:
    """The loads of F feet and the torso in one substep, or in many; its arrays are not to be changed.

    Args:
        rows: Readings, shape (..., columns); they are kept and not copied.
        layout: The meaning of the columns.
    """

    time = _Part("Simulated time in s, shape (...).")
    position_torso = _Part("Origin of the torso's frame in the world in m, shape (..., 3).")
    com = _Part("Centre of mass of the robot in the world in m, shape (..., 3).")
    com_velocity = _Part("Velocity of the centre of mass in the world in m/s, shape (..., 3).")
    angular_momentum = _Part(
        "Angular momentum about the centre of mass, in the world's axes, in kg m^2/s, shape (..., 3)."
    )
    accelerometer = _Part("Specific force at the IMU in the torso's axes in m/s^2, shape (..., 3).")
    gyroscope = _Part("Angular velocity of the torso in its own axes in rad/s, shape (..., 3).")
    inertial = _Part("Accelerometer and gyroscope, shape (..., 6).")
    joint_position = _Part("Angles of the hinge joints in rad, shape (..., J).")

    def __init__(self, rows: Floats, layout: RowLayout) -> None:
        self.rows, self.layout, self.columns = rows, layout, layout.columns

    @property
    def wrench_ankle(self) -> Floats:
        """Wrenches that the feet pass up at and in the ankle sensors' frames in N and N m, shape (..., F, 6).

        The ground's load on the foot, and gravity less inertia of all that hangs below the sensor
        (:attr:`RobotDrawing.below_ankle`): a foot in the air reads its own weight, downwards.
        """
        return -self.rows.take(self.columns.ankle, axis=-1)

    @property
    def force_world(self) -> Floats:
        """Forces of everything that touches a foot on it, in the world in N, shape (..., F, 3)."""
        return self._ground[..., :3]

    @cached_property
    def wrench_sole(self) -> Floats:
        """Wrenches of the ground on the robot at and in the sole frames in N and N m, shape (..., F, 6).

        Whatever else touches a foot, such as the other foot, counts as ground.
        """
        ground = self._ground
        force, torque, place = ground[..., :3], ground[..., 3:6], ground[..., 6:]
        world = np.stack([force, torque + cross(place - self.position_sole, force)], axis=-2)
        return (world @ self.R_world_sole).reshape(*ground.shape[:-1], 6)

    @property
    def _ground(self) -> Floats:
        """The ground's load on the feet: force, torque and the place at which they act, shape (..., F, 9)."""
        ground: Floats = self.rows.take(self.columns.ground, axis=-1)
        ground[..., :6] *= self.columns.up
        return ground

    @property
    def position_sole(self) -> Floats:
        """Origins of the sole frames in the world in m, shape (..., F, 3)."""
        return self.rows.take(self.columns.position_sole, axis=-1)

    @property
    def R_world_sole(self) -> Floats:  # noqa: N802
        """Rotations from the sole frames to the world, shape (..., F, 3, 3)."""
        return _rotation(self.rows.take(self.columns.axes_sole, axis=-1))

    @property
    def cell_data(self) -> Floats:
        """The data of which the cells' forces are made, see :class:`RowLayout`, shape (..., n).

        A cell is pulled where the ground pushes outside the cells.

        Raises:
            ValueError: If a foot has no area, with the reason.
        """
        self._refuse_flaws()
        sensed = self.columns.sensed
        if not sensed.soles:
            return self.rows[..., sensed.cells : sensed.cells + len(self.layout.shear_map)]
        wrench = self.wrench_sole
        return wrench.reshape(*wrench.shape[:-2], -1)

    @cached_property
    def force_cell(self) -> Floats:
        """Forces of the load cells in N, foot by foot FL, FR, RL, RR, shape (..., 4 F)."""
        factors, added = self.layout.cell_map
        force: Floats = self.cell_data @ factors + added
        return force

    @property
    def shear_cell(self) -> Floats:
        """Horizontal forces of the load cells in N, along x of all, and then along y, shape (..., 8 F)."""
        shear: Floats = self.cell_data @ self.layout.shear_map
        return shear

    @property
    def cop_sole(self) -> Floats:
        """Centres of pressure in the sole frames in m, shape (..., F, 2); NaN at no more than 5 N.

        Raises:
            ValueError: If a foot has no area, with the reason.
        """
        self._refuse_flaws()
        wrench = self.wrench_sole
        load = np.where(wrench[..., 2] > CONTACT_FORCE, wrench[..., 2], np.nan)
        return np.stack([-wrench[..., 4] / load, wrench[..., 3] / load], axis=-1)

    def _refuse_flaws(self) -> None:
        """Raise ValueError if a foot has no area."""
        if self.layout.flaw:
            raise ValueError(self.layout.flaw)

    @property
    def R_world_torso(self) -> Floats:  # noqa: N802
        """Rotation from the torso's frame to the world, shape (..., 3, 3)."""
        return _rotation(self.rows[..., self.columns.axes_torso])

    def vgrf(self) -> Floats:
        """Vertical ground reaction forces in the world at the last row in N, shape (..., F)."""
        return self.contacts()[..., 2] + 0.0

    def cop_world(self) -> Floats:
        """Centre of pressure of all feet together at the last row in the world in m, shape (..., 2).

        NaN where all feet together bear no more than 5 N.
        """
        ground = self.contacts()
        force, torque, place = ground[..., :3], ground[..., 3:6], ground[..., 6:]
        moment = (torque + cross(place * (1.0, 1.0, 0.0), force)).sum(axis=-2)
        load = force[..., 2].sum(axis=-1)
        load = np.where(load > CONTACT_FORCE, load, np.nan)
        return np.stack([-moment[..., 1] / load, moment[..., 0] / load], axis=-1)

    def contacts(self) -> Floats:
        """The ground's load on each foot at the last row, a single one or the last substep's, (..., F, 9).

        Force in N, torque in N m and the place in m at which they act, in the world.
        """
        ground = self._ground
        return ground if self.rows.ndim == 1 else ground[..., -1, :, :]


def wrench_at_sole(foot: Sequence[float], up: float) -> list[float]:
    """Return the ground's wrench on one foot at and in its sole frame in N and N m, 6 numbers.

    ``foot`` has force, torque and the place at which they act, origin and axes of the sole in the world, 21
    numbers; ``up`` is 1 if force and torque are the ground's on the robot, -1 if the robot's on the ground.
    """
    fx, fy, fz, tx, ty, tz, px, py, pz, x0, y0, z0, xx, xy, xz, yx, yy, yz, zx, zy, zz = foot
    fx, fy, fz = up * fx, up * fy, up * fz
    rx, ry, rz = px - x0, py - y0, pz - z0
    tx, ty, tz = up * tx + ry * fz - rz * fy, up * ty + rz * fx - rx * fz, up * tz + rx * fy - ry * fx
    return [
        xx * fx + xy * fy + xz * fz,
        yx * fx + yy * fy + yz * fz,
        zx * fx + zy * fy + zz * fz,
        xx * tx + xy * ty + xz * tz,
        yx * tx + yy * ty + yz * tz,
        zx * tx + zy * ty + zz * tz,
    ]


def ground_at_feet(feet: Sequence[Sequence[float]], up: float) -> tuple[list[list[float]], list[float]]:
    """Find the ground's load on the feet, of the numbers that :func:`wrench_at_sole` takes, (F, 21).

    Wrenches at and in the sole frames in N and N m, (F, 6); and of all feet together the load in N and the
    moments about the world's x and y at the height of the contacts in N m, (3).
    """
    wrench, load, moment_x, moment_y = [], 0.0, 0.0, 0.0
    for foot in feet:
        wrench.append(wrench_at_sole(foot, up))
        load = load + (fz := up * foot[2])
        moment_x = moment_x + up * foot[3] + foot[7] * fz
        moment_y = moment_y + up * foot[4] - foot[6] * fz
    return wrench, [load, moment_x, moment_y]


def centres(
    wrench: Sequence[Sequence[float]], common: Sequence[float], flat: Sequence[bool]
) -> tuple[list[list[float]], list[bool]]:
    """Find centres of pressure of :func:`ground_at_feet` feet, of which ``flat`` ones, (F), have an area.

    The centre of all feet in the world and those of each foot in its sole's frame in m, 0 where there is
    none, (1 + F, 2); and which of these there are, (1 + F).
    """
    found, valid = [], []
    for (fz, mx, my), area in zip((common, *(foot[2:5] for foot in wrench)), (True, *flat), strict=True):
        valid.append(enough := area and fz > CONTACT_FORCE)
        found.append([-my / fz, mx / fz] if enough else [0.0, 0.0])
    return found, valid


def _rotation(axes: Floats) -> Floats:
    """Turn three axes in a row, shape (..., 9), into a rotation with these columns, shape (..., 3, 3)."""
    return axes.reshape(*axes.shape[:-1], 3, 3).swapaxes(-1, -2)


def cross(a: Floats, b: Floats) -> Floats:
    """Multiply vectors, shape (..., 3); np.cross takes several times as long for a few robots' rows."""
    x, y, z = (a[..., i] * b[..., j] - a[..., j] * b[..., i] for i, j in ((1, 2), (2, 0), (0, 1)))
    return np.stack([x, y, z], axis=-1)
