"""The page of a checked log, with its figures, to be sent to a colleague."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from surefoot.experiments.instrument.check import Checked, channel_table, facts_table, words_of, wrong_table
from surefoot.experiments.study.figures import figure_at, grid_of, legend_below, logarithmic, name_axes
from surefoot.experiments.study.page import ReportFigure, Section, write_log_page


def write_check_page(path: Path, checked: Checked) -> Path:
    """Write the page of a checked log, with its figures inside, and return its path."""
    verdict = words_of(checked).splitlines()[-1] if checked.sound else "Something is wrong."
    return write_log_page(
        path,
        f"{checked.recording.file}, checked",
        "by 'surefoot check'",
        verdict,
        facts_table(checked.recording),
        checked.recording.notices,
        lambda folder: _sections(folder, checked),
        Section("wrong", "What is wrong", tables=(wrong_table(checked),)),
    )


def _sections(folder: Path, checked: Checked) -> Iterator[Section]:
    drawn = draw_channels(folder / "channels.png", checked)
    figures = [ReportFigure(drawn, "Figure 1", "Range of every channel over the whole log.")]
    curves = draw_allan(folder / "allan.svg", checked)
    if curves is not None:
        caption = (
            "Allan deviation of each channel at rest. White noise falls with the square root of time, a "
            "random walk rises with it. The lowest point is the error that a tare can reach."
        )
        figures.append(ReportFigure(curves, "Figure 2", caption))
    yield Section("channels", "Channels", tables=(channel_table(checked),), figures=tuple(figures))


POINTS = 600  # pieces of a log of which the least and the largest reading are drawn


def draw_channels(path: Path, checked: Checked) -> Path:
    """Draw the range of each channel in each of some hundred pieces of the log."""
    recording = checked.recording
    rows = np.array_split(np.arange(len(recording.raw)), min(POINTS, len(recording.raw)))
    time = recording.time if recording.has_times else np.arange(len(recording.raw), dtype=float)
    middle = np.array([time[part].mean() for part in rows])
    with figure_at(path, 10.0, 1.0 + 0.9 * len(recording.names)) as figure:
        grid = grid_of(figure, len(recording.names), 1, sharex=True)
        for axes, name, raw in zip(grid[:, 0], recording.names, recording.raw.T, strict=True):
            whole = [part[np.isfinite(raw[part])] for part in rows]
            ends = np.array([(raw[p].min(), raw[p].max()) if len(p) else (np.nan, np.nan) for p in whole])
            axes.fill_between(middle, *ends.T, linewidth=0.8, color="#0072B2")
            axes.set_title(name, loc="left", fontsize=8)
        name_axes(grid, "time (s)" if recording.has_times else "row", *[""] * len(recording.names))
    return path


def draw_allan(path: Path, checked: Checked) -> Path | None:
    """Draw Allan deviations; ``None`` where no channel rests."""
    curves = [one for one in checked.facts if len(one.curve.tau) > 1 and one.curve.deviation.any()]
    if not curves:
        return None
    with figure_at(path, 7.0, 4.2) as figure:
        axes = grid_of(figure, 1, 1)[0, 0]
        for one in curves:
            axes.plot(one.curve.tau, one.curve.deviation, marker=".", label=one.name)
        logarithmic(axes)
        logarithmic(axes, "averaged over (s)")
        axes.set_ylabel("Allan deviation (counts)")
        legend_below(figure, axes, columns=3)
    return path
