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
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.envs.instrumentation.robot import FootColumns, MeasuredRobot, TorsoColumns

Array = NDArray[np.float64]

CONTACT_FORCE = 5.0
"""Vertical force in N above which a centre of pressure is defined."""


class SensedColumns(NamedTuple):
    """Where in a row the sensors' loads stand: the first column of each part.

    Attributes:
        joints: Of the encoders' angles.
        inertial: Of accelerometer and gyroscope.
        ankles: Of the first foot's wrench at the ankle, as the simulator reads it: of the robot on the foot.
        cells: The data of which the cells' forces are made by ``cell_map()``.
        stride: Columns from one foot's to the next one's.
        soles: How many feet have force, torque, place and the sole's frame there (:func:`wrench_at_sole`), of
            which wrenches are made first; 0 where these stand there.
    """

    joints: int
    inertial: int
    ankles: int
    cells: int
    stride: int
    soles: int = 0


class FeetTruth:
    """The loads of F feet and the torso in one substep, or in many; its arrays are not to be changed.

    Args:
        rows: Readings, shape (..., 27 F + 28 + J); they are kept and not copied.
        layout: The robot, in whose order the columns are.
    """

    def __init__(self, rows: Array, layout: MeasuredRobot) -> None:
        self.rows = rows
        self.layout = layout
        self._end = FootColumns.width * len(layout.feet)

    @property
    def time(self) -> Array:
        """Simulated time in s, shape (...)."""
        return self.rows[..., -1]

    @property
    def wrench_ankle(self) -> Array:
        """Wrenches that the feet pass up at the ankles in the feet's axes in N and N m, shape (..., F, 6)."""
        return -self._feet[..., FootColumns.ankle]

    @property
    def force_world(self) -> Array:
        """Forces of everything that touches a foot on it, in the world in N, shape (..., F, 3)."""
        return -self._feet[..., FootColumns.force]

    @cached_property
    def wrench_sole(self) -> Array:
        """Wrenches of the ground on the robot at and in the sole frames in N and N m, shape (..., F, 6).

        Whatever else touches a foot, such as the other foot, counts as ground.
        """
        if self.rows.size == self.layout.size:
            # A single row, as every step of one environment makes: plain floats are faster than arrays.
            row = self.rows.ravel().tolist()
            starts = range(_START, self._end, FootColumns.width)
            wrench = [wrench_at_sole(row[at : at + 21], -1.0) for at in starts]
            return np.array(wrench).reshape(*self.rows.shape[:-1], -1, 6)
        feet = self._feet
        force = -feet[..., FootColumns.force]
        arm = feet[..., FootColumns.place] - feet[..., FootColumns.position_sole]
        world = np.stack([force, cross(arm, force) - feet[..., FootColumns.torque]], axis=-2)
        return (world @ self.R_world_sole).reshape(*feet.shape[:-1], 6)

    @property
    def position_sole(self) -> Array:
        """Origins of the sole frames in the world in m, shape (..., F, 3)."""
        return self._feet[..., FootColumns.position_sole]

    @property
    def R_world_sole(self) -> Array:  # noqa: N802
        """Rotations from the sole frames to the world, shape (..., F, 3, 3)."""
        return _rotation(self._feet[..., FootColumns.axes_sole])

    @property
    def cop_sole(self) -> Array:
        """Centres of pressure in the sole frames in m, shape (..., F, 2); NaN at no more than 5 N.

        Raises:
            ValueError: If a foot has no area, with the reason.
        """
        self._refuse_flaws()
        return cop_in_sole(self.wrench_sole)

    def sensor_columns(self) -> SensedColumns:
        """Return where in a row the sensors' loads stand."""
        return SensedColumns(
            joints=self._end + TorsoColumns.width,
            inertial=self._end + TorsoColumns.inertial.start,
            ankles=FootColumns.ankle.start,
            cells=_START,
            stride=FootColumns.width,
            soles=len(self.layout.feet),
        )

    def cell_map(self) -> tuple[Array, Array]:
        """Return the map from :attr:`wrench_sole` to cells' forces: factors (6 F, 4 F) and N to add (4 F)."""
        factors = self.layout.force_of_wrench
        return factors, np.zeros(factors.shape[1])

    @cached_property
    def force_cell(self) -> Array:
        """Forces of the load cells in N, foot by foot FL, FR, RL, RR, shape (..., 4 F).

        A cell is pulled where the ground pushes outside the cells.

        Raises:
            ValueError: If a foot has no area, with the reason.
        """
        self._refuse_flaws()
        wrench = self.wrench_sole
        return wrench.reshape(*wrench.shape[:-2], -1) @ self.layout.force_of_wrench

    @property
    def shear_cell(self) -> Array:
        """Horizontal forces of the load cells in N, along x of all, and then along y, shape (..., 8 F)."""
        wrench = self.wrench_sole
        return wrench.reshape(*wrench.shape[:-2], -1) @ self.shear_map()

    def shear_map(self) -> Array:
        """Return the map from :attr:`wrench_sole` to the cells' horizontal forces, (6 F, 8 F): x, then y."""
        return self.layout.shear_of_wrench

    @property
    def position_torso(self) -> Array:
        """Origin of the torso's frame in the world in m, shape (..., 3)."""
        return self._body[..., TorsoColumns.position]

    @property
    def R_world_torso(self) -> Array:  # noqa: N802
        """Rotation from the torso's frame to the world, shape (..., 3, 3)."""
        return _rotation(self._body[..., TorsoColumns.axes])

    @property
    def com(self) -> Array:
        """Centre of mass of the robot in the world in m, shape (..., 3)."""
        return self._body[..., TorsoColumns.com]

    @property
    def com_velocity(self) -> Array:
        """Velocity of the centre of mass in the world in m/s, shape (..., 3)."""
        return self._body[..., TorsoColumns.com_velocity]

    @property
    def angular_momentum(self) -> Array:
        """Angular momentum about the centre of mass, in the world's axes, in kg m^2/s, shape (..., 3)."""
        return self._body[..., TorsoColumns.angular_momentum]

    @property
    def accelerometer(self) -> Array:
        """Specific force at the IMU in the torso's axes in m/s^2, shape (..., 3)."""
        return self._body[..., TorsoColumns.accelerometer]

    @property
    def gyroscope(self) -> Array:
        """Angular velocity of the torso in its own axes in rad/s, shape (..., 3)."""
        return self._body[..., TorsoColumns.gyroscope]

    @property
    def inertial(self) -> Array:
        """Accelerometer and gyroscope, shape (..., 6)."""
        return self._body[..., TorsoColumns.inertial]

    @property
    def joint_position(self) -> Array:
        """Angles of the hinge joints in rad, shape (..., J)."""
        return self.rows[..., self._end + TorsoColumns.width : -1]

    def vgrf(self) -> Array:
        """Vertical ground reaction forces in the world at the last row in N, shape (..., F)."""
        return 0.0 - self._last[..., FootColumns.force][..., 2]

    def cop_world(self) -> Array:
        """Centre of pressure of all feet together at the last row in the world in m, shape (..., 2).

        NaN where all feet together bear no more than 5 N.
        """
        cop: Array = centre_of_pressure(self.contacts())
        return cop

    def contacts(self) -> Array:
        """The ground's load on each foot at the last row, shape (..., F, 9).

        Force in N, torque in N m and the place in m at which they act, in the world.
        """
        ground: Array = self._last[..., FootColumns.contact] * _UP
        return ground

    @property
    def _feet(self) -> Array:
        return self.rows[..., : self._end].reshape(*self.rows.shape[:-1], -1, FootColumns.width)

    @property
    def _body(self) -> Array:
        return self.rows[..., self._end : self._end + TorsoColumns.width]

    @property
    def _last(self) -> Array:
        """The feet at the last row; a single row is the last one."""
        return self._feet if self.rows.ndim == 1 else self._feet[..., -1, :, :]

    def _refuse_flaws(self) -> None:
        """Raise ValueError if a foot has no area."""
        if self.layout.flaw:
            raise ValueError(self.layout.flaw)


_START: Final = FootColumns.ankle.stop
"""First of a foot's 21 columns after its ankle."""

_UP = np.array([-1.0] * 6 + [1.0] * 3)
"""Turns force and torque of a contact sensor on the ground into those on the robot."""


def wrench_at_sole(foot: Sequence[float], up: float) -> list[float]:
    """Return the ground's wrench on one foot at and in its sole frame in N and N m, 6 numbers.

    Args:
        foot: Force, torque and the place at which they act, origin and axes of the sole in the world: 21
            numbers.
        up: 1 if force and torque are the ground's on the robot, -1 if the robot's on the ground.
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

    Returns:
        Wrenches at and in the sole frames in N and N m, (F, 6); and of all feet together the load in N and
        the moments about the world's x and y at the height of the contacts in N m, (3).
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
    """Find the centres of pressure of :func:`ground_at_feet` feet.

    Args:
        wrench: Wrenches at the soles, (F, 6).
        common: Load and moments of all feet together, (3).
        flat: Which feet have an area, (F).

    Returns:
        The centre of all feet in the world and those of each foot in its sole's frame in m, 0 where there is
        none, (1 + F, 2); and which of these there are, (1 + F).
    """
    found, valid = [], []
    for (fz, mx, my), area in zip((common, *(foot[2:5] for foot in wrench)), (True, *flat), strict=True):
        valid.append(enough := area and fz > CONTACT_FORCE)
        found.append([-my / fz, mx / fz] if enough else [0.0, 0.0])
    return found, valid


def _rotation(axes: Array) -> Array:
    """Turn three axes in a row, shape (..., 9), into a rotation with these columns, shape (..., 3, 3)."""
    return axes.reshape(*axes.shape[:-1], 3, 3).swapaxes(-1, -2)


def centre_of_pressure(ground: NDArray[np.float64]) -> NDArray[np.float64]:
    """Find where on the ground the vertical forces of contacts act together.

    Args:
        ground: Force in N, torque in N m and the place in m at which they act, in the world,
            shape (..., n, 9).

    Returns:
        The centre of pressure in m, shape (..., 2); NaN where n contacts bear no more than 5 N together.
    """
    force, torque, position = ground[..., :3], ground[..., 3:6], ground[..., 6:]
    moment = torque + np.cross(position * (1.0, 1.0, 0.0), force)
    load = force[..., 2].sum(axis=-1)
    load = np.where(load > CONTACT_FORCE, load, np.nan)
    return np.stack([-moment[..., 1].sum(axis=-1) / load, moment[..., 0].sum(axis=-1) / load], axis=-1)


def cross(a: Array, b: Array) -> Array:
    """Multiply vectors, shape (..., 3); np.cross takes several times as long for a few robots' rows."""
    x, y, z = (a[..., i] * b[..., j] - a[..., j] * b[..., i] for i, j in ((1, 2), (2, 0), (0, 1)))
    return np.stack([x, y, z], axis=-1)


def cop_in_sole(wrench_sole: NDArray[np.float64]) -> NDArray[np.float64]:
    """Find where each foot's load acts on its sole.

    Args:
        wrench_sole: Wrenches at and in the sole frames in N and N m, shape (..., 6).

    Returns:
        The centres of pressure in the sole frames in m, shape (..., 2); NaN at no more than 5 N.
    """
    load = np.where(wrench_sole[..., 2] > CONTACT_FORCE, wrench_sole[..., 2], np.nan)
    return np.stack([-wrench_sole[..., 4] / load, wrench_sole[..., 3] / load], axis=-1)
