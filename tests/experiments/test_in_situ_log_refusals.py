"""In-situ logs that are refused, with the way out."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from _in_situ_logs import FORCE, RAW, SPIN, spinning, table, toml, write
from _logs import Change, scale_columns, with_cell

from surefoot.calibration import GRAVITY
from surefoot.experiments.force_torque.config import InSituConfig
from surefoot.experiments.force_torque.log import read_in_situ_log
from surefoot.experiments.logs.format import LogError


def _column(column: str, value: Any) -> Change:
    return lambda frame: frame.assign(**{column: value})


def _set_rows(column: str, values: Any, number: int = 2) -> Change:
    def change(frame: pd.DataFrame) -> pd.DataFrame:
        frame.loc[frame["set"] == number, column] = values
        return frame

    return change


BAD_TABLES: dict[str, tuple[Change, str]] = {
    "no time": (
        lambda f: f.drop(columns="time_s"),
        r"leg\.csv: missing column time_s for the time .*there are 'set', 'raw_0_count'.*\[columns\]",
    ),
    "five channels": (
        lambda f: f.drop(columns=RAW[3]),
        r"missing column raw_3_count for the sensor's channels; there are 'time_s', 'set'",
    ),
    "no accelerometer": (
        lambda f: f.drop(columns=FORCE),
        "missing column specific_force_x_m_s2, .* for the accelerometer",
    ),
    "half a gyroscope": (
        _column(SPIN[0], 0.0),
        "missing column angular_velocity_y_rad_s, .* for the gyroscope",
    ),
    "both signs": (
        lambda f: f.assign(**{f"gravity_{axis}_m_s2": 0.0 for axis in "xyz"}),
        "has both gravity_x_m_s2 and specific_force_x_m_s2",
    ),
    "no rows": (lambda f: f.iloc[:0], r"leg\.csv: holds no rows"),
    "text": (
        with_cell(3, RAW[1], "1.5.2"),
        "column 'raw_1_count' holds '1.5.2' at row 3, which is no number",
    ),
    "infinite": (with_cell(4, FORCE[0], np.inf), "column 'specific_force_x_m_s2' is infinite at row 4"),
    "dead channel": (
        _set_rows(RAW[5], np.nan),
        "set '2': column 'raw_5_count' holds no value in 40 of 40 rows .* check its cable",
    ),
    "mostly dead": (
        _set_rows(RAW[5], [np.nan] * 30 + [1.0] * 10),
        r"set '2': column 'raw_5_count' holds no value in 30 of 40 rows \(75 %\)",
    ),
    "stuck channel": (_set_rows(RAW[5], 17.0), "set '2': column 'raw_5_count' is 17 in all 40 readings"),
    "saturated": (
        with_cell(slice(60, 63), RAW[4], 32767.0),
        "set '2': column 'raw_4_count' stands at 32767, the end of its range, in 10 % of its readings",
    ),
    "in g": (
        scale_columns(FORCE, 1.0 / GRAVITY),
        r"set '1': .* median length of 1 m/s\^2.*units.acceleration = 'g'",
    ),
    "in milli-g": (scale_columns(FORCE, 1e3 / GRAVITY), "units.acceleration = 'mg'"),
    "in mm/s^2": (scale_columns(FORCE, 1e3), r"it looks like mm/s\^2"),
    "no known unit": (scale_columns(FORCE, 0.3), r"give m/s\^2 with gravity in it"),
    "time goes back": (
        with_cell(9, "time_s", 0.05),
        r"set '1': column 'time_s' goes back at row 9 \(0.8 s, then",
    ),
    "a clock that stands": (
        with_cell(slice(5, 40), "time_s", 0.6),
        "set '1': column 'time_s' stands still at 0.6 s from row 5 on; write the time of each row",
    ),
    "set without a name": (with_cell(3, "set", np.nan), "column 'set' is empty at row 3"),
    "unknown set": (
        _set_rows("set", 9),
        r"leg\.csv: the TOML file names set '2', which is not in the log; there are '1', '9', '3'",
    ),
    "a set too short": (
        lambda f: f.drop(index=range(45, 80)),
        "set '2': has 5 whole samples, and a set needs at least 8",
    ),
    "two masses in a set": (
        lambda f: f.assign(added_mass_kg=np.linspace(0.0, 0.1, len(f))),
        "set '1': column 'added_mass_kg' goes from 0 to .*; give one value for each set",
    ),
    "a mass that the TOML denies": (
        _column("added_mass_kg", 0.0),
        r"set '2': the columns say 0 kg at .* m, and the TOML file 0.5 kg at \[0.1, 0.0, 0.3\] m",
    ),
    "a negative mass": (
        _column("added_mass_kg", -1.0),
        "set '1': added_mass_kg: Input should be greater than or equal to 0, got -1",
    ),
}


@pytest.mark.parametrize(("change", "said"), BAD_TABLES.values(), ids=BAD_TABLES)
def test_a_bad_table_is_refused(change: Any, said: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=said):
        read_in_situ_log(write(tmp_path, change(table())))


BAD_SPINS = {
    "in deg/s": (57.29578, "say 57 times the rate at which gravity turns; they look like deg/s"),
    "turned round": (-1.0, "turn gravity the wrong way round"),
    "in other units": (10.0, "say 10 times the rate at which gravity turns; give rad/s"),
}


@pytest.mark.parametrize(("factor", "said"), BAD_SPINS.values(), ids=BAD_SPINS)
def test_a_gyroscope_that_contradicts_gravity_is_refused(factor: float, said: str, tmp_path: Path) -> None:
    path = write(tmp_path, scale_columns(SPIN, factor)(spinning(table())))
    with pytest.raises(LogError, match=said):
        read_in_situ_log(path)


def test_milliseconds_are_recognised_beside_a_gyroscope(tmp_path: Path) -> None:
    path = write(tmp_path, scale_columns(["time_s"], 1e3)(spinning(table())))
    with pytest.raises(LogError, match=r"column 'time_s' steps by 100 s.* say units.time = 'ms'"):
        read_in_situ_log(path)


BAD_CONFIGS = {
    "no TOML": ("[columns\n", r"leg\.toml: not TOML"),
    "unknown table": ("[colums]\n", r"leg\.toml: unknown key 'colums'; there are columns, units, csv"),
    "unknown key": ('[columns]\nrw = ["a"]\n', "columns: unknown key 'rw'; there are time, set, raw"),
    "units that are no table": ("units = 3\n", "units: must be a table of keys with values"),
    "unknown unit": (
        '[units]\nacceleration = "ft"\n',
        r"units.acceleration: Input should be 'm/s\^2', 'g' or 'mg', got 'ft'",
    ),
    "not three": ('[columns]\ngravity = ["a"]\n', "columns.gravity.1: is missing"),
    "not three turns": ('[columns]\nangular_velocity = ["a"]\n', "columns.angular_velocity.1: is missing"),
    "five channels": (f"[columns]\nraw = {RAW[:5]}\n", "columns.raw: needs at least 6, and has 5"),
    "no rotation": (
        "[accelerometer]\nR_sensor_accelerometer = [[2,0,0],[0,1,0],[0,0,1]]\n",
        "must be a rotation",
    ),
    "no such model": (
        '[accelerometer]\ncalibrate = "all"\n',
        "accelerometer.calibrate: Input should be 'bias', 'bias-scale' or 'full', got 'all'",
    ),
    "range upside down": ("[sensor]\nrange_count = [5, -5]\n", r"must be \[lowest, highest\]"),
    "two matrices": (
        f'[factory]\nmatrix = {np.ones((6, 6)).tolist()}\nfile = "m.csv"\n',
        "holds both a 'matrix' and a 'file'",
    ),
    "no matrix file": ('[factory]\nfile = "m.csv"\n', r"m\.csv: no such file; factory\.file gives its path"),
    "a flat matrix": ("[factory]\nmatrix = [1, 2]\n", r"factory\.matrix: must have shape \(6, None\)"),
    "a weightless limb": ("[limb]\nmass_kg = 0\n", "limb.mass_kg: Input should be greater than 0, got 0"),
    "a spread of nothing": ("[limb]\nmass_std_kg = 0.1\n", "limb: 'mass_std_kg' needs 'mass_kg' beside it"),
    "no such option": ("[fit]\ndrift = 99\n", "fit.drift: Input should be a valid boolean"),
    "a set twice": (
        '[[sets]]\nname = "1"\nadded_mass_kg = 0.0\n',
        "set '1' is listed twice; list each set once",
    ),
    "a negative mass": (
        '[[sets]]\nname = "9"\nadded_mass_kg = -0.5\n',
        "sets.0.added_mass_kg: Input should be .* equal to 0, got",
    ),
    "a mass nowhere": (
        '[[sets]]\nname = "9"\nadded_mass_kg = 0.5\n',
        "set '9' has 0.5 kg and no 'added_com_m'",
    ),
    "a nameless set": ("[[sets]]\nadded_mass_kg = 0.5\n", "sets.0.name: is missing"),
    "other channels": (
        f"[factory]\nmatrix = {np.ones((6, 7)).tolist()}\n",
        r"has 6 channels and the factory matrix 7 columns",
    ),
}


@pytest.mark.parametrize(("told", "said"), BAD_CONFIGS.values(), ids=BAD_CONFIGS)
def test_a_bad_configuration_is_refused(told: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=said):
        read_in_situ_log(write(tmp_path, table(), toml(told)))


def test_a_set_that_the_file_does_not_list_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, table(), '[[sets]]\nname = "1"\n')
    with pytest.raises(LogError, match=r"leg\.csv, set '2': is not among the sets of the TOML file \('1'\)"):
        read_in_situ_log(path)


def test_files_that_are_no_tables_are_refused(tmp_path: Path) -> None:
    config = InSituConfig()
    for name, text, said in (
        ("empty.csv", "", r"empty\.csv: is empty"),
        (
            "ragged.csv",
            "a,b\n1,2\n3\n4,5\n",
            r"ragged\.csv: not a readable table \(CSV parse error: Expected 2 columns, got 1.*whole",
        ),
        (
            "semicolon.csv",
            "time_s:set\n1:2\n",
            "if the separator is none of ',', ';' and tab, say csv.separator",
        ),
        ("log.xlsx", "", "log.xlsx: a log ends in .parquet or .csv"),
        ("log.parquet", "no", "log.parquet: not a readable table"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(LogError, match=said):
            read_in_situ_log(tmp_path / name, config)
    with pytest.raises(LogError, match="no such file"):
        read_in_situ_log(tmp_path / "nothing.csv", config)
    with pytest.raises(LogError, match="No log was given"):
        read_in_situ_log([], config)


def test_one_set_in_two_files_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, table(), toml(sets=False))
    again = tmp_path / "again.csv"
    again.write_text(path.read_text())
    with pytest.raises(LogError, match=r"again\.csv: holds set '1', and so does leg\.csv"):
        read_in_situ_log([path, again])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", "it is a PNG picture"),
        (b"PAR1\x15\x04\x15", "it is a Parquet table, whose name must end in .parquet"),
        (b"PK\x03\x04\x14\x00", "it is a ZIP archive or a spreadsheet"),
        (b"\x1f\x8b\x08\x00", "it is a gzip archive"),
        (bytes(range(256)) * 9, "it holds bytes that no text has"),
    ],
)
def test_what_is_no_text_is_refused_by_name(content: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / "leg.csv"
    path.write_bytes(content)
    with pytest.raises(
        LogError, match=rf"leg\.csv: not a table of text: {said}.*; export the samples as CSV"
    ):
        read_in_situ_log(path)


def test_a_gyroscope_needs_time(tmp_path: Path) -> None:
    frame = spinning(table()).drop(columns="time_s")
    with pytest.raises(LogError, match=r"leg\.csv: a gyroscope without a column of time"):
        read_in_situ_log(write(tmp_path, frame, toml('[columns]\ntime = ""\n')))
    still = write(tmp_path, frame.drop(columns=SPIN), toml('[columns]\ntime = ""\n'))
    assert read_in_situ_log(still).sets[0].time is None
