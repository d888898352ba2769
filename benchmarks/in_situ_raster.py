"""How right and how sure in-situ calibration is, by the limb's path and the sensor's hysteresis.

    python benchmarks/in_situ_raster.py                       # 20 seeds, about ten minutes
    python benchmarks/in_situ_raster.py --seeds 3 --paths raster

A raster moves the second joint once while the first sweeps, so that a drift of the sensor's offset looks
like that turn; a sweep moves both many times. Sensor and IMU have all their errors. For each case it prints
how many were answered, the error of the limb's weight, the squared error per parameter by the fit's own
covariance (NEES; 1 where the fit is as sure as it is right), how many 95 % intervals of each kind of
parameter hold the truth, and why the others were refused.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from scipy.stats import binom

from surefoot.calibration.in_situ import InSituFit, calibrate_in_situ
from surefoot.calibration.in_situ.validation import normalised_error
from surefoot.envs.leg_rig.recording import record_rig
from surefoot.experiments.in_situ.instruments import (
    SensorTruth,
    accelerometer_bias,
    read_imu,
    read_sensor,
    sensor_config,
    static_sets,
)
from surefoot.experiments.study.tables import Table, number

Floats = NDArray[np.float64]

_COLUMNS = (
    *("path", "sensor", "hysteresis", "times", "answered", "weight %", "worst %", "NEES"),
    *("in 95 %: matrix", "offset", "limb"),
)

SETS = (1, 2, 3, 4)
HELD, TWO_SIDED = 0.95, 1.96
"""Share of a normal distribution, and the standard deviations to either side that hold it."""


class Case(NamedTuple):
    """What was calibrated, by hysteresis (None: white noise is all); ``times``: whether they were given."""

    path: str
    sensor: str
    hysteresis: float | None
    times: bool


class Score(NamedTuple):
    """One seed: the weight's error, its NEES per unknown, errors over deviations by kind, or the refusal."""

    weight: float
    nees: float
    normal: dict[str, Floats]
    refusal: str


def scores(case: Case, seeds: Sequence[int], rate: float) -> list[Score]:
    """Calibrate one sensor a seed."""
    config = sensor_config(case.sensor, white=case.hysteresis is None)
    config = replace(config, hysteresis=case.hysteresis or 0.0)
    found = []
    for seed in seeds:
        run = record_rig(SETS, rate=rate, seed=seed, rasters=case.path == "raster")
        force = read_imu(run, seed)[..., :3]
        counts, truth = read_sensor(config, case.sensor, run, seed)
        sets = static_sets(case.sensor, run, counts, force - accelerometer_bias(force))
        if not case.times:
            sets = tuple(replace(one, time=None) for one in sets)
        found.append(score(calibrate_in_situ(sets, refuse=False), truth))
    return found


def score(fit: InSituFit, truth: SensorTruth) -> Score:
    """Compare a fit with the truth."""
    if fit.refusals:
        return Score(np.nan, np.nan, {}, str(fit.refusals[0]))
    normal = {
        "matrix": (fit.matrix - np.linalg.inv(truth.response)) / fit.matrix_std,
        "offset": (fit.offset - truth.offset) / fit.offset_std,
        "limb": np.array([fit.limb.mass - truth.limb.mass, *(fit.limb.mass_com - truth.limb.mass_com)])
        / np.sqrt(np.diag(fit.covariance)[fit.columns.limb]),
    }
    nees = normalised_error(fit, truth.response, truth.offset, truth.limb) / len(fit.covariance)
    return Score(fit.limb.mass / truth.limb.mass - 1.0, nees, normal, "")


def covered(answered: Sequence[Score], kind: str) -> Floats:
    """Share of the seeds whose 95 % interval holds each parameter of a kind."""
    return np.asarray(np.mean([np.abs(one.normal[kind]).ravel() < TWO_SIDED for one in answered], axis=0))


def by_chance(seeds: int, parameters: int) -> float:
    """Expected share of the worst of some independent parameters whose intervals are just right."""
    at_least = binom.sf(np.arange(seeds), seeds, HELD)
    return float(np.mean(at_least**parameters))


def shown(case: Case) -> str:
    """Return a case's hysteresis in words."""
    return "white" if case.hysteresis is None else f"{case.hysteresis:.1%}"


def row(case: Case, found: Sequence[Score]) -> tuple[str, ...]:
    """Lay out one case."""
    answered = [one for one in found if not one.refusal]
    key = (case.path, case.sensor, shown(case), "yes" if case.times else "no")
    if not answered:
        return (*key, f"0 of {len(found)}", *[""] * 6)
    weight = 100.0 * np.array([one.weight for one in answered])
    shares = [covered(answered, kind) for kind in ("matrix", "offset", "limb")]
    return (
        *key,
        f"{len(answered)} of {len(found)}",
        number(float(np.median(np.abs(weight)))),
        number(float(np.max(np.abs(weight)))),
        number(float(np.mean([one.nees for one in answered]))),
        *(
            f"{share.mean():.0%} ({share.min():.0%}, {by_chance(len(answered), len(share)):.0%})"
            for share in shares
        ),
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20, help="sensors a case")
    parser.add_argument("--first", type=int, default=0, help="the first of the seeds")
    parser.add_argument("--rate", type=float, default=20.0, help="samples per s")
    parser.add_argument("--paths", nargs="+", default=["raster", "sweep"], choices=["raster", "sweep"])
    parser.add_argument("--sensors", nargs="+", default=["leg", "foot"], choices=["leg", "foot"])
    parser.add_argument("--hysteresis", nargs="+", type=float, default=[0.0, 0.01, 0.015], help="shares")
    parser.add_argument("--white", action="store_true", help="sensors of white noise alone")
    parser.add_argument("--without-times", action="store_true", help="leave the samples' times out")
    arguments = parser.parse_args()
    cases = [
        Case(path, sensor, share, not arguments.without_times)
        for path in arguments.paths
        for sensor in arguments.sensors
        for share in ([None] if arguments.white else arguments.hysteresis)
    ]
    rows, refusals = [], []
    for case in cases:
        found = scores(case, range(arguments.first, arguments.first + arguments.seeds), arguments.rate)
        rows.append(row(case, found))
        counted = Counter(one.refusal for one in found if one.refusal)
        name = f"{case.path}, {case.sensor}, {shown(case)}"
        refusals += [f"{name}: {count} x {why}" for why, count in counted.items()]
    table = Table(
        name="in_situ_raster",
        title=f"{arguments.seeds} sensors a case, four sets of five minutes at {arguments.rate:g} Hz",
        columns=_COLUMNS,
        rows=tuple(rows),
        note=(
            "Coverage is the mean over parameters; in brackets that of the worst parameter, and what the "
            "worst of so many independent ones would have in the mean if every interval were just right."
        ),
    )
    console = Console()
    console.print(table.to_rich())
    for line in refusals:
        console.print(line, markup=False)


if __name__ == "__main__":
    main()
