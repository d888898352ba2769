"""Replay the streams of a scenario, and keep the data that the scores need and nothing else.

A covariance is held against the truth as it appears, once a second, and forgotten.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats, take_rows
from surefoot.calibration import Estimate, FootCalibrator, MomentumReference, Parameters, Reference
from surefoot.calibration.cop import cop_of_feet, sole_wrenches
from surefoot.experiments.logs.format import Log, LogTruth, read_log
from surefoot.experiments.walks.options import WalkStudyOptions
from surefoot.experiments.walks.replay import age_of, beliefs_of, starting_map, steps_of
from surefoot.experiments.walks.scenarios import TRUE_MAP, Scenario, log_paths
from surefoot.experiments.walks.score import hold_last
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.sensors import Fault, LoadCells, apply_faults

FALLING = 1.0  # the last s before a robot lay on the ground, in which it no longer walks
LEAST_JUDGED = 4.0  # shortest part of a walk in s that is worth a score
FAULT_DELAY = 4.0  # s after settling until which a fault may come; at most a third of what is left

_NOISE_STREAM = 0xFA18


@dataclass(frozen=True, eq=False)
class Stream:
    """A log of N samples and how to judge a method on it."""

    log: Log  # with truth
    seed: int
    judged: NDArray[np.bool_]  # samples whose errors count, shape (N,)
    began: float  # to walk, or anything moved, in s
    faults: tuple[Fault, ...] = ()  # of its channels
    fell: bool = False  # the log then ends before it
    cop: Floats | None = None  # to score against in m, (N, 2), where known better than from the true forces

    @property
    def truth(self) -> LogTruth:
        """The simulator's truth."""
        assert self.log.truth is not None
        return self.log.truth

    @property
    def start(self) -> Floats:
        """Forces in N by the map that methods start from, held where no reading arrived, shape (N, K)."""
        return starting_map(self.log).force(hold_last(self.log.raw))  # type: ignore[no-any-return]


def streams_of(scenario: Scenario, options: WalkStudyOptions) -> tuple[list[Stream], int]:
    """Return the recorded walks of a scenario with its faults, and how many fell too early for a score."""
    streams, left_out = [], 0
    for seed in scenario.seeds(options.seeds):
        paths = log_paths(scenario, seed, options.duration, options.logs)
        log = read_log(paths[scenario.condition])
        fell = bool(log.about["fell"])
        if fell:
            log = cut_fall(log)
        end = float(log.time[-1]) if len(log) else 0.0
        if end < options.settle + LEAST_JUDGED:
            left_out += 1
            continue
        earliest = options.settle + min(FAULT_DELAY, (options.duration - options.settle) / 3.0)
        faults = scenario.faults_of(seed, earliest)
        if faults:
            rng = np.random.default_rng([_NOISE_STREAM, seed])
            log = replace(log, raw=apply_faults(log.raw, log.time, faults, _cells_of(scenario), rng))
        streams.append(Stream(log, seed, log.time >= options.settle, STAND_TIME, faults, fell))
    return streams, left_out


def cut_fall(log: Log) -> Log:
    """Cut off the end of a walk, in which the robot fell."""
    return log.cut(slice(int(np.sum(log.time <= log.time[-1] - FALLING))))


def _cells_of(scenario: Scenario) -> LoadCells:
    cells = {one.name: one.cells for one in scenario.cells}[scenario.condition]
    if cells is None:
        raise ValueError(f"Faults befall load cells, and scenario '{scenario.name}' has none.")
    return cells


SNAPSHOT = 1.0  # time between looks at a covariance in s


@dataclass(frozen=True, eq=False)
class Played:
    """The result of a method on one stream of N samples and K channels.

    ``looks`` are squared errors by the covariance claimed, over their number: 1 is right, NaN is no claim. A
    row a look: its time in s, of (a, b), and of the centre of pressure.
    """

    force: Floats  # in N, shape (N, K)
    scale: Floats  # a in F = a F0 + b, F0 by the starting map, shape (N, K)
    offset: Floats  # b in N, shape (N, K)
    flags: NDArray[np.int64]  # bits of :class:`~surefoot.calibration.Flag`, shape (N, K)
    looks: Floats = field(default_factory=lambda: np.empty((0, 3)))
    nis: tuple[float, float] = (0.0, 0.0)  # sum of normalised squared innovations of judged samples; of rows


def play(streams: Sequence[Stream], method: str, **options: Any) -> list[Played]:
    """Run a method, or the true map, over streams of any lengths and robots; each option is the method's."""
    if method == TRUE_MAP:
        return [_true_map(stream) for stream in streams]
    return [_play(stream, method, options) for stream in streams]


def _true_map(stream: Stream) -> Played:
    undone = Parameters(stream.truth.scale, stream.truth.offset).relative_to(starting_map(stream.log))
    flags = np.zeros(stream.log.raw.shape, dtype=np.int64)
    return Played(_undo_errors(stream), undone.scale, undone.offset, flags)


def _undo_errors(stream: Stream) -> Floats:
    """Undo all errors of the readings at every moment, the cross-talk of six-axis sensors included."""
    log, truth = stream.log, stream.truth
    own: Floats = truth.scale * hold_last(log.raw) + truth.offset
    if "truth_cross_talk" not in log.about:
        return own
    # Each axis's own scale g and offset are undone: (I + X / g) w is left, besides the weight beyond it.
    talk, preload = np.array(log.about["truth_cross_talk"]), np.array(log.about["truth_preload"])
    mixed = np.eye(len(talk)) + (truth.scale / log.nominal.scale)[..., None] * talk
    undone: Floats = np.linalg.solve(mixed, (own - preload)[..., None])[..., 0] + preload
    return undone


def _play(stream: Stream, method: str, options: dict[str, Any]) -> Played:
    log, start = stream.log, starting_map(stream.log)
    known: dict[str, Any] = {"mass": log.mass, "dt": log.dt, "lag": log.lag, "age": age_of(log)}
    calibrator = FootCalibrator(log.layout, method, **known, **options)
    force, scale, offset = np.empty((3, len(log), log.layout.channels))
    flags = np.empty(force.shape, dtype=np.int64)
    truth = Parameters(stream.truth.scale, stream.truth.offset).relative_to(start)
    true_map = np.hstack([truth.scale, truth.offset])
    every, looks = max(round(SNAPSHOT / log.dt), 1), []
    nis = rows = 0.0
    # Readings are handed over as forces by the starting map, which scale and offset are then relative to.
    reading, beliefs = start.force(log.raw), beliefs_of(log, method)
    for k, step in enumerate(steps_of(log).tolist()):
        now = take_rows(beliefs, k)
        estimate = calibrator.update(reading[k], now, step)
        force[k], scale[k], offset[k] = estimate.force, estimate.scale, estimate.offset
        flags[k] = estimate.flags
        if estimate.nis is not None and stream.judged[k] and estimate.nis_rows and np.isfinite(estimate.nis):
            nis, rows = nis + float(estimate.nis), rows + float(estimate.nis_rows)
        if (k + 1) % every == 0:
            looks.append((log.time[k], *_nees(stream, k, true_map[k], estimate, now)))
    return Played(force, scale, offset, flags, np.array(looks).reshape(-1, 3), (nis, rows))


def _nees(
    stream: Stream, k: int, true_map: Floats, estimate: Estimate, reference: Reference | MomentumReference
) -> tuple[float, float]:
    """Squared errors of map and CoP at sample ``k`` by the covariance claimed, over their number."""
    nees = cop = float("nan")
    # A faulty channel no longer reads its own force: there is no map to compare the estimate with.
    if not stream.faults:
        nees = _normalise(np.hstack([estimate.scale, estimate.offset]) - true_map, estimate.covariance)
    if estimate.cop_covariance is not None and estimate.cop_valid:
        # The true forces are placed under the soles that the estimate is placed under.
        wrench = sole_wrenches(stream.truth.force[k], stream.log.layout)
        true_cop = cop_of_feet(wrench, reference.position_sole, reference.R_level_sole)
        cop = _normalise(estimate.cop - true_cop, estimate.cop_covariance)
    return nees, cop


def _normalise(error: Floats, covariance: Any) -> float:
    """Return squared errors by their covariance over their number; infinite where it is not one."""
    if covariance is None:
        return float("nan")
    values, vectors = np.linalg.eigh(covariance) if np.isfinite(covariance).all() else (np.zeros(1), None)
    if vectors is None or values[0] <= 0.0:
        return float("inf")
    return float(np.mean((vectors.T @ error) ** 2 / values))
