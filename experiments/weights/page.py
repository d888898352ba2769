"""The page of weighings: readings of each cell over its loads, its line or curve, and the residuals."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.experiments.study.figures import figure_at, grid_of, legend_below, name_axes
from surefoot.experiments.study.page import ReportFigure, Section, write_log_page
from surefoot.experiments.study.tables import Table, decimal
from surefoot.experiments.weights.calibrate import CalibratedCells

UP, DOWN, OUT, LINE = "#0072B2", "#D55E00", "#CC79A7", "#000000"
POINTS = 200  # of a drawn curve

CAPTION = (
    "Left: readings under known weights, with rising and falling load, and the line or curve of the cell. "
    "Right: residuals, the calibrated force minus the weight. Readings that were left out have no residual. "
    "Readings outside the panel are drawn at its edge."
)


def write_weights_page(path: Path, found: CalibratedCells) -> Path:
    """Write the page of calibrated cells, with its figure inside, and return its path."""
    load = found.weighings.load[np.isfinite(found.weighings.load)]
    rows = (
        ("file", found.file),
        ("cells", decimal(len(found.names), "d")),
        ("weighings", decimal(int(np.isfinite(found.weighings.code).sum()), "d")),
        ("weights", f"{load.min():.4g} to {load.max():.4g} N, {len(np.unique(load))} different ones"),
    )
    return write_log_page(
        path,
        f"{found.file}, calibrated by known weights",
        "by 'surefoot calibrate weights'",
        "Each cell carried known weights alone. Its force is scale times count plus offset, after a curve if "
        "a line does not fit.",
        Table("log", "The log", ("what", ""), rows),
        found.notices,
        lambda folder: _sections(folder, found),
    )


def _sections(folder: Path, found: CalibratedCells) -> Iterator[Section]:
    figure = ReportFigure(draw_cells(folder / "cells.svg", found), "Figure 1", CAPTION)
    yield Section("cells", "The cells", tables=(found.table,), figures=(figure,))


def draw_cells(path: Path, found: CalibratedCells) -> Path:
    """Draw readings and residuals of each cell against its loads."""
    with figure_at(path, 10.0, 1.0 + 2.1 * len(found.names)) as figure:
        grid = grid_of(figure, len(found.names), 2, sharex="col")
        for i, ((left, right), name) in enumerate(zip(grid, found.names, strict=True)):
            _draw_cell(left, right, found, i)
            left.set_title(name, loc="left")
        name_axes(grid, "weight (N)", *["reading (count)"] * len(found.names))
        for axes in grid[:, 1]:
            axes.set_ylabel("residual (N)")
        legend_below(figure, grid.ravel())
    return path


def _draw_cell(left: Axes, right: Axes, found: CalibratedCells, i: int) -> None:
    load, code, kept = found.weighings.load, found.weighings.code[:, i], found.kept[:, i]
    read = np.isfinite(kept + load)
    down = falls(load[read])
    forced = found.map.force(found.curves.straighten(found.kept))[:, i]
    for way, label, colour, marker in ((~down, "going up", UP, "^"), (down, "going down", DOWN, "v")):
        if way.any():
            rows = np.flatnonzero(read)[way]
            style: Any = {
                "color": colour,
                "marker": marker,
                "linestyle": "",
                "markersize": 4.0,
                "label": label,
            }
            left.plot(load[rows], code[rows], **style)
            right.plot(load[rows], forced[rows] - load[rows], **style)
    lost = np.isfinite(code + load) & ~read
    if lost.any():
        edges = left.get_ylim()
        left.plot(load[lost], np.clip(code[lost], *edges), "x", color=OUT, label="left out", clip_on=False)
        left.set_ylim(*edges)
    counts = np.linspace(np.nanmin(kept), np.nanmax(kept), POINTS)
    whole = np.tile(counts[:, None], (1, len(found.names)))
    force = found.map.force(found.curves.straighten(whole))[:, i]
    left.plot(force, counts, color=LINE, linewidth=0.9, label="line or curve")
    right.axhline(0.0, color=LINE, linewidth=0.9)


def falls(load: Floats) -> NDArray[np.bool_]:
    """Return whether each load, in order, was reached from a larger one, shape (n,)."""
    turns = np.diff(load, prepend=load[0])
    last = np.maximum.accumulate(np.where(turns != 0.0, np.arange(len(load)), 0))
    return turns[last] < 0.0
