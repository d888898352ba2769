"""Time and memory of in-situ calibration: eight sets of five minutes at 100 Hz, 240,000 samples.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/in_situ_speed.py
    python benchmarks/in_situ_speed.py --duration 100 --rounds 1
    python benchmarks/in_situ_speed.py --times 10

Compared are the fit with the sensor's hysteresis and without, and the in-situ paper's least squares
(Traversaro, Pucci and Nori, 2015, Eqs. 14-17 and 21-24). They take turns in one process, so that other work
of the machine slows all of them alike. Memory is measured in a process of its own for each: by how much the
peak of its memory (VmHWM of Linux, LAPACK's work space included) rises over that with the sets
loaded. No test asserts these figures.
"""

import argparse
import multiprocessing
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from surefoot.calibration.in_situ import (
    InSituOptions,
    InSituSet,
    calibrate_in_situ,
    estimate_matrix,
    estimate_offset,
)
from surefoot.envs.leg_rig.recording import record_rig
from surefoot.experiments.in_situ.instruments import read_sensor, sensor_config, static_sets
from surefoot.experiments.study.tables import Table, number

Floats = NDArray[np.float64]
Method = Callable[[Sequence[InSituSet]], float]

RATE = 100.0
ACCELEROMETER_NOISE = 0.01
"""Standard deviation in m/s^2."""

_TIMED = "what is timed is the fit"
"""Why refusals are passed: short sets or one without hysteresis might be refused."""


def simulate(duration: float, seed: int = 0) -> tuple[tuple[InSituSet, ...], float]:
    """Record a leg with eight added masses by one FTSens with all its errors; returns its mass in kg too."""
    recordings, rng = record_rig(duration=duration, rate=RATE, seed=seed), np.random.default_rng([seed, 1])
    counts, truth = read_sensor(sensor_config("leg"), "leg", recordings, seed)
    force = np.stack([one.specific_force for one in recordings])
    force = force + ACCELEROMETER_NOISE * rng.normal(size=force.shape)
    return static_sets("leg", recordings, counts, force), truth.limb.mass


def denser(sets: Sequence[InSituSet], times: int, seed: int = 0) -> tuple[InSituSet, ...]:
    """Return sets of so many times the rate: readings are interpolated and rounded with new noise."""
    rng, found = np.random.default_rng([seed, 2]), []
    for one in sets:
        assert one.time is not None
        time = np.linspace(one.time[0], one.time[-1], times * len(one.time))

        def between(columns: Floats, old: Floats = one.time, new: Floats = time) -> Floats:
            return np.stack([np.interp(new, old, column) for column in columns.T], axis=1)

        noise = rng.normal(size=(len(time), one.channels + 3))
        raw = np.rint(between(one.raw) + noise[:, :-3])
        gravity = between(one.gravity) + ACCELEROMETER_NOISE * noise[:, -3:]
        found.append(replace(one, raw=raw, gravity=gravity, time=time))
    return tuple(found)


def ours(sets: Sequence[InSituSet]) -> float:
    """Fit all: matrix, limb, drifting offsets, hysteresis; returns the limb's mass in kg."""
    return calibrate_in_situ(sets, accept=_TIMED).limb.mass


def without_hysteresis(sets: Sequence[InSituSet]) -> float:
    """Fit the same without hysteresis."""
    return calibrate_in_situ(sets, options=InSituOptions(hysteresis=False), accept=_TIMED).limb.mass


def paper(sets: Sequence[InSituSet]) -> float:
    """III-B for each set, then III-C, from triangles of nine rows a set."""
    offsets = [estimate_offset(one.raw, one.gravity).offset for one in sets]
    return estimate_matrix(sets, np.array(offsets)).limb.mass


METHODS: Mapping[str, Method] = {
    "with hysteresis": ours,
    "without hysteresis": without_hysteresis,
    "paper, compressed": paper,
}


def seconds(
    sets: Sequence[InSituSet], names: Sequence[str], rounds: int
) -> tuple[Mapping[str, list[float]], Mapping[str, list[float]], dict[str, float]]:
    """Let the methods take turns; returns time and CPU time of each in s, and the limb's mass in kg."""
    taken: dict[str, list[float]] = {name: [] for name in names}
    worked: dict[str, list[float]] = {name: [] for name in names}
    masses = {}
    for _ in range(rounds):
        for name in names:
            start, busy = time.perf_counter(), time.process_time()
            masses[name] = METHODS[name](sets)
            taken[name].append(time.perf_counter() - start)
            worked[name].append(time.process_time() - busy)
    return taken, worked, masses


def megabytes(sets: Sequence[InSituSet], name: str) -> float:
    """Peak of the memory that a method takes beyond its sets, in MB; NaN where there is no VmHWM."""
    before = _peak()
    METHODS[name](sets)
    return _peak() - before


def _peak() -> float:
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return float("nan")
    return next(float(line.split()[1]) / 1e3 for line in status.splitlines() if line.startswith("VmHWM"))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--duration", type=float, default=300.0, help="length of each of the 8 sets in s, at least 85"
    )
    parser.add_argument("--rounds", type=int, default=3, help="how often each method is timed")
    parser.add_argument("--times", type=int, default=1, help="multiple of the rate of 100 Hz")
    arguments = parser.parse_args()
    names = list(METHODS)
    sets, mass = simulate(arguments.duration)
    if arguments.times > 1:
        sets = denser(sets, arguments.times)
    memory = {}
    for name in names:
        # A fresh interpreter each: a peak never falls again.
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            memory[name] = pool.apply(megabytes, (sets, name))
    taken, worked, masses = seconds(sets, names, arguments.rounds)
    slowest = float(np.median(taken[names[-1]]))
    samples = sum(len(one.raw) for one in sets)
    threads = os.environ.get("OMP_NUM_THREADS", "unset")
    table = Table(
        name="in_situ_speed",
        title=f"{samples:,} samples in {len(sets)} sets, OMP_NUM_THREADS={threads}",
        columns=(
            "method",
            "median s",
            "fastest s",
            "CPU s",
            "memory MB",
            f"times faster than {names[-1]}",
            "limb kg",
        ),
        rows=tuple(
            (
                name,
                number(float(np.median(taken[name]))),
                number(min(taken[name])),
                number(min(worked[name])),
                number(memory[name]),
                number(slowest / float(np.median(taken[name]))),
                number(masses[name], 4),
            )
            for name in names
        ),
        note=f"Memory is what is taken beyond the sets themselves. The limb weighs {mass:.4g} kg.",
    )
    Console().print(table.to_rich())


if __name__ == "__main__":
    main()
