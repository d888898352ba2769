"""The arena's work in pieces that processes can do, and that are kept once they are done.

A piece depends on nothing but its arguments and files. What it finds is written under a hash of all that made
it: the recordings, the options and the sources of what replays and scores them.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from surefoot.calibration import FootCalibrator, Reference
from surefoot.experiments.arena.options import TRUE_MAP, ArenaOptions
from surefoot.experiments.arena.recordings import recording_hash, recording_streams
from surefoot.experiments.arena.replay import play
from surefoot.experiments.arena.scenarios import Scenario, scenarios_named
from surefoot.experiments.arena.score import run_errors, running_rmse, score_run
from surefoot.experiments.arena.streams import Stream, streams_of
from surefoot.experiments.arena.walks import log_paths
from surefoot.experiments.logs.format import Log, read_log
from surefoot.experiments.study.files import atomic_path
from surefoot.experiments.study.sources import source_hash
from surefoot.experiments.study.tables import Frame

__all__ = ["Bound", "LogBound", "bound_piece", "score_piece", "time_method"]

SLICE = 2.0
"""Time in s between points of the errors that are drawn over time."""

TIMED = 1600
"""Samples of one walk on which an update is timed: 20 s."""


@dataclass(frozen=True)
class LogBound:
    """What no estimator can go below on one log.

    Attributes:
        cop: Bound on the CoP error in m.
        vgrf: Bound on that of the vertical force in N.
        cell: Bound on that of single cells in N.
    """

    cop: float
    vgrf: float
    cell: float


Bound = Callable[[Log, NDArray[np.bool_], Mapping[str, Any]], LogBound]
"""Computes the bound of a log over the samples that are judged, for an estimator that is told the options of
a scenario; must survive pickling."""


def score_piece(name: str, method: str, options: ArenaOptions) -> tuple[Frame, Frame, int]:
    """Run one method on one scenario, or read what came of it before.

    Args:
        name: The scenario's.
        method: A method or the true map.
        options: How much the arena does.

    Returns:
        One row a run; the running errors over time; and how many walks were left out.
    """
    (scenario,) = scenarios_named((name,), quick=False)
    stem = f"{name}_{method}_{_key(scenario, options, method, *_methods_sources(method))}"
    folder = options.out / "scores"
    scores_file, errors_file = folder / f"{stem}.parquet", folder / f"{stem}.errors.parquet"
    if scores_file.is_file() and errors_file.is_file():
        scores: Frame = pd.read_parquet(scores_file)
        return scores, pd.read_parquet(errors_file), int(scores.attrs.get("left_out", 0))
    streams, left_out = _streams(scenario, options)
    rows, errors = [], []
    for stream, played in zip(streams, play(streams, method, **scenario.options_of(method)), strict=True):
        row = {"scenario": name, "method": method}
        rows.append(row | score_run(stream, played))
        running = running_rmse(stream.log.time, run_errors(stream, played.force)[0])
        every = max(round(SLICE / stream.log.dt), 1)
        for moment, value in zip(stream.log.time[::every], running[::every], strict=True):
            errors.append(row | {"seed": stream.seed, "time": float(moment), "cop": float(value)})
    scores, curves = pd.DataFrame(rows), pd.DataFrame(errors)
    scores.attrs["left_out"] = left_out
    for frame, file in ((curves, errors_file), (scores, scores_file)):
        with atomic_path(file) as part:
            frame.to_parquet(part)
    return scores, curves, left_out


def bound_piece(name: str, options: ArenaOptions, bound: Bound) -> Frame:
    """Compute the bounds of a scenario's streams, or read what they were.

    Args:
        name: The scenario's.
        options: How much the arena does.
        bound: Computes the bound of a log.

    Returns:
        Rows ``scenario``, ``seed``, ``bound_cop`` (m), ``bound_vgrf`` (N) and ``bound_cell`` (N).
    """
    (scenario,) = scenarios_named((name,), quick=False)
    which = f"{bound.__module__}.{bound.__qualname__}"
    file = (
        options.out
        / "scores"
        / f"{name}_bound_{_key(scenario, options, which, 'surefoot.calibration')}.parquet"
    )
    if file.is_file():
        limits: Frame = pd.read_parquet(file)
        return limits
    rows = []

    def told(stream: Stream) -> dict[str, float]:
        return asdict(bound(stream.log, stream.judged, scenario.options_of("moment")))

    for stream in _streams(scenario, options)[0]:
        # A bound knows of no fault: what it says of a channel that fails would mean nothing.
        if not stream.faults:
            limit = {f"bound_{part}": value for part, value in told(stream).items()}
            rows.append({"scenario": name, "seed": stream.seed} | limit)
    kinds = {"scenario": str, "seed": int} | {
        f"bound_{part}": float for part in LogBound.__dataclass_fields__
    }
    limits = pd.DataFrame(rows, columns=list(kinds)).astype(kinds)
    with atomic_path(file) as part:
        limits.to_parquet(part)
    return limits


def _streams(scenario: Scenario, options: ArenaOptions) -> tuple[list[Stream], int]:
    if scenario.recording is None:
        return streams_of(scenario, options)
    return recording_streams(scenario.recording, scenario.seeds(options.seeds)), 0


_SCORERS = tuple(f"surefoot.experiments.arena.{name}" for name in ("score", "streams", "recordings"))


def _methods_sources(method: str) -> tuple[str, ...]:
    return () if method == TRUE_MAP else ("surefoot.calibration.online",)


def _key(scenario: Scenario, options: ArenaOptions, what: str, *sources: str) -> str:
    """Hash all that a result depends on."""
    seeds = scenario.seeds(options.seeds)
    if scenario.walk is not None:
        recorded = [str(log_paths(scenario.walk, seed, options.duration, Path())) for seed in seeds]
    else:
        recorded = [recording_hash(str(scenario.recording)), str(seeds)]
    made_of = (
        scenario,
        what,
        options.settle,
        recorded,
        source_hash(*_SCORERS, *sources),
        [version(name) for name in ("numpy", "scipy")],
    )
    return sha256(repr(made_of).encode()).hexdigest()[:12]


def time_method(path: Path, method: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Time one robot's updates on one walk.

    Args:
        path: A log.
        method: A method.
        options: What it must be told.

    Returns:
        ``method``, and the median and the mean time in microseconds: a method may work on some samples only.
    """
    log = read_log(path)
    calibrator = FootCalibrator(
        log.layout, method, mass=log.mass, initial=log.nominal, dt=log.dt, lag=log.lag, **options
    )
    taken = []
    for k in range(min(TIMED, len(log))):
        reference = Reference(*(part[k] for part in log.reference))
        began = time.perf_counter()
        calibrator.update(log.raw[k], reference)
        taken.append(time.perf_counter() - began)
    # The first half warms up, and holds what only a standing start does.
    steady = 1e6 * np.array(taken[len(taken) // 2 :])
    return {"method": method, "median_us": float(np.median(steady)), "mean_us": float(steady.mean())}
