"""Puts sensors into the feet and the trunk of any robot, in memory.

Sites and sensors only: nothing that has mass, touches or moves, so that the instrumented robot's trajectory
is the bare one's, bit for bit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.envs.feet import find_feet, standing_pose
from surefoot.envs.feet_truth import FOOT_WIDTH, TRUNK_WIDTH, FeetTruth
from surefoot.envs.foot_geometry import FootGeometry, checked_layout, measure_foot
from surefoot.envs.plate import SolePlate

_CONTACT_DATA = 0b10110
"""Bits of a contact sensor's force, torque and position."""

_NET_FORCE = 3
"""A contact sensor's reduction of all contacts to one."""


@dataclass(frozen=True, eq=False)
class Instrumentation:
    """A robot with sensors, to be compiled by whoever simulates it.

    Attributes:
        spec: The instrumented robot: ``spec.compile()``.
        feet: Geometry of its F feet.
        cells: Places of each foot's cells in its sole's frame in m, shape (4, 2); None for one without area.
        plates: How these cells share a load.
        trunk: Name of the body that carries the robot.
        imu: Name of the site of the IMU.
        first_sensor: Name of the first sensor that was added; the others follow it.
    """

    spec: mujoco.MjSpec
    feet: tuple[FootGeometry, ...]
    cells: tuple[NDArray[np.float64] | None, ...]
    plates: tuple[SolePlate | None, ...]
    trunk: str
    imu: str
    first_sensor: str

    def read(self, model: mujoco.MjModel, data: mujoco.MjData) -> FeetTruth:
        """Read all sensors: what was at the beginning of the last step, or at ``mj_forward``.

        Args:
            model: The compiled :attr:`spec`, or what a user has made of it.
            data: Its state.

        Raises:
            ValueError: If the model lacks the sensors.
        """
        return self.read_rows(model, data.sensordata)

    def read_rows(self, model: mujoco.MjModel, sensordata: NDArray[np.float64]) -> FeetTruth:
        """Read sensor data that was recorded, shape (..., nsensordata)."""
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, self.first_sensor)
        if number < 0:
            raise ValueError(
                f"The model has no sensor '{self.first_sensor}': compile the instrumented spec and read that."
            )
        start = int(model.sensor_adr[number])
        width = FOOT_WIDTH * len(self.feet) + TRUNK_WIDTH
        return FeetTruth(sensordata[..., start : start + width], self.feet, self.plates)


def instrument(
    spec: mujoco.MjSpec,
    feet: Sequence[str] | None = None,
    *,
    cells: Mapping[str, ArrayLike] | None = None,
    margin: float = 0.005,
    prefix: str = "surefoot/",
) -> Instrumentation:
    """Put force and torque sensors into a robot's ankles, and into its trunk what tells how it moves.

    The feet are measured in the keyframe "home", "stand" or "standing" or else in the zero pose, in which the
    robot has to stand upright. The ankle's sensor sits at the foot's first joint in the axes of the foot. An
    IMU that the robot has (an accelerometer and a gyro at one site, best on the trunk) says where to read.

    Args:
        spec: The robot, which is not changed.
        feet: Names of the feet's bodies in order; None for the two lowest leaves, the left one first.
        cells: Places of the load cells in the sole's frame in m, front-left, front-right, rear-left,
            rear-right, shape (4, 2), by the foot's body; others lie in the corners of the largest rectangle
            on the sole.
        margin: How far these are drawn in from the rectangle's edges in m.
        prefix: What the names of added sites and sensors begin with.

    Returns:
        The instrumented robot, and how to read it.

    Raises:
        TypeError: If ``spec`` is no specification or ``feet`` a single name.
        ValueError: If a body does not exist, feet cannot be told or cannot touch the ground, a layout is
            wrong, or a name is taken.
    """
    if not isinstance(spec, mujoco.MjSpec):
        raise TypeError(
            "instrument() needs a mujoco.MjSpec, which sensors can be added to (MjSpec.from_file, "
            f"MjSpec.from_string); got a {type(spec).__name__}, which is compiled already."
        )
    model = spec.copy().compile()
    data = standing_pose(model)
    bodies = find_feet(model, data, feet)
    geometry = tuple(measure_foot(model, data, body) for body in bodies)
    trunk = model.body(model.body_rootid[bodies[0]]).name
    unnamed = [body for body, foot in zip(bodies, geometry, strict=True) if not foot.body]
    if unnamed or not trunk:
        raise ValueError(
            f"The trunk and the feet need names: give the bodies {unnamed or ['trunk']} one each."
        )
    places = _places(geometry, cells or {}, margin)
    own = spec.copy()
    taken = {sensor.name for sensor in own.sensors} | {site.name for site in own.sites}
    clash = sorted(name for name in taken if name.startswith(prefix))
    if clash:
        raise ValueError(
            f"The model has sensors or sites that begin with '{prefix}' already: {clash}; it may be "
            "instrumented already, else give another 'prefix'."
        )
    imu = _imu_site(own, trunk) or f"{prefix}imu"
    if imu == f"{prefix}imu":
        own.body(trunk).add_site(name=imu)
    for foot in geometry:
        _add_foot(own, foot, f"{prefix}{foot.body}")
    _add_trunk(own, trunk, imu, f"{prefix}trunk")
    return Instrumentation(
        spec=own,
        feet=geometry,
        cells=places,
        plates=tuple(None if place is None else SolePlate(place, np.ones(4)) for place in places),
        trunk=trunk,
        imu=imu,
        first_sensor=f"{prefix}{geometry[0].body}_ankle_force",
    )


def _places(
    feet: tuple[FootGeometry, ...], cells: Mapping[str, ArrayLike], margin: float
) -> tuple[NDArray[np.float64] | None, ...]:
    """Settle where the cells lie."""
    names = [foot.body for foot in feet]
    unknown = sorted(set(cells) - set(names))
    if unknown:
        raise ValueError(f"'cells' names {unknown}, which are no feet here; the feet are {names}.")
    places: list[NDArray[np.float64] | None] = []
    for foot in feet:
        if foot.body in cells and foot.flaw:
            raise ValueError(foot.flaw)
        if foot.body in cells:
            places.append(checked_layout(foot.body, cells[foot.body]))
        else:
            places.append(None if foot.flaw else foot.layout(margin))
    return tuple(places)


def _imu_site(spec: mujoco.MjSpec, trunk: str) -> str:
    """Find the site of an IMU, best on the trunk; empty if there is none."""
    kinds = (mujoco.mjtSensor.mjSENS_ACCELEROMETER, mujoco.mjtSensor.mjSENS_GYRO)
    sites = [[s.objname for s in spec.sensors if s.type == kind] for kind in kinds]
    both = [name for name in sites[0] if name in sites[1]]
    on_trunk = [name for name in both if spec.site(name).parent.name == trunk]
    return str((on_trunk or both or [""])[0])


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


def _add_trunk(spec: mujoco.MjSpec, trunk: str, imu: str, name: str) -> None:
    """Add the 27 channels of the trunk."""
    body, site = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_SITE
    _add_frame(spec, name, mujoco.mjtObj.mjOBJ_XBODY, trunk)
    for what, kind, objtype, objname in (
        ("com", mujoco.mjtSensor.mjSENS_SUBTREECOM, body, trunk),
        ("com_velocity", mujoco.mjtSensor.mjSENS_SUBTREELINVEL, body, trunk),
        ("angular_momentum", mujoco.mjtSensor.mjSENS_SUBTREEANGMOM, body, trunk),
        ("accelerometer", mujoco.mjtSensor.mjSENS_ACCELEROMETER, site, imu),
        ("gyroscope", mujoco.mjtSensor.mjSENS_GYRO, site, imu),
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
