"""``surefoot demo``: the same walks on bad feet and on calibrated ones; a film, a figure and two tables.

Walks of a NAO are recorded from a bad start (cells that were never calibrated), and every method replays the
same recordings. Then a stabiliser walks in closed loop on feet that are three times as bad: on the true
centre of pressure (CoP), on drifting readings, and on calibrated ones. ``benchmarks/cop_paper.py`` does the
same at length.
"""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surefoot.calibration import METHODS
from surefoot.experiments.evaluate.figures import survival_curves
from surefoot.experiments.logs.format import write_log
from surefoot.experiments.study.figures import by_way, look_of
from surefoot.experiments.study.page import Report, ReportFigure, Section, failure_section, publish
from surefoot.experiments.study.progress import working
from surefoot.experiments.study.runner import Runner, runner
from surefoot.experiments.study.store import Case, Store
from surefoot.experiments.study.tables import Cell, Frame, Table, count_of, mean_of, plural, table_of
from surefoot.experiments.walks.figures import error_curves
from surefoot.experiments.walks.loop import Walk
from surefoot.experiments.walks.record import record_walk
from surefoot.experiments.walks.replay import replay_log, starting_map
from surefoot.experiments.walks.score import errors_of, running_errors, score_forces
from surefoot.experiments.walks.video import FILM, STILL, join_reels, prepare_rendering, shoot_walk
from surefoot.experiments.walks.walkers import STAND_TIME

SPEED, SEVERITY = 0.04, 3.0
FEEDS = ("true", "none", "tare", "window", "moment")  # of the closed loop
DURATION, SETTLE = STAND_TIME + 26.0, STAND_TIME + 10.0  # of a recorded walk in s, and from when errors count
LOOP_DURATION = STAND_TIME + 16.0  # of a walk in closed loop in s
FILM_DURATION = STAND_TIME + 7.0
FALL_TO_SHOW = STAND_TIME + 5.0  # time in s around which the filmed robot should fall: after some steps
SLICE = 1.0  # time in s between points of the curves

INTRODUCTION = (
    "A NAO-class biped of 5.3 kg walks in MuJoCo on eight load cells, four under each foot. The cells were "
    "never calibrated: scales are off by 12 % and offsets by 1.5 N (one standard deviation), and they drift "
    "by 2 % and 1 N per square root of a minute. Each walk is recorded once, and every method gets the same "
    "readings, together with what a robot knows about itself: late and noisy encoders and IMU, and a model "
    "whose mass and centre of mass are off. The truth is only used for the scores.",
    "In closed loop the same stabiliser holds the CoP that it is fed against the planned one and moves the "
    "ankles. Only the feet differ. This robot also walks without a stabiliser: what falls, falls by acting "
    "on wrong readings.",
)


def run_demo(out: Path, seeds: int = 4, jobs: int = 2, *, quick: bool = False) -> Report:
    """Record, replay, close the loop and film, and write ``report.html``.

    Args:
        out: The folder of all results; ``logs`` in it has the recorded walks.
        seeds: How many walks, recorded and in closed loop.
        jobs: Processes that work at the same time.
        quick: Two seeds and short walks.
    """
    prepare_rendering()
    numbers, shorter = (range(min(seeds, 2)), 16.0) if quick else (range(seeds), 0.0)
    times = DURATION - shorter, SETTLE - 0.5 * shorter
    recorded = [Case(f"walk {n}", record_and_replay, (n, *times, out / "logs"), (n, *times)) for n in numbers]
    walks = [Walk(feed, SPEED, n, LOOP_DURATION - shorter, SEVERITY) for feed in FEEDS for n in numbers]
    looped = [Case(f"{walk}", close_loop, (walk,)) for walk in walks]
    store = Store(out / "results")
    with store.open_for(), runner(jobs) as work:
        if not (out / "logs").is_dir():
            store.outcomes.clear()  # a case that is kept would leave its log missing
        work.run("record and replay", recorded, store)
        work.run("close the loop", looped, store)
        failures = store.failures([*recorded, *looped])
        scores, errors = (store.rows(name, recorded) for name in ("scores", "errors"))
        loop = store.rows("loop", looped)
        if not (len(scores) and len(loop)):
            raise ValueError(f"Nothing could be walked: {next(iter(failures.values())).splitlines()[-1]}")
        filmed = _film(work, out, loop, FILM_DURATION - 0.25 * shorter)
    with working("drawing the report"):
        return _write(out, scores, errors, loop, filmed, failures)


def record_and_replay(seed: int, duration: float, settle: float, folder: Path) -> dict[str, Any]:
    """Record a walk as a log, and score each method on it: ``scores``, and ``errors`` over time."""
    log = record_walk(SPEED, seed, duration)["bad-start"]
    assert log.truth is not None
    write_log(log, folder / f"walk_seed{seed}.parquet")
    poses: Any = {"position_sole": log.truth.position_sole, "R_world_sole": log.truth.R_world_sole}
    scores, errors = [], []
    for method in METHODS:
        force = replay_log(log, method, starting_map(log)).force
        known: Any = {"layout": log.layout, **poses}
        score = score_forces(force, log.truth.force, time=log.time, settle=settle, **known)
        about = {"seed": seed, "method": method}
        scores.append(about | score._asdict())
        cop = errors_of(force, log.truth.force, **known).cop
        errors += [about | row for row in running_errors(log.time, cop, SLICE) if row["time"] > STAND_TIME]
    return {"scores": scores, "errors": errors}


def close_loop(walk: Walk) -> dict[str, Any]:
    """Run a walk in closed loop."""
    return {"loop": [walk.row()]}


def choose_walk_to_film(loop: Frame) -> int:
    """Return a seed whose robot falls after some steps on raw readings and stays up on calibrated ones."""
    fell = loop.pivot(index="seed", columns="feed", values="fell").astype(bool)
    telling = (
        fell.index[fell["none"] & ~fell["moment"]] if {"none", "moment"} <= set(fell) else fell.index[:0]
    )
    if not len(telling):
        return int(loop["seed"].iloc[0])
    time = loop[loop["feed"] == "none"].set_index("seed")["time"].loc[telling]
    return int((time - FALL_TO_SHOW).abs().idxmin())


def _film(work: Runner, out: Path, loop: Frame, duration: float) -> int | str:
    """Film two feeds of one seed side by side; return the seed, or why there is no film."""
    seed = choose_walk_to_film(loop)
    walks = [Walk(feed, SPEED, seed, duration, SEVERITY) for feed in ("none", "moment")]
    try:
        join_reels(out, *work.do("film", [(shoot_walk, (walk,)) for walk in walks]))
    except OSError as error:
        return str(error)
    return seed


def lead_table(loop: Frame) -> Table:
    """Return who falls on which feed."""
    columns: dict[str, Cell] = {
        "the controller is fed": lambda item: look_of(item[0]).label,
        "walks that fall": lambda item: count_of("fell")(item[1]),
        "time on its feet (s)": lambda item: mean_of("time")(item[1]),
        "error of the CoP fed (mm)": lambda item: mean_of("cop_error", 1e3)(item[1]),
    }
    note = "The same seeds, ground and cells for every feed, three times as bad as cheap cells."
    return table_of("lead", "In closed loop", columns, by_way(loop, "feed").items(), note)


def score_table(scores: Frame) -> Table:
    """Return the errors of each method on the recorded walks."""
    columns: dict[str, Cell] = {
        "method": lambda runs: look_of(runs["method"].iloc[0]).label,
        "CoP (mm)": mean_of("cop", 1e3),
        "foot's CoP (mm)": mean_of("cop_foot", 1e3),
        "vertical force (N)": mean_of("vgrf"),
        "single cell (N)": mean_of("cell"),
    }
    note = "Root mean squares while walking, mean over walks with the 95 % interval."
    return table_of("scores", "On recorded walks", columns, by_way(scores).values(), note)


def _write(
    out: Path, scores: Frame, errors: Frame, loop: Frame, filmed: int | str, failures: Mapping[str, str]
) -> Report:
    falls = {feed: int(part["fell"].sum()) for feed, part in loop.groupby("feed")}
    walks = plural(loop["seed"].nunique(), "walk")
    said = [
        f"On drifting raw readings the robot falls in {falls.get('none', 0)} of {walks}, on feet that the "
        f"moment filter calibrates in {falls.get('moment', 0)}, on the true CoP in {falls.get('true', 0)}."
    ]
    video: dict[str, Any] = {}
    if isinstance(filmed, str):
        said.append(f"There is no film: {filmed.rstrip('.')}.")
    else:
        caption = (
            f"Seed {filmed}, severity {SEVERITY:g}: left on drifting raw feet, right on feet that the moment "
            "filter calibrates. Below, the soles from above: the black dot is the true CoP, the coloured "
            "one is fed."
        )
        video = {"video": FILM, "poster": STILL, "video_caption": caption}
    curves = error_curves(out / "figures" / "errors_over_time.svg", {f"{SPEED:g} m/s": errors}, 1)
    caption = "Error of the CoP over the last 2 s: median over the walks, and quartiles shaded."
    figure = ReportFigure(curves, "How far off the CoP is", caption)
    tables = (lead_table(loop), score_table(scores))
    lead = Section("lead", "What was done", tuple(said), tables=tables, figures=(figure,), **video)
    standing = survival_curves(
        out / "figures" / "survival.svg", loop.assign(policy="stabiliser", severity=SEVERITY)
    )
    caption = "Share of walks on their feet over time (Kaplan and Meier) with 95 % bands."
    log = sorted((out / "logs").glob("*.parquet"))[-1]
    view = f"surefoot view --feed none --severity {SEVERITY:g} --speed {SPEED:g} --seed 0"
    sections = [
        Section("closed-loop", "Who falls when", figures=(ReportFigure(standing, "Survival", caption),)),
        *failure_section(failures),
        Section("repeat", "Try it", commands=(f"surefoot calibrate walk {shlex.quote(str(log))}", view)),
    ]
    return publish(out, "Walking on bad feet, and on calibrated ones", INTRODUCTION, sections, lead=lead)
