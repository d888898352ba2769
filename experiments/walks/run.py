"""A study of walks: the same recorded streams, several methods, many seeds; and walks on the feet themselves.

Finished cases are kept in the folder, so that a run that was interrupted goes on where it was.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.experiments.study.page import save_frames
from surefoot.experiments.study.runner import Runner, runner
from surefoot.experiments.study.sources import own_code
from surefoot.experiments.study.store import Case, Store
from surefoot.experiments.study.tables import Frame
from surefoot.experiments.walks.gait_cycle import cycle_rows
from surefoot.experiments.walks.loop import TABLE, Walk, loop_row
from surefoot.experiments.walks.options import WalkStudyOptions
from surefoot.experiments.walks.play import play, streams_of
from surefoot.experiments.walks.run_score import (
    OTHER_WAYS,
    other_way,
    run_errors,
    running_rmse,
    score_run,
    yardsticks_of,
)
from surefoot.experiments.walks.scenarios import TRUE_MAP, Scenario, find_scenarios, log_paths, record_missing
from surefoot.experiments.walks.video import join_reels, prepare_rendering, shoot_walk
from surefoot.experiments.walks.walkers import STAND_TIME

LOOP_COLUMNS = ("severity", "speed", "seed", "feed", "fell", "time", "cop_error")
FALL_TO_SHOW = STAND_TIME + 6.0  # s at about which the raw walker of a film best falls: after some steps
SLICE = 2.0  # time in s between points of the errors that are drawn over time

Tables = dict[str, list[dict[str, Any]]]


@dataclass(eq=False)
class WalkStudyResults:
    """The results of a study of walks."""

    options: WalkStudyOptions
    scenarios: tuple[Scenario, ...]
    scores: Frame = field(default_factory=pd.DataFrame)  # a row a run, see ``walks.run_score``
    errors: Frame = field(default_factory=pd.DataFrame)  # running, of the CoP: time (s), cop (m)
    yardsticks: Frame = field(default_factory=pd.DataFrame)  # as the CoP paper scores
    cycles: Frame = field(default_factory=pd.DataFrame)  # a row a run and foot, see ``walks.gait_cycle``
    loop: Frame = field(default_factory=pd.DataFrame)  # an episode a row: :data:`LOOP_COLUMNS`
    filmed: tuple[float, float, int] | str = "not asked for"  # severity, speed in m/s, seed; or why not
    left_out: dict[str, int] = field(default_factory=dict)  # falls before there was a score
    failures: dict[str, str] = field(default_factory=dict)  # raised, by case
    seconds: dict[str, float] = field(default_factory=dict)  # of each stage

    @property
    def speeds(self) -> tuple[float, ...]:
        """Speeds of the walks that are scored as the CoP paper scores, in m/s."""
        return tuple(dict.fromkeys(scenario.speed for scenario in self.scenarios if scenario.paper))


def run_walk_study(options: WalkStudyOptions) -> WalkStudyResults:
    """Walk, record, replay, score, close the loop, film, and save.

    Raises ValueError if there is no scenario of a name, nothing could be scored, or the folder cannot be
    used.
    """
    prepare_rendering()
    chosen = find_scenarios(options.scenarios, quick=options.quick)
    results = WalkStudyResults(options, chosen)
    scored = [score_case(s, m, options) for s in chosen for m in options.rows]
    scored += [score_case(s, way, options) for s in chosen if s.paper for way in OTHER_WAYS]
    loops = _loop_cases(options, results.speeds)
    stages = {
        "replay and score": scored,
        "close the loop": loops,
    }
    store = Store(options.out / "results")
    with store.open_for(), runner(options.jobs, results.seconds) as run:
        walks = {(s.walk, seed): (s, seed) for s in chosen for seed in s.seeds(options.seeds)}
        recordings = [(*walk, options.duration, options.logs) for walk in walks.values()]
        run.do("walk and record", [(record_missing, recording) for recording in recordings])
        for what, cases in stages.items():
            if cases:
                run.run(what, cases, store)
        if loops:
            found = store.rows(TABLE, stages["close the loop"])
            results.loop = found[list(LOOP_COLUMNS)]
        if options.film_duration > 0.0 and len(results.loop):
            _film(run, results)
    results.failures = store.failures([case for cases in stages.values() for case in cases])
    _collect(results, store, scored)
    names = ("scores", "errors", "yardsticks", "cycles", "loop")
    save_frames(options.out / "tables", {name: getattr(results, name) for name in names})
    return results


def _loop_cases(options: WalkStudyOptions, speeds: tuple[float, ...]) -> list[Case]:
    """List the closed loops of the stabiliser: its walks on each feed, by severity and speed in m/s."""
    seeds = tuple(range(options.seeds))[: options.loop_seeds]
    walks = [
        Walk(feed, speed, seed, options.loop_duration, severity)
        for severity, feeds in options.loops.items()
        for speed in speeds
        for feed in feeds
        for seed in seeds
    ]
    return [Case(f"{walk}", loop_row, (walk,), (walk, *own_code(walk.feed))) for walk in walks]


def _film(run: Runner, results: WalkStudyResults) -> None:
    options, severity = results.options, max(results.options.loops)
    speed, seed = choose_walk_to_film(results.loop[results.loop["severity"] == severity])
    walks = [Walk(feed, speed, seed, options.film_duration, severity) for feed in ("none", "moment")]
    try:
        join_reels(options.out, *run.do("film", [(shoot_walk, (walk,)) for walk in walks]))
        results.filmed = (severity, speed, seed)
    except OSError as error:
        results.filmed = str(error)


def choose_walk_to_film(loop: Frame) -> tuple[float, int]:
    """Return speed and seed of the walk to film: raw it falls, best after some steps, calibrated not."""
    fell = loop.pivot(index=["speed", "seed"], columns="feed", values="fell").astype(bool)
    if {"none", "moment"} <= set(fell.columns):
        telling = fell[fell["none"] & ~fell["moment"]]
        if len(telling):
            time = loop[loop["feed"] == "none"].set_index(["speed", "seed"])["time"].loc[telling.index]
            speed, seed = (time - FALL_TO_SHOW).abs().idxmin()
            return float(speed), int(seed)
    return float(loop["speed"].iloc[0]), int(loop["seed"].iloc[0])


def _collect(results: WalkStudyResults, store: Store, scored: list[Case]) -> None:
    for name in ("scores", "errors", "yardsticks", "cycles"):
        setattr(results, name, store.rows(name, scored))
    if not len(results.scores):
        for name, error in store.failures(scored).items():
            raise ValueError(f"No case could be scored. The first, '{name}': {error.splitlines()[-1]}")
        raise ValueError(
            "No walk lasted long enough to be scored: all ended in a fall; take other scenarios."
        )
    left_out = store.rows("left_out", scored)
    results.left_out = left_out.groupby("scenario", sort=False)["count"].first().astype(int).to_dict()


def score_case(scenario: Scenario, method: str, options: WalkStudyOptions) -> Case:
    """Return the case of one method, or of one of :data:`OTHER_WAYS`, on one scenario.

    Its tables are ``scores`` (one row a run), ``errors`` (over time) and ``left_out`` (how many walks were),
    and for the scenarios of the CoP paper ``yardsticks`` and ``cycles``.
    """
    depends = (method, _depends(scenario, options), *own_code(method))
    return Case(f"{scenario.name} {method}", _score, (scenario, method, options), depends)


def _depends(scenario: Scenario, options: WalkStudyOptions) -> tuple[Any, ...]:
    """Options and logs that decide a scenario's results; a log's name is a hash of all that made it."""
    logs = [
        str(log_paths(scenario, seed, options.duration, Path())[scenario.condition])
        for seed in scenario.seeds(options.seeds)
    ]
    return scenario, options.duration, options.settle, logs


def _score(scenario: Scenario, method: str, options: WalkStudyOptions) -> Tables:
    streams, left_out = streams_of(scenario, options)
    row = {"scenario": scenario.name, "method": method}
    found: Tables = {"scores": [], "errors": [], "left_out": [{**row, "count": left_out}]}
    if method in OTHER_WAYS:
        rows = [one for stream in streams for one in other_way(stream, method, options.settle)]
        return {**found, "yardsticks": rows}
    played_by_method = play(streams, method, **scenario.options_of(method))
    for stream, played in zip(streams, played_by_method, strict=True):
        found["scores"].append({**row, **score_run(stream, played)})
        running = running_rmse(stream.log.time, run_errors(stream, played.force).cop)
        every = max(round(SLICE / stream.log.dt), 1)
        found["errors"] += [
            {**row, "seed": stream.seed, "time": float(moment), "cop": float(value)}
            for moment, value in zip(stream.log.time[::every], running[::every], strict=True)
        ]
        if scenario.paper:
            rows = yardsticks_of(stream, method, played.force, options.settle)
            found.setdefault("yardsticks", []).extend(rows)
            ways = {method: played.force} | ({"truth": stream.truth.force} if method == TRUE_MAP else {})
            found.setdefault("cycles", []).extend(
                {**row, "seed": stream.seed, "method": way, **cycle}
                for way, force in ways.items()
                for cycle in cycle_rows(stream, force)
            )
    return found
