"""Figures of the CoP paper's study: its 10 to 15, errors by method and speed, weights, and who falls."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from surefoot.experiments.arrays import Floats
from surefoot.experiments.study.figures import (
    Look,
    draw_curve,
    draw_mean,
    draw_steps,
    figure_at,
    grid_of,
    in_order,
    legend_below,
    logarithmic,
    look_of,
    name_axes,
    short_label,
    show_values,
)
from surefoot.experiments.study.statistics import mean_interval, survival
from surefoot.experiments.study.tables import Frame

Line = Callable[[Floats, Floats], Floats | None]  # of a quantity and its truth
DRAWN = ("truth", "none", "quasi-static", "window", "moment")  # what is drawn over time, in drawing order

_METRICS = (("cop", 1e3, "CoP rmse (mm)"), ("vgrf", 1.0, "vGRF rmse (N)"))
_SPEED_LOOKS = tuple(
    Look("", colour, "-", marker)
    for colour, marker in (("#56B4E9", "o"), ("#0072B2", "s"), ("#012a4a", "^"), ("#7f7f7f", "v"))
)


def cop_over_time(path: Path, traces: Mapping[str, Frame]) -> Path:
    """Draw the CoP over time (the paper's Figures 10, 12, 14), and how far off it is, as walks end."""
    lines: dict[str, Line] = {
        "CoP x, forward (mm)": lambda cop, truth: 1e3 * cop[:, 0],
        "CoP y, left (mm)": lambda cop, truth: 1e3 * cop[:, 1],
        "distance to truth (mm)": lambda cop, truth: (
            None if cop is truth else np.maximum(1e3 * np.linalg.norm(cop - truth, axis=1), 1e-2)
        ),
    }
    with _over_time(path, traces, "cop", 6.6, lines) as (panels, seen):
        truth = 1e3 * np.concatenate(seen["truth"])
        for axes, values in zip(panels[:2, 0], truth.T, strict=True):
            # A reading that runs away must not flatten all the others into one line.
            low, high = np.nanmin(values), np.nanmax(values)
            margin = 0.6 * max(high - low, 1.0)
            bottom, top = axes.get_ylim()
            axes.set_ylim(max(bottom, low - margin), min(top, high + margin))
        for axes in panels[2]:
            logarithmic(axes)
        bottom, top = panels[2, 0].get_ylim()
        panels[2, 0].set_ylim(max(bottom, 0.1), min(top, 1000.0))
    return path


def vgrf_over_time(path: Path, traces: Mapping[str, Frame]) -> Path:
    """Draw the vertical force of both feet and of the left foot over time (the paper's 11, 13, 15)."""
    lines: dict[str, Line] = {
        "both feet, Fz (N)": lambda vgrf, truth: vgrf.sum(axis=1),
        "left foot, Fz (N)": lambda vgrf, truth: vgrf[:, 0],
    }
    with _over_time(path, traces, "vgrf", 5.2, lines) as (panels, seen):
        # Single samples at a landing must not flatten all the others into one line.
        totals = [vgrf.sum(axis=1) for of_way in seen.values() for vgrf in of_way]
        low, high = np.nanpercentile(np.concatenate(totals), [0.5, 99.5])
        margin = 0.4 * max(float(high - low), 1.0)
        panels[0, 0].set_ylim(float(low) - margin, float(high) + margin)
    return path


@contextmanager
def _over_time(
    path: Path, traces: Mapping[str, Frame], quantity: str, height: float, lines: Mapping[str, Line]
) -> Iterator[tuple[Any, dict[str, list[Floats]]]]:
    """Draw a row a line and a column a trace; lend the panels and what was drawn, to set limits."""
    with figure_at(path, 10.0, height) as figure:
        panels = grid_of(figure, len(lines), len(traces), sharex=True, sharey="row")
        seen: dict[str, list[Floats]] = {name: [] for name in DRAWN}
        for column, (title, trace) in zip(panels.T, traces.items(), strict=True):
            ways = {row["method"]: row for row in trace.to_dict("records")}
            for name in DRAWN:
                time, values = _array(ways[name]["time"]), _array(ways[name][quantity])
                seen[name].append(values)
                style = {"linewidth": 1.1, "zorder": 2.0, "alpha": 0.9}
                if name == "truth":
                    style = {"linewidth": 1.9, "zorder": 1.5}
                for axes, line in zip(column, lines.values(), strict=True):
                    drawn = line(values, seen["truth"][-1])
                    if drawn is not None:
                        draw_curve(axes, time, drawn, look_of(name), **style)
            column[0].set_title(title)
        name_axes(panels, "time (s)", *lines)
        yield panels, seen
        legend_below(figure, panels[0, 0])


def rmse_overview(path: Path, scores: Frame, paper: Mapping[tuple[str, float], tuple[float, float]]) -> Path:
    """Draw mean errors (CoP in m, vGRF in N) by method and speed, and the paper's where rows say so."""
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
                    draw_mean(axes, runs[metric], factor, place(speed, name), name, upright=True)
                for (name, speed), printed in paper.items() if rows["paper"].any() else ():
                    if name in methods and speed in speeds:
                        colour = look_of(name).colour
                        axes.plot(place(speed, name), factor * printed[number], color=colour, **dash)
                logarithmic(axes)
                axes.set_xticks(range(len(speeds)), [f"{speed:g}" for speed in speeds])
                axes.set_xlim(-0.5, len(speeds) - 0.5)
            column[0].set_title(title)
        name_axes(panels, "speed (m/s)", *(label for _, _, label in _METRICS))
        for look in map(look_of, methods):
            panels[0, 0].plot([], [], look.marker, color=look.colour, label=look.label)
        panels[0, 0].plot([], [], color="black", label="as published", **dash)
        legend_below(figure, panels[0, 0])
    return path


def sensitivity_curves(path: Path, runs: Frame) -> Path:
    """Draw the window's errors (CoP in m, vGRF in N) against its weights, a row a panel and metric."""
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
    """Draw the share of walkers on their feet, and when each fell, up to the end of a walk in s."""
    speeds, feeds = sorted(runs["speed"].unique()), list(dict.fromkeys(runs["feed"]))
    with figure_at(path, max(3.5 * len(speeds), 8.0), 5.4) as figure:
        panels = grid_of(figure, 2, len(speeds), sharex=True, sharey="row")
        for column, speed in zip(panels.T, speeds, strict=True):
            for row, feed in enumerate(feeds):
                part = runs[(runs["speed"] == speed) & (runs["feed"] == feed)]
                curve = survival(part["time"], part["fell"])
                # Curves that coincide are drawn side by side, half a percent apart.
                share = 100 * np.append(curve.share, curve.share[-1]) - 0.7 * row
                draw_steps(column[0], np.append(curve.time, horizon), share, feed)
                _strip(column[1], part, row, look_of(feed).colour)
            column[0].set_title(f"{speed:g} m/s")
            column[0].set_ylim(-6, 104)
            column[1].set_yticks(range(len(feeds)), [short_label(feed) for feed in feeds])
            column[1].set_ylim(len(feeds) - 0.5, -0.5)
            column[1].set_xlim(0, 1.03 * horizon)
        name_axes(panels, "time (s)", "still walking (%)", "CoP fed back")
        legend_below(figure, panels[0, 0])
    return path


def _array(values: Any) -> Floats:
    """Return what a table holds as nested lists."""
    return np.array([np.asarray(value, dtype=np.float64) for value in values])


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
