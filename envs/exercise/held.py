"""A robot that servos hold in the pose in which it stands."""

from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.envs.exercise.env import CONTROL_STEP, FALLEN_HEIGHT, FALLEN_TILT
from surefoot.envs.exercise.robot import STANDING_STIFFNESS
from surefoot.envs.instrumentation.feet import standing_pose
from surefoot.envs.instrumentation.robot import measure_robot
from surefoot.envs.robots.library import load_robot_spec

_SUBSTEPS = 10  # of a control step
_NOISE = 0.01  # of the first velocities, in m/s and rad/s
_PITCHES = 0.9  # share of the lateral axis in that of a joint that pitches


class HeldRobot(gym.Env[Any, Any]):
    """A robot at hand whose joints are held by position servos in the place of its motors.

    Robots of the Menagerie differ in motors, gains and limits, and not all of them stand by their own. The
    pose is that of the description's keyframe, leant at the ankles so that soles lie flat and the centre of
    mass is over their middle. An action moves all targets by so many rad; an episode ends with a fall.
    """

    def __init__(self, robot: str) -> None:
        self.description = spec = load_robot_spec(robot)
        spec.compiler.discardvisual = True
        spec.option.timestep = CONTROL_STEP / _SUBSTEPS
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        bare = spec.compile()
        data = _leant(bare)
        weight = float(bare.body_subtreemass[0]) * -bare.opt.gravity[2]
        stiffness = STANDING_STIFFNESS * weight * float(data.subtree_com[0, 2])
        for old in (*spec.actuators, *spec.keys):
            spec.delete(old)
        hinges = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
        for joint in hinges:
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
            servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            servo.set_to_position(kp=stiffness, dampratio=1.0)
        self._target = np.array([data.joint(joint.name).qpos[0] for joint in hinges])
        spec.add_key(name="home", qpos=data.qpos, ctrl=self._target)
        self.model, self.dt = spec.compile(), CONTROL_STEP
        self.data = mujoco.MjData(self.model)
        self.observation_space = spaces.Box(-np.inf, np.inf, self._target.shape)
        self.action_space = spaces.Box(-1.0, 1.0, self._target.shape)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Stand, hardly moving."""
        super().reset(seed=seed)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        self.data.qvel[:] = self.np_random.normal(0.0, _NOISE, self.model.nv)
        mujoco.mj_forward(self.model, self.data)
        return self.data.ctrl.copy(), {}

    def step(self, action: NDArray[np.float32]) -> Any:
        """Hold the targets, moved by ``action`` rad, for a control step."""
        self.data.ctrl[:] = self._target + action
        mujoco.mj_step(self.model, self.data, _SUBSTEPS)
        upright = 1.0 - 2.0 * float(np.sum(self.data.qpos[4:6] ** 2)) > np.cos(FALLEN_TILT)
        fell = not upright or self.data.qpos[2] < FALLEN_HEIGHT * self.model.key_qpos[0, 2]
        return self.data.ctrl.copy(), 0.0, bool(fell), False, {}


def _leant(model: mujoco.MjModel) -> mujoco.MjData:
    """Return the standing pose, leant at the lowest joints that pitch, on the ground."""
    data = standing_pose(model)
    feet = measure_robot(model, data, None, None, 0.0).feet
    bodies = [int(model.body(foot.body).id) for foot in feet]

    def soles() -> Floats:
        axes = data.xmat[bodies].reshape(-1, 3, 3)
        places = np.array([foot.position_sole_foot for foot in feet])
        return np.asarray(data.xpos[bodies] + np.einsum("fij,fj->fi", axes, places))

    com, middle = data.subtree_com[0], soles().mean(axis=0)
    middle[0] += np.mean([foot.layout(0.0)[:, 0].mean() for foot in feet])
    lean = float((middle[0] - com[0]) / (com[2] - middle[2]))
    for body, foot in zip(bodies, feet, strict=True):
        up = data.xmat[body].reshape(3, 3) @ foot.R_foot_sole[:, 2]
        joint = _ankle(model, data, body)
        data.qpos[model.jnt_qposadr[joint]] -= (np.arctan2(up[0], up[2]) + lean) / data.xaxis[joint, 1]
    turn = np.array([np.cos(lean / 2.0), 0.0, np.sin(lean / 2.0), 0.0])
    mujoco.mju_mulQuat(data.qpos[3:7], turn, data.qpos[3:7].copy())
    mujoco.mj_kinematics(model, data)
    data.qpos[2] -= soles()[:, 2].min()
    mujoco.mj_forward(model, data)
    return data


def _ankle(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> int:
    """Return the number of the lowest joint above a foot that pitches."""
    while body:
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            if abs(data.xaxis[joint, 1]) > _PITCHES:
                return joint
        body = int(model.body_parentid[body])
    raise ValueError("No joint of a leg pitches.")
