"""What a log of in-situ sets must hold, what is said of one that lacks a little, and what is refused."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from _in_situ_logs import FORCE, RAW, RESPONSE, ROWS, SETS, SPIN, spinning, table, toml, write

from surefoot.calibration import GRAVITY
from surefoot.experiments.force_torque.calibrate import SAMPLE
from surefoot.experiments.force_torque.config import AddedMass, InSituConfig, read_config
from surefoot.experiments.force_torque.icub import read_matrix, write_icub_matrix
from surefoot.experiments.force_torque.log import read_in_situ_log
from surefoot.experiments.logs.format import LogError


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
    with pytest.raises(LogError, match=r"the command line: gravity\.1: is missing"):
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


def test_gaps_and_missing_readings_are_left_out(tmp_path: Path) -> None:
    frame = table()
    frame.loc[5, RAW[2]] = np.nan
    frame.loc[50, FORCE[1]] = np.nan
    frame = frame.drop(index=range(20, 25))
    log = read_in_situ_log(write(tmp_path, frame))
    said = " ".join(log.notices)
    assert "set '1': column 'raw_2_count' holds no value in 1 of 35 rows (2.86 %)" in said
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


def test_equal_times_and_a_restart_of_the_logger_within_a_set(tmp_path: Path) -> None:
    frame = table()
    frame["time_s"] = np.where(frame.index < 25, frame["time_s"], frame["time_s"] - 2.45)
    frame.loc[7, "time_s"] = frame.loc[6, "time_s"]
    log = read_in_situ_log(write(tmp_path, frame))
    time = log.sets[0].time
    assert time is not None
    np.testing.assert_allclose(np.diff(time)[[6, 7, 24]], [0.1, 0.1, 1.0], atol=0.051)
    assert any(
        "set '1': column 'time_s' begins again at row 25 (2.4 s, then 0.05 s)" in one for one in log.notices
    )


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
    (said,) = log.notices
    assert "no factory matrix to check the accelerometer's sign with" in said
    assert said.endswith("The signs of the torques are those of the places as given.")
    moving = read_in_situ_log(write(tmp_path, spinning(table())))
    assert not any("signs of the torques" in said for said in moving.notices)


def test_a_fit_says_that_the_limb_is_not_of_its_given_mass(tmp_path: Path) -> None:
    """To whoever fits the log: `surefoot calibrate ft` and `surefoot check`."""
    log = read_in_situ_log(write(tmp_path, table(), toml("[limb]\nmass_kg = 5.0\n")))
    said = log.fit("exact counts").warnings[-1]
    assert "The limb comes out at 4 kg, and limb.mass_kg is 5 kg (-20.0 %)" in said


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
    for name, settings in InSituConfig():
        assert f"[{name}]" in text
        for key in type(settings or AddedMass(name="")).model_fields:
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
