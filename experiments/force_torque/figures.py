"""Figures of points in space and the ellipsoids that gravity draws (in-situ paper, Figs. 5, 6); residuals."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.ticker import FuncFormatter, MaxNLocator

from surefoot.arrays import Floats
from surefoot.experiments.force_torque.tables import Calibrated
from surefoot.experiments.force_torque.validation import force_ellipsoid, spans_space
from surefoot.experiments.study.figures import Look, figure_at, grid_of, legend_below, look_of

FORCES = ("x (N)", "y (N)", "z (N)")
COUNTS = ("1st (1000 counts)", "2nd", "3rd")
NEWTONS = ("1st (N, N m)", "2nd", "3rd")
"""Labels of the axes. Readings of mixed directions may differ in size by tens: forces alone share a scale."""

_SHOWN = 400  # points of a cloud

_GREY = "#7f7f7f"


class Cloud(NamedTuple):
    """Points and the gravity that belongs to them."""

    points: Floats  # in the axes' unit, shape (n, 3); rows that are not finite are left out
    gravity: Floats  # in m/s^2, shape (n, 3)
    look: Look
    mark: Floats | None = None  # with a cross, shape (3,)


class Panel(NamedTuple):
    """Axes in space: a title and the points to draw."""

    title: str
    clouds: Sequence[Cloud]


def draw_ellipsoids(path: Path, panels: Sequence[Panel], labels: tuple[str, str, str]) -> Path:
    """Draw clouds and their :func:`force_ellipsoid`, four panels a row, with one of the labels above."""
    rows, columns = -(-len(panels) // 4), min(len(panels), 4)
    forces = labels is FORCES
    with figure_at(path, 10.4, 0.4 + 2.9 * rows) as figure:
        for i, panel in enumerate(panels):
            axes: Any = figure.add_subplot(rows, columns, i + 1, projection="3d")
            for cloud in panel.clouds:
                _draw_cloud(axes, cloud, cloud.look.colour if forces else _GREY)
            axes.set_title(panel.title)
            # Without a zoom the label of the vertical axis is cut off.
            axes.set_box_aspect((1.0, 1.0, 1.0), zoom=0.86)
            if forces:
                axes.set_aspect("equal", adjustable="datalim")
            unit = 1e-3 if labels is COUNTS else 1.0
            for axis, label in zip((axes.xaxis, axes.yaxis, axes.zaxis), labels, strict=True):
                axis.set_label_text(label, fontsize=7)
                axis.labelpad = -7 if forces else -4
                axis.set_major_locator(MaxNLocator(3, prune="both"))
                axis.set_major_formatter(FuncFormatter(lambda value, _, unit=unit: f"{unit * value:g}"))
            axes.tick_params(labelsize=7, pad=-2)
        if forces and figure.axes:
            legend_below(figure, figure.axes, columns=3, markerscale=4.0)
    return path


def _draw_cloud(axes: Any, cloud: Cloud, shell: str) -> None:
    """Draw points, and their ellipsoid as thin lines of a colour unless gravity stayed in one plane."""
    points, look = cloud.points[np.isfinite(cloud.points).all(axis=1)], cloud.look
    shown = points[:: max(1, len(points) // _SHOWN)]
    axes.scatter(*shown.T, s=2.0, color=look.colour, alpha=0.7, depthshade=False, label=look.label)
    if cloud.mark is not None:
        axes.scatter(*cloud.mark, s=18.0, color="#000000", marker="+")
    if not spans_space(cloud.gravity):
        return
    ellipsoid = force_ellipsoid(cloud.points, cloud.gravity)
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 13))
    unit = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    x, y, z = np.tensordot(ellipsoid.axes, unit, axes=1) + ellipsoid.centre[:, None, None]
    axes.plot_wireframe(x, y, z, color=shell, linewidth=0.35, alpha=0.55)


def raw_ellipsoids(path: Path, found: Calibrated) -> Path:
    """Draw each set's readings along their three main directions, on one ellipsoid (paper, Fig. 5)."""
    panels = []
    for i, data in enumerate(found.sets):
        whole = np.isfinite(data.raw).all(axis=1)
        centred = data.raw[whole] - data.raw[whole].mean(axis=0)
        points = centred @ np.linalg.svd(centred, full_matrices=False)[2][:3].T
        title = f"set {found.label(i)}: {100.0 * found.affine_residual[i]:.2f} % off"
        panels.append(Panel(title, [Cloud(points, data.gravity[whole], look_of("none"))]))
    return draw_ellipsoids(path, panels, COUNTS if found.log.config.units.raw == "count" else NEWTONS)


def force_ellipsoids(path: Path, found: Calibrated) -> Path:
    """Draw each set's forces, calibrated and by the maker's matrix, and their ellipsoids (paper, Fig. 6)."""
    looks = (look_of("moment"), look_of("none"))
    panels = []
    for i, data in enumerate(found.sets):
        clouds = [
            Cloud(found.wrench(i, matrix)[:, :3], data.gravity, look._replace(label=f"{name} matrix"))
            for look, (name, matrix) in zip(looks, found.matrices.items(), strict=False)
        ]
        panels.append(Panel(f"set {found.label(i)}: {data.added_mass:.3f} kg", clouds))
    return draw_ellipsoids(path, panels, FORCES)


def residuals_over_time(path: Path, found: Calibrated) -> Path:
    """Draw the fit's residual of every channel, set after set."""
    channels, colour = found.log.channels, look_of("moment").colour
    with figure_at(path, 10.0, 0.8 + 1.15 * len(channels)) as figure:
        panels = grid_of(figure, len(channels), 1, sharex=True)[:, 0]
        start, middles = 0.0, []
        for i, data in enumerate(found.sets):
            time = (
                np.arange(len(data.raw), dtype=np.float64) if data.time is None else data.time - data.time[0]
            )
            length = float(time[-1]) + float(np.median(np.diff(time)))
            for axes, column in zip(panels, found.residual(i).T, strict=True):
                axes.plot(start + time, column, color=colour, linewidth=0.6, rasterized=True)
                if i % 2:
                    axes.axvspan(start, start + length, color="#000000", alpha=0.05, linewidth=0)
            middles.append(start + length / 2)
            start += length
        for axes, name in zip(panels, channels, strict=True):
            axes.set_ylabel(name.removeprefix("raw_").removesuffix("_count"))
            axes.axhline(0.0, color="#000000", linewidth=0.6)
        panels[-1].set_xlim(0.0, start)
        panels[-1].set_xticks(middles, [f"set {data.name}" for data in found.sets])
        panels[-1].set_xlabel("sets one after the other")
        figure.supylabel(f"residual of each channel ({found.log.config.units.of_raw})", fontsize=9.5)
    return path
