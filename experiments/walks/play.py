"""Replay the streams of a scenario, and keep what the scores need and nothing else.

A covariance is held against the truth as it appears, once a second, and forgotten.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Estimate, FootCalibrator, Parameters, Reference
from surefoot.calibration.cop import cop_of_feet, sole_wrenches
from surefoot.experiments.arrays import Floats
from surefoot.experiments.walks.options import TRUE_MAP
from surefoot.experiments.walks.replay import age_of, starting_map, steps_of
from surefoot.experiments.walks.score import held
from surefoot.experiments.walks.streams import Stream

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


def play(streams: Sequence[Stream], method: str, **options: Any) -> list[Played]:
    """Run a method, or the true map, over streams of any lengths and robots; each option is the method's."""
    if method == TRUE_MAP:
        return [_true_map(stream) for stream in streams]
    return [_play(stream, method, options) for stream in streams]


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


def _play(stream: Stream, method: str, options: dict[str, Any]) -> Played:
    log, K = stream.log, stream.log.layout.channels
    known: dict[str, Any] = {"dt": log.dt, "lag": log.lag, "age": age_of(log)}
    calibrator = FootCalibrator(log.layout, method, mass=log.mass, **known, **options)
    force, scale, offset = np.empty((3, len(log), K))
    flags = np.empty((len(log), K), dtype=np.int64)
    watch = _Watch(stream)
    # Readings are handed over as forces by the starting map, which scale and offset are then relative to.
    reading = starting_map(log).force(log.raw)
    for k, step in enumerate(steps_of(log).tolist()):
        now = Reference(*(part[k] for part in log.reference))
        estimate = calibrator.update(reading[k], now, step)
        force[k], scale[k], offset[k] = estimate.force, estimate.scale, estimate.offset
        flags[k] = estimate.flags
        watch.look(k, estimate, now)
    return Played(force, scale, offset, flags, watch.seen())


class _Watch:
    """Compares what is claimed of a stream with the truth, as it goes."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._every = max(round(SNAPSHOT / stream.log.dt), 1)
        self._time: list[float] = []
        self._seen: list[tuple[float, float, float]] = []
        self._nis = self._rows = 0.0
        truth = Parameters(stream.truth.scale, stream.truth.offset).relative_to(starting_map(stream.log))
        self._map = np.hstack([truth.scale, truth.offset])

    def look(self, k: int, estimate: Estimate, reference: Reference) -> None:
        """Take in sample ``k``."""
        stream, nis, rows = self._stream, estimate.nis, estimate.nis_rows
        if nis is not None and rows is not None and stream.judged[k] and rows > 0 and np.isfinite(nis):
            self._nis += float(nis)
            self._rows += float(rows)
        if (k + 1) % self._every:
            return
        # A faulty channel no longer reads its own force: there is no map to compare the estimate with.
        nees = force = cop = float("nan")
        if not stream.faults:
            error = np.hstack([estimate.scale, estimate.offset]) - self._map[k]
            nees = _normalised(error, estimate.covariance)
        true_force = stream.truth.force[k]
        if estimate.force_std is not None:
            force = float(np.mean(((estimate.force - true_force) / estimate.force_std) ** 2))
        if estimate.cop_covariance is not None and estimate.cop_valid:
            # The true forces are placed under the soles that the estimate is placed under.
            wrench = sole_wrenches(true_force, stream.log.layout)
            true_cop = cop_of_feet(wrench, reference.position_sole, reference.R_level_sole)
            cop = _normalised(estimate.cop - true_cop, estimate.cop_covariance)
        self._time.append(float(stream.log.time[k]))
        self._seen.append((nees, cop, force))

    def seen(self) -> Consistency:
        """Return what was seen."""
        nees, cop, force = np.array(self._seen).reshape(-1, 3).T
        return Consistency(np.array(self._time), nees, cop, force, self._nis, self._rows)


def _normalised(error: Floats, covariance: Any) -> float:
    """Return squared errors by their covariance over their number; infinite where it is not one."""
    if covariance is None:
        return float("nan")
    values, vectors = np.linalg.eigh(covariance) if np.isfinite(covariance).all() else (np.zeros(1), None)
    if vectors is None or values[0] <= 0.0:
        return float("inf")
    return float(np.mean((vectors.T @ error) ** 2 / values))
