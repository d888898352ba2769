"""The page of a checked log: what one sends to a colleague."""

from collections.abc import Iterator
from pathlib import Path

from surefoot.experiments.instrument import figures
from surefoot.experiments.instrument.check import Checked, channel_table, log_table, wrong_table
from surefoot.experiments.study.page import ReportFigure, Section, Words, write_log_page

_say = Words("instrument")


def write_check_page(path: Path, checked: Checked) -> Path:
    """Write the page of a checked log, with its figures inside, and return its path."""
    verdict = "Nothing that a calibration would refuse was found." if checked.sound else "Something is wrong."
    return write_log_page(
        path,
        f"{checked.recording.file}, checked",
        "by 'surefoot check'",
        verdict,
        log_table(checked),
        checked.recording.notices,
        lambda folder: _sections(folder, checked),
    )


def _sections(folder: Path, checked: Checked) -> Iterator[Section]:
    yield Section("wrong", "What is wrong", tables=(wrong_table(checked),))
    overview = ReportFigure(
        figures.draw_channels(folder / "channels.png", checked), "Figure 1", _say("overview")
    )
    curves = figures.draw_allan(folder / "allan.svg", checked)
    shown = () if curves is None else (ReportFigure(curves, "Figure 2", _say("channels")),)
    yield Section("channels", "Channels", tables=(channel_table(checked),), figures=(overview, *shown))
