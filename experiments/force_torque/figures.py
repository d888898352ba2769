"""Figures of one in-situ calibration: ellipsoids in space, and what the fit leaves over time."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surefoot.experiments.force_torque.ellipsoids import draw_shell, few_ticks
from surefoot.experiments.force_torque.score import force_ellipsoid
from surefoot.experiments.force_torque.tables import Calibrated
from surefoot.experiments.study.figures import Look, figure_at, grid_of, look_of

__all__ = ["force_ellipsoids", "raw_ellipsoids", "residuals_over_time"]

_SHOWN = 400
"""Points a set of a figure in space."""

_COLUMNS = 4


def raw_ellipsoids(path: Path, found: Calibrated) -> Path:
    """Draw each set's counts along their three main directions, on one ellipsoid (in-situ paper, Fig. 5).

    Args:
        path: Where to save the figure.
        found: The calibrated log.
    """
    raw_look = look_of("none")
    with figure_at(path, 10.4, 2.9 * _rows(found)) as figure:
        for i, (data, axes) in enumerate(zip(found.sets, _spaces(figure, found), strict=True)):
            whole = np.isfinite(data.raw).all(axis=1)
            centred = data.raw[whole] - data.raw[whole].mean(axis=0)
            points = centred @ np.linalg.svd(centred, full_matrices=False)[2][:3].T
            _cloud(axes, points, raw_look)
            draw_shell(axes, force_ellipsoid(points, data.gravity[whole]), "#7f7f7f")
            share = 100.0 * found.affine_residual[i]
            _finish(axes, f"set {found.label(i)}: {share:.2f} % off", "counts")
    return path


def force_ellipsoids(path: Path, found: Calibrated) -> Path:
    """Draw each set's forces, calibrated and by the factory matrix, and their ellipsoids (paper, Fig. 6).

    Args:
        path: Where to save the figure.
        found: The calibrated log.
    """
    looks = (look_of("moment")._replace(label="calibrated"), factory_look())
    with figure_at(path, 10.4, 0.4 + 2.9 * _rows(found)) as figure:
        for i, (data, axes) in enumerate(zip(found.sets, _spaces(figure, found), strict=True)):
            for matrix, look in zip(found.matrices(), looks, strict=False):
                force = found.wrench(i, matrix)[:, :3]
                _cloud(axes, force, look)
                draw_shell(axes, force_ellipsoid(force, data.gravity), look.colour)
            _finish(axes, f"set {found.label(i)}: {data.added_mass:.3f} kg", "N")
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2, markerscale=4.0)
    return path


def residuals_over_time(path: Path, found: Calibrated) -> Path:
    """Draw what the fit leaves of every channel, set after set.

    Args:
        path: Where to save the figure.
        found: The calibrated log.
    """
    sets = found.sets
    with figure_at(path, 10.0, 0.8 + 1.15 * len(found.log.channels)) as figure:
        panels = grid_of(figure, len(found.log.channels), 1, sharex=True)[:, 0]
        begun = 0.0
        middles = []
        for i, data in enumerate(sets):
            time = (
                np.arange(len(data.raw), dtype=np.float64) if data.time is None else data.time - data.time[0]
            )
            length = float(time[-1]) + float(np.median(np.diff(time)))
            residual = found.residual(i)
            for axes, column in zip(panels, residual.T, strict=True):
                axes.plot(begun + time, column, color=look_of("window").colour, linewidth=0.6)
                if i % 2:
                    axes.axvspan(begun, begun + length, color="#000000", alpha=0.05, linewidth=0)
            middles.append(begun + length / 2)
            begun += length
        for axes, name in zip(panels, found.log.channels, strict=True):
            axes.set_ylabel(name.removeprefix("raw_").removesuffix("_count"))
            axes.axhline(0.0, color="#000000", linewidth=0.6)
        panels[-1].set_xlim(0.0, begun)
        panels[-1].set_xticks(middles, [f"set {data.name}" for data in sets])
        panels[-1].set_xlabel("sets one after the other")
        figure.supylabel("residual of each channel (counts)", fontsize=9.5)
    return path


def factory_look() -> Look:
    """The house's look of a map that was given and kept, under the factory's name."""
    return look_of("baseline")._replace(label="factory matrix")


def _rows(found: Calibrated) -> int:
    return -(-len(found.sets) // _COLUMNS)


def _spaces(figure: Figure, found: Calibrated) -> list[Any]:
    n = len(found.sets)
    columns = min(n, _COLUMNS)
    return [figure.add_subplot(_rows(found), columns, i + 1, projection="3d") for i in range(n)]


def _cloud(axes: Any, points: NDArray[np.float64], look: Look) -> None:
    points = points[np.isfinite(points).all(axis=1)]
    shown = points[:: max(1, len(points) // _SHOWN)]
    axes.scatter(*shown.T, s=2.0, color=look.colour, alpha=0.7, depthshade=False, label=look.label)


def _finish(axes: Any, title: str, unit: str) -> None:
    axes.set_title(title)
    # Counts of three mixed directions may differ in size by tens, so that only forces share one scale.
    if unit == "N":
        axes.set_aspect("equal")
    else:
        axes.set_box_aspect((1.0, 1.0, 1.0))
    for axis in "xyz":
        getattr(axes, f"set_{axis}label")(axis if unit == "N" else "", fontsize=8, labelpad=-9)
    few_ticks(axes)
