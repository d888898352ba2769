"""Means over a control step of the feet's loads, as ideal cells give them: the truth in ``info``."""

from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.envs.command import rotate_level
from surefoot.envs.instrumentation.robot import FootColumns, MeasuredRobot, TorsoColumns
from surefoot.envs.instrumentation.truth import centres
from surefoot.envs.numbers import ONE, Number, Numbers

Array = NDArray[np.float64]


class FootPlaces(NamedTuple):
    """Where in a row of sensor data things are that feet feel: of each foot, the first of its numbers.

    Attributes:
        ankle: Force and torque at the ankle, of the robot on the foot (6 numbers).
        contact: Force, torque and the place at which they act, in the world (9).
        up: 1 if these are the ground's on the robot, -1 if the robot's on the ground.
        position_sole: Origin of the sole frame in the world (3).
        axes_sole: Its axes one after another (9).
        com: Centre of mass of the robot (3); one for all feet.
        force_cell: Makes forces of the cells in N, shape (..., 4 F), of a row and of the wrenches at the
            soles, shape (..., 6 F); None where a foot has no area.
        flat: Which feet have an area, (F).
    """

    ankle: tuple[int, ...]
    contact: tuple[int, ...]
    up: float
    position_sole: tuple[int, ...]
    axes_sole: tuple[int, ...]
    com: int
    force_cell: Callable[[Array, Array], Array] | None
    flat: tuple[bool, ...]

    def level(self, row: Any, m: Numbers = ONE) -> tuple[Number, Number, Number]:
        """Return where the level frame of the soles is (x, y) in m, and its heading in rad."""
        x = y = along = across = 0.0
        for at, axes in zip(self.position_sole, self.axes_sole, strict=True):
            x, y = x + row[at], y + row[at + 1]
            along, across = along + row[axes], across + row[axes + 1]
        share = 1.0 / len(self.position_sole)
        return share * x, share * y, m.atan2(across, along)


@cache
def _columns(places: FootPlaces) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the columns of each foot that :func:`_add_up` takes, shape (F, 21), and of its ankle, (F, 6)."""
    starts = zip(places.contact, places.position_sole, places.axes_sole, strict=True)
    feet = [[*range(i, i + 9), *range(j, j + 3), *range(k, k + 9)] for i, j, k in starts]
    return np.array(feet, dtype=np.intp), np.array(places.ankle, dtype=np.intp)[:, None] + np.arange(6)


def _add_up(substeps: Sequence[Any]) -> tuple[list[Number], Number, Number]:
    """Add up one foot's loads in all substeps, of 21 numbers each.

    It is :func:`~surefoot.envs.instrumentation.truth.wrench_at_sole`, which explains them, and
    :func:`~surefoot.envs.instrumentation.truth.ground_at_feet` in one loop, which is several times faster.

    Returns:
        The wrench at and in the sole's frame, and the moments about the world's x and y at the height of the
        contacts, each as the contact sensor has its sign.
    """
    a = b = c = d = e = f = x = y = 0.0
    for fx, fy, fz, tx, ty, tz, px, py, pz, x0, y0, z0, xx, xy, xz, yx, yy, yz, zx, zy, zz in substeps:
        x, y = x + tx + py * fz, y + ty - px * fz
        rx, ry, rz = px - x0, py - y0, pz - z0
        mx, my, mz = tx + ry * fz - rz * fy, ty + rz * fx - rx * fz, tz + rx * fy - ry * fx
        a, b, c = (
            a + xx * fx + xy * fy + xz * fz,
            b + yx * fx + yy * fy + yz * fz,
            c + zx * fx + zy * fy + zz * fz,
        )
        d, e, f = (
            d + xx * mx + xy * my + xz * mz,
            e + yx * mx + yy * my + yz * mz,
            f + zx * mx + zy * my + zz * mz,
        )
    return [a, b, c, d, e, f], x, y


def mean_truth(rows: Array, places: FootPlaces, m: Numbers = ONE) -> dict[str, NDArray[Any]]:
    """Compute the truth of a control step for ``info``: means over its substeps, as ideal cells give them.

    Args:
        rows: Sensor data of S substeps, of one robot or with many in front, shape (..., S, columns).
        places: The meaning of the columns.
        m: Whether there is one robot, or many.

    Returns:
        Arrays of their own: ``force_cell`` (..., 4 F) N where all feet have an area; ``vgrf`` (..., F) N;
        ``cop_world`` (..., 2) m, ``cop_foot`` (..., F, 2) m in the soles' frames and ``cop``
        (..., 2) m in the level frame midway between them; ``cop_valid`` (..., 1 + F), which of these there
        are, the common one first (the others are 0); ``com`` (..., 3) m; ``wrench_sole`` and
        ``wrench_ankle`` (..., F, 6) N and N m.
    """
    feet, share = len(places.contact), 1.0 / rows.shape[-2]
    up = places.up * share
    of_feet, of_ankles = _columns(places)
    row = np.add.reduce(rows, axis=-2) * share
    own, wrench = m.parts(row), []
    moment_x = moment_y = load = 0.0
    # Foot by foot: of one robot (F, S, 21), of many with them last.
    for substeps in m.parts(rows.take(of_feet, axis=-1).swapaxes(-2, -3)):
        felt, x, y = _add_up(substeps)
        wrench.append([up * part for part in felt])
        moment_x, moment_y = moment_x + up * x, moment_y + up * y
    vgrf = [0.0 + places.up * own[at + 2] for at in places.contact]
    for part in vgrf:
        load = load + part
    (x, y), *cop_foot, valid = centres(wrench, (load, moment_x, moment_y), places.flat, m)
    middle_x, middle_y, heading = places.level(own, m)
    level = [m.where(valid[0], p, 0.0) for p in rotate_level(x - middle_x, y - middle_y, heading, m)]
    # One array is faster than many.
    numbers = m.array([*vgrf, x, y, *level, *chain.from_iterable(cop_foot), *chain.from_iterable(wrench)])
    split = 3 * feet + 4
    wrench_sole = numbers[..., split:].reshape(*row.shape[:-1], feet, 6)
    truth = {
        "vgrf": numbers[..., :feet],
        "cop_world": numbers[..., feet : feet + 2],
        "cop": numbers[..., feet + 2 : feet + 4],
        "cop_foot": numbers[..., feet + 4 : split].reshape(*row.shape[:-1], feet, 2),
        "cop_valid": m.array(valid),
        "com": row[..., places.com : places.com + 3],
        "wrench_sole": wrench_sole,
        "wrench_ankle": -row.take(of_ankles, axis=-1),
    }
    if places.force_cell is not None:
        truth["force_cell"] = places.force_cell(row, wrench_sole.reshape(*row.shape[:-1], -1))
    return truth


def _force_of_wrench(shares: Array, row: Array, wrench: Array) -> Array:
    """Share wrenches at the soles among cells: the ``force_cell`` of robots with cells under a plate."""
    force: Array = (wrench[..., None, :] @ shares)[..., 0, :]
    return force


def foot_places(layout: MeasuredRobot, start: int = 0) -> FootPlaces:
    """Return where the feet's columns are in rows of an instrumented robot, which begin at ``start``."""

    def each(part: slice) -> tuple[int, ...]:
        return tuple(start + FootColumns.width * foot + part.start for foot in range(len(layout.feet)))

    return FootPlaces(
        ankle=each(FootColumns.ankle),
        contact=each(FootColumns.contact),
        up=-1.0,
        position_sole=each(FootColumns.position_sole),
        axes_sole=each(FootColumns.axes_sole),
        com=start + FootColumns.width * len(layout.feet) + TorsoColumns.com.start,
        force_cell=None if layout.flaw else partial(_force_of_wrench, layout.force_of_wrench),
        flat=tuple(not foot.flaw for foot in layout.feet),
    )
