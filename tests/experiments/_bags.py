"""Writers of ROS bags, and bags of the recorded walk."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from _logs import redescribe

from surefoot.experiments.logs.format import write_log
from surefoot.experiments.logs.motion import count_rows, even_times

pytest.importorskip("rosbags", reason="needs rosbags: pip install surefoot[ros]")
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

START = 1_700_000_000  # s since 1970


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
    write_log(walk.log, path.with_suffix(".csv"))
    path.with_suffix(".csv").unlink()
    motion = {key: value for key, value in walk.description.items() if key not in ("delay_s", "dt_s")}
    redescribe(path, lag_samples=None, motion=motion | changes)


one_format = pytest.mark.parametrize("ros", ["mcap"], indirect=True)  # for what does not depend on the format
