"""Figures of points in space and the ellipsoids that gravity draws (in-situ paper, Figs. 5 and 6)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from surefoot.calibration.in_situ.validation import Ellipsoid, force_ellipsoid
from surefoot.experiments.study.figures import Look, figure_at, legend_below

__all__ = ["COUNTS", "FORCES", "Cloud", "Panel", "draw_ellipsoids"]

FORCES = ("x (N)", "y (N)", "z (N)")
COUNTS = ("1st (1000 counts)", "2nd", "3rd")
"""Labels of the axes. Counts of mixed directions may differ in size by tens: forces alone share a scale."""

_SHOWN = 400
"""Points of a cloud."""

_GREY = "#7f7f7f"


class Cloud(NamedTuple):
    """Points and the gravity that belongs to them.

    Attributes:
        points: In the axes' unit, shape (n, 3); rows that are not finite are left out.
        gravity: In m/s^2, shape (n, 3).
        look: Its colour and label.
        mark: A point to mark with a cross, shape (3,).
    """

    points: NDArray[np.float64]
    gravity: NDArray[np.float64]
    look: Look
    mark: NDArray[np.float64] | None = None


class Panel(NamedTuple):
    """Axes in space: a title and what is drawn there."""

    title: str
    clouds: Sequence[Cloud]


def draw_ellipsoids(path: Path, panels: Sequence[Panel], labels: tuple[str, str, str]) -> Path:
    """Draw clouds with the ellipsoids of :func:`force_ellipsoid`, four panels a row.

    Args:
        path: Where to save the figure.
        panels: What to draw.
        labels: :data:`FORCES` or :data:`COUNTS`.

    Returns:
        The path.
    """
    rows, columns = -(-len(panels) // 4), min(len(panels), 4)
    with figure_at(path, 10.4, 0.4 + 2.9 * rows) as figure:
        for i, panel in enumerate(panels):
            axes: Any = figure.add_subplot(rows, columns, i + 1, projection="3d")
            for cloud in panel.clouds:
                points = cloud.points[np.isfinite(cloud.points).all(axis=1)]
                shown, colour = points[:: max(1, len(points) // _SHOWN)], cloud.look.colour
                label = cloud.look.label
                axes.scatter(*shown.T, s=2.0, color=colour, alpha=0.7, depthshade=False, label=label)
                shell = force_ellipsoid(cloud.points, cloud.gravity)
                _draw_shell(axes, shell, colour if labels is FORCES else _GREY)
                if cloud.mark is not None:
                    axes.scatter(*cloud.mark, s=18.0, color="#000000", marker="+")
            axes.set_title(panel.title)
            # Without a zoom the label of the vertical axis is cut off.
            axes.set_box_aspect((1.0, 1.0, 1.0), zoom=0.86)
            if labels is FORCES:
                axes.set_aspect("equal", adjustable="datalim")
            unit = 1.0 if labels is FORCES else 1e-3
            for axis, label in zip((axes.xaxis, axes.yaxis, axes.zaxis), labels, strict=True):
                axis.set_label_text(label, fontsize=7)
                axis.labelpad = -7 if labels is FORCES else -4
                axis.set_major_locator(MaxNLocator(3, prune="both"))
                axis.set_major_formatter(FuncFormatter(lambda value, _, unit=unit: f"{unit * value:g}"))
            axes.tick_params(labelsize=7, pad=-2)
        if labels is FORCES and figure.axes:
            legend_below(figure, figure.axes, columns=3, markerscale=4.0)
    return path


def _draw_shell(axes: Any, ellipsoid: Ellipsoid, colour: str) -> None:
    """Draw an ellipsoid as a net of thin lines."""
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 13))
    unit = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    x, y, z = np.tensordot(ellipsoid.axes, unit, axes=1) + ellipsoid.centre[:, None, None]
    axes.plot_wireframe(x, y, z, color=colour, linewidth=0.35, alpha=0.55)
