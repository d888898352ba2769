"""How right and how sure in-situ calibration is, by the limb's path and the sensor's hysteresis.

    python benchmarks/in_situ_raster.py                       # 20 seeds, about half an hour
    python benchmarks/in_situ_raster.py --seeds 3 --paths raster --kinds "backlash of 1 %"

A raster moves the second joint once while the first sweeps, so that a drift of the sensor's offset looks
like that turn; a sweep moves both many times. Sensor and IMU have all their errors. For each case it prints
how many were answered, the error of the limb's weight, the squared error per parameter by the fit's own
covariance (NEES; 1 where the fit is as sure as it is right), the share of the matrix's entries that 95 %
intervals hold, and why the others were refused.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from surefoot.calibration.in_situ import calibrate_in_situ
from surefoot.calibration.in_situ.validation import normalise_error
from surefoot.envs.leg_rig.recording import RigRecording, record_rig
from surefoot.experiments.in_situ.instruments import (
    accelerometer_bias,
    read_imu,
    read_sensor,
    sensor_config,
    static_sets,
)
from surefoot.experiments.study.tables import Table, number

Floats = NDArray[np.float64]

SETS = (1, 2, 3, 4)

KINDS: dict[str, dict[str, Any]] = {
    "white noise": {},
    "no hysteresis": {"hysteresis": 0.0},
    "loops of 1 %": {"hysteresis": 0.01},
    "loops of 1.5 %": {"hysteresis": 0.015},
    "backlash of 1 %": {"hysteresis": 0.0},
    "creep of 1 %": {
        "hysteresis": 0.0,
        "creep_shares": (0.005, 0.005),
        "creep_time_constants": (10.0, 100.0),
    },
}
"""Hysteresis of a sensor, as options of the device; the first has none."""

BACKLASH = 0.01
"""Half of its width over the largest amplitude of a load."""

TWO_SIDED = 1.96
"""Deviations to either side that hold 95 % of a normal distribution."""


class Score(NamedTuple):
    """One seed: the weight's error, its NEES per unknown, entries in their intervals, or the refusal."""

    weight: float
    nees: float
    held: float
    refusal: str


def with_backlash(recordings: Sequence[RigRecording], sensor: str) -> list[RigRecording]:
    """Let loads pass through a joint with backlash before the sensor feels them."""
    loads = [getattr(one, f"wrench_{sensor}") for one in recordings]
    half = BACKLASH * np.max([np.ptp(load, axis=0) / 2.0 for load in loads], axis=0)
    found = []
    for one, load in zip(recordings, loads, strict=True):
        felt, at = np.empty_like(load), np.zeros(6)
        for i, row in enumerate(load):
            felt[i] = at = np.clip(at, row - half, row + half)
        found.append(replace(one, **{f"wrench_{sensor}": felt}))
    return found


def score(path: str, sensor: str, kind: str, seed: int, rate: float, times: bool) -> Score:
    """Calibrate one sensor."""
    config = replace(sensor_config(sensor, white=kind == "white noise"), **KINDS[kind])
    run = record_rig(SETS, rate=rate, seed=seed, rasters=path == "raster")
    force = read_imu(run, seed)[..., :3]
    felt = with_backlash(run, sensor) if kind.startswith("backlash") else run
    counts, truth = read_sensor(config, sensor, felt, seed)
    sets = static_sets(sensor, run, counts, force - accelerometer_bias(force))
    fit = calibrate_in_situ(sets if times else [replace(one, time=None) for one in sets], refuse=False)
    if fit.refusals:
        return Score(np.nan, np.nan, np.nan, str(fit.refusals[0]))
    off = np.abs(fit.matrix - np.linalg.inv(truth.response)) / fit.matrix_std
    nees = normalise_error(fit, truth.response, truth.offset, truth.limb) / len(fit.covariance)
    return Score(fit.limb.mass / truth.limb.mass - 1.0, nees, float(np.mean(off < TWO_SIDED)), "")


def row(key: tuple[str, ...], found: Sequence[Score]) -> tuple[str, ...]:
    """Lay out one case."""
    answered = [one for one in found if not one.refusal]
    count = f"{len(answered)} of {len(found)}"
    if not answered:
        return (*key, count, *[""] * 5)
    weight = 100.0 * np.abs([one.weight for one in answered])
    nees = [one.nees for one in answered]
    held = 100.0 * float(np.mean([one.held for one in answered]))
    return (*key, count, *map(number, (np.median(weight), np.max(weight), np.mean(nees), np.max(nees), held)))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20, help="sensors a case")
    parser.add_argument("--first", type=int, default=0, help="the first of the seeds")
    parser.add_argument("--rate", type=float, default=20.0, help="samples per s")
    parser.add_argument("--paths", nargs="+", default=["raster", "sweep"], choices=["raster", "sweep"])
    parser.add_argument("--sensors", nargs="+", default=["leg", "foot"], choices=["leg", "foot"])
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--without-times", action="store_true", help="leave the samples' times out")
    arguments = parser.parse_args()
    rows, refusals = [], []
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    for case in product(arguments.paths, arguments.sensors, arguments.kinds):
        found = [score(*case, seed, arguments.rate, not arguments.without_times) for seed in seeds]
        rows.append(row(case, found))
        counted = Counter(one.refusal for one in found if one.refusal)
        refusals += [f"{', '.join(case)}: {count} x {why}" for why, count in counted.items()]
    table = Table(
        name="in_situ_raster",
        title=f"{arguments.seeds} sensors a case, four sets of five minutes at {arguments.rate:g} Hz",
        columns=(
            *("path", "sensor", "kind", "answered", "weight %", "worst %", "NEES", "worst NEES"),
            "in 95 % (%)",
        ),
        rows=tuple(rows),
    )
    console = Console(width=140)
    console.print(table.to_rich())
    for line in refusals:
        console.print(line, markup=False)


if __name__ == "__main__":
    main()
