"""Score calibration methods on recorded walks: one row of numbers per method and walk.

Errors are root mean squares over the judged samples, as in :mod:`surefoot.experiments.walks.score`. Further
columns:

* ``scale``, ``offset``: error of the parameters, rms over channels and judged samples. ``scale`` is relative;
  ``offset`` is the force in N that is estimated for a channel without load.
* ``worse_cop``, ``worse_cop_foot``, ``worse_vgrf``: whether the error over the end of the walk, at most 10 s,
  exceeds that of the starting map.
* ``nees_end``: the squared error of all scales and offsets at the end of the walk, divided by its claimed
  covariance and by their number ``parameters``. It is 1 for a covariance that is right, and NaN for a method
  without a covariance.
* ``alarms``, ``hours``: how often the flag of a fault rose on a channel without one, and the duration of
  walking.
* ``found``, ``isolated``, ``named``, ``after``, ``after_foot``: with a fault, the time in s until any of
  those flags rose, whether the channels that are flagged up to 1 s later are exactly the faulty ones, whether
  the flag names the fault, and the CoP errors later than 1 s after the fault.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats, take_rows
from surefoot.calibration import Flag, FootCalibrator, Parameters
from surefoot.experiments.logs.format import Log, LogTruth
from surefoot.experiments.walks.replay import age_of, beliefs_of, starting_map, steps_of
from surefoot.experiments.walks.score import Errors, are_forces, errors_of, hold_last, rms
from surefoot.sensors import Fault

TRUE_MAP = "true-map"
"""Name of the map that undoes the errors of the cells at every moment, on the readings as they are."""

END = 10.0  # length in s of the end of a walk, at most a third of it
GRACE = 1.0  # time in s after a fault in which it may be found and isolated, and errors do not count
SNAPSHOT = 1.0  # time between looks at a covariance in s

NAMED = {
    "dead": Flag.DEAD,
    "stuck": Flag.STUCK,
    "saturated": Flag.SATURATED,
    "spiking": Flag.SPIKE,
    "dropped": Flag.MISSING,
    "swapped": Flag.SWAPPED,
    "flipped": Flag.FLIPPED,
}
"""The flag that names each kind of fault."""

ACCUSING = int(reduce(or_, (*(flag for flag in NAMED.values() if flag != Flag.MISSING), Flag.LOST)))
"""Flags that accuse a channel of a fault."""


@dataclass(frozen=True, eq=False)
class Stream:
    """A log of N samples, and how methods are judged on it."""

    log: Log  # with truth
    seed: int
    judged: NDArray[np.bool_]  # samples whose errors count, shape (N,)
    began: float  # time in s at which the robot began to walk
    faults: tuple[Fault, ...] = ()  # of its channels
    fell: bool = False  # whether the robot fell; the log ends before
    cop: Floats | None = None  # CoP to score against in m, (N, 2), if it is known better than from the forces

    @property
    def truth(self) -> LogTruth:
        """The simulator's truth."""
        assert self.log.truth is not None
        return self.log.truth

    def errors(self, force: Floats) -> Errors:
        """Return the errors of forces in N, (N, K), at each sample."""
        truth = self.truth
        return errors_of(
            force, truth.force, self.log.layout, truth.position_sole, truth.R_world_sole, self.cop
        )


@dataclass(frozen=True, eq=False)
class Played:
    """The result of a method on a stream of N samples and K channels."""

    force: Floats  # in N, shape (N, K)
    scale: Floats  # a in F = a F0 + b, with F0 by the starting map, shape (N, K)
    offset: Floats  # b in N, shape (N, K)
    flags: NDArray[np.int64]  # bits of :class:`~surefoot.calibration.Flag`, shape (N, K)
    nees: float = float("nan")  # at the last look


def play(stream: Stream, method: str, **options: Any) -> Played:
    """Run a method with its options, or the true map, over a stream."""
    if method == TRUE_MAP:
        return _true_map(stream)
    log, start = stream.log, starting_map(stream.log)
    known: dict[str, Any] = {"mass": log.mass, "dt": log.dt, "lag": log.lag, "age": age_of(log)}
    calibrator = FootCalibrator(log.layout, method, **known, **options)
    force, scale, offset = np.empty((3, len(log), log.layout.channels))
    flags = np.empty(force.shape, dtype=np.int64)
    truth = Parameters(stream.truth.scale, stream.truth.offset).relative_to(start)
    every, nees = max(round(SNAPSHOT / log.dt), 1), float("nan")
    # Readings are passed as forces by the starting map, to which scale and offset are then relative.
    reading, beliefs = start.force(log.raw), beliefs_of(log, method)
    for k, step in enumerate(steps_of(log).tolist()):
        estimate = calibrator.update(reading[k], take_rows(beliefs, k), step)
        force[k], scale[k], offset[k] = estimate.force, estimate.scale, estimate.offset
        flags[k] = estimate.flags
        # A faulty channel no longer reads its own force: there is no map to compare the estimate with.
        if (k + 1) % every == 0 and not stream.faults:
            error = np.hstack([scale[k] - truth.scale[k], offset[k] - truth.offset[k]])
            nees = normalise(error, estimate.covariance)
    return Played(force, scale, offset, flags, nees)


def _true_map(stream: Stream) -> Played:
    """Undo all errors of the readings at every moment, including the cross-talk of six-axis sensors."""
    log, truth = stream.log, stream.truth
    undone = Parameters(truth.scale, truth.offset).relative_to(starting_map(log))
    force: Floats = truth.scale * hold_last(log.raw) + truth.offset
    if "truth_cross_talk" in log.about:
        # The scale g and the offset of each axis are undone; (I + X / g) w remains, besides the preload.
        talk, preload = np.array(log.about["truth_cross_talk"]), np.array(log.about["truth_preload"])
        mixed = np.eye(len(talk)) + (truth.scale / log.nominal.scale)[..., None] * talk
        force = np.linalg.solve(mixed, (force - preload)[..., None])[..., 0] + preload
    return Played(force, undone.scale, undone.offset, np.zeros(log.raw.shape, dtype=np.int64))


def normalise(error: Floats, covariance: Any) -> float:
    """Return squared errors over their covariance and number; infinite for an invalid covariance."""
    if covariance is None:
        return float("nan")
    values, vectors = np.linalg.eigh(covariance) if np.isfinite(covariance).all() else (np.zeros(1), None)
    if vectors is None or values[0] <= 0.0:
        return float("inf")
    return float(np.mean((vectors.T @ error) ** 2 / values))


def score_run(stream: Stream, played: Played) -> dict[str, Any]:
    """Score the result of a method on a stream, NaN where a column has no meaning."""
    log, judged = stream.log, stream.judged
    errors = stream.errors(played.force)
    before = stream.errors(starting_map(log).force(hold_last(log.raw)))
    final = log.time[judged][-1]
    last = judged & (log.time > final - min(END, (final - stream.began) / 3.0))
    end, start = errors.rms(last), before.rms(last)
    row: dict[str, Any] = {"seed": stream.seed, "fell": stream.fell, **errors.rms(judged)}
    for name in ("cop", "cop_foot", "vgrf"):
        # A method that leaves the readings alone is not worse by a rounding error.
        row[f"worse_{name}"] = bool(end[name] > start[name] * (1.0 + 1e-6))
    row |= {"nees_end": played.nees, "parameters": float(2 * log.layout.channels)}
    return row | _parameter_errors(stream, played) | _faults(stream, played, errors)


def _parameter_errors(stream: Stream, played: Played) -> dict[str, float]:
    if stream.faults:
        return {"scale": float("nan"), "offset": float("nan")}
    judged, start, truth = stream.judged, starting_map(stream.log), stream.truth
    ratio = truth.scale / start.scale
    true_offset = truth.offset - ratio * start.offset
    # A channel without load: F0 = -true_offset / ratio.
    unloaded = played.offset - played.scale * true_offset / ratio
    offset = unloaded[judged][:, are_forces(stream.log.layout)]
    return {"scale": rms((played.scale / ratio - 1.0)[judged]), "offset": rms(offset)}


def _faults(stream: Stream, played: Played, errors: Errors) -> dict[str, float]:
    time = stream.log.time
    accused = (played.flags & ACCUSING) != 0
    start = min((fault.start for fault in stream.faults), default=float("inf"))
    before = (time >= stream.began) & (time < start)
    rising = accused[1:] & ~accused[:-1]
    row = dict.fromkeys(("found", "isolated", "named", "after", "after_foot"), float("nan"))
    row["alarms"] = float(rising[before[1:]].sum())
    row["hours"] = float(before.sum() * stream.log.dt / 3600.0)
    if not stream.faults:
        return row
    kinds = {NAMED[fault.kind] for fault in stream.faults}
    accused |= (played.flags & int(reduce(or_, kinds))) != 0
    guilty = {n for fault in stream.faults for n in (fault.channel, fault.other) if n is not None}
    raised = np.flatnonzero(accused.any(axis=1) & (time >= start))
    row["after"], row["after_foot"] = (rms(error[time >= start + GRACE]) for error in errors[:2])
    row |= {"found": float("inf"), "isolated": 0.0, "named": 0.0}
    if len(raised):
        window = (time >= start) & (time <= time[raised[0]] + GRACE)
        union = int(np.bitwise_or.reduce(played.flags[window], axis=None))
        row["found"] = float(time[raised[0]] - start)
        row["isolated"] = float(set(np.flatnonzero(accused[window].any(axis=0)).tolist()) == guilty)
        row["named"] = float(all(union & int(kind) for kind in kinds))
    return row


def score_all(streams: Sequence[Stream], method: str, **options: Any) -> list[dict[str, Any]]:
    """Play a method on streams and score each."""
    return [score_run(stream, play(stream, method, **options)) for stream in streams]
