"""The arena's page: tables, figures and what they say, in one file."""

from datetime import UTC, datetime
from pathlib import Path

import pandas as pd

from surefoot.experiments.arena import figures, tables
from surefoot.experiments.arena.findings import scenario_findings, summary_findings
from surefoot.experiments.arena.run import ArenaResults
from surefoot.experiments.arena.scenarios import Scenario
from surefoot.experiments.study.files import atomic_path
from surefoot.experiments.study.page import ReportFigure, Section, flat, write_page
from surefoot.experiments.study.tables import Table
from surefoot.experiments.walks.walkers import STAND_TIME

__all__ = ["ArenaPage"]

_INTRODUCTION = """
    A NAO-class biped walks in MuJoCo on feet whose gains and zeros are wrong and drift. Every walk is
    recorded once, and the same stream goes through every method. The methods are told what a robot knows of
    itself, never the truth, which serves to score them. Unless a scenario says otherwise, gains are off by
    12 % and zeros by 1.5 N, they drift by 2 % and 1 N per square root of a minute, the believed centre of
    mass is off by 3 mm and the mass by 0.5 %, the IMU is noisy and biased, and telemetry comes 20 ± 4 ms
    late."""

_AMOUNT = """
    {seeds} walks of {duration:g} s a scenario, unless the table says fewer; the first {stand:g} s are
    standing, and errors count from {settle:g} s on. Intervals are 95 % intervals of the mean over walks
    (Student t). The row "floor (true map)" is what the map that undoes the errors at every moment would
    read: what is left of it is the sensors' own noise and age."""

_CAPTIONS = {
    "overview": "Means and 95 % intervals of all scenarios; dashed, what was set out to be reached.",
    "curves": "Rmse of the last 2 s: median over the walks, and quartiles shaded.",
    "consistency": "How the errors of gains and zeros at the ends of the walks agree with the covariance "
    "claimed: 1 is right, to the right of it a method is too sure. Grey, the 95 % interval of a consistent "
    "estimator.",
    "detection": "Every dot is a walk in which the fault was found; dashed, one second.",
}


class ArenaPage:
    """Tables and figures of one run of the arena, and the page that holds them.

    Args:
        results: What the arena found.
    """

    def __init__(self, results: ArenaResults) -> None:
        self.results = results
        self.folder = results.options.out
        scores = results.scores
        self.overview = tables.overview_table(scores, results.scenarios)
        self.targets = tables.target_table(scores, results.timing)
        self.faults = tables.fault_table(scores, results.scenarios)
        self.alarms = tables.alarm_table(scores)
        self.timing = tables.timing_table(results.timing, scores)
        self.scenarios = {s.name: tables.scenario_table(scores, s) for s in results.scenarios}

    @property
    def tables(self) -> tuple[Table, ...]:
        """All tables, in the order of the page."""
        summary = (self.targets, self.overview, self.timing, self.alarms, self.faults)
        return (*(table for table in summary if table is not None), *self.scenarios.values())

    def write(self) -> Path:
        """Draw the figures, save the tables as CSV, and write ``report.html``."""
        for table in self.tables:
            with atomic_path(self.folder / "tables" / f"{table.name}.csv") as part:
                table.to_frame().to_csv(part, index=False)
        self._summarise()
        options = self.results.options
        amount = _AMOUNT.format(
            seeds=options.seeds, duration=options.duration, stand=STAND_TIME, settle=options.settle
        )
        made = f"Made {datetime.now(UTC):%Y-%m-%d %H:%M} UTC by {self.results.machine}."
        sections = (self._summary_section(), *map(self._scenario_section, self.results.scenarios))
        faulty = self._fault_section()
        if self.results.skipped:
            sections = (*sections, _skipped_section(self.results.skipped))
        sections = (*sections, *(() if faulty is None else (faulty,)), self._repeat_section())
        introduction = (flat(_INTRODUCTION), flat(amount))
        title = "surefoot arena: calibrators on the same streams"
        return write_page(self.folder / "report.html", title, introduction, sections, made=made)

    def _summarise(self) -> None:
        """Write means over runs, for machines."""
        numbers = self.results.scores.select_dtypes(["number", "bool"]).columns.difference(["seed"])
        scores = self.results.scores
        means = scores.groupby(["scenario", "method"], sort=False)[list(numbers)].mean()
        runs = scores.groupby(["scenario", "method"], sort=False).size().rename("runs")
        with atomic_path(self.folder / "tables" / "summary.csv") as part:
            pd.concat([runs, means], axis=1).to_csv(part)

    def _path(self, name: str) -> Path:
        return self.folder / "figures" / f"{name}.png"

    def _summary_section(self) -> Section:
        results = self.results
        scores, scenarios = results.scores, results.scenarios
        drawn = [
            (figures.overview(self._path("overview"), scores, scenarios), "All scenarios", "overview"),
            (
                figures.consistency(self._path("consistency"), scores, scenarios),
                "Consistency",
                "consistency",
            ),
        ]
        tables = (self.targets, self.overview, self.timing, self.alarms)
        return Section(
            "summary",
            "In short",
            findings=summary_findings(scores),
            tables=tuple(table for table in tables if table is not None),
            figures=tuple(
                ReportFigure(path, name, _CAPTIONS[caption])
                for path, name, caption in drawn
                if path is not None
            ),
        )

    def _scenario_section(self, scenario: Scenario) -> Section:
        results = self.results
        left_out = results.left_out.get(scenario.name, 0)
        shown: tuple[ReportFigure, ...] = ()
        curves = results.errors[results.errors["scenario"] == scenario.name]
        if curves["cop"].notna().any():
            path = self._path(f"curves_{scenario.name}")
            figures.error_curves(path, results.errors, (scenario,))
            shown = (ReportFigure(path, "Error over time", _CAPTIONS["curves"]),)
        return Section(
            scenario.name,
            scenario.title[:1].upper() + scenario.title[1:],
            (scenario.answers,),
            findings=scenario_findings(results.scores, scenario, left_out),
            tables=(self.scenarios[scenario.name],),
            figures=shown,
        )

    def _fault_section(self) -> Section | None:
        if self.faults is None:
            return None
        results = self.results
        path = figures.detection(self._path("detection"), results.scores, results.scenarios)
        shown = () if path is None else (ReportFigure(path, "Detection", _CAPTIONS["detection"]),)
        return Section("faults", "Faults side by side", tables=(self.faults,), figures=shown)

    def _repeat_section(self) -> Section:
        options = self.results.options
        took = ", ".join(f"{what} {seconds:.0f} s" for what, seconds in self.results.seconds.items())
        quick = " --quick" if options.quick else ""
        scenario = self.results.scenarios[0].name
        return Section(
            "repeat",
            "Repeat any part",
            (
                "All scores are in tables/scores.csv and .parquet, one row a run; tables/summary.csv holds "
                "their means, tables/errors.parquet the errors over time, and logs/ the recorded streams.",
                f"This run took: {took}. What is finished is kept, so that a run goes on where it stopped.",
            ),
            commands=(
                f"surefoot compare walking --scenario {scenario} --seeds {options.seeds}{quick} "
                f"--out {options.out}",
            ),
        )


def _skipped_section(skipped: tuple[Scenario, ...]) -> Section:
    names = ", ".join(scenario.name for scenario in skipped)
    text = (
        f"Left out: {names}. These are public recordings that may not be handed on with the package; set "
        "SUREFOOT_DATA to the folder that holds them and run again."
    )
    return Section("skipped", "Real recordings", (text,))
