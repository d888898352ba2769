"""The page about one calibrated log: what came of it, how far to trust it, and what the log lacks."""

from collections.abc import Iterator
from pathlib import Path

from surefoot.experiments.study.page import ReportFigure, Section, Words, write_log_page
from surefoot.experiments.walking import figures, tables

_say, _caption = Words("walking"), Words("walking", "captions")


def write_walking_page(path: Path, facts: tables.Facts) -> Path:
    """Write the page of a calibrated log, with its figures inside, and return its path."""
    return write_log_page(
        path,
        f"{facts.file}, calibrated",
        f"by the method {facts.method!r}",
        "Raw readings and what the robot knows of its own motion went in; calibrated forces, centres of "
        "pressure and parameters came out, sample by sample, as the robot would have had them on its way.",
        tables.log_table(facts),
        facts.notices,
        lambda folder: _sections(folder, facts),
    )


def _sections(folder: Path, facts: tables.Facts) -> Iterator[Section]:
    def figure(number: int, path: Path, more: str = "") -> ReportFigure:
        return ReportFigure(path, f"Figure {number}", _caption(f"{number}") + more)

    if not facts.feet_alone:
        cop = figure(1, figures.cop_against_motion(folder / "cop.svg", facts))
        table, title = tables.agreement_table(facts), "Agreement with the robot's own motion"
        yield Section("agreement", title, (_say("agreement"),), tables=(table,), figures=(cop,))
    if facts.log.truth is not None:
        yield Section("truth", "Errors against the truth", tables=(tables.score_table(facts),))
    feet = figure(2, figures.force_of_feet(folder / "feet.svg", facts))
    cells = figure(3, figures.cells_over_time(folder / "cells.svg", facts))
    yield Section("forces", "Forces", figures=(feet, cells))
    known = facts.estimate.covariance is not None
    bands = ", with bands of ± one standard deviation." if known else "; the method claims no uncertainty."
    drawn = figure(4, figures.parameters_over_time(folder / "parameters.svg", facts), bands)
    yield Section("parameters", "Parameters", tables=(tables.parameter_table(facts),), figures=(drawn,))
    flags = figures.flags_over_time(folder / "flags.svg", facts)
    shown = () if flags is None else (figure(5, flags),)
    yield Section("flags", "Flags", tables=(tables.flag_table(facts),), figures=shown)
