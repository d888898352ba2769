"""The pages of a checked log, which one sends to a colleague, and of an instrument's twin."""

from collections.abc import Iterator
from pathlib import Path

from surefoot.experiments.instrument import figures
from surefoot.experiments.instrument.check import Checked, channel_table, facts_table, wrong_table
from surefoot.experiments.instrument.twin import Twin, likeness_table, parameter_table
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
        facts_table(checked.recording),
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


def write_twin_page(path: Path, twin: Twin) -> Path:
    """Write the page of an instrument, and return its path."""
    alike = "No test tells the two apart." if twin.alike else "Tests tell the two apart: see below."
    return write_log_page(
        path,
        f"{twin.recording.file}, its instrument",
        "by 'surefoot twin'",
        f"{_say('twin')} {alike}",
        facts_table(twin.recording),
        (*twin.recording.notices, *twin.notes),
        lambda _: (
            Section("instrument", "The instrument", (_say("parameters"),), tables=(parameter_table(twin),)),
            Section("likeness", "Twin against log", tables=(likeness_table(twin),)),
        ),
    )
