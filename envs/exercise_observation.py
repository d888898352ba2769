"""What the exercise shows: the state vector and the true forces under two feet."""

from math import atan2, cos, sin
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.envs.command import Command
from surefoot.envs.feet_truth import FeetTruth
from surefoot.envs.truth import CONTACT_FORCE

Observation = dict[str, NDArray[Any]]

COP_BOUND = 1.0
"""Largest coordinate of a centre of pressure that is shown, in m."""


class ExerciseObserver:
    """Turns truth and command into an observation; holds the last valid centres of pressure.

    Args:
        joints: Number J of hinge joints.
        force_bound: Largest force of a cell that is shown, in N.

    Attributes:
        space: The observation space.
        state_layout: Where each part lies in the state vector.
    """

    def __init__(self, joints: int, force_bound: float) -> None:
        bounds = {
            "joint_position": (joints, np.pi),
            "joint_velocity": (joints, 50.0),
            "tilt": (2, np.pi),
            "gyroscope": (3, 50.0),
            "com_reference": (2, 1.0),
            "com_reference_velocity": (2, 2.0),
            "cop_reference": (2, 1.0),
            "stance": (2, 1.0),
            "phase": (2, 1.0),
        }
        self.state_layout: dict[str, slice] = {}
        end = 0
        for name, (size, _) in bounds.items():
            self.state_layout[name] = slice(end, end + size)
            end += size
        self._high = np.concatenate([np.full(n, high, dtype=np.float32) for n, high in bounds.values()])
        self._low = -self._high
        self._low[self.state_layout["stance"]] = 0.0
        self._force_bound = force_bound
        self.space: Any = spaces.Dict(
            {
                "state": spaces.Box(self._low.copy(), self._high.copy(), dtype=np.float32),
                "foot_force": spaces.Box(-force_bound, force_bound, (8,), dtype=np.float32),
                "cop_foot": spaces.Box(-COP_BOUND, COP_BOUND, (2, 2), dtype=np.float32),
                "cop": spaces.Box(-COP_BOUND, COP_BOUND, (2,), dtype=np.float32),
                "cop_valid": spaces.MultiBinary(3),
            }
        )
        self.reset()

    def reset(self) -> None:
        """Forget the centres of pressure of the last episode."""
        self._cop = [0.0, 0.0]
        self._cop_foot = [[0.0, 0.0], [0.0, 0.0]]

    def observe(
        self, truth: FeetTruth, joint_velocity: NDArray[np.float64], command: Command
    ) -> tuple[Observation, dict[str, NDArray[np.float64]]]:
        """Show the last row of a control step.

        Args:
            truth: The control step, shape (S, ...).
            joint_velocity: Speeds of the hinge joints at its last row in rad/s, shape (J,).
            command: What the robot commands at its end.

        Returns:
            The observation, and the truth at the control rate for ``info``.
        """
        wrench, force_cell = truth.wrench_sole[-1], truth.force_cell[-1]
        vgrf, cop_world = truth.vgrf(), truth.cop_world()
        cop_foot = np.full((2, 2), np.nan)
        valid = [bool(cop_world[0] == cop_world[0]), False, False]
        for foot, (_, _, load, torque_x, torque_y, _) in enumerate(wrench.tolist()):
            if load > CONTACT_FORCE:
                valid[1 + foot] = True
                self._cop_foot[foot] = [-torque_y / load, torque_x / load]
                cop_foot[foot] = self._cop_foot[foot]
        if valid[0]:
            forward = truth.R_world_sole[-1, :, :2, 0].sum(axis=0).tolist()
            heading = atan2(forward[1], forward[0])
            middle = truth.position_sole[-1, :, :2].sum(axis=0) / 2.0
            self._cop = _level(cop_world - middle, heading)
        observation: Observation = {
            "state": self._state(truth, joint_velocity, command),
            "foot_force": _clipped(force_cell, self._force_bound),
            "cop_foot": _clipped(self._cop_foot, COP_BOUND),
            "cop": _clipped(self._cop, COP_BOUND),
            "cop_valid": np.array(valid, dtype=np.int8),
        }
        return observation, {
            "force_cell": force_cell.copy(),
            "vgrf": np.array(vgrf),
            "cop_world": np.array(cop_world),
            "cop_foot": cop_foot,
            "com": truth.com[-1].copy(),
            "wrench_sole": wrench.copy(),
        }

    def _state(
        self, truth: FeetTruth, joint_velocity: NDArray[np.float64], command: Command
    ) -> NDArray[np.float32]:
        x_up, y_up, z_up = truth.R_world_torso[-1, 2].tolist()
        left, right = command.yaw_sole.tolist()
        middle = command.position_sole[:, :2].sum(axis=0) / 2.0
        heading = atan2(sin(left) + sin(right), cos(left) + cos(right))
        angle = 2.0 * np.pi * command.phase
        joints = joint_velocity.size
        state = np.empty(self._high.size, dtype=np.float32)
        state[:joints] = truth.joint_position[-1]
        state[joints : 2 * joints] = joint_velocity
        state[2 * joints :] = [
            atan2(y_up, z_up),
            atan2(-x_up, (y_up * y_up + z_up * z_up) ** 0.5),
            *truth.gyroscope[-1].tolist(),
            *_level(command.com[:2] - middle, heading),
            *_level(command.com_velocity[:2], heading),
            *_level(command.cop - middle, heading),
            *command.stance.tolist(),
            sin(angle),
            cos(angle),
        ]
        np.maximum(state, self._low, out=state)
        np.minimum(state, self._high, out=state)
        return state


def _clipped(value: Any, bound: float) -> NDArray[np.float32]:
    clipped = np.array(value, dtype=np.float32)
    np.maximum(clipped, -bound, out=clipped)
    np.minimum(clipped, bound, out=clipped)
    return clipped


def _level(place: NDArray[np.float64], heading: float) -> list[float]:
    """Turn a place in the world about the vertical into a frame with a heading."""
    x, y = place.tolist()
    c, s = cos(heading), sin(heading)
    return [c * x + s * y, c * y - s * x]
