"""The NAO-class biped: its model and the names of its parts.

The numbers are those of nao.xml alone; this module adds the orders in which the rest of the package
speaks of joints, motors and feet.
"""

import copy
import functools
from importlib.resources import files

import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats

FEET = ("left", "right")  # the order of the feet everywhere

CELLS = ("front_left", "front_right", "rear_left", "rear_right")
"""The order of a foot's load cells everywhere."""

LEG_MOTORS = (
    "LHipYawPitch",
    "LHipRoll",
    "LHipPitch",
    "LKneePitch",
    "LAnklePitch",
    "LAnkleRoll",
    "RHipRoll",
    "RHipPitch",
    "RKneePitch",
    "RAnklePitch",
    "RAnkleRoll",
)
"""The 11 leg motors in the order of an action: LHipYawPitch turns both hip-yaw-pitch joints."""


def load_nao_spec() -> mujoco.MjSpec:
    """Read nao.xml afresh: to instrument or perturb in memory and then ``compile()``."""
    xml = files("surefoot.envs.robots").joinpath("nao.xml").read_text(encoding="utf-8")
    return mujoco.MjSpec.from_string(xml)


def nao_model() -> mujoco.MjModel:
    """Return a model of nao.xml of its own; it is compiled once in a process."""
    return copy.copy(_compile())


@functools.cache
def _compile() -> mujoco.MjModel:
    return load_nao_spec().compile()


def hinge_joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of all hinge joints in model order: the J columns of every joint array."""
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    return tuple(model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] == hinge)


def motor_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of all actuators in model order: the M columns of motor arrays, the legs' first."""
    return tuple(model.actuator(i).name for i in range(model.nu))


def motor_of_joint(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return which motor turns each hinge joint, shape (J,); one turns both hip-yaw-pitch joints."""
    motors = motor_names(model)
    shared = {"RHipYawPitch": "LHipYawPitch"}
    return np.array([motors.index(shared.get(name, name)) for name in hinge_joint_names(model)])


def cell_positions(model: mujoco.MjModel) -> Floats:
    """Read where cells lie in the sole frames in m, (left, right) and as :data:`CELLS`, shape (2, 4, 3)."""
    return np.array(
        [
            [model.site(f"{foot}_cell_{cell}").pos - model.site(f"{foot}_sole").pos for cell in CELLS]
            for foot in FEET
        ]
    )


def place_on_ground(
    model: mujoco.MjModel, data: mujoco.MjData, position_sole: Floats, yaw_sole: Floats
) -> None:
    """Put the upright robot, with the joints of ``data.qpos``, onto its footprints; evaluate the kinematics.

    The torso stays upright; heading and place follow from the middle of the two soles, the height from the
    lowest corner of the soles, which just touches the ground. Footprints have origins in m, shape (2, 3), and
    headings in rad, shape (2,).
    """
    data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    mujoco.mj_kinematics(model, data)
    sole_x = np.array([data.site(f"{foot}_sole").xmat.reshape(3, 3)[:, 0] for foot in FEET]).sum(axis=0)
    heading = np.arctan2(np.sin(yaw_sole).sum(), np.cos(yaw_sole).sum()) - np.arctan2(sole_x[1], sole_x[0])
    data.qpos[3:7] = (np.cos(heading / 2), 0.0, 0.0, np.sin(heading / 2))
    mujoco.mj_kinematics(model, data)
    middle = np.mean([data.site(f"{foot}_sole").xpos for foot in FEET], axis=0)
    lowest = min(data.site(f"{foot}_cell_{cell}").xpos[2] for foot in FEET for cell in CELLS)
    data.qpos[:2] = position_sole[:, :2].mean(axis=0) - middle[:2]
    data.qpos[2] = position_sole[:, 2].min() - lowest
    mujoco.mj_kinematics(model, data)
