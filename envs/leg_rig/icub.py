"""The leg of the real iCub on the stand of the in-situ rig, from the official model where that is installed.

The URDF comes from the package ``icub-models`` (CC BY-SA 4.0), which is not part of this one: the extra
``icub`` installs it. Only its kinematics and inertias are used, no meshes. Beam and IMU under the foot are
those of rig.xml, and so are the names of joints, sites and sensors: code for that rig reads this one.
"""

import importlib
from typing import Any, Literal
from xml.etree import ElementTree

import mujoco
import numpy as np

from surefoot.envs.leg_rig.spec import SENSORS, added_mass, load_leg_rig_spec

_LINKS = ("hip_1", "hip_2", "hip_3", "upper_leg", "lower_leg", "ankle_1", "ankle_2", "foot")
_JOINTS = {"hip_pitch": "hip_front_back", "hip_roll": "hip_lateral"}


def load_icub_leg_spec(configuration: int = 1, *, side: Literal["left", "right"] = "right") -> mujoco.MjSpec:
    """Build the in-situ rig with a leg of the iCub, all joints below the hip held: an own specification.

    The sensors lie where the fixed joints ``leg_ft_sensor`` and ``foot_ft_sensor`` are, with their frames: x
    forward, y right, z down. In this model the feet's sensors lie 0.4212 m below the legs', not 0.3636 m as
    in the experiment of 2015: added masses, 1 to 8 (:data:`~surefoot.envs.leg_rig.spec.ADDED_MASSES`), keep
    their places in the foot sensor's frame. ImportError if ``icub-models`` is not installed, ValueError if
    there is no such configuration or side.
    """
    load = added_mass(configuration)
    if side not in ("left", "right"):
        raise ValueError(f"'side' must be 'left' or 'right', got {side!r}.")
    spec = mujoco.MjSpec.from_string(_leg_urdf(side[0]))
    spec.option.gravity = (0.0, 0.0, -9.81)
    for joint, name in _JOINTS.items():
        hinge = spec.joint(f"{side[0]}_{joint}")
        hinge.name, hinge.limited = name, mujoco.mjtLimited.mjLIMITED_FALSE
    rig = load_leg_rig_spec()
    foot = spec.body(f"{side[0]}_foot")
    # The body of the link is the sensor's frame already.
    for sensor, link in zip(SENSORS, ("foot", "hip_3"), strict=True):
        spec.body(f"{side[0]}_{link}").add_site(name=f"{sensor}_ft")
    for name in ("beam", "imu"):
        part = rig.body(name)
        _add_body(foot, name, part.pos * (1.0, -1.0, -1.0), part.mass, part.inertia)
    spec.body("imu").add_site(name="imu")
    _add_body(foot, "added_mass", np.array(load.com_foot), load.mass, np.full(3, load.inertia))
    for sensor in rig.sensors:
        spec.add_sensor(name=sensor.name, type=sensor.type, objtype=sensor.objtype, objname=sensor.objname)
    return spec


def _add_body(foot: Any, name: str, place: Any, mass: float, inertia: Any) -> None:
    """Fix a body to the foot, at a place in the sensor's frame."""
    body = foot.add_body(name=name, pos=place)
    # Left out, the centre of mass would be taken to lie at the place once more.
    body.explicitinertial, body.ipos = True, np.zeros(3)
    body.mass, body.inertia = mass, inertia


def _leg_urdf(prefix: str) -> str:
    """Cut one leg out of the robot's URDF: no visuals, and no joints but the hip's two."""
    try:
        icub_models = importlib.import_module("icub_models")
    except ImportError as error:
        raise ImportError(
            "The iCub's leg needs the package 'icub-models'; install it with pip install 'surefoot[icub]'."
        ) from error
    robot = ElementTree.parse(icub_models.get_model_file("iCubGazeboV2_5")).getroot()
    leg = ElementTree.Element("robot", name="icub_leg")
    wrapper = ElementTree.SubElement(leg, "mujoco")
    compiler = {"fusestatic": "false", "balanceinertia": "true", "strippath": "false"}
    ElementTree.SubElement(wrapper, "compiler", compiler)
    names = {"root_link", *(f"{prefix}_{link}" for link in _LINKS)}
    for link in robot.findall("link"):
        if link.get("name") in names:
            for drawn in (*link.findall("visual"), *link.findall("collision")):
                link.remove(drawn)
            leg.append(link)
    for joint in robot.findall("joint"):
        ends = [joint.find(end) for end in ("parent", "child")]
        if any(end is None or end.get("link") not in names for end in ends):
            continue
        if str(joint.get("name")).removeprefix(f"{prefix}_") not in _JOINTS:
            joint.set("type", "fixed")
        leg.append(joint)
    # The iCub's root looks backwards: turn it about, and put it where the stand of the rig holds it.
    ElementTree.SubElement(leg, "link", name="stand")
    mount = ElementTree.SubElement(leg, "joint", name="mount", type="fixed")
    ElementTree.SubElement(mount, "parent", link="stand")
    ElementTree.SubElement(mount, "child", link="root_link")
    ElementTree.SubElement(mount, "origin", xyz="0 0 1.12", rpy=f"0 0 {np.pi}")
    return ElementTree.tostring(leg, encoding="unicode")
