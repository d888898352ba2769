"""The page about one in-situ calibration: its result, and how far to trust it."""

from collections.abc import Iterator
from pathlib import Path

from surefoot.experiments.force_torque import figures, tables
from surefoot.experiments.study.page import ReportFigure, Section, Words, write_log_page

_say = Words("force_torque")


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
    yield Section("weight", "Weight of the limb", (_say("weight"),), tables=limb)
    matrices = ", and by ".join(f"the {name} matrix" for name in found.matrices)
    caption = f"Force of each set in N while the limb turned, with its fitted ellipsoid, by {matrices}."
    shown = (ReportFigure(figures.force_ellipsoids(folder / "forces.png", found), "Figure 1", caption),)
    axes = (tables.semi_axes_table(found),)
    yield Section("spheres", "Spheres", (_say("spheres"),), tables=axes, figures=shown)
    if weighed := tables.weighing_tables(found):
        yield Section("masses", "Added masses", (_say("masses"),), tables=weighed)
    matrix = (tables.matrix_table(found), tables.offset_table(found))
    yield Section("calibration", "The calibration", (_say("matrix"),), tables=matrix)
    path = figures.raw_ellipsoids(folder / "raw.png", found)
    shown = (ReportFigure(path, "Figure 2", _say("raw_figure")),)
    yield Section("raw", "Raw readings", (_say("raw"),), figures=shown)
    caption = "What the fit leaves of every channel, with one offset a set."
    path = figures.residuals_over_time(folder / "residuals.svg", found)
    shown = (ReportFigure(path, "Figure 3", caption),)
    yield Section("residuals", "Residuals", (_say("residuals"),), figures=shown)
