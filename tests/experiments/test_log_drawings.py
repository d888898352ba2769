"""A made robot by its drawing: references of joints and an IMU, and what is refused."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from _logs import Change, redescribe, refusal_of, scale_columns, write_motion

import surefoot  # noqa: F401  (registers the environments)
from surefoot.calibration import GRAVITY
from surefoot.experiments.logs.checks import LISTED
from surefoot.experiments.logs.format import Log, LogError, read_log

HINGES = """
  <body name="{side}_leg" pos="0 {y} -0.1">
    <joint name="{side}_hip" axis="0 1 0"/>
    <geom type="box" size="0.02 0.02 0.1" pos="0 0 -0.1" mass="1"/>
    <site name="{side}_sole" pos="0 0 -0.2"/>
  </body>"""
MJCF = (
    """<mujoco><worldbody><body name="base" pos="0 0 0.3">
  <site name="imu" pos="0.01 0 0.05" euler="0 0 90"/>
  <geom type="box" size="0.1 0.1 0.1" pos="0.01 0 0.1" mass="3"/>"""
    + HINGES.format(side="right", y=-0.05)
    + HINGES.format(side="left", y=0.05)
    + "</body></worldbody></mujoco>"
)
LINK = """
<link name="{side}_leg"><inertial><origin xyz="0 0 -0.1"/><mass value="1"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{side}_hip" type="revolute"><parent link="base"/><child link="{side}_leg"/><axis xyz="0 1 0"/>
  <origin xyz="0 {y} -0.1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<link name="{side}_sole"/><joint name="{side}_ankle" type="fixed"><parent link="{side}_leg"/>
  <child link="{side}_sole"/><origin xyz="0 0 -0.2"/></joint>"""
URDF = (
    """<robot name="r"><link name="base"><inertial><origin xyz="0.01 0 0.1"/><mass value="3"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><geometry><mesh filename="not_there.stl"/></geometry></visual></link>
<link name="imu"/><joint name="imu_fix" type="fixed"><parent link="base"/><child link="imu"/>
  <origin xyz="0.01 0 0.05" rpy="0 0 1.5707963267948966"/></joint>"""
    + LINK.format(side="right", y=-0.05)
    + LINK.format(side="left", y=0.05)
    + "</robot>"
)
STANDING = {"model": "robot.xml", "torso": "base", "imu": "imu", "soles": ["left_sole", "right_sole"]}


def standing(folder: Path, log: Log, model: str = "robot.xml", **changes: Any) -> Path:
    """A made robot that stands, leaning its torso forward by 0.1 rad over feet that stay level."""
    (folder / "robot.xml").write_text(MJCF)
    (folder / "robot.urdf").write_text(URDF)
    n = 120
    log = dataclasses.replace(log, truth=None, lag=0, mass=5.0)
    motion = pd.DataFrame({"time_s": 0.01 * np.arange(-20, n - 20)})
    for name in ("right_hip", "left_hip"):
        motion[f"joint_{name}_rad"] = -0.1
    # The IMU is turned a quarter to the left: its y axis points where the torso's -x axis does.
    felt = GRAVITY * np.array([0.0, np.sin(0.1), np.cos(0.1)])
    for i, axis in enumerate("xyz"):
        motion[f"accelerometer_{axis}_m_s2"] = felt[i]
        motion[f"gyroscope_{axis}_rad_s"] = 0.0
    description = STANDING | {"model": model, "dt_s": 0.01} | changes
    return write_motion(log, motion, folder / "walk.csv", description)


@pytest.mark.parametrize("model", ["robot.xml", "robot.urdf"])
def test_any_drawing_will_do(log: Log, tmp_path: Path, model: str) -> None:
    """MJCF and URDF, masses of shapes or given, the right leg first, a base without a joint, a turned IMU."""
    found = read_log(standing(tmp_path, log, model))
    reference = found.reference
    np.testing.assert_allclose(reference.position_sole[30], [(0, 0.05, 0), (0, -0.05, 0)], atol=2e-4)
    np.testing.assert_allclose(reference.R_level_sole[30], np.tile(np.eye(3), (2, 1, 1)), atol=5e-4)
    # Torso and legs about the hips: what leans is the torso alone.
    up = 3.0 * 0.2
    com = np.array([(3.0 * 0.01 * np.cos(0.1) + up * np.sin(0.1)) / 5.0, 0.0])
    np.testing.assert_allclose(reference.com[30, :2], com, atol=2e-4)
    np.testing.assert_allclose(reference.com_acceleration[30], 0.0, atol=5e-3)
    felt = GRAVITY * np.array([-np.sin(0.1), 0.0, np.cos(0.1)])
    np.testing.assert_allclose(reference.accelerometer[30], felt, atol=1e-9)
    assert reference.stance[10:50].all()
    assert not reference.swing.any()
    assert found.about["model_mass_kg"] == pytest.approx(5.0)


def test_a_mesh_is_missing_where_a_mass_needs_it(log: Log, tmp_path: Path) -> None:
    path = standing(tmp_path, log, "robot.urdf")
    first, _, rest = URDF.partition("<inertial>")
    massless = first + rest.partition("</inertial>")[2]
    (tmp_path / "robot.urdf").write_text(massless.replace("visual>", "collision>"))
    assert refusal_of(path) == (
        "walk.csv: the model 'robot.urdf' cannot be used: Error: Error opening file 'not_there.stl'; a link "
        "without a mass takes it from its mesh: put the file there, or give it its mass."
    )


BAD_MOTIONS: dict[str, tuple[dict[str, Any], str]] = {
    "no drawing": (
        {"model": "gone.xml"},
        "the description's motion.model '{folder}/gone.xml' is not there; give its path from the "
        "log's folder.",
    ),
    "no torso": (
        {"torso": "chest"},
        "the description's motion.torso 'chest' is not in the model; it has the bodies "
        "['base', 'right_leg', 'left_leg'].",
    ),
    "no site": (
        {"imu": "gyro"},
        "the description's motion.imu 'gyro' is not in the model; it has the sites "
        "['imu', 'right_sole', 'left_sole'] and the bodies ['base', 'right_leg', 'left_leg'].",
    ),
    "an IMU on a leg": (
        {"imu": "left_leg"},
        "the description's motion.imu 'left_leg' is not fixed to the torso 'base' but to 'left_leg'; name "
        "the body that carries the IMU as the torso.",
    ),
    "one sole": ({"soles": ["left_sole"]}, "the description: motion.soles.1: is missing, got ['left_sole']."),
    "an unknown key": (
        {"delay": 0.02},
        "the description: motion: unknown key 'delay'; there are model, torso, imu, soles, table, dt_s, "
        "delay_s, readings_age_s, averaged, held_rad.",
    ),
    "milliseconds": (
        {"delay_s": 20},
        "the description: motion.delay_s: Input should be less than 10, got 20.",
    ),
    "a delay in words": (
        {"delay_s": "short"},
        "the description: motion.delay_s: Input should be a valid number, got 'short'.",
    ),
    "no table": (
        {"table": "gone.csv"},
        "{folder}/gone.csv: no such file; motion.table gives its path from the log.",
    ),
    "another rate": (
        {"dt_s": 0.02},
        "walk.motion.csv: joints and IMU come every 0.01 s where the description says 0.02 s; give "
        "motion.dt_s, the time between two of their rows in seconds.",
    ),
    "an unknown joint is held": (
        {"held_rad": {"head": 0.0}},
        "walk.motion.csv: motion.held_rad names ['head']; the model's hinges are ['right_hip', 'left_hip'].",
    ),
}


@pytest.mark.parametrize(("change", "message"), BAD_MOTIONS.values(), ids=BAD_MOTIONS)
def test_a_bad_description_of_motion_is_refused(log: Log, tmp_path: Path, change: Any, message: str) -> None:
    path = standing(tmp_path, log, **change)
    message = message.format(folder=tmp_path) if "{folder}" in message else message
    named = message.startswith(("walk.", str(tmp_path)))
    assert refusal_of(path) == (message if named else f"walk.csv: {message}")


BAD_COLUMNS: dict[str, tuple[Change, str]] = {
    "no column": (
        lambda t: t.drop(columns="joint_left_hip_rad"),
        f"missing column joint_left_hip_rad; {LISTED} A joint without a column is held at an angle by "
        "motion.held_rad.",
    ),
    "never a number": (
        lambda t: t.assign(joint_left_hip_rad=np.nan),
        "column 'joint_left_hip_rad' holds no number in any of its 120 rows; log it, or hold the joint at an "
        "angle with motion.held_rad.",
    ),
    "never whole rows": (
        lambda t: t.assign(gyroscope_x_rad_s=np.where(t.index < 3, 0.0, np.nan)),
        "only 3 rows have all of joints and IMU, and 8 are needed; write all of them into the same rows.",
    ),
    "degrees": (
        scale_columns(["joint_left_hip_rad"], 180 / 0.1),
        "column 'joint_left_hip_rad' goes to 180, and no hinge turns by more than 6.6 rad; give radians, not "
        "degrees or ticks.",
    ),
    "accelerations in g": (
        scale_columns([f"accelerometer_{axis}_m_s2" for axis in "xyz"], 1 / GRAVITY),
        "columns 'accelerometer_x_m_s2' to '_z_m_s2' have a median length of 1, and a robot on the ground "
        "feels 9.81 m/s^2; give the specific force in m/s^2, gravity included.",
    ),
    "degrees per second": (
        lambda t: t.assign(gyroscope_z_rad_s=5.0),
        "columns 'gyroscope_x_rad_s' to '_z_rad_s' turn by 5 (rms) where the joints turn the torso by 0 "
        "rad/s over its soles; give rad/s, not degrees per second.",
    ),
    "out of order": (
        lambda t: t.iloc[[0, 2, 1, *range(3, 120)]],
        "column 'time_s' goes back at row 2 (-0.18 s, then -0.19 s); packets came late: sort the rows by "
        "their time.",
    ),
    "packets that do not count": (
        lambda t: t.assign(packet=1),
        "column 'packet' must hold whole numbers that increase; or leave it out.",
    ),
    "another clock": (
        lambda t: t.assign(time_s=t["time_s"] + 1e9),
        "joints and IMU reach from 999999999.8 to 1000000000.99 s, and the feet from 0 to 0.7375 s; give "
        "both on one clock, and motion.delay_s.",
    ),
}


@pytest.mark.parametrize(("change", "message"), BAD_COLUMNS.values(), ids=BAD_COLUMNS)
def test_a_bad_table_of_motion_is_refused(log: Log, tmp_path: Path, change: Any, message: str) -> None:
    path = standing(tmp_path, log)
    table = path.with_suffix(".motion.csv")
    change(pd.read_csv(table)).to_csv(table, index=False)
    assert refusal_of(path) == f"walk.motion.csv: {message}"


def test_a_held_joint_needs_no_column(log: Log, tmp_path: Path) -> None:
    path = standing(tmp_path, log, held_rad={"left_hip": -0.1})
    table = path.with_suffix(".motion.csv")
    pd.read_csv(table).drop(columns="joint_left_hip_rad").to_csv(table, index=False)
    held = read_log(path).reference
    np.testing.assert_allclose(held.com, read_log(standing(tmp_path, log)).reference.com, atol=1e-12)


def test_a_late_packet_is_not_a_lost_one(log: Log, tmp_path: Path) -> None:
    path = standing(tmp_path, log)
    table = path.with_suffix(".motion.csv")
    late = pd.read_csv(table)
    late.loc[60, "time_s"] += 0.009
    late.loc[61, "time_s"] = late.loc[60, "time_s"]
    late.to_csv(table, index=False)
    assert np.isfinite(read_log(path).reference.com).all()
    late.drop(index=[60, 61]).to_csv(table, index=False)
    assert np.isfinite(read_log(path).reference.com).all()  # a few lost rows are filled in
    late.drop(index=range(40, 60)).to_csv(table, index=False)
    assert np.isnan(read_log(path).reference.com[:, 0]).any()


def test_a_lag_beside_motion_is_refused(log: Log, tmp_path: Path) -> None:
    path = standing(tmp_path, log)
    redescribe(path, lag_samples=2)
    assert refusal_of(path) == (
        "walk.csv: the description: 'lag_samples' is 2 beside 'motion', whose references are made for the "
        "very moment of each row; leave it out, and give motion.readings_age_s for old readings of the feet "
        "or motion.delay_s for old joints and IMU, in seconds."
    )


def test_without_a_simulator_the_extra_is_named(
    log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = standing(tmp_path, log)
    monkeypatch.setitem(__import__("sys").modules, "surefoot.experiments.logs.model", None)
    assert 'install it with `pip install "surefoot[sim]"`, or give the reference' in refusal_of(path)


DRAWINGS = {
    "no XML": ("<mujoco><worldbody>", "the model 'robot.xml' cannot be used: XML parse error"),
    "a slider": (
        MJCF.replace('<joint name="left_hip" axis="0 1 0"/>', '<joint name="left_hip" type="slide"/>'),
        "the model 'robot.xml' cannot be used: A nominal model needs a robot that floats on one free joint",
    ),
    "a torso that hangs on another body": (
        MJCF.replace('<body name="base" pos="0 0 0.3">', '<body name="lift"><body name="base">').replace(
            "</body></worldbody>", "</body></body></worldbody>"
        ),
        "the model 'robot.xml' cannot be used: ",
    ),
}


@pytest.mark.parametrize(("drawing", "message"), DRAWINGS.values(), ids=DRAWINGS)
def test_a_drawing_that_is_no_robot_is_refused(log: Log, tmp_path: Path, drawing: str, message: str) -> None:
    path = standing(tmp_path, log)
    (tmp_path / "robot.xml").write_text(drawing)
    assert refusal_of(path).startswith(f"walk.csv: {message}")


def test_junk_in_joints_and_imu_is_refused_or_not_known(log: Log, tmp_path: Path) -> None:
    path = standing(tmp_path, log)
    side = path.with_suffix(".motion.csv")
    table = pd.read_csv(side)
    rng = np.random.default_rng(3)
    read, reasons = 0, []
    for _ in range(30):
        spoilt = table.copy()
        for _ in range(rng.integers(1, 4)):
            value = (np.nan, np.inf, 1e300, -1e300, 1e6, 0.0, -3.0)[rng.integers(7)]
            rows = slice(None) if rng.random() < 0.2 else rng.integers(len(table))
            spoilt.loc[rows, rng.choice(table.columns)] = value
        spoilt.to_csv(side, index=False)
        try:
            reference = read_log(path).reference
        except LogError as error:
            reasons.append(str(error))
            continue
        read += 1
        known = np.isfinite(reference.com).all(axis=1)
        assert known.any()
        assert not (reference.stance | reference.swing)[~known].any()
    assert read > 4
    assert all(reason.startswith("walk.motion.csv: ") for reason in reasons)


def test_a_plate_alone_has_no_joints(log: Log, tmp_path: Path) -> None:
    path = standing(tmp_path, log)
    layout = json.loads(path.with_suffix(".json").read_text())["layout"]
    one = {"scale_N_per_count": [1.0] * 4, "offset_N": [0.0] * 4}
    redescribe(path, layout=layout[:1], nominal=one)
    assert refusal_of(path) == (
        "walk.csv: motion needs the layout of two feet, got 1; give the reference columns of a single plate."
    )
