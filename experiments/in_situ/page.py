"""The page of the simulated in-situ experiment, with its figures."""

from pathlib import Path

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
    flat,
    save_tables,
    write_page,
)
from surefoot.experiments.study.tables import Frame, Table, plural

__all__ = ["InSituStudyPage"]

_LOOKS = {"measurement": "moment", "no-loop": "tare", "paper": "window", "manufacturer": "none"}
"""Whose colours and markers the methods have in figures."""


class InSituStudyPage:
    """Tables and figures of one run of the study, and the page that holds them.

    Args:
        results: What the study found.
    """

    def __init__(self, results: InSituStudyResults) -> None:
        self.results = results
        self._tables = all_tables(results)

    @property
    def tables(self) -> tuple[Table, ...]:
        """All tables, in the order of the page."""
        return tuple(self._tables.values())

    def write(self) -> Path:
        """Draw the figures, save the tables as CSV, and write ``report.html``."""
        results, out = self.results, self.results.options.out
        save_tables(out / "tables", self.tables, prefix="page_")
        amount = _AMOUNT.format(
            seeds=plural(results.options.seeds, "seed"),
            rate=results.options.rate,
            moving=plural(min(results.options.seeds, results.options.moving_seeds), "seed"),
        )
        title = "In-situ calibration of six-axis sensors, simulated"
        return write_page(out / "report.html", title, (flat(_INTRODUCTION), flat(amount)), self._sections())

    def _sections(self) -> tuple[Section, ...]:
        results, tables = self.results, self._tables
        folder = results.options.out / "figures"
        spheres = tuple(tables[name] for name in ("table1", "table2", "table3"))
        limb = ReportFigure(
            _draw_limb(folder / "limb.svg", results.fits),
            "Weight of the limb",
            "A mark a seed; grey, one percent.",
        )
        return (
            Section("targets", "In short", findings=summary_findings(results), tables=(tables["targets"],)),
            Section(
                "spheres",
                "Spheres, masses, places",
                (flat(_SPHERES),),
                tables=spheres,
                figures=_ellipsoids(folder, results.shown) if len(results.shown) else (),
            ),
            Section(
                "limb",
                "Weight of the limb",
                (flat(_LIMB),),
                limb_findings(results),
                (tables["limb"],),
                figures=(limb,),
            ),
            Section(
                "bound", "As sure as right", (flat(_BOUND),), bound_findings(results), (tables["bound"],)
            ),
            Section(
                "motion",
                "Without waiting for rest",
                (flat(_MOTION),),
                motion_findings(results),
                (tables["motion"],),
            ),
            Section(
                "refusals",
                "Experiments that went wrong",
                findings=refusal_findings(results),
                tables=(tables["refusals"],),
            ),
            Section("exact", "The paper's method without noise", tables=(tables["exact"],)),
            *failure_section(results.failures),
            self._repeat(),
        )

    def _repeat(self) -> Section:
        options = self.results.options
        quick = " --quick" if options.quick else ""
        took = ", ".join(f"{what} {seconds:.0f} s" for what, seconds in self.results.seconds.items())
        text = (
            "All numbers are in tables/: fits.csv and sets.csv hold one row a seed, and the tables of this "
            "page begin with page_.",
            f"This run took: {took}. What is finished is kept, so that a run goes on where it stopped.",
        )
        command = f"surefoot compare in-situ --seeds {options.seeds}{quick} --jobs {options.jobs} "
        return Section("repeat", "Repeat it", text, commands=(f"{command}--out {options.out}",))


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
        ReportFigure(
            draw_ellipsoids(folder / "raw.png", counts, COUNTS),
            "Figure 5",
            "Counts of the sets that were not fitted along their three main directions, the ellipsoid "
            "that gravity draws, the offset in its centre, and the share of their spread that lies "
            "outside these three (Lemma 1). Seed 0.",
        ),
        ReportFigure(
            draw_ellipsoids(folder / "force.png", forces, FORCES),
            "Figure 6",
            "Forces of the same sets, calibrated and by the manufacturer's matrix. Seed 0.",
        ),
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
