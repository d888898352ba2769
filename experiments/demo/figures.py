"""Figures of the CoP paper's study: its 10 to 15, errors by method and speed, weights, and who falls."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from surefoot.experiments.arena.figures import draw_dot
from surefoot.experiments.study.figures import (
    Look,
    draw_curve,
    figure_at,
    grid_of,
    in_order,
    legend_below,
    logarithmic,
    look_of,
    short_label,
    show_values,
)
from surefoot.experiments.study.statistics import mean_interval, survival
from surefoot.experiments.study.tables import Frame

__all__ = [
    "closed_loop_survival",
    "cop_over_time",
    "rmse_overview",
    "sensitivity_curves",
    "vgrf_over_time",
]

DRAWN = ("truth", "none", "quasi-static", "window", "moment")
"""What is drawn over time, in drawing order."""

_METRICS = (("cop", 1e3, "CoP rmse (mm)"), ("vgrf", 1.0, "vGRF rmse (N)"))
_SPEED_LOOKS = tuple(
    Look("", colour, "-", marker)
    for colour, marker in (("#56B4E9", "o"), ("#0072B2", "s"), ("#012a4a", "^"), ("#7f7f7f", "v"))
)


def cop_over_time(path: Path, traces: Mapping[str, Frame]) -> Path:
    """Draw the centre of pressure over time (the paper's Figures 10, 12, 14), and how far off it is.

    Args:
        path: Where to save the figure.
        traces: Ends of walks by title, see :func:`~surefoot.experiments.arena.yardsticks.trace_of`.
    """
    labels = ("CoP x, forward (mm)", "CoP y, left (mm)", "distance to truth (mm)")
    with figure_at(path, 10.0, 6.6) as figure:
        panels = grid_of(figure, 3, len(traces), sharex=True, sharey="row")
        truths = []
        for column, (title, trace) in zip(panels.T, traces.items(), strict=True):
            ways = {row["method"]: row for row in trace.to_dict("records")}
            truth = 1e3 * _array(ways["truth"]["cop"])
            truths.append(truth)
            for name in DRAWN:
                time, cop = _array(ways[name]["time"]), 1e3 * _array(ways[name]["cop"])
                _draw(column[0], name, time, cop[:, 0])
                _draw(column[1], name, time, cop[:, 1])
                if name != "truth":
                    _draw(column[2], name, time, np.maximum(np.linalg.norm(cop - truth, axis=1), 1e-2))
            column[0].set_title(title)
            logarithmic(column[2])
            column[2].set_xlabel("time (s)")
        for axis in (0, 1):
            _limit(panels[axis, 0], np.concatenate(truths)[:, axis])
        bottom, top = panels[2, 0].get_ylim()
        panels[2, 0].set_ylim(max(bottom, 0.1), min(top, 1000.0))
        for axes, label in zip(panels[:, 0], labels, strict=True):
            axes.set_ylabel(label)
        legend_below(figure, panels[0, 0])
    return path


def vgrf_over_time(path: Path, traces: Mapping[str, Frame]) -> Path:
    """Draw the vertical force of both feet and of the left foot over time (the paper's 11, 13, 15).

    Args:
        path: Where to save the figure.
        traces: As in :func:`cop_over_time`.
    """
    with figure_at(path, 10.0, 5.2) as figure:
        panels = grid_of(figure, 2, len(traces), sharex=True, sharey="row")
        totals = []
        for column, (title, trace) in zip(panels.T, traces.items(), strict=True):
            ways = {row["method"]: row for row in trace.to_dict("records")}
            for name in DRAWN:
                time, vgrf = _array(ways[name]["time"]), _array(ways[name]["vgrf"])
                totals.append(vgrf.sum(axis=1))
                _draw(column[0], name, time, totals[-1])
                _draw(column[1], name, time, vgrf[:, 0])
            column[0].set_title(title)
            column[1].set_xlabel("time (s)")
        # Single samples at a landing must not flatten all the others into one line.
        low, high = np.nanpercentile(np.concatenate(totals), [0.5, 99.5])
        margin = 0.4 * max(float(high - low), 1.0)
        panels[0, 0].set_ylim(float(low) - margin, float(high) + margin)
        panels[0, 0].set_ylabel("both feet, Fz (N)")
        panels[1, 0].set_ylabel("left foot, Fz (N)")
        legend_below(figure, panels[0, 0])
    return path


def rmse_overview(path: Path, scores: Frame, paper: Mapping[tuple[str, float], tuple[float, float]]) -> Path:
    """Draw mean errors with 95 % intervals by method and speed, with the paper's own figures.

    Args:
        path: Where to save the figure.
        scores: One row a walk and method: ``panel``, ``speed`` (m/s), ``method``, ``cop`` (m), ``vgrf`` (N).
        paper: (CoP in m, vGRF in N) by method and speed, drawn where the panel's rows say ``paper``.
    """
    titles = list(dict.fromkeys(scores["panel"]))
    speeds, methods = sorted(scores["speed"].unique()), in_order(scores["method"])
    dash: dict[str, Any] = {"marker": "_", "markersize": 14, "markeredgewidth": 2.2, "linestyle": "none"}

    def place(speed: float, name: str) -> float:
        return float(speeds.index(speed)) + 0.62 * ((methods.index(name) + 0.5) / len(methods) - 0.5)

    with figure_at(path, 3.5 * len(titles), 5.4) as figure:
        panels = grid_of(figure, 2, len(titles), sharex=True, sharey="row")
        for column, title in zip(panels.T, titles, strict=True):
            rows = scores[scores["panel"] == title]
            for number, (axes, (metric, factor, _)) in enumerate(zip(column, _METRICS, strict=True)):
                for (name, speed), runs in rows.groupby(["method", "speed"]):
                    draw_dot(axes, runs[metric], factor, place(speed, name), name, upright=True)
                for (name, speed), printed in paper.items() if rows["paper"].any() else ():
                    if name in methods and speed in speeds:
                        colour = look_of(name).colour
                        axes.plot(place(speed, name), factor * printed[number], color=colour, **dash)
                logarithmic(axes)
                axes.set_xticks(range(len(speeds)), [f"{speed:g}" for speed in speeds])
                axes.set_xlim(-0.5, len(speeds) - 0.5)
            column[0].set_title(title)
            column[1].set_xlabel("speed (m/s)")
        for axes, (_, _, label) in zip(panels[:, 0], _METRICS, strict=True):
            axes.set_ylabel(label)
        for look in map(look_of, methods):
            panels[0, 0].plot(
                [], [], color=look.colour, marker=look.marker, linestyle="none", label=look.label
            )
        panels[0, 0].plot([], [], color="black", label="as published", **dash)
        legend_below(figure, panels[0, 0])
    return path


def sensitivity_curves(path: Path, runs: Frame) -> Path:
    """Draw the window's errors against its weights (the paper's sensitivity study).

    Args:
        path: Where to save the figure.
        runs: Rows ``panel``, ``weight`` (``w_F``, ``w_P``, ``w_S``), ``factor``, ``speed``, ``seed``, ``cop``
            (m), ``vgrf`` (N).
    """
    titles, weights = (list(dict.fromkeys(runs[name])) for name in ("panel", "weight"))
    metrics = [(title, *metric) for title in titles for metric in _METRICS]
    with figure_at(path, 3.3 * len(weights), 2.1 * len(metrics) + 0.5) as figure:
        panels = grid_of(figure, len(metrics), len(weights), sharex=True, sharey="row")
        for row, (title, metric, scale, label) in zip(panels, metrics, strict=True):
            for axes, weight in zip(row, weights, strict=True):
                part = runs[(runs["panel"] == title) & (runs["weight"] == weight)]
                _sensitivity_lines(axes, part, metric, scale)
            row[0].set_ylabel(label)
            row[len(row) // 2].set_title(title)
            row[0].set_ylim(0, 1.05 * row[0].get_ylim()[1])
        for axes, weight in zip(panels[-1], weights, strict=True):
            axes.set_xlabel(f"factor on ${weight[0]}_{weight[-1]}$")
        legend_below(figure, panels[0, 0])
    return path


def closed_loop_survival(path: Path, runs: Frame, horizon: float) -> Path:
    """Draw the share of walkers on their feet, and when each fell.

    Args:
        path: Where to save the figure.
        runs: One row a walk: ``speed``, ``seed``, ``feed``, ``fell``, ``time`` (s).
        horizon: End of a walk in s.
    """
    speeds, feeds = sorted(runs["speed"].unique()), list(dict.fromkeys(runs["feed"]))
    with figure_at(path, max(3.5 * len(speeds), 8.0), 5.4) as figure:
        panels = grid_of(figure, 2, len(speeds), sharex=True, sharey="row")
        for column, speed in zip(panels.T, speeds, strict=True):
            for row, feed in enumerate(feeds):
                look = look_of(feed)
                part = runs[(runs["speed"] == speed) & (runs["feed"] == feed)]
                curve = survival(part["time"], part["fell"])
                # Curves that coincide are drawn side by side, half a percent apart.
                column[0].step(
                    np.append(curve.time, horizon),
                    100 * np.append(curve.share, curve.share[-1]) - 0.7 * row,
                    where="post",
                    color=look.colour,
                    linestyle=look.line,
                    label=look.label,
                )
                _strip(column[1], part, row, look.colour)
            column[0].set_title(f"{speed:g} m/s")
            column[0].set_ylim(-6, 104)
            column[1].set_yticks(range(len(feeds)), [short_label(feed) for feed in feeds])
            column[1].set_ylim(len(feeds) - 0.5, -0.5)
            column[1].set_xlabel("time (s)")
            column[1].set_xlim(0, 1.03 * horizon)
        panels[0, 0].set_ylabel("still walking (%)")
        panels[1, 0].set_ylabel("CoP fed back")
        legend_below(figure, panels[0, 0])
    return path


def _array(values: Any) -> NDArray[np.float64]:
    """Return what a table holds as nested lists."""
    return np.array([np.asarray(value, dtype=np.float64) for value in values])


def _draw(axes: Axes, name: str, time: NDArray[np.float64], values: NDArray[np.float64]) -> None:
    truth = name == "truth"
    style = {"linewidth": 1.9, "zorder": 1.5} if truth else {"linewidth": 1.1, "zorder": 2.0, "alpha": 0.9}
    draw_curve(axes, time, values, look_of(name), **style)


def _limit(axes: Axes, truth: NDArray[np.float64]) -> None:
    """Keep a reading that runs away from flattening all the others into one line."""
    low, high = float(np.nanmin(truth)), float(np.nanmax(truth))
    margin = 0.6 * max(high - low, 1.0)
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low - margin), min(top, high + margin))


def _sensitivity_lines(axes: Axes, part: Frame, metric: str, scale: float) -> None:
    factors = sorted(part["factor"].unique())
    for speed, look in zip(sorted(part["speed"].unique()), _SPEED_LOOKS, strict=False):
        here = part[part["speed"] == speed]
        cells = [mean_interval(here[here["factor"] == factor][metric]) for factor in factors]
        mean = np.array([scale * cell.mean for cell in cells])
        half = np.nan_to_num(np.array([scale * cell.half for cell in cells]))
        draw_curve(axes, factors, mean, look._replace(label=f"{speed:g} m/s"), mean - half, mean + half)
    axes.axvline(1.0, color="#7f7f7f", linewidth=0.8, linestyle=":")
    axes.set_xscale("log")
    show_values(axes, factors)


def _strip(axes: Axes, part: Frame, row: int, colour: str) -> None:
    spread = row + 0.28 * np.linspace(-1, 1, len(part)) if len(part) > 1 else np.array([row])
    fell = part["fell"].to_numpy(dtype=bool)
    time = part["time"].to_numpy()
    axes.scatter(time[fell], spread[fell], marker="x", s=20, color=colour, linewidths=1.3)
    axes.scatter(time[~fell], spread[~fell], marker="o", s=14, facecolors="none", edgecolors=colour)
