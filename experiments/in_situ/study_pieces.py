"""The simulated in-situ experiment in pieces for processes; a piece depends on its arguments alone."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from surefoot.calibration.in_situ import InSituOptions, calibrate_in_situ, estimate_matrix, estimate_offset
from surefoot.envs.leg_rig.recording import RigRecording, record_rig
from surefoot.experiments.in_situ.bound import cramer_rao, normalised_error, offset_bounds
from surefoot.experiments.in_situ.instruments import (
    accelerometer_bias,
    moving_sets,
    read_imus,
    read_sensors,
    sensor_config,
    static_sets,
)
from surefoot.experiments.in_situ.methods import FITTED, METHODS, MethodResult, calibrate_by_all, of_fit
from surefoot.experiments.in_situ.study_score import fit_row, set_rows
from surefoot.experiments.study.tables import Frame
from surefoot.sensors import StrainGauges

__all__ = [
    "BATCH",
    "KINDS",
    "MOTIONS",
    "SENSORS",
    "Motion",
    "Shown",
    "exact_piece",
    "motion_piece",
    "sweep_piece",
    "white_piece",
]

SENSORS = ("foot", "leg")

BATCH = 4
"""Seeds of a piece: what the rig and the sensors show of eight sets of 30,000 samples are 80 MB a seed."""

WHITE_RATE = 4.0
"""Samples per s of the sets with white noise alone, of which the bound knows how many there are."""

KINDS = {
    "still": "white noise, and zeros that are known not to drift",
    "white": "white noise",
    "real": "hysteresis, creep, drift and converter as well",
}
"""What the sensors suffer whose fits are held against the bound and against their own covariance."""

SHOWN = 400
"""Samples a set that figures show."""


@dataclass(frozen=True, eq=False)
class Shown:
    """One sensor's run, thinned out for figures.

    Attributes:
        sensor: "foot" or "leg".
        raw: Counts of each set, shape (J, n, 6).
        gravity: Shape (J, n, 3).
        found: What each method made of the whole run, by the names of METHODS.
    """

    sensor: str
    raw: NDArray[np.float64]
    gravity: NDArray[np.float64]
    found: dict[str, MethodResult | str]


@dataclass(frozen=True)
class Motion:
    """How the hip moves in a set.

    Attributes:
        name: What tables call it.
        duration: Of a set in s.
        fast: Swings at 0.8 to 2 Hz, with the gyroscope's help, rather than sweeps at 6 degrees a second.
    """

    name: str
    duration: float
    fast: bool


MOTIONS = (
    Motion("slow sweep, taken to be at rest", 300.0, fast=False),
    Motion("slow sweep, taken to be at rest", 90.0, fast=False),
    Motion("swings at 0.8 to 2 Hz, with the gyroscope", 60.0, fast=True),
    Motion("swings at 0.8 to 2 Hz, with the gyroscope", 30.0, fast=True),
    Motion("swings at 0.8 to 2 Hz, with the gyroscope", 15.0, fast=True),
)
"""What is held against each other: as long as the paper's, as short as a sweep can be, and fast."""

REST = 60.0
"""Time in s that the limb rests in many postures so that the accelerometer of a fast motion is calibrated."""


def exact_piece(sensor: str, rate: float) -> dict[str, Any]:
    """Run the paper's method on sensors without an error but that of their matrix and zeros, at rest.

    Returns:
        ``sensor`` and relative errors: ``offset`` (III-B, worst set), ``matrix_force`` and ``matrix_torque``
        (III-C, in the Frobenius norm of the rows), ``limb`` (mass) and ``first_moment``.
    """
    recordings = record_rig(rate=rate, at_rest=True)
    config = sensor_config(sensor, exact=True)
    counts, truth = read_sensors(config, sensor, [recordings], [0])[0]
    force = np.stack([recording.specific_force for recording in recordings])
    sets = static_sets(sensor, recordings, counts, force)
    offsets = np.array([estimate_offset(data.raw, data.gravity).offset for data in sets])
    fit = estimate_matrix(sets[:FITTED], offsets[:FITTED], noise_margin=0.0)
    C: NDArray[np.float64] = np.asarray(np.linalg.inv(truth.response), dtype=np.float64)
    return {
        "sensor": sensor,
        "offset": max(map(_relative, offsets, truth.offsets)),
        "matrix_force": _relative(fit.matrix[:3], C[:3]),
        "matrix_torque": _relative(fit.matrix[3:], C[3:]),
        "limb": abs(fit.limb.mass / truth.limb.mass - 1.0),
        "first_moment": _relative(fit.limb.mass_com, truth.limb.mass_com),
    }


def sweep_piece(seeds: tuple[int, ...], rate: float) -> tuple[Frame, Frame, list[Shown]]:
    """Run the paper's experiment with a foot's and a leg's sensor and an IMU of each seed.

    Args:
        seeds: Of the sweeps, the sensors and the IMU.
        rate: Samples per s.

    Returns:
        A row a sensor, seed and method (``sensor``, ``seed``, ``method``, ``clipped`` and
        :func:`~surefoot.experiments.in_situ.study_score.fit_row`); a row a set that was not fitted
        (:func:`~surefoot.experiments.in_situ.study_score.set_rows`); and what figures show of seed 0.
    """
    runs = [record_rig(rate=rate, seed=seed) for seed in seeds]
    force = read_imus(runs, seeds)[..., :3]
    for of_seed in force:
        of_seed -= accelerometer_bias(of_seed[:FITTED])
    fits, sets_rows, shown = [], [], []
    for sensor in SENSORS:
        config = sensor_config(sensor)
        for i, (counts, truth) in enumerate(read_sensors(config, sensor, runs, seeds)):
            sets = static_sets(sensor, runs[i], counts, force[i])
            wrench = _held_out(runs[i], sensor)
            found = calibrate_by_all(sets, config.nominal_matrix, InSituOptions(code_range=config.code_range))
            for method in METHODS:
                key = {"sensor": sensor, "seed": seeds[i], "method": method}
                row = fit_row(found[method], truth, wrench)
                fits.append({**key, "clipped": _clipped(counts[:FITTED], config), **row})
                sets_rows += [{**key, **row} for row in set_rows(found[method], sets)]
            if seeds[i] == 0:
                thin = slice(None, None, max(counts.shape[1] // SHOWN, 1))
                gravity = np.stack([data.gravity for data in sets])
                shown.append(Shown(sensor, counts[:, thin].copy(), gravity[:, thin].copy(), found))
    return pd.DataFrame(fits), pd.DataFrame(sets_rows), shown


def white_piece(seeds: tuple[int, ...], kind: str) -> Frame:
    """Fit sets at rest whose gravity is exact, and hold errors against the bound and the claimed covariance.

    Args:
        seeds: Of the sensors.
        kind: A key of :data:`KINDS`.

    Returns:
        A row a sensor and seed: ``kind``, ``sensor``, ``seed``, ``nees`` and ``unknowns``, and the squared
        errors of the offsets in N^2 and (N m)^2, means over sets and axes, beside their bounds
        (``force_square``, ``force_bound``, ``torque_square``, ``torque_bound``), the same of the limb's mass
        in kg^2 (``limb_square``, ``limb_bound``), and ``said``.
    """
    loops, options = kind == "real", InSituOptions() if kind != "still" else InSituOptions(drift=0)
    fitted = range(1, FITTED + 1)
    runs = [record_rig(fitted, rate=WHITE_RATE, at_rest=True, seed=seed) for seed in seeds]
    rows = []
    for sensor in SENSORS:
        config = sensor_config(sensor, white=not loops)
        deviation = np.repeat([config.noise_force, config.noise_torque], 3)
        noise = (config.nominal_response * deviation**2) @ config.nominal_response.T
        for seed, run, (counts, truth) in zip(
            seeds, runs, read_sensors(config, sensor, runs, seeds), strict=True
        ):
            force = np.stack([recording.specific_force for recording in run])
            sets = static_sets(sensor, run, counts, force)
            fit = calibrate_in_situ(sets, options=options, refuse=False)
            bound = cramer_rao(sets, truth.response, truth.limb, noise)
            of_offsets = offset_bounds(bound, truth.response, len(sets))
            off = (fit.offsets - truth.offsets) @ np.linalg.inv(truth.response).T
            variance = np.array([np.diag(one) for one in of_offsets])
            limb = 6 * config.channels
            rows.append(
                {
                    "kind": kind,
                    "sensor": sensor,
                    "seed": seed,
                    "nees": np.nan
                    if fit.refusals
                    else normalised_error(fit, truth.response, truth.offset, truth.limb),
                    "unknowns": len(fit.covariance),
                    "force_square": float(np.mean(off[:, :3] ** 2)),
                    "force_bound": float(np.mean(variance[:, :3])),
                    "torque_square": float(np.mean(off[:, 3:] ** 2)),
                    "torque_bound": float(np.mean(variance[:, 3:])),
                    "limb_square": (fit.limb.mass - truth.limb.mass) ** 2,
                    "limb_bound": float(bound[limb, limb]),
                    "said": str(fit.refusals[0]) if fit.refusals else "",
                }
            )
    return pd.DataFrame(rows)


def motion_piece(index: int, seeds: tuple[int, ...], rate: float) -> Frame:
    """Calibrate from one kind of motion.

    Args:
        index: In :data:`MOTIONS`.
        seeds: Of the sensors and IMUs.
        rate: Samples per s; fast motion takes at least 100.

    Returns:
        A row a sensor and seed: ``motion`` (the index), ``sensor``, ``seed``, ``minutes`` of data, and
        :func:`~surefoot.experiments.in_situ.study_score.fit_row`.
    """
    motion = MOTIONS[index]
    rate = max(rate, 100.0) if motion.fast else rate
    how: dict[str, Any] = {"duration": motion.duration, "rate": rate, "fast_motion": motion.fast}
    runs = [record_rig(range(1, FITTED + 1), seed=seed, **how) for seed in seeds]
    readings = read_imus(runs, seeds)
    resting = readings
    minutes = FITTED * motion.duration / 60.0
    if motion.fast:
        still = _thinned(record_rig((1,), rate=rate, at_rest=True, seed=seeds[0])[0], REST)
        resting = read_imus([[still]] * len(seeds), seeds)
        minutes += REST / 60.0
    held_out = record_rig(range(FITTED + 1, 9), rate=10.0)
    rows = []
    for sensor in SENSORS:
        config = sensor_config(sensor)
        wrench = _held_out(held_out, sensor, first=0)
        for i, (counts, truth) in enumerate(read_sensors(config, sensor, runs, seeds)):
            bias = accelerometer_bias(resting[i, ..., :3])
            if motion.fast:
                sets = moving_sets(sensor, runs[i], counts, readings[i], bias)
            else:
                sets = static_sets(sensor, runs[i], counts, readings[i, ..., :3] - bias)
            fit = calibrate_in_situ(sets, refuse=False)
            found = str(fit.refusals[0]) if fit.refusals else of_fit(fit, sets)
            key = {"motion": index, "sensor": sensor, "seed": seeds[i], "minutes": minutes}
            rows.append({**key, **fit_row(found, truth, wrench)})
    return pd.DataFrame(rows)


def _thinned(recording: RigRecording, duration: float) -> RigRecording:
    """Thin a recording at rest out to a shorter one of as many postures."""
    step = max(round((recording.time[-1] - recording.time[0]) / duration), 1)
    rows = slice(None, None, step)
    n = len(recording.time[rows])
    parts = ("hip", "wrench_foot", "wrench_leg", "specific_force", "angular_velocity", "angular_acceleration")
    thinned = {part: getattr(recording, part)[rows] for part in parts}
    return replace(recording, time=recording.time[:n], **thinned)


def _clipped(counts: NDArray[np.float64], config: StrainGauges) -> bool:
    """Whether a channel's readings ended with the converter in more than a trace of some set."""
    ended = np.abs(counts) >= config.code_range[1]
    return bool(np.any(ended.mean(axis=1) > 1e-3))


def _held_out(recordings: list[RigRecording], sensor: str, first: int = FITTED) -> NDArray[np.float64]:
    """True wrenches of the sets that are not fitted, shape (n, 6)."""
    return np.concatenate([getattr(one, f"wrench_{sensor}") for one in recordings[first:]])


def _relative(found: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))
