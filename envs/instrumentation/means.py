"""Means over a control step of the feet's loads, as ideal cells give them: the truth in ``info``.

:func:`mean_truth` is the specification, of one robot. :class:`MeanTruth` calls the library for one or many,
with the same bits.
"""

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.envs.command import rotate_level
from surefoot.envs.instrumentation.robot import RowLayout
from surefoot.envs.instrumentation.truth import centres
from surefoot.native import ENVS, Call, Library, PointerRecord


def _add_up(substeps: Sequence[Sequence[float]]) -> tuple[list[float], float, float]:
    """Add up one foot's loads in all substeps, of 21 numbers each, with the sign of the contact sensor.

    It is :func:`~surefoot.envs.instrumentation.truth.wrench_at_sole`, which explains them, and
    :func:`~surefoot.envs.instrumentation.truth.ground_at_feet` in one loop: the wrench at and in the sole's
    frame, and the moments about the world's x and y at the height of the contacts.
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


def mean_truth(rows: Floats, layout: RowLayout) -> dict[str, NDArray[Any]]:
    """Compute the truth of a control step, (S, columns), for ``info``: means of its substeps, by ideal cells.

    Arrays of their own: ``force_cell`` (4 F) N where all feet have an area; ``vgrf`` (F) N; ``cop_world`` (2)
    m, ``cop_foot`` (F, 2) m in the soles' frames and ``cop`` (2) m in the level frame midway between them;
    ``cop_valid`` (1 + F), which of these there are, the common one first (the others are 0); ``com`` (3) m;
    ``wrench_sole`` and ``wrench_ankle`` (F, 6) N and N m.
    """
    share, columns = 1.0 / len(rows), layout.columns
    up = columns.up * share
    row = np.add.reduce(rows) * share
    own, wrench = row.tolist(), []
    moment_x = moment_y = load = 0.0
    for substeps in zip(*map(layout.feet, rows.tolist()), strict=True):
        felt, x, y = _add_up(substeps)
        wrench.append([up * part for part in felt])
        moment_x, moment_y = moment_x + up * x, moment_y + up * y
    vgrf = [0.0 + columns.up * own[at] for at in columns.ground[:, 2]]
    for part in vgrf:
        load = load + part
    ((x, y), *cop_foot), valid = centres(wrench, (load, moment_x, moment_y), layout.flat)
    middle_x, middle_y, heading = layout.level(own)
    level = rotate_level(x - middle_x, y - middle_y, heading) if valid[0] else [0.0, 0.0]
    truth = {
        "vgrf": np.array(vgrf),
        "cop_world": np.array([x, y]),
        "cop": np.array(level),
        "cop_foot": np.array(cop_foot),
        "cop_valid": np.array(valid),
        "com": row[columns.com],
        "wrench_sole": np.array(wrench),
        "wrench_ankle": -row[columns.ankle],
    }
    if not layout.flaw:
        truth["force_cell"] = layout.force_cell(row, np.array([*chain.from_iterable(wrench)]))
    return truth


class MeanTruth:
    """Computes :func:`mean_truth` of one robot or of many: by the library where there is one."""

    def __init__(self, layout: RowLayout) -> None:
        self._layout = layout
        self._calls: dict[tuple[int, ...], Call | None] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        # Addresses are of no use elsewhere.
        return MeanTruth, (self._layout,)

    def __call__(self, rows: Floats, threads: int = 1) -> dict[str, NDArray[Any]]:
        """Compute the truth of a control step, (S, columns), or of many robots by threads, (N, S, ...)."""
        if rows.shape not in self._calls:
            library = ENVS.installed()
            self._calls[rows.shape] = None if library is None else self._call(library, *rows.shape)
        found = self._calls[rows.shape]
        if found is None:
            return mean_truth(rows, self._layout) if rows.ndim == 2 else self._of_each(rows)
        results = found(np.ascontiguousarray(rows), threads=threads)
        truth = {name: results[name] for name in _TOLD}
        if not self._layout.flaw:
            wrench = results["wrench_sole"].reshape(*rows.shape[:-2], -1)
            truth["force_cell"] = self._layout.force_cell(results["row"], wrench)
        return truth

    def _of_each(self, rows: Floats) -> dict[str, NDArray[Any]]:
        each = [mean_truth(own, self._layout) for own in rows]
        return {name: np.array([truth[name] for truth in each]) for name in each[0]}

    def _call(self, library: Library, *shape: int) -> Call:
        """Return the library's function for rows of a shape."""
        *robots, substeps, columns = shape
        feet = len(self._layout.flat)
        at = places_record(library, self._layout, substeps, columns)
        real = np.float64
        fields = {
            "row": (real, (columns,)), "vgrf": (real, (feet,)), "cop_world": (real, (2,)),
            "cop": (real, (2,)), "cop_foot": (real, (feet, 2)), "com": (real, (3,)),
            "wrench_sole": (real, (feet, 6)), "wrench_ankle": (real, (feet, 6)),
            "cop_valid": (np.bool_, (1 + feet,)),
        }  # fmt: skip
        many = robots[0] if robots else None
        return Call(library, "surefoot_mean_truth", "truth_room", at, fields, many)


_TOLD = ("vgrf", "cop_world", "cop", "cop_foot", "cop_valid", "com", "wrench_sole", "wrench_ankle")
"""The library's results that are told; of the mean row only what is made of it."""


def places_record(library: Library, layout: RowLayout, substeps: int, columns: int) -> PointerRecord:
    """Make the library's record of places in rows."""
    columns_of = layout.columns
    whole = {"ankle": columns_of.ankle, "contact": columns_of.ground}
    whole |= {"position_sole": columns_of.position_sole, "axes_sole": columns_of.axes_sole}
    arrays = {name: part[:, 0].astype(np.int32) for name, part in whole.items()}
    arrays["flat"] = np.array(layout.flat, dtype=np.int32)
    sizes = {"feet": len(layout.flat), "rows": substeps, "columns": columns}
    at = {"up": columns_of.up, "com": columns_of.com.start}
    return PointerRecord(library, "foot_places", {**arrays, **sizes, **at})
