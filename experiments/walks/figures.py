"""Figures of a study of walks: errors at a glance and over time; the CoP paper's 10 to 15."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from surefoot.experiments.arrays import Floats
from surefoot.experiments.study.figures import (
    by_way,
    draw_curve,
    draw_mean,
    figure_at,
    grid_of,
    in_order,
    legend_below,
    limit_to,
    logarithmic,
    look_of,
    name_axes,
)
from surefoot.experiments.study.tables import Frame
from surefoot.experiments.walks.scenarios import Scenario
from surefoot.experiments.walks.tables import METRICS, WALKING_TABLES, Metric

DRAWN = ("truth", "none", "quasi-static", "window", "moment")  # what is drawn over time, in drawing order
OVER_TIME = (
    "CoP x, forward (mm)",
    "CoP y, left (mm)",
    "distance to truth (mm)",
    "both feet, Fz (N)",
    "left foot, Fz (N)",
)


def overview(path: Path, rows: Mapping[str, Frame], metrics: Sequence[Metric] = METRICS) -> Path:
    """Draw mean errors with 95 % intervals: rows by title down, a panel an error, colours for methods.

    Dashed is what was set out to be reached; of runs against the CoP paper's baseline there are the paper's
    own errors instead, as bars.
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
                    if of_paper and (runs["against"] == "baseline").all():
                        _draw_paper_value(axes, metric, float(runs["speed"].iloc[0]), at, name)
            if not of_paper:
                axes.axvline(metric.target, color="black", linestyle="--", linewidth=0.8)
            logarithmic(axes, metric.label)
        panels[0].set_yticks(range(len(rows)), list(rows))
        panels[0].set_ylim(len(rows) - 0.4, -0.6)
        for look in map(look_of, methods):
            panels[0].plot([], [], look.marker, color=look.colour, label=look.label)
        legend_below(figure, panels[0])
    return path


def _draw_paper_value(axes: Axes, metric: Metric, speed: float, at: float, name: str) -> None:
    """Draw the CoP paper's own error of a method at a walking speed in m/s, if it gives one."""
    published = WALKING_TABLES.get(speed, {}).get(name)
    if published is not None:
        style: Any = {"marker": "|", "markersize": 14, "markeredgewidth": 2.2, "linestyle": "none"}
        error = metric.factor * getattr(published, metric.column)
        axes.plot(error, at, color=look_of(name).colour, **style)


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


def over_time(path: Path, traces: Mapping[str, Frame]) -> Path:
    """Draw CoP and vertical forces as walks end (the paper's Figures 10 to 15), a column a trace."""
    with figure_at(path, 10.0, 10.4) as figure:
        panels = grid_of(figure, len(OVER_TIME), len(traces), sharex=True, sharey="row")
        places, totals = [], []
        for column, (title, trace) in zip(panels.T, traces.items(), strict=True):
            ways = trace.set_index("method")
            truth = 1e3 * _array(ways.loc["truth", "cop"])
            places.append(truth)
            for name in DRAWN:
                time, cop, vgrf = (_array(ways.loc[name, quantity]) for quantity in ("time", "cop", "vgrf"))
                off = np.maximum(np.linalg.norm(1e3 * cop - truth, axis=1), 1e-2)
                totals.append(vgrf.sum(axis=1))
                style = {"linewidth": 1.1, "zorder": 2.0, "alpha": 0.9}
                if name == "truth":
                    off, style = np.full(len(off), np.nan), {"linewidth": 1.9, "zorder": 1.5}
                for axes, line in zip(column, (*1e3 * cop.T, off, totals[-1], vgrf[:, 0]), strict=True):
                    draw_curve(axes, time, line, look_of(name), **style)
            column[0].set_title(title)
            logarithmic(column[2])
        for axes, values in zip(panels[:2, 0], np.concatenate(places).T, strict=True):
            limit_to(axes, values, least=1.0)
        bottom, top = panels[2, 0].get_ylim()
        panels[2, 0].set_ylim(max(bottom, 0.1), min(top, 1000.0))
        # Single samples at a landing must not flatten all the others into one line.
        low, high = map(float, np.nanpercentile(np.concatenate(totals), [0.5, 99.5]))
        margin = 0.4 * max(high - low, 1.0)
        panels[3, 0].set_ylim(low - margin, high + margin)
        name_axes(panels, "time (s)", *OVER_TIME)
        legend_below(figure, panels[0, 0])
    return path


def _array(values: Any) -> Floats:
    """Return nested lists of a table as an array."""
    return np.array([np.asarray(value, dtype=np.float64) for value in values])


def by_scenario(scores: Frame, scenarios: Sequence[Scenario]) -> dict[str, Frame]:
    """Return the rows of each scenario that has some, by its title."""
    parts = {scenario.title: scores[scores["scenario"] == scenario.name] for scenario in scenarios}
    return {title: part for title, part in parts.items() if len(part)}
