"""In-situ calibration of simulated sensors: contact loads, paths and hysteresis, and later offsets.

    python benchmarks/in_situ.py contact        # 20 sensors a cell, six minutes
    python benchmarks/in_situ.py raster         # 20 seeds a cell, half an hour
    python benchmarks/in_situ.py tracker        # 3 seeds a row, two minutes
    python benchmarks/in_situ.py tracker --jump --seeds 2
    python benchmarks/in_situ.py contact --out out/results && python docs/study_tables.py out/results

**contact**: a six-axis sensor (12 bits of noise, or ten times as much) whose maker's matrix is off by a share
of full scale in every entry is calibrated with one to four loads: a bare tool, and masses on it. It is scored
with pushes of up to half of full scale at random, which no tool's weight resembles: the error of the wrench
beside the offset, of the maker's matrix and of the calibrated one; how much worse than its maker the worst
sensor gets; and the share of the calibrated matrix's entries that its 95 % intervals hold.

**raster**: legs and feet with all errors of sensor and IMU. A raster moves the second joint once while the
first sweeps, so that a drift of the sensor's offset looks like that turn; a sweep moves both many times. The
table has the error of the limb's weight, and the squared error per parameter by the fit's own covariance
(NEES; 1 where the fit is as sure as it is right).

**tracker**: sensors that were calibrated with four masses go on in the air for five minutes on another path.
Compared over the second half are the offset of the fit, the mean difference of readings and the fit's weight
over the last 30 s, and the tracker, with its NEES a channel. With ``--jump`` the sensor was switched off and
on again in between.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import bench
import numpy as np
import pandas as pd
from rig import (
    OFFSET_SHIFT,
    accelerometer_bias,
    read_imu,
    read_sensor,
    sensor_config,
    static_sets,
)
from scipy.spatial.transform import Rotation

from surefoot.arrays import Floats
from surefoot.calibration.in_situ import InSituFit, InSituSet, InSituTracker, calibrate_in_situ
from surefoot.envs.leg_rig.recording import RigRecording, record_rig
from surefoot.experiments.force_torque.validation import normalise_error
from surefoot.experiments.study.page import save_tables
from surefoot.experiments.study.tables import Table
from surefoot.sensors import strain_gauges
from surefoot.sensors.devices.strain_gauges import shift_offset, true_response

TWO_SIDED = 1.96  # deviations to either side that hold 95 % of a normal distribution


def count_held(fit: InSituFit, response: Floats) -> float:
    """Return the share of a matrix's entries that 95 % intervals hold."""
    off = np.abs(fit.matrix - np.linalg.inv(response)) / fit.matrix_std
    return float(np.mean(off < TWO_SIDED))


FULL_SCALE = np.array([130.0, 130.0, 400.0, 10.0, 10.0, 10.0])  # of an ATI Gamma SI-130-10 in N and N m
NOISE = {"": 2.0**-12, ", noisy": 10.0 * 2.0**-12}  # white noise as a share of full scale
OFF = {"": (0.0, 0.01, 0.03, 0.1), ", noisy": (0.03, 0.1)}
"""How far the maker's matrix is off, as a share of full scale."""

LOADS = (
    (0.0, (0.0, 0.0, 0.0)),
    (1.0, (0.12, 0.0, 0.08)),
    (1.0, (-0.05, 0.1, 0.1)),
    (1.5, (0.0, -0.08, 0.15)),
)
"""Masses in kg, and their places in m."""

TOOL = (1.2, np.array([0.01, 0.02, 0.06]))
ROWS, SPACING = 600, 0.1
GRAVITY_NOISE = 0.02  # in m/s^2
COUNTED = ("one load", "two", "three", "four")


def load_sensor(seed: int, loads: int, off: float, noise: float) -> tuple[list[InSituSet], Floats]:
    """Return sets of a driver's newtons and the true response."""
    rng = np.random.default_rng([7, seed, loads, round(1e4 * off), round(1e6 * noise)])
    response = np.eye(6) + off * rng.standard_normal((6, 6)) * FULL_SCALE[:, None] / FULL_SCALE
    clock = np.asarray(SPACING * np.arange(ROWS), dtype=np.float64)
    sets: list[InSituSet] = []
    for mass, place in LOADS[:loads]:
        phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        angles = np.array([1.2, 1.4]) * np.sin(2.0 * np.pi * clock[:, None] / np.array([37.0, 23.0]) + phase)
        gravity = Rotation.from_euler("xy", angles).inv().apply([0.0, 0.0, -9.80665])
        moment = TOOL[0] * TOOL[1] + mass * np.array(place)
        wrench = np.concatenate([(TOOL[0] + mass) * gravity, np.cross(moment, gravity)], axis=1)
        read = wrench @ response.T + rng.normal(0.0, 0.02, 6) * FULL_SCALE
        read = read + noise * FULL_SCALE * rng.standard_normal(read.shape)
        felt = gravity + GRAVITY_NOISE * rng.standard_normal(gravity.shape)
        sets.append(InSituSet(read, felt, mass, place, time=clock, name=f"load {len(sets)}"))
    return sets, response


def push(seed: int, loads: int, off: float, noise: float) -> dict[str, Any]:
    """Calibrate one sensor; return errors of forces and torques as shares of full scale."""
    sets, response = load_sensor(seed, loads, off, noise)
    pushes = 0.5 * FULL_SCALE * np.random.default_rng([8, seed]).uniform(-1.0, 1.0, (500, 6))

    def error(matrix: Floats) -> Floats:
        wrong = (pushes @ (matrix @ response - np.eye(6)).T) / FULL_SCALE
        return np.asarray(np.sqrt(np.mean(wrong.reshape(-1, 2, 3) ** 2, axis=(0, 2))))

    fit = calibrate_in_situ(sets, factory_matrix=np.eye(6), refuse=False)
    found = {"maker": error(np.eye(6)), "refusal": str(fit.refusals[0]) if fit.refusals else ""}
    return found | {"ours": error(fit.matrix), "held": count_held(fit, response)}


def contact(seeds: Sequence[int], _: argparse.Namespace) -> list[Table]:
    """Score contact loads that no fit has seen."""
    rows: list[tuple[str, ...]] = []
    for name, noise in NOISE.items():
        for off in OFF[name]:
            cells, worst, inside = [], [], []
            for loads in range(1, 1 + len(LOADS)):
                found = [push(seed, loads, off, noise) for seed in seeds]
                told = [one for one in found if not one["refusal"]]
                ours, maker = (np.array([one[key] for one in told]) for key in ("ours", "maker"))
                cells += [pair(maker.mean(axis=0))] * (loads == 1) + [pair(ours.mean(axis=0))]
                worst.append(f"{100.0 * np.max(ours - maker):+.2f}")
                inside.append(f"{100.0 * np.mean([one['held'] for one in told]):.0f}")
                tell_refusals(f"{off:.0%}{name}, {loads}", found)
            rows.append(
                (f"{off:.0%}{name}".replace("%", " %"), *cells, " / ".join(worst), " / ".join(inside))
            )
    heads = (
        "maker off by",
        "the maker's",
        *COUNTED,
        "worst sensor, against its maker",
        "in 95 % intervals (%)",
    )
    return [Table("contact", "Errors of contact loads, % of full scale", heads, tuple(rows))]


def pair(errors: Floats) -> str:
    """Return errors of forces and torques in % of full scale."""
    return " / ".join(f"{100.0 * one:.2f}" if one < 0.01 else f"{100.0 * one:.1f}" for one in errors)


def tell_refusals(case: str, found: Sequence[dict[str, Any]]) -> None:
    """Print why a case's sensors were refused."""
    for why, count in Counter(one["refusal"] for one in found if one["refusal"]).items():
        print(f"{case}: {count} x {why[:300]}")


KINDS: dict[str, dict[str, Any]] = {
    "no hysteresis": {"hysteresis": 0.0},
    "loops of 1 %": {"hysteresis": 0.01},
    "loops of 1.5 %": {"hysteresis": 0.015},
    "backlash of 1 %": {"hysteresis": 0.0},
    "creep of 1 %, half of it in 10 s, half in 100 s": {
        "hysteresis": 0.0,
        "creep_shares": (0.005, 0.005),
        "creep_time_constants": (10.0, 100.0),
    },
    "Dahl's friction of 1.25 %": {"hysteresis": 0.0},
    "Bouc and Wen's law of 1.25 %": {"hysteresis": 0.0},
}
"""Hysteresis of a sensor, as options of the device."""

FOREIGN = 0.0125  # hysteresis of laws that the fit does not contain: half of a loop over half of the swing
BACKLASH = 0.01  # half of its width over the largest amplitude of a load
RASTER_RATE = 20.0  # samples per s


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


def lag_otherwise(load: Floats, half: Floats, law: str) -> Floats:
    """Let loads, shape (n, 6), with half swings, shape (6,), lag by a law that the fit does not contain.

    The friction z approaches its limit over a tenth of the swing (Dahl, 1968), or over 15 % of it with loops
    that differ from side to side (Bouc, 1967; Wen, 1976).
    """
    felt, z, last = np.empty_like(load), np.zeros(6), np.zeros(6)
    for i, row in enumerate(load):
        if law.startswith("Dahl"):
            step = row - last
            z = np.sign(step) + (z - np.sign(step)) * np.exp(-np.abs(step) / (0.2 * half))
        else:
            parts = 1 + int(20.0 * np.max(np.abs(row - last) / (0.3 * half)))
            for step in np.tile((row - last) / (0.3 * half) / parts, (parts, 1)):
                z = z + step - 0.6 * np.abs(step * z) * z - 0.4 * step * z**2
        felt[i], last = row - FOREIGN * half * z, row
    return felt


def with_another_law(recordings: Sequence[RigRecording], sensor: str, law: str) -> list[RigRecording]:
    """Let loads lag before the sensor feels them, by a law that the fit does not contain."""
    loads = [getattr(one, f"wrench_{sensor}") for one in recordings]
    half = np.max([np.ptp(load, axis=0) / 2.0 for load in loads], axis=0)
    changes: list[dict[str, Any]] = [{f"wrench_{sensor}": lag_otherwise(load, half, law)} for load in loads]
    return [replace(one, **change) for one, change in zip(recordings, changes, strict=True)]


def turn(path: str, sensor: str, kind: str, seed: int) -> dict[str, Any]:
    """Calibrate one sensor on a path."""
    config = replace(sensor_config(sensor), **KINDS[kind])
    run = record_rig((1, 2, 3, 4), rate=RASTER_RATE, seed=seed, rasters=path == "raster")
    force = read_imu(run, seed)[..., :3]
    felt = with_backlash(run, sensor) if kind.startswith("backlash") else run
    if kind.startswith(("Dahl", "Bouc")):
        felt = with_another_law(run, sensor, kind)
    counts, truth = read_sensor(config, sensor, felt, seed)
    fit = calibrate_in_situ(static_sets(sensor, run, counts, force - accelerometer_bias(force)), refuse=False)
    case = {"path": path, "sensor": sensor, "hysteresis": kind, "seed": seed}
    if fit.refusals:
        return case | {"refusal": str(fit.refusals[0])}
    nees = normalise_error(fit, truth.response, truth.offset, truth.limb) / len(fit.covariance)
    weight = 100.0 * abs(fit.limb.mass / truth.limb.mass - 1.0)
    return case | {"weight": weight, "NEES": nees, "held": count_held(fit, truth.response), "refusal": ""}


def raster(seeds: Sequence[int], given: argparse.Namespace) -> list[Table]:
    """Score the limb's weight by path and hysteresis."""
    kinds = [kind for kind in KINDS if given.only in kind]
    cases = product(("raster", "sweep"), ("leg", "foot"), kinds, seeds)
    data = pd.DataFrame([turn(*case) for case in cases])
    groups = data.groupby(["path", "sensor", "hysteresis"], sort=False)
    every = groups.agg(
        answered=("weight", "count"), median=("weight", "median"), worst=("weight", "max"),
        NEES=("NEES", "mean"), worst_NEES=("NEES", "max"), held=("held", "mean"),
    )  # fmt: skip
    print(every.round(3).to_string())
    tell_refusals("raster", data.to_dict("records"))
    columns = {
        f"{path}: {name}, leg / foot": [
            " / ".join(f"{every.loc[(path, one, kind), key]:.2f}" for one in ("leg", "foot")) + unit
            for kind in kinds
        ]
        for path in ("raster", "sweep")
        for name, key, unit in (("worst error", "worst", " %"), ("NEES", "NEES", ""))
    }
    rows = tuple(zip(kinds, *columns.values(), strict=True))
    return [Table("raster", "Error of the limb's weight", ("hysteresis", *columns), rows)]


TRACKER_RATE, MEAN = 10.0, 30.0  # samples per s, and the mean's length in s


def follow(sensor: str, seed: int, hysteresis: float, drifts: bool, jump: bool) -> tuple[Floats, float]:
    """Return errors (nothing, mean, tracker) in N and N m, shape (3, 2), and the tracker's NEES."""
    config = replace(sensor_config(sensor), hysteresis=hysteresis)
    if not drifts:
        config = replace(config, offset_drift_force=0.0, offset_drift_torque=0.0)
    run = [
        *record_rig((1, 2, 3, 4), rate=TRACKER_RATE, seed=seed),
        *record_rig((1,), rate=TRACKER_RATE, seed=seed + 1000),
    ]
    felt = read_imu(run, seed)[..., :3]
    felt = felt - accelerometer_bias(felt[:4])
    rng, noise = np.random.default_rng([31, seed]), np.random.default_rng([32, seed])
    device = strain_gauges(config)
    first = state = device.init((config.channels,), rng)
    counts, offsets = [], []
    for j, one in enumerate(run):
        # Masses are changed with the sensor off; the limb goes on without.
        if 0 < j < 4 or jump:
            state = shift_offset(config, state, rng, *OFFSET_SHIFT)
        for wrench in getattr(one, f"wrench_{sensor}"):
            read, state = device.apply(wrench, state, noise, 1.0 / TRACKER_RATE)
            counts.append(read)
            offsets.append(state.offset)
    raw, offset = (np.array(part).reshape(len(run), -1, 6) for part in (counts, offsets))
    fit = calibrate_in_situ(static_sets(sensor, run[:4], raw[:4], felt[:4]))
    response = true_response(config, first)[0]
    later = {"since_fit_force": OFFSET_SHIFT[0], "since_fit_torque": OFFSET_SHIFT[1]} if jump else {}
    tracker = InSituTracker(fit, **later)
    g = -felt[4] - fit.imu.bias
    weight = np.concatenate([fit.limb.mass * g, np.cross(fit.limb.mass_com, g)], axis=1)
    left = raw[4] - weight @ fit.response.T
    half, window = len(g) // 2, int(MEAN * TRACKER_RATE)
    errors, nees = np.zeros((len(g) - half, 3, 6)), []
    for i in range(len(g)):
        estimate = tracker.update(raw[4, i], g[i], 1.0 / TRACKER_RATE)
        if i >= half:
            guesses = fit.offset, left[i - window : i].mean(axis=0), estimate.offset
            errors[i - half] = np.linalg.solve(response, (np.array(guesses) - offset[4, i]).T).T
            off = estimate.offset - offset[4, i]
            nees.append(off @ np.linalg.solve(estimate.covariance, off) / len(off))
    square = np.mean(errors**2, axis=0)
    return np.sqrt(square.reshape(3, 2, 3).mean(axis=2)), float(np.mean(nees))


def tracker(seeds: Sequence[int], given: argparse.Namespace) -> list[Table]:
    """Compare the tracked offset with a mean over 30 s, and with the fit alone."""
    rows = []
    for hysteresis, sensor, drifts in product((0.0, 0.01), ("leg", "foot"), (False, True)):
        found = [follow(sensor, seed, hysteresis, drifts, given.jump) for seed in seeds]
        rms = np.sqrt(np.mean([one[0] ** 2 for one in found], axis=0))
        kind = f"{100.0 * hysteresis:.0f} % hysteresis" if hysteresis else "no hysteresis"
        cells = (f"{force:.2f} / {torque:.4f}" for force, torque in rms)
        nees = f"{np.mean([one[1] for one in found]):.2f}"
        rows.append((f"{sensor}, {kind}, {'drift' if drifts else 'no drift'}", *cells, nees))
    heads = ("sensor", "the fit left alone", "mean of 30 s", "tracker", "NEES")
    return [Table("tracker", "Error of the offset in N / N m, rms", heads, tuple(rows))]


STUDIES = {"contact": (contact, 0, 20), "raster": (raster, 70, 20), "tracker": (tracker, 60, 3)}
"""Each study, its first seed, and the number of seeds."""


def main() -> None:
    """Print tables, and save them where a folder is given."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("study", choices=list(STUDIES))
    parser.add_argument("--seeds", type=int, help="sensors a case")
    parser.add_argument("--first", type=int, help="the first of the seeds")
    parser.add_argument("--only", default="", help="raster: kinds of hysteresis whose name contains this")
    parser.add_argument("--jump", action="store_true", help="tracker: the sensor was switched off in between")
    parser.add_argument("--out", type=Path, help="folder of results")
    given = parser.parse_args()
    study, first, count = STUDIES[given.study]
    first = first if given.first is None else given.first
    tables = study(range(first, first + (given.seeds or count)), given)
    bench.show(tables)
    if given.out:
        save_tables(given.out / f"in-situ-{given.study}" / "tables", tables)


if __name__ == "__main__":
    main()
