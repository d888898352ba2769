"""A robot as parameters of the ROS 2 node ``surefoot``: its map, its constants and its beliefs.

The package in ``ros2/`` reads them; the constants are the records of the library in C, field by field.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration import OnlineSetup, Parameters
from surefoot.calibration.native.config import constants_of
from surefoot.experiments.logs.format import Log
from surefoot.experiments.walks.replay import age_of
from surefoot.files import write_text
from surefoot.names import page
from surefoot.native import CALIBRATION, require
from surefoot.robot.beliefs.lag import packets_per_join, usual_lag
from surefoot.robot.beliefs.momentum import MomentumBeliefs
from surefoot.robot.beliefs.native import NativeBeliefs
from surefoot.robot.beliefs.references import Beliefs
from surefoot.robot.model_file import touching_points
from surefoot.sensors.telemetry.computer import TelemetryLayout
from surefoot.sensors.transport.link import Link


def node_parameters(
    setup: OnlineSetup,
    beliefs: MomentumBeliefs,
    *,
    joints: dict[str, float],
    soles: Sequence[str] = ("left_sole", "right_sole"),
    R_torso_imu: ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    age: float = 0.0,
) -> dict[str, Any]:
    """Return the parameters of the node for one robot, its map to start from and its beliefs, by their names.

    ``joints`` are the angles in rad at which hinges of the model are held, in the model's order, NaN for
    those that ``joint_states`` holds; ``soles`` the names of the sole frames, ``R_torso_imu`` the rotation
    from the IMU's axes to the torso's, (3, 3), ``age`` how many s before they arrive counts were measured.
    RuntimeError if there is no library here, ValueError if it is not made for such a robot.
    """
    library = require(CALIBRATION.installed())
    found = constants_of(library, "moment", setup, {})
    if found is None or found.own is None:
        raise ValueError(f"The library is not made for such a robot; {page('native')} has its limits.")
    records = {"robot": found.config, "moment": found.own, **NativeBeliefs(library, beliefs).constants}
    return {
        "channels": list(setup.layout.channel_names),
        "scale_N_per_count": np.asarray(setup.initial.scale, dtype=float).tolist(),
        "offset_N": np.asarray(setup.initial.offset, dtype=float).tolist(),
        "feet": [foot.name for foot in setup.layout.feet],
        "sole_frames": list(soles),
        "joints": list(joints),
        "held_rad": [float(angle) for angle in joints.values()],
        "R_torso_imu": np.asarray(R_torso_imu, dtype=float).ravel().tolist(),
        "readings_age_s": float(age),
        **{name: _fields(record) for name, record in records.items()},
    }


def parameters_of_log(log: Log, initial: Parameters, **options: Any) -> tuple[dict[str, Any], str]:
    """Return the parameters of the node for the robot of a log, or none of them and why.

    ``initial`` is the map that the node starts from; options are further fields of the setup.
    """
    facts = log.motion
    if facts is None:
        return {}, f"the log has no joints, IMU and drawing ('motion' in {page('log-format')})."
    from surefoot.experiments.logs.model import load_model

    model, R_torso_imu = load_model(facts, facts.model.name)
    link = Link(rate=1.0 / facts.dt_s, delay=facts.delay_s, jitter=0.0)
    lag = usual_lag(link, facts.dt_s, log.dt, facts.readings_age_s)
    beliefs = Beliefs(
        model,
        TelemetryLayout(len(model.joint_names)),
        facts.dt_s,
        facts.delay_s,
        facts.averaged,
        lag=lag,
        dt=log.dt,
        joined=packets_per_join(facts.dt_s),
        touching=touching_points(log.layout),
    )
    known: dict[str, Any] = {"mass": log.mass, "dt": log.dt, "lag": lag, "age": age_of(log), **options}
    try:
        parameters = node_parameters(
            OnlineSetup(layout=log.layout, initial=initial, **known),
            MomentumBeliefs(beliefs),
            joints={name: facts.held_rad.get(name, np.nan) for name in model.joint_names},
            soles=facts.soles,
            R_torso_imu=R_torso_imu,
            age=facts.readings_age_s,
        )
    except (RuntimeError, ValueError) as problem:
        return {}, str(problem)
    # The drawing's masses are brought to the log's, as its own references are.
    heavier = log.mass / model.mass
    for name in ("mass", "inertia"):
        parameters["model"][name] = [heavier * x for x in parameters["model"][name]]
    return parameters, ""


def write_node_parameters(path: Path, parameters: dict[str, Any], comment: str) -> Path:
    """Write parameters of the node as YAML, with a comment of one line before them."""
    body = yaml.safe_dump(
        {"surefoot": {"ros__parameters": parameters}}, sort_keys=False, default_flow_style=None, width=2**20
    )
    write_text(path, f"# {comment}\n{body}")
    return path


def _fields(record: NDArray[Any]) -> dict[str, list[float]]:
    """Return the fields of a record as lists of numbers; scale and offset are parameters of their own."""
    names = record.dtype.names or ()
    return {
        name: record[name].ravel().astype(float).tolist() for name in names if name not in ("scale", "offset")
    }
