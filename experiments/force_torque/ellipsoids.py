"""Axes in space on which figures of in-situ sets show points and ellipsoids; private."""

from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from surefoot.experiments.force_torque.score import Ellipsoid

__all__ = ["draw_shell", "few_ticks"]


def draw_shell(axes: Any, ellipsoid: Ellipsoid, colour: str) -> None:
    """Draw an ellipsoid as a net of thin lines.

    Args:
        axes: Axes in space.
        ellipsoid: In the axes' unit.
        colour: Of the lines.
    """
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 13))
    unit = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    x, y, z = np.tensordot(ellipsoid.axes, unit, axes=1) + ellipsoid.centre[:, None, None]
    axes.plot_wireframe(x, y, z, color=colour, linewidth=0.35, alpha=0.55)


def few_ticks(axes: Any) -> None:
    """Put small ticks at a few round numbers of each axis."""
    for axis in "xyz":
        getattr(axes, f"{axis}axis").set_major_locator(MaxNLocator(4))
    axes.tick_params(labelsize=7, pad=-2)
