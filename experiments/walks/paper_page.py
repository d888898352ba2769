"""The page of the demo and of the CoP paper's full study: first a film, a sentence, a figure and a table."""

from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.calibration import METHODS
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
from surefoot.experiments.study.tables import Frame, claim_table, plural
from surefoot.experiments.walks import paper as tables
from surefoot.experiments.walks import paper_figures as figures
from surefoot.experiments.walks import paper_findings as findings
from surefoot.experiments.walks.figures import error_curves
from surefoot.experiments.walks.options import TRUE_MAP, ArenaOptions
from surefoot.experiments.walks.paper import WALKING_TABLES
from surefoot.experiments.walks.paper_findings import loop_claims, walking_claims, weight_claims
from surefoot.experiments.walks.record import CONDITIONS, Condition
from surefoot.experiments.walks.recordings import log_paths
from surefoot.experiments.walks.run import ArenaResults, run_arena
from surefoot.experiments.walks.scenarios import PAPER_SCENARIOS
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.experiments.weights.paper import paper_table_2, weights_section
from surefoot.experiments.weights.weighing import run_weighing

_say, _caption = Words("walks", "paper"), Words("walks", "captions")

PAPER, BAD = CONDITIONS
PAPER_FIGURES = {0.02: (10, 11), 0.04: (12, 13), 0.1: (14, 15)}
YARDSTICKS = (
    (PAPER, "baseline", f"{PAPER.title}, against the baseline"),
    (PAPER, "truth", f"{PAPER.title}, against the truth"),
    (BAD, "truth", f"{BAD.title}, against the truth"),
)


def run_demo(options: ArenaOptions) -> Report:
    """Run the demo or the full study, and write its page; what is refused is that of :func:`run_arena`."""
    results = run_arena(options)
    with working("drawing the report"):
        return write_demo_page(results)


def write_demo_page(results: ArenaResults) -> Report:
    """Draw the figures, save the tables as CSV, and write ``report.html``; return it with its tables."""
    options = results.options
    folder = options.out / "figures"
    weighing, coefficient = run_weighing(), paper_table_2()[1]
    slowest = results.timing.set_index("method")["slowest_us"]
    claims = weight_claims(coefficient, weighing.calibrated.cop, weighing.calibrated.vgrf)
    claims += walking_claims(results.yardsticks, PAPER.name, 1e-3 * float(slowest["window"]))
    claims += loop_claims(results.loop) if len(results.loop) else []
    targets = claim_table(claims, "Set out to reach")
    sections = [
        _walking_section(results, folder),
        *((_loop_section(results, folder),) if len(results.loop) else ()),
        weights_section(weighing, folder),
        *((_sensitivity_section(results, folder),) if len(results.sensitivity) else ()),
        *failure_section(results.failures),
        _repeat_section(results),
        Section("targets", "What was set out to reach", tables=(targets,)),
    ]
    lead = _lead(results, folder) if len(results.loop) else None
    amount = _say(
        "amount",
        seeds=plural(options.seeds, "seed"),
        speeds=", ".join(f"{speed:g}" for speed in results.speeds),
        duration=options.duration,
        stand=STAND_TIME,
        settle=options.settle,
    )
    introduction = (_say("introduction"), amount)
    title = "Walking on bad feet, and on calibrated ones"
    return publish(options.out, title, introduction, sections, lead=lead)


def _figure(path: Path, name: str, caption: str, **values: Any) -> ReportFigure:
    return ReportFigure(path, name, _caption(caption, **values))


def _lead(results: ArenaResults, folder: Path) -> Section:
    """Return what a person sees first: the worst feet that were walked on."""
    film, loop = results.film, results.loop
    loop = loop[loop["severity"] == loop["severity"].max()]
    # In the middle of the paper's speeds, if it was walked.
    speed = results.speeds[len(results.speeds) // 2]
    curves = error_curves(folder / "lead.svg", dict([_errors(results, BAD, speed)]))
    paragraphs = [findings.lead_finding(loop)]
    video: dict[str, Any] = {}
    if film.path is None or film.still is None or results.filmed is None:
        paragraphs.append(f"There is no film in this report: {film.problem.rstrip('.')}.")
    else:
        severity, at, seed = results.filmed
        caption = _caption("film", severity=severity, speed=at, seed=seed)
        video = {"video": film.path.name, "poster": film.still.name, "video_caption": caption}
    own = results.yardsticks[results.yardsticks["speed"] == speed]
    return Section(
        "lead",
        "What was done",
        tuple(paragraphs),
        tables=(tables.lead_table(own, loop[loop["speed"] == speed], BAD.name, f"In short: {speed:g} m/s"),),
        figures=(_figure(curves, "How far off the CoP is", "errors_over_time"),),
        **video,
    )


def _errors(results: ArenaResults, condition: Condition, speed: float) -> tuple[str, Frame]:
    """Return a title, and the errors over time of one condition and speed, while it walks."""
    errors = results.errors
    shown = errors["scenario"] == PAPER_SCENARIOS[condition.name, speed].name
    shown &= (errors["time"] > STAND_TIME) & errors["method"].isin([TRUE_MAP, *METHODS])
    return f"{condition.title}, {speed:g} m/s", errors[shown]


def _walking_section(results: ArenaResults, folder: Path) -> Section:
    scores, conditions = results.yardsticks, [(PAPER.name, "the paper's"), (BAD.name, BAD.title)]
    said = list(findings.baseline_findings(scores, PAPER.name))
    for condition in CONDITIONS:
        said += findings.truth_findings(scores, condition.name, condition.title)
    published = {(m, speed): errors for speed, by in WALKING_TABLES.items() for m, errors in by.items()}
    shown = scores[scores["method"].isin([TRUE_MAP, *METHODS])]
    rows = pd.concat(_of(shown, *yardstick) for yardstick in YARDSTICKS)
    overview = figures.rmse_overview(folder / "overview.svg", rows, published)
    drawn = [_figure(overview, "All speeds at once", "overview")]
    for speed in results.speeds:
        drawn += _speed_figures(results.traces, speed, folder)
    panels = dict(_errors(results, condition, speed) for condition in CONDITIONS for speed in results.speeds)
    curves = error_curves(folder / "errors_over_time.svg", panels, max(len(results.speeds), 2))
    drawn.append(_figure(curves, "Errors over time", "errors_over_time"))
    texts = (
        _say("conditions", paper=PAPER.title.capitalize(), bad=BAD.title.capitalize()),
        _say("yardsticks"),
        _say("definitions"),
    )
    laid_out = tuple(tables.walking_table(scores, speed, conditions) for speed in results.speeds)
    title = "Calibrating while walking"
    return Section("walking", title, texts, tuple(said), laid_out, figures=tuple(drawn))


def _of(scores: Frame, condition: Condition, against: str, title: str) -> Frame:
    """Return the scores of a condition and yardstick as a panel."""
    part = scores[(scores["condition"] == condition.name) & (scores["against"] == against)]
    return part.assign(panel=title, paper=against == "baseline")


def _speed_figures(traces: Frame, speed: float, folder: Path) -> list[ReportFigure]:
    here = traces[traces["speed"] == speed]
    shown = {condition.title: here[here["condition"] == condition.name] for condition in CONDITIONS}
    first, second = (f"Figure {number}" for number in PAPER_FIGURES.get(speed, ("CoP", "vGRF")))
    tag = f"{speed:g}".replace(".", "_")
    return [
        _figure(figures.cop_over_time(folder / f"cop_{tag}.svg", shown), first, "cop", speed=speed),
        _figure(figures.vgrf_over_time(folder / f"vgrf_{tag}.svg", shown), second, "vgrf", speed=speed),
    ]


def _loop_section(results: ArenaResults, folder: Path) -> Section:
    horizon, drawn = results.options.loop_duration, []
    for severity, runs in results.loop.groupby("severity", sort=False):
        path = folder / f"closed_loop_severity{severity:g}.svg"
        figures.closed_loop_survival(path, runs, horizon)
        drawn.append(_figure(path, f"Who falls when, severity {severity:g}", "closed_loop"))
    said = tuple(findings.loop_findings(results.loop, horizon))
    shown: Any = {"tables": (tables.loop_table(results.loop, horizon),), "figures": tuple(drawn)}
    return Section("closed-loop", "Closing the loop", (_say("loop", stand=STAND_TIME),), said, **shown)


def _sensitivity_section(results: ArenaResults, folder: Path) -> Section:
    parts = {y[2]: _of(results.sensitivity, *y) for y in (YARDSTICKS[0], YARDSTICKS[2])}
    curves = figures.sensitivity_curves(folder / "sensitivity.svg", pd.concat(parts.values()))
    return Section(
        "sensitivity",
        "How much hangs on the window's weights",
        (_say("sensitivity"),),
        tuple(
            f"{title.capitalize()}: {sentence}"
            for title, part in parts.items()
            for sentence in findings.sensitivity_findings(part)
        ),
        tuple(tables.sensitivity_table(part, title) for title, part in parts.items()),
        figures=(_figure(curves, "Sensitivity", "weights"),),
    )


def _repeat_section(results: ArenaResults) -> Section:
    options = results.options
    speed, seed = results.speeds[-1], options.seeds - 1
    scenario = PAPER_SCENARIOS[BAD.name, speed]
    log = log_paths(scenario.walk, seed, options.duration, options.logs)[scenario.condition]
    severity = max(options.loops, default=1.0)
    commands = (
        f"surefoot calibrate walk {log} --method window --settle {options.settle:g}",
        f"surefoot view --feed none --severity {severity:g} --speed {speed:g} --seed {seed} "
        f"--duration {options.loop_duration:g} --video walk.mp4",
        f"surefoot compare walking --full --seeds 10 --jobs {options.jobs}",
    )
    return repeat_section(_say("repeat"), commands, results.seconds)
