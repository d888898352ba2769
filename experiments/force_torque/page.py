"""The page about one in-situ calibration: what came of it, and how far to trust it."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import surefoot
from surefoot.experiments.force_torque.figures import force_ellipsoids, raw_ellipsoids, residuals_over_time
from surefoot.experiments.force_torque.tables import (
    Calibrated,
    limb_table,
    matrix_table,
    offset_table,
    semi_axes_table,
    set_table,
    weighing_tables,
)
from surefoot.experiments.study.page import ReportFigure, Section, write_page
from surefoot.experiments.study.tables import Table

__all__ = ["InSituPage"]


@dataclass(frozen=True, eq=False)
class InSituPage:
    """An in-situ calibration, to be shown.

    Attributes:
        found: The calibrated log.
    """

    found: Calibrated

    def shown_tables(self) -> tuple[Table, ...]:
        """List what a terminal shows at once."""
        return (
            set_table(self.found),
            limb_table(self.found),
            semi_axes_table(self.found),
            *weighing_tables(self.found),
        )

    def write(self, path: Path) -> Path:
        """Write the page, with its figures inside.

        Args:
            path: Where.

        Returns:
            The path.
        """
        sensor = self.found.log.config.sensor or "Six-axis sensor"
        with tempfile.TemporaryDirectory() as folder:
            made = f"Made with surefoot {surefoot.__version__} from {', '.join(self.found.log.files)}."
            return write_page(
                path,
                f"{sensor}, calibrated in situ",
                (_INTRODUCTION,),
                self._sections(Path(folder)),
                made=made,
            )

    def _sections(self, folder: Path) -> tuple[Section, ...]:
        found = self.found
        said = (*found.fit.warnings, *found.log.notices)
        log = Section(
            "log",
            "The log",
            findings=said,
            tables=(set_table(found),),
            paragraphs=() if said else ("Nothing in the log calls for a warning.",),
        )
        calibration = Section(
            "calibration",
            "The calibration",
            paragraphs=(_CALIBRATION,),
            tables=(matrix_table(found), offset_table(found)),
        )
        weight = Section("weight", "Weight of the limb", paragraphs=(_WEIGHT,), tables=(limb_table(found),))
        forces = force_ellipsoids(folder / "forces.png", found)
        spheres = Section(
            "spheres",
            "Spheres",
            paragraphs=(_SPHERES,),
            tables=(semi_axes_table(found),),
            figures=(
                ReportFigure(
                    forces,
                    "Figure 1",
                    "Force of each set in N while the limb turned, with its fitted ellipsoid: "
                    + ("calibrated." if found.factory is None else "calibrated, and by the factory matrix."),
                ),
            ),
        )
        raw = Section(
            "raw",
            "Raw readings",
            paragraphs=(_RAW,),
            figures=(
                ReportFigure(
                    raw_ellipsoids(folder / "raw.png", found),
                    "Figure 2",
                    "Counts of each set along their three main directions with the ellipsoid that gravity "
                    "draws, and the share of their spread that lies outside these three.",
                ),
            ),
        )
        left = Section(
            "residuals",
            "Residuals",
            paragraphs=(_RESIDUALS,),
            figures=(
                ReportFigure(
                    residuals_over_time(folder / "residuals.png", found),
                    "Figure 3",
                    "What the fit leaves of every channel, with one offset a set.",
                ),
            ),
        )
        weighed = weighing_tables(found)
        masses = (
            (Section("masses", "Added masses", paragraphs=(_MASSES,), tables=weighed),) if weighed else ()
        )
        return (log, weight, spheres, *masses, calibration, raw, left)


_INTRODUCTION = (
    "A limb hung on the sensor and was turned about with different known masses on it. Gravity says what the "
    "sensor should have read; matrix and offset are those that agree with it best."
)
_CALIBRATION = (
    "Wrench = matrix (raw - offset), exerted by the limb on the robot through the sensor, in the sensor's "
    "frame. Standard deviations are the fit's own claim; they know nothing of masses or places that were "
    "given wrongly."
)
_WEIGHT = (
    "All forces scale with the added masses. The limb's own mass is an outcome of the fit, so that a pair of "
    "scales can check the absolute scale: forces that look like perfect spheres may be wrong by a common "
    "factor."
)
_SPHERES = (
    "A limb of constant weight draws a sphere of force as it turns. A matrix that is off draws an ellipsoid "
    "(in-situ paper, Table I and Fig. 6)."
)
_RAW = (
    "Readings of a rigid limb at rest lie on an ellipsoid in a three-dimensional part of the channels' space "
    "(in-situ paper, Lemma 1 and Fig. 5). What lies outside is noise, hysteresis, motion or a limb that "
    "bends."
)
_RESIDUALS = (
    "Noise has no shape. A slope is drift, a loop is hysteresis, a step is a contact or something that came "
    "loose."
)
_MASSES = (
    "With the limb taken off, what is left weighs and locates the added masses (in-situ paper, Tables II "
    "and III)."
)
