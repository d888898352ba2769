"""Replay logs through the online methods: many walks at once, each as the robot would have.

Methods are batched, and a batch of robots costs little more than one. What robots of one batch must share is
length, mass, lag and layout; their starting maps may differ, because readings are handed over as forces by
each log's own starting map and the result is brought back to counts afterwards.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Parameters, Reference, replay
from surefoot.experiments.logs.format import Log, LogError

Floats = NDArray[np.float64]


class LogBatch(NamedTuple):
    """Walks that go through a method side by side, as robots of one batch.

    Attributes:
        members: Which of the logs they are.
        force: Readings as forces by each log's own starting map in N, shape (N, B, K).
        reference: The robots' beliefs, N rows of B robots in every field.
        steps: Times since the sample before in s, shape (N,).
    """

    members: list[int]
    force: Floats
    reference: Reference
    steps: Floats


def batches_of(logs: Sequence[Log], starts: Sequence[Parameters]) -> Iterator[LogBatch]:
    """Put those logs together that share length, mass, lag and layout.

    Args:
        logs: Walks of any lengths and robots.
        starts: The map that each starts from.
    """
    groups: dict[tuple[Any, ...], list[int]] = {}
    for i, log in enumerate(logs):
        key = (len(log), round(log.mass, 9), log.lag, log.dt, log.layout.wrench_map.tobytes())
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


class Replayed(NamedTuple):
    """What a method made of one log of N samples.

    Attributes:
        force: Calibrated channels in N, shape (N, K).
        cop: Centre of pressure of both feet in the reference's level frame in m, shape (N, 2).
        scale: Newtons per count, shape (N, K).
        offset: Force that a reading of zero stands for in N, shape (N, K).
        flags: Bits of :class:`~surefoot.calibration.Flag`, shape (N, K).
    """

    force: Floats
    cop: Floats
    scale: Floats
    offset: Floats
    flags: NDArray[np.int64]


def starting_map(log: Log, start: str | None = None) -> Parameters:
    """Return the map that a replay starts from.

    Args:
        log: The log.
        start: ``"nominal"`` or ``"calibrated"`` (``"bench"`` in older logs); by default what the log's
            ``about`` has under ``start``, else ``"nominal"``.

    Raises:
        LogError: If the log has no such map.
    """
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

    Raises:
        LogError: If a log has no such starting map.
        ValueError: If there is no such method or option.
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
