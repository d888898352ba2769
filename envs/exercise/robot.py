"""Prepare a biped with flat feet for exercises: sensors, legs, and gains to stand on one foot."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.envs.instrumentation.feet import standing_pose
from surefoot.envs.instrumentation.made import make
from surefoot.envs.instrumentation.spec import Instrumentation, instrument
from surefoot.envs.robots.library import ROBOTS, load_robot_spec, read_robot_spec

STANDING_STIFFNESS: Final = 2.0
"""Minimum stiffness of a leg motor in multiples of m g h, the negative stiffness of gravity for a robot of
mass m with its centre of mass at height h. One ankle must exceed 1 to stand on one foot; 2 is chosen."""


@dataclass(frozen=True, eq=False)
class ExerciseRobot:
    """A compiled biped."""

    instrumentation: Instrumentation  # its sensors
    model: mujoco.MjModel
    """The compiled ``instrumentation.spec``, with raised gains of the legs if necessary."""
    torso: int  # index of the floating body
    soles: tuple[int, ...]  # indices of the sites of both soles, the left one first
    legs: tuple[NDArray[np.intp], ...]  # indices of each leg's hinge joints, from the hip down
    leg_motors: NDArray[np.intp]  # indices of the L actuators that move them, in model order
    centre: Floats  # middles of the largest rectangles on the soles, in the sole frames in m, shape (2, 2)
    half: Floats  # half the length and width in m, the minimum of both feet, shape (2,)

    @property
    def gravity(self) -> float:
        """Size of gravity in m/s^2."""
        return float(np.linalg.norm(self.model.opt.gravity))

    @property
    def weight(self) -> float:
        """Weight in N."""
        return self.gravity * float(self.model.body_subtreemass[self.torso])


def prepare_robot(robot: Any, feet: Sequence[str] | None = None, *, boxes: bool = False) -> ExerciseRobot:
    """Add sensors to a biped and raise its gains so that it can stand on one leg.

    The robot is a name that :func:`~surefoot.envs.load_robot_spec` knows, the path of an MJCF file with robot
    and floor, or such a ``mujoco.MjSpec``, which is not changed. ``feet`` are names of bodies, the left one
    first, or ``None`` to find them. With ``boxes`` purely visual meshes become boxes, which need less memory.

    ModuleNotFoundError if a named robot's package is missing, TypeError for other types, ValueError if there
    is no such robot or file, it has not two flat feet, it does not float on one free joint, or a joint of a
    leg has no position motor.
    """
    spec = _load(robot)
    if boxes and spec.meshes:
        full = spec.copy().compile()
        usual: Any = {"cells": None, "margin": 0.005, "prefix": "surefoot/"}
        made = make(spec, full, feet, soles=False, boxes=True, samples=1, **usual)
        assert made.instrumentation is not None
        assert made.model is not None
        instrumentation, model = made.instrumentation, made.model
    else:
        instrumentation = instrument(spec, feet)
        model = instrumentation.spec.compile()
    bodies = [foot.body for foot in instrumentation.feet]
    if len(bodies) != 2:
        raise ValueError(f"An exercise needs two feet, feet=(left, right); got {bodies}.")
    if instrumentation.drawing.flaw:
        raise ValueError(instrumentation.drawing.flaw)
    torso = int(model.body(instrumentation.torso).id)
    if (
        model.body_jntnum[torso] != 1
        or model.jnt_type[model.body_jntadr[torso]] != mujoco.mjtJoint.mjJNT_FREE
    ):
        raise ValueError(f"The body '{instrumentation.torso}' must float on one free joint; give it one.")
    legs = tuple(_leg(model, int(model.body(body).id), torso) for body in bodies)
    leg_motors = _motors(model, np.unique(np.concatenate(legs)))
    soles = tuple(int(model.site(sole).id) for sole in instrumentation.drawing.soles)
    _strengthen(model, leg_motors, torso, soles)
    corners = np.array([foot.layout(0.0) for foot in instrumentation.feet])
    return ExerciseRobot(
        instrumentation=instrumentation,
        model=model,
        torso=torso,
        soles=soles,
        legs=legs,
        leg_motors=leg_motors,
        centre=corners.mean(axis=1),
        half=np.ptp(corners, axis=1).min(axis=0) / 2.0,
    )


def motor_moments(model: mujoco.MjModel, data: mujoco.MjData) -> Floats:
    """Return the moment arm of each actuator about each degree of freedom, shape (M, nv)."""
    moments = np.zeros((model.nu, model.nv))
    if model.nu:
        mujoco.mju_sparse2dense(
            moments, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
    return moments


def _load(robot: Any) -> mujoco.MjSpec:
    """Read a robot with its floor."""
    if isinstance(robot, mujoco.MjSpec):
        return robot
    if not isinstance(robot, str | Path):
        raise TypeError(
            f"'robot' must be a name, the path of an MJCF file or a mujoco.MjSpec; got a "
            f"{type(robot).__name__}."
        )
    if robot in ROBOTS:
        return load_robot_spec(str(robot))
    if not Path(robot).is_file():
        raise ValueError(
            f"'robot' must be one of {list(ROBOTS)} or the path of an MJCF file; there is no '{robot}'."
        )
    return read_robot_spec(robot)


def _leg(model: mujoco.MjModel, foot: int, torso: int) -> NDArray[np.intp]:
    """List the joints between torso and foot, from the hip down."""
    joints: list[int] = []
    while foot != torso:
        first = int(model.body_jntadr[foot])
        joints = [*range(first, first + int(model.body_jntnum[foot])), *joints]
        foot = int(model.body_parentid[foot])
    others = [model.joint(j).name for j in joints if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE]
    if others:
        raise ValueError(f"The joints of a leg must be hinges; {others} are none.")
    return np.array(joints, dtype=np.intp)


def _motors(model: mujoco.MjModel, joints: NDArray[np.intp]) -> NDArray[np.intp]:
    """Find the motors of the legs."""
    data = standing_pose(model)
    mujoco.mj_forward(model, data)
    arms = motor_moments(model, data)[:, model.jnt_dofadr[joints]]
    motors = np.flatnonzero(np.any(arms != 0.0, axis=1))
    stiffness = model.actuator_gainprm[:, 0]
    servo = (
        (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED)
        & (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE)
        & (stiffness > 0.0)
        & np.isclose(model.actuator_biasprm[:, 1], -stiffness)
    )
    idle = [model.joint(j).name for j, arm in zip(joints, arms.T, strict=True) if not np.any(arm[servo])]
    other = [model.actuator(i).name for i in motors if not servo[i]]
    if idle or other:
        raise ValueError(
            f"Each joint of a leg needs a position actuator (<position kp=... kv=...>): the joints {idle} "
            f"have none, and the actuators {other} are of another kind."
        )
    return motors


def _strengthen(model: mujoco.MjModel, motors: NDArray[np.intp], torso: int, soles: tuple[int, ...]) -> None:
    """Raise gains that are too low, and damping with their square root, which keeps the damping ratio."""
    data = standing_pose(model)
    weight = float(model.body_subtreemass[torso] * np.linalg.norm(model.opt.gravity))
    height = float(data.subtree_com[torso][2] - data.site_xpos[list(soles), 2].mean())
    least = STANDING_STIFFNESS * weight * height
    for motor in motors:
        ratio = max(least / float(model.actuator_gainprm[motor, 0]), 1.0)
        model.actuator_gainprm[motor, 0] *= ratio
        model.actuator_biasprm[motor, 1] *= ratio
        model.actuator_biasprm[motor, 2] *= np.sqrt(ratio)
