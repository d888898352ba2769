"""Files and values that would harm, as the command, studies and environments meet them."""

import json
import os
import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import surefoot.envs
from surefoot.calibration.in_situ import read_calibration
from surefoot.controllers import CalibrationMotion
from surefoot.controllers.policy import PolicyNetwork
from surefoot.envs.prelude import Prelude
from surefoot.experiments.evaluate import command
from surefoot.experiments.force_torque.config import read_config
from surefoot.experiments.logs.bag import _read_topics
from surefoot.experiments.logs.format import METADATA_KEY, read_log
from surefoot.experiments.study.store import JOURNAL, PLAN, Outcome, Store
from surefoot.files import LARGEST_TEXT, read_json, read_toml
from surefoot.wrappers import FootSensors, SelfCalibration

DEEP = "[" * 100_000 + "]" * 100_000
DEEP_TOML = f"a = {DEEP}"
BINARY = bytes(range(256)) * 4


def nested(path: Path) -> None:
    table = pa.table({"time_s": [0.0]}).replace_schema_metadata({METADATA_KEY: DEEP.encode()})
    pq.write_table(table, path)


def packed(path: Path) -> None:
    pq.write_table(pa.table({"time_s": np.zeros(2**20)}), path, compression="zstd")
    assert path.stat().st_size < 2**14


def text(content: str | bytes) -> Any:
    return lambda path: path.write_bytes(content if isinstance(content, bytes) else content.encode())


def large(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(LARGEST_TEXT + 1)


def read_plan(path):
    """Read what surefoot evaluate --config is given."""
    return command.load_config(path, path.parent, False)


MOTION = "time_s,target_knee_rad,stance_left_1,stance_right_1,swing_left_1,swing_right_1,rest_1"
FILES: dict[str, tuple[str, Any, Any, str]] = {
    "deep JSON in Parquet": (
        "walk.parquet", nested, read_log,
        "walk.parquet: the description: not JSON: it is nested more than 64 levels deep.",
    ),
    "some kilobytes of Parquet that unpack to far more": (
        "walk.parquet", packed, read_log,
        "walk.parquet: 1048576 rows of 1 columns unpack to more than 4194304 bytes; leave out columns",
    ),
    "Parquet that is text": ("walk.parquet", text("no"), read_log, "walk.parquet: not a readable table ("),
    "deep JSON": ("a.json", text(DEEP), read_json, "a.json: not JSON: it is nested more than 64 levels"),
    "just too deep": (
        "a.json", text("[" * 65 + "]" * 65), read_json, "a.json: not JSON: it is nested more than 64",
    ),
    "a number without end": ("a.json", text("9" * 5000), read_json, "a.json: not JSON: Exceeds the limit"),
    "JSON in Latin-1": ("a.json", text(b'"\xe9"'), read_json, "a.json: not a text in UTF-8 ("),
    "no end": ("a.json", large, read_json, "a.json: has 67108865 bytes; a text file has at most 67108864."),
    "deep TOML": ("a.toml", text(DEEP_TOML), read_toml, "a.toml: not TOML: it is nested more than 64 levels"),
    "binary TOML": ("a.toml", text(BINARY), read_toml, "a.toml: not a text in UTF-8 ("),
    "a deep plan": ("a.toml", text(DEEP_TOML), read_plan, "a.toml: not TOML: it is nested more than 64"),
    "no plan": ("a.toml", lambda path: None, read_plan, "a.toml: no such file."),
    "deep topics": (
        "a.toml", text(DEEP_TOML), lambda path: _read_topics(Path("walk.bag"), path),
        "a.toml: not TOML: it is nested more than 64 levels deep.",
    ),
    "deep settings": ("a.toml", text(DEEP_TOML), read_config, "a.toml: not TOML: it is nested more than 64"),
    "a deep calibration": (
        "ft.json", text(DEEP), read_calibration, "ft.json: is no surefoot-in-situ-calibration 2, ",
    ),
    "a binary prelude": ("a.csv", text(BINARY), Prelude.read, "a.csv: not a text in UTF-8 ("),
    "zeros for a prelude": ("a.csv", text(bytes(64)), Prelude.read, "a.csv"),
    "an empty prelude": (
        "a.csv", text(""), Prelude.read,
        "a.csv: not a table: it needs a line of column names; write it with surefoot calibrate motion.",
    ),
    "a prelude from a pipe": ("a.csv", os.mkfifo, Prelude.read, "a.csv' is a device, pipe or socket, not a "),
    "a prelude that is a folder": ("a.csv", os.mkdir, Prelude.read, "a.csv' is a folder, not a regular file"),
    "a binary motion": ("a.csv", text(BINARY), CalibrationMotion.read, "a.csv: not a text in UTF-8 ("),
    "another table": (
        "a.csv", text("a,b\n1,2\n"), CalibrationMotion.read,
        "a.csv lacks the columns ['time_s', 'rest_1', 'stance_left_1', 'stance_right_1', 'swing_left_1', ",
    ),
    "a torn motion": (
        "a.csv", text(f"{MOTION}\n0.1,0,1,1"), CalibrationMotion.read,
        "a.csv: line 2 has 4 cells for 7 columns; write it with surefoot calibrate motion.",
    ),
    "words in a motion": (
        "a.csv", text(f"{MOTION}\n0.1,left,1,1,0,0,1\n"), CalibrationMotion.read,
        "a.csv: could not convert string to float: ",
    ),
    "NaN in a motion": (
        "a.csv", text(f"{MOTION}\n0.1,nan,1,1,0,0,1\n"), CalibrationMotion.read,
        "a.csv: column 'target_knee_rad' is not finite in line 2; write it with surefoot calibrate motion.",
    ),
    "a motion without rows": ("a.csv", text(f"{MOTION}\n"), CalibrationMotion.read, "The last row of 'rest'"),
    "a column twice": (
        "a.csv", text(f"{MOTION},rest_1\n"), CalibrationMotion.read,
        "a.csv has a column twice; write it with surefoot calibrate motion.",
    ),
    "a policy that is a pipe": ("a.npz", os.mkfifo, PolicyNetwork.load, "a.npz' is a device, pipe or socket"),
}  # fmt: skip


@pytest.mark.parametrize("case", FILES)
def test_a_file_that_would_harm_is_refused(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A thousandth of what is refused: writing it takes as long as reading it would.
    monkeypatch.setattr("surefoot.experiments.logs.table._LARGEST", 2**22)
    name, write, read, message = FILES[case]
    write(tmp_path / name)
    there = (tmp_path / name).lstat() if case != "no plan" else None
    with pytest.raises(ValueError, match=re.escape(message)):
        read(tmp_path / name)
    if there is not None:
        after = (tmp_path / name).lstat()
        assert (after.st_ino, after.st_mode, after.st_mtime) == (there.st_ino, there.st_mode, there.st_mtime)


def test_lines_that_are_no_result_cost_their_cases(tmp_path: Path) -> None:
    kept = [Outcome(f"{i}", f"case {i}", "code", {"walks": [{"time": 0.1 * i}]}) for i in range(3)]
    store = Store(tmp_path)
    with store.open_for():
        for outcome in kept:
            store.add(outcome)
    lines = (tmp_path / JOURNAL).read_text().splitlines()
    old = json.dumps(json.loads(lines[2]) | {"digest": "of an earlier version"})
    (tmp_path / JOURNAL).write_text(
        "\n".join([lines[0], lines[1][1:], old, DEEP, '{"key": [1]}', "[]"]) + "\n"
    )
    store.read()
    assert list(store.outcomes) == ["0", "2"]
    assert store.damaged == 4
    (tmp_path / PLAN).write_text(DEEP)
    with pytest.raises(ValueError, match=r"is not a study's plan \(study\.json: not JSON: it is nested more"):
        store.open_for({"seeds": 1}).__enter__()


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_a_policy_is_saved_over_no_pipe_and_no_folder(make: Any, tmp_path: Path) -> None:
    weights, biases, matrix = [np.ones((1, 2))], [np.zeros(1)], np.ones((3, 1))
    how: dict[str, Any] = {"posture_speed": 1.0, "posture_memory": 1.0, "hold": 1, "dt": 0.01}
    policy = PolicyNetwork({"cop": 2}, weights, biases, posture_matrix=matrix, **how)
    make(tmp_path / "policy.npz")
    before = (tmp_path / "policy.npz").lstat()
    with pytest.raises(ValueError, match="not a regular file; give the path of a file"):
        policy.save(tmp_path / "policy.npz")
    after = (tmp_path / "policy.npz").lstat()
    assert (after.st_ino, after.st_mode) == (before.st_ino, before.st_mode)
    policy.save(tmp_path / "named as given")
    assert PolicyNetwork.load(tmp_path / "named as given").notes == policy.notes


@pytest.fixture(scope="module")
def robot() -> Any:
    robot = SelfCalibration(FootSensors(gym.make("surefoot/NaoStand-v0")))
    robot.reset(seed=0)
    for _ in range(3):
        robot.step(np.zeros(robot.action_space.shape))
    return robot


LEARNT = {
    "masses.mass": (np.nan, "'masses.mass' is nan at (0,), outside "),
    "masses.inertia": (-1.0, "'masses.inertia' is -1 at (0, 0), outside "),
    "masses.com": (1e6, "'masses.com' is 1e+06 at (0, 0), outside "),
    "initial.scale": (0.0, "'initial.scale' is 0 at (0,), outside "),
    "initial.offset": (np.inf, "'initial.offset' is inf at (0,), outside "),
    "state.published.mean": (1e30, "'state.published.mean' is 1e+30 at (0,), outside -20 to 20."),
    "state.belief.mean": (np.nan, "'state.belief.mean' is nan at (0, 0), outside -20 to 20."),
}
HARDWARE = {
    "telemetry.imu.bias": (np.nan, "'telemetry.imu.bias' is nan at (0,), outside "),
    "telemetry.encoders.0.error": (np.inf, "'telemetry.encoders.0.error' is inf at (0,), outside "),
    "cells.held": (1e30, "'cells.held' is 1e+30 at (0,), outside "),
}


@pytest.mark.parametrize("leaf", [*LEARNT, *HARDWARE])
def test_a_robot_goes_on_with_no_impossible_file(leaf: str, robot: Any, tmp_path: Path) -> None:
    who = robot if leaf in LEARNT else robot.env
    value, message = (LEARNT | HARDWARE)[leaf]
    path, before = tmp_path / "robot.npz", tmp_path / "before.npz"
    who.save(before)
    entries = dict(np.load(before))
    np.savez(path, **entries | {f"state.{leaf}": np.full_like(entries[f"state.{leaf}"], value)})
    with pytest.raises(ValueError, match=re.escape(message)):
        who.load(path)
    who.save(path)
    for name, entry in np.load(path).items():
        np.testing.assert_array_equal(entry, entries[name], err_msg=name)
    observation = robot.step(np.zeros(robot.action_space.shape))[0]
    assert all(np.isfinite(part).all() for part in observation.values())


WALK, STAND = surefoot.envs.NaoWalkEnv, surefoot.envs.NaoStandEnv
OPTIONS: dict[str, tuple[Any, dict[str, Any], str]] = {
    "no duration": (WALK, {"duration": None}, "'duration' must be finite, got None."),
    "a list of speeds": (WALK, {"speed": [1]}, "'speed' must be "),
    "one number of sway": (STAND, {"sway": 1.0}, "'sway' must be amplitudes (forward, left) of at most "),
    "no width": (STAND, {"width": None}, "'width' and 'height' must be positive and at most "),
    "a standard output": (
        STAND, {"prelude": True},
        "'prelude' must be a Prelude or the path of one: A path must be a str or a Path, got True of bool.",
    ),
    "no prelude there": (STAND, {"prelude": "gone.csv"}, "gone.csv: no such file."),
    "a program": (STAND, {"prelude": "/bin/sh"}, "sh: not a text in UTF-8 ("),
    "no severity": (FootSensors, {"severity": None}, "'severity' must be a number, got None of type"),
    "faults of none": (FootSensors, {"faults": 1}, "'faults' must be a sequence of faults or a mapping of "),
    "no view": (SelfCalibration, {"show": 5}, "'show' must name parts of "),
    "beliefs in words": (
        SelfCalibration, {"errors": "small"},
        "A BeliefErrors is made of a mapping of its fields, got ",
    ),
    "no method": (
        SelfCalibration, {"method": None},
        "'method' must be a name, such as 'moment', or its options, such as Moment(scale_std=0.2), got None",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("kind", "options", "message"), OPTIONS.values(), ids=OPTIONS)
def test_options_are_refused_at_the_door(kind: Any, options: Any, message: str, robot: Any) -> None:
    inner = {FootSensors: [robot.env.env], SelfCalibration: [robot.env]}.get(kind, [])
    with pytest.raises((TypeError, ValueError), match=re.escape(message)):
        kind(*inner, **options)
