"""Figures of single walks and of the bench: the CoP paper's 7, 8 and 10-15.

Every function takes plain numbers, draws one figure and returns the path of its PNG file. Colours mean
the same way to read the feet in all of them (:mod:`surefoot.experiments.study.figures`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from surefoot.experiments.study.figures import figure_at, grid_of, legend_below, logarithmic, look_of

__all__ = ["Trace", "bench_cop", "bench_vgrf", "cop_over_time", "vgrf_over_time"]


@dataclass(frozen=True, eq=False)
class Trace:
    """One walk as several ways to read the feet saw it.

    Attributes:
        title: What walk it is, such as ``"from a bad start"``.
        time: Times in s, shape (N,).
        cop: Centres of pressure in the world in m by way of reading, each (N, 2).
        vgrf: Vertical forces of the left and the right foot in N by way of reading, each (N, 2).
    """

    title: str
    time: NDArray[np.float64]
    cop: Mapping[str, NDArray[np.float64]]
    vgrf: Mapping[str, NDArray[np.float64]]


def bench_cop(
    path: Path,
    holes: NDArray[np.float64],
    initial: NDArray[np.float64],
    corrected: NDArray[np.float64],
) -> Path:
    """Draw measured centres of pressure against the holes of the bench plate (the paper's Figure 7).

    Args:
        path: Where to save the figure.
        holes: Where the weights truly stood in the sole frame in m, shape (n, 2).
        initial: Centres of pressure by the initial coefficients in m, shape (n, 2).
        corrected: The same placements after the bench calibration, shape (n, 2).
    """
    with figure_at(path, 9.0, 4.4) as figure:
        panels = grid_of(figure, 1, 2, sharex=True, sharey=True)[0]
        for axes, places, name, title in (
            (panels[0], initial, "none", "initial coefficients"),
            (panels[1], corrected, "baseline", "after the bench calibration"),
        ):
            axes.scatter(
                *(1e3 * holes.T), s=46, facecolors="none", edgecolors="#9a9a9a", label="holes (truth)"
            )
            axes.scatter(*(1e3 * places.T), s=7, color=look_of(name).colour, label="measured", zorder=3)
            off = 1e3 * np.linalg.norm(places - holes, axis=1)
            axes.set_title(f"{title}: {np.sqrt(np.mean(off**2)):.3g} mm rmse")
            axes.set_aspect("equal")
            axes.set_xlabel("x in the sole frame (mm)")
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
        panels[0].set_ylabel("y in the sole frame (mm)")
    return path


def bench_vgrf(
    path: Path,
    load: NDArray[np.float64],
    initial: NDArray[np.float64],
    corrected: NDArray[np.float64],
) -> Path:
    """Draw the vertical force of held-out placements (the paper's Figure 8).

    Args:
        path: Where to save the figure.
        load: True weights in N, shape (n,).
        initial: Forces by the initial coefficients in N, shape (n,).
        corrected: Forces after the bench calibration in N, shape (n,).
    """
    order = np.argsort(load, kind="stable")
    index = np.arange(len(load))
    with figure_at(path, 9.0, 4.2) as figure:
        top, bottom = grid_of(figure, 2, 1, sharex=True, height_ratios=[2, 1])[:, 0]
        for forces, name, label in (
            (initial, "none", "initial coefficients"),
            (corrected, "baseline", "after the bench calibration"),
        ):
            look = look_of(name)
            style = {"color": look.colour, "linestyle": "none", "marker": ".", "markersize": 4}
            top.plot(index, forces[order], label=label, **style)
            bottom.plot(index, np.maximum(np.abs(forces - load)[order], 1e-5), **style)
        top.step(index, load[order], where="mid", color="black", linestyle=":", linewidth=1.4, label="weight")
        top.set_ylabel("vertical force (N)")
        top.legend(loc="upper left")
        logarithmic(bottom)
        bottom.set_ylabel("|error| (N)")
        bottom.set_xlabel("held-out placement, sorted by weight")
    return path


def cop_over_time(
    path: Path, traces: Sequence[Trace], names: Sequence[str], span: tuple[float, float]
) -> Path:
    """Draw the centre of pressure over time (the paper's Figures 10, 12, 14), and how far off it is.

    Args:
        path: Where to save the figure.
        traces: Walks, one a column; each holds a way to read the feet called ``"truth"``.
        names: Ways to read the feet, in drawing order.
        span: First and last time in s to show.
    """
    with figure_at(path, 10.0, 6.6) as figure:
        panels = grid_of(figure, 3, len(traces), sharex=True, sharey="row")
        for column, trace in zip(panels.T, traces, strict=True):
            shown = (trace.time >= span[0]) & (trace.time <= span[1])
            truth = 1e3 * trace.cop["truth"][shown]
            for name in names:
                cop = 1e3 * trace.cop[name][shown]
                _draw(column[0], name, trace.time[shown], cop[:, 0])
                _draw(column[1], name, trace.time[shown], cop[:, 1])
                if name != "truth":
                    off = np.maximum(np.linalg.norm(cop - truth, axis=1), 1e-2)
                    _draw(column[2], name, trace.time[shown], off)
            column[0].set_title(trace.title)
            logarithmic(column[2])
            column[2].set_xlabel("time (s)")
        for axis in (0, 1):
            _limit(panels[axis, 0], traces, axis, span)
        bottom, top = panels[2, 0].get_ylim()
        panels[2, 0].set_ylim(max(bottom, 0.1), min(top, 1000.0))
        for axes, label in zip(
            panels[:, 0], ("CoP x, forward (mm)", "CoP y, left (mm)", "distance to truth (mm)"), strict=True
        ):
            axes.set_ylabel(label)
        legend_below(figure, panels[0, 0])
    return path


def vgrf_over_time(
    path: Path, traces: Sequence[Trace], names: Sequence[str], span: tuple[float, float]
) -> Path:
    """Draw the vertical force of both feet and of the left foot over time (the paper's 11, 13, 15).

    Args:
        path: Where to save the figure.
        traces: Walks, one a column.
        names: Ways to read the feet, in drawing order.
        span: First and last time in s to show.
    """
    with figure_at(path, 10.0, 5.2) as figure:
        panels = grid_of(figure, 2, len(traces), sharex=True, sharey="row")
        for column, trace in zip(panels.T, traces, strict=True):
            shown = (trace.time >= span[0]) & (trace.time <= span[1])
            for name in names:
                _draw(column[0], name, trace.time[shown], trace.vgrf[name][shown].sum(axis=1))
                _draw(column[1], name, trace.time[shown], trace.vgrf[name][shown, 0])
            column[0].set_title(trace.title)
            column[1].set_xlabel("time (s)")
        _limit_forces(panels[0, 0], traces, names, span)
        panels[0, 0].set_ylabel("both feet, Fz (N)")
        panels[1, 0].set_ylabel("left foot, Fz (N)")
        legend_below(figure, panels[0, 0])
    return path


def _draw(axes: Axes, name: str, time: NDArray[np.float64], values: NDArray[np.float64]) -> None:
    look = look_of(name)
    truth = name == "truth"
    axes.plot(
        time,
        values,
        color=look.colour,
        linestyle=look.line,
        linewidth=1.9 if truth else 1.1,
        alpha=1.0 if truth else 0.9,
        zorder=1.5 if truth else 2.0,
        label=look.label,
    )


def _limit(axes: Axes, traces: Sequence[Trace], axis: int, span: tuple[float, float]) -> None:
    """Keep a reading that runs away from flattening all the others into one line."""
    spans = []
    for trace in traces:
        shown = (trace.time >= span[0]) & (trace.time <= span[1])
        values = 1e3 * trace.cop["truth"][shown, axis]
        spans.append((float(np.nanmin(values)), float(np.nanmax(values))))
    low, high = min(s[0] for s in spans), max(s[1] for s in spans)
    margin = 0.6 * max(high - low, 1.0)
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low - margin), min(top, high + margin))


def _limit_forces(
    axes: Axes, traces: Sequence[Trace], names: Sequence[str], span: tuple[float, float]
) -> None:
    """Keep single samples at a landing from flattening all the others into one line."""
    total = np.concatenate(
        [
            trace.vgrf[name][(trace.time >= span[0]) & (trace.time <= span[1])].sum(axis=1)
            for trace in traces
            for name in names
        ]
    )
    low, high = np.nanpercentile(total, [0.5, 99.5])
    margin = 0.4 * max(float(high - low), 1.0)
    axes.set_ylim(float(low) - margin, float(high) + margin)
