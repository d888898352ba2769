"""A study of walks: the same recorded streams, several methods, many seeds; and walks on the feet themselves.

Everything lands in one folder: logs, results, tables, figures and the page. What is finished is kept, so that
a run that was interrupted goes on where it was, and a new method is scored without the old ones.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from surefoot.experiments.arena.cases import Bound, LogBound, bound_case, loop_case, score_case, time_method
from surefoot.experiments.arena.options import TRUE_MAP, ArenaOptions
from surefoot.experiments.arena.scenarios import Scenario, scenarios_named
from surefoot.experiments.arena.streams import logs_folder
from surefoot.experiments.arena.walks import log_paths, record_missing
from surefoot.experiments.arena.yardsticks import OTHER_WAYS
from surefoot.experiments.study.files import atomic_path, write_text
from surefoot.experiments.study.runner import Runner, machine, runner
from surefoot.experiments.study.store import Case, Store
from surefoot.experiments.study.tables import Frame
from surefoot.experiments.walks.video import Film, join_reels, prepare_rendering, shoot
from surefoot.experiments.walks.walkers import STAND_TIME

__all__ = ["WEIGHTS", "ArenaResults", "run_arena"]

WEIGHTS = {"w_F": "force_weight", "w_P": "cop_weight", "w_S": "smoothness_weight"}
"""The weights of Eq. 14, and the window's options that scale them."""

FALL_TO_SHOW = STAND_TIME + 6.0
"""Time in s at about which the raw walker of a film best falls: after some steps."""


@dataclass(eq=False)
class ArenaResults:
    """What a study of walks found.

    Attributes:
        options: How it was run.
        scenarios: What was run, in order.
        scores: One row a run: ``scenario``, ``method`` and what :mod:`surefoot.experiments.arena.score`
            names.
        errors: Running CoP errors: ``scenario``, ``method``, ``seed``, ``time`` (s), ``cop`` (m).
        yardsticks: Errors as the CoP paper scores them, see :mod:`surefoot.experiments.arena.yardsticks`.
        traces: Ends of walks, see there.
        sensitivity: The same for the window with a weight scaled: ``weight``, ``factor``.
        loop: One row a closed loop, see :class:`~surefoot.experiments.walks.closed_loop.LoopRun`.
        film: The film, or why there is none.
        filmed: Severity, speed in m/s and seed of the film.
        left_out: Walks of each scenario that ended in a fall before they were worth a score.
        timing: Time of one robot's update by ``method``, see
            :func:`~surefoot.experiments.arena.cases.time_method`.
        failures: What was raised in cases that failed, by their names.
        seconds: Time that each stage took in s.
        machine: What it ran on.
    """

    options: ArenaOptions
    scenarios: tuple[Scenario, ...]
    scores: Frame = field(default_factory=pd.DataFrame)
    errors: Frame = field(default_factory=pd.DataFrame)
    yardsticks: Frame = field(default_factory=pd.DataFrame)
    traces: Frame = field(default_factory=pd.DataFrame)
    sensitivity: Frame = field(default_factory=pd.DataFrame)
    loop: Frame = field(default_factory=pd.DataFrame)
    film: Film = field(default_factory=lambda: Film(None, None, "not asked for"))
    filmed: tuple[float, float, int] | None = None
    left_out: dict[str, int] = field(default_factory=dict)
    timing: Frame = field(default_factory=pd.DataFrame)
    failures: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    machine: str = ""

    @property
    def speeds(self) -> tuple[float, ...]:
        """Speeds of the walks that are scored as the CoP paper scores, in m/s."""
        return tuple(dict.fromkeys(scenario.walk.speed for scenario in self.scenarios if scenario.paper))


def run_arena(
    options: ArenaOptions, *, bound: Bound | None = None, console: Console | None = None
) -> ArenaResults:
    """Do everything but the page: walk, record, replay, score, time, close the loop, film.

    Args:
        options: How much.
        bound: Computes what no estimator can go below; ``None`` leaves it out.
        console: Where progress is shown.

    Returns:
        What was found; it is in files under ``options.out`` as well.

    Raises:
        ValueError: If there is no scenario of a name, or nothing in them that could be scored.
        StudyError: If the folder cannot be used.
    """
    prepare_rendering()
    chosen = scenarios_named(options.scenarios, quick=options.quick)
    results = ArenaResults(options, chosen, machine=machine())
    scored = [score_case(s, m, options) for s in chosen for m in options.rows]
    scored += [score_case(s, way, options) for s in chosen if s.paper for way in OTHER_WAYS]
    bounds = [] if bound is None else [bound_case(scenario, options, bound) for scenario in chosen]
    fewer = replace(options, seeds=min(options.seeds, options.sensitivity_seeds))
    scaled = {
        (weight, factor): [score_case(s, "window", fewer, {changed: factor}) for s in chosen if s.paper]
        for weight, changed in WEIGHTS.items()
        for factor in options.factors
        if factor != 1.0
    }
    loops = [
        loop_case(severity, feed, speed, seed, options.loop_duration)
        for severity, feeds in options.loops.items()
        for speed in results.speeds
        for seed in range(options.seeds)
        for feed in feeds
    ]
    store = Store(options.out / "results")
    with store.opened(), runner(options.jobs, results.seconds, console) as run:
        run.do("walk and record", _recordings(chosen, options))
        run.run("replay and score", scored, store)
        if bounds:
            run.run("compute the bounds", bounds, store)
        if scaled:
            run.run(
                "scale the window's weights", [case for cases in scaled.values() for case in cases], store
            )
        if loops:
            run.run("close the loop", loops, store)
            results.loop = store.rows("loop", loops)
        results.timing = pd.DataFrame(run.do("time an update", _timings(results)))
        if options.film_duration > 0.0 and len(results.loop):
            _film(run, results)
    _collect(results, store, scored, scaled)
    if not len(results.scores):
        raise ValueError(_nothing(store, scored))
    limits = store.rows("bounds", bounds)
    columns = [f"bound_{part}" for part in LogBound.__dataclass_fields__]
    if len(limits):
        results.scores = results.scores.merge(limits, on=["scenario", "seed"], how="left")
    else:
        results.scores = results.scores.assign(**dict.fromkeys(columns, np.nan))
    results.failures = store.failures(
        [*scored, *bounds, *(c for cases in scaled.values() for c in cases), *loops]
    )
    _save(results)
    return results


def _recordings(chosen: tuple[Scenario, ...], options: ArenaOptions) -> list[Any]:
    """List every walk once, however many scenarios share it."""
    walks = {
        (scenario.walk.name, seed): (scenario.walk, seed)
        for scenario in chosen
        for seed in scenario.seeds(options.seeds)
    }
    folder = logs_folder(options)
    return [(record_missing, (walk, seed, options.duration, folder)) for walk, seed in walks.values()]


def _timings(results: ArenaResults) -> list[Any]:
    """List the methods with the first walk of the first scenario."""
    options, first = results.options, results.scenarios[0]
    path = log_paths(first.walk, 0, options.duration, logs_folder(options))[first.condition]
    return [(time_method, (path, m, first.options_of(m))) for m in options.rows if m != TRUE_MAP]


def _film(run: Runner, results: ArenaResults) -> None:
    options, severity = results.options, max(results.options.loops)
    speed, seed = telling_walk(results.loop[results.loop["severity"] == severity])
    results.filmed = (severity, speed, seed)
    filmed = partial(shoot, speed=speed, seed=seed, duration=options.film_duration, severity=severity)
    reels = run.do("film", [(filmed, (feed,)) for feed in ("none", "moment")])
    results.film = join_reels(options.out, *reels)


def telling_walk(loop: Frame) -> tuple[float, int]:
    """Return speed and seed of the walk to film: raw it falls, best after some steps; calibrated it does not.

    Args:
        loop: Closed loops of one severity.
    """
    fell = loop.pivot(index=["speed", "seed"], columns="feed", values="fell").astype(bool)
    if {"none", "moment"} <= set(fell.columns):
        telling = fell[fell["none"] & ~fell["moment"]]
        if len(telling):
            time = loop[loop["feed"] == "none"].set_index(["speed", "seed"])["time"].loc[telling.index]
            where: Any = (time - FALL_TO_SHOW).abs().idxmin()
            speed, seed = where
            return float(speed), int(seed)
    return float(loop["speed"].iloc[0]), int(loop["seed"].iloc[0])


def _collect(
    results: ArenaResults, store: Store, scored: list[Case], scaled: dict[tuple[str, float], list[Case]]
) -> None:
    for name in ("scores", "errors", "yardsticks", "traces"):
        setattr(results, name, store.rows(name, scored))
    left_out = store.rows("left_out", scored)
    if len(left_out):
        results.left_out = left_out.groupby("scenario", sort=False)["count"].first().astype(int).to_dict()
    if not scaled or not len(results.yardsticks):
        return
    frames = [
        store.rows("yardsticks", cases).assign(weight=weight, factor=factor)
        for (weight, factor), cases in scaled.items()
    ]
    # Weights as they are were replayed already.
    plain = results.yardsticks
    plain = plain[(plain["method"] == "window") & (plain["seed"] < results.options.sensitivity_seeds)]
    as_they_are = [plain.assign(weight=weight, factor=1.0) for weight in WEIGHTS]
    results.sensitivity = pd.concat([*frames, *as_they_are], ignore_index=True)


def _nothing(store: Store, scored: Iterable[Case]) -> str:
    """Return why there is no score at all."""
    if failures := store.failures(scored):
        name, error = next(iter(failures.items()))
        return f"No case could be scored. The first, '{name}': {error.splitlines()[-1]}"
    return "No walk lasted long enough to be scored: all ended in a fall; take other scenarios."


def _save(results: ArenaResults) -> None:
    out = results.options.out
    for name in ("scores", "errors", "timing", "yardsticks", "sensitivity", "loop"):
        frame = getattr(results, name)
        if len(frame):
            with atomic_path(out / "tables" / f"{name}.csv") as part:
                frame.to_csv(part, index=False)
            with atomic_path(out / "tables" / f"{name}.parquet") as part:
                frame.to_parquet(part)
    facts = {
        "options": results.options.as_dict(),
        "scenarios": {s.name: {"title": s.title, "answers": s.answers} for s in results.scenarios},
        "left_out": results.left_out,
        "film": results.film.problem or "walk.mp4",
        "machine": results.machine,
        "seconds": results.seconds,
    }
    write_text(out / "results.json", json.dumps(facts, indent=1))
