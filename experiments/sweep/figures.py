"""Figures of a sweep's report; colours mean feeds, as in all of surefoot's figures."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from surefoot.experiments.policy.controllers import drawn_names
from surefoot.experiments.study.figures import (
    figure_at,
    grid_of,
    in_order,
    legend_below,
    look_of,
    short_label,
)
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import Frame
from surefoot.experiments.sweep.statistics import fall_share, survival

__all__ = ["against_severity", "heat_maps", "survival_curves"]


def survival_curves(path: Path, rows: Frame) -> Path:
    """Draw shares on their feet over time with 95 % bands: a panel a severity (across) and controller (down).

    Args:
        path: Where to save the figure.
        rows: Of one scenario. True feet, which have no severity, are in every panel.
    """
    controllers = list(rows["controller"].unique())
    names = drawn_names(controllers)
    severities = sorted(rows[rows["feed"] != "true"]["severity"].unique()) or [0.0]
    with figure_at(path, max(9.2, 2.9 * len(severities)), 2.5 * len(controllers) + 1.1) as figure:
        panels = grid_of(figure, len(controllers), len(severities), sharex=True, sharey=True)
        for line, controller in zip(panels, controllers, strict=True):
            for axes, severity in zip(line, severities, strict=True):
                part = rows[rows["controller"] == controller]
                part = part[(part["feed"] == "true") | (part["severity"] == severity)]
                for feed in in_order(part["feed"]):
                    _survival(axes, part[part["feed"] == feed], feed)
                axes.set_ylim(-0.03, 1.03)
                axes.set_title(f"{names[controller]}, severity {severity:g}")
            line[0].set_ylabel("share on its feet")
        for axes in panels[-1]:
            axes.set_xlabel("time (s)")
        legend_below(figure, panels.ravel())
    return path


def against_severity(path: Path, rows: Frame) -> Path:
    """Draw mean return and share of falls against severity with 95 % intervals, a line a controller.

    Args:
        path: Where to save the figure.
        rows: Of one scenario. True feet, which have no severity, are drawn across.
    """
    controllers = list(rows["controller"].unique())
    names = drawn_names(controllers)
    with figure_at(path, 8.8, 2.7 * len(controllers) + 0.9) as figure:
        panels = grid_of(figure, len(controllers), 2, sharex=True, sharey="col")
        for line, controller in zip(panels, controllers, strict=True):
            part = rows[rows["controller"] == controller]
            feeds = in_order(part["feed"])
            for i, feed in enumerate(feeds):
                beside = 0.012 * (i - 0.5 * len(feeds)) * part["severity"].max()
                _severities(line, part[part["feed"] == feed], feed, beside)
            line[0].set_ylabel("return")
            line[1].set_ylabel("share that fell")
            line[1].set_ylim(-0.03, 1.03)
            for axes in line:
                axes.set_title(names[controller])
        for axes in panels[-1]:
            axes.set_xlabel("severity")
        legend_below(figure, panels.ravel())
    return path


def heat_maps(path: Path, rows: Frame, titles: dict[str, str]) -> Path:
    """Draw shares of falls, scenarios down and severities across, a map a controller and feed.

    Args:
        path: Where to save the figure.
        rows: Of all scenarios.
        titles: What to call each scenario, in order.
    """
    controllers, feeds = list(rows["controller"].unique()), in_order(rows["feed"])
    names = drawn_names(controllers)
    width, height = max(8.4, 2.1 * len(feeds) + 2.4), len(controllers) * (0.32 * len(titles) + 0.9) + 0.5
    with figure_at(path, width, height) as figure:
        panels = grid_of(figure, len(controllers), len(feeds), sharey=True)
        for line, controller in zip(panels, controllers, strict=True):
            for axes, feed in zip(line, feeds, strict=True):
                part = rows[(rows["controller"] == controller) & (rows["feed"] == feed)]
                _heat(axes, part, titles)
                axes.set_title(f"{names[controller]}: {short_label(feed)}")
        for axes in panels[-1]:
            axes.set_xlabel("severity")
        image = panels[0, 0].images[0]
        figure.colorbar(image, ax=panels, label="share that fell", shrink=0.8)
    return path


def _survival(axes: Axes, runs: Frame, feed: str) -> None:
    curve, look = survival(runs["time"], runs["fell"]), look_of(feed)
    axes.step(curve.time, curve.share, where="post", color=look.colour, linestyle=look.line, label=look.label)
    axes.fill_between(
        curve.time, curve.low, curve.high, step="post", color=look.colour, alpha=0.12, linewidth=0
    )


def _severities(line: Any, runs: Frame, feed: str, beside: float) -> None:
    """Draw one feed, a little to the side, so that intervals do not hide each other."""
    look = look_of(feed)
    style: dict[str, Any] = {"color": look.colour, "linestyle": look.line}
    severities = np.array(sorted(runs["severity"].unique()))
    by_severity = [runs[runs["severity"] == severity] for severity in severities]
    returns = [mean_interval(part["return"]) for part in by_severity]
    shares = [fall_share(part["fell"]) for part in by_severity]
    if feed == "true":
        line[0].axhline(returns[0].mean, label=look.label, **style)
        half = np.nan_to_num(returns[0].half)
        line[0].axhspan(returns[0].mean - half, returns[0].mean + half, color=look.colour, alpha=0.08, lw=0)
        line[1].axhline(shares[0].share, **style)
        return
    means = np.array([interval.mean for interval in returns])
    halves = np.nan_to_num([interval.half for interval in returns])
    style |= {"marker": look.marker, "markersize": 4.5, "capsize": 2, "linewidth": 1.2}
    line[0].errorbar(severities + beside, means, yerr=halves, label=look.label, **style)
    middle = np.array([share.share for share in shares])
    reach = [
        [share.share - share.low for share in shares],
        [share.high - share.share for share in shares],
    ]
    line[1].errorbar(severities + beside, middle, yerr=np.maximum(reach, 0.0), **style)


def _heat(axes: Axes, rows: Frame, titles: dict[str, str]) -> None:
    severities = sorted(rows["severity"].unique()) or [0.0]
    share = np.full((len(titles), len(severities)), np.nan)
    for i, scenario in enumerate(titles):
        for j, severity in enumerate(severities):
            found = rows[(rows["scenario"] == scenario) & (rows["severity"] == severity)]
            share[i, j] = fall_share(found["fell"]).share
    axes.imshow(share, vmin=0.0, vmax=1.0, cmap="magma_r", aspect="auto")
    for (i, j), value in np.ndenumerate(share):
        if np.isfinite(value):
            colour = "white" if value > 0.55 else "black"
            axes.text(j, i, f"{100 * value:.0f} %", ha="center", va="center", color=colour, fontsize=8)
    axes.set_xticks(range(len(severities)), [f"{severity:g}" for severity in severities])
    axes.set_yticks(range(len(titles)), list(titles.values()))
    axes.grid(visible=False)
