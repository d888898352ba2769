"""Propose a mapping file for a ROS bag, with the probable column of each field."""

import json
import re
from pathlib import Path
from typing import Any

from surefoot.experiments.logs.bag import explain_damage, message_of, open_bag
from surefoot.experiments.logs.columns import raw_names_of
from surefoot.experiments.logs.description import Description
from surefoot.experiments.logs.motion import ACCELEROMETER, GYROSCOPE
from surefoot.experiments.logs.table import LogError
from surefoot.files import read_json

COUNTS = re.compile(r"std_msgs/msg/(Float|U?Int)\d+MultiArray")
WRENCHES = ("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/Wrench")
JOINTS, IMU = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"

AXES = {
    True: (*ACCELEROMETER, *GYROSCOPE),
    False: tuple(
        f"{name}_{axis}_{unit}"
        for name, unit in (("specific_force", "m_s2"), ("angular_velocity", "rad_s"))
        for axis in "xyz"
    ),
}
"""Columns of an IMU for walks (True) and for in-situ sets (False)."""


def guess_topics(path: Path, *, walk: bool) -> str:
    """Return a mapping file for ``calibrate walk`` or ``calibrate ft`` as TOML.

    Channels of a walk are named as in the layout of the ``.json`` file beside the bag if their number agrees,
    otherwise they are numbered. Raises LogError if the bag is incomplete.
    """
    firsts: dict[str, Any] = {}  # messages, by topic
    joints: dict[str, dict[str, None]] = {}  # names of the joints of all messages in order, by topic
    with open_bag(path) as reader:
        kinds = {name: str(info.msgtype) for name, info in sorted(reader.topics.items())}
        known = [
            one
            for one in reader.connections
            if one.msgtype in (*WRENCHES, JOINTS, IMU) or COUNTS.fullmatch(one.msgtype)
        ]
        with explain_damage(path):
            for connection, _, data in reader.messages(known) if known else ():
                if connection.topic not in firsts or connection.msgtype == JOINTS:
                    message = message_of(path, reader, connection, data)
                    firsts.setdefault(connection.topic, message)
                    joints.setdefault(connection.topic, {}).update(
                        dict.fromkeys(getattr(message, "name", ()))
                    )
    counts = [name for name in firsts if COUNTS.fullmatch(kinds[name])]
    feet = sorted(counts or (name for name in firsts if kinds[name] in WRENCHES))
    channels = [(name, field) for name in feet for field in _channels(firsts[name])]
    fields: dict[str, list[tuple[str, str]]] = {}
    for (name, field), column in zip(channels, _names(path, len(channels), walk, not counts), strict=True):
        fields.setdefault(name, []).append((field, column))
    for name in sorted(firsts) if walk else ():
        if kinds[name] == JOINTS:
            fields[name] = [(f"position.{_key(joint)}", f"joint_{joint}_rad") for joint in joints[name]]
    for name in [name for name in sorted(firsts) if kinds[name] == IMU][:1]:
        places = [
            f"{field}.{axis}" for field in ("linear_acceleration", "angular_velocity") for axis in "xyz"
        ]
        fields[name] = list(zip(places, AXES[walk], strict=True))
    lines = [f"# Proposed for {path.name}: see that each field is what its column says."]
    if not feet:
        lines += ["# No topic of counts or wrenches was recognised; put yours here, before the others."]
    for name, parts in fields.items():
        lines += ["", f"[topics.{json.dumps(name)}]  # {kinds[name]}"]
        lines += [f"{field} = {json.dumps(column)}" for field, column in parts]
    lines += ["", *(f"# not used: {name} ({kind})" for name, kind in kinds.items() if name not in fields)]
    return "\n".join(lines).rstrip() + "\n"


def _channels(message: Any) -> list[str]:
    if hasattr(message, "data"):
        return [f"data.{i}" for i in range(len(message.data))]
    stem = "wrench." if hasattr(message, "wrench") else ""
    return [f"{stem}{part}.{axis}" for part in ("force", "torque") for axis in "xyz"]


def _names(path: Path, channels: int, walk: bool, driver: bool) -> list[str]:
    side = path.with_suffix(".json")
    if walk and side.is_file():
        layout = Description.read(read_json(side, LogError), side.name).layout
        if layout.channels == channels:
            return raw_names_of(layout)
    if driver and not walk and channels == 6:
        return [*(f"force_{axis}_N" for axis in "xyz"), *(f"torque_{axis}_Nm" for axis in "xyz")]
    return [f"raw_{i}_count" for i in range(channels)]


def _key(name: str) -> str:
    """Return a name as a TOML key."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name)
