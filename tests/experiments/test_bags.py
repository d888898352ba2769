"""ROS bags: what arrives jittered, late and by several clocks gives the calibration of the log."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from _logs import run

from surefoot.calibration import calibrate_in_situ, replay
from surefoot.experiments.force_torque.calibrate import SAMPLE
from surefoot.experiments.force_torque.log import read_in_situ_log
from surefoot.experiments.instrument.check import check_log
from surefoot.experiments.logs.bag import Series, read_bag
from surefoot.experiments.logs.format import Log, read_log, write_log
from surefoot.experiments.logs.guess import guess_topics
from surefoot.experiments.walking.calibrate import standard_deviations

pytest.importorskip("rosbags", reason="needs rosbags: pip install surefoot[ros]")
from _bags import COUNTS, IMU, JOINTS, WRENCH, Ros, Topic, describe, one_format

VECTORS = (("specific_force", "m_s2"), ("angular_velocity", "rad_s"))


@pytest.fixture(scope="module")
def learnt(recorded_walk: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, np.ndarray]:
    """What the log itself gives: scales and offsets, and how sure they are."""
    path = tmp_path_factory.mktemp("log") / "walk.csv"
    told = recorded_walk.description
    describe(path, recorded_walk, table="walk.motion.csv", delay_s=told["delay_s"], dt_s=told["dt_s"])
    write_log(recorded_walk.log, path.with_suffix(".parquet"))
    table = pd.read_parquet(path.with_suffix(".parquet"))
    table[[name for name in table if not name.startswith("reference_")]].to_csv(path, index=False)
    recorded_walk.motion.to_csv(path.with_suffix(".motion.csv"), index=False)
    return learn(read_log(path))


def learn(log: Log) -> tuple[np.ndarray, np.ndarray]:
    steps = np.diff(log.time, prepend=log.time[0] - log.dt)
    estimate = replay(
        log.layout, "moment", log.raw, log.reference, steps, mass=log.mass, initial=log.nominal, lag=log.lag
    )
    spread = standard_deviations(estimate, log.nominal)
    assert spread is not None
    return np.stack([estimate.scale[-1], estimate.offset[-1]]), np.stack(
        [spread.scale[-1], spread.offset[-1]]
    )


def test_the_calibration_is_that_of_the_log(bag: Path, learnt: tuple[np.ndarray, np.ndarray]) -> None:
    """Within its own uncertainty: the farthest of 16 parameters is 0.3 standard deviations off."""
    found, _ = learn(read_log(bag))
    sigmas = np.abs(found - learnt[0]) / learnt[1]
    assert sigmas.max() < 0.6
    assert np.sqrt(np.mean(sigmas**2)) < 0.3


def test_clocks_are_found(bag: Path, recorded_walk: Any) -> None:
    read = read_bag(bag)
    left = read.series[0]
    counts = np.stack([*left.columns.values()], axis=-1)
    raw = recorded_walk.log.raw[:, :4]
    which = [np.abs(raw - row).sum(axis=1).argmin() for row in counts]
    off = left.time - recorded_walk.log.time[which]
    assert np.abs(off - off.mean()).max() < 5e-4, "times of receipt lose their jitter"
    own, imu = (one.time for one in read.series[2:])
    assert np.quantile(np.abs(imu[:, None] - own).min(axis=1), 0.9) < 1e-3, "two clocks become one"
    told = read.notices
    assert len(told) == 4
    assert "no stamps, so times of receipt, whose jitter of 0.93 ms was averaged out." in told[0]
    assert "; its stamps as they are; they reach the recorder after 0." in told[2]
    assert "its stamps are of a clock 3.699" in told[3]
    assert "ahead of the recorder's" in told[3]


@one_format
@pytest.mark.parametrize("offset", [-3.7, -3.2])
def test_a_given_offset_goes_before_what_is_found(bag: Path, tmp_path: Path, offset: float) -> None:
    mapping = tmp_path / "mine.toml"
    text = bag.with_suffix(".topics.toml").read_text()
    mapping.write_text(f'{text}\n[offsets_s]\n"/imu" = {offset}\n')
    found, given = read_bag(bag), read_bag(bag, mapping)
    apart = np.median(given.series[3].time) - np.median(found.series[3].time)
    assert apart == pytest.approx(offset + 3.7, abs=1e-3)
    assert f"stamps and {offset} s, as offsets_s says" in given.notices[3]


@one_format
def test_the_command_reads_a_bag_and_writes_ros2_parameters(bag: Path, tmp_path: Path, no_page: None) -> None:
    result = run("calibrate", "walk", bag, "--method", "tare", "--ros2", "--out", tmp_path)
    assert f"Note: {bag.name}: '/imu': " in result.stdout
    told = json.loads((tmp_path / "walk.tare.json").read_text())
    assert told["notices"][3].startswith(f"{bag.name}: '/imu': ")
    node = yaml.safe_load((tmp_path / "walk.tare.ros2.yaml").read_text())["surefoot"]["ros__parameters"]
    assert node["scale_N_per_count"] == told["scale_N_per_count"]
    assert node["offset_N"] == told["offset_N"]
    assert node["channels"] == told["channels"]
    assert node["joints"][0] == "LHipYawPitch"
    assert set(node) >= {"robot", "moment", "model", "timing", "held_rad", "sole_frames"}


@one_format
def test_guess_prints_the_mapping_file(bag: Path) -> None:
    result = run("calibrate", "walk", bag, "--guess")
    assert result.stdout == bag.with_suffix(".topics.toml").read_text()
    assert (
        '[topics."/feet/right"]  # std_msgs/msg/Float64MultiArray\ndata.0 = "raw_right_front_left_count"'
        in (result.stdout)
    )
    assert 'position.LKneePitch = "joint_LKneePitch_rad"\n' in result.stdout
    assert 'linear_acceleration.z = "accelerometer_z_m_s2"\n' in result.stdout


def test_a_file_of_a_folder_is_a_bag_as_well(bag: Path, tmp_path: Path) -> None:
    """As robots without a ``metadata.yaml`` leave it."""
    if bag.is_file():
        pytest.skip("a bag of ROS 1 is a file anyway")
    file = next(one for one in bag.iterdir() if one.suffix in (".mcap", ".db3"))
    path = Path(shutil.copy(file, tmp_path / f"walk{file.suffix}"))
    found, whole = read_bag(path, bag.with_suffix(".topics.toml")), read_bag(bag)
    for one, other in zip(found.series, whole.series, strict=True):
        np.testing.assert_array_equal(one.time, other.time)


class TestTables:
    """How topics of several rates become rows."""

    ROWS = Series("/feet", np.arange(10) * 0.1, {"raw_a_count": np.arange(10.0)})

    def table(self, *series: Series) -> dict[str, np.ndarray]:
        from surefoot.experiments.logs.bag import Bag

        table = Bag("walk.bag", (self.ROWS, *series), ()).table()
        return {name: table.numbers(name) for name in table.names}

    def test_values_between_messages_lie_on_a_line_but_not_over_a_gap(self) -> None:
        time = np.delete(np.arange(21) * 0.05 - 0.02, [10, 11, 12])
        found = self.table(Series("/imu", time, {"gyroscope_x_rad_s": 3.0 * time}))
        np.testing.assert_allclose(found["gyroscope_x_rad_s"], 3.0 * found["time_s"], atol=1e-12)
        assert found["raw_a_count"].tolist() == [0, 1, 2, 3, 4, 7, 8, 9]

    def test_counts_are_never_made_up(self) -> None:
        time = np.delete(self.ROWS.time + 0.01, 4)
        found = self.table(Series("/right", time, {"raw_b_count": np.delete(np.arange(10.0), 4) + 0.25}))
        expected = np.arange(10.0) + 0.25
        expected[4] = np.nan
        np.testing.assert_array_equal(found["raw_b_count"], expected)

    def test_contacts_are_what_they_last_were(self) -> None:
        found = self.table(
            Series("/contact", np.array([0.05, 0.31]), {"command_left_contact": np.array([1.0, 0.0])})
        )
        assert found["raw_a_count"].tolist() == list(range(1, 10))
        assert found["command_left_contact"].tolist() == [1, 1, 1, 0, 0, 0, 0, 0, 0]

    def test_a_quaternion_keeps_its_length(self) -> None:
        time = np.arange(12) * 0.09
        q = np.where(np.arange(12) % 2 == 0, 1.0, -1.0)
        found = self.table(Series("/pose", time, {"reference_left_sole_qw": q}))
        assert set(np.abs(found["reference_left_sole_qw"])) == {1.0}

    def test_joints_of_two_messages_become_one_row(self, ros: Ros, tmp_path: Path) -> None:
        """A topic on which two drivers publish, each its own joints."""
        time = np.arange(50) * 0.02
        arms = Topic("/joint_states", JOINTS, time, np.c_[time, -time], ("a", "b"))
        legs = Topic("/joint_states", JOINTS, time + 0.01, 2.0 * time[:, None] + 0.02, ("c",))
        path = ros.write(tmp_path / "walk", [arms, legs], keep=1.0)
        assert guess_topics(path, walk=True).count("_rad") == 3
        mapping = path.with_suffix(".topics.toml")
        mapping.write_text('[topics."/joint_states"]\nposition = {a = "joint_a_rad", c = "joint_c_rad"}\n')
        table = read_bag(path).table()
        time_s = table.numbers("time_s")
        assert len(table) == 49
        assert np.median(np.diff(time_s)) == pytest.approx(0.02, abs=1e-3)
        first = time_s[0] - table.numbers("joint_a_rad")[0]
        np.testing.assert_allclose(table.numbers("joint_a_rad"), time_s - first, atol=2e-3)
        np.testing.assert_allclose(table.numbers("joint_c_rad"), 2.0 * (time_s - first), atol=4e-3)


def test_in_situ_sets_in_one_bag_give_the_calibration_of_the_log(tmp_path: Path) -> None:
    """Counts without stamps, an IMU whose clock is 12 s behind, and a topic that numbers the sets."""
    table = pd.read_parquet(SAMPLE)
    time = table["time_s"].to_numpy()
    begun = np.flatnonzero(table["set"].ne(table["set"].shift()))
    imu = [f"{name}_{axis}_{unit}" for name, unit in VECTORS for axis in "xyz"]
    topics = [
        Topic("/ft", COUNTS, time, table.filter(like="raw_").to_numpy()),
        Topic("/imu", IMU, time, table[imu].to_numpy(), ahead=-12.0),
        Topic(
            "/set", "std_msgs/msg/Int32", time[begun] - 0.05, table["set"].astype(int).to_numpy()[begun, None]
        ),
    ]
    path = Ros("mcap").write(tmp_path / "leg", topics, keep=1.0)
    mapping = guess_topics(path, walk=False)
    assert "# not used: /set (std_msgs/msg/Int32)\n" in mapping
    path.with_suffix(".topics.toml").write_text(f'{mapping}\n[topics."/set"]\ndata = "set"\n')
    shutil.copy(SAMPLE.with_suffix(".toml"), path.with_suffix(".toml"))
    fits = []
    for source in (path, SAMPLE):
        log = read_in_situ_log(source)
        assert [one.name for one in log.sets] == list("12345678")
        options = log.config.fit.options(log.config.sensor)
        fits.append(calibrate_in_situ(log.fitted, factory_matrix=log.config.factory.matrix, options=options))
        if source == path:
            assert any("'/imu'" in notice and "12.00" in notice for notice in log.notices)
    found, own = fits
    sigmas = np.abs(found.matrix - own.matrix) / own.matrix_std
    assert sigmas.max() < 0.5


def test_a_drivers_wrench_is_guessed_as_such(ros: Ros, tmp_path: Path) -> None:
    path = ros.write(tmp_path / "leg", [Topic("/wrench", WRENCH, np.arange(20) * 0.01, np.ones((20, 6)))])
    result = run("calibrate", "ft", path, "--guess")
    assert 'wrench.force.x = "force_x_N"\n' in result.stdout
    assert 'wrench.torque.z = "torque_z_Nm"\n' in result.stdout
    path.with_suffix(".topics.toml").write_text(result.stdout)
    table = read_bag(path).table()
    assert len(table) >= 17
    np.testing.assert_array_equal(table.numbers("force_z_N"), 1.0)


@one_format
def test_a_bag_is_checked_as_its_walk(bag: Path, undrawn: None) -> None:
    checked = check_log(bag)
    assert (checked.recording.kind, len(checked.recording.names)) == ("walk", 8)
    assert checked.sound, checked.wrong
    assert len(checked.recording.notices) >= 3  # a clock of each topic
