"""A study of walks: the same recorded streams, several methods, many seeds; and walks on the feet themselves.

What is finished is kept in the folder, so that a run that was interrupted goes on where it was.
"""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from surefoot.experiments.study.page import save_facts, save_frames
from surefoot.experiments.study.runner import Runner, machine, runner
from surefoot.experiments.study.store import Case, Store
from surefoot.experiments.study.tables import Frame
from surefoot.experiments.walks.cases import bound_case, loop_case, score_case, time_method
from surefoot.experiments.walks.options import TRUE_MAP, ArenaOptions
from surefoot.experiments.walks.recordings import log_paths, record_missing
from surefoot.experiments.walks.scenarios import Scenario, scenarios_named
from surefoot.experiments.walks.video import Film, join_reels, prepare_rendering, shoot
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.experiments.walks.yardsticks import OTHER_WAYS

WEIGHTS = {"w_F": "force_weight", "w_P": "cop_weight", "w_S": "smoothness_weight"}  # of Eq. 14
FALL_TO_SHOW = STAND_TIME + 6.0  # s at about which the raw walker of a film best falls: after some steps


@dataclass(eq=False)
class ArenaResults:
    """What a study of walks found."""

    options: ArenaOptions
    scenarios: tuple[Scenario, ...]
    scores: Frame = field(default_factory=pd.DataFrame)  # a row a run, see ``arena.score``
    errors: Frame = field(default_factory=pd.DataFrame)  # running, of the CoP: time (s), cop (m)
    yardsticks: Frame = field(default_factory=pd.DataFrame)  # as the CoP paper scores
    traces: Frame = field(default_factory=pd.DataFrame)  # ends of walks
    sensitivity: Frame = field(default_factory=pd.DataFrame)  # yardsticks of the window, a weight scaled
    loop: Frame = field(default_factory=pd.DataFrame)  # a row a closed loop, see :class:`LoopRun`
    timing: Frame = field(default_factory=pd.DataFrame)  # see :func:`time_method`
    film: Film = field(default_factory=lambda: Film(None, None, "not asked for"))
    filmed: tuple[float, float, int] | None = None  # severity, speed in m/s, seed
    left_out: dict[str, int] = field(default_factory=dict)  # falls before there was a score
    failures: dict[str, str] = field(default_factory=dict)  # raised, by case
    seconds: dict[str, float] = field(default_factory=dict)  # of each stage

    @property
    def speeds(self) -> tuple[float, ...]:
        """Speeds of the walks that are scored as the CoP paper scores, in m/s."""
        return tuple(dict.fromkeys(scenario.walk.speed for scenario in self.scenarios if scenario.paper))


def run_arena(options: ArenaOptions, *, bounds: bool = False) -> ArenaResults:
    """Walk, record, replay, score, time, close the loop, film, and save; bounds on errors if asked for.

    Raises ValueError if there is no scenario of a name, nothing could be scored, or the folder cannot be
    used.
    """
    prepare_rendering()
    chosen = scenarios_named(options.scenarios, quick=options.quick)
    results = ArenaResults(options, chosen)
    scored = [score_case(s, m, options) for s in chosen for m in options.rows]
    scored += [score_case(s, way, options) for s in chosen if s.paper for way in OTHER_WAYS]
    fewer = replace(options, seeds=min(options.seeds, options.sensitivity_seeds))
    scaled = {
        (weight, factor): [score_case(s, "window", fewer, {changed: factor}) for s in chosen if s.paper]
        for weight, changed in WEIGHTS.items()
        for factor in options.factors
        if factor != 1.0
    }
    stages = {
        "replay and score": scored,
        "compute the bounds": [bound_case(s, options) for s in chosen] if bounds else [],
        "scale the window's weights": [case for cases in scaled.values() for case in cases],
        "close the loop": [
            loop_case(severity, feed, speed, seed, options.loop_duration)
            for severity, feeds in options.loops.items()
            for speed in results.speeds
            for seed in range(options.seeds)
            for feed in feeds
        ],
    }
    store = Store(options.out / "results")
    with store.opened(), runner(options.jobs, results.seconds) as run:
        walks = {(s.walk.name, seed): (s.walk, seed) for s in chosen for seed in s.seeds(options.seeds)}
        recordings = [(*walk, options.duration, options.logs) for walk in walks.values()]
        run.do("walk and record", [(record_missing, recording) for recording in recordings])
        for what, cases in stages.items():
            if cases:
                run.run(what, cases, store)
        results.loop = store.rows("loop", stages["close the loop"])
        results.timing = pd.DataFrame(run.do("time an update", _timings(results)))
        if options.film_duration > 0.0 and len(results.loop):
            _film(run, results)
    results.failures = store.failures([case for cases in stages.values() for case in cases])
    _collect(results, store, scored, scaled)
    limits = store.rows("bounds", stages["compute the bounds"])
    if len(limits):
        results.scores = results.scores.merge(limits, on=["scenario", "seed"], how="left")
    else:
        results.scores = results.scores.assign(bound_cop=np.nan, bound_vgrf=np.nan, bound_cell=np.nan)
    names = ("scores", "errors", "timing", "yardsticks", "sensitivity", "loop")
    save_frames(options.out / "tables", {name: getattr(results, name) for name in names})
    save_facts(
        options.out / "results.json",
        options,
        scenarios={s.name: {"title": s.title, "answers": s.answers} for s in chosen},
        left_out=results.left_out,
        film=results.film.problem or "walk.mp4",
        machine=machine(),
        seconds=results.seconds,
    )
    return results


def _timings(results: ArenaResults) -> list[Any]:
    """List the methods with the first walk of the first scenario."""
    options, first = results.options, results.scenarios[0]
    path = log_paths(first.walk, 0, options.duration, options.logs)[first.condition]
    return [(time_method, (path, m, first.options_of(m))) for m in options.rows if m != TRUE_MAP]


def _film(run: Runner, results: ArenaResults) -> None:
    options, severity = results.options, max(results.options.loops)
    speed, seed = telling_walk(results.loop[results.loop["severity"] == severity])
    results.filmed = (severity, speed, seed)
    filmed = partial(shoot, speed=speed, seed=seed, duration=options.film_duration, severity=severity)
    try:
        results.film = join_reels(options.out, *run.do("film", [(filmed, (f,)) for f in ("none", "moment")]))
    except OSError as error:
        results.film = Film(None, None, str(error))


def telling_walk(loop: Frame) -> tuple[float, int]:
    """Return speed and seed of the walk to film: raw it falls, best after some steps, calibrated not."""
    fell = loop.pivot(index=["speed", "seed"], columns="feed", values="fell").astype(bool)
    if {"none", "moment"} <= set(fell.columns):
        telling = fell[fell["none"] & ~fell["moment"]]
        if len(telling):
            time = loop[loop["feed"] == "none"].set_index(["speed", "seed"])["time"].loc[telling.index]
            speed, seed = (time - FALL_TO_SHOW).abs().idxmin()
            return float(speed), int(seed)
    return float(loop["speed"].iloc[0]), int(loop["seed"].iloc[0])


def _collect(
    results: ArenaResults, store: Store, scored: list[Case], scaled: dict[tuple[str, float], list[Case]]
) -> None:
    for name in ("scores", "errors", "yardsticks", "traces"):
        setattr(results, name, store.rows(name, scored))
    if not len(results.scores):
        for name, error in store.failures(scored).items():
            raise ValueError(f"No case could be scored. The first, '{name}': {error.splitlines()[-1]}")
        raise ValueError(
            "No walk lasted long enough to be scored: all ended in a fall; take other scenarios."
        )
    left_out = store.rows("left_out", scored)
    results.left_out = left_out.groupby("scenario", sort=False)["count"].first().astype(int).to_dict()
    if scaled and len(plain := results.yardsticks):
        frames = [
            store.rows("yardsticks", cases).assign(weight=weight, factor=factor)
            for (weight, factor), cases in scaled.items()
        ]
        # Weights as they are were replayed already.
        plain = plain[(plain["method"] == "window") & (plain["seed"] < results.options.sensitivity_seeds)]
        as_they_are = [plain.assign(weight=weight, factor=1.0) for weight in WEIGHTS]
        results.sensitivity = pd.concat([*frames, *as_they_are], ignore_index=True)
