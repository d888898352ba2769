"""Figures of an evaluation; returns and survival are drawn as a sweep draws them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from surefoot.experiments.policy.comparison import Difference
from surefoot.experiments.policy.controllers import drawn_names
from surefoot.experiments.study.figures import figure_at, grid_of, legend_below
from surefoot.experiments.study.tables import Frame
from surefoot.experiments.sweep import figures

__all__ = ["forest", "returns", "survival_curves"]

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Of severities; those of Okabe and Ito (2008)."""


def returns(path: Path, frame: Frame) -> Path:
    """Draw mean return and share of falls against severity, see the sweep's figure of the name."""
    return figures.against_severity(path, _as_sweep(frame))


def survival_curves(path: Path, frame: Frame) -> Path:
    """Draw shares on their feet over time, see the sweep's figure of the name."""
    return figures.survival_curves(path, _as_sweep(frame))


def forest(path: Path, found: Sequence[Difference]) -> Path:
    """Draw differences with their intervals, one under the other: a panel a controller.

    Args:
        path: Where to save the figure.
        found: The differences.
    """
    controllers = list(dict.fromkeys(one.controller for one in found))
    # True feet have no severity: NaN, which is not equal to itself.
    on_true = [one for one in found if one.severity != one.severity]
    severities = sorted({one.severity for one in found if one.severity == one.severity})
    series = [("true feet", "#000000", on_true)] * bool(on_true)
    series += [
        (f"severity {severity:g}", _COLOURS[i % 6], [one for one in found if one.severity == severity])
        for i, severity in enumerate(severities)
    ]
    rows = list(dict.fromkeys(one.what for one in found))
    names = drawn_names(controllers)
    columns = min(2, len(controllers))
    lines = -(-len(controllers) // columns)
    height = (0.16 + 0.2 * max(len(severities), 1)) * len(rows) + 1.2
    with figure_at(path, 4.6 * columns + 1.4, height * lines) as figure:
        panels = grid_of(figure, lines, columns, sharex=True, sharey=True)
        for axes in panels.ravel()[len(controllers) :]:
            axes.set_axis_off()
        for axes, controller in zip(panels.ravel(), controllers, strict=False):
            axes.axvline(0.0, color="#7f7f7f", linewidth=1.0)
            for i, (label, colour, all_of) in enumerate(series):
                shown = [one for one in all_of if one.controller == controller]
                place = [rows.index(one.what) + _beside(one, severities) for one in shown]
                axes.errorbar(
                    [one.interval.mean for one in shown],
                    place,
                    xerr=np.nan_to_num([one.interval.half for one in shown]),
                    color=colour,
                    linestyle="none",
                    marker="osD^vP"[i % 6],
                    markersize=5,
                    capsize=2.5,
                    label=label,
                )
            axes.set_yticks(range(len(rows)), rows)
            axes.set_ylim(len(rows) - 0.5, -0.5)
            axes.tick_params(labelbottom=True)
            axes.set_title(names[controller])
            axes.set_xlabel("difference of returns")
        if severities:
            legend_below(figure, panels.ravel())
    return path


def _beside(one: Difference, severities: Sequence[float]) -> float:
    """Say how far from the middle of its row a difference lies, so that severities do not hide each other."""
    if one.severity not in severities:
        return 0.0
    return 0.22 * (severities.index(one.severity) - 0.5 * (len(severities) - 1))


def _as_sweep(frame: Frame) -> Frame:
    """Rename what a sweep calls otherwise; what was given another centre of pressure is left out."""
    felt = frame[frame["cop_input"] == "felt"]
    return felt.assign(**{"return": felt["total"]})
