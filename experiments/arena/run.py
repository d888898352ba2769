"""The arena: the same recorded streams, several methods, many seeds.

Everything lands in one folder: logs, one file of scores for each scenario and method, tables, figures,
``results.json`` and the page ``report.html``. What is finished is kept under the hash of all that made it, so
that a run that was interrupted goes on where it was, and a new method is scored without the old ones.
"""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from surefoot.experiments.arena.options import TRUE_MAP, ArenaOptions
from surefoot.experiments.arena.pieces import Bound, LogBound, bound_piece, score_piece, time_method
from surefoot.experiments.arena.recordings import recording_hash
from surefoot.experiments.arena.scenarios import Scenario, scenarios_named
from surefoot.experiments.arena.streams import logs_folder
from surefoot.experiments.arena.walks import log_paths, record_missing
from surefoot.experiments.study.files import atomic_path, write_text
from surefoot.experiments.study.runner import machine, runner
from surefoot.experiments.study.tables import Frame

__all__ = ["ArenaResults", "run_arena"]


@dataclass(eq=False)
class ArenaResults:
    """What the arena found.

    Attributes:
        options: How it was run.
        scenarios: What was run, in order.
        scores: One row a run: ``scenario``, ``method`` and what :mod:`surefoot.experiments.arena.score`
            names.
        errors: Running CoP errors: ``scenario``, ``method``, ``seed``, ``time`` (s), ``cop`` (m).
        skipped: Scenarios whose recordings are not there.
        left_out: Walks of each scenario that ended in a fall before they were worth a score.
        timing: Time of one robot's update: ``method``, ``median_us``, ``mean_us``.
        seconds: Time that each stage took in s.
        machine: What it ran on.
    """

    options: ArenaOptions
    scenarios: tuple[Scenario, ...]
    scores: Frame = field(default_factory=pd.DataFrame)
    errors: Frame = field(default_factory=pd.DataFrame)
    skipped: tuple[Scenario, ...] = ()
    left_out: dict[str, int] = field(default_factory=dict)
    timing: Frame = field(default_factory=pd.DataFrame)
    seconds: dict[str, float] = field(default_factory=dict)
    machine: str = ""


def run_arena(
    options: ArenaOptions, *, bound: Bound | None = None, console: Console | None = None
) -> ArenaResults:
    """Do everything but the page: walk, record, replay, score, time.

    Args:
        options: How much.
        bound: Computes what no estimator can go below; ``None`` leaves it out.
        console: Where progress is shown.

    Returns:
        What was found; it is in files under ``options.out`` as well.

    Raises:
        ValueError: If there is no scenario of a name, or nothing in them that could be scored.
    """
    asked = scenarios_named(options.scenarios, quick=options.quick)
    chosen = tuple(s for s in asked if s.recording is None or recording_hash(s.recording))
    if not chosen:
        raise ValueError(
            "All of these scenarios are recordings: set SUREFOOT_DATA to the folder that holds foot/."
        )
    results = ArenaResults(options, chosen, machine=machine())
    results.skipped = tuple(s for s in asked if s not in chosen)
    with runner(options.jobs, results.seconds, console) as stage:
        stage.do("walk and record", _recordings(chosen, options))
        pieces = [(s.name, method) for s in chosen for method in options.rows]
        found = stage.do("replay and score", [(score_piece, (*piece, options)) for piece in pieces])
        limits = []
        if bound is not None:
            limits = stage.do("compute the bounds", [(bound_piece, (s.name, options, bound)) for s in chosen])
        timed = next((s for s in chosen if s.walk is not None), None)
        path = None if timed is None else _first_log(timed, options)
        work = [] if timed is None else [(m, timed.options_of(m)) for m in options.rows if m != TRUE_MAP]
        rows = stage.do("time an update", [(time_method, (path, *piece)) for piece in work])
        results.timing = pd.DataFrame(rows, columns=["method", "median_us", "mean_us"])
    frames = [scores for scores, _, _ in found if len(scores)]
    if not frames:
        raise ValueError(
            "No walk lasted long enough to be scored: all ended in a fall; take other scenarios."
        )
    results.scores = _with_bounds(pd.concat(frames, ignore_index=True), limits)
    results.errors = pd.concat([errors for _, errors, _ in found if len(errors)], ignore_index=True)
    results.left_out = {name: left for (name, _), (_, _, left) in zip(pieces, found, strict=True)}
    _save(results)
    return results


def _recordings(chosen: tuple[Scenario, ...], options: ArenaOptions) -> list[Any]:
    """List every walk once, however many scenarios share it."""
    walks = {
        (scenario.walk.name, seed): (scenario.walk, seed)
        for scenario in chosen
        if scenario.walk is not None
        for seed in scenario.seeds(options.seeds)
    }
    folder = logs_folder(options)
    return [(record_missing, (walk, seed, options.duration, folder)) for walk, seed in walks.values()]


def _with_bounds(scores: Frame, limits: list[Frame]) -> Frame:
    """Put the bound of its stream beside every run; NaN where there is none."""
    columns = [f"bound_{part}" for part in LogBound.__dataclass_fields__]
    if not limits:
        return scores.assign(**dict.fromkeys(columns, np.nan))
    return scores.merge(pd.concat(limits, ignore_index=True), on=["scenario", "seed"], how="left")


def _first_log(scenario: Scenario, options: ArenaOptions) -> Path:
    assert scenario.walk is not None
    paths = log_paths(scenario.walk, 0, options.duration, logs_folder(options))
    return paths[scenario.condition]


def _save(results: ArenaResults) -> None:
    out = results.options.out
    for name in ("scores", "errors", "timing"):
        frame = getattr(results, name)
        with atomic_path(out / "tables" / f"{name}.csv") as part:
            frame.to_csv(part, index=False)
        with atomic_path(out / "tables" / f"{name}.parquet") as part:
            frame.to_parquet(part)
    facts = {
        "options": {k: str(v) if isinstance(v, Path) else v for k, v in asdict(results.options).items()},
        "scenarios": {s.name: {"title": s.title, "answers": s.answers} for s in results.scenarios},
        "skipped": [s.name for s in results.skipped],
        "left_out": results.left_out,
        "machine": results.machine,
        "seconds": results.seconds,
    }
    write_text(out / "results.json", json.dumps(facts, indent=1))
