"""The ground forces and motor torques that a planned motion of the whole robot requires.

Newton and Euler for the whole body, with the centre of mass c, the angular momentum L about it and the ground
at height zero, give the centre of pressure:

    Fz = M (z'' + g),    px = x - [z M x'' + L_y'] / Fz,    py = y - [z M y'' - L_x'] / Fz.

Inverse dynamics, with the ground's reaction shared between the feet as the planned centre of pressure says,
gives the torques.
"""

import copy

import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.robots.nao import motor_names

ARM_OF_TORQUE = 0.01
"""Torque in N m that weighs as much as a force of 1 N where both feet share a wrench.

Small: the feet shall share forces rather than twist against each other.
"""


def joint_velocities(model: mujoco.MjModel, qpos: Floats, dt: float) -> Floats:
    """Differentiate postures, shape (ticks, nq), by central differences to velocities, shape (ticks, nv).

    They are at rest before the first and after the last; ``dt`` s lie between two.
    """
    qvel = np.empty((len(qpos), model.nv))
    last = len(qpos) - 1
    for k in range(len(qpos)):
        mujoco.mj_differentiatePos(model, qvel[k], 2 * dt, qpos[max(k - 1, 0)], qpos[min(k + 1, last)])
    return qvel


def multibody_zmp(model: mujoco.MjModel, qpos: Floats, dt: float) -> Floats:
    """Compute the zero-moment point of a motion on the ground, shape (ticks, 2), in m by central differences.

    Postures, shape (ticks, nq), are at rest before the first and after the last; body 1 is the tree's root.
    """
    data = mujoco.MjData(model)
    com, momentum = np.empty((len(qpos), 3)), np.empty((len(qpos), 3))
    for k, qvel in enumerate(joint_velocities(model, qpos, dt)):
        data.qpos[:] = qpos[k]
        data.qvel[:] = qvel
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        com[k] = data.subtree_com[1]
        momentum[k] = data.subtree_angmom[1]
    mass = float(model.body_subtreemass[1])
    acceleration: Floats = np.diff(com, n=2, axis=0, prepend=com[:1], append=com[-1:]) / dt**2
    spin = _rate(momentum, dt)
    force = mass * (acceleration[:, 2] - model.opt.gravity[2])
    height = com[:, 2]
    x = com[:, 0] - (height * mass * acceleration[:, 0] + spin[:, 1]) / force
    y = com[:, 1] - (height * mass * acceleration[:, 1] - spin[:, 0]) / force
    return np.stack([x, y], axis=1)


def joint_torques(model: mujoco.MjModel, qpos: Floats, cop_foot: Floats, share: Floats, dt: float) -> Floats:
    """Find the torques of a motion with its feet on the ground in N m, shape (ticks, nv).

    They are what the motors have to supply besides friction and damping, which are counted in; zero for the
    floating torso up to rounding. While both feet carry, their wrenches are not determined by the motion: the
    one taken is the smallest, each foot's weighed by its ``share`` of the load, shape (ticks, 2), of which
    one is positive.

    The model has bodies ``left_plate`` and ``right_plate``; postures, (ticks, nq), each ``dt`` s, rest before
    the first and after the last; ``cop_foot`` is where each foot is to carry, in the world in m, (ticks, 2,
    2).
    """
    free = copy.copy(model)
    free.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(free)
    plates = [free.body(f"{foot}_plate").id for foot in ("left", "right")]
    qvel = joint_velocities(free, qpos, dt)
    qacc = _rate(qvel, dt)
    ease = np.repeat([1.0, ARM_OF_TORQUE**2], 3)
    jacobian = np.zeros((2, 6, free.nv))
    torque = np.empty_like(qvel)
    for k in range(len(qpos)):
        data.qpos[:], data.qvel[:], data.qacc[:] = qpos[k], qvel[k], qacc[k]
        mujoco.mj_inverse(free, data)
        for foot, plate in enumerate(plates):
            point = np.append(cop_foot[k, foot], 0.0)
            mujoco.mj_jac(free, data, jacobian[foot, :3], jacobian[foot, 3:], point, plate)
        feet = jacobian.reshape(12, free.nv)
        root = feet[:, :6].T
        weight = np.outer(share[k], ease).ravel()
        wrench = weight * (root.T @ np.linalg.solve((root * weight) @ root.T, data.qfrc_inverse[:6]))
        torque[k] = data.qfrc_inverse - wrench @ feet
    return torque


def motor_targets(model: mujoco.MjModel, qpos: Floats, qvel: Floats, torque: Floats) -> Floats:
    """Lead a motion to make up for servos that give way and lag behind: targets in rad, shape (ticks, M).

    A servo pulls with kp (target - q) - kv q', so that target = q + (torque + kv q') / kp. Postures,
    velocities and torques in N m have shapes (ticks, nq) and (ticks, nv). Each motor is named after the joint
    that it turns; LHipYawPitch turns the right one as well.
    """
    target = np.empty((len(qpos), model.nu))
    for motor, name in enumerate(motor_names(model)):
        kp, kv = model.actuator_gainprm[motor, 0], -model.actuator_biasprm[motor, 2]
        joint = model.joint(name)
        load = torque[:, int(joint.dofadr[0])]
        if name == "LHipYawPitch":
            load = load + torque[:, int(model.joint("RHipYawPitch").dofadr[0])]
        target[:, motor] = qpos[:, int(joint.qposadr[0])] + (load + kv * qvel[:, int(joint.dofadr[0])]) / kp
    return target


def _rate(values: Floats, dt: float) -> Floats:
    """Differentiate along the first axis by central differences; a single row is at rest."""
    if len(values) == 1:
        return np.zeros_like(values)
    rate: Floats = np.gradient(values, dt, axis=0)
    return rate
