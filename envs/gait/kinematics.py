"""From where the feet and the centre of mass should be to the joints' angles.

Newton's method on the errors and Jacobians of :mod:`mink`. Two legs with one common hip-yaw-pitch motor have
eleven degrees of freedom and the floating torso six; both soles (12), the centre of mass (3) and an upright
torso (2) use up all seventeen: nothing is left to a posture, and a step is one small linear system. The
torso's heading follows from the common motor, which turns both legs outward alike: it is near the mean
heading of the soles.
"""

from typing import NamedTuple

import mink
import mujoco
import numpy as np

from surefoot.arrays import Floats

TOLERANCE = 2e-6  # largest error left in m and rad
ITERATIONS = 30  # Newton steps before a posture counts as out of reach; a few suffice

DAMPING = 1e-9  # keeps a step finite where a leg is stretched; the costs of the tasks are 3 and more
MEMO_GRID = 1e-6  # postures whose feet and centre of mass agree to this, in m and rad, are solved once
ARM_AND_HEAD_JOINTS = ("Head", "Shoulder", "Elbow", "Wrist")

# Of the errors of both soles (position, orientation), the centre of mass and the torso's orientation.
_PLACES = [0, 1, 2, 6, 7, 8, 12, 13, 14]
_ANGLES = [3, 4, 5, 9, 10, 11, 18, 19]


class JointTrack(NamedTuple):
    """Postures over time."""

    qpos: Floats  # generalised positions, floating torso first, shape (ticks, nq)
    error: float  # largest remaining error of a sole's or the centre of mass's position, in m


class WholeBodyKinematics:
    """Inverse kinematics of a biped with given soles, level unless a pitch is given, and an upright torso.

    The model has sites ``left_sole`` and ``right_sole``, a body ``torso`` on a free joint, and a keyframe
    ``stand`` to start from; the arms and the head stay as they are there.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self._configuration = mink.Configuration(model)
        self._soles = [
            mink.FrameTask(site, "site", position_cost=10.0, orientation_cost=3.0)
            for site in ("left_sole", "right_sole")
        ]
        self._com = mink.ComTask(cost=10.0)
        self._upright = mink.FrameTask("torso", "body", position_cost=0.0, orientation_cost=[1.0, 1.0, 0.0])
        self._tasks = (*self._soles, self._com, self._upright)
        self._cost = np.concatenate([task.cost for task in self._tasks])
        # Motion of all joints by motion of the free ones: the arms and the head rest, the hips' yaw is one.
        joints = range(model.njnt)
        still = [
            joint for joint in joints if any(word in model.joint(joint).name for word in ARM_AND_HEAD_JOINTS)
        ]
        follows = {int(one): int(other) for one, other in zip(model.eq_obj1id, model.eq_obj2id, strict=True)}
        self._motion = np.eye(model.nv)
        for one, other in follows.items():
            self._motion[model.jnt_dofadr[one], model.jnt_dofadr[other]] = 1.0
        self._motion = np.delete(self._motion, model.jnt_dofadr[[*still, *follows]], axis=1)
        hinge = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
        self._angles, self._range = model.jnt_qposadr[hinge], model.jnt_range[hinge].T

    def solve(
        self,
        com: Floats,
        position_sole: Floats,
        yaw_sole: Floats,
        start: Floats | None = None,
        pitch_sole: Floats | None = None,
    ) -> tuple[Floats, float]:
        """Find the posture, (nq,), of some places, and the largest remaining error of a position in m.

        Places are the centre of mass, (3,), the soles' origins, (2, 3), in m, their headings, (2,), and their
        pitch in rad, positive toe down, (2,), level when not given; the posture to start from, (nq,), is the
        keyframe ``stand`` when not given. ValueError if it is out of the legs' reach or limits.
        """
        if start is None:
            self._configuration.update_from_keyframe("stand")
        else:
            self._configuration.update(start)
        tilt = np.zeros(2) if pitch_sole is None else pitch_sole
        for task, position, yaw, pitch in zip(self._soles, position_sole, yaw_sole, tilt, strict=True):
            rotation = mink.SO3.from_z_radians(float(yaw))
            if pitch != 0.0:
                rotation = rotation @ mink.SO3.from_y_radians(float(pitch))
            task.set_target(mink.SE3.from_rotation_and_translation(rotation, position))
        self._com.set_target(com)
        self._upright.set_target(mink.SE3.from_rotation(mink.SO3.from_z_radians(float(np.mean(yaw_sole)))))
        for _ in range(ITERATIONS):
            error = np.concatenate([task.compute_error(self._configuration) for task in self._tasks])
            place, angle = np.abs(error[_PLACES]).max(), np.abs(error[_ANGLES]).max()
            if max(place, angle) < TOLERANCE:
                return self._configuration.q.copy(), float(place)
            jacobian = np.concatenate([task.compute_jacobian(self._configuration) for task in self._tasks])
            weighted = self._cost[:, None] * (jacobian @ self._motion)
            normal = weighted.T @ weighted
            normal.flat[:: len(normal) + 1] += DAMPING
            step = self._motion @ np.linalg.solve(normal, -weighted.T @ (self._cost * error))
            posture = self._configuration.integrate(step, 1.0)
            posture[self._angles] = posture[self._angles].clip(*self._range)
            self._configuration.update(posture)
        raise ValueError(
            f"The legs cannot place the soles at {np.round(position_sole, 4).tolist()} m, headings "
            f"{np.round(yaw_sole, 4).tolist()} rad, under a centre of mass at {np.round(com, 4).tolist()} m: "
            f"{1e3 * place:.2f} mm remain. Walk or turn more slowly, or lower the centre of mass."
        )

    def track(
        self, com: Floats, position_sole: Floats, yaw_sole: Floats, pitch_sole: Floats | None = None
    ) -> JointTrack:
        """Find the postures of a motion, each started from the one before.

        A posture depends on where things are relative to the left sole, not on where in the world that is. A
        steady walk repeats itself in these terms, so that each posture of its cycle is solved once. Arguments
        and errors are those of :meth:`solve`, with ticks in front.
        """
        heading = yaw_sole[:, 0]
        cosine, sine = np.cos(heading), np.sin(heading)
        origin = np.concatenate([position_sole[:, 0, :2], np.zeros((len(com), 1))], axis=1)
        R_world_left = np.zeros((len(com), 3, 3))
        R_world_left[:, 0, 0] = R_world_left[:, 1, 1] = cosine
        R_world_left[:, 1, 0], R_world_left[:, 0, 1] = sine, -sine
        R_world_left[:, 2, 2] = 1.0
        com_left = np.einsum("kji,kj->ki", R_world_left, com - origin)
        sole_left = np.einsum("kji,kfj->kfi", R_world_left, position_sole - origin[:, None])
        yaw_left = yaw_sole - heading[:, None]
        pitch = np.zeros_like(yaw_sole) if pitch_sole is None else pitch_sole
        keys = np.round(
            np.concatenate([com_left, sole_left.reshape(len(com), 6), yaw_left, pitch], axis=1) / MEMO_GRID
        ).astype(np.int64)

        solved: dict[bytes, Floats] = {}
        qpos = np.empty((len(com), self.model.nq))
        worst, last = 0.0, None
        for k, key in enumerate(map(np.ndarray.tobytes, keys)):
            if key not in solved:
                solved[key], error = self.solve(com_left[k], sole_left[k], yaw_left[k], last, pitch[k])
                worst = max(worst, error)
            last = solved[key]
            qpos[k] = last
        qpos[:, :3] = np.einsum("kij,kj->ki", R_world_left, qpos[:, :3]) + origin
        qpos[:, 3:7] = _turn(heading, qpos[:, 3:7])
        return JointTrack(qpos, worst + MEMO_GRID)


def _turn(yaw: Floats, quaternion: Floats) -> Floats:
    """Turn orientations, shape (ticks, 4) as (w, x, y, z), by ``yaw`` about the vertical, shape (ticks,)."""
    c, s = np.cos(yaw / 2), np.sin(yaw / 2)
    w, x, y, z = quaternion.T
    return np.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], axis=1)
