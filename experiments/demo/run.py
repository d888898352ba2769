"""The demo: walk, record, calibrate the same streams by every method, close the loop, and report.

Everything lands in one folder: logs, tables, figures, a film, ``results.json`` and the page ``report.html``.
"""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console

from surefoot.calibration import METHODS
from surefoot.experiments.demo.jobs import (
    WEIGHTS,
    Outcome,
    record_job,
    replay_job,
    sensitivity_job,
    window_update_ms,
)
from surefoot.experiments.demo.options import DemoOptions
from surefoot.experiments.study.files import atomic_path, write_text
from surefoot.experiments.study.runner import Runner, machine, runner
from surefoot.experiments.study.tables import Frame
from surefoot.experiments.walks.closed_loop import LoopRun, run_loop
from surefoot.experiments.walks.video import Film, Reel, join_reels, prepare_rendering, shoot
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.experiments.weights.weighing import WeighingReport, run_weighing

__all__ = ["DemoResults", "run_demo"]


@dataclass(eq=False)
class DemoResults:
    """What the demo found.

    Attributes:
        options: How it was run.
        bench: The virtual bench.
        scores: One row a walk, way to read the feet and yardstick.
        errors: Errors over time.
        outcomes: Ways to read the first walk, by condition and speed.
        sensitivity: Rows of the sensitivity study.
        loop: Rows of the closed loop.
        film: The film, or why there is none.
        filmed: Severity, speed in m/s and seed of the film.
        update_ms: Median time of an update of the window in ms.
        seconds: Time that each part took in s.
        machine: What it ran on.
    """

    options: DemoOptions
    bench: WeighingReport
    scores: Frame = field(default_factory=pd.DataFrame)
    errors: Frame = field(default_factory=pd.DataFrame)
    outcomes: dict[tuple[str, float], list[Outcome]] = field(default_factory=dict)
    sensitivity: Frame = field(default_factory=pd.DataFrame)
    loop: Frame = field(default_factory=pd.DataFrame)
    film: Film = field(default_factory=lambda: Film(None, None, "not asked for"))
    filmed: tuple[float, float, int] | None = None
    update_ms: float = float("nan")
    seconds: dict[str, float] = field(default_factory=dict)
    machine: str = ""


def run_demo(options: DemoOptions, console: Console | None = None) -> DemoResults:
    """Do everything but the page: walk, record, replay, close the loop, film.

    Args:
        options: How much.
        console: Where progress is shown.

    Returns:
        What was found; it is in files under ``options.out`` as well.
    """
    prepare_rendering()
    results = DemoResults(options, run_weighing(), machine=machine())
    with runner(options.jobs, results.seconds, console) as stage:
        logs = _record(stage, options)
        _replay(stage, results, logs)
        _sensitivity(stage, results, logs)
        _close_the_loop(stage, results)
    results.update_ms = window_update_ms(logs[options.speeds[0]][0][0])
    _save(results)
    return results


Logs = dict[float, list[list[Path]]]
"""Logs of each speed: one list a seed, one log a condition."""


def _record(stage: Runner, options: DemoOptions) -> Logs:
    folder = options.out / "logs"
    cells = [(speed, seed) for speed in options.speeds for seed in range(options.seeds)]
    found = stage.do("walk and record", [(record_job, (*cell, options.duration, folder)) for cell in cells])
    logs: Logs = {}
    for (speed, _), paths in zip(cells, found, strict=True):
        logs.setdefault(speed, []).append(list(paths.values()))
    return logs


def _replay(stage: Runner, results: DemoResults, logs: Logs) -> None:
    names = ["truth", "floor", "baseline", "reference", *METHODS]
    work: list[Any] = [
        (replay_job, (_flat(logs[speed]), name, results.options.settle)) for speed in logs for name in names
    ]
    outcomes: list[Outcome] = [o for found in stage.do("replay through every method", work) for o in found]
    for outcome in outcomes:
        results.outcomes.setdefault((outcome.condition, outcome.speed), []).append(outcome)
    results.scores = pd.DataFrame([row for outcome in outcomes for row in outcome.scores])
    results.errors = pd.DataFrame([row for outcome in outcomes for row in outcome.errors])


def _sensitivity(stage: Runner, results: DemoResults, logs: Logs) -> None:
    options = results.options
    work: list[Any] = [
        (sensitivity_job, (_flat(logs[speed][: options.sensitivity_seeds]), weight, factor, options.settle))
        for speed in logs
        for weight in WEIGHTS
        for factor in options.factors
        if factor != 1.0
    ]
    scaled = pd.DataFrame([row for rows in stage.do("scale the window's weights", work) for row in rows])
    # Weights as they are were replayed already.
    scores = results.scores
    plain = scores[(scores["method"] == "window") & (scores["seed"] < options.sensitivity_seeds)]
    as_they_are = [plain.assign(weight=weight, factor=1.0) for weight in WEIGHTS]
    results.sensitivity = pd.concat([scaled, *as_they_are], ignore_index=True)


def _flat(paths: list[list[Path]]) -> list[Path]:
    return [path for of_seed in paths for path in of_seed]


def _close_the_loop(stage: Runner, results: DemoResults) -> None:
    options = results.options
    cells = [
        (severity, feed, speed, seed)
        for severity, feeds in options.loops.items()
        for speed in options.speeds
        for seed in range(options.seeds)
        for feed in feeds
    ]
    work: list[Any] = [(_loop_job, (*cell, options.loop_duration)) for cell in cells]
    found: list[LoopRun] = stage.do("close the loop", work)
    results.loop = pd.DataFrame([asdict(run) for run in found])
    if options.film_duration > 0:
        severity = max(options.loops)
        speed, seed = _telling_seed(results.loop[results.loop["severity"] == severity])
        results.filmed = (severity, speed, seed)
        shots: list[Any] = [
            (_film_job, (feed, speed, seed, options.film_duration, severity)) for feed in ("none", "moment")
        ]
        results.film = join_reels(options.out, *stage.do("film", shots))


def _loop_job(severity: float, feed: str, speed: float, seed: int, duration: float) -> LoopRun:
    return run_loop(feed, speed=speed, seed=seed, duration=duration, severity=severity)


def _film_job(feed: str, speed: float, seed: int, duration: float, severity: float) -> Reel:
    return shoot(feed, speed=speed, seed=seed, duration=duration, severity=severity)


def _telling_seed(loop: Frame) -> tuple[float, int]:
    """Choose the walk to film: raw it falls, if it may be after some steps; calibrated it does not."""
    fell = loop.pivot(index=["speed", "seed"], columns="feed", values="fell").astype(bool)
    if {"none", "moment"} <= set(fell.columns):
        telling = fell[fell["none"] & ~fell["moment"]]
        if len(telling):
            time = loop[loop["feed"] == "none"].set_index(["speed", "seed"])["time"].loc[telling.index]
            where: Any = (time - (STAND_TIME + 6.0)).abs().idxmin()
            speed, seed = where
            return float(speed), int(seed)
    return float(loop["speed"].iloc[0]), int(loop["seed"].iloc[0])


def _save(results: DemoResults) -> None:
    out = results.options.out
    for name in ("scores", "errors", "sensitivity", "loop"):
        with atomic_path(out / "tables" / f"{name}.csv") as part:
            getattr(results, name).to_csv(part, index=False)
    facts = {
        "options": {
            key: str(value) if isinstance(value, Path) else value
            for key, value in asdict(results.options).items()
        },
        "machine": results.machine,
        "seconds": results.seconds,
        "window_update_ms": results.update_ms,
        "bench": {
            "initial": asdict(results.bench.initial),
            "calibrated": asdict(results.bench.calibrated),
        },
        "film": results.film.problem or "walk.mp4",
    }
    write_text(out / "results.json", json.dumps(facts, indent=1))
