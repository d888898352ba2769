"""The sample log of in-situ calibration that ships with the package: the iCub's leg on its stand, simulated.

    python benchmarks/in_situ_sample.py

makes it again. Its sensor is the leg's FTSens with all its
errors, whose maker's matrix, long outdated, goes with the log as the factory matrix; its IMU is that of a
small robot after its zeros were taken. The simulator's truth is in neither file.
"""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from surefoot.arrays import Floats
from surefoot.envs.leg_rig.recording import RigRecording, record_rig
from surefoot.experiments.force_torque.calibrate import SAMPLE
from surefoot.files import atomic_path, write_text
from surefoot.sensors import Imu, StrainGauges, imu, preset, strain_gauges

RATE = 10.0
DURATION = 60.0
SEED = 2
"""An ordinary sensor: its maker's matrix shows the leg's weight as an ellipsoid whose longest axis is
1.9 times the shortest, the median of :class:`~surefoot.sensors.StrainGauges`."""

PAUSE = 60.0  # time in s between two sets, in which masses are changed
SPEED_DEG = 12.0  # highest speed of the hip in deg/s, so that a minute covers its ranges


def make_sample(seed: int = SEED) -> tuple[dict[str, Floats], list[RigRecording], Floats]:
    """Record eight sets of a minute each with one sensor, switched on once.

    Returns the log's columns, the recordings behind them, and the true A in counts per N and N m, (6, 6).
    """
    config = preset("icub-ftsens-leg", StrainGauges)
    sensor, motion = strain_gauges(config), imu(Imu(accelerometer_bias_std=0.005, averaged=True))
    rng = np.random.default_rng([seed, 1])
    state, motion_state = sensor.init((config.channels,), rng), motion.init((6,), rng)
    response = np.array(state.response)
    recordings = record_rig(duration=DURATION, rate=RATE, speed_deg=SPEED_DEG, seed=seed)
    rows: dict[str, list[Floats]] = {"time_s": [], "set": [], "raw": [], "imu": []}
    for index, recording in enumerate(recordings):
        raw = np.empty((len(recording.time), config.channels))
        felt = np.concatenate([recording.specific_force, recording.angular_velocity], axis=1)
        for i, wrench in enumerate(recording.wrench_leg):
            # The first sample of a set comes after a pause in which the new mass came to hang there.
            dt = 1.0 / RATE if i else PAUSE
            raw[i], state = sensor.apply(wrench, state, rng, dt)
            felt[i], motion_state = motion.apply(felt[i], motion_state, rng, dt)
        rows["time_s"].append(recording.time + index * (DURATION + PAUSE))
        rows["set"].append(np.full(len(raw), float(recording.configuration)))
        rows["raw"].append(raw)
        rows["imu"].append(felt)
    raw, felt = np.concatenate(rows["raw"]), np.concatenate(rows["imu"])
    columns = {"time_s": np.concatenate(rows["time_s"]), "set": np.concatenate(rows["set"])}
    columns |= {f"raw_{i}_count": column for i, column in enumerate(raw.T)}
    columns |= {f"specific_force_{axis}_m_s2": felt[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"angular_velocity_{axis}_rad_s": felt[:, 3 + i] for i, axis in enumerate("xyz")}
    return columns, recordings, response


def write_sample(path: Path = SAMPLE, seed: int = SEED) -> Path:
    """Write the log, as ``.parquet``, and the TOML file beside it; return the log's path."""
    columns, recordings, _ = make_sample(seed)
    kinds = {"set": pa.int8(), "time_s": pa.float64()}
    table = pa.table(
        {
            name: pa.array(values).cast(kinds.get(name, pa.int32() if "raw" in name else pa.float32()))
            for name, values in columns.items()
        }
    )
    write_text(path.with_suffix(".toml"), _toml(recordings))
    with atomic_path(path) as part:
        pq.write_table(table, part, compression="zstd")
    return path


def _toml(recordings: list[RigRecording]) -> str:
    config = preset("icub-ftsens-leg", StrainGauges)
    low, high = config.code_range
    lines = [
        "# A simulated leg of the iCub with eight added masses. docs/in-situ-log.md lists all keys.",
        "",
        "[sensor]",
        'name = "FTSens in a leg (simulated)"',
        f"range_count = [{low:.0f}, {high:.0f}]",
        "full_scale = [1500, 1500, 2000, 35, 35, 25]  # N and N m, of its data sheet",
        "",
        "[accelerometer]",
        f"position_m = {_list_toml(recordings[0].position_imu_leg)}  # in the sensor's frame",
        "",
        "[factory]",
        "matrix = [  # N and N m per count, of the maker's certificate",
        *(f"  {_list_toml(np.array(row))}," for row in config.matrix),
        "]",
        "",
        "[fit]",
        'sets = ["1", "2", "3", "4"]  # as the in-situ paper does; the others prove the fit',
        "",
        "[limb]",
        f"mass_kg = {recordings[0].limb_leg.mass:.3f}  # of a pair of scales: what hangs beyond the sensor, "
        "nothing added",
    ]
    for recording in recordings:
        lines += ["", "[[sets]]", f'name = "{recording.configuration}"']
        lines += [f"added_mass_kg = {recording.added_mass:.5g}"]
        if recording.added_mass > 0.0:
            lines += [f"added_com_m = {_list_toml(recording.added_com_leg)}"]
    return "\n".join(lines) + "\n"


def _list_toml(values: Floats) -> str:
    return "[" + ", ".join(f"{value:.9g}" for value in np.asarray(values).tolist()) + "]"


if __name__ == "__main__":
    print(write_sample())
