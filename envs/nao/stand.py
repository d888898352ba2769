"""The robot stands still, or sways."""

from collections.abc import Sequence
from math import cos, pi, sin
from typing import Any

import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.command import Command
from surefoot.envs.nao.env import CONTROL_STEP, NaoEnv
from surefoot.envs.options import numbers_of, positive
from surefoot.envs.robots.nao import FEET, place_on_ground

LEG_LENGTH = 0.2029  # thigh and tibia in m
LARGEST_SWAY = 0.065  # largest sway in m that keeps the robot over its feet


class NaoStandEnv(NaoEnv):
    """Stand on both feet without falling; actions, observations and reward are :class:`NaoEnv`'s.

    Args:
        sway: Amplitudes (forward, left) of a sine by which the pelvis sways over the feet, in m, forward and
            left first; zero to stand still. The feet stay flat and the torso upright. It fades in over the
            first period.
        sway_period: Period of the sway in s.
        **options: Of :class:`NaoEnv`.

    Raises:
        ValueError: If an option is out of its range, naming it.
    """

    def __init__(
        self, *, sway: Sequence[float] = (0.0, 0.0), sway_period: float = 4.0, **options: Any
    ) -> None:
        amplitude = numbers_of(sway)
        if len(amplitude) != 2 or not all(abs(part) <= LARGEST_SWAY for part in amplitude):
            raise ValueError(
                f"'sway' must be amplitudes (forward, left) of at most {LARGEST_SWAY} m, which keep the "
                f"robot over its feet; got {sway!r}."
            )
        super().__init__(**options)
        self._sway = amplitude
        self._rate = 2.0 * pi / positive("sway_period", sway_period)
        motor = {name: i for i, name in enumerate(self.motor_names)}
        # A positive ankle pitch turns the toes down, or, with the sole on the ground, the leg backwards.
        self._swaying = np.zeros((2, len(motor)))
        for joint, axis, sign in (
            ("AnklePitch", 0, -1.0),
            ("HipPitch", 0, 1.0),
            ("AnkleRoll", 1, 1.0),
            ("HipRoll", 1, -1.0),
        ):
            self._swaying[axis, [motor[side + joint] for side in "LR"]] = sign
        self._posture = self.model.key("stand").ctrl.copy()
        self._height = LEG_LENGTH * cos(self._posture[motor["LAnklePitch"]])
        self._com, self._position_sole = self._stand(self._posture)
        pelvis = 0.01
        # How far the centre of mass follows the pelvis, forward and left.
        self._follow = [
            float((self._stand(self._lean(*shift))[0] - self._com)[axis]) / pelvis
            for axis, shift in enumerate([(pelvis, 0.0), (0.0, pelvis)])
        ]
        self._gravity = -float(self.model.opt.gravity[2])
        self._still = self._sample(0)

    def _stand(self, posture: Floats) -> tuple[Floats, Floats]:
        """Find the centre of mass and the soles of a posture in which both soles are flat."""
        data = mujoco.MjData(self.model)
        data.qpos[7:] = posture[self._motor_of_joint]
        place_on_ground(self.model, data, np.zeros((2, 3)), np.zeros(2))
        mujoco.mj_comPos(self.model, data)
        soles = np.array([data.site(f"{foot}_sole").xpos for foot in FEET])
        return data.subtree_com[self._torso] - (soles.mean(axis=0) * (1.0, 1.0, 0.0)), soles

    def _lean(self, forward: Any, left: Any) -> Floats:
        pitch, roll = np.multiply.outer(forward / self._height, self._swaying[0]), self._swaying[1]
        posture: Floats = self._posture + pitch + np.multiply.outer(left / self._height, roll)
        return posture

    def _sine(self, tick: int) -> tuple[float, float, float]:
        """A sine that fades in over its first period, with its first two derivatives in time."""
        rate, time = self._rate, tick * CONTROL_STEP
        sine, cosine = sin(rate * time), cos(rate * time)
        half = 0.5 * rate
        # After a whole period of the sine the fade is complete, half of one of its own.
        turn = min(half * time, pi)
        fade = 0.5 - 0.5 * cos(turn)
        slope = 0.5 * half * sin(turn) if turn < pi else 0.0
        curve = 0.5 * half * half * cos(turn) if turn < pi else 0.0
        return (
            fade * sine,
            slope * sine + fade * rate * cosine,
            curve * sine + 2.0 * slope * rate * cosine - fade * rate * rate * sine,
        )

    def command_at(self, plan: Any, tick: Any) -> Command:
        """Return the command at a control step of an episode; tasks' rules are in :class:`BipedEnv`."""
        return self._sample(tick) if any(self._sway) else self._still

    def _sample(self, tick: Any) -> Command:
        ticks = np.ravel(tick).tolist()
        motion = np.array([self._sine(one) for one in ticks]).reshape(*np.shape(tick), 3, 1)
        forward, left = self._sway
        sway = np.array([forward * self._follow[0], left * self._follow[1], 0.0])
        where = motion[..., 0, 0]
        return self._sway_command(where * forward, where * left, motion * sway)

    def _sway_command(self, forward: Any, left: Any, motion: Floats) -> Command:
        """Return the command of a pelvis that is moved by so many m forward and left.

        The motion of the centre of mass has shape (..., 3, 3): place, velocity and acceleration.
        """
        com = self._com + motion[..., 0, :]
        velocity, acceleration = motion[..., 1, :], motion[..., 2, :]
        return Command(
            joint_target=self._lean(forward, left),
            com=com,
            com_velocity=velocity,
            com_acceleration=acceleration,
            cop=com[..., :2] - self._com[2] / self._gravity * acceleration[..., :2],
            position_sole=self._position_sole,
            yaw_sole=np.zeros(2),
            stance=np.ones(2, dtype=bool),
            swing=np.zeros(2, dtype=bool),
            phase=0.0,
        )
