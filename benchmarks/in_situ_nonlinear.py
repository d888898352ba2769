"""What a polynomial on top of the linear in-situ map is worth, on readings that were not fitted.

    python benchmarks/in_situ_nonlinear.py                         # 12 seeds, about three minutes
    SUREFOOT_DATA=/path/to/recordings python benchmarks/in_situ_nonlinear.py --real

The rig's leg and foot are read by sensors whose full scale is near the limb's weight, with all errors of the
instrument (1 % hysteresis among them): linear ones, and such with cubic terms of up to 4 % and products of
two axes of up to 1 % each. Sets 1 to 4 are fitted, once with the limb weighed to 0.2 % and once not; sets 5
to 8, which have other masses, are scored against the true wrench, offsets found anew. A mean over seeds has
its 95 % interval.

Real sensors are scored on loads or halves that were not fitted, by the linear map of the same fit and with
the polynomial, if there is one.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from in_situ_optical import load_optical
from in_situ_real import WINDOW, sensor_recordings_folder
from numpy.typing import NDArray
from rich.console import Console
from scipy.stats import t

from surefoot.calibration.imu import savitzky_golay
from surefoot.calibration.in_situ import InSituFit, InSituOptions, InSituSet, KnownLimb, calibrate_in_situ
from surefoot.calibration.in_situ.validation import as_seen
from surefoot.envs.leg_rig.recording import record_rig
from surefoot.experiments.in_situ.instruments import (
    accelerometer_bias,
    read_imu,
    read_sensor,
    sensor_config,
    static_sets,
)
from surefoot.experiments.study.tables import Table, number

Floats = NDArray[np.float64]

FITTED = 4
RATE = 10.0
FULL_SCALE = {"leg": (60.0, 12.0), "foot": (12.0, 2.0)}
"""In N and N m, near what hangs there: a law in shares of 1500 N does not show under a leg."""

BENT = {"nonlinearity": 0.04, "cross_nonlinearity": 0.01}
WEIGHED, PLACED = 0.002, 0.002
"""Deviations of the limb's mass, as a share, and of its place in m."""

PARTS = {"force N": slice(0, 3), "torque N m": slice(3, 6)}


class Score(NamedTuple):
    """One fit: errors of the linear map and with the polynomial, (2, 6) each, and what was chosen."""

    rms: Floats
    worst: Floats
    degrees: tuple[int, ...]
    limb: float
    """Error of the limb's mass over its deviation."""
    refusal: str


def score(fit: InSituFit, held_out: Sequence[tuple[InSituSet, Floats]], limb: float) -> Score:
    """Score a fit on sets and their true wrenches, each about its own mean error."""
    if fit.refusals:
        return Score(np.full((2, 6), np.nan), np.full((2, 6), np.nan), (), np.nan, str(fit.refusals[0]))
    found = []
    for one in (replace(fit, nonlinear=None), fit):
        errors = []
        for data, wrench in held_out:
            seen = as_seen(data, fit)
            # The offset of these sets is another one: by the model's mean, as a robot would in the air.
            offset = np.nanmean(seen.raw - wrench @ fit.response.T, axis=0)
            error = one.wrench(seen.raw, offset) - wrench
            errors.append(error - np.nanmean(error, axis=0))
        found.append(np.concatenate(errors))
    errors = np.stack(found)
    degrees = fit.nonlinear.degrees if fit.nonlinear else (1,) * 6
    normal = (fit.limb.mass - limb) / fit.limb_mass_std
    return Score(
        np.sqrt(np.nanmean(errors**2, axis=1)), np.nanmax(np.abs(errors), axis=1), degrees, normal, ""
    )


def scores(sensor: str, bent: bool, weighed: bool, seeds: Sequence[int]) -> list[Score]:
    """Calibrate one sensor a seed."""
    force, torque = FULL_SCALE[sensor]
    scale = {"full_scale_force": force, "full_scale_torque": torque}
    true = {"hysteresis_true_force": force / 1.5, "hysteresis_true_torque": torque / 3.0}
    # Cross-talk is in shares of the full scales.
    config = replace(sensor_config(sensor), **scale, **true, **(BENT if bent else {}))
    found = []
    for seed in seeds:
        run = record_rig(range(1, 9), rate=RATE, seed=seed)
        forces = read_imu(run, seed)[..., :3]
        counts, truth = read_sensor(config, sensor, run, seed)
        sets = static_sets(sensor, run, counts, forces - accelerometer_bias(forces))
        limb = truth.limb
        known = KnownLimb(limb.mass, WEIGHED * limb.mass, limb.com, PLACED) if weighed else None
        options = InSituOptions(nonlinear="auto")
        fit = calibrate_in_situ(sets[:FITTED], limb=known, options=options, refuse=False)
        wrenches = [getattr(recording, f"wrench_{sensor}") for recording in run]
        found.append(score(fit, list(zip(sets[FITTED:], wrenches[FITTED:], strict=True)), limb.mass))
    return found


def interval(values: Floats) -> str:
    """Return a mean with its 95 % interval."""
    half = float(t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / np.sqrt(len(values)))
    return f"{number(float(np.mean(values)))} ± {number(half)}"


def rows(name: tuple[str, ...], found: Sequence[Score]) -> Iterator[tuple[str, ...]]:
    """Yield a row for forces and one for torques."""
    answered = [one for one in found if not one.refusal]
    for part, axes in PARTS.items() if answered else ():
        rms = np.array([np.linalg.norm(one.rms[:, axes], axis=1) for one in answered])
        worst = np.max([one.worst[:, axes].max(axis=1) for one in answered], axis=0)
        ratio = rms[:, 1] / rms[:, 0]
        yield (
            *name,
            part,
            f"{len(answered)} of {len(found)}",
            *(interval(column) for column in rms.T),
            interval(ratio),
            number(float(ratio.max())),
            f"{number(worst[0])}, {number(worst[1])}",
            number(float(np.sqrt(np.mean([one.limb**2 for one in answered])))),
        )


def simulated(seeds: Sequence[int]) -> Table:
    """Lay out all cases."""
    laid, refusals = [], []
    for sensor, bent, weighed in (
        ("leg", True, True),
        ("leg", True, False),
        ("leg", False, True),
        ("foot", True, True),
        ("foot", False, True),
    ):
        found = scores(sensor, bent, weighed, seeds)
        name = (sensor, "4 %" if bent else "linear", "weighed" if weighed else "unknown")
        laid += list(rows(name, found))
        refusals += [f"{sensor}: {one.refusal}" for one in found if one.refusal]
    return Table(
        "in_situ_nonlinear",
        f"Sets with other masses, {len(seeds)} sensors a case",
        ("sensor", "law", "limb", "", "answered", "linear, rms", "polynomial, rms", "ratio", "largest",
         "worst, both", "limb's sigmas"),
        tuple(laid),
        " ".join(dict.fromkeys(refusals)),
    )  # fmt: skip


def real() -> Table:
    """Lay out real sensors."""
    folder = sensor_recordings_folder()
    if folder is None:
        sys.exit("SUREFOOT_DATA names no folder that holds 'ft' with the recordings of real sensors.")
    laid = []
    with np.load(folder / "ft" / "icub_right_foot_swing.npz") as file:
        time, raw, gravity = file["t"], file["raw"], file["gravity"]
        factory, mass = file["factory_matrix"], float(file["expected_mass"])
        moment = file["expected_mass_com"].mean(axis=0)
    weight = np.hstack([mass * gravity, np.cross(moment, gravity)])
    halves = slice(0, len(raw) // 2), slice(len(raw) // 2, None)
    raw = np.concatenate([savitzky_golay(raw[half], WINDOW) for half in halves])
    for name, half, other in (("first", *halves), ("second", *halves[::-1])):
        fit = calibrate_in_situ(
            [InSituSet(raw[half], gravity[half], time=time[half], name="swing")],
            factory_matrix=factory,
            limb=KnownLimb(mass, 0.01 * mass, moment / mass, 0.0003),
            options=InSituOptions(drift=0, residual_tolerance=0.2, scale_tolerance=0.5, nonlinear="auto"),
            refuse=False,
        )
        held_out = [(InSituSet(raw[other], gravity[other]), weight[other])]
        laid.append((f"iCub's foot, {name} half fitted", score(fit, held_out, mass)))
    with np.load(folder / "ft" / "kuka_ati_gamma_static.npz") as file:
        wrench, gravity = file["wrench"], file["gravity"]
    direction = np.unique(np.rint(gravity / 9.8), axis=0, return_inverse=True)[1]
    linear = calibrate_in_situ([InSituSet(wrench, gravity)], factory_matrix=np.eye(6), refuse=False)
    out = direction == direction.max()
    fit = calibrate_in_situ(
        [InSituSet(wrench[~out], gravity[~out], name="Gamma")],
        factory_matrix=np.eye(6),
        options=InSituOptions(factory_std=(0.001,) * 6, nonlinear="auto"),
        refuse=False,
    )
    limb = linear.limb
    true = np.hstack([limb.mass * gravity, np.cross(limb.mass_com, gravity)])
    held_out = [(InSituSet(wrench[out], gravity[out]), true[out])]
    laid.append(("ATI Gamma, one direction left out", score(fit, held_out, limb.mass)))
    optical = load_optical(folder)
    wide = {"residual_tolerance": 1.0, "mass_tolerance": 10.0, "scale_tolerance": 10.0, "axis_tolerance": 1e9}
    for j in (1, 2, 3):
        kept = [data for i, data in enumerate(optical.sets) if i != j]
        known = KnownLimb(optical.base[0], 0.005, optical.base[1], 0.005)
        fit = calibrate_in_situ(
            kept, limb=known, options=InSituOptions(nonlinear="auto", **wide), refuse=False
        )
        held_out = [(optical.sets[j], optical.wrenches[j])]
        laid.append((f"printed, {optical.sets[j].name} left out", score(fit, held_out, optical.base[0])))
    cells = []
    for name, one in laid:
        for part, axes in PARTS.items():
            rms = np.linalg.norm(one.rms[:, axes], axis=1)
            worst = np.max(one.worst[:, axes], axis=1)
            bent = ", ".join(map(str, one.degrees)) if max(one.degrees, default=1) > 1 else "linear"
            cells.append((name, part, one.refusal[:60] or bent, *map(number, (*rms, *worst))))
    return Table(
        "in_situ_nonlinear_real",
        "Real sensors, on what was not fitted",
        ("what", "", "degrees", "linear, rms", "polynomial, rms", "linear, worst", "polynomial, worst"),
        tuple(cells),
        "Errors about their mean. The wrench is that of the weighed or modelled load.",
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=12, help="sensors a case")
    parser.add_argument("--first", type=int, default=0, help="the first of the seeds")
    parser.add_argument("--real", action="store_true", help="real recordings")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    Console(width=180).print((real() if arguments.real else simulated(seeds)).to_rich())


if __name__ == "__main__":
    main()
