"""Logs of joints and IMU: the references made of them are those of the robot's own beliefs."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from _logs import redescribe, refusal_of, run, write_motion
from scipy.interpolate import CubicSpline

import surefoot  # noqa: F401  (registers the environments)
from surefoot.calibration import GRAVITY, Reference
from surefoot.experiments.logs.bag import Bag, Series
from surefoot.experiments.logs.contacts import GUESSED, guess_contacts
from surefoot.experiments.logs.format import read_log
from surefoot.experiments.logs.motion import ACCELEROMETER, GYROSCOPE, count_rows, means_since
from surefoot.experiments.walking.judge import judge_log
from surefoot.experiments.walks.replay import starting_map


@pytest.fixture(scope="module")
def recorded(recorded_walk: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("motion") / "walk.csv"
    recorded_walk.path = write_motion(
        recorded_walk.log, recorded_walk.motion, path, recorded_walk.description
    )
    return recorded_walk


@pytest.mark.parametrize("joint", ["RHipRoll", pytest.param("LAnklePitch", marks=pytest.mark.slow)])
def test_a_joint_of_the_wrong_sign_is_named(recorded: Any, tmp_path: Path, joint: str) -> None:
    name = f"joint_{joint}_rad"
    motion = recorded.motion.assign(**{name: -recorded.motion[name]})
    log = read_log(write_motion(recorded.log, motion, tmp_path / "walk.csv", recorded.description))
    assert not {"HeadYaw", "LElbowRoll"} & set(log.turned)
    found = judge_log(log, starting_map(log)).findings[0]
    assert (found.name, found.refuses) == ("joint sign", True)
    assert f"the joint '{joint}' has the other sign" in found.reason
    assert found.cure == f"Turn the sign of column '{name}' round."


def test_momentum_is_what_the_robot_had(recorded: Any) -> None:
    """Of points between the cells, where the robot knows the edges of its soles."""
    log, own = read_log(recorded.path), recorded.momentum
    n, late = len(log) - recorded.lag, slice(160, None)
    assert log.momentum is not None
    relative = [one.com - one.position_sole.mean(axis=1) for one in (log.momentum, own)]
    for made, had, most in (
        (log.momentum.com_velocity, own.com_velocity, 0.01),
        (log.momentum.angular_momentum, own.angular_momentum, 0.01),
        (relative[0], relative[1], 2e-3),
    ):
        difference = (made[:n] - had[recorded.lag :])[late]
        assert np.sqrt(np.mean((difference - difference.mean(axis=0)) ** 2)) < most


@pytest.mark.slow
def test_references_are_those_that_the_robot_had(recorded: Any) -> None:
    """Up to the clock of the telemetry, which a robot averages over the past alone."""
    log = read_log(recorded.path)
    n = len(log) - recorded.lag
    assert log.lag == 0
    assert log.about["contacts"] == GUESSED
    for field, tolerance in {
        "com": 5e-5,
        "position_sole": 5e-5,
        "R_level_sole": 1e-4,
        "com_acceleration": 0.03,
        "angular_momentum_rate": 0.03,
        "accelerometer": 0.01,
        "gyroscope": 0.002,
    }.items():
        made = np.asarray(getattr(log.reference, field))[:n][80:]
        own = np.asarray(getattr(recorded.own, field))[recorded.lag :][80:]
        difference = np.sqrt(np.mean((made - own) ** 2))
        assert difference < tolerance, field
        assert difference < 0.15 * np.std(own - own.mean(axis=0)), field


def test_guessed_contacts_are_true_and_neither_all_nor_nothing(recorded: Any) -> None:
    log = read_log(recorded.path)
    load = recorded.force.reshape(-1, 2, 4).sum(axis=-1)
    stance, swing = log.reference.stance, log.reference.swing
    assert not (stance & swing).any()
    assert (swing.mean(axis=0) > 0.03).all()
    assert (stance.mean(axis=0) > 0.3).all()
    assert np.abs(load[swing]).max() < 0.5
    assert (load[stance] > 0.5).mean() > 0.99


def test_commanded_contacts_come_before_a_guess_and_those_of_the_log_before_them(
    recorded: Any, tmp_path: Path
) -> None:
    path = write_motion(recorded.log, recorded.motion, tmp_path / "walk.csv", recorded.description)
    table = pd.read_csv(path)
    down = np.ones(len(table), dtype=int)
    down[100:120] = 0
    commanded = table.assign(command_left_contact=down, command_right_contact=1)
    commanded.to_csv(path, index=False)
    log = read_log(path)
    assert log.about["contacts"] == "as the log says was commanded"
    expected = np.zeros(len(table), dtype=bool)
    expected[104:116] = True
    np.testing.assert_array_equal(log.reference.swing[:, 0], expected)
    assert not log.reference.swing[:, 1].any()
    assert log.reference.stance[:, 1].all()
    commanded.drop(columns="command_right_contact").to_csv(path, index=False)
    assert refusal_of(path) == (
        "walk.csv: column command_left_contact is there without command_right_contact; "
        "give contacts of both feet or none."
    )
    given = {f"reference_{foot}_{phase}": 0 for foot in ("left", "right") for phase in ("stance", "swing")}
    commanded.assign(**given).to_csv(path, index=False)
    log = read_log(path)
    assert log.about["contacts"] == "as the log says"
    assert not log.reference.stance.any()


def test_joints_in_the_rows_of_the_log_and_lost_rows(recorded: Any, tmp_path: Path) -> None:
    """At the rate of the feet, in one table: a few lost rows are filled in, over many nothing is known."""
    log, motion = recorded.log, recorded.motion
    columns = {"time_s": log.time}
    for name in motion.columns[1:]:
        measured = motion["time_s"].rolling(65, center=True, min_periods=1).mean() - 0.020
        columns[name] = np.interp(log.time, measured, motion[name])
    table = pd.DataFrame(columns)
    table.loc[200:211, "joint_LKneePitch_rad"] = np.nan
    table.loc[230:233, "joint_LKneePitch_rad"] = np.nan
    description = recorded.description | {"delay_s": 0.0, "dt_s": log.dt, "averaged": False}
    path = write_motion(log, table, tmp_path / "walk.csv", description)
    redescribe(path, motion=description)
    pd.concat([pd.read_csv(path), table.drop(columns="time_s")], axis=1).to_csv(path, index=False)
    made = read_log(path).reference
    unknown = np.flatnonzero(np.isnan(made.com[:, 0]))
    assert {200, 206, 211} <= set(unknown.tolist())
    assert not {229, 231, 234} & set(unknown.tolist())
    assert len(unknown) < 30
    assert not (made.stance | made.swing)[unknown].any()
    whole = read_log(recorded.path).reference
    difference = (made.com - whole.com)[250:600]
    assert np.sqrt(np.mean(difference**2)) < 5e-4, "the tilt is found again after the long gap"


@pytest.mark.slow
def test_the_command_calibrates_it(recorded: Any, tmp_path: Path) -> None:
    run("calibrate", "walk", recorded.path, "--method", "tare", "--out", tmp_path)
    walk = pd.read_parquet(tmp_path / "walk.tare.parquet")
    swing = read_log(recorded.path).reference.swing
    after = np.flatnonzero((np.cumsum(swing, axis=0) > 20).all(axis=1))
    assert len(after) > 40
    for i, foot in enumerate(("left", "right")):
        aloft = after[swing[after, i]]
        assert np.abs(walk[f"vgrf_{foot}_N"].to_numpy()[aloft]).mean() < 0.5
    page = (tmp_path / "walk.tare.html").read_text()
    assert GUESSED in page
    assert "nao.xml" in page


@pytest.mark.parametrize("seed", range(8))
def test_lost_rows_are_counted_however_close(seed: int) -> None:
    """Rows come every 10 ms and later than that by 1 ms on average; 3 % are lost, some side by side."""
    rng = np.random.default_rng(seed)
    there = rng.random(2000) < 0.97
    there[[600, 601, 603, 610]] = False
    there[590:600] = there[611:630] = True
    number = np.flatnonzero(there)
    counted = count_rows(0.01 * number + rng.exponential(0.001, len(number)), 0.01)
    # Of some sixty losses one or two may be miscounted; they do not add up to more.
    off = (counted - counted[0]) - (number - number[0])
    assert np.abs(off).max() <= 3


def _soles(height: np.ndarray, along: np.ndarray) -> Reference:
    n = len(height)
    position = np.zeros((n, 2, 3))
    position[:, 0, 2], position[:, 0, 0] = height, along
    position[:, :, 1] = 0.05, -0.05
    zero, eye = np.zeros((n, 3)), np.tile(np.eye(3), (n, 2, 1, 1))
    nothing = np.zeros((n, 2), dtype=bool)
    return Reference(zero, zero, zero, position, eye, nothing, nothing, zero, zero)


def test_a_step_is_guessed_and_its_ends_are_left_open() -> None:
    """The left foot steps from 1 to 2 s, 2 cm high and 10 cm far."""
    time = np.arange(240) / 80.0
    phase = np.clip(time - 1.0, 0.0, 1.0)
    smooth = phase**3 * (10 - 15 * phase + 6 * phase**2)
    stance, swing = guess_contacts(_soles(0.02 * np.sin(np.pi * phase) ** 2, 0.1 * smooth), 1 / 80)
    moves = (time > 1.1) & (time < 1.9)
    assert swing[(time > 1.4) & (time < 1.6), 0].all()
    assert not swing[(time < 1.0) | (time > 2.0), 0].any()
    assert not stance[moves, 0].any()
    assert stance[(time < 0.9) | (time > 2.15)].all()
    assert stance[(time > 1.45) & (time < 1.55), 1].all()
    assert not swing[:, 1].any()


def test_a_foot_that_is_held_up_may_stand_on_a_stair() -> None:
    stance, swing = guess_contacts(_soles(np.full(160, 0.05), np.zeros(160)), 1 / 80)
    assert not swing.any()
    assert not stance[:, 0].any()


def test_a_robot_that_falls_stands_on_nothing() -> None:
    reference = _soles(np.zeros(160), np.zeros(160))
    fall = np.zeros((160, 3))
    fall[:, 2] = -GRAVITY
    assert not guess_contacts(reference._replace(com_acceleration=fall), 1 / 80)[0].any()
    assert guess_contacts(reference, 1 / 80)[0].all()


def test_rounded_angles_of_a_fast_link_do_not_drown_accelerations(recorded: Any, tmp_path: Path) -> None:
    """At 500 rows a second and 12 bits, second differences of single rows are noise of 50 m/s^2."""
    motion, described = recorded.motion, recorded.description
    first, *_, last = motion["time_s"]
    time = np.linspace(first, last, len(motion))
    fast = np.arange(time[0], time[-1], 0.002)
    table = pd.DataFrame({"time_s": fast})
    for name in motion.columns[1:]:
        made = CubicSpline(time, motion[name])(fast)
        step = 2.0 * np.pi / 4096 if name.startswith("joint_") else 1e-3
        table[name] = np.round(made / step) * step
    path = write_motion(recorded.log, table, tmp_path / "walk.csv", described | {"dt_s": 0.002})
    made, slow = (read_log(one).reference.com_acceleration[100:500] for one in (path, recorded.path))
    assert np.sqrt(np.mean((made - slow) ** 2)) < 0.5 * np.std(slow)


@pytest.mark.parametrize("averaged", [True, False])
def test_an_imu_with_rows_of_its_own_is_averaged_between_those_of_the_joints(averaged: bool) -> None:
    """A vibration at the rate of the joints does not alias, and what was lost is filled in."""
    rng = np.random.default_rng(5)
    fast, rows = 0.0021 + np.arange(1500) / 500.0, 0.1 + np.arange(280) / 100.0
    slow = np.sin(3.0 * fast)
    values = slow + 2.0 * np.cos(2.0 * np.pi * 100.0 * (fast - 0.001))
    kept = np.sort(rng.permutation(1500)[:1470])
    found = means_since(fast[kept], values[kept], rows, averaged, 0.025)
    late = 0.005 + 0.001 * averaged  # the middle of the interval, and of each of the means
    assert np.sqrt(np.mean((found - np.sin(3.0 * (rows - late))) ** 2)) < 0.15
    picked = np.interp(rows, fast, values)
    assert np.sqrt(np.mean((picked - np.sin(3.0 * rows)) ** 2)) > 0.8


def test_an_imu_is_not_known_where_it_was_silent() -> None:
    fast, rows = np.arange(1000) / 500.0, np.arange(2, 100) / 50.0
    silent = (fast > 1.003) & (fast < 1.101)
    found = means_since(fast[~silent], fast[~silent], rows, False, 0.05)
    unknown = (rows > 1.003) & (rows - 0.02 < 1.101)
    np.testing.assert_array_equal(np.isnan(found), unknown)
    np.testing.assert_allclose(found[~unknown], rows[~unknown] - 0.01, atol=1e-6)


def test_a_lost_row_of_joints_costs_none_of_the_imu() -> None:
    fast, slow = np.arange(0.0, 3.0, 0.005), np.arange(0.1, 2.9, 0.01)
    kept = ~np.isin(np.arange(len(slow)), (40, 75, 120, 166, 230))
    imu = Series("imu.csv", fast, {name: np.sin(4.0 * fast) for name in (*ACCELEROMETER, *GYROSCOPE)})
    joints = Series("joints.csv", slow[kept], {"joint_knee_rad": np.cos(slow[kept])})
    table, averaged = Bag("feet.csv", (joints, imu), ()).motion(averaged=False)
    time = table.numbers("time_s")
    assert averaged
    assert len(time) == len(slow)
    felt = table.numbers(GYROSCOPE[1])
    np.testing.assert_allclose(felt, np.sin(4.0 * (time - 0.005)), atol=2e-3)
    np.testing.assert_allclose(table.numbers("joint_knee_rad"), np.cos(time), atol=2e-3)
