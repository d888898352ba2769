"""The page of a study of walks: scenarios one by one, or the CoP paper's conditions with the loop closed."""

from pathlib import Path
from typing import Any

from surefoot.calibration import METHODS
from surefoot.experiments.evaluate.figures import survival_curves
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
from surefoot.experiments.study.tables import Frame, claim_table, plural, sentence
from surefoot.experiments.walks import figures, findings, tables
from surefoot.experiments.walks.options import WalkStudyOptions
from surefoot.experiments.walks.record import CONDITIONS
from surefoot.experiments.walks.run import WalkStudyResults, run_walk_study
from surefoot.experiments.walks.scenarios import SCENARIOS, TRUE_MAP, Scenario, log_paths
from surefoot.experiments.walks.video import FILM, STILL
from surefoot.experiments.walks.walkers import STAND_TIME

_caption = Words("walks", "captions")
_say_paper = Words("walks", "paper")

PAPER, BAD = CONDITIONS
YARDSTICKS = (
    (PAPER, "baseline", f"{PAPER.title}, against the baseline"),
    (PAPER, "truth", f"{PAPER.title}, against the truth"),
    (BAD, "truth", f"{BAD.title}, against the truth"),
)


def report_walks(options: WalkStudyOptions) -> Report:
    """Run a study of walks, and write its page; it refuses the same as :func:`run_walk_study`."""
    results = run_walk_study(options)
    with working("drawing the report"):
        return write_walks_page(results)


def write_walks_page(results: WalkStudyResults) -> Report:
    """Draw the figures, save the tables as CSV, and write ``report.html``; return it with its summary."""
    options, of_paper = results.options, bool(results.options.loops)
    say = _say_paper if of_paper else Words("walks", "scenarios")
    if of_paper:
        title, sections = "Walking on bad feet, and on calibrated ones", _paper_sections(results)
    else:
        title, sections = "Calibrators on the same walks", _scenario_sections(results)
    sections += failure_section(results.failures)
    sections.append(repeat_section(say("repeat"), _commands(results), results.seconds))
    if claims := [] if of_paper else findings.claims_of(results.scores):
        targets = (claim_table(claims, "Set out to reach"),)
        sections.append(Section("targets", "What was set out to reach", tables=targets))
    amount = say(
        "amount",
        walks=plural(options.seeds, "walk"),
        seeds=plural(options.seeds, "seed"),
        speeds=", ".join(f"{speed:g}" for speed in results.speeds),
        duration=options.duration,
        stand=STAND_TIME,
        settle=options.settle,
    )
    lead = _lead(results) if len(results.loop) else None
    report = publish(options.out, title, (say("introduction"), amount), sections, lead=lead)
    if of_paper:
        # A row a foot, method and condition is for the page alone.
        return report._replace(tables=tuple(one for one in report.tables if one.name != "gait_cycle"))
    first = ("targets", "summary", "faults")
    found = {section.anchor: section.tables for section in sections if section.anchor in first}
    return report._replace(tables=tuple(table for name in first for table in found.get(name, ())))


def _figure(path: Path | None, name: str, caption: str = "", **values: Any) -> tuple[ReportFigure, ...]:
    """Return a figure with its caption, which its name tells by default; nothing where none was drawn."""
    return () if path is None else (ReportFigure(path, name, _caption(caption or name, **values)),)


def _scenario_sections(results: WalkStudyResults) -> list[Section]:
    scores, scenarios, drawn = results.scores, results.scenarios, results.options.out / "figures"
    overview = figures.overview(drawn / "overview.svg", figures.by_scenario(scores, scenarios))
    shown = _figure(overview, "All scenarios")
    overviews = [tables.overview_table(scores, scenarios, metric) for metric in tables.METRICS]
    summary = (*overviews, tables.alarm_table(scores))
    sections = [
        Section("summary", "In short", tables=summary, figures=shown),
        *(_scenario_section(results, scenario, drawn) for scenario in scenarios),
    ]
    faults = tables.fault_table(scores, scenarios)
    if faults is not None:
        sections.append(Section("faults", "Faults side by side", tables=(faults,)))
    return sections


def _scenario_section(results: WalkStudyResults, scenario: Scenario, folder: Path) -> Section:
    curves = results.errors[results.errors["scenario"] == scenario.name]
    path = None
    if curves["cop"].notna().any():
        path = figures.error_curves(folder / f"curves_{scenario.name}.svg", {scenario.title: curves})
    return Section(
        scenario.name,
        sentence(scenario.title),
        (scenario.answers,),
        findings.scenario_findings(results.scores, scenario, results.left_out.get(scenario.name, 0)),
        (tables.scenario_table(results.scores, scenario),),
        figures=_figure(path, "Error over time"),
    )


def _paper_sections(results: WalkStudyResults) -> list[Section]:
    folder = results.options.out / "figures"
    return [
        _walking_section(results, folder),
        *((_cycle_section(results),) if len(results.cycles) else ()),
        *((_loop_section(results, folder),) if len(results.loop) else ()),
    ]


def _lead(results: WalkStudyResults) -> Section:
    """First section of the page: the worst feet that were walked on."""
    loop = results.loop[results.loop["severity"] == results.loop["severity"].max()]
    # In the middle of the paper's speeds, if it was walked.
    speed = results.speeds[len(results.speeds) // 2]
    drawn = results.options.out / "figures" / "errors_over_time.svg"
    curves = figures.error_curves(drawn, _errors(results), max(len(results.speeds), 2))
    paragraphs = [findings.lead_finding(loop)]
    video: dict[str, Any] = {}
    if isinstance(results.filmed, str):
        paragraphs.append(f"There is no film in this report: {results.filmed.rstrip('.')}.")
    else:
        severity, at, seed = results.filmed
        caption = _caption("film", severity=severity, speed=at, seed=seed)
        video = {"video": FILM, "poster": STILL, "video_caption": caption}
    own = results.yardsticks[results.yardsticks["speed"] == speed]
    return Section(
        "lead",
        "What was done",
        tuple(paragraphs),
        tables=(tables.lead_table(own, loop[loop["speed"] == speed], BAD.name, f"In short: {speed:g} m/s"),),
        figures=_figure(curves, "How far off the CoP is", "errors_over_time"),
        **video,
    )


def _errors(results: WalkStudyResults) -> dict[str, Frame]:
    """Return the errors over time of each condition and speed, while it walks, by a title."""
    errors = results.errors
    walked = errors[(errors["time"] > STAND_TIME) & errors["method"].isin([TRUE_MAP, *METHODS])]
    return {
        f"{condition.title}, {speed:g} m/s": walked[walked["scenario"] == f"{condition.name}-{speed:g}"]
        for condition in CONDITIONS
        for speed in results.speeds
    }


def _walking_section(results: WalkStudyResults, folder: Path) -> Section:
    scores, conditions = results.yardsticks, [(PAPER.name, "the paper's"), (BAD.name, BAD.title)]
    said = tuple(
        f"{sentence(scenario.title)}: {text}"
        for scenario in results.scenarios
        for text in findings.scenario_findings(
            results.scores, scenario, results.left_out.get(scenario.name, 0)
        )
    )
    shown = scores[scores["method"].isin([TRUE_MAP, *METHODS])]
    parts = dict(iter(shown.groupby(["condition", "against", "speed"])))
    rows = {
        f"{title}, {speed:g} m/s": parts.get((condition.name, against, speed), shown[:0])
        for condition, against, title in YARDSTICKS
        for speed in results.speeds
    }
    overview = figures.overview(folder / "overview.svg", rows, tables.PAPER_METRICS)
    drawn = _figure(overview, "All speeds", "overview")
    texts = (
        _say_paper("conditions", paper=PAPER.title.capitalize(), bad=BAD.title.capitalize()),
        _say_paper("yardsticks"),
        _say_paper("definitions"),
    )
    laid_out = tuple(tables.walking_table(scores, speed, conditions) for speed in results.speeds)
    return Section("walking", "Calibrating while walking", texts, said, laid_out, figures=drawn)


def _cycle_section(results: WalkStudyResults) -> Section:
    # In the middle of the paper's speeds, if it was walked.
    speed = results.speeds[len(results.speeds) // 2]
    walks = figures.by_scenario(results.cycles, [s for s in results.scenarios if s.speed == speed])
    return Section("gait-cycle", "Gait cycles", tables=(tables.cycle_table(walks),))


def _loop_section(results: WalkStudyResults, folder: Path) -> Section:
    horizon = results.options.loop_duration
    drawn: tuple[ReportFigure, ...] = ()
    for speed, runs in results.loop.groupby("speed", sort=False):
        path = survival_curves(
            folder / f"closed_loop_{speed:g}.svg".replace(".", "_", 1), runs.assign(policy="stabiliser")
        )
        drawn += _figure(path, f"Who falls when, {speed:g} m/s", "closed_loop")
    said = tuple(findings.loop_findings(results.loop))
    shown: Any = {"tables": (tables.loop_table(results.loop, horizon),), "figures": drawn}
    return Section("closed-loop", "Closing the loop", (_say_paper("loop", stand=STAND_TIME),), said, **shown)


def _commands(results: WalkStudyResults) -> tuple[str, ...]:
    options = results.options
    if not options.loops:
        quick = " --quick" if options.quick else ""
        first = f"surefoot compare walking --scenario {results.scenarios[0].name} --seeds {options.seeds}"
        return (f"{first}{quick} --out {options.out}",)
    speed, seed = results.speeds[-1], options.seeds - 1
    scenario = SCENARIOS[f"{BAD.name}-{speed:g}"]
    log = log_paths(scenario, seed, options.duration, options.logs)[scenario.condition]
    severity = max(options.loops)
    return (
        f"surefoot calibrate walk {log} --method window --settle {options.settle:g}",
        f"surefoot view --feed none --severity {severity:g} --speed {speed:g} --seed {seed}",
        f"surefoot compare walking --full --seeds 10 --jobs {options.jobs}",
    )
