"""The page of the comparison: tables, figures and what they say, in one file."""

from pathlib import Path

import pandas as pd
from rich.console import Console

from surefoot.experiments.arena import figures, tables
from surefoot.experiments.arena.bound import bound_of
from surefoot.experiments.arena.findings import claims_of, scenario_findings, summary_findings
from surefoot.experiments.arena.options import ArenaOptions
from surefoot.experiments.arena.run import ArenaResults, run_arena
from surefoot.experiments.arena.scenarios import Scenario
from surefoot.experiments.study.files import atomic_path
from surefoot.experiments.study.page import (
    Report,
    ReportFigure,
    Section,
    failure_section,
    repeat_section,
    save_tables,
    write_page,
)
from surefoot.experiments.study.progress import working
from surefoot.experiments.study.tables import claim_table, flat, plural, sentence
from surefoot.experiments.walks.walkers import STAND_TIME

_INTRODUCTION = """
    A NAO-class biped walks in MuJoCo on feet whose scales and offsets are wrong and drift. Every walk is
    recorded once, and the same stream goes through every method. The methods are given what a robot knows
    of itself, never the truth, which serves to score them. Unless a scenario says otherwise, scales are
    off by 12 % and offsets by 1.5 N, they drift by 2 % and 1 N per square root of a minute, the assumed
    centre of mass is off by 3 mm and the mass by 0.5 %, the IMU is noisy and biased, and telemetry comes
    20 ± 4 ms late."""

_AMOUNT = """
    {walks} of {duration:g} s a scenario, unless the table says fewer; the first {stand:g} s are standing,
    and errors count from {settle:g} s on. Intervals are 95 % intervals of the mean over walks (Student t).
    The row "floor (true map)" is what the map that undoes the errors at every moment would read: what is
    left of it is the sensors' own noise and age."""

_REPEAT = """
    All scores are in tables/scores.csv and .parquet, one row a run; tables/summary.csv holds their means,
    tables/errors.parquet the errors over time, and logs/ the recorded streams."""

_CAPTIONS = {
    "All scenarios": "Means and 95 % intervals of all scenarios; dashed, what was set out to be reached.",
    "Error over time": "Rmse of the last 2 s: median over the walks, and quartiles shaded.",
    "Consistency": "How the errors of scales and offsets at the ends of the walks agree with the covariance "
    "claimed: 1 is right, to the right of it a method is too sure. Grey, the 95 % interval of a consistent "
    "estimator.",
    "Detection": "Every dot is a walk in which the fault was found; dashed, one second.",
}


def compare_walking(options: ArenaOptions, console: Console | None = None) -> Report:
    """Run the comparison of all scenarios, and write its page; refused is what :func:`run_arena` refuses."""
    results = run_arena(options, bound=bound_of, console=console)
    with working("drawing the report"):
        return write_arena_page(results)


def write_arena_page(results: ArenaResults) -> Report:
    """Draw the figures, save the tables as CSV, and write ``report.html``; return it with what sums it up."""
    options, scores, scenarios = results.options, results.scores, results.scenarios
    drawn = options.out / "figures"
    timing, alarms = tables.timing_table(results.timing, scores), tables.alarm_table(scores)
    summary = (tables.overview_table(scores, scenarios), timing, alarms)
    faults = tables.fault_table(scores, scenarios)
    claims = claims_of(scores, results.timing)
    targets = (claim_table(claims, "Set out to reach"),) if claims else ()
    shown = (
        *_figure(figures.overview(drawn / "overview.svg", scores, scenarios), "All scenarios"),
        *_figure(figures.consistency(drawn / "consistency.svg", scores, scenarios), "Consistency"),
    )
    sections = [
        Section("summary", "In short", (), summary_findings(scores), summary, figures=shown),
        *(_scenario_section(results, scenario, drawn) for scenario in scenarios),
    ]
    if faults is not None:
        shown = _figure(figures.detection(drawn / "detection.svg", scores, scenarios), "Detection")
        sections.append(Section("faults", "Faults side by side", tables=(faults,), figures=shown))
    quick = " --quick" if options.quick else ""
    command = f"surefoot compare walking --scenario {scenarios[0].name} --seeds {options.seeds}{quick}"
    sections += failure_section(results.failures)
    sections.append(repeat_section((_REPEAT,), (f"{command} --out {options.out}",), results.seconds))
    if targets:
        sections.append(Section("targets", "What was set out to reach", tables=targets))
    _save_summary(results)
    save_tables(options.out / "tables", [table for section in sections for table in section.tables])
    amount = _AMOUNT.format(
        walks=plural(options.seeds, "walk"),
        duration=options.duration,
        stand=STAND_TIME,
        settle=options.settle,
    )
    title = "Calibrators on the same walks"
    page = write_page(options.out / "report.html", title, (flat(_INTRODUCTION), flat(amount)), sections)
    return Report(page, (*targets, *summary, *(() if faults is None else (faults,))))


def _figure(path: Path | None, name: str) -> tuple[ReportFigure, ...]:
    return () if path is None else (ReportFigure(path, name, _CAPTIONS[name]),)


def _scenario_section(results: ArenaResults, scenario: Scenario, folder: Path) -> Section:
    curves = results.errors[results.errors["scenario"] == scenario.name]
    path = None
    if curves["cop"].notna().any():
        path = figures.error_curves(folder / f"curves_{scenario.name}.svg", {scenario.title: curves})
    return Section(
        scenario.name,
        sentence(scenario.title),
        (scenario.answers,),
        scenario_findings(results.scores, scenario, results.left_out.get(scenario.name, 0)),
        (tables.scenario_table(results.scores, scenario),),
        figures=_figure(path, "Error over time"),
    )


def _save_summary(results: ArenaResults) -> None:
    """Write means over runs, for machines."""
    numbers = results.scores.select_dtypes(["number", "bool"]).columns.difference(["seed"])
    groups = results.scores.groupby(["scenario", "method"], sort=False)
    runs = groups.size().rename("runs")
    with atomic_path(results.options.out / "tables" / "summary.csv") as part:
        pd.concat([runs, groups[list(numbers)].mean()], axis=1).to_csv(part)
