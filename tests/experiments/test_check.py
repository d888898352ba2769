"""`surefoot check`: any log, what is wrong with it, since when, and what would settle it."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from _logs import fails, run_for_json

from surefoot.experiments.force_torque.calibrate import SAMPLE
from surefoot.experiments.instrument.check import check_log
from surefoot.experiments.instrument.noise import Stretch, allan, noise_of
from surefoot.experiments.logs.format import Log, write_log


def check(path: Path, code: int) -> dict[str, Any]:
    """Run the command and return its JSON."""
    found = run_for_json("check", path, code=code)
    assert path.with_suffix(".check.html").is_file()
    return found


def test_noise_and_drift_are_those_that_were_put_in() -> None:
    """White noise of 3 counts and a walk of 1 count per sqrt(s), seen in stretches of 20 s at 100 Hz."""
    rng = np.random.default_rng(0)
    time = np.arange(2000) / 100.0
    drift = np.cumsum(rng.normal(0.0, np.sqrt(0.01), (8, 2000)), axis=1)
    parts = [Stretch(time, row) for row in drift + rng.normal(0.0, 3.0, drift.shape)]
    curve = allan(parts)
    found = noise_of(curve)
    assert curve.tau[0] == pytest.approx(0.01)
    assert curve.deviation[0] == pytest.approx(3.0, rel=0.02)
    assert found.white == pytest.approx(3.0, rel=0.02)
    assert found.walk == pytest.approx(1.0, rel=0.15)


def test_a_sound_walk_is_sound(bad_start: Log, tmp_path: Path, undrawn: None) -> None:
    found = check(write_log(bad_start, tmp_path / "walk.parquet"), 0)
    assert (found["sound"], found["kind"]) == (True, "walk")
    assert found["tables"]["wrong"]["rows"] == []
    rows = found["tables"]["channels"]["rows"]
    assert [row["channel"] for row in rows][:2] == ["left_front_left", "left_front_right"]
    assert all(row["step"] == 1 for row in rows)


def test_what_goes_wrong_on_the_way_is_named_with_its_time(
    bad_start: Log, tmp_path: Path, undrawn: None
) -> None:
    late = bad_start.time >= 10.0
    raw = np.where(late[:, None], np.roll(bad_start.raw, 4, axis=1), bad_start.raw)
    found = check(write_log(dataclasses.replace(bad_start, raw=raw), tmp_path / "walk.parquet"), 3)
    wrong = found["tables"]["wrong"]["rows"][0]
    assert wrong["what"] == "feet exchanged"
    assert float(wrong["since"].removeprefix("about ").removesuffix(" s")) == pytest.approx(10.0, abs=0.3)
    assert wrong["what would settle it"].startswith("Lift the left foot")


def test_a_channel_that_dies(bad_start: Log, tmp_path: Path, undrawn: None) -> None:
    raw = bad_start.raw.copy()
    raw[700:, 3] = raw[700, 3]
    found = check(write_log(dataclasses.replace(bad_start, raw=raw), tmp_path / "walk.csv"), 3)
    wrong = found["tables"]["wrong"]["rows"][0]
    assert (wrong["what"], wrong["since"]) == ("constant", f"{bad_start.time[700]:.6g} s")
    assert wrong["what to do"] == "Check its cable and its converter."
    page = (tmp_path / "walk.check.html").read_text()
    assert page.index("1. What is wrong") < page.index("2. The log")
    assert "calls for a warning" not in page


def test_a_log_that_its_command_cannot_read_is_shown(path: Path, undrawn: None) -> None:
    pd.read_csv(path).drop(columns="raw_left_rear_left_count").to_csv(path, index=False)
    found = check(path, 3)
    assert found["tables"]["wrong"]["rows"][0]["what"] == "unreadable"
    assert len(found["tables"]["channels"]["rows"]) == 7
    path.with_suffix(".json").write_text("{,}")
    wrong = check(path, 3)["tables"]["wrong"]["rows"][0]
    assert wrong["what is seen"].startswith("walk.json: the description: not JSON")


def test_sets_weighings_and_bare_channels(tmp_path: Path, undrawn: None) -> None:
    assert check_log(SAMPLE).recording.kind == "six-axis sensor"
    loads = np.repeat([0.0, 1.0, 2.0, 4.0], 3)
    rng = np.random.default_rng(0)
    table = pd.DataFrame(
        {"load_kg": loads, "raw_a_count": np.rint(84e3 + 1e5 * loads + rng.normal(0, 30, 12))}
    )
    table.to_csv(tmp_path / "scales.csv", index=False)
    assert check(tmp_path / "scales.csv", 0)["kind"] == "weighings"
    table.loc[[0, 1, 2, 6, 7, 8], "load_kg"] = np.repeat([2.0, 0.0], 3)
    table.to_csv(tmp_path / "exchanged.csv", index=False)
    wrong = check(tmp_path / "exchanged.csv", 3)["tables"]["wrong"]["rows"][0]
    assert wrong["what would settle it"] == "Put the two weights on again, each once."
    time = np.arange(3000) / 100.0
    bare = pd.DataFrame({"t": time, "a": np.rint(rng.normal(8e4, 20.0, 3000))})
    bare.to_csv(tmp_path / "bare.csv", index=False)
    (tmp_path / "bare.toml").write_text("[columns]\ntime_s = 't'\nraw_a_count = 'a'\n")
    found = check(tmp_path / "bare.csv", 0)
    page = (tmp_path / "bare.check.html").read_text()
    assert "Clock and channels are sound; nothing says what" in page
    assert "100 a second, jitter 0 ms" in page
    assert found["kind"] == "channels"
    assert found["tables"]["channels"]["rows"][0]["noise (counts)"] == pytest.approx(20.0, rel=0.05)


def test_what_is_no_log_ends_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y\n1,2\n")
    fails(
        ["check", tmp_path / "a.csv"],
        "a.csv: has no column 'raw_<channel>_count'; there are 'x', 'y'. Name yours under "
        "[columns] in a.toml.",
    )


@pytest.mark.parametrize("early", [-30, -2, 0, 5])
def test_noise_is_that_of_rest_where_the_column_of_loads_is_early_or_late(early: int, tmp_path: Path) -> None:
    load = np.repeat([0.0, 2.0, 0.0, 4.0, 0.0], 500)
    counts = 4e4 + 1.5e5 * np.roll(load, early) + np.random.default_rng(1).normal(0.0, 25.0, len(load))
    table = {"time_s": np.arange(len(load)) / 100.0, "load_kg": load, "raw_cell_count": np.rint(counts)}
    pd.DataFrame(table).to_csv(tmp_path / "rig.csv", index=False)
    assert check_log(tmp_path / "rig.csv").facts[0].noise.white == pytest.approx(25.0, rel=0.05)


def test_a_six_axis_foot_without_a_length_is_refused_by_check_too(tmp_path: Path, undrawn: None) -> None:
    time = np.arange(1500) / 200.0
    load = 600.0 * np.clip(np.sin(np.pi * time), 0.0, 1.0)
    axes = ("fx", "fy", "fz", "tx", "ty", "tz")
    noise = np.random.default_rng(4).normal(0.0, 1.0, (6, len(time)))
    counts = {f"raw_sole_{axis}_count": noise[i] + load * (axis == "fz") for i, axis in enumerate(axes)}
    pd.DataFrame({"time_s": time} | counts).to_csv(tmp_path / "sole.csv", index=False)
    foot = {"name": "sole", "channel_names": axes, "wrench_map": np.eye(6).tolist()}
    told = {"format": "surefoot-log", "format_version": 1, "lag_samples": 0, "mass_kg": 60.0}
    told |= {"layout": [foot], "nominal": {"scale_N_per_count": [1.0] * 6}}
    (tmp_path / "sole.json").write_text(json.dumps(told))
    reasons = [row["what is seen"] for row in check(tmp_path / "sole.csv", 3)["tables"]["wrong"]["rows"]]
    assert "foot_length_m" in reasons[0]
    (tmp_path / "sole.json").write_text(json.dumps(told | {"about": {"foot_length_m": 0.24}}))
    check(tmp_path / "sole.csv", 0)
