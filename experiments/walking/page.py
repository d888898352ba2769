"""The page about one calibrated log: what came of it, how far to trust it, and what the log cannot tell."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import surefoot
from surefoot.calibration import Estimate, Parameters
from surefoot.experiments.logs.format import Log
from surefoot.experiments.study.page import ReportFigure, Section, write_page
from surefoot.experiments.study.tables import Table
from surefoot.experiments.walking.figures import (
    cells_over_time,
    cop_against_motion,
    flags_over_time,
    force_of_feet,
    parameters_over_time,
)
from surefoot.experiments.walking.tables import (
    Facts,
    agreement_table,
    flag_table,
    parameter_table,
    score_table,
)

__all__ = ["WalkingPage"]


@dataclass(frozen=True, eq=False)
class WalkingPage:
    """A calibrated log, to be shown.

    Attributes:
        log: The log.
        file: Its name.
        method: The method.
        start: Name of the map that it started from.
        began: That map.
        estimate: What came of every sample.
        settle: Samples before this time in s do not count in errors.
        notices: What the log cannot tell.
    """

    log: Log
    file: str
    method: str
    start: str
    began: Parameters
    estimate: Estimate
    settle: float
    notices: tuple[str, ...]

    def facts(self) -> Facts:
        """Gather what tables and figures are made of."""
        return Facts(self.log, self.start, self.began, self.estimate, self.settle)

    def write(self, path: Path) -> Path:
        """Write the page, with its figures inside.

        Args:
            path: Where.

        Returns:
            The path.
        """
        with tempfile.TemporaryDirectory() as folder:
            sections = self._sections(Path(folder))
            made = f"Made with surefoot {surefoot.__version__} by the method {self.method!r}."
            return write_page(path, f"{self.file}, calibrated", (_INTRODUCTION,), sections, made=made)

    def _sections(self, folder: Path) -> tuple[Section, ...]:
        facts, log = self.facts(), self.log
        sections = [
            Section(
                "log",
                "The log",
                findings=self.notices,
                tables=(self._log_table(),),
                paragraphs=() if self.notices else ("Nothing in the log calls for a warning.",),
            ),
            Section(
                "agreement",
                "Agreement with the robot's own motion",
                paragraphs=(_AGREEMENT,),
                tables=(agreement_table(facts),),
                figures=(
                    ReportFigure(
                        cop_against_motion(folder / "cop.png", facts, self.method),
                        "Figure 1",
                        "Centre of pressure of all feet from the middle between the soles, and its distance "
                        "from the one that the motion asks for.",
                    ),
                ),
            ),
        ]
        if log.truth is not None:
            sections.append(Section("truth", "Errors against the truth", tables=(score_table(facts),)))
        flags = flags_over_time(folder / "flags.png", facts)
        sections += [
            Section(
                "forces",
                "Forces",
                figures=(
                    ReportFigure(
                        force_of_feet(folder / "feet.png", facts, self.method),
                        "Figure 2",
                        "Vertical force of all feet and of each.",
                    ),
                    ReportFigure(
                        cells_over_time(folder / "cells.png", facts, self.method),
                        "Figure 3",
                        "Every channel by the map that the calibration started from, and calibrated.",
                    ),
                ),
            ),
            Section(
                "parameters",
                "Parameters",
                tables=(parameter_table(log, self.estimate, self.began, self.start),),
                figures=(
                    ReportFigure(
                        parameters_over_time(folder / "parameters.png", facts),
                        "Figure 4",
                        "Gain and zero of every channel against the map that the calibration started from"
                        + (
                            "; the method claims no uncertainty."
                            if self.estimate.covariance is None
                            else ", with bands of ± one standard deviation."
                        ),
                    ),
                ),
            ),
            Section(
                "flags",
                "Flags",
                tables=(flag_table(log, np.asarray(self.estimate.flags)),),
                figures=()
                if flags is None
                else (ReportFigure(flags, "Figure 5", "When each flag was raised."),),
            ),
        ]
        return tuple(sections)

    def _log_table(self) -> Table:
        log = self.log
        rows = [
            ("samples", str(len(log))),
            ("duration", f"{log.time[-1] - log.time[0]:.2f} s at {1 / log.dt:.4g} Hz"),
            ("mass", f"{log.mass:.4g} kg"),
            ("channels", str(log.layout.channels)),
            ("motion is late by", f"{log.lag} samples"),
            ("contacts", str(log.about.get("contacts", "as the log says"))),
            ("surely in the air", _shares(log, np.asarray(log.reference.swing))),
            ("surely on the ground", _shares(log, np.asarray(log.reference.stance))),
            ("started from", f"the {self.start} map"),
            ("errors count from", f"{self.settle:g} s on"),
        ]
        if "model" in log.about:
            rows.insert(5, ("model", f"{log.about['model']}, {log.about['model_mass_kg']:.4g} kg"))
        return Table("log", "What was calibrated", ("what", "given"), tuple(rows))


def _shares(log: Log, phase: NDArray[np.bool_]) -> str:
    return ", ".join(
        f"{foot.name} {100 * share:.0f} %"
        for foot, share in zip(log.layout.feet, phase.mean(axis=0), strict=True)
    )


_INTRODUCTION = (
    "Raw readings and what the robot knows of its own motion went in; calibrated forces, centres of pressure "
    "and parameters came out, sample by sample, as the robot would have had them while it walked."
)
_AGREEMENT = (
    "Mass, joints and IMU say what the ground must exert. A calibration brings the feet nearer to that; what "
    "is left are the errors of both. If the robot's mass or centre of mass is wrong, the feet agree with a "
    "motion that is wrong: weigh the robot, and mind the model."
)
