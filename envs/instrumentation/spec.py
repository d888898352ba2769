"""Puts sensors into the feet and the torso of any robot, in memory.

Sites and sensors only: nothing that has mass, touches or moves, so that the instrumented robot's trajectory
is the bare one's, bit for bit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.envs.instrumentation.drawing import RobotDrawing, draw_robot
from surefoot.envs.instrumentation.feet import standing_pose
from surefoot.envs.instrumentation.geometry import FootGeometry
from surefoot.envs.instrumentation.robot import MeasuredRobot, joint_name, measure_robot
from surefoot.envs.instrumentation.truth import FeetTruth

_CONTACT_DATA = 0b10110  # bits of a contact sensor's force, torque and position
_NET_FORCE = 3  # a contact sensor's reduction of all contacts to one


@dataclass(frozen=True, eq=False)
class Instrumentation:
    """A robot with sensors, to be compiled by whoever simulates it."""

    spec: mujoco.MjSpec
    """The instrumented robot: ``spec.compile()``. A copy has none, as an ``MjSpec`` can be neither pickled
    nor copied with objects that refer to it; it reads without."""
    layout: MeasuredRobot  # the measures of it
    drawing: RobotDrawing  # the drawing by its maker
    first_sensor: str  # name of the first sensor that was added; the others follow it

    def __getstate__(self) -> dict[str, Any]:
        return {name: part for name, part in vars(self).items() if name != "spec"}

    @property
    def feet(self) -> tuple[FootGeometry, ...]:
        """Geometry of the F feet."""
        return self.layout.feet

    @property
    def cells(self) -> tuple[Floats | None, ...]:
        """Places of each foot's cells in its sole's frame in m, shape (4, 2); None for one without area."""
        return self.layout.cells

    @property
    def torso(self) -> str:
        """Name of the body that carries the robot."""
        return self.layout.torso

    @property
    def imu(self) -> str:
        """Name of the site of the IMU."""
        return self.drawing.imu

    def read(self, model: mujoco.MjModel, data: mujoco.MjData) -> FeetTruth:
        """Read all sensors: the state at the beginning of the last step, or at ``mj_forward``.

        Of the compiled :attr:`spec`, or a user's change of it; ValueError if it lacks the sensors. The
        accelerometer is MuJoCo's sensor, which omits what implicit damping adds to the motion;
        :class:`~surefoot.envs.InstrumentedEnv` reads the velocity that the IMU gains instead.
        """
        return self.read_rows(model, data.sensordata)

    def read_rows(self, model: mujoco.MjModel, sensordata: Floats) -> FeetTruth:
        """Read sensor data that was recorded, shape (..., nsensordata)."""
        return FeetTruth(sensordata[..., self.columns(model)].copy(), self.layout.rows)

    def columns(self, model: mujoco.MjModel) -> slice:
        """Find where the sensors that were added lie in a model's data; ValueError if it lacks them."""
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, self.first_sensor)
        if number < 0:
            raise ValueError(
                f"The model has no sensor '{self.first_sensor}': compile the instrumented spec and read that."
            )
        start = int(model.sensor_adr[number])
        return slice(start, start + self.layout.rows.size)


def instrument(
    spec: mujoco.MjSpec,
    feet: Sequence[str] | None = None,
    *,
    cells: Mapping[str, ArrayLike] | None = None,
    margin: float = 0.005,
    prefix: str = "surefoot/",
    samples: int = 1,
) -> Instrumentation:
    """Put force and torque sensors into a robot's ankles, and sensors of its motion into its torso.

    The feet are measured in the keyframe "home", "stand" or "standing" or else in the zero pose, in which the
    robot has to stand upright. The ankle's sensor sits at the foot's first joint in the axes of the foot. An
    IMU of the robot's own (an accelerometer and a gyro at one named site) is read if it sits on the torso,
    the body that floats, in the torso's axes; otherwise another one is put at the torso's origin, so that
    its measurements are always in the torso's axes.

    Args:
        spec: The robot, which is not changed.
        feet: Names of the feet's bodies in order; None for the two lowest leaves, the left one first.
        cells: Places of the load cells in the sole's frame in m, front-left, front-right, rear-left,
            rear-right, shape (4, 2), by the foot's body; others lie in the corners of the largest rectangle
            on the sole.
        margin: How far these are drawn in from the rectangle's edges in m.
        prefix: The beginning of the names of added sites and sensors.
        samples: How many of its last substeps the simulation keeps of each added sensor (MuJoCo's
            ``nsample``), for who reads all of them once a control step.

    Returns:
        The instrumented robot, and how to read it.

    Raises:
        TypeError: If ``spec`` is no specification or ``feet`` a single name.
        ValueError: If a body does not exist, feet cannot be found or cannot touch the ground, a layout is
            wrong, or a name is taken.
    """
    if not isinstance(spec, mujoco.MjSpec):
        raise TypeError(
            "instrument() needs a mujoco.MjSpec, which sensors can be added to (MjSpec.from_file, "
            f"MjSpec.from_string); got a {type(spec).__name__}, which is compiled already."
        )
    checked = spec.copy()
    model = checked.compile()
    own = spec.copy()
    for joint, compiled in zip(own.joints, checked.joints, strict=True):
        joint.name = joint_name(model, compiled.id)
    return instrument_as(own, model, feet, cells=cells, margin=margin, prefix=prefix, samples=samples)


def instrument_as(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    feet: Sequence[str] | None,
    *,
    cells: Mapping[str, ArrayLike] | None,
    margin: float,
    prefix: str,
    samples: int,
) -> Instrumentation:
    """Put sensors into a specification, which is changed, of a robot that is measured in compiled form."""
    data = standing_pose(model)
    layout = measure_robot(model, data, feet, cells, margin)
    own_sensors = len(spec.sensors)
    refuse_taken({sensor.name for sensor in spec.sensors} | {site.name for site in spec.sites}, prefix)
    own_imu = find_imu(model, layout.torso)
    drawing = draw_robot(model, data, layout, imu=own_imu, prefix=prefix)
    if not own_imu:
        spec.body(layout.torso).add_site(name=drawing.imu)
    for foot in layout.feet:
        _add_foot(spec, foot, f"{prefix}{foot.body}")
    _add_torso(spec, layout.torso, drawing.imu, f"{prefix}torso")
    for joint in layout.joint_names:
        spec.add_sensor(
            # A joint may be called "torso" or like a foot, whose sensors have names of the same form.
            name=f"{prefix}joint/{joint}_position",
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint,
        )
    spec.add_sensor(name=f"{prefix}time", type=mujoco.mjtSensor.mjSENS_CLOCK)
    if samples > 1:
        for sensor in spec.sensors[own_sensors:]:
            sensor.nsample = samples
    return Instrumentation(spec, layout, drawing, f"{prefix}{layout.feet[0].body}_ankle_force")


def refuse_taken(names: set[str], prefix: str) -> None:
    """Raise ValueError if names of sensors or sites begin with a prefix already."""
    clash = sorted(name for name in names if name.startswith(prefix))
    if clash:
        raise ValueError(
            f"The model has sensors or sites that begin with '{prefix}' already: {clash}; it may be "
            "instrumented already, else give another 'prefix'."
        )


def find_imu(model: mujoco.MjModel, torso: str) -> str:
    """Return the site on a torso that has an accelerometer, a gyro and the torso's axes; empty without."""
    site, body = mujoco.mjtObj.mjOBJ_SITE, model.body(torso).id
    kinds = (mujoco.mjtSensor.mjSENS_ACCELEROMETER, mujoco.mjtSensor.mjSENS_GYRO)
    measured = [set(model.sensor_objid[model.sensor_type == kind].tolist()) for kind in kinds]
    for number in sorted(measured[0] & measured[1]):
        turned = abs(model.site_quat[number, 0]) < 1.0 - 1e-12
        if model.site_bodyid[number] == body and not turned:
            return str(mujoco.mj_id2name(model, site, number) or "")
    return ""


def _add_foot(spec: mujoco.MjSpec, foot: FootGeometry, name: str) -> None:
    """Add the 27 channels of a foot."""
    body = spec.body(foot.body)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, foot.R_foot_sole.ravel())
    ankle, sole = f"{name}_ankle", f"{name}_sole"
    body.add_site(name=ankle, pos=foot.position_ankle_foot)
    body.add_site(name=sole, pos=foot.position_sole_foot, quat=quaternion)
    site = mujoco.mjtObj.mjOBJ_SITE
    spec.add_sensor(name=f"{ankle}_force", type=mujoco.mjtSensor.mjSENS_FORCE, objtype=site, objname=ankle)
    spec.add_sensor(name=f"{ankle}_torque", type=mujoco.mjtSensor.mjSENS_TORQUE, objtype=site, objname=ankle)
    spec.add_sensor(
        name=f"{name}_ground",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=foot.body,
        intprm=[_CONTACT_DATA, _NET_FORCE, 1],
    )
    _add_frame(spec, sole, site, sole)


def _add_torso(spec: mujoco.MjSpec, torso: str, imu: str, name: str) -> None:
    """Add the 30 channels of the torso."""
    body, site = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_SITE
    _add_frame(spec, name, mujoco.mjtObj.mjOBJ_XBODY, torso)
    for what, kind, objtype, objname in (
        ("com", mujoco.mjtSensor.mjSENS_SUBTREECOM, body, torso),
        ("com_velocity", mujoco.mjtSensor.mjSENS_SUBTREELINVEL, body, torso),
        ("angular_momentum", mujoco.mjtSensor.mjSENS_SUBTREEANGMOM, body, torso),
        ("accelerometer", mujoco.mjtSensor.mjSENS_ACCELEROMETER, site, imu),
        ("gyroscope", mujoco.mjtSensor.mjSENS_GYRO, site, imu),
        ("velocity", mujoco.mjtSensor.mjSENS_FRAMELINVEL, site, imu),
    ):
        spec.add_sensor(name=f"{name}_{what}", type=kind, objtype=objtype, objname=objname)


def _add_frame(spec: mujoco.MjSpec, name: str, objtype: mujoco.mjtObj, objname: str) -> None:
    """Add the place and the three axes of a frame in the world."""
    for what, kind in (
        ("position", mujoco.mjtSensor.mjSENS_FRAMEPOS),
        ("x", mujoco.mjtSensor.mjSENS_FRAMEXAXIS),
        ("y", mujoco.mjtSensor.mjSENS_FRAMEYAXIS),
        ("z", mujoco.mjtSensor.mjSENS_FRAMEZAXIS),
    ):
        spec.add_sensor(name=f"{name}_{what}", type=kind, objtype=objtype, objname=objname)
