"""Figures of one calibrated log: forces, centre of pressure, parameters with their bands, and flags."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from surefoot.calibration import Flag, sole_wrenches
from surefoot.experiments.logs.agreement import Ground, asked_of, carried_by
from surefoot.experiments.study.figures import Look, figure_at, grid_of, legend_below, look_of
from surefoot.experiments.walking.tables import Facts

__all__ = [
    "cells_over_time",
    "cop_against_motion",
    "flags_over_time",
    "force_of_feet",
    "parameters_over_time",
]

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#999933")


def force_of_feet(path: Path, facts: Facts, method: str) -> Path:
    """Draw the vertical force of both feet and of each, by the starting map and calibrated.

    Args:
        path: Where to save the figure.
        facts: The calibrated log.
        method: The method's name.
    """
    log, asked = facts.log, asked_of(facts.log)
    before = sole_wrenches(facts.before, log.layout)[..., 2]
    after = sole_wrenches(facts.estimate.force, log.layout)[..., 2]
    with figure_at(path, 10.0, 2.0 + 1.7 * (1 + len(log.layout.feet))) as figure:
        panels = grid_of(figure, 1 + len(log.layout.feet), 1, sharex=True)[:, 0]
        for axes, name, raw, found in (
            (panels[0], "all feet", before.sum(axis=-1), after.sum(axis=-1)),
            *(
                (panels[1 + i], f"{foot.name} foot", before[:, i], after[:, i])
                for i, foot in enumerate(log.layout.feet)
            ),
        ):
            _line(axes, log.time, raw, _before(facts))
            _line(axes, log.time, found, look_of(method))
            axes.set_ylabel(f"{name}, Fz (N)")
        _line(panels[0], asked.time, asked.vgrf, _asked())
        if log.truth is not None:
            true = sole_wrenches(log.truth.force, log.layout)[..., 2]
            _line(panels[0], log.time, true.sum(axis=-1), look_of("truth"))
            for axes, part in zip(panels[1:], true.T, strict=True):
                _line(axes, log.time, part, look_of("truth"))
        panels[-1].set_xlabel("time (s)")
        legend_below(figure, panels[0])
    return path


def cells_over_time(path: Path, facts: Facts, method: str) -> Path:
    """Draw every channel by the starting map and calibrated.

    Args:
        path: Where to save the figure.
        facts: The calibrated log.
        method: The method's name.
    """
    log = facts.log
    before = facts.before
    rows = max(foot.channels for foot in log.layout.feet)
    with figure_at(path, 10.0, 1.0 + 1.4 * rows) as figure:
        panels = grid_of(figure, rows, len(log.layout.feet), sharex=True)
        for column, foot, where in zip(panels.T, log.layout.feet, log.layout.slices, strict=True):
            for axes, name, i in zip(
                column, foot.channel_names, range(where.start, where.stop), strict=False
            ):
                _line(axes, log.time, before[:, i], _before(facts))
                _line(axes, log.time, facts.estimate.force[:, i], look_of(method))
                if log.truth is not None:
                    _line(axes, log.time, log.truth.force[:, i], look_of("truth"))
                axes.set_title(f"{foot.name}, {name}")
            column[-1].set_xlabel("time (s)")
            for axes in column[foot.channels :]:
                axes.set_axis_off()
        figure.supylabel("force (N; N m for torques)", fontsize=9.5)
        legend_below(figure, panels[0, 0])
    return path


def cop_against_motion(path: Path, facts: Facts, method: str) -> Path:
    """Draw the centre of pressure against the one that the motion asks for.

    Args:
        path: Where to save the figure.
        facts: The calibrated log.
        method: The method's name.
    """
    log, asked = facts.log, asked_of(facts.log)
    sides = (
        (carried_by(log, facts.before), _before(facts)),
        (carried_by(log, facts.estimate.force), look_of(method)),
    )
    with figure_at(path, 10.0, 6.6) as figure:
        panels = grid_of(figure, 3, 1, sharex=True)[:, 0]
        for axes, axis, name in ((panels[0], 0, "forward"), (panels[1], 1, "left")):
            for ground, look in (*sides, (asked, _asked())):
                _line(axes, ground.time, 1e3 * ground.cop[:, axis], look)
            axes.set_ylabel(f"CoP {'xy'[axis]}, {name} (mm)")
            _limit(axes, asked, axis)
        for ground, look in sides:
            _line(panels[2], ground.time, 1e3 * np.linalg.norm(ground.cop - asked.cop, axis=1), look)
        panels[2].set_ylabel("distance (mm)")
        panels[2].set_ylim(0.0, None)
        panels[2].set_xlabel("time (s)")
        legend_below(figure, panels[0])
    return path


def parameters_over_time(path: Path, facts: Facts) -> Path:
    """Draw gains and zeros against the starting map, with bands of one standard deviation where claimed.

    Args:
        path: Where to save the figure.
        facts: The calibrated log.
    """
    log, estimate = facts.log, facts.estimate
    ratio = estimate.scale / facts.began.scale
    shift = estimate.offset - ratio * facts.began.offset
    std = None
    if estimate.covariance is not None:
        std = np.sqrt(np.maximum(np.diagonal(np.asarray(estimate.covariance), axis1=1, axis2=2), 0.0))
    K = log.layout.channels
    with figure_at(path, 10.0, 6.2) as figure:
        panels = grid_of(figure, 2, len(log.layout.feet), sharex=True, sharey="row")
        for column, foot, where in zip(panels.T, log.layout.feet, log.layout.slices, strict=True):
            for i, name in zip(range(where.start, where.stop), foot.channel_names, strict=True):
                look = Look(name, _COLOURS[(i - where.start) % len(_COLOURS)], "-", "o")
                for axes, values, index in ((column[0], 100 * (ratio - 1), i), (column[1], shift, K + i)):
                    _line(axes, log.time, values[:, i], look)
                    if std is not None:
                        half = std[:, index] * (100 if index == i else 1)
                        axes.fill_between(
                            log.time,
                            values[:, i] - half,
                            values[:, i] + half,
                            color=look.colour,
                            alpha=0.18,
                            linewidth=0,
                        )
            column[0].set_title(f"{foot.name} foot")
            column[1].set_xlabel("time (s)")
        panels[0, 0].set_ylabel("gain, against the start (%)")
        panels[1, 0].set_ylabel("zero, against the start (N)")
        legend_below(figure, panels[0, 0])
    return path


def flags_over_time(path: Path, facts: Facts) -> Path | None:
    """Draw when which flag was raised on which channel.

    Args:
        path: Where to save the figure.
        facts: The calibrated log.

    Returns:
        The path, or ``None`` if there is nothing to draw.
    """
    log, flags = facts.log, np.asarray(facts.estimate.flags)
    lines: list[tuple[str, NDArray[np.bool_]]] = []
    for flag in Flag:
        raised = (flags & flag.value) != 0
        if not raised.any():
            continue
        label = str(flag.name).lower().replace("_", " ")
        if (raised == raised[:, :1]).all():
            lines.append((label, raised[:, 0]))
        else:
            names = log.layout.channel_names
            lines += [(f"{label}: {names[i]}", raised[:, i]) for i in np.flatnonzero(raised.any(axis=0))]
    if not lines:
        return None
    with figure_at(path, 10.0, 0.9 + 0.28 * len(lines)) as figure:
        axes = grid_of(figure, 1, 1)[0, 0]
        for row, (_, raised) in enumerate(lines):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], raised.astype(int), [0]])))
            first, last = edges[::2], edges[1::2] - 1
            starts = log.time[first]
            axes.broken_barh(
                list(zip(starts, log.time[last] - starts + log.dt, strict=True)),
                (row - 0.35, 0.7),
                color=_COLOURS[row % len(_COLOURS)],
            )
        axes.set_yticks(range(len(lines)), [label for label, _ in lines])
        axes.set_xlim(log.time[0], log.time[-1])
        axes.invert_yaxis()
        axes.set_xlabel("time (s)")
    return path


def _before(facts: Facts) -> Look:
    return look_of("none")._replace(label=f"by the {facts.start} map")


def _asked() -> Look:
    return look_of("reference")._replace(label="what the motion asks for", line="-")


def _line(axes: Axes, time: NDArray[np.float64], values: NDArray[np.float64], look: Look) -> None:
    axes.plot(time, values, color=look.colour, linestyle=look.line, linewidth=1.0, label=look.label)


def _limit(axes: Axes, asked: Ground, axis: int) -> None:
    """Keep a reading that runs away from flattening all else."""
    values = 1e3 * asked.cop[:, axis]
    if not np.isfinite(values).any():
        return
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = 0.6 * max(high - low, 20.0)
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low - margin), min(top, high + margin))
