"""Figures of the arena: errors of all scenarios at a glance, over time, and how sure methods are of them.

Colours mean the same way to read the feet as in :mod:`surefoot.experiments.demo.figures`.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from scipy import stats

from surefoot.experiments.arena.scenarios import Scenario
from surefoot.experiments.study.figures import (
    figure_at,
    grid_of,
    in_order,
    legend_below,
    logarithmic,
    look_of,
)
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import Frame

__all__ = ["consistency", "detection", "error_curves", "overview"]

_PANELS = (
    ("cop", 1e3, "CoP rmse (mm)", 2.0),
    ("vgrf", 1.0, "vGRF rmse (N)", 0.4),
    ("cell", 1.0, "single cell rmse (N)", 0.4),
)


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
            for i, scenario in enumerate(shown):
                part = scores[scores["scenario"] == scenario.name]
                for j, method in enumerate(methods):
                    values = part[part["method"] == method][metric]
                    _dot(axes, values, factor, i + 0.7 * ((j + 0.5) / len(methods) - 0.5), method)
            axes.axvline(target, color="black", linestyle="--", linewidth=0.8)
            _log_x(axes, label)
        _by_scenario(figure, panels[0], shown, methods)
    return path


def error_curves(path: Path, errors: Frame, scenarios: tuple[Scenario, ...]) -> Path:
    """Draw the running CoP error over time, median and quartiles over runs, one panel a scenario.

    Args:
        path: Where to save the figure.
        errors: Rows ``scenario``, ``method``, ``seed``, ``time`` (s) and ``cop`` (m).
        scenarios: What to draw.
    """
    shown = [s for s in scenarios if (errors["scenario"] == s.name).any()]
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    with figure_at(path, max(3.7 * columns + 0.4, 8.4), 2.5 * rows + 1.2) as figure:
        panels = grid_of(figure, rows, columns, sharey=True)
        for axes, scenario in zip(panels.flat, shown, strict=False):
            part = errors[errors["scenario"] == scenario.name]
            for method in in_order(part["method"]):
                runs = part[part["method"] == method].groupby("time")["cop"]
                low, middle, high = (1e3 * runs.quantile(q).clip(lower=1e-5) for q in (0.25, 0.5, 0.75))
                look = look_of(method)
                axes.plot(middle.index, middle, color=look.colour, linestyle=look.line, label=look.label)
                axes.fill_between(middle.index, low, high, color=look.colour, alpha=0.15, linewidth=0)
            axes.set_title(scenario.title)
            axes.set_ylim(bottom=0.3)
            logarithmic(axes)
        for axes in panels.flat[len(shown) :]:
            axes.set_visible(False)
        for axes in panels[-1]:
            axes.set_xlabel("time (s)")
        for axes in panels[:, 0]:
            axes.set_ylabel("CoP rmse of 2 s (mm)")
        legend_below(figure, panels[0, 0], columns=6 if columns == 3 else 4)
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
        for i, scenario in enumerate(shown):
            part = claims[claims["scenario"] == scenario.name]
            for j, method in enumerate(methods):
                runs = part[part["method"] == method]
                if not len(runs):
                    continue
                degrees = float(runs["parameters"].sum())
                low, high = (stats.chi2.ppf(q, degrees) / degrees for q in (0.025, 0.975))
                at = i + 0.5 * ((j + 0.5) / len(methods) - 0.5)
                axes.plot([low, high], [at, at], color="black", linewidth=5, alpha=0.25)
                _dot(axes, runs["nees_end"], 1.0, at, method)
        axes.axvline(1.0, color="black", linewidth=0.8)
        _log_x(axes, "NEES of gains and zeros over its degrees of freedom")
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
        for i, scenario in enumerate(shown):
            part = found[found["scenario"] == scenario.name]
            for j, method in enumerate(methods):
                times = np.maximum(part[part["method"] == method]["found"], 0.01)
                at = np.full(len(times), i + 0.7 * ((j + 0.5) / len(methods) - 0.5))
                axes.plot(times, at, linestyle="none", alpha=0.5, markersize=4, **_mark(method))
        axes.axvline(1.0, color="black", linestyle="--", linewidth=0.8)
        _log_x(axes, "time until a fault is found (s)")
        _by_scenario(figure, axes, shown, methods)
    return path


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


def _dot(axes: Axes, values: Any, factor: float, at: float, method: str) -> None:
    interval = mean_interval(values)
    if interval.n == 0 or not interval.mean > 0.0:
        return
    mean, half = factor * interval.mean, 0.0 if np.isnan(interval.half) else factor * interval.half
    # On a logarithmic axis an interval that reaches below zero is cut off near the mean.
    reach = [[min(half, 0.9 * mean)], [half]]
    axes.errorbar(mean, at, xerr=reach, markersize=4.5, capsize=1.5, linewidth=1.1, **_mark(method))


def _mark(method: str) -> dict[str, Any]:
    look = look_of(method)
    return {"color": look.colour, "marker": look.marker}
