r"""Keeping the centre of mass over its plan with the ankles.

The capture point :math:`\xi = c + \dot c \sqrt{h / g}` tips (c centre of mass, h its height). Motors alone
hold it against gravity with the ankle's stiffness less the loss in soft contacts and the other joints, which
may be too little on one foot; so the ankles push the ground's reaction beyond its error,
:math:`\Delta p = k (\xi - \xi_{plan})`, within the sole.
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
"""How far the ankles push the centre of pressure per metre of the capture point's error, in m."""


class AnkleBalance:
    """Turns an error of the capture point into a correction of the motors' targets."""

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
        """Answer the last row of truth with a correction of leg motors' targets in rad, shape (..., L)."""
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
