"""Figures of a study of walks: errors at a glance and over time, faults; the CoP paper's 10 to 15."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
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
from surefoot.experiments.walks.tables import METRICS, WALKING_TABLES, Metric, consistent

Panel = tuple[str, float | None, Callable[[Axes, Frame, float, str], None]]
"""A label, where a line is drawn, and what draws the runs of one method at a height."""

Line = Callable[[Floats, Floats], Floats | None]  # of a quantity and its truth
DRAWN = ("truth", "none", "quasi-static", "window", "moment")  # what is drawn over time, in drawing order


def overview(path: Path, rows: Mapping[str, Frame], metrics: Sequence[Metric] = METRICS) -> Path:
    """Draw mean errors with 95 % intervals: rows by title down, a panel an error, colours for methods.

    Dashed is what was set out to be reached; of runs against the CoP paper's baseline there are the paper's
    own errors instead, as bars.
    """

    def panel(metric: Metric) -> Panel:
        def draw(axes: Axes, runs: Frame, at: float, name: str) -> None:
            draw_mean(axes, runs[metric.column], metric.factor, at, name)
            if not of_paper or not (runs["against"] == "baseline").all():
                return
            published = WALKING_TABLES.get(float(runs["speed"].iloc[0]), {}).get(name)
            if published is not None:
                style: Any = {"marker": "|", "markersize": 14, "markeredgewidth": 2.2, "linestyle": "none"}
                error = metric.factor * getattr(published, metric.column)
                axes.plot(error, at, color=look_of(name).colour, **style)

        return metric.label, None if of_paper else metric.target, draw

    of_paper = all("against" in runs for runs in rows.values())
    return _draw_rows(path, rows, [panel(metric) for metric in metrics])


def consistency(path: Path, scores: Frame, scenarios: Sequence[Scenario]) -> Path | None:
    """Draw the mean NEES at the ends of walks and the interval of a consistent estimator; or ``None``."""

    def draw(axes: Axes, runs: Frame, at: float, name: str) -> None:
        axes.plot(consistent(runs), [at, at], color="black", linewidth=5, alpha=0.25)
        draw_mean(axes, runs["nees_end"], 1.0, at, name)

    rows = by_scenario(scores[np.isfinite(scores["nees_end"])], scenarios)
    label = "NEES of scales and offsets over its degrees of freedom"
    return _draw_rows(path, rows, [(label, 1.0, draw)]) if rows else None


def detection(path: Path, scores: Frame, scenarios: Sequence[Scenario]) -> Path | None:
    """Draw how long each fault went unfound, one dot a run; ``None`` if no fault was ever found."""

    def draw(axes: Axes, runs: Frame, at: float, name: str) -> None:
        times, look = np.maximum(runs["found"], 0.01), look_of(name)
        style = {"color": look.colour, "marker": look.marker, "linestyle": "none"}
        axes.plot(times, np.full(len(times), at), alpha=0.5, markersize=4, **style)  # type: ignore[arg-type]

    found = scores[np.isfinite(scores["found"])]
    rows = by_scenario(found, [scenario for scenario in scenarios if scenario.faults])
    return _draw_rows(path, rows, [("time until a fault is found (s)", 1.0, draw)]) if rows else None


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
            limit_to(axes, values, least=1.0)
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
    """Draw a row a line and a column a trace; lend the panels and the lines, to set limits."""
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


def _array(values: Any) -> Floats:
    """Return nested lists of a table as an array."""
    return np.array([np.asarray(value, dtype=np.float64) for value in values])


def by_scenario(scores: Frame, scenarios: Sequence[Scenario]) -> dict[str, Frame]:
    """Return the rows of each scenario that has some, by its title."""
    parts = {scenario.title: scores[scores["scenario"] == scenario.name] for scenario in scenarios}
    return {title: part for title, part in parts.items() if len(part)}


def _draw_rows(path: Path, rows: Mapping[str, Frame], panels: Sequence[Panel]) -> Path:
    """Draw a row a title, with the methods beside each other around it, a panel each."""
    methods = in_order(name for runs in rows.values() for name in runs["method"])
    with figure_at(path, 5.0 + 2.0 * len(panels) + (len(panels) == 1), 1.6 + 0.42 * len(rows)) as figure:
        drawn = grid_of(figure, 1, len(panels), sharey=True)[0]
        for axes, (label, line, draw) in zip(drawn, panels, strict=True):
            for i, part in enumerate(rows.values()):
                for name, runs in by_way(part).items():
                    draw(axes, runs, i + 0.7 * ((methods.index(name) + 0.5) / len(methods) - 0.5), name)
            if line is not None:
                axes.axvline(line, color="black", linestyle="--", linewidth=0.8)
            logarithmic(axes, label)
        drawn[0].set_yticks(range(len(rows)), list(rows))
        drawn[0].set_ylim(len(rows) - 0.4, -0.6)
        for look in map(look_of, methods):
            drawn[0].plot([], [], look.marker, color=look.colour, label=look.label)
        legend_below(figure, drawn[0])
    return path
