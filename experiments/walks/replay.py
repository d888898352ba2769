"""Replay logs through the online methods: many walks at once, each as the robot would have.

Robots of one batch share length, mass, lag and layout; their starting maps may differ, because readings are
handed over as forces by each log's own map and the result is brought back to counts.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Estimate, Parameters, Reference, replay
from surefoot.experiments.arrays import Floats
from surefoot.experiments.logs.format import Log
from surefoot.experiments.logs.table import LogError


class LogBatch(NamedTuple):
    """Walks that go through a method side by side, as robots of one batch."""

    members: list[int]  # which of the logs they are
    force: Floats  # by each log's own starting map in N, shape (N, B, K)
    reference: Reference  # N rows of B robots in every field
    steps: Floats  # times since the sample before in s, shape (N,)


def batches_of(logs: Sequence[Log], starts: Sequence[Parameters]) -> Iterator[LogBatch]:
    """Put those logs together that share length, mass, lag and layout; each starts from its own map."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for i, log in enumerate(logs):
        key = (len(log), round(log.mass, 9), log.lag, log.dt, age_of(log), log.layout.wrench_map.tobytes())
        groups.setdefault(key, []).append(i)
    for members in groups.values():
        batch = [logs[i] for i in members]
        parts = zip(*(log.reference for log in batch), strict=True)
        start = batch[0].time[0] - batch[0].dt
        yield LogBatch(
            members,
            np.stack([starts[i].force(logs[i].raw) for i in members], axis=1),
            Reference(*(np.stack(part, axis=1) for part in parts)),
            np.diff(np.mean([log.time for log in batch], axis=0), prepend=start),
        )


def replay_log(log: Log, method: str, initial: Parameters, **options: Any) -> Estimate:
    """Run one method over a log, N samples at once, from a map; options as of :func:`replay`."""
    steps = np.diff(log.time, prepend=log.time[0] - log.dt)
    known: dict[str, Any] = {"mass": log.mass, "initial": initial, "lag": log.lag, "age": age_of(log)}
    return replay(log.layout, method, log.raw, log.reference, steps, **known, **options)


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
    results: dict[int, Replayed] = {}
    for batch in batches_of(logs, starts):
        first, K = logs[batch.members[0]], logs[batch.members[0]].layout.channels
        estimate = replay(
            first.layout,
            method,
            batch.force,
            batch.reference,
            batch.steps,
            mass=first.mass,
            initial=Parameters(np.ones(K), np.zeros(K)),
            lag=first.lag,
            age=age_of(first),
            **options,
        )
        for i, member in enumerate(batch.members):
            learnt = Parameters(estimate.scale[:, i], estimate.offset[:, i]).after(starts[member])
            results[member] = Replayed(
                force=estimate.force[:, i],
                cop=estimate.cop[:, i],
                scale=learnt.scale,
                offset=learnt.offset,
                flags=np.asarray(estimate.flags[:, i]),
            )
    return [results[i] for i in range(len(logs))]
