"""The page about one calibrated log: what came of it, how far to trust it, and what the log lacks."""

from collections.abc import Iterator
from pathlib import Path

from surefoot.experiments.logs.page import write_log_page
from surefoot.experiments.study.page import ReportFigure, Section
from surefoot.experiments.walking import figures, tables


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
    yield Section(
        "agreement",
        "Agreement with the robot's own motion",
        (
            "Mass, joints and IMU give what the ground must exert. A calibration brings the feet nearer to "
            "that; what is left are the errors of both. If the robot's mass or centre of mass is wrong, the "
            "feet agree with a motion that is wrong: weigh the robot, and check the model.",
        ),
        tables=(tables.agreement_table(facts),),
        figures=(
            ReportFigure(
                figures.cop_against_motion(folder / "cop.svg", facts),
                "Figure 1",
                "Centre of pressure of all feet from the middle between the soles, and its distance from the "
                "one that the motion asks for.",
            ),
        ),
    )
    if facts.log.truth is not None:
        yield Section("truth", "Errors against the truth", tables=(tables.score_table(facts),))
    yield Section(
        "forces",
        "Forces",
        figures=(
            ReportFigure(
                figures.force_of_feet(folder / "feet.svg", facts),
                "Figure 2",
                "Vertical force of all feet and of each.",
            ),
            ReportFigure(
                figures.cells_over_time(folder / "cells.svg", facts),
                "Figure 3",
                "Every channel by the map that the calibration started from, and calibrated.",
            ),
        ),
    )
    drawn = figures.parameters_over_time(folder / "parameters.svg", facts)
    bands = (
        "; the method claims no uncertainty."
        if facts.estimate.covariance is None
        else ", with bands of ± one standard deviation."
    )
    text = f"Scale and offset of every channel against the map that the calibration started from{bands}"
    yield Section(
        "parameters",
        "Parameters",
        tables=(tables.parameter_table(facts),),
        figures=(ReportFigure(drawn, "Figure 4", text),),
    )
    flags = figures.flags_over_time(folder / "flags.svg", facts)
    shown = () if flags is None else (ReportFigure(flags, "Figure 5", "When each flag was raised."),)
    yield Section("flags", "Flags", tables=(tables.flag_table(facts),), figures=shown)
