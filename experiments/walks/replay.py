"""Replay logs through the online methods, each as the robot would have."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Estimate, Parameters, replay
from surefoot.experiments.arrays import Floats
from surefoot.experiments.logs.format import Log
from surefoot.experiments.logs.table import LogError


def replay_log(log: Log, method: str, initial: Parameters, **options: Any) -> Estimate:
    """Run one method over a log, N samples at once, from a map; options as of :func:`replay`."""
    known: dict[str, Any] = {"mass": log.mass, "initial": initial, "lag": log.lag, "age": age_of(log)}
    return replay(log.layout, method, log.raw, log.reference, steps_of(log), **known, **options)


def steps_of(log: Log) -> Floats:
    """Return the times since the sample before in s, shape (N,)."""
    steps: Floats = np.diff(log.time, prepend=log.time[0] - log.dt)
    return steps


def age_of(log: Log) -> float:
    """Return how old a log's readings were on average when they were taken, in s; 0 where nothing says so."""
    return float(log.about.get("sample_age_s", 0.0))


class Replayed(NamedTuple):
    """What a method made of one log of N samples."""

    force: Floats  # calibrated, in N, shape (N, K)
    cop: Floats  # of both feet in the reference's level frame in m, shape (N, 2)
    scale: Floats  # newtons per count, shape (N, K)
    offset: Floats  # force that a reading of zero stands for in N, shape (N, K)
    flags: NDArray[np.int64]  # bits of :class:`~surefoot.calibration.Flag`, shape (N, K)


def starting_map(log: Log, start: str | None = None) -> Parameters:
    """Return the nominal or the calibrated map, or raise LogError; by default what ``about`` says."""
    if start is None:
        start = str(log.about.get("start", "nominal"))
    if start not in ("nominal", "calibrated", "bench"):
        raise LogError(f"A replay starts from 'nominal' or 'calibrated', not from '{start}'.")
    found = log.nominal if start == "nominal" else log.calibrated
    if found is None:
        raise LogError("The log's description has no 'calibrated' map; start from 'nominal', or add the map.")
    return found


def replay_logs(logs: Sequence[Log], method: str, start: str | None = None, **options: Any) -> list[Replayed]:
    """Run one method over logs of any lengths and robots, and return what it made of each.

    Raises LogError if a log has no such starting map, ValueError if there is no such method or option.
    """
    starts = [starting_map(log, start) for log in logs]
    found = [replay_log(log, method, initial, **options) for log, initial in zip(logs, starts, strict=True)]
    return [Replayed(one.force, one.cop, one.scale, one.offset, one.flags) for one in found]
