"""Figures of one in-situ calibration: ellipsoids in space, and residuals over time."""

from pathlib import Path

import numpy as np

from surefoot.experiments.force_torque.ellipsoids import COUNTS, FORCES, Cloud, Panel, draw_ellipsoids
from surefoot.experiments.force_torque.tables import Calibrated
from surefoot.experiments.study.figures import figure_at, grid_of, look_of

__all__ = ["force_ellipsoids", "raw_ellipsoids", "residuals_over_time"]


def raw_ellipsoids(path: Path, found: Calibrated) -> Path:
    """Draw each set's counts along their three main directions, on one ellipsoid (in-situ paper, Fig. 5)."""
    panels = []
    for i, data in enumerate(found.sets):
        whole = np.isfinite(data.raw).all(axis=1)
        centred = data.raw[whole] - data.raw[whole].mean(axis=0)
        points = centred @ np.linalg.svd(centred, full_matrices=False)[2][:3].T
        title = f"set {found.label(i)}: {100.0 * found.affine_residual[i]:.2f} % off"
        panels.append(Panel(title, [Cloud(points, data.gravity[whole], look_of("none"))]))
    return draw_ellipsoids(path, panels, COUNTS)


def force_ellipsoids(path: Path, found: Calibrated) -> Path:
    """Draw each set's forces, calibrated and by the factory matrix, and their ellipsoids (paper, Fig. 6)."""
    looks = (
        look_of("moment")._replace(label="calibrated"),
        look_of("none")._replace(label="factory matrix"),
    )
    panels = []
    for i, data in enumerate(found.sets):
        clouds = [
            Cloud(found.wrench(i, matrix)[:, :3], data.gravity, look)
            for matrix, look in zip(found.matrices(), looks, strict=False)
        ]
        panels.append(Panel(f"set {found.label(i)}: {data.added_mass:.3f} kg", clouds))
    return draw_ellipsoids(path, panels, FORCES)


def residuals_over_time(path: Path, found: Calibrated) -> Path:
    """Draw what the fit leaves of every channel, set after set."""
    channels = found.log.channels
    with figure_at(path, 10.0, 0.8 + 1.15 * len(channels)) as figure:
        panels = grid_of(figure, len(channels), 1, sharex=True)[:, 0]
        start, middles = 0.0, []
        for i, data in enumerate(found.sets):
            rows = np.arange(len(data.raw), dtype=np.float64)
            time = rows if data.time is None else data.time - data.time[0]
            length = float(time[-1]) + float(np.median(np.diff(time)))
            for axes, column in zip(panels, found.residual(i).T, strict=True):
                colour = look_of("moment").colour
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
        figure.supylabel("residual of each channel (counts)", fontsize=9.5)
    return path
