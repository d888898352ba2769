"""The page about one in-situ calibration: what came of it, and how far to trust it."""

from collections.abc import Iterator
from pathlib import Path

from surefoot.experiments.force_torque import figures, tables
from surefoot.experiments.study.page import ReportFigure, Section, write_log_page
from surefoot.experiments.study.tables import flat

_WEIGHT = """
    All forces scale with the added masses. The limb's own mass is an outcome of the fit, so that a pair of
    scales can check the absolute scale: forces that look like perfect spheres may be wrong by a common
    factor."""

_SPHERES = """
    A limb of constant weight draws a sphere of force as it turns. A matrix that is off draws an ellipsoid
    (in-situ paper, Table I and Fig. 6)."""

_MASSES = """
    With the limb taken off, what is left weighs and locates the added masses (in-situ paper, Tables II and
    III)."""

_MATRIX = """
    Wrench = matrix (raw - offset), exerted by the limb on the robot through the sensor, in the sensor's
    frame. Standard deviations are the fit's own; they know nothing of masses or places that were given
    wrongly."""

_NONLINEAR = """
    A polynomial in the wrench by the matrix is added to it, on the axes where it predicts what took no part
    clearly better. The matrix above is the best linear map."""

_RAW = """
    Readings of a rigid limb at rest lie on an ellipsoid in a three-dimensional part of the channels' space
    (in-situ paper, Lemma 1 and Fig. 5). What lies outside is noise, hysteresis, motion or a limb that
    bends."""

_RAW_CAPTION = """
    Readings of each set along their three main directions with the ellipsoid that gravity draws, and the
    share of their spread that lies outside these three."""

_RESIDUALS = """
    Noise has no shape. A slope is drift, a loop is hysteresis, a step is a contact or something that came
    loose."""


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
        found.notices,
        lambda folder: _sections(folder, found),
    )


def _sections(folder: Path, found: tables.Calibrated) -> Iterator[Section]:
    limb = (tables.limb_table(found),)
    yield Section("weight", "Weight of the limb", (flat(_WEIGHT),), tables=limb)
    matrices = "calibrated, and by the factory matrix." if "factory" in found.matrices else "calibrated."
    caption = f"Force of each set in N while the limb turned, with its fitted ellipsoid: {matrices}"
    shown = (ReportFigure(figures.force_ellipsoids(folder / "forces.png", found), "Figure 1", caption),)
    axes = (tables.semi_axes_table(found),)
    yield Section("spheres", "Spheres", (flat(_SPHERES),), tables=axes, figures=shown)
    if weighed := tables.weighing_tables(found):
        yield Section("masses", "Added masses", (flat(_MASSES),), tables=weighed)
    matrix = (tables.matrix_table(found), tables.offset_table(found))
    yield Section("calibration", "The calibration", (flat(_MATRIX),), tables=matrix)
    if found.fit.nonlinear is not None:
        bent = (tables.nonlinear_table(found),)
        yield Section("nonlinear", "Not linear", (flat(_NONLINEAR),), tables=bent)
    path = figures.raw_ellipsoids(folder / "raw.png", found)
    shown = (ReportFigure(path, "Figure 2", flat(_RAW_CAPTION)),)
    yield Section("raw", "Raw readings", (flat(_RAW),), figures=shown)
    caption = "What the fit leaves of every channel, with one offset a set."
    path = figures.residuals_over_time(folder / "residuals.svg", found)
    shown = (ReportFigure(path, "Figure 3", caption),)
    yield Section("residuals", "Residuals", (flat(_RESIDUALS),), figures=shown)
