"""`surefoot check --preset` measures presets on recordings of simulated instruments with known errors."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from _logs import fails, run_for_json

import surefoot  # noqa: F401  (registers the environments)
from surefoot.calibration.results import CalibrationRefused
from surefoot.experiments.instrument.channels import facts_of
from surefoot.experiments.instrument.noise import conversions
from surefoot.experiments.instrument.preset import find_preset
from surefoot.experiments.instrument.recording import read_recording
from surefoot.experiments.logs.format import Log, write_log
from surefoot.sensors import ForceTorque, LoadCells, preset
from surefoot.sensors.devices.force_torque import force_torque
from surefoot.sensors.devices.load_cells import load_cells
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE
from surefoot.wrappers import FootSensors

HOST = 200.0  # rows per second
PROGRAM = ((0.0, 60.0), (30.0, 5.0), (90.0, 5.0), (0.0, 30.0))  # loads in N, and their durations in s


def record(cells: LoadCells, path: Path, seed: int = 3) -> Path:
    """Write the readings of cells under known loads."""
    rng, K = np.random.default_rng(seed), cells.channels
    load = np.concatenate([np.full(round(HOST * seconds), newtons) for newtons, seconds in PROGRAM])
    device = load_cells(cells)
    state, raw = device.init((K,), rng), np.empty((len(load), K))
    for row, now in enumerate(load):
        raw[row], state = device.apply(np.full((1, K), now), state, rng, 1.0 / HOST)
    table = pd.DataFrame(raw, columns=[f"raw_{i}_count" for i in range(K)])
    table.insert(0, "load_N", load)
    table.insert(0, "time_s", np.arange(len(load)) / HOST)
    table.to_csv(path, index=False)
    return path


@pytest.mark.parametrize(
    "change",
    [
        {"polarity": (-1, 1), "rate": (78.0, 94.0)},
        {"input_noise": 4e-7, "offset_drift": 0.5 * PER_SQRT_MINUTE, "rate": (40.0, 40.0)},
        {"adc_bits": 12, "coding": "two's complement", "input_noise": 2e-5, "rate": (200.0, 200.0)},
        {"adc_bits": 0, "input_noise": 2e-6, "polarity": (1,), "rate": None},
    ],
)
def test_noise_drift_resolution_and_clock_are_measured(change: dict[str, Any], tmp_path: Path) -> None:
    known: dict[str, Any] = {
        "channels": 4,
        "scale_drift": 0.0,
        "initial_scale_std": 0.0,
        "initial_offset_std": 0.1,
    }
    known |= {"offset_drift": 0.1 * PER_SQRT_MINUTE}
    cells = LoadCells(**(known | change))
    path = record(cells, tmp_path / "rig.csv")
    result = run_for_json("check", path, "--preset", tmp_path / "cells.toml")
    assert result["files"]["preset"] == str(tmp_path / "cells.toml")
    found: LoadCells = preset(str(tmp_path / "cells.toml"))
    assert (found.adc_bits > 0, found.coding == "offset-binary") == (
        cells.adc_bits > 0,
        cells.adc_bits == 24,
    )
    assert found.counts_per_newton == pytest.approx(cells.counts_per_newton, rel=0.01)
    assert np.sign(found.slope[:4]).tolist() == np.sign(cells.slope).tolist()
    assert found.noise_counts == pytest.approx(cells.noise_counts, rel=0.1)
    assert found.offset_drift == pytest.approx(cells.offset_drift, rel=0.35)
    rate = cells.rate or (HOST, HOST)
    assert found.rate is not None
    assert rate[0] * 0.99 < found.rate[0] <= found.rate[1] < rate[1] * 1.01
    # Fields that were not measured keep their defaults.
    assert found.initial_offset_std == LoadCells().initial_offset_std


def test_a_preset_file_takes_the_place_of_a_name(tmp_path: Path) -> None:
    path = str(tmp_path / "cells.toml")
    run_for_json(
        "check", record(LoadCells(channels=2, polarity=(1,)), tmp_path / "rig.csv"), "--preset", path
    )
    env = FootSensors(gym.make("surefoot/NaoStand-v0"), path)
    env.reset(seed=1)
    env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    assert np.isfinite(env.raw).all()
    env.close()


def test_a_walk_is_measured_by_feet_in_the_air(walks: dict[str, Log], tmp_path: Path) -> None:
    """The reference is late, so rows in which a foot already stands again must not count as unloaded."""
    log = walks["bad-start"]
    assert log.truth is not None
    recording = read_recording(write_log(log, tmp_path / "walk.parquet"))
    assert np.abs(log.truth.force[recording.unloaded]).max() < 0.05
    cells, _ = find_preset(recording, facts_of(recording))
    assert isinstance(cells, LoadCells)
    assert cells.offset_drift == pytest.approx(HX711_LOAD_CELLS.offset_drift, rel=0.15)
    assert cells.polarity == (-1, 1, -1, 1, -1, 1, -1, 1)


def test_a_six_axis_sensor_is_measured_through_its_matrix(tmp_path: Path) -> None:
    sensor = ForceTorque(sensors=1, noise_force=0.3, noise_torque=0.004)
    rng, device = np.random.default_rng(5), force_torque(sensor)
    state, rows = device.init((6,), rng), []
    for _ in range(6000):
        counts, state = device.apply(np.array([0.0, 0.0, 50.0, 0.0, 0.0, 0.0]), state, rng, 0.01)
        rows.append(counts)
    table = pd.DataFrame(rows, columns=[f"raw_{axis}_count" for axis in ("fx", "fy", "fz", "tx", "ty", "tz")])
    table.insert(0, "time_s", 0.01 * np.arange(len(table)))
    for axis, gravity in zip("xyz", (0.0, 0.0, -9.81), strict=True):
        table[f"gravity_{axis}_m_s2"] = gravity
    table.to_csv(tmp_path / "arm.csv", index=False)
    recording = read_recording(tmp_path / "arm.csv")
    with pytest.raises(CalibrationRefused, match="no matrix turns the channels into newtons"):
        find_preset(recording, facts_of(recording))
    matrix = np.round(sensor.nominal_matrix[0], 9).tolist()
    (tmp_path / "arm.toml").write_text(f"[factory]\nmatrix = {matrix}\n")
    recording = read_recording(tmp_path / "arm.csv")
    found, measured = find_preset(recording, facts_of(recording))
    assert isinstance(found, ForceTorque)
    assert found.noise_force == pytest.approx(0.3, rel=0.05)
    assert found.noise_torque == pytest.approx(0.004, rel=0.05)
    assert found.resolution_force == pytest.approx(sensor.resolution_force)
    # A sensor that was never known to be unloaded does not show its drift.
    assert "offset_drift_force" not in measured


def test_what_a_preset_needs(tmp_path: Path) -> None:
    path = record(LoadCells(channels=1, polarity=(1,)), tmp_path / "rig.csv")
    fails(["check", path, "--preset", "cells.json"], "--preset must end in .toml, got 'cells.json'.")
    recording = read_recording(path)
    facts = facts_of(recording)
    with pytest.raises(
        CalibrationRefused, match=r"the size of a count in newtons is not known\. Give the load"
    ):
        find_preset(replace(recording, load=None), facts)
    with pytest.raises(CalibrationRefused, match="column 'raw_0_count' does not follow its load"):
        find_preset(replace(recording, load=np.roll(np.array(recording.load), 4000, axis=0)), facts)
    with pytest.raises(CalibrationRefused, match="no channel rests"):
        find_preset(recording, [])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("channels = 2", "must contain one table out of"),
        ("[LoadCells]\ndrift = 1.0", "LoadCells has no field"),
        ("[Imu]\n", "is a preset of Imu, not of LoadCells"),
    ],
)
def test_other_files_are_no_presets(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "cells.toml").write_text(text)
    with pytest.raises(ValueError, match=message):
        preset(str(tmp_path / "cells.toml"))


def test_repeats_of_a_clock_and_of_coarse_steps_are_distinguished() -> None:
    rng = np.random.default_rng(5)
    quiet = np.rint(rng.normal(0.3, 2.0, 6000))  # steps of half its noise: 14 % of the rows repeat by chance
    assert not conversions(quiet).slower
    for rate in (10.0, 78.0, 150.0):
        number_of = np.floor(rate * np.arange(0.0, 30.0, 1.0 / HOST) + 0.3).astype(int)
        found = conversions(np.rint(rng.normal(0.0, 40.0, number_of[-1] + 1))[number_of])
        assert found.slower
        assert len(found.rows) == pytest.approx(30.0 * rate, rel=0.02)
    assert not conversions(np.full(500, 7.0)).slower
