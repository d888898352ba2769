r"""Feedback of the capture point to the ankles, which keeps the centre of mass on its plan.

The capture point :math:`\xi = c + \dot c \sqrt{h / g}` is unstable (c is the centre of mass, h its height).
Without feedback only the stiffness of the ankle motors holds it, reduced by the compliance of the contacts
and of the other joints, which may not suffice on one foot. The ankles therefore shift the centre of pressure
by :math:`\Delta p = k (\xi - \xi_{plan})`, within the sole.
"""

from math import sqrt
from typing import Final

import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.command import Command
from surefoot.envs.exercise.motion import Motion
from surefoot.envs.exercise.robot import ExerciseRobot, motor_moments
from surefoot.envs.instrumentation.truth import FeetTruth

GAIN: Final = 1.0
"""Shift of the centre of pressure in m per metre of the capture point's error; chosen."""


class AnkleBalance:
    """Map from an error of the capture point to a correction of the motors' targets."""

    def __init__(self, robot: ExerciseRobot, motion: Motion) -> None:
        self._motion = motion
        self._half = robot.half
        self._time = sqrt(motion.height / robot.gravity)
        model, data = robot.model, mujoco.MjData(robot.model)
        data.qpos[:] = motion.qpos
        mujoco.mj_forward(model, data)
        moments = motor_moments(model, data)
        stiffness = model.actuator_gainprm[robot.leg_motors, :1]
        of_shift = []
        for leg in robot.legs:
            torque = np.zeros((model.nv, 2))
            for joint in leg[-2:]:
                # The ground's moment on a foot about (x, y) is (shift_y, -shift_x) times its load.
                x, y, _ = data.xaxis[joint]
                torque[model.jnt_dofadr[joint]] = robot.weight * y, -robot.weight * x
            exerted = np.linalg.lstsq(moments[robot.leg_motors].T, torque, rcond=None)[0]
            of_shift.append(exerted / stiffness)
        self._left, self._right = np.array(of_shift).swapaxes(-1, -2)

    def correction(self, truth: FeetTruth, command: Command) -> Floats:
        """Return the correction of leg motors' targets in rad for the last row of truth, shape (..., L)."""
        share = self._motion.shares(command)
        left, right = share[..., :1], share[..., 1:]
        slid = (truth.position_sole[..., -1, :, :] - command.position_sole)[..., :2]
        error = truth.com[..., -1, :2] - command.com[..., :2]
        error -= left * slid[..., 0, :] + right * slid[..., 1, :]
        error += self._time * (truth.com_velocity[..., -1, :2] - command.com_velocity[..., :2])
        shift = np.minimum(np.maximum(GAIN * error, -self._half), self._half)
        forward, aside = shift[..., :1], shift[..., 1:]
        corrected: Floats = left * (forward * self._left[0] + aside * self._left[1])
        corrected += right * (forward * self._right[0] + aside * self._right[1])
        return corrected
