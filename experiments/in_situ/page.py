"""The page of the simulated in-situ experiment, with its figures."""

from pathlib import Path
from typing import Any

import numpy as np

from surefoot.calibration.in_situ import estimate_offset
from surefoot.experiments.force_torque.figures import COUNTS, FORCES, Cloud, Panel, draw_ellipsoids
from surefoot.experiments.in_situ.cases import DRAWN
from surefoot.experiments.in_situ.claims import (
    bound_findings,
    limb_findings,
    motion_findings,
    refusal_findings,
    summary_findings,
)
from surefoot.experiments.in_situ.methods import METHODS
from surefoot.experiments.in_situ.study import InSituStudyResults
from surefoot.experiments.in_situ.tables import all_tables
from surefoot.experiments.study.figures import Look, figure_at, grid_of, look_of
from surefoot.experiments.study.page import (
    ReportFigure,
    Section,
    failure_section,
    repeat_section,
    save_tables,
    write_page,
)
from surefoot.experiments.study.tables import Frame, Table, flat, plural

_LOOKS = {"measurement": "moment", "no-loop": "tare", "paper": "window", "manufacturer": "none"}
"""Whose colours and markers the methods have in figures."""


class InSituStudyPage:
    """Tables and figures of one run of the study, and the page that holds them."""

    def __init__(self, results: InSituStudyResults) -> None:
        self.results = results
        self._tables = all_tables(results)

    @property
    def tables(self) -> tuple[Table, ...]:
        """All tables, in the order of the page."""
        return tuple(self._tables.values())

    def write(self) -> Path:
        """Draw the figures, save the tables as CSV, and write ``report.html``."""
        results, tables, options = self.results, self._tables, self.results.options
        save_tables(options.out / "tables", self.tables, prefix="page_")
        amount = _AMOUNT.format(
            seeds=plural(options.seeds, "seed"),
            rate=options.rate,
            moving=plural(min(options.seeds, options.moving_seeds), "seed"),
        )
        title = "In-situ calibration of six-axis sensors, simulated"

        def section(name: str, title: str, text: str = "", said: Any = None, **more: Any) -> Section:
            found = () if said is None else said(results)
            shown = {"tables": (tables[name],)} if name in tables else {}
            return Section(name, title, (flat(text),) if text else (), found, **shown | more)

        folder = options.out / "figures"
        limb = (ReportFigure(_draw_limb(folder / "limb.svg", results.fits), *_LIMB_FIGURE),)
        spheres: dict[str, Any] = {"tables": tuple(tables[f"table{number}"] for number in (1, 2, 3))}
        spheres["figures"] = _ellipsoids(folder, results.shown) if len(results.shown) else ()
        quick = " --quick" if options.quick else ""
        command = f"surefoot compare in-situ --seeds {options.seeds}{quick} --jobs {options.jobs}"
        sections = (
            section("targets", "In short", said=summary_findings),
            section("spheres", "Spheres, masses, places", _SPHERES, **spheres),
            section("limb", "Weight of the limb", _LIMB, limb_findings, figures=limb),
            section("bound", "As sure as right", _BOUND, bound_findings),
            section("motion", "Without waiting for rest", _MOTION, motion_findings),
            section("refusals", "Experiments that went wrong", said=refusal_findings),
            section("exact", "The paper's method without noise"),
            *failure_section(results.failures),
            repeat_section((_REPEAT,), (f"{command} --out {options.out}",), results.seconds),
        )
        return write_page(options.out / "report.html", title, (flat(_INTRODUCTION), flat(amount)), sections)


def _ellipsoids(folder: Path, shown: Frame) -> tuple[ReportFigure, ...]:
    """Draw the paper's Figs. 5 and 6: counts with the offset in the middle, and forces by two matrices."""
    counts, forces = [], []
    for _, row in shown.iterrows():
        raw, gravity = _points(row["raw"]), _points(row["gravity"])
        title = f"{row['sensor']}, set {row['set']}"
        fit = estimate_offset(raw, gravity)
        cloud = Cloud(fit.coordinates(raw), gravity, look_of("none"), mark=fit.coordinates(fit.offset))
        counts.append(Panel(f"{title}: {100.0 * fit.affine_residual:.2f} % off", [cloud]))
        found = {method: row[f"force_{method}"] for method in DRAWN if len(row[f"force_{method}"])}
        clouds = [Cloud(_points(force), gravity, _look(method)) for method, force in found.items()]
        forces.append(Panel(title, clouds))
    return (
        ReportFigure(draw_ellipsoids(folder / "raw.png", counts, COUNTS), "Figure 5", flat(_FIGURE_5)),
        ReportFigure(draw_ellipsoids(folder / "force.png", forces, FORCES), "Figure 6", _FIGURE_6),
    )


def _points(nested: object) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return points of a table's cell, shape (n, k)."""
    return np.stack([np.asarray(point, dtype=np.float64) for point in nested])  # type: ignore[attr-defined]


def _draw_limb(path: Path, fits: Frame) -> Path:
    """Draw the error of the limb's weight of every seed, by sensor and method."""
    sensors = list(dict.fromkeys(fits["sensor"]))
    ticks = {"measurement": "measurement\nspace", "no-loop": "without\nhysteresis", "paper": "III-B, III-C"}
    with figure_at(path, 9.0, 3.2) as figure:
        for axes, sensor in zip(grid_of(figure, 1, len(sensors))[0], sensors, strict=True):
            axes.axhspan(-1.0, 1.0, color="#000000", alpha=0.08, linewidth=0)
            for place, method in enumerate(ticks):
                chosen = (fits["sensor"] == sensor) & (fits["method"] == method)
                errors = 100.0 * fits[chosen]["limb_error"].dropna()
                spread = np.linspace(-0.25, 0.25, len(errors)) if len(errors) > 1 else np.zeros(len(errors))
                look = _look(method)
                axes.plot(place + spread, errors, look.marker, color=look.colour, markersize=3.5)
            axes.set_xticks(range(len(ticks)), list(ticks.values()))
            axes.set_title(sensor)
            axes.axhline(0.0, color="#000000", linewidth=0.6)
        figure.supylabel("limb's weight, error (%)", fontsize=9.5)
    return path


def _look(method: str) -> Look:
    return look_of(_LOOKS[method])._replace(label=METHODS[method])


_REPEAT = """
    All numbers are in tables/: fits.csv and sets.csv hold one row a seed, and the tables of this page begin
    with page_."""

_LIMB_FIGURE = ("Weight of the limb", "A mark a seed; grey, one percent.")

_FIGURE_5 = """
    Counts of the sets that were not fitted along their three main directions, the ellipsoid that gravity
    draws, the offset in its centre, and the share of their spread that lies outside these three (Lemma 1).
    Seed 0."""

_FIGURE_6 = "Forces of the same sets, calibrated and by the manufacturer's matrix. Seed 0."

_INTRODUCTION = """
    The experiment of Traversaro, Pucci and Nori (2015), simulated: a leg with six-axis sensors at foot and
    hip is swept about while known masses hang on it. Sets 1 to 4 are fitted, 5 to 8 validate. The sensors
    have hysteresis, noise, creep, drifting offsets that jump between sets, a 16-bit converter and matrices
    that are no longer the manufacturer's; the accelerometer on the beam has noise and a bias, which is
    calibrated from its own readings. The methods see counts, the IMU and the added masses; the truth only
    scores."""

_AMOUNT = """
    {seeds}, each another pair of sensors, another IMU and another sweep, at {rate:g} samples a second
    for 300 s a set (motions: {moving}). Intervals are 95 % intervals of the mean over seeds (Student t)."""

_SPHERES = """
    Turned about, a limb of constant weight draws a sphere of force. Beside each method's numbers stand those
    that the paper printed for its own robot."""

_LIMB = """
    A sphere does not show a common factor of all forces, and an added mass hardly does: only the limb's own
    weight does. III-C regresses on noisy readings, so that it shrinks the scale."""

_BOUND = """
    With white noise of known size the Cramér-Rao bound gives how well offsets can be known. The covariance
    of a fit is compared with its errors (NEES): matrix, last offset and limb together."""

_MOTION = """
    With a gyroscope the limb need not be at rest: the acceleration of the sensor follows from the IMU's
    readings and the angular acceleration, taken by local cubics over 0.15 s."""
