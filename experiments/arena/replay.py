"""Replay the streams of a scenario as one batch, and keep what the scores need and nothing else.

A covariance is held against the truth as it appears, once a second, and forgotten.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Estimate, FootCalibrator, Parameters, Reference
from surefoot.calibration.cop import cop_of_feet, sole_wrenches
from surefoot.experiments.arena.options import TRUE_MAP
from surefoot.experiments.arena.streams import Stream
from surefoot.experiments.arrays import Floats
from surefoot.experiments.walks.replay import LogBatch, age_of, batches_of, starting_map
from surefoot.experiments.walks.score import held

SNAPSHOT = 1.0  # time between looks at a covariance in s


@dataclass(frozen=True, eq=False)
class Consistency:
    """Squared errors of one run by the covariance claimed, over their number: 1 is right, NaN is no claim."""

    time: Floats  # of M looks in s, shape (M,)
    nees: Floats  # of (a, b), shape (M,)
    nees_cop: Floats  # of the centre of pressure
    nees_force: Floats  # of single channels, without what they have to do with each other
    nis: float  # sum of the normalised squared innovations after the settling time
    nis_rows: float  # number of rows in that sum


@dataclass(frozen=True, eq=False)
class Played:
    """What a method made of one stream of N samples and K channels."""

    force: Floats  # in N, shape (N, K)
    scale: Floats  # a in F = a F0 + b, F0 by the starting map, shape (N, K)
    offset: Floats  # b in N, shape (N, K)
    flags: NDArray[np.int64]  # bits of :class:`~surefoot.calibration.Flag`, shape (N, K)
    consistency: Consistency
    seconds: float  # a sample and robot of the batch


def play(streams: Sequence[Stream], method: str, **options: Any) -> list[Played]:
    """Run a method, or the true map, over streams of any lengths and robots; each option is the method's."""
    if method == TRUE_MAP:
        return [_true_map(stream) for stream in streams]
    logs = [stream.log for stream in streams]
    played: dict[int, Played] = {}
    for batch in batches_of(logs, [starting_map(log) for log in logs]):
        found = _play_batch([streams[i] for i in batch.members], batch, method, options)
        played |= zip(batch.members, found, strict=True)
    return [played[i] for i in range(len(streams))]


def _true_map(stream: Stream) -> Played:
    log, truth = stream.log, stream.truth
    start = starting_map(log)
    undone = Parameters(truth.scale, truth.offset).relative_to(start)
    nothing = np.full(0, np.nan)
    return Played(
        force=_undone(stream),
        scale=undone.scale,
        offset=undone.offset,
        flags=np.zeros(log.raw.shape, dtype=np.int64),
        consistency=Consistency(nothing, nothing, nothing, nothing, float("nan"), 0.0),
        seconds=float("nan"),
    )


def _undone(stream: Stream) -> Floats:
    """Undo all errors of the readings at every moment, the cross-talk of six-axis sensors included."""
    log, truth = stream.log, stream.truth
    own: Floats = truth.scale * held(log.raw) + truth.offset
    if "truth_cross_talk" not in log.about:
        return own
    # Each axis's own scale g and offset are undone: (I + X / g) w is left, besides the weight beyond it.
    talk, preload = np.array(log.about["truth_cross_talk"]), np.array(log.about["truth_preload"])
    mixed = np.eye(len(talk)) + (truth.scale / log.nominal.scale)[..., None] * talk
    undone: Floats = np.linalg.solve(mixed, (own - preload)[..., None])[..., 0] + preload
    return undone


def _play_batch(streams: list[Stream], batch: LogBatch, method: str, options: dict[str, Any]) -> list[Played]:
    first = streams[0].log
    layout, samples, robots = first.layout, len(first), len(streams)
    known: dict[str, Any] = {"dt": first.dt, "lag": first.lag, "age": age_of(first)}
    calibrator = FootCalibrator(layout, method, mass=first.mass, **known, **options)
    force, scale, offset = (np.empty((samples, robots, layout.channels)) for _ in range(3))
    flags = np.empty((samples, robots, layout.channels), dtype=np.int64)
    watch = _Watch(streams)
    seconds = 0.0
    for k, step in enumerate(batch.steps.tolist()):
        now = Reference(*(part[k] for part in batch.reference))
        began = time.perf_counter()
        estimate = calibrator.update(batch.force[k], now, step)
        seconds += time.perf_counter() - began
        force[k], scale[k], offset[k] = estimate.force, estimate.scale, estimate.offset
        flags[k] = estimate.flags
        watch.look(k, estimate, now)
    return [
        Played(force[:, i], scale[:, i], offset[:, i], flags[:, i], watch.of(i), seconds / (samples * robots))
        for i in range(robots)
    ]


class _Watch:
    """Compares what a batch of streams claims with the truth, as it goes."""

    def __init__(self, streams: list[Stream]) -> None:
        self._streams = streams
        self._every = max(round(SNAPSHOT / streams[0].log.dt), 1)
        self._time: list[float] = []
        self._seen: list[Floats] = []
        self._nis, self._rows = np.zeros((2, len(streams)))
        truths = [Parameters(s.truth.scale, s.truth.offset).relative_to(starting_map(s.log)) for s in streams]
        # A faulty channel no longer reads its own force: there is no map to compare the estimate with.
        self._healthy = np.array([not s.faults for s in streams])
        self._map = np.stack([np.hstack([t.scale, t.offset]) for t in truths], axis=1)
        self._judged = np.stack([s.judged for s in streams], axis=1)

    def look(self, k: int, estimate: Estimate, reference: Reference) -> None:
        """Take in sample ``k``."""
        nis, rows = estimate.nis, estimate.nis_rows
        if nis is not None and rows is not None:
            counted = self._judged[k] & (rows > 0) & np.isfinite(nis)
            self._nis += np.where(counted, nis, 0.0)
            self._rows += np.where(counted, rows, 0)
        if (k + 1) % self._every:
            return
        error = np.hstack([estimate.scale, estimate.offset]) - self._map[k]
        nees = np.where(self._healthy, _normalised(error, estimate.covariance), np.nan)
        true_force = np.stack([s.truth.force[k] for s in self._streams])
        force = cop = np.full(len(self._streams), np.nan)
        if estimate.force_std is not None:
            force = np.mean(((estimate.force - true_force) / estimate.force_std) ** 2, axis=-1)
        if estimate.cop_covariance is not None:
            # The true forces are placed under the soles that the estimate is placed under.
            wrench = sole_wrenches(true_force, self._streams[0].log.layout)
            true_cop = cop_of_feet(wrench, reference.position_sole, reference.R_level_sole)
            off = _normalised(estimate.cop - true_cop, estimate.cop_covariance)
            cop = np.where(estimate.cop_valid, off, np.nan)
        self._time.append(float(self._streams[0].log.time[k]))
        self._seen.append(np.stack([nees, cop, force]))

    def of(self, robot: int) -> Consistency:
        """Return what was seen of one robot."""
        nees, cop, force = np.array(self._seen).reshape(-1, 3, len(self._streams))[..., robot].T
        nis, rows = float(self._nis[robot]), float(self._rows[robot])
        return Consistency(np.array(self._time), nees, cop, force, nis, rows)


def _normalised(error: Floats, covariance: Any) -> Floats:
    """Squared errors by their covariance over their number, shape (B,); infinite where it is not one."""
    if covariance is None:
        return np.full(len(error), np.nan)
    found = np.full(len(error), np.inf)
    for i, (off, matrix) in enumerate(zip(error, np.asarray(covariance, dtype=np.float64), strict=True)):
        values, vectors = np.linalg.eigh(matrix) if np.isfinite(matrix).all() else (np.zeros(1), None)
        if vectors is not None and values[0] > 0.0:
            found[i] = np.mean((vectors.T @ off) ** 2 / values)
    return found
