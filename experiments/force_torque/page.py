"""The page about one in-situ calibration: what came of it, and how far to trust it."""

from collections.abc import Iterator
from pathlib import Path

from surefoot.experiments.force_torque import figures, tables
from surefoot.experiments.logs.page import write_log_page
from surefoot.experiments.study.page import ReportFigure, Section


def write_in_situ_page(path: Path, found: tables.Calibrated) -> Path:
    """Write the page of a calibrated log, with its figures inside, and return its path."""
    log = found.log
    return write_log_page(
        path,
        f"{log.config.sensor.name or 'Six-axis sensor'}, calibrated in situ",
        f"from {', '.join(log.files)}",
        "A limb hung on the sensor and was turned about with different known masses on it. Gravity gives "
        "what the sensor should have read; matrix and offset are those that agree with it best.",
        tables.set_table(found),
        (*found.fit.warnings, *log.notices),
        lambda folder: _sections(folder, found),
    )


def _sections(folder: Path, found: tables.Calibrated) -> Iterator[Section]:
    yield Section(
        "weight",
        "Weight of the limb",
        (
            "All forces scale with the added masses. The limb's own mass is an outcome of the fit, so that a "
            "pair of scales can check the absolute scale: forces that look like perfect spheres may be wrong "
            "by a common factor.",
        ),
        tables=(tables.limb_table(found),),
    )
    yield Section(
        "spheres",
        "Spheres",
        (
            "A limb of constant weight draws a sphere of force as it turns. A matrix that is off draws an "
            "ellipsoid (in-situ paper, Table I and Fig. 6).",
        ),
        tables=(tables.semi_axes_table(found),),
        figures=(
            ReportFigure(
                figures.force_ellipsoids(folder / "forces.png", found),
                "Figure 1",
                "Force of each set in N while the limb turned, with its fitted ellipsoid: "
                + (
                    "calibrated, and by the factory matrix." if "factory" in found.matrices else "calibrated."
                ),
            ),
        ),
    )
    if weighed := tables.weighing_tables(found):
        text = (
            "With the limb taken off, what is left weighs and locates the added masses (in-situ paper, "
            "Tables II and III).",
        )
        yield Section("masses", "Added masses", text, tables=weighed)
    yield Section(
        "calibration",
        "The calibration",
        (
            "Wrench = matrix (raw - offset), exerted by the limb on the robot through the sensor, in the "
            "sensor's frame. Standard deviations are the fit's own; they know nothing of masses or places "
            "that were given wrongly.",
        ),
        tables=(tables.matrix_table(found), tables.offset_table(found)),
    )
    yield Section(
        "raw",
        "Raw readings",
        (
            "Readings of a rigid limb at rest lie on an ellipsoid in a three-dimensional part of the "
            "channels' space (in-situ paper, Lemma 1 and Fig. 5). What lies outside is noise, hysteresis, "
            "motion or a limb that bends.",
        ),
        figures=(
            ReportFigure(
                figures.raw_ellipsoids(folder / "raw.png", found),
                "Figure 2",
                "Counts of each set along their three main directions with the ellipsoid that gravity draws, "
                "and the share of their spread that lies outside these three.",
            ),
        ),
    )
    yield Section(
        "residuals",
        "Residuals",
        (
            "Noise has no shape. A slope is drift, a loop is hysteresis, a step is a contact or something "
            "that came loose.",
        ),
        figures=(
            ReportFigure(
                figures.residuals_over_time(folder / "residuals.svg", found),
                "Figure 3",
                "What the fit leaves of every channel, with one offset a set.",
            ),
        ),
    )
