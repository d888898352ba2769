"""The page of the comparison: tables, figures and what they say, in one file."""

from pathlib import Path

import pandas as pd

from surefoot.experiments.study.page import (
    Report,
    ReportFigure,
    Section,
    Words,
    failure_section,
    publish,
    repeat_section,
)
from surefoot.experiments.study.progress import working
from surefoot.experiments.study.tables import claim_table, plural, sentence
from surefoot.experiments.walks import figures, tables
from surefoot.experiments.walks.findings import claims_of, scenario_findings, summary_findings
from surefoot.experiments.walks.options import ArenaOptions
from surefoot.experiments.walks.run import ArenaResults, run_arena
from surefoot.experiments.walks.scenarios import Scenario
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.files import atomic_path

_say, _caption = Words("walks", "scenarios"), Words("walks", "captions")


def compare_walking(options: ArenaOptions) -> Report:
    """Run the comparison of all scenarios, and write its page; refused is what :func:`run_arena` refuses."""
    results = run_arena(options, bounds=True)
    with working("drawing the report"):
        return write_arena_page(results)


def write_arena_page(results: ArenaResults) -> Report:
    """Draw the figures, save the tables as CSV, and write ``report.html``; return it with what sums it up."""
    options, scores, scenarios = results.options, results.scores, results.scenarios
    drawn = options.out / "figures"
    timing, alarms = tables.timing_table(results.timing), tables.alarm_table(scores)
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
    sections.append(repeat_section(_say("repeat"), (f"{command} --out {options.out}",), results.seconds))
    if targets:
        sections.append(Section("targets", "What was set out to reach", tables=targets))
    _save_summary(results)
    amount = _say(
        "amount",
        walks=plural(options.seeds, "walk"),
        duration=options.duration,
        stand=STAND_TIME,
        settle=options.settle,
    )
    title = "Calibrators on the same walks"
    report = publish(options.out, title, (_say("introduction"), amount), sections)
    return report._replace(tables=(*targets, *summary, *(() if faults is None else (faults,))))


def _figure(path: Path | None, name: str) -> tuple[ReportFigure, ...]:
    return () if path is None else (ReportFigure(path, name, _caption(name)),)


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
