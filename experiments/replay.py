"""Replay logs through the online methods: many walks at once, each as the robot would have.

Methods are batched, and a batch of robots costs little more than one. What robots of one batch must share is
length, mass, lag and layout; their starting maps may differ, because readings are handed over as forces by
each log's own starting map and the result is brought back to counts afterwards.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Parameters, Reference, replay
from surefoot.experiments.log_format import Log, LogError

__all__ = ["Replayed", "replay_logs", "starting_map"]


class Replayed(NamedTuple):
    """What a method made of one log of N samples.

    Attributes:
        force: Calibrated channels in N, shape (N, K).
        cop: Centre of pressure of both feet in the reference's level frame in m, shape (N, 2).
        scale: Newtons per count, shape (N, K).
        offset: Force that a reading of zero stands for in N, shape (N, K).
        flags: Bits of :class:`~surefoot.calibration.Flag`, shape (N, K).
    """

    force: NDArray[np.float64]
    cop: NDArray[np.float64]
    scale: NDArray[np.float64]
    offset: NDArray[np.float64]
    flags: NDArray[np.int64]


def starting_map(log: Log, start: str | None = None) -> Parameters:
    """Look up the map that a replay starts from.

    Args:
        log: The log.
        start: ``"nominal"`` or ``"bench"``; by default what the log's ``about`` says under ``start``, else
            ``"nominal"``.

    Raises:
        LogError: If the log has no such map.
    """
    if start is None:
        start = str(log.about.get("start", "nominal"))
    if start not in ("nominal", "bench"):
        raise LogError(f"A replay starts from 'nominal' or 'bench', not from '{start}'.")
    found = log.nominal if start == "nominal" else log.bench
    if found is None:
        raise LogError("The log's description has no 'bench' map; start from 'nominal', or add the map.")
    return found


def replay_logs(logs: Sequence[Log], method: str, start: str | None = None, **options: Any) -> list[Replayed]:
    """Run one method over logs.

    Args:
        logs: Walks of any lengths and robots.
        method: A key of :data:`~surefoot.calibration.METHODS`.
        start: The map to start from, as in :func:`starting_map`.
        **options: Options of the method, and ``zero_phase``.

    Returns:
        What the method made of each log, in their order.

    Raises:
        LogError: If a log has no such starting map.
        ValueError: If there is no such method or option.
    """
    groups: dict[tuple[Any, ...], list[int]] = {}
    for i, log in enumerate(logs):
        key = (len(log), round(log.mass, 9), log.lag, log.dt, log.layout.wrench_map.tobytes())
        groups.setdefault(key, []).append(i)
    results: dict[int, Replayed] = {}
    for members in groups.values():
        batch = _replay_batch([logs[i] for i in members], method, start, options)
        results |= dict(zip(members, batch, strict=True))
    return [results[i] for i in range(len(logs))]


def _replay_batch(logs: list[Log], method: str, start: str | None, options: dict[str, Any]) -> list[Replayed]:
    starts = [starting_map(log, start) for log in logs]
    force = np.stack([first.force(log.raw) for first, log in zip(starts, logs, strict=True)], axis=1)
    reference = Reference(
        *(np.stack(parts, axis=1) for parts in zip(*(log.reference for log in logs), strict=True))
    )
    first = logs[0]
    channels = first.layout.channels
    steps = np.diff(np.mean([log.time for log in logs], axis=0), prepend=first.time[0] - first.dt)
    estimate = replay(
        first.layout,
        method,
        force,
        reference,
        steps,
        mass=first.mass,
        initial=Parameters(np.ones(channels), np.zeros(channels)),
        lag=first.lag,
        **options,
    )
    replayed = []
    for i, began in enumerate(starts):
        learnt = Parameters(estimate.scale[:, i], estimate.offset[:, i]).after(began)
        replayed.append(
            Replayed(
                force=estimate.force[:, i],
                cop=estimate.cop[:, i],
                scale=learnt.scale,
                offset=learnt.offset,
                flags=np.asarray(estimate.flags[:, i]),
            )
        )
    return replayed
