"""Bags that cannot be read: one line that names the flaw and the cure."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from _logs import fails, run

from surefoot.experiments.logs.bag import read_bag
from surefoot.experiments.logs.format import LogError
from surefoot.names import page

pytest.importorskip("rosbags", reason="needs rosbags: pip install surefoot[ros]")
from _bags import COUNTS, Ros, Topic, one_format


def change(old: str, new: str) -> Callable[[Path], None]:
    def spoil(path: Path) -> None:
        mapping = path.with_suffix(".topics.toml")
        mapping.write_text(mapping.read_text().replace(old, new))

    return spoil


BAD_BAGS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "no such topic": (
        change("/imu", "/imu/data"),
        "{bag}: has no message of the topic '/imu/data', which walk.topics.toml names; there are "
        "'/feet/left', '/feet/right', '/imu', '/joint_states'.",
    ),
    "no such field": (
        change("linear_acceleration", "acceleration"),
        "{bag}: '/imu' holds sensor_msgs/msg/Imu, which has no field 'acceleration'; there are header, "
        "orientation, orientation_covariance, angular_velocity, angular_velocity_covariance, "
        "linear_acceleration, linear_acceleration_covariance.",
    ),
    "no number": (
        change("linear_acceleration.x", "orientation"),
        "{bag}: '/imu' holds sensor_msgs/msg/Imu, in which 'orientation' is no number; name one of "
        "its parts, or another topic.",
    ),
    "too few elements": (
        change("data.3", "data.4"),
        "{bag}: '/feet/left' holds no number under 'data.4' in any message.",
    ),
    "no such joint": (
        change("position.LHipRoll", "position.l_hip"),
        "{bag}: '/joint_states' holds no number under 'position.l_hip' in any message. Its names are LHipYaw",
    ),
    "a column twice": (
        change("gyroscope_x", "gyroscope_y"),
        "walk.topics.toml: column 'gyroscope_y_rad_s' is there twice; name each column once.",
    ),
    "no text": (
        change('"gyroscope_x_rad_s"', "1"),
        "walk.topics.toml: topics./imu: must be a table of fields, such as data.0 = "
        "'raw_left_front_left_count'.",
    ),
    "an offset of nothing": (
        change("# Proposed", '[offsets_s]\n"/odom" = 1.0\n# Proposed'),
        "walk.topics.toml: offsets_s names '/odom', which is not among the topics.",
    ),
    "two clocks that do not overlap": (
        change("# Proposed", '[offsets_s]\n"/imu" = 1000.0\n# Proposed'),
        "{bag}: no overlap in time: '/joint_states' from ",
    ),
    "joints and feet that do not overlap": (
        change("# Proposed", '[offsets_s]\n"/joint_states" = 100.0\n"/imu" = 96.3\n# Proposed'),
        "{bag}: joints and IMU reach from 100",
    ),
    "no TOML": (change("[topics", "{topics"), "walk.topics.toml: not TOML: "),
    "no mapping file": (
        lambda path: path.with_suffix(".topics.toml").unlink(),
        "{bag}: the mapping file walk.topics.toml is not there; --guess prints one to begin with, and "
        "--topics names another.",
    ),
    "no description": (
        lambda path: path.with_suffix(".json").unlink(),
        "{bag}: the description walk.json is not beside it; it holds layout, mass and calibrations; "
        f"{page('log-format')} shows one.",
    ),
    "no bag": (
        lambda path: path.unlink() if path.is_file() else shutil.rmtree(path),
        "{path}: no such file; 'surefoot demo' records logs under out/demo/logs.",
    ),
}


@one_format
@pytest.mark.parametrize(("spoil", "reason"), BAD_BAGS.values(), ids=BAD_BAGS)
def test_a_bad_bag_is_one_line(bag: Path, tmp_path: Path, spoil: Callable[[Path], Any], reason: str) -> None:
    for one in bag.parent.iterdir():
        (shutil.copytree if one.is_dir() else shutil.copy)(one, tmp_path / one.name)
    path = tmp_path / bag.name
    spoil(path)
    result = run("calibrate", "walk", path, "--method", "none", code=2)
    assert result.stderr.count("\n") == 1
    expected = "surefoot: " + reason.format(bag=bag.name, path=path)
    assert result.stderr[: len(expected)] == expected
    assert result.stderr[len(expected) :] == "\n" or not expected.endswith(".")


def test_a_bag_that_ends_in_the_middle(bag: Path, tmp_path: Path) -> None:
    path = tmp_path / bag.name
    (shutil.copytree if bag.is_dir() else shutil.copy)(bag, path)
    file = path if path.is_file() else next(one for one in path.iterdir() if one.suffix in (".mcap", ".db3"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    result = run("calibrate", "walk", path, code=2)
    assert result.stderr.startswith(f"surefoot: {path.name}: not a whole bag (")
    assert result.stderr.endswith(
        "); `ros2 bag reindex` or `rosbag reindex` mends a recording that was cut off, and `rosbags-convert "
        "--exclude-topic` leaves out what cannot be decoded.\n"
    )
    assert result.stderr.count("\n") == 1


def test_an_empty_bag_and_what_is_none(ros: Ros, tmp_path: Path) -> None:
    path = ros.write(tmp_path / "walk", [Topic("/feet", COUNTS, np.zeros(0), np.zeros((0, 8)))])
    for options in ([], ["--guess"]):
        fails(["calibrate", "walk", path, *options], f"{path.name}: the bag is empty: it holds no message.")
    (tmp_path / "walk.csv").write_text("time_s\n")
    words = ["calibrate", "walk", tmp_path / "walk.csv", "--guess"]
    fails(words, "walk.csv: no bag; one is a folder or ends in .bag, .mcap, .db3.")
    (tmp_path / "logs").mkdir()
    said = "logs: a folder without metadata.yaml is no bag of ROS 2; give a log."
    fails(["check", tmp_path / "logs"], said)


def test_without_rosbags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    with pytest.raises(LogError) as refused:
        read_bag(tmp_path / "walk.bag")
    assert str(refused.value) == (
        'walk.bag: bags are read by rosbags.highlevel, which is missing: pip install "surefoot[ros]".'
    )
