"""The page of the simulated in-situ experiment."""

from datetime import UTC, datetime
from pathlib import Path

from surefoot.experiments.in_situ import study_tables as tables
from surefoot.experiments.in_situ.study import InSituStudyResults
from surefoot.experiments.in_situ.study_figures import force_figure, limb_figure, raw_figure
from surefoot.experiments.in_situ.study_findings import (
    bound_findings,
    limb_findings,
    motion_findings,
    refusal_findings,
    summary_findings,
)
from surefoot.experiments.study.files import atomic_path
from surefoot.experiments.study.page import ReportFigure, Section, flat, write_page
from surefoot.experiments.study.tables import Table

__all__ = ["InSituStudyPage"]


class InSituStudyPage:
    """Tables and figures of one run of the study, and the page that holds them.

    Args:
        results: What the study found.
    """

    def __init__(self, results: InSituStudyResults) -> None:
        self.results = results
        self.folder = results.options.out
        self.targets = tables.target_table(results)
        self.limb = tables.limb_table(results)
        self.spheres = (
            tables.semi_axes_table(results),
            tables.mass_table(results),
            tables.place_table(results),
        )
        self.bound = tables.bound_table(results)
        self.motion = tables.motion_table(results)
        self.refusals = tables.refusal_table(results)
        self.exact = tables.exact_table(results)

    @property
    def tables(self) -> tuple[Table, ...]:
        """All tables, in the order of the page."""
        return (self.targets, *self.spheres, self.limb, self.bound, self.motion, self.refusals, self.exact)

    def write(self) -> Path:
        """Draw the figures, save the tables as CSV, and write ``report.html``."""
        for table in self.tables:
            with atomic_path(self.folder / "tables" / f"page_{table.name}.csv") as part:
                table.to_frame().to_csv(part, index=False)
        results = self.results
        amount = _AMOUNT.format(
            seeds=results.options.seeds,
            rate=results.options.rate,
            moving=min(results.options.seeds, results.options.moving_seeds),
        )
        made = f"Made {datetime.now(UTC):%Y-%m-%d %H:%M} UTC by {results.machine}."
        title = "In-situ calibration of six-axis sensors, simulated"
        introduction = (flat(_INTRODUCTION), flat(amount))
        return write_page(self.folder / "report.html", title, introduction, self._sections(), made=made)

    def _sections(self) -> tuple[Section, ...]:
        results = self.results
        return (
            Section("targets", "In short", findings=summary_findings(results), tables=(self.targets,)),
            Section(
                "spheres",
                "Spheres, masses, places",
                (flat(_SPHERES),),
                tables=self.spheres,
                figures=self._ellipsoids(),
            ),
            Section(
                "limb",
                "Weight of the limb",
                (flat(_LIMB),),
                findings=limb_findings(results),
                tables=(self.limb,),
                figures=(
                    ReportFigure(
                        limb_figure(self._path("limb"), results.fits),
                        "Weight of the limb",
                        "A mark a seed; grey, one percent.",
                    ),
                ),
            ),
            Section(
                "bound",
                "As sure as right",
                (flat(_BOUND),),
                findings=bound_findings(results),
                tables=(self.bound,),
            ),
            Section(
                "motion",
                "Without waiting for rest",
                (flat(_MOTION),),
                findings=motion_findings(results),
                tables=(self.motion,),
            ),
            Section(
                "refusals",
                "Experiments that went wrong",
                findings=refusal_findings(results),
                tables=(self.refusals,),
            ),
            Section("exact", "The paper's method without noise", tables=(self.exact,)),
            self._repeat(),
        )

    def _ellipsoids(self) -> tuple[ReportFigure, ...]:
        shown = self.results.shown
        if not shown:
            return ()
        return (
            ReportFigure(
                raw_figure(self._path("raw"), shown),
                "Figure 5",
                "Counts of the sets that were not fitted along their three main directions, the ellipsoid "
                "that gravity draws, the offset in its centre, and the share of their spread that lies "
                "outside these three (Lemma 1). Seed 0.",
            ),
            ReportFigure(
                force_figure(self._path("force"), shown, ("surefoot", "manufacturer")),
                "Figure 6",
                "Forces of the same sets, calibrated and by the manufacturer's matrix. Seed 0.",
            ),
        )

    def _path(self, name: str) -> Path:
        return self.folder / "figures" / f"{name}.png"

    def _repeat(self) -> Section:
        options = self.results.options
        quick = " --quick" if options.quick else ""
        took = ", ".join(f"{what} {seconds:.0f} s" for what, seconds in self.results.seconds.items())
        return Section(
            "repeat",
            "Repeat it",
            (
                "Every figure is in tables/: fits.csv and sets.csv hold one row a seed, and the tables of "
                "this page begin with page_.",
                f"This run took: {took}. What is finished is kept, so that a run goes on where it stopped.",
            ),
            commands=(
                f"surefoot compare in-situ --seeds {options.seeds}{quick} --jobs {options.jobs} "
                f"--out {options.out}",
            ),
        )


_INTRODUCTION = """
    The experiment of Traversaro, Pucci and Nori (2015), simulated: a leg with six-axis sensors at foot and
    hip is swept about while known masses hang on it. Sets 1 to 4 are fitted, 5 to 8 validate. The sensors
    have hysteresis, noise, creep, drifting zeros that jump between sets, a 16-bit converter and matrices that
    are no longer the manufacturer's; the accelerometer on the beam has noise and a bias, which is calibrated
    from its own readings. The methods see counts, the IMU and the added masses; the truth only scores."""

_AMOUNT = """
    {seeds} seeds, each another pair of sensors, another IMU and another sweep, at {rate:g} samples a second
    for 300 s a set (motions: {moving} seeds). Intervals are 95 % intervals of the mean over seeds
    (Student t)."""

_SPHERES = """
    Turned about, a limb of constant weight draws a sphere of force. Beside each method's figures stand those
    that the paper printed for its own robot."""

_LIMB = """
    A sphere does not show a common factor of all forces, and an added mass hardly does: only the limb's own
    weight does. III-C regresses on noisy readings, so that it shrinks the scale."""

_BOUND = """
    With white noise of known size the Cramér-Rao bound says how well offsets can be known. The covariance
    that a fit claims is held against its errors (NEES): matrix, last offset and limb together."""

_MOTION = """
    With a gyroscope the limb need not be at rest: the acceleration of the sensor follows from the IMU's
    readings and the angular acceleration, taken by local cubics over 0.15 s."""
