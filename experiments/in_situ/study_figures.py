"""Figures of the simulated in-situ experiment: the paper's ellipsoids, and how heavy the limb comes out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from surefoot.calibration.in_situ import estimate_offset
from surefoot.experiments.force_torque.ellipsoids import draw_shell, few_ticks
from surefoot.experiments.force_torque.score import force_ellipsoid
from surefoot.experiments.in_situ.methods import FITTED, METHODS, MethodResult
from surefoot.experiments.in_situ.study_pieces import Shown
from surefoot.experiments.study.figures import Look, figure_at, grid_of, look_of
from surefoot.experiments.study.tables import Frame

__all__ = ["force_figure", "limb_figure", "method_look", "raw_figure"]

_LOOKS = {"surefoot": "moment", "no-loop": "tare", "paper": "window", "manufacturer": "none"}


def method_look(method: str) -> Look:
    """Look up how a method appears, in the house's colours."""
    return look_of(_LOOKS[method])._replace(label=METHODS[method])


def raw_figure(path: Path, shown: Sequence[Shown]) -> Path:
    """Draw counts along their three main directions, with the offset in the middle (in-situ paper, Fig. 5).

    Args:
        path: Where to save the figure.
        shown: The sensors, a row each; of their sets the ones that were not fitted.
    """
    with figure_at(path, 10.4, 2.9 * len(shown)) as figure:
        for one, j, axes in _spaces(figure, shown):
            fit = estimate_offset(one.raw[j], one.gravity[j])
            points = fit.coordinates(one.raw[j])
            axes.scatter(*points.T, s=2.0, color=look_of("none").colour, alpha=0.7, depthshade=False)
            draw_shell(axes, force_ellipsoid(points, one.gravity[j]), "#7f7f7f")
            axes.scatter(*fit.coordinates(fit.offset), s=18.0, color="#000000", marker="+")
            axes.set_title(f"{one.sensor}, set {j + 1}: {100.0 * fit.affine_residual:.2f} % off")
            axes.set_box_aspect((1.0, 1.0, 1.0))
            few_ticks(axes)
    return path


def force_figure(path: Path, shown: Sequence[Shown], methods: Sequence[str]) -> Path:
    """Draw forces by several matrices and their ellipsoids (in-situ paper, Fig. 6).

    Args:
        path: Where to save the figure.
        shown: The sensors, a row each; of their sets the ones that were not fitted.
        methods: Keys of METHODS; those that refused are left out.
    """
    with figure_at(path, 10.4, 0.4 + 2.9 * len(shown)) as figure:
        for one, j, axes in _spaces(figure, shown):
            for method in methods:
                found = one.found[method]
                if not isinstance(found, MethodResult):
                    continue
                look = method_look(method)
                force = (one.raw[j] - found.offsets[j]) @ found.matrix[:3].T
                axes.scatter(
                    *force.T, s=2.0, color=look.colour, alpha=0.7, depthshade=False, label=look.label
                )
                draw_shell(axes, force_ellipsoid(force, one.gravity[j]), look.colour)
            axes.set_title(f"{one.sensor}, set {j + 1} (N)")
            axes.set_aspect("equal")
            few_ticks(axes)
        if figure.axes:
            handles, labels = figure.axes[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=3, markerscale=4.0)
    return path


def limb_figure(path: Path, fits: Frame) -> Path:
    """Draw the error of the limb's weight of every seed, by sensor and method.

    Args:
        path: Where to save the figure.
        fits: A row a sensor, seed and method.
    """
    sensors = list(dict.fromkeys(fits["sensor"]))
    methods = [method for method in METHODS if method != "manufacturer"]
    with figure_at(path, 9.0, 3.2) as figure:
        for axes, sensor in zip(grid_of(figure, 1, len(sensors))[0], sensors, strict=True):
            axes.axhspan(-1.0, 1.0, color="#000000", alpha=0.08, linewidth=0)
            for place, method in enumerate(methods):
                part = fits[(fits["sensor"] == sensor) & (fits["method"] == method)].dropna(
                    subset=["limb_error"]
                )
                spread = np.linspace(-0.25, 0.25, len(part)) if len(part) > 1 else np.zeros(len(part))
                look = method_look(method)
                axes.plot(
                    place + spread, 100.0 * part["limb_error"], look.marker, color=look.colour, markersize=3.5
                )
            axes.set_xticks(range(len(methods)), ["surefoot", "without\nhysteresis", "III-B, III-C"])
            axes.set_title(sensor)
            axes.axhline(0.0, color="#000000", linewidth=0.6)
        figure.supylabel("limb's weight, error (%)", fontsize=9.5)
    return path


def _spaces(figure: Figure, shown: Sequence[Shown]) -> list[tuple[Shown, int, Any]]:
    """Make axes in space for each sensor's sets that were not fitted."""
    places = [(one, j) for one in shown for j in range(FITTED, len(one.raw))]
    columns = len(places) // max(len(shown), 1)
    return [
        (one, j, figure.add_subplot(len(shown), columns, i + 1, projection="3d"))
        for i, (one, j) in enumerate(places)
    ]
