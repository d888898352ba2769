"""The page about one calibrated log: how far to trust it, its missing data, and its figures."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration import Flag
from surefoot.calibration.cop import sole_wrenches
from surefoot.experiments.study.figures import (
    Look,
    figure_at,
    grid_of,
    legend_below,
    limit_to,
    look_of,
    name_axes,
)
from surefoot.experiments.study.page import ReportFigure, Section, write_log_page
from surefoot.experiments.walking import tables
from surefoot.experiments.walking.agreement import ground_of_forces, ground_of_motion
from surefoot.experiments.walking.tables import Facts

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#999933")
_ASKED = look_of("reference")._replace(label="required by the motion", line="-")

_LONG = 2000  # points from which a line is an image within the SVG, which would grow with it
_COLUMNS = 2000  # columns of a figure in which a line is drawn from its least to its greatest value


def force_of_feet(path: Path, facts: Facts) -> Path:
    """Draw the vertical force of both feet and of each, by the starting map and calibrated."""
    log, asked = facts.log, ground_of_motion(facts.log)
    feet = [foot.name for foot in log.layout.feet]
    with figure_at(path, 10.0, 2.0 + 1.7 * (1 + len(feet))) as figure:
        grid = grid_of(figure, 1 + len(feet), 1, sharex=True)
        panels = grid[:, 0]
        if not facts.feet_alone:
            _line(panels[0], asked.time, asked.vgrf, _ASKED)
        for force, look in _sides(facts):
            vertical = sole_wrenches(force, log.layout)[..., 2]
            for axes, part in zip(panels, (vertical.sum(axis=-1), *vertical.T), strict=True):
                _line(axes, log.time, part, look)
        name_axes(grid, "time (s)", "all feet, Fz (N)", *(f"{name} foot, Fz (N)" for name in feet))
        legend_below(figure, panels[0])
    return path


def cells_over_time(path: Path, facts: Facts) -> Path:
    """Draw every channel by the starting map and calibrated."""
    log, sides = facts.log, _sides(facts)
    rows = max(foot.channels for foot in log.layout.feet)
    with figure_at(path, 10.0, 1.0 + 1.4 * rows) as figure:
        panels = grid_of(figure, rows, len(log.layout.feet), sharex=True)
        for column, foot, where in zip(panels.T, log.layout.feet, log.layout.slices, strict=True):
            channels = range(where.start, where.stop)
            for axes, name, i in zip(column, foot.channel_names, channels, strict=False):
                for force, look in sides:
                    _line(axes, log.time, force[:, i], look)
                axes.set_title(f"{foot.name}, {name}")
            column[-1].set_xlabel("time (s)")
            for axes in column[foot.channels :]:
                axes.set_axis_off()
        figure.supylabel("force (N; N m for torques)", fontsize=9.5)
        legend_below(figure, panels[0, 0])
    return path


def cop_against_motion(path: Path, facts: Facts) -> Path:
    """Draw the centre of pressure beside the one that the motion asks for, and their distance."""
    log, asked = facts.log, ground_of_motion(facts.log)
    sides = [(ground_of_forces(log, force), look) for force, look in _sides(facts)[:2]]
    with figure_at(path, 10.0, 6.6) as figure:
        panels = grid_of(figure, 3, 1, sharex=True)[:, 0]
        for axis, (axes, name) in enumerate(zip(panels, ("x, forward", "y, left"), strict=False)):
            for ground, look in (*sides, (asked, _ASKED)):
                _line(axes, ground.time, 1e3 * ground.cop[:, axis], look)
            axes.set_ylabel(f"CoP {name} (mm)")
            limit_to(axes, 1e3 * asked.cop[:, axis], least=20.0)
        for ground, look in sides:
            _line(panels[2], ground.time, 1e3 * np.linalg.norm(ground.cop - asked.cop, axis=1), look)
        panels[2].set_ylabel("distance (mm)")
        panels[2].set_ylim(0.0, None)
        panels[2].set_xlabel("time (s)")
        legend_below(figure, panels[0])
    return path


def parameters_over_time(path: Path, facts: Facts) -> Path:
    """Draw scales and offsets against the starting map, with bands of one standard deviation if known."""
    log, change = facts.log, facts.change()
    with figure_at(path, 10.0, 6.2) as figure:
        panels = grid_of(figure, 2, len(log.layout.feet), sharex=True, sharey="row")
        for column, foot, where in zip(panels.T, log.layout.feet, log.layout.slices, strict=True):
            for i, name in enumerate(foot.channel_names):
                look = Look(name, _COLOURS[i % len(_COLOURS)], "-", "o")
                for axes, values, std in zip(column, (change.scale, change.offset), change.std, strict=True):
                    line = values[:, where][:, i]
                    _line(axes, log.time, line, look)
                    if std is not None:
                        half = std[:, where][:, i]
                        band = {"color": look.colour, "alpha": 0.18, "linewidth": 0}
                        long = len(line) > _LONG
                        axes.fill_between(
                            *_extremes(log.time, line - half, line + half), rasterized=long, **band
                        )
            column[0].set_title(f"{foot.name} foot")
        name_axes(panels, "time (s)", "scale, against the start (%)", "offset, against the start (N)")
        legend_below(figure, panels[0, 0])
    return path


def flags_over_time(path: Path, facts: Facts) -> Path | None:
    """Draw when which flag was raised on which channel; return ``None`` if none was."""
    log, flags = facts.log, np.asarray(facts.estimate.flags)
    lines: list[tuple[str, NDArray[np.bool_]]] = []
    for flag in Flag:
        raised, label = (flags & flag.value) != 0, flag.label
        if raised.any() and (raised == raised[:, :1]).all():
            lines.append((label, raised[:, 0]))
            continue
        names = log.layout.channel_names
        lines += [(f"{label}: {names[i]}", raised[:, i]) for i in np.flatnonzero(raised.any(axis=0))]
    if not lines:
        return None
    with figure_at(path, 10.0, 0.9 + 0.28 * len(lines)) as figure:
        axes = grid_of(figure, 1, 1)[0, 0]
        for row, (_, raised) in enumerate(lines):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], raised.astype(int), [0]])))
            starts, ends = log.time[edges[::2]], log.time[edges[1::2] - 1]
            spans = list(zip(starts, ends - starts + log.dt, strict=True))
            axes.broken_barh(spans, (row - 0.35, 0.7), color=_COLOURS[row % len(_COLOURS)])
        axes.set_yticks(range(len(lines)), [label for label, _ in lines])
        axes.set_xlim(log.time[0], log.time[-1])
        axes.invert_yaxis()
        axes.set_xlabel("time (s)")
    return path


def _sides(facts: Facts) -> list[tuple[Floats, Look]]:
    """Return forces by the starting map, calibrated and, where the log has them, true."""
    before = look_of("none")._replace(label=f"by the {facts.start} map")
    sides = [(facts.before, before), (facts.estimate.force, look_of(facts.method))]
    return sides if facts.log.truth is None else [*sides, (facts.log.truth.force, look_of("truth"))]


def _line(axes: Axes, time: Floats, values: Floats, look: Look) -> None:
    style: Any = {"color": look.colour, "linestyle": look.line, "label": look.label}
    size = len(time) // _COLUMNS
    if size > 2:
        time, low, high = _extremes(time, values, values)
        time, values = np.repeat(time, 2), np.column_stack([low, high]).ravel()
    axes.plot(time, values, linewidth=1.0, rasterized=len(time) > _LONG, **style)


def _extremes(time: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the least and greatest values of a band in each column of a figure; short bands unchanged."""
    starts = np.arange(0, len(time), max(len(time) // _COLUMNS, 1))
    return time[starts], np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def write_walking_page(path: Path, facts: tables.Facts) -> Path:
    """Write the page of a calibrated log, with its figures inside, and return its path."""
    known = "contacts" if facts.feet_alone else "the robot's estimate of its motion"
    return write_log_page(
        path,
        f"{facts.file}, calibrated",
        f"by the method {facts.method!r}",
        f"The inputs are raw readings and {known}. The outputs are calibrated forces, centres of pressure "
        "and parameters, sample by sample, as an online calibration computes them.",
        tables.log_table(facts),
        facts.notices,
        lambda folder: _sections(folder, facts),
    )


def _sections(folder: Path, facts: tables.Facts) -> Iterator[Section]:
    if not facts.feet_alone:
        cop = ReportFigure(
            cop_against_motion(folder / "cop.svg", facts),
            "Figure 1",
            "Centre of pressure of all feet, relative to the middle between the soles, and its distance from "
            "the one that the motion requires.",
        )
        text = (
            "Mass, joints and IMU determine the forces of the ground. A calibration brings the feet nearer "
            "to them. The remaining differences are errors of both. If the robot's mass or centre of mass is "
            "wrong, the feet agree with a wrong motion: weigh the robot, and check the model."
        )
        table, title = tables.agreement_table(facts), "Agreement with the robot's own motion"
        yield Section("agreement", title, (text,), tables=(table,), figures=(cop,))
    if facts.log.truth is not None:
        yield Section("truth", "Errors against the truth", tables=(tables.score_table(facts),))
    feet = ReportFigure(
        force_of_feet(folder / "feet.svg", facts), "Figure 2", "Vertical force of all feet and of each foot."
    )
    cells = ReportFigure(
        cells_over_time(folder / "cells.svg", facts),
        "Figure 3",
        "Every channel by the starting map, and calibrated.",
    )
    yield Section("forces", "Forces", figures=(feet, cells))
    if facts.estimate.covariance is None:
        caption = (
            "Scale and offset of every channel, relative to the starting map. The method has no covariance."
        )
    else:
        caption = (
            "Scale and offset of every channel, relative to the starting map, with bands of ± one standard "
            "deviation."
        )
    drawn = ReportFigure(parameters_over_time(folder / "parameters.svg", facts), "Figure 4", caption)
    yield Section("parameters", "Parameters", tables=(tables.parameter_table(facts),), figures=(drawn,))
    flags = flags_over_time(folder / "flags.svg", facts)
    shown = (
        () if flags is None else (ReportFigure(flags, "Figure 5", "Times at which each flag was raised."),)
    )
    yield Section("flags", "Flags", tables=(tables.flag_table(facts),), figures=shown)
