"""The measures of a robot before sensors are put in: feet, their cells, torso and encoders."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import atan2
from typing import Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.arrays import Floats
from surefoot.envs.instrumentation.feet import find_feet
from surefoot.envs.instrumentation.geometry import (
    FACE_SLOPE,
    FootGeometry,
    below,
    check_layout,
    measure_foot,
)
from surefoot.envs.instrumentation.plate import SolePlate


class FootColumns:
    """Columns of one foot in a row: the measurements of its sensors, in the order in which they are added."""

    ankle: Final = slice(0, 6)
    force: Final = slice(6, 9)
    torque: Final = slice(9, 12)
    place: Final = slice(12, 15)
    contact: Final = slice(6, 15)
    position_sole: Final = slice(15, 18)
    axes_sole: Final = slice(18, 27)
    width: Final = 27


TORSO: Final = {
    "position_torso": slice(0, 3),
    "axes_torso": slice(3, 12),
    "com": slice(12, 15),
    "com_velocity": slice(15, 18),
    "angular_momentum": slice(18, 21),
    "accelerometer": slice(21, 24),
    "gyroscope": slice(24, 27),
    "inertial": slice(21, 27),
    "velocity_imu": slice(27, 30),
}
"""Columns after the feet: frame of the torso, motion of the whole robot, IMU and its velocity."""

TORSO_WIDTH: Final = 30

LEAST_WEIGHT: Final = (
    0.1  # share of its weight that a robot with gravity compensation puts on its feet at least
)


class SensedColumns(NamedTuple):
    """Where in a row the sensors' loads stand: the first column of each part."""

    joints: int  # of the encoders' angles
    inertial: int  # of accelerometer and gyroscope
    ankles: int
    """Of the first foot's wrench at the ankle, as the simulator reads it: of the robot on the foot."""
    cells: int  # the data of which the cells' forces are made by ``cell_map``
    stride: int  # columns from one foot's to the next one's
    soles: int = 0
    """How many feet have force, torque, place and the sole's frame there, of which wrenches are made first; 0
    where these stand there."""


class RowColumns(NamedTuple):
    """Where in a row of readings the parts stand, of a robot with F feet."""

    ankle: NDArray[np.intp]  # force and torque at each ankle, of the robot on the foot, shape (F, 6)
    ground: NDArray[np.intp]
    """Force and torque in the contacts and the place at which they act, in the world, shape (F, 9)."""
    up: float  # 1 if these are the ground's on the robot, -1 if the robot's on the ground
    position_sole: NDArray[np.intp]  # origins of the sole frames in the world, shape (F, 3)
    axes_sole: NDArray[np.intp]  # their axes one after another, shape (F, 9)
    position_torso: slice  # origin of the torso's frame; with its axes and what follows of the whole robot
    axes_torso: slice
    com: slice
    com_velocity: slice
    angular_momentum: slice
    accelerometer: slice
    gyroscope: slice
    inertial: slice
    joint_position: slice
    sensed: SensedColumns  # what sensors read
    time: int  # the simulated time
    velocity_imu: slice = slice(0, 0)  # velocity of the IMU in the world; empty where it is not measured


CellMap = tuple[Floats, Floats]
"""Factors from data of F feet to the forces of 4 F cells, shape (n, 4 F), and N to add, shape (4 F,)."""


@dataclass(frozen=True, eq=False)
class RowLayout:
    """The meaning of a row, and how cells share the loads in it.

    The cells' data are wrenches at the soles, shape (6 F), where ``columns.sensed.soles`` says that these are
    made first; otherwise columns from ``columns.sensed.cells`` on.
    """

    size: int  # columns of a row
    columns: RowColumns
    flat: tuple[bool, ...]  # which feet have an area, (F)
    flaw: str  # why not all feet have cells, or empty
    cell_map: CellMap  # from the cells' data to their forces
    shear_map: Floats
    """Factors from these data to the cells' horizontal forces, along x of all, then y, shape (n, 8 F)."""

    def force_cell(self, row: Floats, wrench: Floats) -> Floats:
        """Return forces of the cells in N, (..., 4 F), of a row and of wrenches at the soles, (..., 6 F)."""
        (factors, added), sensed = self.cell_map, self.columns.sensed
        data = wrench if sensed.soles else row[..., sensed.cells : sensed.cells + len(factors)]
        force: Floats = (data[..., None, :] @ factors)[..., 0, :]
        return force if sensed.soles else force + added

    def level(self, row: Sequence[float]) -> tuple[float, float, float]:
        """Return where the level frame of the soles is (x, y) in m, and its heading in rad."""
        x = y = along = across = 0.0
        for at, axes in zip(*self._starts("position_sole", "axes_sole"), strict=True):
            x, y = x + row[at], y + row[at + 1]
            along, across = along + row[axes], across + row[axes + 1]
        share = 1.0 / len(self.flat)
        return share * x, share * y, atan2(across, along)

    def feet(self, row: Sequence[float]) -> list[list[float]]:
        """Take the 21 numbers of each foot after its ankle out of a row, (F, 21)."""
        starts = zip(*self._starts("ground", "position_sole", "axes_sole"), strict=True)
        return [[*row[i : i + 9], *row[j : j + 3], *row[k : k + 9]] for i, j, k in starts]

    def _starts(self, *names: str) -> list[list[int]]:
        """Return the first number of parts, of each foot."""
        return [getattr(self.columns, name)[:, 0].tolist() for name in names]


def share_loads(plates: Sequence[SolePlate | None]) -> tuple[Floats, Floats]:
    """Return all cells' forces by wrenches at the soles: upwards, (6 F, 4 F); along x, then y, (6 F, 8 F).

    Cells of a foot without a plate feel nothing.
    """
    number = len(plates)
    up, across = np.zeros((6 * number, 4 * number)), np.zeros((6 * number, 2, 4 * number))
    for i, plate in enumerate(plates):
        if plate is not None:
            cells = slice(4 * i, 4 * i + 4)
            up[6 * i + 2 : 6 * i + 5, cells] = plate.share.T
            across[6 * i + np.array([0, 1, 5]), :, cells] = plate.across.T.reshape(3, 2, 4)
    return up, across.reshape(6 * number, -1)


@dataclass(frozen=True, eq=False)
class MeasuredRobot:
    """A robot with F feet and J encoders, measured."""

    feet: tuple[FootGeometry, ...]  # geometry of the feet
    cells: tuple[Floats | None, ...]
    """Places of each foot's cells in its sole's frame in m, shape (4, 2); None for one without area."""
    plates: tuple[SolePlate | None, ...]  # how these cells share a load
    torso: str  # name of the body that carries the robot
    joint_names: tuple[str, ...]
    """The hinge joints that hang on it in model order; those that carry it have no encoders."""

    @cached_property
    def flaw(self) -> str:
        """Why not all feet have cells, or empty."""
        return next((foot.flaw for foot in self.feet if foot.flaw), "")

    @cached_property
    def rows(self) -> RowLayout:
        """The layout of its rows: 27 numbers per foot, 30 of the torso, one per joint, and the time."""
        return self.rows_after(0)

    def rows_after(self, start: int) -> RowLayout:
        """Return the layout of rows in which other numbers stand before the robot's, so many."""
        number = len(self.feet)
        feet = start + FootColumns.width * np.arange(number)[:, None]
        torso = int(start + FootColumns.width * number)
        joints = torso + TORSO_WIDTH
        ankle, ground, sole, axes = (
            feet + np.arange(part.start, part.stop)
            for part in (
                FootColumns.ankle, FootColumns.contact, FootColumns.position_sole, FootColumns.axes_sole
            )
        )  # fmt: skip
        columns = RowColumns(
            ankle, ground, -1.0, sole, axes,
            **{name: slice(torso + part.start, torso + part.stop) for name, part in TORSO.items()},
            joint_position=slice(joints, joints + len(self.joint_names)),
            sensed=SensedColumns(
                joints, torso + TORSO["inertial"].start, int(ankle[0, 0]), int(ground[0, 0]),
                FootColumns.width, number,
            ),
            time=joints + len(self.joint_names),
        )  # fmt: skip
        up, across = share_loads(self.plates)
        flat = tuple(not foot.flaw for foot in self.feet)
        return RowLayout(columns.time + 1, columns, flat, self.flaw, (up, np.zeros(4 * number)), across)


def measure_robot(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    feet: Sequence[str] | None,
    cells: Mapping[str, ArrayLike] | None,
    margin: float,
) -> MeasuredRobot:
    """Measure a robot in the pose of ``data`` in which it stands, of which the kinematics were evaluated.

    ``feet`` are names of bodies, or guessed; ``cells`` are places by the foot's body, shape (4, 2), others
    lie in the corners, drawn in from the sole's edges by ``margin`` m. TypeError if ``feet`` is a single
    name; ValueError if feet cannot be found, cannot touch or have no name, a layout is wrong, or gravity does
    not point along -z.
    """
    bodies = find_feet(model, data, feet)
    geometry = tuple(measure_foot(model, data, body) for body in bodies)
    root = int(model.body_rootid[bodies[0]])
    torso = model.body(root).name
    unnamed = [body for body, foot in zip(bodies, geometry, strict=True) if not foot.body]
    if unnamed or not torso:
        raise ValueError(
            f"The torso and the feet need names: give the bodies {unnamed or ['torso']} one each."
        )
    if not -model.opt.gravity[2] > FACE_SLOPE * np.linalg.norm(model.opt.gravity):
        raise ValueError(
            "Gravity must point down the world's z axis, to within 30 degrees, got "
            f"{model.opt.gravity.tolist()} m/s^2: soles are measured as they look down that axis."
        )
    weighed = below(model, root) * model.body_mass
    if not float(weighed @ (1.0 - model.body_gravcomp)) > LEAST_WEIGHT * float(weighed.sum()):
        raise ValueError(
            f"'gravcomp' of the robot's bodies carries all of its weight, {torso!r} and what hangs on it: "
            "feet would feel nothing. Set it to 0 in the description."
        )
    places = _places(geometry, cells or {}, margin)
    return MeasuredRobot(
        feet=geometry,
        cells=places,
        plates=tuple(None if place is None else SolePlate(place, np.ones(4)) for place in places),
        torso=torso,
        joint_names=tuple(joint_name(model, joint) for joint in encoders(model, root)),
    )


def encoders(model: mujoco.MjModel, torso: int) -> tuple[int, ...]:
    """Return the numbers of the hinge joints that hang on a torso, without those that carry it."""
    body, hinge = model.jnt_bodyid, model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    return tuple(np.flatnonzero(hinge & below(model, torso)[body] & (body != torso)).tolist())


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return a joint's name, or one with its number if it has none."""
    return model.joint(joint).name or f"joint{joint}"


def _places(
    feet: tuple[FootGeometry, ...], cells: Mapping[str, ArrayLike], margin: float
) -> tuple[Floats | None, ...]:
    """Return where the cells lie."""
    names = [foot.body for foot in feet]
    unknown = sorted(set(cells) - set(names))
    if unknown:
        raise ValueError(f"'cells' names {unknown}, which are no feet here; the feet are {names}.")
    places: list[Floats | None] = []
    for foot in feet:
        if foot.body in cells and foot.flaw:
            raise ValueError(foot.flaw)
        if foot.body in cells:
            places.append(check_layout(foot, cells[foot.body]))
        else:
            places.append(None if foot.flaw else foot.layout(margin))
    return tuple(places)
