"""A calibrated sensor in the air: is its tracked offset better than a mean over 30 s, and than the fit alone?

    python benchmarks/in_situ_tracker.py
    python benchmarks/in_situ_tracker.py --seeds 2 --jump

A leg's and a foot's sensor are calibrated with four masses, and then go on in the air for five minutes on
another path: the bare limb sweeps, with the errors of sensor and IMU. Compared over the second half are the
offset of the fit, the mean difference of readings and the fit's weight over the last 30 s, and the
tracker: root mean square errors in N and N m, and the tracker's squared error by its own covariance (NEES, a
channel; 1 is right). With ``--jump`` the sensor was switched off and on again in between.
"""

import argparse
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from surefoot.calibration.in_situ import InSituTracker, calibrate_in_situ
from surefoot.envs.leg_rig.recording import record_rig
from surefoot.experiments.in_situ.instruments import (
    OFFSET_SHIFT,
    accelerometer_bias,
    read_imu,
    sensor_config,
    static_sets,
)
from surefoot.sensors import strain_gauges
from surefoot.sensors.devices.strain_gauges import shift_offset, true_response

Floats = NDArray[np.float64]

RATE, MEAN = 10.0, 30.0
"""Samples per s, and the mean's length in s."""


def follow(sensor: str, seed: int, hysteresis: float, drifts: bool, jump: bool) -> tuple[Floats, float]:
    """Return errors (nothing, mean, tracker) in N and N m, shape (3, 2), and the tracker's NEES."""
    config = replace(sensor_config(sensor), hysteresis=hysteresis)
    if not drifts:
        config = replace(config, offset_drift_force=0.0, offset_drift_torque=0.0)
    run = [*record_rig((1, 2, 3, 4), rate=RATE, seed=seed), *record_rig((1,), rate=RATE, seed=seed + 1000)]
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
            read, state = device.apply(wrench, state, noise, 1.0 / RATE)
            counts.append(read)
            offsets.append(state.offset)
    raw, offset = (np.array(part).reshape(len(run), -1, 6) for part in (counts, offsets))
    fit = calibrate_in_situ(static_sets(sensor, run[:4], raw[:4], felt[:4]))
    response = true_response(config, first)[0]
    later = {"since_fit_force": OFFSET_SHIFT[0], "since_fit_torque": OFFSET_SHIFT[1]} if jump else {}
    tracker = InSituTracker(fit, **later)
    g = -felt[4] - fit.accelerometer_bias
    weight = np.concatenate([fit.limb.mass * g, np.cross(fit.limb.mass_com, g)], axis=1)
    left = raw[4] - weight @ fit.response.T
    half, window = len(g) // 2, int(MEAN * RATE)
    errors, nees = np.zeros((len(g) - half, 3, 6)), []
    for i in range(len(g)):
        estimate = tracker.update(raw[4, i], g[i], 1.0 / RATE)
        if i >= half:
            guesses = fit.offset, left[i - window : i].mean(axis=0), estimate.offset
            errors[i - half] = np.linalg.solve(response, (np.array(guesses) - offset[4, i]).T).T
            off = estimate.offset - offset[4, i]
            nees.append(off @ np.linalg.solve(estimate.covariance, off) / len(off))
    square = np.mean(errors**2, axis=0)
    return np.sqrt(square.reshape(3, 2, 3).mean(axis=2)), float(np.mean(nees))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=60)
    parser.add_argument("--jump", action="store_true", help="the sensor was switched off in between")
    arguments = parser.parse_args()
    table = Table("sensor", "hysteresis", "drifts", "fit alone", "mean of 30 s", "tracker", "NEES")
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    for sensor in ("leg", "foot"):
        for hysteresis in (0.0, 0.01):
            for drifts in (False, True):
                found = [follow(sensor, seed, hysteresis, drifts, arguments.jump) for seed in seeds]
                rms = np.sqrt(np.mean([one[0] ** 2 for one in found], axis=0))
                table.add_row(
                    sensor,
                    f"{hysteresis:.0%}",
                    "yes" if drifts else "no",
                    *(f"{force:.3f} N, {torque:.4f} N m" for force, torque in rms),
                    f"{np.mean([one[1] for one in found]):.2f}",
                )
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
