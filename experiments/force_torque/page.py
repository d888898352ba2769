"""The page about one in-situ calibration: its result, and how far to trust it."""

from collections.abc import Iterator
from pathlib import Path

from surefoot.experiments.force_torque import figures, tables
from surefoot.experiments.study.page import ReportFigure, Section, write_log_page


def write_in_situ_page(path: Path, found: tables.Calibrated) -> Path:
    """Write the page of a calibrated log, with its figures inside, and return its path."""
    log = found.log
    return write_log_page(
        path,
        f"{log.config.sensor.name or 'Six-axis sensor'}, calibrated in situ",
        f"from {', '.join(log.files)}",
        "A limb on the sensor was turned with different known masses on it. Gravity gives the wrench that "
        "the sensor should read. Matrix and offset are those that agree with it best.",
        tables.set_table(found),
        found.notices,
        lambda folder: _sections(folder, found),
    )


def _sections(folder: Path, found: tables.Calibrated) -> Iterator[Section]:
    text = (
        "All forces scale with the added masses. The mass of the limb is a result of the fit, so weighing "
        "the limb checks the absolute scale. Forces that form perfect spheres may still be wrong by a "
        "factor."
    )
    yield Section("weight", "Weight of the limb", (text,), tables=(tables.limb_table(found),))
    matrices = " and by ".join(f"the {name} matrix" for name in found.matrices)
    caption = f"Force of each set in N while the limb turned, with its fitted ellipsoid, by {matrices}."
    shown = (ReportFigure(figures.force_ellipsoids(folder / "forces.png", found), "Figure 1", caption),)
    text = (
        "The force of a limb of constant weight lies on a sphere while the limb turns. A wrong matrix makes "
        "it an ellipsoid (in-situ paper, Table I and Fig. 6)."
    )
    axes = (tables.semi_axes_table(found),)
    yield Section("spheres", "Spheres", (text,), tables=axes, figures=shown)
    if weighed := tables.weighing_tables(found):
        text = (
            "Without the limb, the remaining force gives the added masses and their places (in-situ paper, "
            "Tables II and III)."
        )
        yield Section("masses", "Added masses", (text,), tables=weighed)
    text = (
        "Wrench = matrix (raw - offset), exerted by the limb on the robot through the sensor, in the frame "
        "of the sensor. The standard deviations do not include errors of the given masses and places."
    )
    matrix = (tables.matrix_table(found), tables.offset_table(found))
    yield Section("calibration", "The calibration", (text,), tables=matrix)
    text = (
        "Readings of a rigid limb at rest lie on an ellipsoid in a three-dimensional subspace of the "
        "channels (in-situ paper, Lemma 1 and Fig. 5). The rest is noise, hysteresis, motion or bending of "
        "the limb."
    )
    caption = (
        "Readings of each set along their three principal directions with the ellipsoid of gravity, and the "
        "share of their spread outside these directions."
    )
    shown = (ReportFigure(figures.raw_ellipsoids(folder / "raw.png", found), "Figure 2", caption),)
    yield Section("raw", "Raw readings", (text,), figures=shown)
    text = (
        "Noise has no structure. A slope indicates drift, a loop hysteresis, and a step a contact or a "
        "loose part."
    )
    path = figures.residuals_over_time(folder / "residuals.svg", found)
    shown = (ReportFigure(path, "Figure 3", "Residuals of every channel, with one offset per set."),)
    yield Section("residuals", "Residuals", (text,), figures=shown)
