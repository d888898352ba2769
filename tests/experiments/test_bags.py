"""ROS bags: what arrives jittered, late and by several clocks gives the calibration of the log."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
import yaml
from typer.testing import CliRunner

from surefoot.calibration import calibrate_in_situ, replay
from surefoot.experiments.cli.app import app
from surefoot.experiments.force_torque.calibrate import SAMPLE
from surefoot.experiments.force_torque.log import read_in_situ_log
from surefoot.experiments.instrument.check import check_log
from surefoot.experiments.logs.bag import Series, guess_topics, read_bag
from surefoot.experiments.logs.format import Log, LogError, read_log, write_log
from surefoot.experiments.logs.motion import count_rows, even_times
from surefoot.experiments.walking import calibrate as module
from surefoot.experiments.walking.calibrate import standard_deviations
from surefoot.names import page

pytest.importorskip("rosbags", reason="needs rosbags: pip install surefoot[ros]")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

RUNNER = CliRunner()
START = 1_700_000_000  # s since 1970
FORMATS = ("ros1", "sqlite3", "mcap")
VECTORS = (("specific_force", "m_s2"), ("angular_velocity", "rad_s"))


class Topic(NamedTuple):
    """What one node publishes: messages of a type, made of rows of numbers."""

    name: str
    kind: str
    time: np.ndarray  # when each row was measured in s, shape (M,)
    values: np.ndarray  # shape (M, n)
    names: tuple[str, ...] = ()  # of joints
    ahead: float = 0.0  # its clock before the recorder's in s
    late: float = 0.0005  # least time to the recorder in s


class Ros:
    """Writes bags of one format."""

    def __init__(self, form: str) -> None:
        self.form = form
        self.store = get_typestore(Stores.ROS1_NOETIC if form == "ros1" else Stores.ROS2_HUMBLE)

    def write(self, path: Path, topics: list[Topic], seed: int = 0, keep: float = 0.99) -> Path:
        """Write a bag: rows are lost, stamps jitter, and messages are late by chance."""
        rng = np.random.default_rng(seed)
        path = path.with_suffix(".bag") if self.form == "ros1" else path.with_suffix("")
        messages = []
        for topic in topics:
            arrived = np.flatnonzero(rng.random(len(topic.time)) < keep)
            stamps = topic.time + topic.ahead + 1e-4 * rng.standard_normal(len(topic.time))
            received = topic.time + topic.late + rng.exponential(1e-3, len(topic.time))
            for row in arrived.tolist():
                made = np.ascontiguousarray(topic.values[row])
                messages.append((START + received[row], START + stamps[row], topic, made))
        messages.sort(key=lambda message: message[0])
        with self._writer(path) as writer:
            kinds = {topic.name: topic.kind for topic in topics}
            links = {name: writer.add_connection(name, kinds[name], typestore=self.store) for name in kinds}
            for received, stamp, topic, row in messages:
                made = self._made(topic, stamp, row)
                encode = self.store.serialize_ros1 if self.form == "ros1" else self.store.serialize_cdr
                writer.write(links[topic.name], round(received * 1e9), encode(made, topic.kind))
        return path

    def _writer(self, path: Path) -> Any:
        if self.form == "ros1":
            return Writer1(path)
        plugin = StoragePlugin.MCAP if self.form == "mcap" else StoragePlugin.SQLITE3
        return Writer2(path, version=9, storage_plugin=plugin)

    def _made(self, topic: Topic, stamp: float, row: np.ndarray) -> Any:
        types = self.store.types
        seconds = int(stamp)
        time = types["builtin_interfaces/msg/Time"](seconds, round((stamp - seconds) * 1e9) % 1_000_000_000)
        number = (0,) if self.form == "ros1" else ()
        header = types["std_msgs/msg/Header"](*number, time, "")
        vector = types["geometry_msgs/msg/Vector3"]
        none = np.zeros(0)
        kind = types[topic.kind]
        if topic.kind.endswith("MultiArray"):
            layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
            return kind(layout, row.astype(np.int32 if "Int32" in topic.kind else np.float64))
        if topic.kind.endswith("JointState"):
            return kind(header, list(topic.names), row, none, none)
        if topic.kind.endswith("Imu"):
            turn, nine = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), np.zeros(9)
            return kind(header, turn, nine, vector(*row[3:]), nine, vector(*row[:3]), nine)
        if topic.kind.endswith("Int32"):
            return kind(int(row[0]))
        wrench = types["geometry_msgs/msg/Wrench"](vector(*row[:3]), vector(*row[3:]))
        return kind(header, wrench)


COUNTS, JOINTS = "std_msgs/msg/Float64MultiArray", "sensor_msgs/msg/JointState"
IMU, WRENCH = "sensor_msgs/msg/Imu", "geometry_msgs/msg/WrenchStamped"


def topics_of(walk: Any) -> list[Topic]:
    """What a robot would publish of the recorded walk: the IMU's clock is 3.7 s ahead of all others."""
    motion, told = walk.motion, walk.description
    arrived = motion["time_s"].to_numpy()
    even, _ = even_times(arrived, count_rows(arrived, told["dt_s"]))
    measured = even - told["delay_s"]
    joints = [name for name in motion.columns if name.startswith("joint_")]
    names = tuple(name.removeprefix("joint_").removesuffix("_rad") for name in joints)
    imu = motion.columns[-6:]
    return [
        Topic("/feet/left", COUNTS, walk.log.time, walk.log.raw[:, :4]),
        Topic("/feet/right", COUNTS, walk.log.time, walk.log.raw[:, 4:]),
        Topic("/joint_states", JOINTS, measured, motion[joints].to_numpy(), names),
        Topic("/imu", IMU, measured, motion[imu].to_numpy(), ahead=3.7),
    ]


def describe(path: Path, walk: Any, **changes: Any) -> None:
    """Write a log's description beside it."""
    write_log(walk.log, path.with_suffix(".csv"))
    path.with_suffix(".csv").unlink()
    side = path.with_suffix(".json")
    told = json.loads(side.read_text())
    del told["lag_samples"]
    motion = {key: value for key, value in walk.description.items() if key not in ("delay_s", "dt_s")}
    side.write_text(json.dumps(told | {"motion": motion | changes}))


@pytest.fixture(
    scope="module",
    params=[form if form == "mcap" else pytest.param(form, marks=pytest.mark.slow) for form in FORMATS],
)
def ros(request: pytest.FixtureRequest) -> Ros:
    return Ros(request.param)


@pytest.fixture(scope="module")
def bag(ros: Ros, recorded_walk: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recorded walk as a bag with its description and the mapping file that was guessed."""
    path = tmp_path_factory.mktemp(ros.form) / "walk"
    describe(path, recorded_walk)
    path = ros.write(path, topics_of(recorded_walk), seed=1)
    path.with_suffix(".topics.toml").write_text(guess_topics(path, walk=True))
    return path


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


one_format = pytest.mark.parametrize("ros", ["mcap"], indirect=True)
"""For what does not depend on the format."""


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
def test_the_command_reads_a_bag_and_writes_ros2_parameters(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "write_walking_page", lambda path, facts: path)
    arguments = ["calibrate", "walk", str(bag), "--method", "tare", "--ros2", "--out", str(tmp_path)]
    result = RUNNER.invoke(app, arguments)
    assert result.exit_code == 0, result.output
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
    result = RUNNER.invoke(app, ["calibrate", "walk", str(bag), "--guess"])
    assert result.exit_code == 0
    assert result.stdout == bag.with_suffix(".topics.toml").read_text()
    assert (
        '[topics."/feet/right"]  # std_msgs/msg/Float64MultiArray\ndata.0 = "raw_right_front_left_count"'
        in (result.stdout)
    )
    assert 'position.LKneePitch = "joint_LKneePitch_rad"\n' in result.stdout
    assert 'linear_acceleration.z = "accelerometer_z_m_s2"\n' in result.stdout


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
        "{bag}: joints and IMU reach from 99",
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
@pytest.mark.parametrize("case", BAD_BAGS)
def test_a_bad_bag_is_one_line(bag: Path, tmp_path: Path, case: str) -> None:
    spoil, reason = BAD_BAGS[case]
    for one in bag.parent.iterdir():
        (shutil.copytree if one.is_dir() else shutil.copy)(one, tmp_path / one.name)
    path = tmp_path / bag.name
    spoil(path)
    result = RUNNER.invoke(app, ["calibrate", "walk", str(path), "--method", "none"])
    assert result.exit_code == 2, result.output
    assert result.stderr.count("\n") == 1
    expected = "surefoot: " + reason.format(bag=bag.name, path=path)
    assert result.stderr[: len(expected)] == expected
    assert result.stderr[len(expected) :] == "\n" or not expected.endswith(".")


def test_a_bag_that_ends_in_the_middle(bag: Path, tmp_path: Path) -> None:
    path = tmp_path / bag.name
    (shutil.copytree if bag.is_dir() else shutil.copy)(bag, path)
    file = path if path.is_file() else next(one for one in path.iterdir() if one.suffix in (".mcap", ".db3"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    result = RUNNER.invoke(app, ["calibrate", "walk", str(path)])
    assert result.exit_code == 2
    assert result.stderr.startswith(f"surefoot: {path.name}: not a whole bag (")
    assert result.stderr.endswith(
        "); `ros2 bag reindex` or `rosbag reindex` mends a recording that was cut off, and `rosbags-convert "
        "--exclude-topic` leaves out what cannot be decoded.\n"
    )
    assert result.stderr.count("\n") == 1


def test_an_empty_bag_and_what_is_none(ros: Ros, tmp_path: Path) -> None:
    path = ros.write(tmp_path / "walk", [Topic("/feet", COUNTS, np.zeros(0), np.zeros((0, 8)))])
    for options in ([], ["--guess"]):
        result = RUNNER.invoke(app, ["calibrate", "walk", str(path), *options])
        assert result.exit_code == 2
        assert result.stderr == f"surefoot: {path.name}: the bag is empty: it holds no message.\n"
    (tmp_path / "walk.csv").write_text("time_s\n")
    result = RUNNER.invoke(app, ["calibrate", "walk", str(tmp_path / "walk.csv"), "--guess"])
    assert result.stderr == ("surefoot: walk.csv: no bag; one is a folder or ends in .bag, .mcap, .db3.\n")


def test_a_file_of_a_folder_is_a_bag_as_well(bag: Path, tmp_path: Path) -> None:
    """As robots without a ``metadata.yaml`` leave it."""
    if bag.is_file():
        pytest.skip("a bag of ROS 1 is a file anyway")
    file = next(one for one in bag.iterdir() if one.suffix in (".mcap", ".db3"))
    path = Path(shutil.copy(file, tmp_path / f"walk{file.suffix}"))
    found, whole = read_bag(path, bag.with_suffix(".topics.toml")), read_bag(bag)
    for one, other in zip(found.series, whole.series, strict=True):
        np.testing.assert_array_equal(one.time, other.time)


def test_without_rosbags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    with pytest.raises(LogError) as refused:
        read_bag(tmp_path / "walk.bag")
    assert str(refused.value) == (
        'walk.bag: bags are read by rosbags.highlevel, which is missing: pip install "surefoot[ros]".'
    )


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
        mapping = path.with_suffix(".topics.toml")
        mapping.write_text('[topics."/joint_states"]\nposition = {a = "joint_a_rad", c = "joint_c_rad"}\n')
        table = read_bag(path).table()
        time_s = table.numbers("time_s")
        assert len(table) > 90
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
    result = RUNNER.invoke(app, ["calibrate", "ft", str(path), "--guess"])
    assert result.exit_code == 0
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
