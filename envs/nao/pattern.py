"""The robot follows a planned walk, and is paid for how well it does."""

from math import atan2, cos, exp, sin

import numpy as np
from numpy.typing import NDArray

from surefoot.envs.command import Command
from surefoot.envs.gait.pattern import Pattern
from surefoot.envs.nao.env import NaoEnv

COP_SCALE = 0.02
"""Error of the centre of pressure in m at which its reward has fallen to 1/e."""

VELOCITY_SCALE = 0.1
"""Error of the velocity of the centre of mass in m/s at which its reward has fallen to 1/e."""

TILT_SCALE = 0.2
"""Tilt of the torso in rad at which its reward has fallen to 1/e."""


class NaoPatternEnv(NaoEnv):
    """Follow a pattern; subclasses plan it, at the latest when an episode starts.

    True and planned values are compared in the level frames of the true and of the commanded soles, so that a
    walk that has drifted off its line is not paid less for it.

    Attributes:
        pattern: The plan.
        cop_scale: Error of the centre of pressure in m at which its reward has fallen to 1/e.
    """

    pattern: Pattern
    cop_scale = COP_SCALE

    def _command(self, tick: int) -> Command:
        return self.pattern.command(tick)

    def _reward(self, truth: dict[str, NDArray[np.float64]], action: NDArray[np.float64]) -> dict[str, float]:
        command, now = self.command, self.truth
        sole = now.position_sole[-1, :, :2]
        ahead = now.R_world_sole[-1, :, :2, 0]
        heading = atan2(ahead[0, 1] + ahead[1, 1], ahead[0, 0] + ahead[1, 0])
        planned_heading = float(command.yaw_sole.mean())

        velocity = _turned(now.com_velocity[-1, :2], -heading)
        planned_velocity = _turned(command.com_velocity[:2], -planned_heading)
        cop = _turned(truth["cop_world"] - sole.mean(axis=0), -heading)
        planned_cop = _turned(command.cop - command.position_sole[:, :2].mean(axis=0), -planned_heading)
        tilt = float(np.arccos(np.clip(now.R_world_torso[-1, 2, 2], -1.0, 1.0)))
        return {
            "reward_alive": 1.0,
            "reward_progress": _closeness(velocity - planned_velocity, VELOCITY_SCALE),
            "reward_upright": exp(-((tilt / TILT_SCALE) ** 2)),
            "reward_cop": _closeness(cop - planned_cop, self.cop_scale),
            "reward_action": -0.1 * float(action @ action) / action.size,
        }


def _turned(vector: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    c, s = cos(angle), sin(angle)
    x, y = vector.tolist()
    return np.array([c * x - s * y, s * x + c * y])


def _closeness(error: NDArray[np.float64], scale: float) -> float:
    """1 for no error, 1/e for one of ``scale``, 0 for one that is undefined."""
    square = float(error @ error)
    return exp(-square / scale**2) if square == square else 0.0
