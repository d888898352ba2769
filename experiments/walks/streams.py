"""One stream of the arena: a log, what was done to it, and which of its samples are judged."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surefoot.experiments.arrays import Floats
from surefoot.experiments.logs.format import Log, LogTruth, read_log
from surefoot.experiments.walks.options import ArenaOptions
from surefoot.experiments.walks.recordings import log_paths
from surefoot.experiments.walks.replay import starting_map
from surefoot.experiments.walks.scenarios import Scenario
from surefoot.experiments.walks.score import held
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.sensors import Fault, LoadCells, apply_faults

FALLING = 1.0  # the last s before a robot lay on the ground, in which it no longer walks
LEAST_JUDGED = 4.0  # shortest part of a walk in s that is worth a score
FAULT_DELAY = 4.0  # s after settling until which a fault may come; at most a third of what is left

_NOISE_STREAM = 0xFA18


@dataclass(frozen=True, eq=False)
class Stream:
    """A log of N samples and how to judge what a method makes of it."""

    log: Log  # with truth
    seed: int
    judged: NDArray[np.bool_]  # samples whose errors count, shape (N,)
    began: float  # to walk, or anything moved, in s
    faults: tuple[Fault, ...] = ()  # of its channels
    fell: bool = False  # the log then ends before it
    cop: Floats | None = None  # to score against in m, (N, 2), where known better than from the true forces

    @property
    def truth(self) -> LogTruth:
        """What the simulator knew."""
        assert self.log.truth is not None
        return self.log.truth

    @property
    def start(self) -> Floats:
        """Forces in N by the map that methods start from, held where no reading arrived, shape (N, K)."""
        return starting_map(self.log).force(held(self.log.raw))  # type: ignore[no-any-return]


def streams_of(scenario: Scenario, options: ArenaOptions) -> tuple[list[Stream], int]:
    """Return the recorded walks of a scenario with its faults, and how many fell too early for a score."""
    streams, left_out = [], 0
    for seed in scenario.seeds(options.seeds):
        paths = log_paths(scenario.walk, seed, options.duration, options.logs)
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
    kept = log.time <= log.time[-1] - FALLING
    truth = log.truth
    if truth is not None:
        truth = LogTruth(**{name: getattr(truth, name)[kept] for name in LogTruth.__dataclass_fields__})
    reference = type(log.reference)(*(part[kept] for part in log.reference))
    return replace(log, time=log.time[kept], raw=log.raw[kept], reference=reference, truth=truth)


def _cells_of(scenario: Scenario) -> LoadCells:
    cells = {one.name: one.cells for one in scenario.walk.conditions}[scenario.condition]
    if cells is None:
        raise ValueError(f"Faults befall load cells, and scenario '{scenario.name}' has none.")
    return cells
