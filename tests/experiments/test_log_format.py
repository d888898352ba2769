"""What is written is read back, and what would mislead a calibrator is refused with a cure."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from _logs import Change, redescribe, refusal_of, with_cell

from surefoot.calibration import Parameters
from surefoot.experiments.logs.checks import LISTED
from surefoot.experiments.logs.format import Log, LogError, read_log, write_log
from surefoot.experiments.walks.replay import beliefs_of


@pytest.mark.parametrize("name", ["walk.parquet", "walk.csv"])
def test_a_log_survives_the_file(full: Log, tmp_path: Path, name: str) -> None:
    log, raw = full, full.raw.copy()
    raw[3, 2] = np.nan
    log = dataclasses.replace(
        log, raw=raw, calibrated=Parameters(log.nominal.scale * 1.1, log.nominal.offset)
    )
    back = read_log(write_log(log, tmp_path / name))
    np.testing.assert_array_equal(back.time, log.time)
    np.testing.assert_array_equal(back.raw, log.raw)
    for field in log.reference._fields:
        np.testing.assert_allclose(getattr(back.reference, field), getattr(log.reference, field), atol=1e-15)
    assert back.reference.stance.dtype == bool
    assert back.momentum is not None
    assert log.momentum is not None
    for field, part in log.momentum._asdict().items():
        np.testing.assert_allclose(getattr(back.momentum, field), part, atol=1e-15)
    assert back.truth is not None
    assert log.truth is not None
    np.testing.assert_array_equal(back.truth.force, log.truth.force)
    np.testing.assert_allclose(back.truth.R_world_sole, log.truth.R_world_sole, atol=1e-15)
    assert back.calibrated is not None
    np.testing.assert_array_equal(back.calibrated.scale, log.nominal.scale * 1.1)
    np.testing.assert_array_equal(back.layout.wrench_map, log.layout.wrench_map)
    assert back.layout.channel_names == log.layout.channel_names
    assert (back.mass, back.dt, back.lag, back.seed, back.about) == (
        log.mass, log.dt, log.lag, log.seed, log.about,
    )  # fmt: skip


def test_a_log_without_momentum_is_one_of_accelerations(path: Path) -> None:
    assert '"momentum_' not in path.read_text().splitlines()[0]
    back = read_log(path)
    assert back.momentum is None
    assert beliefs_of(back, "moment") is back.reference


def test_rows_are_cut_from_all_parts(full: Log) -> None:
    part = full.cut(slice(10, 50))
    assert {len(values) for kind in (part.reference, part.momentum) for values in kind or ()} == {40}
    assert len(part) == len(part.raw) == 40
    assert part.truth is not None
    assert len(part.truth.force) == 40


def test_a_log_says_what_it_is_in_one_line_and_becomes_a_frame(log: Log) -> None:
    assert repr(log).startswith(f"Log({len(log)} samples of 8 channels (left, right), ")
    assert len(repr(log)) < 110
    frame = log.to_pandas()
    np.testing.assert_array_equal(frame["raw_right_rear_left_count"], log.raw[:, 6])


def test_a_real_robot_has_no_truth(log: Log, tmp_path: Path) -> None:
    path = write_log(dataclasses.replace(log, truth=None, seed=None), tmp_path / "walk.csv")
    assert not any(name.startswith("truth_") for name in pd.read_csv(path).columns)
    assert read_log(path).truth is None


def test_extra_columns_are_ignored(log: Log, path: Path) -> None:
    pd.read_csv(path).assign(battery_V=21.6).to_csv(path, index=False)
    assert len(read_log(path)) == len(log)


def test_writing_fails_whole(log: Log, tmp_path: Path) -> None:
    path = write_log(log, tmp_path / "walk.parquet")
    before = path.read_bytes()
    broken = dataclasses.replace(log, about={"what": object()})
    with pytest.raises(TypeError):
        write_log(broken, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["walk.parquet"]


BAD_TABLES: dict[str, tuple[Change, str]] = {
    "missing column": (
        lambda t: t.drop(columns=["raw_left_front_left_count"]),
        f"missing column raw_left_front_left_count; {LISTED}",
    ),
    "half a truth": (
        lambda t: t.drop(columns=["truth_right_sole_qz"]),
        f"missing column truth_right_sole_qz; {LISTED}",
    ),
    "half a momentum": (
        lambda t: t.drop(columns=["momentum_com_velocity_x_m_s"]),
        f"missing column momentum_com_velocity_x_m_s; {LISTED}",
    ),
    "many missing columns": (
        lambda t: t[["time_s"]],
        "missing column raw_left_front_left_count, raw_left_front_right_count, "
        f"raw_left_rear_left_count, raw_left_rear_right_count and 37 more; {LISTED} Feet alone, without "
        "references, can be calibrated by --method tare or none.",
    ),
    "text": (
        with_cell(4, "reference_com_x_m", "1,5"),
        "column 'reference_com_x_m' holds '1,5' at row 4, which is no number; leave the cell empty where no "
        "sample arrived, and check the separator and the decimal point.",
    ),
    "a belief that is not there": (
        with_cell(4, "reference_com_x_m", np.nan),
        "column 'reference_com_x_m' is nan at row 4; drop the row or interpolate the column.",
    ),
    "an infinite reading": (
        with_cell(7, "raw_right_rear_right_count", np.inf),
        "column 'raw_right_rear_right_count' is inf at row 7; write NaN where no sample arrived.",
    ),
    "a flag that is none": (
        with_cell(2, "reference_left_stance", 2),
        "column 'reference_left_stance' is 2.0 at row 2; it must be 0 or 1.",
    ),
    "no quaternion": (
        with_cell(9, "reference_left_sole_qw", 2.0),
        "columns 'reference_left_sole_qw' to 'reference_left_sole_qz' have length 2 at row 9; "
        "a rotation is a quaternion (w, x, y, z) of length 1.",
    ),
    "time turns back": (
        with_cell(10, "time_s", 0.05),
        "column 'time_s' goes back at row 10 (0.1125 s, then 0.05 s); packets came late: sort the rows by "
        "their time.",
    ),
    "a gap": (
        lambda t: t.assign(time_s=t["time_s"] + 22.6 * (t.index >= 30)),
        "column 'time_s' leaps by 22.6 s at row 30 (at most 0.3 s); cut the log there and calibrate "
        "the parts one by one, or bridge it with --split-gaps.",
    ),
    "milliseconds": (
        lambda t: t.assign(time_s=1e3 * t["time_s"]),
        "column 'time_s' steps by 12.5 where the description says dt_s = 0.0125; it looks like "
        "ms: say so in 'walk.toml', [units] time_s = \"ms\".",
    ),
    "nanoseconds since 1970": (
        lambda t: t.assign(time_s=1_700_000_000_000_000_000 + (1e9 * t["time_s"]).astype("int64")),
        "column 'time_s' steps by 1.25e+07 where the description says dt_s = 0.0125; it looks like "
        "ns: say so in 'walk.toml', [units] time_s = \"ns\".",
    ),
    "one row": (lambda t: t.head(1), "column 'time_s' has one row alone; record some seconds."),
}


@pytest.mark.parametrize(("change", "message"), BAD_TABLES.values(), ids=BAD_TABLES)
def test_a_bad_table_is_refused(full: Log, tmp_path: Path, change: Change, message: str) -> None:
    path = write_log(full, tmp_path / "walk.csv")
    change(pd.read_csv(path)).to_csv(path, index=False)
    assert refusal_of(path) == f"walk.csv: {message}"


BAD_DESCRIPTIONS: dict[str, tuple[dict[str, object], str]] = {
    "another format": (
        {"format": "rosbag"},
        "the description: format: Input should be 'surefoot-log', got 'rosbag'.",
    ),
    "another version": ({"format_version": 9}, "the description: format_version: Input should be 1, got 9."),
    "negative mass": (
        {"mass_kg": -5.3},
        "the description: mass_kg: Input should be greater than 0, got -5.3.",
    ),
    "negative lag": (
        {"lag_samples": -1},
        "the description: lag_samples: Input should be greater than or equal to 0, got -1.",
    ),
    "a mass in words": (
        {"mass_kg": "heavy"},
        "the description: mass_kg: Input should be a valid number, got 'heavy'.",
    ),
    "too few scales": (
        {"nominal": {"scale_N_per_count": [1.0], "offset_N": [0.0]}},
        "the description: a map needs 8 finite scales and offsets, one a channel.",
    ),
    "no offsets": (
        {"nominal": {"scale_N_per_count": [1.0] * 8}},
        "the description's nominal has no 'offset_N', and the left foot is never surely in the air, where it "
        "could be read; lift it, or give for 'raw_left_front_left_count' minus scale times what the channel "
        "reads unloaded.",
    ),
}


@pytest.mark.parametrize(("change", "message"), BAD_DESCRIPTIONS.values(), ids=BAD_DESCRIPTIONS)
def test_a_bad_description_is_refused(path: Path, change: Any, message: str) -> None:
    redescribe(path, **change)
    assert refusal_of(path) == f"walk.csv: {message}"


def test_the_places_of_the_cells_say_what_a_foot_is(log: Log, path: Path) -> None:
    description = json.loads(path.with_suffix(".json").read_text())
    feet = [
        {
            "name": foot["name"],
            "position_cell_sole_m": foot["position_cell_sole_m"],
            "mass_below_kg": foot["sensors"][0]["mass_below_kg"],
            "com_below_sole_m": foot["sensors"][0]["com_below_sole_m"],
        }
        for foot in description["layout"]
    ]
    redescribe(path, layout=feet)
    assert str(read_log(path).layout) == str(log.layout)
    del feet[1]["position_cell_sole_m"]
    redescribe(path, layout=feet)
    assert "layout: lacks 'position_cell_sole_m', where the load cells of a" in refusal_of(path)


def test_feet_that_no_robot_has_are_refused(path: Path) -> None:
    left = json.loads(path.with_suffix(".json").read_text())["layout"][0]
    redescribe(path, layout=[])
    assert refusal_of(path).startswith("walk.csv: the description: layout: A layout needs at least one foot")
    redescribe(path, layout=[left] * 2)
    assert "Several feet are named ['left']; give each its own name" in refusal_of(path)


def test_files_that_are_no_logs(log: Log, tmp_path: Path) -> None:
    assert "gone.parquet: no such file; 'surefoot demo' records logs" in refusal_of(tmp_path / "gone.parquet")
    (tmp_path / "walk.txt").write_text("")
    (tmp_path / "walk.parquet").write_bytes(b"PAR0")
    pq.write_table(pa.table({"time_s": [0.0, 1.0]}), tmp_path / "bare.parquet")
    write_log(log, tmp_path / "lonely.csv").with_suffix(".json").unlink()
    write_log(log, tmp_path / "torn.csv").with_suffix(".json").write_text('{"format": ')
    for name, message in {
        "walk.txt": "walk.txt: a log ends in .parquet or .csv; rename or convert",
        "walk.parquet": "walk.parquet: not a readable table",
        "bare.parquet": "bare.parquet: the description bare.json is not beside it, nor within it",
        "lonely.csv": "lonely.csv: the description lonely.json is not beside it",
        "torn.csv": "torn.json: the description: not JSON",
    }.items():
        assert refusal_of(tmp_path / name).startswith(message)
    with pytest.raises(LogError, match=r"^walk\.mat: a log ends in \.parquet or \.csv; rename the file\."):
        write_log(log, tmp_path / "walk.mat")
