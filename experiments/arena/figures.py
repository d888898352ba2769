"""Figures of the comparison: errors at a glance, errors over time, and how sure methods are of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from surefoot.experiments.arena.scenarios import Scenario
from surefoot.experiments.arena.tables import consistent
from surefoot.experiments.study.figures import (
    draw_curve,
    figure_at,
    grid_of,
    in_order,
    legend_below,
    logarithmic,
    look_of,
)
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import Frame

__all__ = ["consistency", "detection", "draw_dot", "error_curves", "overview"]

_PANELS = (
    ("cop", 1e3, "CoP rmse (mm)", 2.0),
    ("vgrf", 1.0, "vGRF rmse (N)", 0.4),
    ("cell", 1.0, "single cell rmse (N)", 0.4),
)

SMALLEST = 1e-9
"""What is smaller than this is nothing, which a logarithmic axis cannot show."""


def draw_dot(axes: Axes, values: Any, factor: float, at: float, name: str, *, upright: bool = False) -> None:
    """Draw a mean with its 95 % interval on a logarithmic axis, in the look of a way to read the feet.

    Args:
        axes: Where.
        values: One number a run.
        factor: To multiply them with.
        at: Place on the other axis.
        name: The way to read the feet.
        upright: Whether the values go upwards, in place of to the right.
    """
    interval, look = mean_interval(values), look_of(name)
    if interval.n == 0 or not interval.mean > SMALLEST:
        return
    mean, half = factor * interval.mean, 0.0 if np.isnan(interval.half) else factor * interval.half
    # On a logarithmic axis an interval that reaches below zero is cut off near the mean.
    reach = [[min(half, 0.9 * mean)], [half]]
    place: dict[str, Any] = (
        {"x": at, "y": mean, "yerr": reach} if upright else {"x": mean, "y": at, "xerr": reach}
    )
    axes.errorbar(**place, color=look.colour, marker=look.marker, markersize=4.5, capsize=2.0, linewidth=1.2)


def overview(path: Path, scores: Frame, scenarios: tuple[Scenario, ...]) -> Path:
    """Draw mean errors with 95 % intervals: scenarios down, one panel a kind of error, colours for methods.

    Args:
        path: Where to save the figure.
        scores: One row a run, as :func:`surefoot.experiments.arena.run.run_arena` makes them.
        scenarios: What to draw, from the top.
    """
    shown = [s for s in scenarios if (scores["scenario"] == s.name).any()]
    methods = in_order(scores["method"])
    with figure_at(path, 11.0, 1.6 + 0.42 * len(shown)) as figure:
        panels = grid_of(figure, 1, 3, sharey=True)[0]
        for axes, (metric, factor, label, target) in zip(panels, _PANELS, strict=True):
            for at, name, runs in _rows(scores, shown, methods, 0.7):
                draw_dot(axes, runs[metric], factor, at, name)
            axes.axvline(target, color="black", linestyle="--", linewidth=0.8)
            _log_x(axes, label)
        _by_scenario(figure, panels[0], shown, methods)
    return path


def error_curves(path: Path, panels: Mapping[str, Frame], columns: int = 3) -> Path:
    """Draw the running CoP error over time, median and quartiles over runs.

    Args:
        path: Where to save the figure.
        panels: By title: rows ``method``, ``seed``, ``time`` (s) and ``cop`` (m).
        columns: Most panels side by side.
    """
    across = min(columns, len(panels))
    down = -(-len(panels) // across)
    with figure_at(path, max(3.7 * across + 0.4, 6.4), 2.5 * down + 1.2) as figure:
        drawn = grid_of(figure, down, across, sharey=True)
        for axes, (title, part) in zip(drawn.flat, panels.items(), strict=False):
            for method in in_order(part["method"]):
                runs = part[part["method"] == method].groupby("time")["cop"]
                low, middle, high = (1e3 * runs.quantile(q).clip(lower=1e-5) for q in (0.25, 0.5, 0.75))
                draw_curve(axes, middle.index, middle, look_of(method), low, high)
            axes.set_title(title)
            logarithmic(axes)
        drawn[0, 0].set_ylim(bottom=0.3)
        for axes in drawn.flat[len(panels) :]:
            axes.set_visible(False)
        for axes in drawn[-1]:
            axes.set_xlabel("time (s)")
        for axes in drawn[:, 0]:
            axes.set_ylabel("CoP rmse of 2 s (mm)")
        legend_below(figure, drawn[0, 0])
    return path


def consistency(path: Path, scores: Frame, scenarios: tuple[Scenario, ...]) -> Path | None:
    """Draw the mean NEES at the ends of walks with the interval that a consistent estimator keeps to.

    Args:
        path: Where to save the figure.
        scores: One row a run.
        scenarios: What to draw, from the top.

    Returns:
        The path, or ``None`` if no method claims an uncertainty.
    """
    claims = scores[np.isfinite(scores["nees_end"])]
    shown = [s for s in scenarios if (claims["scenario"] == s.name).any()]
    if not shown:
        return None
    methods = in_order(claims["method"])
    with figure_at(path, 8.0, 1.6 + 0.36 * len(shown)) as figure:
        axes = grid_of(figure, 1, 1)[0, 0]
        for at, name, runs in _rows(claims, shown, methods, 0.5):
            axes.plot(consistent(runs), [at, at], color="black", linewidth=5, alpha=0.25)
            draw_dot(axes, runs["nees_end"], 1.0, at, name)
        axes.axvline(1.0, color="black", linewidth=0.8)
        _log_x(axes, "NEES of scales and offsets over its degrees of freedom")
        _by_scenario(figure, axes, shown, methods)
    return path


def detection(path: Path, scores: Frame, scenarios: tuple[Scenario, ...]) -> Path | None:
    """Draw how long each fault went unfound, one dot a run.

    Args:
        path: Where to save the figure.
        scores: One row a run.
        scenarios: What to draw, from the top; those without a fault are left out.

    Returns:
        The path, or ``None`` if no fault was ever found.
    """
    found = scores[np.isfinite(scores["found"])]
    shown = [s for s in scenarios if s.faults and (scores["scenario"] == s.name).any()]
    if not len(found) or not shown:
        return None
    methods = in_order(found["method"])
    with figure_at(path, 8.0, 1.6 + 0.42 * len(shown)) as figure:
        axes = grid_of(figure, 1, 1)[0, 0]
        for at, name, runs in _rows(found, shown, methods, 0.7):
            times = np.maximum(runs["found"], 0.01)
            axes.plot(
                times, np.full(len(times), at), linestyle="none", alpha=0.5, markersize=4, **_mark(name)
            )
        axes.axvline(1.0, color="black", linestyle="--", linewidth=0.8)
        _log_x(axes, "time until a fault is found (s)")
        _by_scenario(figure, axes, shown, methods)
    return path


def _rows(
    scores: Frame, shown: list[Scenario], methods: list[str], spread: float
) -> list[tuple[float, str, Frame]]:
    """Return the place, the method and the runs of every row: scenarios one apart, methods around them."""
    rows = []
    for i, scenario in enumerate(shown):
        part = scores[scores["scenario"] == scenario.name]
        for j, method in enumerate(methods):
            runs = part[part["method"] == method]
            if len(runs):
                rows.append((i + spread * ((j + 0.5) / len(methods) - 0.5), method, runs))
    return rows


def _log_x(axes: Axes, label: str) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xlabel(label)


def _by_scenario(figure: Figure, axes: Axes, shown: list[Scenario], methods: list[str]) -> None:
    """Name the scenarios from the top, and put a key to the methods below."""
    axes.set_yticks(range(len(shown)), [s.title for s in shown])
    axes.set_ylim(len(shown) - 0.4, -0.6)
    for method in methods:
        axes.plot([], [], linestyle="none", label=look_of(method).label, **_mark(method))
    legend_below(figure, axes)


def _mark(method: str) -> dict[str, Any]:
    look = look_of(method)
    return {"color": look.colour, "marker": look.marker}
