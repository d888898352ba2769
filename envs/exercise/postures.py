r"""Postures of an exercise by inverse kinematics, and the targets of the motors that hold them.

A motor with stiffness k deflects by u / k under the torque u, so that its target must lead by the same angle.
The torques follow from the equations of motion of the floating robot,
:math:`M \ddot q + c = B^T u + J_c^T \lambda + \sum_i \alpha_i J_i^T w`: each sole i bears the share
:math:`\alpha_i` of one wrench w. The six rows of the floating torso determine w, and the other rows u.
"""

from typing import Any, Final

import mink
import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.exercise.robot import ExerciseRobot, motor_moments
from surefoot.envs.instrumentation.feet import standing_pose

TOLERANCE: Final = 1e-5  # maximum error of a solution in m and rad
ITERATIONS: Final = 40  # Newton steps before a posture counts as out of reach; solutions need a few
PITCH_AXIS: Final = 0.8  # minimum lateral component of the axis of a pitch joint


class UnreachableError(ValueError):
    """A posture that the legs cannot reach."""


class Postures:
    """Postures with level soles, an upright torso and a given centre of mass.

    ``bend`` is added in rad to the knees of legs that pitch in hip, knee and ankle; ``inward`` is how far
    inside the middle of its sole the robot stands on one leg, in half widths of the sole. UnreachableError if
    the first posture is out of the legs' reach.

    ``position_sole`` are the soles' origins on the ground in m about the common origin, (2, 3), ``yaw_sole``
    their headings in rad, (2,); ``forward`` is the mean heading, ``left`` across it, ``up_torso`` the
    vertical in the torso's axes, (3,) each; ``stand`` is where the soles bear the robot in m, (2, 2), ``com``
    the centre of mass between the two in m, (3,), and ``qpos`` the posture with it, (nq,).
    """

    def __init__(self, robot: ExerciseRobot, bend: float, inward: float) -> None:
        self.robot = robot
        model, data = robot.model, standing_pose(robot.model)
        axes = np.array([data.site_xmat[site].reshape(3, 3)[:, 0] for site in robot.soles])
        place = np.array([data.site_xpos[site] for site in robot.soles])
        self.yaw_sole = np.arctan2(axes[:, 1], axes[:, 0])
        self.position_sole = (place - place.mean(axis=0)) * (1.0, 1.0, 0.0)
        heading = np.arctan2(axes[:, 1].sum(), axes[:, 0].sum())
        self.forward = np.array([np.cos(heading), np.sin(heading), 0.0])
        self.left = np.array([-np.sin(heading), np.cos(heading), 0.0])
        c, s = np.cos(self.yaw_sole), np.sin(self.yaw_sole)
        x, y = robot.centre.T
        middle = self.position_sole[:, :2] + np.stack([c * x - s * y, s * x + c * y], axis=1)
        to_other = middle[::-1] - middle
        to_other /= np.linalg.norm(to_other, axis=1, keepdims=True)
        self.stand = middle + inward * robot.half[1] * to_other

        self._data = mujoco.MjData(model)
        self._configuration = mink.Configuration(model)
        self._soles = [
            mink.FrameTask(model.site(site).name, "site", position_cost=10.0, orientation_cost=3.0)
            for site in robot.soles
        ]
        self._com = mink.ComTask(cost=10.0)
        self._upright = mink.FrameTask(
            model.body(robot.torso).name, "body", position_cost=0.0, orientation_cost=[1.0, 1.0, 0.0]
        )
        R_world_torso = data.xmat[robot.torso].reshape(3, 3)
        self.up_torso = R_world_torso[2].copy()
        self._upright.set_target(mink.SE3.from_rotation(mink.SO3.from_matrix(R_world_torso)))
        free = {*range(6), *(int(model.jnt_dofadr[joint]) for joint in np.concatenate(robot.legs))}
        still = [dof for dof in range(model.nv) if dof not in free]
        self._constraints: list[Any] = [mink.DofFreezingTask(model, dof_indices=still)] if still else []
        if model.neq:
            self._constraints.append(mink.EqualityConstraintTask(model, cost=1.0))
        self._limits = [mink.ConfigurationLimit(model)]
        bent, height = self._bent(data, bend)
        self.com = np.array([*self.stand.mean(axis=0), height])
        self.qpos = self.solve(self.com, np.zeros(2), bent)

    def solve(self, com: Floats, lift: Floats, start: Floats) -> Floats:
        """Find a posture (nq,) near another one, for a centre of mass (3,) and sole heights (2,) in m.

        UnreachableError if it is beyond the legs' reach or limits.
        """
        configuration = self._configuration
        configuration.update(start)
        for task, position, yaw, up in zip(self._soles, self.position_sole, self.yaw_sole, lift, strict=True):
            place = np.array([position[0], position[1], up])
            rotation = mink.SO3.from_z_radians(float(yaw))
            task.set_target(mink.SE3.from_rotation_and_translation(rotation, place))
        self._com.set_target(com)
        tasks = [*self._soles, self._com, self._upright]
        for _ in range(ITERATIONS):
            errors = [task.compute_error(configuration) for task in tasks]
            # The upright task does not constrain position and heading.
            errors[-1] = errors[-1][3:5]
            error = max(float(np.abs(part).max()) for part in errors)
            if error < TOLERANCE:
                return np.array(configuration.q)
            velocity = mink.solve_ik(
                configuration,
                tasks,
                1.0,
                "daqp",
                damping=1e-9,
                limits=self._limits,
                constraints=self._constraints,
            )
            configuration.integrate_inplace(velocity, 1.0)
        raise UnreachableError(
            f"The legs cannot hold the soles at {np.round(self.position_sole[:, :2], 3).tolist()} m, lifted "
            f"by {np.round(lift, 3).tolist()} m, under an upright torso with the centre of mass at "
            f"{np.round(com, 3).tolist()} m: {error:.4f} m or rad remain."
        )

    def shares(self, cop: Floats, lift: Floats) -> Floats:
        """Return shares of the load on the soles, (..., 2), for a centre of pressure in m, (..., 2).

        A sole whose height in m, (..., 2), is positive bears no load.
        """
        left, right = self.stand
        off, apart = cop - right, left - right
        share = (off[..., 0] * apart[0] + off[..., 1] * apart[1]) / (apart @ apart)
        share = np.where(lift[..., 1] > 0.0, 1.0, np.minimum(np.maximum(share, 0.0), 1.0))
        share = np.where(lift[..., 0] > 0.0, 0.0, share)
        return np.stack([share, 1.0 - share], axis=-1)

    def leads(self, qpos: Floats, slope: Floats, share: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the motors' targets in a posture on a path, with shares of the load on the soles, (2,).

        ``slope`` is the change of the posture per unit of the path's parameter, (nv,). Targets at rest, and
        their change per unit of the parameter's speed and acceleration against damping and inertia, in rad,
        rad s and rad s^2, shape (M,) each.
        """
        model, data = self.robot.model, self._data
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        moments = motor_moments(model, data)
        jacobian = np.zeros((6, model.nv))
        for i, site in enumerate(self.robot.soles):
            one = np.zeros((6, model.nv))
            point = np.array([*self.stand[i], data.site_xpos[site][2]])
            mujoco.mj_jac(model, data, one[:3], one[3:], point, int(model.site_bodyid[site]))
            jacobian += share[i] * one
        exerted = [moments]
        equality = np.flatnonzero(data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        if len(equality):
            dense = np.zeros((data.nefc, model.nv))
            if mujoco.mj_isSparse(model):
                mujoco.mju_sparse2dense(
                    dense, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind
                )
            else:
                dense[:] = data.efc_J.reshape(-1, model.nv)[: data.nefc]
            exerted.append(dense[equality])
        inertial = np.zeros(model.nv)
        mujoco.mj_mulM(model, data, inertial, slope)
        needed = np.stack([data.qfrc_bias - data.qfrc_passive, model.dof_damping * slope, inertial], 1)
        needed -= jacobian.T @ np.linalg.solve(jacobian[:, :6].T, needed[:6])
        torque = np.linalg.lstsq(np.concatenate(exerted).T, needed, rcond=None)[0][: model.nu]
        stiffness, damping = model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]
        lead = torque / np.where(stiffness > 0.0, stiffness, np.inf)[:, None]
        braked = damping * (moments @ slope) / np.where(stiffness > 0.0, stiffness, np.inf)
        return data.actuator_length + lead[:, 0], lead[:, 1] + braked, lead[:, 2]

    def _bent(self, data: mujoco.MjData, bend: float) -> tuple[Floats, float]:
        """Return a posture with flexed knees, and the height of its centre of mass above the soles."""
        model, bent = self.robot.model, self._data
        bent.qpos[:] = data.qpos
        # A keyframe that is rounded past a joint limit would make the limits infeasible.
        hinges = np.flatnonzero((model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) & (model.jnt_limited == 1))
        places = model.jnt_qposadr[hinges]
        bent.qpos[places] = np.clip(bent.qpos[places], *model.jnt_range[hinges].T)
        for leg in self.robot.legs:
            along = data.xaxis[leg] @ self.left
            pitch = np.flatnonzero(np.abs(along) > PITCH_AXIS)
            if len(pitch) == 3:
                flexion = np.array([-0.5, 1.0, -0.5]) * bend * np.sign(along[pitch])
                bent.qpos[model.jnt_qposadr[leg[pitch]]] += flexion
        mujoco.mj_kinematics(model, bent)
        mujoco.mj_comPos(model, bent)
        sole = np.mean([bent.site_xpos[site] for site in self.robot.soles], axis=0)
        qpos = bent.qpos.copy()
        qpos[:3] -= sole
        return qpos, float(bent.subtree_com[self.robot.torso][2] - sole[2])
