"""Logs as people have them: other names, units, clocks, and several tables at rates of their own."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from _logs import redescribe, refusal_of

from surefoot.calibration import GRAVITY
from surefoot.experiments.logs.format import Log, LogError, read_log, write_log

EPOCH = 1_700_000_000_000_000_000  # a moment in ns since 1970


def test_other_names_units_and_an_epoch_in_nanoseconds(log: Log, path: Path) -> None:
    table = pd.read_csv(path)
    table["time_s"] = EPOCH + np.rint(1e9 * table["time_s"]).astype(np.int64)
    for name in table.columns:
        if name.startswith("reference_accelerometer"):
            table[name] /= GRAVITY
        if name.startswith("reference_gyroscope"):
            table[name] *= 180.0 / np.pi
    names = {"time_s": "stamp [ns]", "raw_left_front_left_count": "FL", "reference_com_x_m": "com.x"}
    table.rename(columns=names).to_csv(path, index=False, sep=";", decimal=",")
    lines = [f"{name} = '{theirs}'" for name, theirs in names.items()]
    units = {"time_s": "ns", "*_accelerometer_*": "g", "*_gyroscope_*": "deg/s"}
    lines += ["[units]", *(f"'{name}' = '{unit}'" for name, unit in units.items())]
    path.with_suffix(".toml").write_text("\n".join(["[columns]", *lines]))
    found = read_log(path)
    np.testing.assert_allclose(found.time - 1e-9 * EPOCH, log.time, atol=5e-7)
    np.testing.assert_allclose(found.raw, log.raw)
    for field, expected in log.reference._asdict().items():
        np.testing.assert_allclose(getattr(found.reference, field), expected, atol=1e-9, err_msg=field)


def test_times_of_day_are_seconds(log: Log, path: Path) -> None:
    table = pd.read_csv(path)
    table["time_s"] = pd.to_datetime(EPOCH + np.rint(1e9 * table["time_s"]).astype(np.int64)).astype(str)
    table.to_csv(path, index=False)
    np.testing.assert_allclose(read_log(path).time - 1e-9 * EPOCH, log.time, atol=5e-7)


def test_tables_at_rates_of_their_own_come_onto_the_rows_of_the_feet(full: Log, tmp_path: Path) -> None:
    """The lines between two rows of a faster table, the last of flags; counts are never made up."""
    log, path = full, write_log(full, tmp_path / "walk.csv")
    table = pd.read_csv(path)
    beliefs = [name for name in table.columns if name.startswith(("reference_", "momentum_"))]
    beliefs = [name for name in beliefs if "_q" not in name]
    flags = [name for name in beliefs if name.endswith(("_stance", "_swing"))]
    moved = [name for name in beliefs if name not in flags]
    fine = np.arange(-0.1, 1.0, 1 / 200)
    body = {name: np.interp(fine, table["time_s"], table[name]) for name in moved}
    pd.DataFrame({"t": 1e3 * (fine - 0.25)} | body).to_csv(tmp_path / "body.csv", index=False)
    steps = pd.DataFrame(
        {name: np.ones(30, int) if "stance" in name else np.zeros(30, int) for name in flags}
    )
    steps.iloc[10:20] = 0
    steps.to_csv(tmp_path / "steps.csv", index=False)
    table.drop(columns=beliefs).to_csv(path, index=False)
    redescribe(path, dt_s=None)
    path.with_suffix(".toml").write_text(
        "[tables.'body.csv']\ntime_s = 't'\n[tables.'steps.csv']\n[rates]\n'steps.csv' = 30.0\n"
        "[offsets_s]\n'body.csv' = 0.25\n[units]\n'body.csv:time_s' = 'ms'\n"
    )
    found = read_log(path)
    assert found.dt == pytest.approx(log.dt)
    np.testing.assert_allclose(found.raw, log.raw, rtol=1e-15)
    exact = np.interp(log.time, fine, body["reference_com_x_m"])
    np.testing.assert_allclose(found.reference.com[:, 0], exact, atol=1e-12)
    assert found.momentum is not None
    np.testing.assert_allclose(found.momentum.com[:, 0], exact, atol=1e-12)
    on = (log.time * 30.0 + 1e-9).astype(int)
    np.testing.assert_array_equal(found.reference.stance[:, 0], (on < 10) | (on >= 20))
    assert found.about["notices"][1] == "body.csv: 220 rows, 200 a second."


def mapped(path: Path, text: str) -> str:
    """Return why a log is refused with a TOML file beside it."""
    path.with_suffix(".toml").write_text(text)
    return refusal_of(path)


def test_what_the_file_may_not_say(log: Log, path: Path, tmp_path: Path) -> None:
    assert mapped(path, "[columns]\ntime_s = 't'").startswith(
        "walk.csv: missing column t; which the TOML file names; there are 'time_s', 'raw_left_"
    )
    assert mapped(path, "[units]\ntime_s = 'deg'") == (
        "units: 'time_s' cannot be in 'deg'; there are s, ms, us, ns."
    )
    assert mapped(path, "[units]\n'joint_*' = 'deg'").startswith(
        "units: no column is called 'joint_*'; there "
    )
    assert mapped(path, "[rates]\n'imu.csv' = 100.0") == (
        "walk.toml: names the table 'imu.csv'; there are walk.csv."
    )
    assert (
        mapped(path, "[tables.'imu.csv']")
        == f"{tmp_path / 'imu.csv'}: no such file; [tables] gives its path."
    )
    pd.DataFrame({"t": [0.0, 1.0], "x": 1.0}).to_csv(tmp_path / "imu.csv", index=False)
    assert mapped(path, "[tables.'imu.csv']\ntime_s = 't'") == (
        "imu.csv: holds no column of a log; there are 'x', 'time_s'. Name them under [tables.\"imu.csv\"]."
    )


def test_a_column_of_another_name_is_shown_the_way(path: Path) -> None:
    pd.read_csv(path).rename(columns={"raw_left_front_left_count": "FL"}).to_csv(path, index=False)
    with pytest.raises(LogError, match=r"there are 'FL'.*: name them under \[columns\] in walk\.toml\."):
        read_log(path)


def test_offsets_that_nobody_gave_are_read_in_the_air(log: Log, tmp_path: Path) -> None:
    swing = np.zeros((len(log), 2), dtype=bool)
    swing[:20, 0] = swing[30:50, 1] = True
    unloaded = np.linspace(80_000.0, 87_000.0, 8)
    raw = unloaded + (log.raw - log.raw.mean(axis=0)) * 0.0
    # Row k of the reference describes the feet of row k - lag.
    raw[~np.roll(swing, -log.lag, axis=0).repeat(4, axis=1)] += 1000.0
    swung = dataclasses.replace(log, raw=raw, reference=log.reference._replace(swing=swing), truth=None)
    path = write_log(swung, tmp_path / "walk.csv")
    redescribe(path, nominal={"scale_N_per_count": log.nominal.scale.tolist()})
    np.testing.assert_allclose(read_log(path).nominal.offset, -2e-5 * unloaded)


def test_the_most_specific_unit_of_a_column_counts(log: Log, path: Path) -> None:
    table = pd.read_csv(path)
    table["time_s"] *= 1e3
    for name in table.columns:
        if name.endswith("_gyroscope_x_rad_s"):
            table[name] *= 180.0 / np.pi
    table.to_csv(path, index=False)
    units = {"*_rad_s": "rad/s", "*_gyroscope_x_*": "deg/s", "time_s": "us", "walk.csv:time_s": "ms"}
    lines = [f"'{name}' = '{unit}'" for name, unit in units.items()]
    path.with_suffix(".toml").write_text("\n".join(["[units]", *lines]))
    found = read_log(path)
    np.testing.assert_allclose(found.time, log.time, atol=1e-12)
    np.testing.assert_allclose(found.reference.gyroscope, log.reference.gyroscope, atol=1e-12)
