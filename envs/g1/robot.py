r"""A Unitree G1 that stands on both legs: its model, its postures, and what it believes about its balance.

The robot is the MuJoCo Menagerie's, with its published servos. Arms and waist are held in a carrying pose, so
that twelve leg joints remain, and only the spheres under the feet touch anything.

Positions are in the level frame midway between the soles' origins, x forward and y to the left, in m.
"""

from typing import Final, NamedTuple

import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.exercise.postures import Postures, UnreachableError
from surefoot.envs.exercise.robot import ExerciseRobot, prepare_robot
from surefoot.envs.robots.library import load_robot_spec

FEET: Final = ("left_ankle_roll_link", "right_ankle_roll_link")
TIMESTEP: Final = 0.004  # of the simulation in s

ARMS: Final = {
    "left_shoulder_pitch_joint": -0.35,
    "left_shoulder_roll_joint": 0.18,
    "left_elbow_joint": 0.5,
    "right_shoulder_pitch_joint": -0.35,
    "right_shoulder_roll_joint": -0.18,
    "right_elbow_joint": 0.5,
}
"""Angles in rad of the arms in front of the body. Other joints of the arms and the waist are held at zero."""

STRADDLE: Final = 0.06  # angle in rad by which the legs are spread, so that the soles are 16 cm apart
BEND: Final = 0.6  # flexion of the knees in rad, which leaves the legs room to reach in every direction
GRID: Final = (np.linspace(-0.10, 0.10, 9), np.linspace(-0.12, 0.12, 9))
"""Places of the centre of mass from the middle of the support in m for which postures are tabulated."""

LIFTS: Final = np.linspace(0.0, 0.05, 5)  # heights in m of the lifted foot for which postures are tabulated


def g1_spec(*, drawn: bool) -> mujoco.MjSpec:
    """Return the description of the robot; one that is not drawn has no meshes."""
    spec = load_robot_spec("g1")
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH and not drawn:
            spec.delete(geom)
        elif geom.name != "floor" and geom.type != mujoco.mjtGeom.mjGEOM_SPHERE:
            geom.contype = geom.conaffinity = 0
    for part in [*spec.keys, *([] if drawn else spec.meshes)]:
        spec.delete(part)
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE or joint.name.split("_")[1] in ("hip", "knee", "ankle"):
            continue
        for actuator in list(spec.actuators):
            if actuator.target == joint.name:
                spec.delete(actuator)
        turn, pose = np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, np.array(joint.axis, dtype=np.float64), ARMS.get(joint.name, 0.0))
        mujoco.mju_mulQuat(pose, np.array(joint.parent.quat, dtype=np.float64), turn)
        joint.parent.quat = pose
        spec.delete(joint)
    model = spec.compile()
    stand = np.zeros(model.nq)
    stand[2:4] = 0.79, 1.0  # height of the pelvis in m, and an upright attitude
    for side, sign in (("left", 1.0), ("right", -1.0)):
        stand[model.joint(f"{side}_hip_roll_joint").qposadr] = -sign * STRADDLE
        stand[model.joint(f"{side}_ankle_roll_joint").qposadr] = sign * STRADDLE
    spec.add_key(name="stand", qpos=stand)
    return spec


class Measured(NamedTuple):
    """What a robot measures of itself."""

    joints: Floats  # angles in rad, shape (12,), the left leg first, from hip to ankle
    joint_speeds: Floats  # in rad/s, shape (12,)
    tilt: Floats  # roll and pitch of the pelvis in rad, shape (2,)
    gyroscope: Floats  # in rad/s in the pelvis's axes, shape (3,)


class Stance(NamedTuple):
    """Where the robot is commanded to be."""

    com: Floats  # centre of mass in m, shape (2,)
    com_velocity: Floats  # in m/s, shape (2,)
    lift: Floats  # heights of both feet in m, shape (2,)


class StandingG1:
    """The robot, motors' targets for places of its centre of mass, and its balance by what it can measure.

    Attributes:
        robot: The compiled robot with its sensors.
        qpos: The posture in the middle of the support, shape (nq,).
        middle: The middle of the support in m, shape (2,).
        half: Half the length and width of the support in m, shape (2,).
        stand: The middles of both soles in m, shape (2, 2), the left one first.
        time: Time constant sqrt(h / g) in s with which the robot tips.
    """

    def __init__(self, *, drawn: bool) -> None:
        self.robot: ExerciseRobot = prepare_robot(g1_spec(drawn=drawn), FEET)
        postures = Postures(self.robot, BEND, 0.0)
        self.qpos, self.stand = postures.qpos, postures.stand
        self.middle = postures.com[:2]
        self.half = self.robot.half + np.array([0.0, abs(self.stand[0, 1])])
        self.time = float(np.sqrt(postures.com[2] / self.robot.gravity))
        self._position_sole = postures.position_sole[:, :2]
        self._both, self._one = _both_feet(postures), [_one_foot(postures, foot) for foot in (0, 1)]
        self._believed = mujoco.MjData(self.robot.model)
        # A shift of the centre of pressure by 1 m takes the foot's load times 1 m at its ankle, which a servo
        # exerts when its target is off by the torque over its stiffness. Pitch moves x, and roll moves -y.
        self._per_shift = np.zeros((12, 2))
        self._per_shift[[4, 10], 0], self._per_shift[[5, 11], 1] = 1.0, -1.0
        self._per_shift *= self.robot.weight / self.robot.model.actuator_gainprm[:, :1]

    def targets(self, stance: Stance) -> Floats:
        """Return the motors' targets in rad, shape (12,), that hold a posture of the unloaded robot.

        While a foot is lifted, the centre of mass is over the middle of the other sole.
        """
        if stance.lift.any():
            up = int(stance.lift[1] > 0.0)
            return _interpolate(self._one[up], [(LIFTS, stance.lift[up])])
        return _interpolate(self._both, list(zip(GRID, stance.com - self.middle, strict=True)))

    def _shares(self, stance: Stance) -> tuple[float, float]:
        """Return how much of the load each foot is to bear."""
        (_, y), (_, other) = self.stand
        left = min(max((float(stance.com[1]) - other) / (y - other), 0.0), 1.0)
        left = 0.0 if stance.lift[0] > 0.0 else 1.0 if stance.lift[1] > 0.0 else left
        return left, 1.0 - left

    def believe(self, measured: Measured, stance: Stance) -> tuple[Floats, Floats]:
        """Return the believed centre of mass in m and its velocity in m/s, shape (2,) each.

        It believes that the soles that bear it stand where they should, and that it carries nothing.
        """
        model, data, (roll, pitch) = self.robot.model, self._believed, measured.tilt / 2.0
        data.qpos[:3], data.qpos[7:] = 0.0, measured.joints
        about_y = np.array([np.cos(pitch), 0.0, np.sin(pitch), 0.0])
        about_x = np.array([np.cos(roll), np.sin(roll), 0.0, 0.0])
        mujoco.mju_mulQuat(data.qpos[3:7], about_y, about_x)
        data.qvel[:3], data.qvel[3:6], data.qvel[6:] = 0.0, measured.gyroscope, measured.joint_speeds
        for evaluate in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel, mujoco.mj_subtreeVel):
            evaluate(model, data)
        com = data.subtree_com[self.robot.torso, :2].copy()
        com_velocity = data.subtree_linvel[self.robot.torso, :2].copy()
        shares, velocity = self._shares(stance), np.zeros(6)
        for sole, place, share in zip(self.robot.soles, self._position_sole, shares, strict=True):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, sole, velocity, 0)
            com -= share * (data.site_xpos[sole, :2] - place)
            com_velocity -= share * velocity[3:5]
        return com, com_velocity

    def balance(self, believed: tuple[Floats, Floats], stance: Stance) -> Floats:
        r"""Return how the motors' targets answer an error of the centre of mass, in rad, shape (12,).

        The ankles move the centre of pressure with the error of the capture point
        :math:`c + \dot c \sqrt{h / g}` (c centre of mass, h its height), as far as the soles reach.
        """
        com, com_velocity = believed
        shift = com - stance.com + self.time * (com_velocity - stance.com_velocity)
        shift = np.minimum(np.maximum(shift, -self.robot.half), self.robot.half)
        answer: Floats = np.repeat(self._shares(stance), 6) * (self._per_shift @ shift)
        return answer


def _both_feet(postures: Postures) -> Floats:
    """Tabulate targets over places of the centre of mass, shape (9, 9, 12).

    A place that the legs do not reach has the targets of its neighbour closer to the middle.
    """
    middle, (along, across) = len(GRID[1]) // 2, GRID
    table = np.empty((len(along), len(across), postures.robot.model.nu))
    for i, x in enumerate(along):
        for side in (range(middle, len(across)), range(middle, -1, -1)):
            qpos = postures.qpos
            for j in side:
                com = postures.com + np.array([x, across[j], 0.0])
                try:
                    qpos = postures.solve(com, np.zeros(2), qpos)
                except UnreachableError:
                    table[i, j] = table[i, j - int(np.sign(j - middle))]
                    continue
                table[i, j] = _targets(postures, qpos, com, np.zeros(2))
    return table


def _one_foot(postures: Postures, up: int) -> Floats:
    """Tabulate targets over heights of a lifted foot, shape (5, 12), with the robot over the other one."""
    com = np.array([*postures.stand[1 - up], postures.com[2]])
    qpos, table = postures.solve(com, np.zeros(2), postures.qpos), []
    for height in LIFTS:
        # The lowest height is that of a foot that just leaves the ground, and bears nothing.
        lift = max(height, 1e-4) * (np.arange(2) == up)
        qpos = postures.solve(com, lift, qpos)
        table.append(_targets(postures, qpos, com, lift))
    return np.array(table)


def _targets(postures: Postures, qpos: Floats, com: Floats, lift: Floats) -> Floats:
    """Return the motors' targets that hold a posture at rest, shape (12,)."""
    still = np.zeros(postures.robot.model.nv)
    targets, _, _ = postures.leads(qpos, still, postures.shares(com[:2], lift))
    return targets


def _interpolate(table: Floats, places: list[tuple[Floats, float]]) -> Floats:
    """Interpolate linearly in the first axes of a table; beyond a grid its end counts."""
    for grid, place in places:
        steps = min(max((place - grid[0]) / (grid[1] - grid[0]), 0.0), len(grid) - 1.0)
        i = min(int(steps), len(grid) - 2)
        table = table[i] + (steps - i) * (table[i + 1] - table[i])
    return table
