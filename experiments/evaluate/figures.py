"""Figures of an evaluation; colours mean feeds, as in all of surefoot's figures."""

from pathlib import Path
from typing import Any

import numpy as np

from surefoot.experiments.evaluate.statistics import mean_over, severities_of
from surefoot.experiments.study.figures import (
    by_way,
    figure_at,
    grid_of,
    legend_below,
    look_of,
    name_axes,
    show_values,
)
from surefoot.experiments.study.page import ReportFigure
from surefoot.experiments.study.statistics import fall_share, survival
from surefoot.experiments.study.tables import Frame


def outcome_figures(folder: Path, rows: Frame) -> tuple[ReportFigure, ReportFigure]:
    """Draw returns and falls against severity, and survival over time."""
    returns = against_severity(folder / "returns.svg", rows)
    standing = survival_curves(folder / "survival.svg", rows)
    means = "Mean return with 95 % intervals (Student t), and share of falls (Wilson), over severity."
    shares = "Share of episodes that have not ended in a fall, over time (Kaplan and Meier) with 95 % bands."
    return ReportFigure(returns, "Return and falls", means), ReportFigure(standing, "Survival", shares)


def survival_curves(path: Path, rows: Frame) -> Path:
    """Draw shares on their feet over time with 95 % bands: severities across, policies down."""
    policies = list(dict.fromkeys(rows["policy"]))
    severities = severities_of(rows) or [0.0]
    with figure_at(path, max(9.2, 2.9 * len(severities)), 2.5 * len(policies) + 1.1) as figure:
        panels = grid_of(figure, len(policies), len(severities), sharex=True, sharey=True)
        for line, policy in zip(panels, policies, strict=True):
            for axes, severity in zip(line, severities, strict=True):
                part = rows[rows["policy"] == policy]
                part = part[(part["feed"] == "true") | (part["severity"] == severity)]
                for i, (feed, runs) in enumerate(by_way(part, "feed").items()):
                    curve, look = survival(runs["time"], runs["fell"]), look_of(feed)
                    # Curves that coincide are drawn side by side.
                    style: Any = {"where": "post", "linestyle": look.line, "label": look.label}
                    axes.step(curve.time, curve.share - 0.007 * i, color=look.colour, **style)
                    band = {"step": "post", "color": look.colour, "alpha": 0.12, "linewidth": 0}
                    axes.fill_between(curve.time, curve.low, curve.high, **band)
                axes.set_ylim(-0.03, 1.03)
                axes.set_title(f"{policy}, severity {severity:g}", parse_math=False)
        name_axes(panels, "time (s)", "share on its feet")
        legend_below(figure, panels.ravel())
    return path


def against_severity(path: Path, rows: Frame) -> Path:
    """Draw mean return and share of falls against severity with 95 % intervals; true feet across."""
    policies = list(dict.fromkeys(rows["policy"]))
    severities = severities_of(rows)
    with figure_at(path, 8.8, 2.7 * len(policies) + 0.9) as figure:
        panels = grid_of(figure, len(policies), 2, sharex=True, sharey="col")
        for line, policy in zip(panels, policies, strict=True):
            part = rows[rows["policy"] == policy]
            feeds = by_way(part, "feed")
            for i, (feed, runs) in enumerate(feeds.items()):
                beside = 0.012 * (i - 0.5 * len(feeds)) * part["severity"].max()
                _severities(line, runs, feed, beside)
            line[1].set_ylabel("share that fell")
            line[1].set_ylim(-0.03, 1.03)
            for axes in line:
                axes.set_title(policy, parse_math=False)
        name_axes(panels, "severity", "return")
        for axes in panels[-1] if severities else ():
            show_values(axes, severities)
        legend_below(figure, panels.ravel())
    return path


def _severities(line: Any, runs: Frame, feed: str, beside: float) -> None:
    """Draw one feed, a little to the side, so that intervals do not hide each other."""
    look = look_of(feed)
    style: dict[str, Any] = {"color": look.colour, "linestyle": look.line}
    severities = np.array(sorted(runs["severity"].unique()))
    by_severity = [runs[runs["severity"] == severity] for severity in severities]
    returns = [mean_over(part.set_index(["training", "seed"])["return"]) for part in by_severity]
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
    reach = [[share.share - share.low for share in shares], [share.high - share.share for share in shares]]
    line[1].errorbar(severities + beside, middle, yerr=np.maximum(reach, 0.0), **style)
