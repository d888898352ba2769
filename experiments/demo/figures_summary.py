"""Figures that sum walks up: errors by method and speed, over time and over weights, and who falls when.

Colours mean the same way to read the feet as in :mod:`surefoot.experiments.demo.figures`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from surefoot.experiments.study.figures import (
    figure_at,
    grid_of,
    in_order,
    legend_below,
    logarithmic,
    look_of,
    short_label,
)
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import Frame
from surefoot.experiments.walks.score import survival_curve

__all__ = ["closed_loop_survival", "error_over_time", "rmse_overview", "sensitivity_curves"]


def rmse_overview(path: Path, scores: Frame, paper: Mapping[tuple[str, float], tuple[float, float]]) -> Path:
    """Draw mean errors with 95 % intervals by method and speed, with the paper's own figures.

    Args:
        path: Where to save the figure.
        scores: One row a walk and method: ``panel``, ``speed`` (m/s), ``method``, ``cop`` (m), ``vgrf`` (N).
        paper: (CoP in m, vGRF in N) by method and speed, drawn where the panel's rows say ``paper``.
    """
    titles = list(dict.fromkeys(scores["panel"]))
    speeds = sorted(scores["speed"].unique())
    methods = in_order(scores["method"])
    with figure_at(path, 3.5 * len(titles), 5.4) as figure:
        panels = grid_of(figure, 2, len(titles), sharex=True, sharey="row")
        for column, title in zip(panels.T, titles, strict=True):
            rows = scores[scores["panel"] == title]
            for row, (axes, metric, factor) in enumerate(
                zip(column, ("cop", "vgrf"), (1e3, 1.0), strict=True)
            ):
                _dots(axes, rows, metric, factor, speeds, methods)
                if rows["paper"].any():
                    for name, speed in paper:
                        if name in methods and speed in speeds:
                            x = speeds.index(speed) + _shift(methods, name)
                            axes.plot(
                                x,
                                factor * paper[name, speed][row],
                                marker="_",
                                markersize=14,
                                markeredgewidth=2.2,
                                color=look_of(name).colour,
                                linestyle="none",
                            )
                logarithmic(axes)
                axes.set_xticks(range(len(speeds)), [f"{speed:g}" for speed in speeds])
            column[0].set_title(title)
            column[1].set_xlabel("speed (m/s)")
        panels[0, 0].set_ylabel("CoP rmse (mm)")
        panels[1, 0].set_ylabel("vGRF rmse (N)")
        for name in methods:
            panels[0, 0].plot(
                [],
                [],
                color=look_of(name).colour,
                marker=look_of(name).marker,
                linestyle="none",
                label=look_of(name).label,
            )
        panels[0, 0].plot(
            [],
            [],
            color="black",
            marker="_",
            markersize=12,
            markeredgewidth=2.2,
            linestyle="none",
            label="as published",
        )
        legend_below(figure, panels[0, 0])
    return path


def _shift(methods: Sequence[str], name: str) -> float:
    return 0.62 * ((methods.index(name) + 0.5) / len(methods) - 0.5)


def _dots(
    axes: Axes,
    rows: Frame,
    metric: str,
    factor: float,
    speeds: Sequence[float],
    methods: Sequence[str],
) -> None:
    for name in methods:
        for i, speed in enumerate(speeds):
            values = rows[(rows["method"] == name) & (rows["speed"] == speed)][metric]
            interval = mean_interval(values)
            if interval.n == 0 or interval.mean <= 1e-9:
                continue
            half = 0.0 if np.isnan(interval.half) else factor * interval.half
            mean = factor * interval.mean
            # On a logarithmic axis an interval that reaches below zero is cut off near the mean.
            below = min(half, 0.9 * mean)
            axes.errorbar(
                i + _shift(methods, name),
                mean,
                [[below], [half]],
                color=look_of(name).colour,
                marker=look_of(name).marker,
                markersize=5,
                capsize=2.5,
                linewidth=1.3,
            )


def error_over_time(path: Path, errors: Frame) -> Path:
    """Draw how the error of the centre of pressure goes with time, median and quartiles over seeds.

    Args:
        path: Where to save the figure.
        errors: Rows ``panel``, ``speed``, ``method``, ``seed``, ``time`` (s) and ``cop`` (m), the rmse of the
            piece of the walk that ends then.
    """
    titles = list(dict.fromkeys(errors["panel"]))
    speeds = sorted(errors["speed"].unique())
    with figure_at(path, max(3.4 * len(speeds), 8.0), 2.6 * len(titles) + 0.5) as figure:
        panels = grid_of(figure, len(titles), len(speeds), sharex=True, sharey=True)
        for row, title in zip(panels, titles, strict=True):
            for axes, speed in zip(row, speeds, strict=True):
                part = errors[(errors["panel"] == title) & (errors["speed"] == speed)]
                for name in in_order(part["method"]):
                    look = look_of(name)
                    quartiles = (
                        part[part["method"] == name].groupby("time")["cop"].quantile([0.25, 0.5, 0.75])
                    )
                    table = 1e3 * quartiles.unstack()
                    axes.plot(
                        table.index, table[0.5], color=look.colour, linestyle=look.line, label=look.label
                    )
                    axes.fill_between(
                        table.index, table[0.25], table[0.75], color=look.colour, alpha=0.13, linewidth=0
                    )
                logarithmic(axes)
                axes.set_title(f"{title}, {speed:g} m/s")
            row[0].set_ylabel("CoP rmse (mm)")
        for axes in panels[-1]:
            axes.set_xlabel("time since the start (s)")
        legend_below(figure, panels[0, 0])
    return path


def sensitivity_curves(path: Path, runs: Frame) -> Path:
    """Draw the window's errors against its weights (the paper's sensitivity study).

    Args:
        path: Where to save the figure.
        runs: Rows ``panel``, ``weight`` (``w_F``, ``w_P``, ``w_S``), ``factor``, ``speed``, ``seed``, ``cop``
            (m), ``vgrf`` (N).
    """
    titles = list(dict.fromkeys(runs["panel"]))
    weights = list(dict.fromkeys(runs["weight"]))
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


_METRICS = (("cop", 1e3, "CoP rmse (mm)"), ("vgrf", 1.0, "vGRF rmse (N)"))
_SPEED_COLOURS = ("#56B4E9", "#0072B2", "#012a4a", "#7f7f7f")


def _sensitivity_lines(axes: Axes, part: Frame, metric: str, scale: float) -> None:
    factors = sorted(part["factor"].unique())
    for speed, colour in zip(sorted(part["speed"].unique()), _SPEED_COLOURS, strict=False):
        here = part[part["speed"] == speed]
        cells = [mean_interval(here[here["factor"] == factor][metric]) for factor in factors]
        mean = np.array([scale * cell.mean for cell in cells])
        half = np.nan_to_num(np.array([scale * cell.half for cell in cells]))
        axes.plot(factors, mean, marker="o", markersize=4, color=colour, label=f"{speed:g} m/s")
        axes.fill_between(factors, mean - half, mean + half, color=colour, alpha=0.15, linewidth=0)
    axes.axvline(1.0, color="#7f7f7f", linewidth=0.8, linestyle=":")
    axes.set_xscale("log")
    axes.set_xticks(factors, [f"{factor:g}" for factor in factors])
    axes.minorticks_off()


def closed_loop_survival(path: Path, runs: Frame, horizon: float) -> Path:
    """Draw the share of walkers on their feet, and when each fell.

    Args:
        path: Where to save the figure.
        runs: One row a walk: ``speed``, ``seed``, ``feed``, ``fell``, ``time`` (s).
        horizon: End of a walk in s.
    """
    speeds = sorted(runs["speed"].unique())
    feeds = list(dict.fromkeys(runs["feed"]))
    with figure_at(path, max(3.5 * len(speeds), 8.0), 5.4) as figure:
        panels = grid_of(figure, 2, len(speeds), sharex=True, sharey="row")
        for column, speed in zip(panels.T, speeds, strict=True):
            for row, feed in enumerate(feeds):
                look = look_of(feed)
                part = runs[(runs["speed"] == speed) & (runs["feed"] == feed)]
                time, share = survival_curve(part["time"], part["fell"])
                # Curves that coincide are drawn side by side, half a percent apart.
                column[0].step(
                    np.append(time, horizon),
                    100 * np.append(share, share[-1]) - 0.7 * row,
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


def _strip(axes: Axes, part: Frame, row: int, colour: str) -> None:
    spread = row + 0.28 * np.linspace(-1, 1, len(part)) if len(part) > 1 else np.array([row])
    fell = part["fell"].to_numpy(dtype=bool)
    time = part["time"].to_numpy()
    axes.scatter(time[fell], spread[fell], marker="x", s=20, color=colour, linewidths=1.3)
    axes.scatter(time[~fell], spread[~fell], marker="o", s=14, facecolors="none", edgecolors=colour)
