"""Read a robot's own model from an MJCF or URDF file.

Masses, hinges, and where the IMU and the soles are: all that kinematics needs. Shapes, actuators and other
parts of a simulation are left out, so that their files need not be there.
"""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration import FeetLayout
from surefoot.envs.instrumentation.feet import find_feet, standing_pose
from surefoot.envs.instrumentation.geometry import FootGeometry, measure_foot
from surefoot.robot.beliefs.errors import NO_ERRORS
from surefoot.robot.beliefs.nominal import NominalModel

IMU_SITE = "surefoot_imu"  # name of the site that is added where the IMU is, in the torso's axes

_NOT_NEEDED = (
    "geoms", "tendons", "actuators", "sensors", "equalities", "excludes", "keys", "skins", "meshes",
    "hfields", "textures", "materials",
)  # fmt: skip
"""Parts that need files or that kinematics does not; a part that refers to another one comes first."""


class FileRobot(NamedTuple):
    """A robot that was read from a file."""

    model: NominalModel  # kinematics and masses
    R_torso_imu: Floats  # rotation from the IMU's axes to the torso's, shape (3, 3)
    touching: Floats
    """Parts of each foot that may touch the ground: centres in the sole frame and radii in m, (F, n, 4)."""
    rolls: bool  # whether feet are round, so that they stand on any of their sides


class ModelPartError(ValueError):
    """A name is not that of a part of the model; the message begins with the argument that holds it."""


def read_spec(path: str | PathLike[str]) -> mujoco.MjSpec:
    """Read an MJCF or URDF file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If MuJoCo cannot read it.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"There is no model file '{path}'; give the path of an MJCF or URDF file.")
    spec = mujoco.MjSpec.from_file(str(path))
    # Fixed links of a URDF are places that may be named. Fused with their parents they would be lost.
    spec.compiler.fusestatic = False
    return spec


def nominal_model(
    spec: mujoco.MjSpec, torso: str, imu: str, soles: Sequence[str]
) -> tuple[NominalModel, Floats]:
    """Make a robot's own model of a specification, which is changed.

    Args:
        spec: The robot. A torso without a free joint gets one.
        torso: The body that floats.
        imu: Site or body that is fixed to the torso.
        soles: Sites or bodies of the sole frames, the left one first.

    Returns:
        The model, and the rotation from the IMU's axes to the torso's, shape (3, 3).

    Raises:
        ModelPartError: If a name is not in the model, or the IMU is elsewhere than on the torso.
        ValueError: If the robot does not consist of a floating body and hinges.
    """
    _check_place(spec, torso, "torso", bodies_only=True)
    for name, role in ((imu, "imu"), *((name, "soles") for name in soles)):
        _check_place(spec, name, role)
    _fix_masses(spec)
    for part in _NOT_NEEDED:
        for element in list(getattr(spec, part)):
            spec.delete(element)
    floating = spec.body(torso)
    if not any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in floating.joints):
        floating.add_freejoint()
    for name in soles:
        if spec.site(name) is None:
            spec.body(name).add_site(name=name)
    R_torso_imu = _place_imu(spec, torso, imu)
    return NominalModel(spec, NO_ERRORS, sites=(IMU_SITE, *soles), torso=torso), R_torso_imu


def _check_place(spec: Any, name: str, role: str, *, bodies_only: bool = False) -> None:
    """Raise ModelPartError if a name is neither that of a body nor, where it may be one, of a site."""
    bodies = [body.name for body in spec.bodies if body.name != "world"]
    sites = [] if bodies_only else [site.name for site in spec.sites]
    if name not in bodies + sites:
        available = f"the bodies {bodies}" if bodies_only else f"the sites {sites} and the bodies {bodies}"
        raise ModelPartError(f"{role} '{name}' is not in the model; it has {available}.")


def _fix_masses(spec: Any) -> None:
    """Write down the masses that follow from shapes, before the shapes are deleted."""
    bodies = [body for body in spec.bodies[1:] if not body.explicitinertial and len(body.geoms)]
    if not bodies:
        return
    full = spec.copy().compile()
    for body in bodies:
        if not body.name:
            raise ValueError("a body without a name takes its mass from its shapes; name every body.")
        row = full.body(body.name).id
        body.explicitinertial = True
        body.mass = float(full.body_mass[row])
        body.ipos, body.iquat = full.body_ipos[row].copy(), full.body_iquat[row].copy()
        body.inertia = full.body_inertia[row].copy()


def _place_imu(spec: Any, torso_name: str, imu: str) -> Floats:
    """Put a site where the IMU is; return the rotation from its axes to the torso's."""
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    torso, is_site = data.body(torso_name), spec.site(imu) is not None
    place = data.site(imu) if is_site else data.body(imu)
    owner = model.body_weldid[model.site_bodyid[place.id] if is_site else place.id]
    if owner != torso.id:
        raise ModelPartError(
            f"imu '{imu}' is not fixed to the torso '{torso_name}' but to '{model.body(owner).name}'; "
            "name the body that carries the IMU as the torso."
        )
    R_world_torso = torso.xmat.reshape(3, 3)
    spec.body(torso_name).add_site(name=IMU_SITE, pos=R_world_torso.T @ (place.xpos - torso.xpos))
    R: Floats = R_world_torso.T @ np.asarray(place.xmat).reshape(3, 3)
    return R


def read_robot(
    path: str | PathLike[str],
    feet: Sequence[str] | None = None,
    imu: str | None = None,
    layout: FeetLayout | None = None,
) -> FileRobot:
    """Read a robot from an MJCF or URDF file.

    Args:
        path: The file.
        feet: Names of the feet, the left one first. The soles of bodies with shapes are measured. A site, or
            a body without shapes, is a sole frame: z up, x to the toes. By default the two lowest leaves.
        imu: Site or body that carries the IMU; by default the site of the model's accelerometer, or else the
            torso itself.
        layout: The feet's channels. Their places are what touches the ground where ``feet`` names frames.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file cannot be read, a name is not in it, feet cannot be guessed, or the robot does
            not consist of a floating body and hinges.
    """
    spec = read_spec(path)
    try:
        if feet is not None and all(_is_frame(spec, name) for name in feet):
            soles, rolls = tuple(feet), False
            touching = np.zeros((len(soles), 1, 4)) if layout is None else touching_points(layout)
        else:
            soles, touching, rolls = _measure_soles(spec, feet)
        torso = _carrier(spec, soles[0])
        measured = [sensor for sensor in spec.sensors if sensor.type == mujoco.mjtSensor.mjSENS_ACCELEROMETER]
        imu = imu or next((sensor.objname for sensor in measured), torso)
        model, R_torso_imu = nominal_model(spec, torso, imu, soles)
    except (ValueError, mujoco.FatalError) as error:
        raise ValueError(f"The model '{path}' cannot be used: {error}") from None
    return FileRobot(model, R_torso_imu, touching, rolls)


def touching_points(layout: FeetLayout) -> Floats:
    """Return the places of the feet's channels in the sole frames and radii of 0, in m, (F, n, 4).

    A foot whose channels have no places touches the ground at the origin of its sole frame.
    """
    cells = [foot.position_cell_sole for foot in layout.feet]
    return _pad([np.zeros((1, 3)) if places is None else places for places in cells])


def _pad(points: Sequence[Floats]) -> Floats:
    """Stack the points of several feet, (n, up to 4) each; a foot with fewer points repeats its last one."""
    most = max(map(len, points))
    wide = [np.pad(part, ((0, 0), (0, 4 - part.shape[1]))) for part in points]
    return np.stack([np.pad(part, ((0, most - len(part)), (0, 0)), mode="edge") for part in wide])


def _is_frame(spec: Any, name: str) -> bool:
    """Return whether a name is that of a site, or of a body without shapes that can touch."""
    if spec.site(name) is not None:
        return True
    body = spec.body(name)
    if body is None:
        raise ModelPartError(
            f"feet '{name}' is not in the model; it has the sites {[site.name for site in spec.sites]} and "
            f"the bodies {[body.name for body in spec.bodies[1:]]}."
        )
    bodies = [body]
    for one in bodies:
        if any(geom.contype or geom.conaffinity for geom in one.geoms):
            return False
        bodies.extend(one.bodies)
    return True


def _measure_soles(spec: Any, feet: Sequence[str] | None) -> tuple[tuple[str, ...], Floats, bool]:
    """Put a site into each sole; return their names, the parts that touch, and whether feet are round."""
    model = spec.copy().compile()
    data = standing_pose(model)
    found: list[FootGeometry] = [measure_foot(model, data, body) for body in find_feet(model, data, feet)]
    names = tuple(f"surefoot_{foot.body}_sole" for foot in found)
    for name, foot in zip(names, found, strict=True):
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, foot.R_foot_sole.ravel())
        spec.body(foot.body).add_site(name=name, pos=foot.position_sole_foot, quat=quaternion)
    parts = [foot.round if foot.flaw else foot.polygon for foot in found]
    # Polygons lie in the sole's plane; round parts have a height and a radius.
    parts = [np.pad(part, ((0, 0), (0, 4 - part.shape[1]))) for part in parts]
    return names, _pad(parts), any(foot.flaw for foot in found)


def _carrier(spec: Any, sole: str) -> str:
    """Return the name of the uppermost body of the robot that carries a sole."""
    site = spec.site(sole)
    body = site.parent if site is not None else spec.body(sole)
    while body.parent.name != "world":
        body = body.parent
    if not body.name:
        raise ModelPartError("torso '' has no name; name the body that floats.")
    return str(body.name)
