"""What a log of in-situ sets must hold, what is said of one that lacks a little, and what is refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from surefoot.calibration import GRAVITY
from surefoot.experiments.force_torque.calibrate import SAMPLE
from surefoot.experiments.force_torque.config import AddedMass, InSituConfig, read_config
from surefoot.experiments.force_torque.icub import read_matrix, write_icub_matrix
from surefoot.experiments.force_torque.log import read_in_situ_log
from surefoot.experiments.logs.format import LogError

RAW = [f"raw_{i}_count" for i in range(6)]
FORCE = [f"specific_force_{axis}_m_s2" for axis in "xyz"]
SPIN = [f"angular_velocity_{axis}_rad_s" for axis in "xyz"]
ROWS = 40
RESPONSE = np.diag([20.0, 20.0, 10.0, 900.0, 900.0, 800.0])
SETS = {"1": (0.0, (0.0, 0.0, 0.0)), "2": (0.5, (0.1, 0.0, 0.3)), "3": (0.7, (-0.1, 0.1, 0.3))}


def table() -> pd.DataFrame:
    """Three sets of a leg of 4 kg that turns slowly, whose counts are exact, at 10 Hz."""
    parts = []
    for begun, (name, (mass, com)) in enumerate(SETS.items()):
        time = np.arange(ROWS) / 10.0
        pitch, roll = 0.6 * np.sin(0.5 * time), 0.5 * np.sin(0.9 * time)
        up = GRAVITY * np.stack(
            [np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)], axis=1
        )
        first = 4.0 * np.array([0.01, 0.0, 0.2]) + mass * np.asarray(com)
        wrench = np.concatenate([-(4.0 + mass) * up, -np.cross(first, up)], axis=1)
        frame = pd.DataFrame({"time_s": time + 100.0 * begun, "set": int(name)})
        frame[RAW] = wrench @ RESPONSE.T + 300.0
        frame[FORCE] = up
        parts.append(frame)
    return pd.concat(parts, ignore_index=True)


def toml(extra: str = "", sets: bool = True) -> str:
    """Name the added masses."""
    listed = [
        f'[[sets]]\nname = "{name}"\nadded_mass_kg = {mass}\nadded_com_m = {list(com)}\n'
        for name, (mass, com) in SETS.items()
    ]
    return extra + "\n" + "".join(listed if sets else [])


def write(folder: Path, frame: pd.DataFrame, told: str | None = None) -> Path:
    """Write a log with its TOML file."""
    path = folder / "leg.csv"
    frame.to_csv(path, index=False)
    path.with_suffix(".toml").write_text(toml() if told is None else told)
    return path


def spinning(frame: pd.DataFrame) -> pd.DataFrame:
    """Add the gyroscope that belongs to the turning of gravity (its part about gravity left at zero)."""
    frame = frame.copy()
    frame[SPIN] = 0.0
    for _, part in frame.groupby("set"):
        up = part[FORCE].to_numpy() / GRAVITY
        rate = np.gradient(up, 0.1, axis=0)
        # d up/dt = -w x up; the w without a part along up is up x d up/dt turned round.
        frame.loc[part.index, SPIN] = np.cross(rate, up)
    return frame


def test_the_sets_are_read_as_they_were_written(tmp_path: Path) -> None:
    frame = table()
    log = read_in_situ_log(write(tmp_path, frame))
    assert [data.name for data in log.sets] == ["1", "2", "3"]
    assert log.channels == tuple(RAW)
    for data, (mass, com) in zip(log.sets, SETS.values(), strict=True):
        rows = frame[frame["set"] == int(data.name)]
        np.testing.assert_array_equal(data.raw, rows[RAW])
        np.testing.assert_array_equal(data.gravity, -rows[FORCE].to_numpy())
        assert data.added_mass == mass
        np.testing.assert_array_equal(data.added_com, com)
        assert data.time is not None
        assert not data.moves


def test_parquet_csv_and_one_file_a_set_say_the_same(tmp_path: Path) -> None:
    frame = table()
    whole = read_in_situ_log(write(tmp_path, frame))
    parquet = tmp_path / "leg2.parquet"
    frame.to_parquet(parquet)
    paths = []
    for name, part in frame.groupby("set"):
        paths.append(tmp_path / f"{name}.csv")
        part.drop(columns="set").to_csv(paths[-1], index=False)
    config = read_config(tmp_path / "leg.toml")
    for other in (read_in_situ_log(parquet, config), read_in_situ_log(paths, config)):
        assert [data.name for data in other.sets] == [data.name for data in whole.sets]
        for one, two in zip(whole.sets, other.sets, strict=True):
            np.testing.assert_array_equal(one.raw, two.raw)
            np.testing.assert_array_equal(one.gravity, two.gravity)


def test_other_names_units_and_frames(tmp_path: Path) -> None:
    frame = spinning(table())
    whole = read_in_situ_log(write(tmp_path, frame))
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    other = pd.DataFrame({"t": 1e3 * frame["time_s"], "phase": frame["set"]})
    for i, name in enumerate(RAW):
        other[f"ch{i}"] = frame[name]
    # Vectors in the accelerometer's axes are R^T times those in the sensor's.
    other[["gx", "gy", "gz"]] = -frame[FORCE].to_numpy() @ turned / GRAVITY
    other[["wx", "wy", "wz"]] = np.degrees(frame[SPIN].to_numpy() @ turned)
    told = f"""
[columns]
time = "t"
set = "phase"
raw = ["ch0", "ch1", "ch2", "ch3", "ch4", "ch5"]
gravity = ["gx", "gy", "gz"]
angular_velocity = ["wx", "wy", "wz"]
[units]
time = "ms"
acceleration = "g"
angular_velocity = "deg/s"
[accelerometer]
R_sensor_accelerometer = {turned.tolist()}
"""
    path = tmp_path / "other.csv"
    other.to_csv(path, index=False)
    path.with_suffix(".toml").write_text(toml(told))
    for one, two in zip(whole.sets, read_in_situ_log(path).sets, strict=True):
        np.testing.assert_array_equal(one.raw, two.raw)
        np.testing.assert_allclose(two.gravity, one.gravity, atol=1e-9)
        assert two.angular_velocity is not None
        assert two.angular_acceleration is not None
        np.testing.assert_allclose(two.angular_velocity, one.angular_velocity, atol=1e-9)
        np.testing.assert_allclose(two.angular_acceleration, one.angular_acceleration, atol=1e-8)


def test_names_on_the_command_line_go_before_those_of_the_file(tmp_path: Path) -> None:
    frame = table().rename(columns={"time_s": "t", "set": "phase"})
    frame[["gx", "gy", "gz"]] = -frame[FORCE]
    path = write(tmp_path, frame, toml('[columns]\ntime = "nowhere"\n'))
    config = read_config(tmp_path / "leg.toml").override(
        time="t", set="phase", gravity=("gx", "gy", "gz"), raw=None
    )
    log = read_in_situ_log(path, config)
    np.testing.assert_array_equal(log.sets[0].gravity, frame.loc[:39, ["gx", "gy", "gz"]])
    with pytest.raises(LogError, match=r"the command line: gravity\.1: Field required"):
        config.override(gravity=("gx",))


def test_masses_may_stand_in_columns(tmp_path: Path) -> None:
    frame = table()
    masses = {int(name): given for name, given in SETS.items()}
    frame["added_mass_kg"] = [masses[number][0] for number in frame["set"]]
    for a, axis in enumerate("xyz"):
        frame[f"added_com_{axis}_m"] = [masses[number][1][a] for number in frame["set"]]
    log = read_in_situ_log(write(tmp_path, frame, toml(sets=False)))
    assert [data.added_mass for data in log.sets] == [mass for mass, _ in SETS.values()]
    np.testing.assert_array_equal(log.sets[2].added_com, SETS["3"][1])
    assert not any("counts as the bare limb" in notice for notice in log.notices)


def test_the_sample_reads_without_a_word() -> None:
    log = read_in_situ_log(SAMPLE)
    assert [data.name for data in log.sets] == [str(number) for number in range(1, 9)]
    assert all(data.moves and len(data.raw) == 600 for data in log.sets)
    assert log.notices == ()
    assert SAMPLE.stat().st_size + SAMPLE.with_suffix(".toml").stat().st_size < 400_000


# -- what is said but not refused -----------------------------------------------------------------


def test_gaps_and_missing_readings_are_left_out(tmp_path: Path) -> None:
    frame = table()
    frame.loc[5, RAW[2]] = np.nan
    frame.loc[50, FORCE[1]] = np.nan
    frame = frame.drop(index=range(20, 25))
    log = read_in_situ_log(write(tmp_path, frame))
    said = " ".join(log.notices)
    assert "set '1': column 'raw_2_count' holds no value in 1 of 35 rows (2.9 %)" in said
    assert "set '2': column 'specific_force_y_m_s2' holds no value in 1 of 40 rows (2.5 %)" in said
    assert "set '1': column 'time_s' leaps 1 times, the longest by 0.6 s where rows are 0.1 s apart" in said
    assert len(log.sets[0].raw) == 35
    assert np.isnan(log.sets[0].raw[5, 2])
    assert len(log.sets[1].raw) == 39


def test_rows_that_are_there_twice_are_dropped(tmp_path: Path) -> None:
    frame = table()
    twice = pd.concat([frame.iloc[:8], frame.iloc[7:]], ignore_index=True)
    log = read_in_situ_log(write(tmp_path, twice))
    np.testing.assert_array_equal(log.sets[0].raw, frame.loc[:39, RAW])
    assert any("set '1': 1 rows repeat the row before them" in notice for notice in log.notices)


def test_a_touch_of_the_end_of_the_range_is_left_out(tmp_path: Path) -> None:
    frame = pd.concat([table()] * 5, ignore_index=True)
    frame["set"] = 1
    frame["time_s"] = np.arange(len(frame)) / 10.0
    frame.loc[17, RAW[0]] = 32767
    told = '[sensor]\nrange_count = [-32768, 32767]\n[[sets]]\nname = "1"\n'
    log = read_in_situ_log(write(tmp_path, frame, told))
    assert np.isnan(log.sets[0].raw[17, 0])
    assert any(
        "column 'raw_0_count' touches the end of its range in 1 readings" in said for said in log.notices
    )


def test_a_log_whose_sign_nothing_can_check_says_so(tmp_path: Path) -> None:
    log = read_in_situ_log(write(tmp_path, table()))
    assert any("no factory matrix to check the accelerometer's sign with" in said for said in log.notices)


def test_a_matrix_in_other_axes_is_a_notice(tmp_path: Path) -> None:
    wrong = np.linalg.inv(RESPONSE)[[1, 2, 0, 3, 4, 5]]
    log = read_in_situ_log(write(tmp_path, table(), toml(f"[factory]\nmatrix = {wrong.tolist()}")))
    assert any("hardly agree" in notice for notice in log.notices)


def test_an_accelerometer_is_calibrated_on_request(tmp_path: Path) -> None:
    frame = table()
    truth = frame[FORCE].to_numpy()
    frame[FORCE] = truth + np.array([0.05, -0.08, 0.02])
    log = read_in_situ_log(write(tmp_path, frame, toml('[accelerometer]\ncalibrate = "bias"\n')))
    np.testing.assert_allclose(log.sets[0].gravity, -truth[:ROWS], atol=1e-6)
    assert any("its bias was (0.05, -0.08, 0.02) m/s^2" in notice for notice in log.notices)


def test_factory_matrices_are_read_from_files(tmp_path: Path) -> None:
    matrix = np.linalg.inv(RESPONSE)
    np.savetxt(tmp_path / "matrix.csv", matrix, delimiter=",")
    scale = [2000.0, 2000.0, 4000.0, 40.0, 40.0, 50.0]
    write_icub_matrix(matrix, scale, tmp_path / "SN1.txt")
    for name, atol in (("matrix.csv", 0.0), ("SN1.txt", 4000.0 / 2**16 / 32767)):
        told = tmp_path / f"{name}.toml"
        told.write_text(f'[factory]\nfile = "{name}"\n')
        config = read_config(told)
        assert config.factory.matrix is not None
        np.testing.assert_allclose(config.factory.matrix, matrix, rtol=1e-15, atol=atol)
    assert config.sensor.full_scale is not None
    assert config.sensor.full_scale.tolist() == scale


# -- what is refused --------------------------------------------------------------------------------


def _scaled(columns: list[str], factor: float) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def change(frame: pd.DataFrame) -> pd.DataFrame:
        frame[columns] = factor * frame[columns]
        return frame

    return change


def _cell(row: int, column: str, value: Any) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def change(frame: pd.DataFrame) -> pd.DataFrame:
        if isinstance(value, str):
            frame[column] = frame[column].astype(object)
        frame.loc[row, column] = value
        return frame

    return change


def _column(column: str, value: Any) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda frame: frame.assign(**{column: value})


def _set_rows(column: str, values: Any, number: int = 2) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def change(frame: pd.DataFrame) -> pd.DataFrame:
        frame.loc[frame["set"] == number, column] = values
        return frame

    return change


def _saturated(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[60:63, RAW[4]] = 32767.0
    return frame


def _repeated(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[7, "time_s"] = frame.loc[6, "time_s"]
    return frame


BAD_TABLES: dict[str, tuple[Callable[[pd.DataFrame], pd.DataFrame], str]] = {
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
    "text": (_cell(3, RAW[1], "1.5.2"), "column 'raw_1_count' holds '1.5.2' at row 3, which is no number"),
    "infinite": (_cell(4, FORCE[0], np.inf), "column 'specific_force_x_m_s2' is infinite at row 4"),
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
        _saturated,
        "set '2': column 'raw_4_count' stands at 32767, the end of its range, in 10 % of its readings",
    ),
    "in g": (
        _scaled(FORCE, 1.0 / GRAVITY),
        r"set '1': .* median length of 1 m/s\^2.*units.acceleration = 'g'",
    ),
    "in milli-g": (_scaled(FORCE, 1e3 / GRAVITY), "units.acceleration = 'mg'"),
    "in mm/s^2": (_scaled(FORCE, 1e3), r"it looks like mm/s\^2"),
    "no known unit": (_scaled(FORCE, 0.3), r"give m/s\^2 with gravity in it"),
    "time goes back": (
        _cell(9, "time_s", 0.05),
        r"set '1': column 'time_s' goes back at row 9 \(0.8 s, then",
    ),
    "two values at once": (
        _repeated,
        "set '1': column 'time_s' is 0.6 s at rows 6 and 7, which differ",
    ),
    "set without a name": (_cell(3, "set", np.nan), "column 'set' is empty at row 3"),
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


@pytest.mark.parametrize("name", BAD_TABLES)
def test_a_bad_table_is_refused(name: str, tmp_path: Path) -> None:
    change, said = BAD_TABLES[name]
    with pytest.raises(LogError, match=said):
        read_in_situ_log(write(tmp_path, change(table())))


BAD_SPINS = {
    "in deg/s": (57.29578, "say 57 times the rate at which gravity turns; they look like deg/s"),
    "turned round": (-1.0, "turn gravity the wrong way round"),
    "in other units": (10.0, "say 10 times the rate at which gravity turns; give rad/s"),
}


@pytest.mark.parametrize("name", BAD_SPINS)
def test_a_gyroscope_that_contradicts_gravity_is_refused(name: str, tmp_path: Path) -> None:
    factor, said = BAD_SPINS[name]
    path = write(tmp_path, _scaled(SPIN, factor)(spinning(table())))
    with pytest.raises(LogError, match=said):
        read_in_situ_log(path)


def test_milliseconds_are_recognised_beside_a_gyroscope(tmp_path: Path) -> None:
    path = write(tmp_path, _scaled(["time_s"], 1e3)(spinning(table())))
    with pytest.raises(LogError, match=r"column 'time_s' steps by 100 s.* say units.time = 'ms'"):
        read_in_situ_log(path)


def test_a_sign_that_the_factory_matrix_contradicts_is_refused(tmp_path: Path) -> None:
    matrix = np.linalg.inv(RESPONSE)
    path = write(tmp_path, _scaled(FORCE, -1.0)(table()), toml(f"[factory]\nmatrix = {matrix.tolist()}"))
    with pytest.raises(
        LogError, match=r"pulls against gravity \(correlation -1.00\).*under columns\.gravity"
    ):
        read_in_situ_log(path)


BAD_CONFIGS = {
    "no TOML": ("[columns\n", r"leg\.toml: not TOML"),
    "unknown table": ("[colums]\n", r"leg\.toml: unknown key 'colums'; there are columns, units, csv"),
    "unknown key": (
        '[columns]\nrw = ["a"]\n',
        "columns: unknown key 'rw'; there are time, set, raw",
    ),
    "units that are no table": ("units = 3\n", "units: Input should be a valid dictionary"),
    "unknown unit": (
        '[units]\nacceleration = "ft"\n',
        r"units.acceleration: Input should be 'm/s\^2', 'g' or 'mg', got 'ft'",
    ),
    "not three": (
        '[columns]\ngravity = ["a"]\n',
        "columns.gravity.1: Field required",
    ),
    "not three turns": (
        '[columns]\nangular_velocity = ["a"]\n',
        "columns.angular_velocity.1: Field required",
    ),
    "five channels": (f"[columns]\nraw = {RAW[:5]}\n", "columns.raw: Tuple should have at least 6 items"),
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
    "a set with two masses": (
        '[[sets]]\nname = "1"\nadded_mass_kg = 0.2\nadded_com_m = [0, 0, 0]\n',
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
    "a nameless set": ("[[sets]]\nadded_mass_kg = 0.5\n", "sets.0.name: Field required"),
    "other channels": (
        f"[factory]\nmatrix = {np.ones((6, 7)).tolist()}\n",
        r"has 6 channels and the factory matrix 7 columns",
    ),
}


@pytest.mark.parametrize("name", BAD_CONFIGS)
def test_a_bad_configuration_is_refused(name: str, tmp_path: Path) -> None:
    told, said = BAD_CONFIGS[name]
    with pytest.raises(LogError, match=said):
        read_in_situ_log(write(tmp_path, table(), toml(told)))


def test_a_set_that_the_file_does_not_list_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, table(), '[[sets]]\nname = "1"\n')
    with pytest.raises(LogError, match=r"leg\.csv, set '2': is not among the sets of the TOML file \('1'\)"):
        read_in_situ_log(path)


def test_files_that_are_no_tables_are_refused(tmp_path: Path) -> None:
    config = InSituConfig()
    for name, text, said in (
        ("empty.csv", "", r"empty\.csv: not a readable table \(Empty CSV file\)"),
        (
            "ragged.csv",
            "a,b\n1,2\n3\n",
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


@pytest.mark.parametrize("told", ["", '[csv]\nseparator = ";"\ndecimal = ","\n'], ids=["seen", "told"])
def test_decimal_commas_are_read(tmp_path: Path, told: str) -> None:
    frame = table()
    path = tmp_path / "leg.csv"
    frame.to_csv(path, index=False, sep=";", decimal=",")
    path.with_suffix(".toml").write_text(toml(told))
    np.testing.assert_array_equal(read_in_situ_log(path).sets[0].raw, frame.loc[:39, RAW])


@pytest.mark.parametrize("encoding", ["latin-1", "cp1252", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), (";", "."), ("\t", ",")])
def test_tables_of_other_offices_are_read(
    encoding: str, separator: str, decimal: str, tmp_path: Path
) -> None:
    """Headers and names with umlauts, in what spreadsheets save."""
    frame = table().assign(Größe="ä; µ, 1")
    frame["set"] = "Würfel " + frame["set"].astype(str)
    path = tmp_path / "leg.csv"
    frame.to_csv(path, index=False, sep=separator, decimal=decimal, encoding=encoding)
    log = read_in_situ_log(path)
    assert [data.name for data in log.sets] == ["Würfel 1", "Würfel 2", "Würfel 3"]
    np.testing.assert_array_equal(log.sets[0].raw, frame.loc[:39, RAW])


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


def test_a_file_of_settings_may_have_a_mark_of_its_encoding(tmp_path: Path) -> None:
    path = write(tmp_path, table())
    path.with_suffix(".toml").write_text(toml(), encoding="utf-8-sig")
    assert len(read_in_situ_log(path).sets) == 3
    path.with_suffix(".toml").write_text("# größer\n" + toml(), encoding="latin-1")
    with pytest.raises(LogError, match=r"leg\.toml: not a text in UTF-8 .*; save it as UTF-8"):
        read_in_situ_log(path)


def test_a_matrix_with_decimal_commas_is_read(tmp_path: Path) -> None:
    matrix = np.linalg.inv(RESPONSE) * 1.5
    for text in (
        "\n".join(";".join(f"{value:.9f}".replace(".", ",") for value in row) for row in matrix),
        "\n".join(" ".join(f"{value:.9f}".replace(".", ",") for value in row) for row in matrix),
        "\n".join(", ".join(f"{value:.9f}" for value in row) for row in matrix),
        "\n".join(",".join(f"{value:.9f}" for value in row) for row in matrix),
    ):
        (tmp_path / "m.txt").write_text(text)
        found, _ = read_matrix(tmp_path / "m.txt")
        np.testing.assert_allclose(found, matrix, atol=1e-9)


def test_the_documentation_knows_every_key() -> None:
    page = Path(__file__).parents[2] / "docs" / "in-situ-log.md"
    if not page.is_file():
        pytest.skip("the documentation is not part of the package")
    text = page.read_text()
    for name, table in InSituConfig():
        assert f"[{name}]" in text
        for key in type(table or AddedMass(name="")).model_fields:
            assert f"\n{key} = " in text or f"or {key} = " in text or f"or: {key} = " in text, f"{name}.{key}"


def test_rows_between_close_gaps_tell_no_angular_acceleration(tmp_path: Path) -> None:
    frame = spinning(table()).drop(index=[10, 11, 12, 16, 17, 18])
    log = read_in_situ_log(write(tmp_path, frame))
    # Rows 13 to 15 are three, and the derivative needs seven.
    assert len(log.sets[0].raw) == 31
    assert log.sets[0].moves
    assert any("set '1': 3 rows stand between gaps too close together" in said for said in log.notices)


def test_rows_that_all_stand_between_gaps_need_no_gyroscope(tmp_path: Path) -> None:
    """Poses held one by one, three rows each: no rate can be taken, so that the limb must have rested."""
    frame = spinning(table())
    frame = frame[frame.index % 10 < 3]
    path = write(tmp_path, frame)
    with pytest.raises(LogError, match=r"set '1': all 12 rows .*say columns.angular_velocity = \"\""):
        read_in_situ_log(path)
    path.with_suffix(".toml").write_text(toml('[columns]\nangular_velocity = ""\n'))
    assert [(data.moves, len(data.raw)) for data in read_in_situ_log(path).sets] == 3 * [(False, 12)]


def test_a_gyroscope_needs_time(tmp_path: Path) -> None:
    frame = spinning(table()).drop(columns="time_s")
    with pytest.raises(LogError, match=r"leg\.csv: a gyroscope without a column of time"):
        read_in_situ_log(write(tmp_path, frame, toml('[columns]\ntime = ""\n')))
    still = write(tmp_path, frame.drop(columns=SPIN), toml('[columns]\ntime = ""\n'))
    assert read_in_situ_log(still).sets[0].time is None


def test_the_imu_is_carried_to_the_sensor(tmp_path: Path) -> None:
    """With the IMU at p the sensor's g - a differs by alpha x p + w x (w x p)."""
    frame, place = spinning(table()), np.array([0.2, 0.0, 0.4])
    near = read_in_situ_log(write(tmp_path, frame)).sets[0]
    told = toml(f"[accelerometer]\nposition_m = {place.tolist()}\n")
    far = read_in_situ_log(write(tmp_path, frame, told)).sets[0]
    assert near.angular_velocity is not None
    assert near.angular_acceleration is not None
    w = near.angular_velocity
    carried = np.cross(near.angular_acceleration, place) + np.cross(w, np.cross(w, place))
    assert np.abs(carried).max() > 0.05
    np.testing.assert_allclose(far.gravity - near.gravity, carried, atol=1e-12)
