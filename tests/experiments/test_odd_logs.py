"""Logs as they come off robots: clocks that stand, tables that Excel saved, chips slower than the rows."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from _logs import run

from surefoot.calibration import CalibrationRefused
from surefoot.experiments.instrument.channels import Wrong
from surefoot.experiments.instrument.check import check_log, wrong_table
from surefoot.experiments.instrument.recording import read_recording
from surefoot.experiments.logs.clock import unit_of_times
from surefoot.experiments.logs.format import Log, read_log, write_log
from surefoot.experiments.logs.table import LogError
from surefoot.experiments.walking.judge import judge_log
from surefoot.experiments.walking.notices import check_weight, log_notices
from surefoot.experiments.weights.calibrate import fit_weighings

ROWS = 2000
TIME = np.arange(ROWS) / 80.0
CELL = "raw_a_count"


def channels(**columns: object) -> pd.DataFrame:
    """Two channels at rest, seen for 25 s at 80 Hz."""
    rng = np.random.default_rng(0)
    noise = np.rint(8e4 + rng.normal(0.0, 20.0, (2, ROWS)))
    return pd.DataFrame({"time_s": TIME, CELL: noise[0], "raw_b_count": noise[1], **columns})


def said(wrong: Wrong) -> tuple[str, str, bool]:
    """When it began, what is seen, and whether it refuses the log."""
    return wrong.since, wrong.finding.reason, wrong.finding.refuses


ODD: dict[str, tuple[pd.DataFrame, tuple[str, str, bool]]] = {
    "a clock that stands": (
        channels(time_s=1.0),
        ("all along", "Column 'time_s' stands still at 1 s from row 0 on.", True),
    ),
    "a clock that stops": (
        channels(time_s=np.minimum(TIME, 12.5)),
        ("12.5 s", "Column 'time_s' stands still at 12.5 s from row 1000 on.", True),
    ),
    "a clock that goes back": (
        channels(time_s=np.where(TIME > 12.5, TIME - 10.0, TIME)),
        (
            "13.5 s",
            "Column 'time_s' begins again at row 1001 (12.5 s, then 2.5125 s), as when a logger was "
            "restarted.",
            False,
        ),
    ),
    "a clock that leaps": (
        channels(time_s=TIME + 5.0 * (TIME > 12.5)),
        ("17.5125 s", "The clock has 1 gap, the longest of 5.01 s.", False),
    ),
    "packets that came late": (
        channels(time_s=TIME[np.where(np.arange(ROWS) == 900, 896, np.arange(ROWS))]),
        ("11.2 s", "Column 'time_s' goes back at row 900 (11.2375 s, then 11.2 s).", True),
    ),
    "a time that is missing": (
        channels(time_s=np.where(np.arange(ROWS) == 5, np.nan, TIME)),
        ("row 5", "Column 'time_s' is nan at row 5.", True),
    ),
    "no times": (
        channels().drop(columns="time_s"),
        ("all along", "Rows have no times, so rate, noise and drift cannot be measured.", False),
    ),
    "a leap, in seconds since 1970": (
        channels(time_s=1.7e9 + TIME + 5.0 * (TIME > 12.5)),
        ("1700000017.51 s", "The clock has 1 gap, the longest of 5.01 s.", False),
    ),
    "milliseconds": (
        channels(time_s=1e3 * TIME),
        ("all along", "Rows are 12.5 s apart, so times may be in another unit than seconds.", False),
    ),
    "one row": (channels()[:1], ("all along", "1 row is too few for a check.", True)),
    "zeros": (channels(raw_a_count=0, raw_b_count=0), ("all along", "No channel changes.", True)),
    "nothing": (
        channels(raw_a_count=np.nan, raw_b_count=np.nan),
        ("all along", "No column contains a reading.", True),
    ),
}


@pytest.mark.parametrize(("table", "expected"), ODD.values(), ids=ODD)
def test_a_bare_log_says_its_flaw_once(table: pd.DataFrame, expected: Any, tmp_path: Path) -> None:
    table.to_csv(tmp_path / "rig.csv", index=False)
    checked = check_log(tmp_path / "rig.csv")
    assert [said(one) for one in checked.wrong] == [expected]
    assert len(wrong_table(checked).rows) == 1
    assert checked.sound != expected[2]


@pytest.mark.parametrize("name", ["a clock that stops", "a clock that goes back", "a clock that leaps"])
def test_rate_and_noise_are_those_of_the_rows_between_leaps(name: str, tmp_path: Path) -> None:
    ODD[name][0].to_csv(tmp_path / "rig.csv", index=False)
    for one in check_log(tmp_path / "rig.csv").facts:
        assert 1.0 / one.noise.interval == pytest.approx(80.0)
        assert one.noise.white == pytest.approx(20.0, rel=0.1)


def test_a_page_is_drawn_of_a_clock_that_stands_and_of_zeros(tmp_path: Path) -> None:
    channels().assign(time_s=1.0, raw_a_count=0, raw_b_count=0).to_csv(tmp_path / "rig.csv", index=False)
    result = run("check", tmp_path / "rig.csv", code=3)
    assert result.stderr == ""
    assert "nan" not in result.stdout


UNREADABLE = {
    "nothing": ("", "log.csv: is empty; a log has a line of column names, and a row a sample."),
    "names alone": (f"time_s,{CELL}\n", "log.csv: holds no rows of samples, only names of columns."),
}


@pytest.mark.parametrize(("text", "expected"), UNREADABLE.values(), ids=UNREADABLE)
def test_what_cannot_be_read_says_why(text: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(LogError) as refused:
        check_log(tmp_path / "log.csv")
    assert str(refused.value) == expected


def test_decimal_commas_between_commas_are_named(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(f"time_s,{CELL}\n0,01,5\n0,02,6\n")
    with pytest.raises(LogError, match=r"Decimal commas need another separator, such as ';'\.$"):
        check_log(tmp_path / "log.csv")


@pytest.mark.parametrize(("step", "unit"), [(12.5, "ms"), (500.0, "us"), (1.25e4, "us"), (1.25e7, "ns")])
def test_a_step_of_time_tells_its_unit(step: float, unit: str) -> None:
    assert unit_of_times(step) == unit


CELLS = [f"raw_{foot}_{cell}_count" for foot in ("left", "right") for cell in ("heel", "ball", "toe")]


def write_feet(path: Path, change: Callable[[pd.DataFrame, dict[str, Any]], Any]) -> Path:
    """Write 6 s of two feet alone that step on the spot, 5 kg on three cells each, and change the log."""
    time = np.arange(600) / 100.0
    share = (0.5 + 0.8 * np.sin(2.0 * np.pi * time / 1.2)).clip(0.0, 1.0)[:, None] * [1.0, -1.0] + [0.0, 1.0]
    noise = np.random.default_rng(0).normal(0.0, 100.0, (600, 6))
    counts = np.rint(5.0 * 9.81 * share[:, [0, 0, 0, 1, 1, 1]] / 3.0 / 1e-5 + noise)
    places = {"position_cell_sole_m": [[-0.06, 0.0], [0.05, 0.02], [0.1, 0.0]]}
    places |= {"channel_names": ["heel", "ball", "toe"]}
    told = {"format": "surefoot-log", "format_version": 1, "lag_samples": 0, "mass_kg": 5.0}
    told |= {"layout": [{"name": foot, **places} for foot in ("left", "right")]}
    told |= {"nominal": {"scale_N_per_count": [1e-5] * 6}}
    table = pd.DataFrame(counts, columns=CELLS)
    table.insert(0, "time_s", time)
    changed = change(table, told)
    (table if changed is None else changed).to_csv(path, index=False)
    path.with_suffix(".json").write_text(json.dumps(told))
    return path


FEET: dict[str, tuple[Callable[[pd.DataFrame, dict[str, Any]], Any], str]] = {
    "a mass in grams": (
        lambda table, told: told.update(mass_kg=5000.0),
        "by the nominal map no foot's load changes by more than 49.05 N, and mass_kg = 5000 weighs 4.905e+04 "
        "N: 0.001 times as much, where a step makes 0.5 to 3. Give scale_N_per_count in newtons (9.81 for "
        "each kilogram) and mass_kg in kilograms; if they are, lift each foot, or give 'offset_N'.",
    ),
    "a mass in tonnes": (
        lambda table, told: told.update(mass_kg=0.005),
        " 1e+03 times as much, where a step",
    ),
    "a map in kilograms": (
        lambda table, told: told.update(nominal={"scale_N_per_count": [1.02e-6] * 6}),
        " 0.102 times as much, where a step makes 0.5 to 3. Give scale_N_per_count in newtons",
    ),
    "an empty column": (
        lambda table, told: table.assign(raw_left_toe_count=np.nan),
        "column 'raw_left_toe_count' holds no reading in any of 600 rows, and the description's nominal has "
        "no 'offset_N'; check its cable and its name, or give 'offset_N'.",
    ),
    "empty columns": (
        lambda table, told: table.assign(**dict.fromkeys(CELLS, np.nan)),
        "column 'raw_left_heel_count', as 5 others, holds no reading in any of 600 rows, and",
    ),
    "milliseconds": (
        lambda table, told: table.assign(time_s=1e3 * table["time_s"]),
        "column 'time_s' steps by 10 where feet have several rows a second; it looks like ms: say so in "
        "'feet.toml', [units] time_s = \"ms\".",
    ),
    "microseconds": (
        lambda table, told: table.assign(time_s=1e6 * table["time_s"]),
        "it looks like us: say so in 'feet.toml', [units] time_s = \"us\".",
    ),
    "a gap": (
        lambda table, told: table.assign(time_s=table["time_s"] + 2.0 * (table.index > 300)),
        "column 'time_s' leaps by 2.01 s at row 301 (at most 0.3 s); cut the log there and calibrate",
    ),
    "a repeated time, and a gap": (
        lambda table, told: table.assign(
            time_s=table["time_s"].where(table.index != 9, 0.08) + 2.0 * (table.index > 300)
        ),
        "column 'time_s' leaps by 2.01 s at row 301",
    ),
    "a restarted logger": (
        lambda table, told: table.assign(time_s=table["time_s"] - 3.1 * (table.index > 400)),
        "column 'time_s' begins again at row 401 (4 s, then 0.91 s), as when a logger was restarted. Sorting "
        "would mix the sessions: cut the file there and calibrate the parts one by one, or keep them apart "
        "with --split-gaps.",
    ),
    "cells in millimetres": (
        lambda table, told: told["layout"][0].update(position_cell_sole_m=[[-60, 0], [50, 20], [100, 0]]),
        "the description: 'position_cell_sole_m' of the left foot go to 100, and no foot reaches farther "
        "than 5 m; give metres.",
    ),
    "no lag": (
        lambda table, told: told.pop("lag_samples") or None,
        "lacks 'lag_samples', by how many rows the reference is late; of feet alone give 0.",
    ),
    "a time of another name": (
        lambda table, told: table.rename(columns={"time_s": "time_ms"}),
        "missing column time_s; there are 'time_ms': name them under [columns] in feet.toml. docs/",
    ),
}


@pytest.mark.parametrize(("change", "message"), FEET.values(), ids=FEET)
def test_feet_alone_are_refused_by_both_commands(change: Any, message: str, tmp_path: Path) -> None:
    path = write_feet(tmp_path / "feet.csv", change)
    with pytest.raises(LogError) as refused:
        read_log(path, feet_alone=True)
    assert message in str(refused.value)
    assert not check_log(path).sound


def test_feet_alone_that_step_are_sound(tmp_path: Path) -> None:
    path = write_feet(tmp_path / "feet.csv", lambda table, told: None)
    assert np.abs(read_log(path, feet_alone=True).nominal.offset).max() < 0.01
    assert check_log(path).wrong == ()


def test_a_repeated_time_hides_no_gap(tmp_path: Path) -> None:
    path = write_feet(tmp_path / "feet.csv", FEET["a repeated time, and a gap"][0])
    assert [one.finding.name for one in check_log(path).wrong] == ["gaps"]


DRESS: dict[str, Callable[[str], str]] = {
    "comments": lambda text: f"# rig 3\n#\n{text}",
    "Excel's line of the separator": lambda text: "sep=;\n" + text.replace(",", ";"),
    "names in a comment": lambda text: f"# rig 3, cells a and b\n# {text}",
    "a preamble": lambda text: f"Rig 3, by Li\nRate,80\n\nserial;12, 14\n{text}",
    "a preamble between semicolons": lambda text: "Ort;Labor;2\n" + text.replace(",", ";"),
    "a row of units": lambda text: text.replace("\n", "\ns,count (2^24),\n", 1),
    "spaces": lambda text: text.replace(",", ", "),
}


@pytest.mark.parametrize("name", DRESS)
def test_what_stands_around_a_table_costs_nothing(name: str, tmp_path: Path) -> None:
    table = channels()
    (tmp_path / "rig.csv").write_text(DRESS[name](table.to_csv(index=False)))
    found = read_recording(tmp_path / "rig.csv")
    assert np.array_equal(found.raw, table[[CELL, "raw_b_count"]])
    assert np.array_equal(found.time, TIME)
    assert ("left out" in " ".join(found.notices)) == (name == "a row of units")


def test_a_walk_says_of_its_clock_and_cells_once(bad_start: Log, tmp_path: Path) -> None:
    time = bad_start.time + 3.0 * (bad_start.time > 6.0)
    raw = bad_start.raw.copy()
    raw[:, 0] = raw[0, 0]
    path = write_log(dataclasses.replace(bad_start, time=time, raw=raw), tmp_path / "walk.parquet")
    found = [one.finding.name for one in check_log(path).wrong]
    assert found == ["gaps", "constant"]


def test_readings_that_repeat_are_late_and_no_mistake_of_cables(bad_start: Log) -> None:
    """Chips of 10 Hz in rows of 80 Hz: readings are up to 90 ms old, and no feet are exchanged."""
    held = dataclasses.replace(bad_start, raw=bad_start.raw[np.arange(len(bad_start)) // 8 * 8])
    assert not any(one.refuses for one in judge_log(held, held.nominal).findings)
    assert any("repeat the readings of all channels" in one for one in log_notices(held, "walk.csv"))


def test_a_cell_that_reads_zero_does_not_weigh(bad_start: Log) -> None:
    raw = bad_start.raw.copy()
    raw[:, 2] = 0.0  # whose offset alone is seven times the robot's weight
    check_weight(dataclasses.replace(bad_start, raw=raw), "nominal", bad_start.nominal, "walk.csv")


def test_a_mass_in_grams_is_named_by_both_commands(bad_start: Log, tmp_path: Path) -> None:
    path = write_log(dataclasses.replace(bad_start, mass=1e3 * bad_start.mass), tmp_path / "walk.parquet")
    assert "kilonewtons or a mass in grams" in run("calibrate", "walk", path, code=2).stderr
    assert "kilonewtons or a mass in grams" in check_log(path).wrong[0].finding.reason


def test_a_description_may_lie_beside_a_table_of_pandas(log: Log, path: Path) -> None:
    pd.read_csv(path).to_parquet(path.with_suffix(".parquet"))
    np.testing.assert_allclose(read_log(path.with_suffix(".parquet")).raw, log.raw, rtol=1e-12)


def test_rows_and_words_that_are_too_few(log: Log, tmp_path: Path) -> None:
    path = write_log(dataclasses.replace(log.cut(slice(0, 2)), lag=4), tmp_path / "walk.csv")
    with pytest.raises(LogError, match=r"walk\.csv: 2 rows are too few where .* lag_samples = 4 rows late"):
        read_log(path)
    times = pd.read_csv(write_log(log, path))
    times["time_s"] = times["time_s"].to_numpy()[np.arange(len(log)) // 5 * 5] + 1e-4 * (
        np.arange(len(log)) % 5
    )
    times.to_csv(path, index=False)
    with pytest.raises(LogError, match=r"rows come in bursts: .* in 'walk\.toml' \[rates\]"):
        read_log(path)
    for given, expected in (
        ({}, "format: is missing."),
        ([], "must be a table of keys with values, got []."),
    ):
        path.with_suffix(".json").write_text(json.dumps(given))
        with pytest.raises(LogError) as refused:
            read_log(path)
        assert str(refused.value) == f"walk.csv: the description: {expected}"


def test_sets_whose_settings_name_columns_alone_are_sets(tmp_path: Path) -> None:
    """A robot's arm: a driver's newtons, and an accelerometer, under names of their own."""
    rng = np.random.default_rng(0)
    table = pd.DataFrame(rng.normal(0.0, 1.0, (40, 9)), columns=["t", *"abcdef", "x", "y"])
    table["z"] = 9.81
    table.to_csv(tmp_path / "arm.csv", index=False)
    settings = (
        '[columns]\ntime = ""\nraw = ["a", "b", "c", "d", "e", "f"]\nspecific_force = ["x", "y", "z"]\n'
    )
    (tmp_path / "arm.toml").write_text(settings)
    assert read_recording(tmp_path / "arm.csv").kind == "six-axis sensor"


def test_columns_with_units_in_their_names_are_listed(path: Path) -> None:
    table = pd.read_csv(path)
    table.rename(columns=lambda name: f"{name} [count]" if name.startswith("raw_") else name).to_csv(
        path, index=False
    )
    with pytest.raises(
        LogError, match=r"'raw_left_front_left_count \[count\]', .* under \[columns\] in walk\.toml"
    ):
        read_log(path)


WEIGHED = {
    "one load": ([1.0, 1.0, 1.0], "The cell 'a' saw only the load 9.81 N, and a line needs two."),
    "loads below zero": ([0.0, -1.0, -2.0], "Column 'load_kg' holds loads below zero, such as -2."),
}


@pytest.mark.parametrize(("loads", "reason"), WEIGHED.values(), ids=WEIGHED)
def test_check_and_calibrate_refuse_the_same_weighings(loads: Any, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "scales.csv"
    counts = [84000 + 100000 * i for i in range(3)]
    pd.DataFrame({"load_kg": loads, CELL: counts}).to_csv(path, index=False)
    assert reason in [one.finding.reason for one in check_log(path).wrong]
    with pytest.raises(CalibrationRefused) as refused:
        fit_weighings(path, tmp_path / "map.json")
    assert str(refused.value).startswith(f"scales.csv: {reason}")


def test_options_that_no_log_has_are_refused(log: Log, path: Path, tmp_path: Path) -> None:
    for options, message in (
        (
            ["--stand", "9", "--method", "window"],
            "--stand must be shorter than the log's 0.7375 s and positive",
        ),
        (["--stand", "0.5"], "A quiet stand tells the weights of the window alone, not of 'moment'"),
        (
            ["--topics", "no.toml"],
            "walk.csv: is a table; --topics names columns of bags, and walk.toml those of",
        ),
        (["--out", path], f"'{path}': File exists."),
    ):
        assert run("calibrate", "walk", path, *options, code=2).stderr.startswith(f"surefoot: {message}")


def test_sessions_of_a_restarted_logger_never_interleave(tmp_path: Path) -> None:
    def restart(table: pd.DataFrame, told: Any) -> pd.DataFrame:
        again = table.assign(time_s=table["time_s"] + 0.0037)
        return pd.concat([table, again], ignore_index=True)

    path = write_feet(tmp_path / "feet.csv", restart)
    log = read_log(path, np.inf, feet_alone=True)
    assert (np.diff(log.time) > 0.0).all()
    assert np.diff(log.time)[599] == pytest.approx(1.0)
    assert np.array_equal(log.raw[:600], log.raw[600:])
    assert "begins again at row 600" in log.about["notices"][0]


def test_a_last_row_that_was_cut_off_is_left_out_and_noted(tmp_path: Path) -> None:
    text = channels().to_csv(index=False).rstrip("\n")
    (tmp_path / "rig.csv").write_text(text[: text.rindex(",") - 3])
    found = read_recording(tmp_path / "rig.csv")
    assert len(found.raw) == ROWS - 1
    assert found.notices == ("rig.csv: the last row is cut off, and was left out.",)
    (tmp_path / "rig.csv").write_text(text.replace("\n0.125,", "\n0.125;"))
    with pytest.raises(LogError, match=r"not a readable table .*Expected 3 columns, got 2"):
        read_recording(tmp_path / "rig.csv")
