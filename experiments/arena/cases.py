"""The cases of a study of walks: one method on one scenario, a scenario's bound, one closed loop."""

import time
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import FootCalibrator, OnlineSetup, Parameters, Reference, posterior_bound
from surefoot.calibration.moment.config import Moment
from surefoot.experiments.arena.options import ArenaOptions
from surefoot.experiments.arena.replay import play
from surefoot.experiments.arena.scenarios import Scenario
from surefoot.experiments.arena.score import run_errors, running_rmse, score_run
from surefoot.experiments.arena.streams import streams_of
from surefoot.experiments.arena.walks import log_paths
from surefoot.experiments.arena.yardsticks import OTHER_WAYS, other_way, trace_of, yardsticks_of
from surefoot.experiments.logs.format import Log, read_log
from surefoot.experiments.study.sources import own_code
from surefoot.experiments.study.store import Case
from surefoot.experiments.walks.closed_loop import run_loop
from surefoot.experiments.walks.replay import age_of, starting_map

SLICE = 2.0  # time in s between points of the errors that are drawn over time
TIMED = 1600  # samples of one walk on which an update is timed: 20 s
PHASES = 4  # the window solves at every fourth sample: one of four samples is the slow one

Tables = dict[str, list[dict[str, Any]]]


def score_case(
    scenario: Scenario, method: str, options: ArenaOptions, changes: Mapping[str, Any] | None = None
) -> Case:
    """Return the case of one method, or of one of :data:`OTHER_WAYS`, on one scenario, with changed options.

    Its tables are ``scores`` (one row a run), ``errors`` (over time) and ``left_out`` (how many walks were),
    and for the scenarios of the CoP paper ``yardsticks`` and ``traces``.
    """
    changed = dict(changes or {})
    name = " ".join([scenario.name, method, *(f"{key}={value:g}" for key, value in changed.items())])
    arguments = (scenario, method, options, changed)
    depends = (method, changed, _depends(scenario, options), *own_code(method))
    return Case(name, _score, arguments, depends)


def bound_case(scenario: Scenario, options: ArenaOptions) -> Case:
    """Return the case of a scenario's bound: ``bounds``, a row a run (``bound_cop`` in m, others in N)."""
    return Case(f"{scenario.name} bound", _bound, (scenario, options), _depends(scenario, options))


def loop_case(severity: float, feed: str, speed: float, seed: int, duration: float) -> Case:
    """Return the case of one closed loop; its table ``loop`` has one row."""
    name = f"closed loop, severity {severity:g}, {feed}, {speed:g} m/s, seed {seed}"
    return Case(name, _loop, (severity, feed, speed, seed, duration))


def bound_of(log: Log, judged: NDArray[np.bool_], options: Mapping[str, Any]) -> dict[str, float]:
    """Return the posterior Cramér-Rao bounds on errors of CoP (m), vGRF and cells (N) over judged samples.

    NaN for what is no walk of the NAO.
    """
    walks = log.truth is not None and bool(log.about.get("speed_m_s"))
    if not walks or not judged.any() or not np.isfinite(log.raw).all():
        return dict.fromkeys(("cop", "vgrf", "cell"), float("nan"))
    assert log.truth is not None
    model = {field.name for field in fields(Moment)}
    setup = OnlineSetup(
        layout=log.layout,
        mass=log.mass,
        initial=starting_map(log),
        dt=log.dt,
        lag=log.lag,
        **{name: value for name, value in options.items() if name not in model},
    )
    config = Moment(**{name: value for name, value in options.items() if name in model})
    truth = Parameters(log.truth.scale, log.truth.offset)
    bound = posterior_bound(setup, log.raw, log.reference, truth, config)
    return {
        "cop": float(np.sqrt(np.nanmean((bound.cop[judged] ** 2).sum(axis=-1)))),
        "vgrf": float(np.sqrt(np.mean(bound.vgrf[judged] ** 2))),
        "cell": float(np.sqrt(np.mean(bound.force[judged] ** 2))),
    }


def time_method(path: Path, method: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Time one robot's updates: median, mean, and the median of the slowest of four phases, in us."""
    log = read_log(path)
    known: dict[str, Any] = {"mass": log.mass, "dt": log.dt, "lag": log.lag, "age": age_of(log)}
    calibrator = FootCalibrator(log.layout, method, initial=starting_map(log), **known, **options)
    taken = []
    for k in range(min(TIMED, len(log))):
        reference = Reference(*(part[k] for part in log.reference))
        began = time.perf_counter()
        calibrator.update(log.raw[k], reference)
        taken.append(time.perf_counter() - began)
    # The first half warms up, and holds what only a standing start does.
    steady = 1e6 * np.array(taken[len(taken) // 2 :])
    phases = steady[: len(steady) // PHASES * PHASES].reshape(-1, PHASES)
    return {
        "method": method,
        "median_us": float(np.median(steady)),
        "mean_us": float(steady.mean()),
        "slowest_us": float(np.median(phases, axis=0).max()),
    }


def _depends(scenario: Scenario, options: ArenaOptions) -> tuple[Any, ...]:
    """Return what a scenario's results depend on; a log's name is a hash of all that made it."""
    logs = [
        str(log_paths(scenario.walk, seed, options.duration, Path())[scenario.condition])
        for seed in scenario.seeds(options.seeds)
    ]
    return scenario, options.duration, options.settle, logs


def _score(scenario: Scenario, method: str, options: ArenaOptions, changes: dict[str, Any]) -> Tables:
    streams, left_out = streams_of(scenario, options)
    row = {"scenario": scenario.name, "method": method}
    found: Tables = {"scores": [], "errors": [], "left_out": [{**row, "count": left_out}]}
    if method in OTHER_WAYS:
        rows = [one for stream in streams for one in other_way(stream, method, options.settle)]
        return {**found, "yardsticks": rows}
    played_by_method = play(streams, method, **scenario.options_of(method), **changes)
    for stream, played in zip(streams, played_by_method, strict=True):
        found["scores"].append({**row, **score_run(stream, played)})
        running = running_rmse(stream.log.time, run_errors(stream, played.force)[0])
        every = max(round(SLICE / stream.log.dt), 1)
        found["errors"] += [
            {**row, "seed": stream.seed, "time": float(moment), "cop": float(value)}
            for moment, value in zip(stream.log.time[::every], running[::every], strict=True)
        ]
        if scenario.paper:
            rows = yardsticks_of(stream, method, played.force, options.settle)
            found.setdefault("yardsticks", []).extend(rows)
            if stream.seed == 0:
                found["traces"] = trace_of(stream, method, played.force)
    return found


def _bound(scenario: Scenario, options: ArenaOptions) -> Tables:
    rows = []
    for stream in streams_of(scenario, options)[0]:
        # A bound knows of no fault: what it says of a channel that fails would mean nothing.
        if not stream.faults:
            limit = bound_of(stream.log, stream.judged, scenario.options_of("moment"))
            named = {f"bound_{part}": value for part, value in limit.items()}
            rows.append({"scenario": scenario.name, "seed": stream.seed, **named})
    return {"bounds": rows}


def _loop(severity: float, feed: str, speed: float, seed: int, duration: float) -> Tables:
    return {"loop": [asdict(run_loop(feed, speed=speed, seed=seed, duration=duration, severity=severity))]}
