"""A biped that is not the package's: another robot, gait and controller than the NAO, and its truth.

It weighs 8.3 kg, has six joints a leg of other lengths, lumped arms, servos with a spring and a damper of
their own, and soles of 0.20 x 0.10 m, each a plate on four cells of unequal stiffness at uneven places.

It walks on a linear inverted pendulum. The centre of pressure p is planned piece by piece as a straight line
in time, and for such a piece the pendulum c'' = w^2 (c - p) has the solution

    c(t) = p(t) + A exp(w t) + B exp(-w t).

The divergent part A is found backwards from the end of the walk (Englsberger et al., 2015), the other
forwards. The legs follow in closed form, with the torso placed so that the drawing's centre of mass lies on
c. Commands leave at 100 Hz. Servos that hold them in between climb stairs, which are in the forces; others
go on a straight line. Ankles and hips push back when the torso tilts.
"""

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

__all__ = ["COMMAND", "PLATE_COM", "PLATE_MASS", "POSITION_CELL_SOLE", "SUBSTEP", "Run", "robot_xml", "walk"]

Floats = NDArray[np.float64]

SUBSTEP = 0.00125
"""Time in s between two moments of the simulation, and of the truth."""

COMMAND = 8
"""Substeps between two commands: 100 Hz."""

HIP, THIGH, SHIN, ANKLE = 0.060, 0.165, 0.150, 0.055
"""Half the distance of the hips, lengths of thigh and shin, and height of the ankle above the ground in m."""

HIP_DROP = 0.09
"""Height of the torso's frame above the hips in m."""

PLATE_MASS, PLATE_COM = 0.14, (0.02, 0.0, 0.003)
"""The plate below the cells: its mass in kg and centre of mass in the sole frame in m."""

POSITION_CELL_SOLE = np.array(
    [
        [[0.098, 0.041], [0.086, -0.038], [-0.056, 0.034], [-0.067, -0.043]],
        [[0.091, 0.039], [0.100, -0.042], [-0.064, 0.044], [-0.052, -0.036]],
    ]
)
"""Places of the cells of the left and the right foot in their sole frames in m."""

STIFFNESS = np.array([[1.0, 1.25, 0.85, 1.1], [1.15, 0.9, 1.2, 0.95]])
"""How stiff each cell is beside the others: it decides who carries what of a wrench."""

STEP, UNEVEN, DOUBLE = 0.55, 0.02, 0.25
"""Time in s from step to step, by how much single ones differ from it, and the share with both feet down."""

LIFT, CROUCH, FORWARD = 0.022, 0.018, 0.015
"""How high a foot is lifted, how far the stretched legs are bent, and how far before the ankles the centre of
pressure is planned, in m."""

INWARD = 0.004
"""By how much it is planned beside the ankle, towards the other foot, in m."""

ANKLES, HIPS = (0.35, 0.04), (0.25, 0.03)
"""Feedback of the torso's tilt (rad per rad) and of its rate (s) to the ankles and hips that carry."""

_LEG = """
<body name="{n}_hip" pos="0 {y} -0.09">
 <inertial pos="0 0 0" mass="0.15" diaginertia="1e-4 1e-4 1e-4"/>
 <joint name="{n}_hip_yaw" axis="0 0 1"/>
 <body name="{n}_pelvis"><inertial pos="0.005 0 -0.01" mass="0.15" diaginertia="1e-4 1e-4 1e-4"/>
  <joint name="{n}_hip_roll" axis="1 0 0"/>
  <body name="{n}_thigh"><inertial pos="0.008 {t} -0.07" mass="0.75" diaginertia="2e-3 2e-3 5e-4"/>
   <joint name="{n}_hip_pitch" axis="0 1 0"/>
   <body name="{n}_shin" pos="0 0 -0.165">
     <inertial pos="0.006 0 -0.065" mass="0.55" diaginertia="1.2e-3 1.2e-3 3e-4"/>
    <joint name="{n}_knee" axis="0 1 0"/>
    <body name="{n}_ankle" pos="0 0 -0.15"><inertial pos="0 0 0" mass="0.12" diaginertia="1e-4 1e-4 1e-4"/>
     <joint name="{n}_ankle_pitch" axis="0 1 0"/>
     <body name="{n}_foot"><inertial pos="0.015 0 -0.03" mass="0.26" diaginertia="3e-4 8e-4 9e-4"/>
      <joint name="{n}_ankle_roll" axis="1 0 0"/>
      <body name="{n}_plate" pos="0 0 -0.055">
       <inertial pos="0.02 0 0.003" mass="0.14" diaginertia="1.2e-4 4.7e-4 5.8e-4"/>
       <geom type="box" pos="0.02 0 0.004" size="0.1 0.05 0.004"/>
       <site name="{n}_sole"/>
</body></body></body></body></body></body></body>"""

_ROBOT = """
<mujoco model="second walker">
<compiler angle="radian" autolimits="true"/>
<option timestep="0.00125" integrator="Euler" cone="elliptic" gravity="0 0 -9.81">
 <flag eulerdamp="disable"/>
</option>
<default>
 <joint damping="0.25" armature="0.012" frictionloss="0.12"/>
 <geom solref="0.009 1" friction="0.8 0.01 0.001" condim="4"/>
 <position kp="420" kv="9" forcerange="-35 35"/>
</default>
<worldbody>
 <geom type="plane" size="0 0 1"/>
 <body name="torso"><freejoint/>
  <inertial pos="0.012 0.002 0.075" mass="3.25" diaginertia="0.028 0.024 0.014"/>
  <site name="imu" pos="-0.02 0.01 0.04"/>
  <body name="left_arm" pos="0.02 0.13 0.06">
   <inertial pos="0 0 -0.06" mass="0.42" diaginertia="2e-3 2e-3 3e-4"/>
  </body>
  <body name="right_arm" pos="0.02 -0.13 0.06">
   <inertial pos="0 0 -0.06" mass="0.42" diaginertia="2e-3 2e-3 3e-4"/>
  </body>
  {legs}
 </body>
</worldbody>
<actuator>{motors}</actuator>
<sensor>
 <accelerometer site="imu"/><gyro site="imu"/>
 <force site="left_sole"/><torque site="left_sole"/><force site="right_sole"/><torque site="right_sole"/>
</sensor>
</mujoco>"""

_FEET = ("left", "right")
_JOINTS = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
YAW, HIP_ROLL, HIP_PITCH, KNEE, ANKLE_PITCH, ANKLE_ROLL = range(6)


def robot_xml() -> str:
    """Return the robot on its plain as MJCF."""
    legs = (_LEG.format(n=n, y=s * HIP, t=s * 0.004) for n, s in zip(_FEET, (1, -1), strict=True))
    motors = (f'<position joint="{n}_{j}"/>' for n in _FEET for j in _JOINTS)
    return _ROBOT.format(legs="".join(legs), motors="".join(motors))


class Plan(NamedTuple):
    """A walk at the rate of the commands.

    Attributes:
        joint: Commanded angles in rad, shape (T, 12).
        down: Feet that are planned to be on the ground, shape (T, 2).
        torso: Place of the torso in m, shape (T, 3).
    """

    joint: Floats
    down: NDArray[np.bool_]
    torso: Floats


@dataclass(frozen=True, eq=False)
class Run:
    """The truth of a walk of N moments, :data:`SUBSTEP` apart.

    Attributes:
        force: Loads of the cells in N, the left foot's first, shape (N, 8).
        inertial: Specific force in m/s^2 and angular velocity in rad/s at the IMU, shape (N, 6).
        joint: Joint angles in rad, shape (N, 12).
        position_sole: Origins of the sole frames in m, shape (N, 2, 3).
        R_world_sole: Their rotations, shape (N, 2, 3, 3).
        down: Feet that are planned to be on the ground, by command, shape (T, 2).
        mass: The robot's mass in kg.
        fell: Whether it fell, which ended the walk.
    """

    force: Floats
    inertial: Floats
    joint: Floats
    position_sole: Floats
    R_world_sole: Floats
    down: NDArray[np.bool_]
    mass: float
    fell: bool


def walk(
    speed: float, duration: float, stand: float, rng: np.random.Generator, *, stairs: bool = True
) -> Run:
    """Stand, then walk straight ahead until the time is over or the robot has fallen.

    Args:
        speed: In m/s.
        duration: Standing included, in s.
        stand: How long to stand first in s.
        rng: Draws how the robot is set down, and how long every step takes.
        stairs: Whether servos hold a command until the next; else they go to it on a straight line.
    """
    model = mujoco.MjModel.from_xml_string(robot_xml())
    data = mujoco.MjData(model)
    plan = _plan(model, speed, duration, stand, rng)
    data.qpos[:3], data.qpos[7:], data.ctrl[:] = plan.torso[0], plan.joint[0], plan.joint[0]
    data.qpos[7:] += 0.002 * rng.standard_normal(12)
    count = len(plan.joint) * COMMAND
    sensed, joint = np.empty((count, model.nsensordata)), np.empty((count, 12))
    place, axes = np.empty((count, 2, 3)), np.empty((count, 2, 3, 3))
    soles = [model.site(f"{foot}_sole").id for foot in _FEET]
    fell, k = False, 0
    for target, down in zip(plan.joint, plan.down, strict=True):
        before, command = data.ctrl.copy(), target + _feedback(data, down)
        for i in range(COMMAND):
            data.ctrl[:] = command if stairs else before + (i + 1) / COMMAND * (command - before)
            joint[k] = data.qpos[7:]
            mujoco.mj_step(model, data)  # sensors and frames are those of before the step
            sensed[k], place[k] = data.sensordata, data.site_xpos[soles]
            axes[k] = data.site_xmat[soles].reshape(2, 3, 3)
            k += 1
        fell = data.qpos[2] < 0.75 * plan.torso[0, 2]
        if fell:
            break
    return Run(
        force=_cells(sensed[:k, 6:].reshape(k, 2, 6)),
        inertial=sensed[:k, :6],
        joint=joint[:k],
        position_sole=place[:k],
        R_world_sole=axes[:k],
        down=plan.down,
        mass=float(model.body_mass.sum()),
        fell=bool(fell),
    )


def _cells(wrench: Floats) -> Floats:
    """Divide the plates' loads, without their weight at rest, among the cells, shape (N, 8).

    A stiff plate that moves by u under its springs, F_i = k_i a_i u with a_i = (1, y_i, -x_i), carries
    (fz, tx, ty) = sum a_i F_i.
    """
    forces = []
    for foot in range(2):
        x, y = POSITION_CELL_SOLE[foot].T
        arms = np.stack([np.ones(4), y, -x])
        shares = STIFFNESS[foot][:, None] * arms.T @ np.linalg.inv(arms * STIFFNESS[foot] @ arms.T)
        weight = 9.81 * PLATE_MASS * np.array([1.0, PLATE_COM[1], -PLATE_COM[0]])
        forces.append((weight - wrench[:, foot, 2:5]) @ shares.T)  # MuJoCo: of the foot on the plate
    return np.hstack(forces)


def _feedback(data: mujoco.MjData, down: NDArray[np.bool_]) -> Floats:
    """Angles that ankles and hips of the feet on the ground add to bring the torso upright."""
    w, x, y, z = data.qpos[3:7]
    roll, pitch = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), np.arcsin(2 * (w * y - z * x))
    tilt = np.array([roll, pitch])
    rate = data.qvel[3:5]
    ankle, hip = (gain * tilt + damping * rate for gain, damping in (ANKLES, HIPS))
    added = np.zeros((2, 6))
    added[:, [ANKLE_ROLL, ANKLE_PITCH]], added[:, [HIP_ROLL, HIP_PITCH]] = ankle, hip
    return (added * down[:, None]).ravel()


def _plan(
    model: mujoco.MjModel, speed: float, duration: float, stand: float, rng: np.random.Generator
) -> Plan:
    time = np.arange(round(duration / (SUBSTEP * COMMAND))) * SUBSTEP * COMMAND
    height = THIGH + SHIN + ANKLE - CROUCH
    soles, down, knots, cop = _footsteps(time, speed, stand, rng)
    data = mujoco.MjData(model)
    data.qpos[:7] = 0.0, 0.0, height + HIP_DROP, 1.0, 0.0, 0.0, 0.0
    data.qpos[7:] = _legs(data.qpos[None, :3], soles[:1])[0]
    mujoco.mj_forward(model, data)
    com_height = float(data.subtree_com[1, 2])
    com = _pendulum(time, knots, cop, np.sqrt(9.81 / com_height))
    torso = np.column_stack([com, np.full(len(time), height + HIP_DROP)])
    for _ in range(3):
        joint = _legs(torso, soles)
        for k in range(len(time)):
            data.qpos[:3], data.qpos[7:] = torso[k], joint[k]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            torso[k, :2] += com[k] - data.subtree_com[1, :2]
    return Plan(_legs(torso, soles), down, torso)


def _footsteps(
    time: Floats, speed: float, stand: float, rng: np.random.Generator
) -> tuple[Floats, NDArray[np.bool_], Floats, Floats]:
    """Return soles (T, 2, 3), which are down (T, 2), and corners of the planned CoP: times and places."""
    soles, down = np.zeros((len(time), 2, 3)), np.ones((len(time), 2), dtype=bool)
    soles[:, :, 1] = HIP, -HIP
    at = soles[0].copy()
    knots, cop = [0.0, stand], [[FORWARD, 0.0], [FORWARD, 0.0]]
    begin, carrying = stand + 1.0, 0
    while begin < time[-1] + 2.0:
        step = STEP + UNEVEN * rng.uniform(-1.0, 1.0)
        end = begin + step * (1.0 - DOUBLE)
        side = 1.0 - 2.0 * carrying
        under = [at[carrying, 0] + FORWARD, at[carrying, 1] - side * INWARD]
        knots, cop = [*knots, begin, end], [*cop, under, under]
        swinging = 1 - carrying
        to = at[carrying, 0] + speed * step
        during = (time >= begin) & (time < end)
        s = (time[during] - begin) / (end - begin)
        smooth = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        soles[during, swinging, 0] = at[swinging, 0] + smooth * (to - at[swinging, 0])
        soles[during, swinging, 2] = LIFT * 64.0 * (s * (1.0 - s)) ** 3
        soles[time >= end, swinging, 0] = to
        down[during, swinging] = False
        at[swinging, 0] = to
        begin, carrying = begin + step, swinging
    return soles, down, np.array(knots), np.array(cop)


def _pendulum(time: Floats, knots: Floats, cop: Floats, w: float) -> Floats:
    """Return the centre of mass over the planned CoP, shape (T, 2)."""
    length = np.diff(knots)
    slope = np.diff(cop, axis=0) / length[:, None]
    capture = np.empty_like(cop)
    capture[-1] = cop[-1]
    for i in reversed(range(len(length))):
        ahead = capture[i + 1] - cop[i + 1] - slope[i] / w
        capture[i] = cop[i] + slope[i] / w + np.exp(-w * length[i]) * ahead
    com = np.empty_like(cop)
    com[0] = cop[0]
    growing = 0.5 * (capture[:-1] - cop[:-1] - slope / w)
    decaying = np.empty_like(slope)
    for i, span in enumerate(length):
        decaying[i] = com[i] - cop[i] - growing[i]
        com[i + 1] = cop[i + 1] + growing[i] * np.exp(w * span) + decaying[i] * np.exp(-w * span)
    i = np.searchsorted(knots, time, side="right") - 1
    t = (time - knots[i])[:, None]
    return cop[i] + slope[i] * t + growing[i] * np.exp(w * t) + decaying[i] * np.exp(-w * t)


def _legs(torso: Floats, soles: Floats) -> Floats:
    """Return the joints, shape (T, 12), that put level soles (T, 2, 3) below an upright torso (T, 3)."""
    joint = np.zeros((len(soles), 2, 6))
    for foot, side in enumerate((1.0, -1.0)):
        x, y, z = (soles[:, foot] + (0.0, 0.0, ANKLE) - torso - (0.0, side * HIP, -HIP_DROP)).T
        down = np.hypot(y, z)
        far = np.minimum(np.hypot(x, down), THIGH + SHIN - 1e-4)
        bent = np.arccos((far**2 - THIGH**2 - SHIN**2) / (2.0 * THIGH * SHIN))
        thigh = np.arctan2(-x, down) - np.arctan2(SHIN * np.sin(bent), THIGH + SHIN * np.cos(bent))
        roll = np.arctan2(y, -z)
        joint[:, foot, HIP_ROLL], joint[:, foot, ANKLE_ROLL] = roll, -roll
        joint[:, foot, HIP_PITCH], joint[:, foot, KNEE] = thigh, bent
        joint[:, foot, ANKLE_PITCH] = -(thigh + bent)
    return joint.reshape(len(soles), 12)
