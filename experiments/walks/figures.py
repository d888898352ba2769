"""Figures of the comparison: errors at a glance, errors over time, and how sure methods are of them."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from surefoot.experiments.study.figures import (
    by_way,
    draw_curve,
    draw_mean,
    figure_at,
    grid_of,
    in_order,
    legend_below,
    logarithmic,
    look_of,
    name_axes,
)
from surefoot.experiments.study.tables import Frame
from surefoot.experiments.walks.scenarios import Scenario
from surefoot.experiments.walks.tables import METRICS, consistent

Panel = tuple[str, float, Callable[[Axes, Frame, float, str], None]]
"""A label, where a line is drawn, and what draws the runs of one method at a height."""


def overview(path: Path, scores: Frame, scenarios: Sequence[Scenario]) -> Path:
    """Draw mean errors with 95 % intervals: scenarios down, a panel a kind of error, colours for methods."""

    def panel(metric: str, factor: float, label: str, target: float) -> Panel:
        return label, target, lambda axes, runs, at, name: draw_mean(axes, runs[metric], factor, at, name)

    return _by_scenario(path, scores, _ran(scores, scenarios), [panel(*metric) for metric in METRICS])


def consistency(path: Path, scores: Frame, scenarios: Sequence[Scenario]) -> Path | None:
    """Draw the mean NEES at the ends of walks and the interval of a consistent estimator; or ``None``."""

    def draw(axes: Axes, runs: Frame, at: float, name: str) -> None:
        axes.plot(consistent(runs), [at, at], color="black", linewidth=5, alpha=0.25)
        draw_mean(axes, runs["nees_end"], 1.0, at, name)

    claims = scores[np.isfinite(scores["nees_end"])]
    shown = _ran(claims, scenarios)
    label = "NEES of scales and offsets over its degrees of freedom"
    return _by_scenario(path, claims, shown, [(label, 1.0, draw)]) if shown else None


def detection(path: Path, scores: Frame, scenarios: Sequence[Scenario]) -> Path | None:
    """Draw how long each fault went unfound, one dot a run; ``None`` if no fault was ever found."""

    def draw(axes: Axes, runs: Frame, at: float, name: str) -> None:
        times, look = np.maximum(runs["found"], 0.01), look_of(name)
        style = {"color": look.colour, "marker": look.marker, "linestyle": "none"}
        axes.plot(times, np.full(len(times), at), alpha=0.5, markersize=4, **style)  # type: ignore[arg-type]

    found = scores[np.isfinite(scores["found"])]
    shown = _ran(scores, [scenario for scenario in scenarios if scenario.faults])
    panel = ("time until a fault is found (s)", 1.0, draw)
    return _by_scenario(path, found, shown, [panel]) if len(found) and shown else None


def error_curves(path: Path, panels: Mapping[str, Frame], columns: int = 3) -> Path:
    """Draw the running CoP error (m) over time (s), median and quartiles over runs, a panel a title."""
    across = min(columns, len(panels))
    down = -(-len(panels) // across)
    with figure_at(path, max(3.7 * across + 0.4, 6.4), 2.5 * down + 1.2) as figure:
        drawn = grid_of(figure, down, across, sharey=True)
        for axes, (title, part) in zip(drawn.flat, panels.items(), strict=False):
            for method, runs in by_way(part).items():
                errors = runs.groupby("time")["cop"]
                low, middle, high = (1e3 * errors.quantile(q).clip(lower=1e-5) for q in (0.25, 0.5, 0.75))
                draw_curve(axes, middle.index, middle, look_of(method), low, high)
            axes.set_title(title)
            logarithmic(axes)
        drawn[0, 0].set_ylim(bottom=0.3)
        for axes in drawn.flat[len(panels) :]:
            axes.set_visible(False)
        name_axes(drawn, "time (s)", "CoP rmse of 2 s (mm)")
        legend_below(figure, drawn[0, 0])
    return path


def _ran(scores: Frame, scenarios: Sequence[Scenario]) -> list[Scenario]:
    return [scenario for scenario in scenarios if (scores["scenario"] == scenario.name).any()]


def _by_scenario(path: Path, scores: Frame, shown: Sequence[Scenario], panels: Sequence[Panel]) -> Path:
    """Draw a row a scenario, with the methods beside each other around it."""
    methods = in_order(scores["method"])
    with figure_at(path, 5.0 + 2.0 * len(panels) + (len(panels) == 1), 1.6 + 0.42 * len(shown)) as figure:
        drawn = grid_of(figure, 1, len(panels), sharey=True)[0]
        for axes, (label, line, draw) in zip(drawn, panels, strict=True):
            for i, scenario in enumerate(shown):
                for name, runs in by_way(scores[scores["scenario"] == scenario.name]).items():
                    draw(axes, runs, i + 0.7 * ((methods.index(name) + 0.5) / len(methods) - 0.5), name)
            axes.axvline(line, color="black", linestyle="--", linewidth=0.8)
            logarithmic(axes, label)
        drawn[0].set_yticks(range(len(shown)), [scenario.title for scenario in shown])
        drawn[0].set_ylim(len(shown) - 0.4, -0.6)
        for look in map(look_of, methods):
            drawn[0].plot([], [], look.marker, color=look.colour, label=look.label)
        legend_below(figure, drawn[0])
    return path
