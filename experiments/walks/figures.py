"""Figures of a study of walks: errors at a glance and over time."""

from collections.abc import Mapping, Sequence
from pathlib import Path

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
from surefoot.experiments.walks.tables import METRICS, Metric


def overview(path: Path, rows: Mapping[str, Frame], metrics: Sequence[Metric] = METRICS) -> Path:
    """Draw mean errors with 95 % intervals: rows by title down, a panel an error, colours for methods.

    Dashed is what was set out to be reached, but of runs against the CoP paper's baseline.
    """
    methods = in_order(name for runs in rows.values() for name in runs["method"])
    of_paper = all("against" in runs for runs in rows.values())
    with figure_at(path, 5.0 + 2.0 * len(metrics), 1.6 + 0.42 * len(rows)) as figure:
        panels = grid_of(figure, 1, len(metrics), sharey=True)[0]
        for axes, metric in zip(panels, metrics, strict=True):
            for i, part in enumerate(rows.values()):
                for name, runs in by_way(part).items():
                    at = i + 0.7 * ((methods.index(name) + 0.5) / len(methods) - 0.5)
                    draw_mean(axes, runs[metric.column], metric.factor, at, name)
            if not of_paper:
                axes.axvline(metric.target, color="black", linestyle="--", linewidth=0.8)
            logarithmic(axes, metric.label)
        panels[0].set_yticks(range(len(rows)), list(rows))
        panels[0].set_ylim(len(rows) - 0.4, -0.6)
        for look in map(look_of, methods):
            panels[0].plot([], [], look.marker, color=look.colour, label=look.label)
        legend_below(figure, panels[0])
    return path


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


def by_scenario(scores: Frame, scenarios: Sequence[Scenario]) -> dict[str, Frame]:
    """Return the rows of each scenario that has some, by its title."""
    parts = {scenario.title: scores[scores["scenario"] == scenario.name] for scenario in scenarios}
    return {title: part for title, part in parts.items() if len(part)}
