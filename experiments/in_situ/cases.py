"""Cases of the simulated in-situ experiment; each function depends on its arguments alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.in_situ import InSituOptions, calibrate_in_situ, estimate_matrix, estimate_offset
from surefoot.envs.leg_rig.recording import RigRecording, record_rig
from surefoot.experiments.force_torque.validation import cramer_rao, normalise_error, offset_bounds
from surefoot.experiments.in_situ.instruments import (
    accelerometer_bias,
    moving_sets,
    read_imu,
    read_sensor,
    sensor_config,
    static_sets,
)
from surefoot.experiments.in_situ.methods import (
    FITTED,
    FORCE,
    METHODS,
    TORQUE,
    MethodResult,
    add_offsets,
    calibrate_by_all,
    fit_row,
    set_rows,
)
from surefoot.sensors import StrainGauges

Rows = list[dict[str, Any]]

SENSORS = ("foot", "leg")

BATCH = 4  # seeds of a case, of 80 MB each

KINDS = {
    "still": "white noise, and offsets that are known not to drift",
    "white": "white noise",
    "real": "hysteresis, creep, drift and converter as well",
}
"""The errors of the sensors whose fits are compared with the bound and with their own covariance."""

DRAWN = ("measurement", "manufacturer")  # methods whose forces figures show
_SHOWN = 400  # samples a set that figures show


@dataclass(frozen=True)
class RigMotion:
    """How the hip moves in a set of so many s: sweeps at 6 degrees a second, or swings at 0.8 to 2 Hz."""

    name: str
    duration: float
    fast: bool


MOTIONS = (
    RigMotion("slow sweep, taken to be at rest", 300.0, fast=False),
    RigMotion("slow sweep, taken to be at rest", 90.0, fast=False),
    RigMotion("swings at 0.8 to 2 Hz, with the gyroscope", 60.0, fast=True),
    RigMotion("swings at 0.8 to 2 Hz, with the gyroscope", 30.0, fast=True),
    RigMotion("swings at 0.8 to 2 Hz, with the gyroscope", 15.0, fast=True),
)
"""Motions to compare: as long as the paper's, as short as a sweep can be, and fast."""

REST = 60.0  # s of rest in many postures for the accelerometer of a fast motion


def exact_errors(sensor: str, rate: float) -> dict[str, Rows]:
    """Run the paper's method on a sensor at rest whose only errors are its matrix and offsets.

    ``exact`` has relative errors: offset (III-B, worst set), matrix (III-C, Frobenius norm of rows), limb.
    """
    recordings = record_rig(rate=rate, at_rest=True)
    counts, truth = read_sensor(sensor_config(sensor, exact=True), sensor, recordings, 0)
    sets = static_sets(sensor, recordings, counts, _specific_force(recordings))
    offsets = np.array([estimate_offset(data.raw, data.gravity).offset for data in sets])
    fit = estimate_matrix(sets[:FITTED], offsets[:FITTED], noise_margin=0.0)
    C: Floats = np.asarray(np.linalg.inv(truth.response), dtype=np.float64)
    row = {
        "sensor": sensor,
        "offset": max(map(_relative, offsets, truth.offsets)),
        "matrix_force": _relative(fit.matrix[FORCE], C[FORCE]),
        "matrix_torque": _relative(fit.matrix[TORQUE], C[TORQUE]),
        "limb": abs(fit.limb.mass / truth.limb.mass - 1.0),
        "first_moment": _relative(fit.limb.mass_com, truth.limb.mass_com),
    }
    return {"exact": [row]}


def sweep_and_calibrate(seeds: tuple[int, ...], rate: float) -> dict[str, Rows]:
    """Run the paper's experiment with a foot's and a leg's sensor and an IMU of each seed, at a rate in Hz.

    ``fits`` has a row a sensor, seed and method (``clipped``: the converter ended, and :func:`fit_row`),
    ``sets`` those of :func:`set_rows`, ``shown`` the points of seed 0 that figures show.
    """
    runs = {seed: record_rig(rate=rate, seed=seed) for seed in seeds}
    force = {seed: read_imu(run, seed)[..., FORCE] for seed, run in runs.items()}
    fits: Rows = []
    checked: Rows = []
    shown: Rows = []
    for sensor in SENSORS:
        config = sensor_config(sensor)
        for seed, run in runs.items():
            counts, truth = read_sensor(config, sensor, run, seed)
            bias = accelerometer_bias(force[seed][:FITTED])
            sets = static_sets(sensor, run, counts, force[seed] - bias)
            wrench = _wrenches(run[FITTED:], sensor)
            found = calibrate_by_all(sets, config.nominal_matrix, InSituOptions(code_range=config.code_range))
            for method in METHODS:
                key = {"sensor": sensor, "seed": seed, "method": method}
                row = fit_row(found[method], truth, wrench)
                fits.append({**key, "clipped": _find_clipping(counts[:FITTED], config), **row})
                checked += [{**key, **row} for row in set_rows(found[method], sets)]
            thin = slice(None, None, max(counts.shape[1] // _SHOWN, 1))
            for j in range(FITTED, len(sets)) if seed == 0 else ():
                raw = counts[j, thin]
                points = {"raw": raw, "gravity": sets[j].gravity[thin]}
                points |= {f"force_{name}": _forces(found[name], j, raw) for name in DRAWN}
                listed = {name: values.tolist() for name, values in points.items()}
                shown.append({"sensor": sensor, "set": j + 1, **listed})
    return {"fits": fits, "sets": checked, "shown": shown}


def compare_with_bound(seeds: tuple[int, ...], kind: str, rate: float) -> dict[str, Rows]:
    """Fit sets at rest whose gravity is exact; compare errors with the bound and the covariance of the fit.

    ``white`` has, a row a sensor and seed, squared errors of the offsets in N^2 and (N m)^2, means over sets
    and axes, and of the limb's mass in kg^2, beside their bounds. Kinds are those of :data:`KINDS`.
    """
    options = InSituOptions(drift=False) if kind == "still" else InSituOptions()
    runs = [record_rig(range(1, FITTED + 1), rate=rate, at_rest=True, seed=seed) for seed in seeds]
    rows = []
    for sensor in SENSORS:
        config = sensor_config(sensor, white=kind != "real")
        deviation = np.repeat([config.noise_force, config.noise_torque], 3)
        noise = (config.nominal_response * deviation**2) @ config.nominal_response.T
        for seed, run in zip(seeds, runs, strict=True):
            counts, truth = read_sensor(config, sensor, run, seed)
            sets = static_sets(sensor, run, counts, _specific_force(run))
            if kind != "real":
                # Each posture was held: with times a fit would count the turns from one to the next.
                sets = tuple(replace(one, time=None) for one in sets)
            fit = calibrate_in_situ(sets, options=options, refuse=False)
            bound = cramer_rao(sets, truth.response, truth.limb, noise)
            of_offsets = offset_bounds(bound, truth.response, len(sets))
            off = (fit.offsets - truth.offsets) @ np.linalg.inv(truth.response).T
            variance = np.array([np.diag(one) for one in of_offsets])
            limb = 6 * config.channels
            nees = np.nan
            if not fit.refusals:
                nees = normalise_error(fit, truth.response, truth.offset, truth.limb)
            rows.append(
                {
                    "kind": kind,
                    "sensor": sensor,
                    "seed": seed,
                    "nees": nees,
                    "unknowns": len(fit.covariance),
                    "force_square": float(np.mean(off[:, FORCE] ** 2)),
                    "force_bound": float(np.mean(variance[:, FORCE])),
                    "torque_square": float(np.mean(off[:, TORQUE] ** 2)),
                    "torque_bound": float(np.mean(variance[:, TORQUE])),
                    "limb_square": (fit.limb.mass - truth.limb.mass) ** 2,
                    "limb_bound": float(bound[limb, limb]),
                    "refusal": str(fit.refusals[0]) if fit.refusals else "",
                }
            )
    return {"white": rows}


def compare_motion(index: int, seeds: tuple[int, ...], rate: float) -> dict[str, Rows]:
    """Calibrate from one of :data:`MOTIONS`, fast at 100 Hz at least: ``motions``, see :func:`fit_row`."""
    motion = MOTIONS[index]
    rate = max(rate, 100.0) if motion.fast else rate
    how: dict[str, Any] = {"duration": motion.duration, "rate": rate, "fast_motion": motion.fast}
    runs = [record_rig(range(1, FITTED + 1), seed=seed, **how) for seed in seeds]
    readings = [read_imu(run, seed) for run, seed in zip(runs, seeds, strict=True)]
    resting = readings
    minutes = FITTED * motion.duration / 60.0
    if motion.fast:
        rest = _thin(record_rig((1,), rate=rate, at_rest=True, seed=seeds[0])[0], REST)
        resting = [read_imu([rest], seed) for seed in seeds]
        minutes += REST / 60.0
    unseen = record_rig(range(FITTED + 1, 9), rate=10.0)
    rows = []
    for sensor in SENSORS:
        wrench = _wrenches(unseen, sensor)
        for seed, run, read, still in zip(seeds, runs, readings, resting, strict=True):
            counts, truth = read_sensor(sensor_config(sensor), sensor, run, seed)
            bias = accelerometer_bias(still[..., FORCE])
            if motion.fast:
                sets = moving_sets(sensor, run, counts, read, bias)
            else:
                sets = static_sets(sensor, run, counts, read[..., FORCE] - bias)
            found = add_offsets(calibrate_in_situ(sets, refuse=False), sets)
            key = {"motion": index, "sensor": sensor, "seed": seed, "minutes": minutes}
            rows.append({**key, **fit_row(found, truth, wrench)})
    return {"motions": rows}


def _specific_force(recordings: Sequence[RigRecording]) -> Floats:
    return np.stack([recording.specific_force for recording in recordings])


def _wrenches(recordings: Sequence[RigRecording], sensor: str) -> Floats:
    """Return true wrenches of recordings, shape (n, 6)."""
    return np.concatenate([getattr(one, f"wrench_{sensor}") for one in recordings])


def _forces(found: MethodResult | str, index: int, raw: Floats) -> Floats:
    """Return the forces of a set by a calibration; none where it was refused."""
    if isinstance(found, str):
        return np.zeros((0, 3))
    return np.asarray((raw - found.offsets[index]) @ found.matrix[FORCE].T)


def _thin(recording: RigRecording, duration: float) -> RigRecording:
    """Return a shorter recording at rest of as many postures."""
    step = max(round((recording.time[-1] - recording.time[0]) / duration), 1)
    rows = slice(None, None, step)
    n = len(recording.time[rows])
    parts = ("hip", "wrench_foot", "wrench_leg", "specific_force", "angular_velocity", "angular_acceleration")
    thinned = {part: getattr(recording, part)[rows] for part in parts}
    return replace(recording, time=recording.time[:n], **thinned)


def _find_clipping(counts: Floats, config: StrainGauges) -> bool:
    """Whether a channel's readings ended with the converter in more than a trace of some set."""
    ended = np.abs(counts) >= config.code_range[1]
    return bool(np.any(ended.mean(axis=1) > 1e-3))


def _relative(found: Floats, truth: Floats) -> float:
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))
