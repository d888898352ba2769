"""What the exercise shows: the state vector and the true forces under two feet."""

from math import atan2

import numpy as np
from numpy.typing import NDArray

from surefoot.envs.command import Command, command_state, turned
from surefoot.envs.instrumentation.truth import CONTACT_FORCE, FeetTruth
from surefoot.envs.observation import Observation, ObservationTable


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
        self._table = ObservationTable(joints, force_bound)
        self.space, self.state_layout = self._table.space, self._table.state_layout
        self.reset()

    def reset(self) -> None:
        """Start with centres of pressure at the origin."""
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
        cop_foot = np.zeros((2, 2))
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
            x, y = (cop_world - middle).tolist()
            self._cop = turned(x, y, heading)
        else:
            cop_world = np.zeros(2)
        state = self._state(truth, joint_velocity, command)
        return self._table.bounded(state, force_cell, self._cop_foot, self._cop, valid), {
            "force_cell": force_cell.copy(),
            "vgrf": vgrf,
            "cop_world": cop_world,
            "cop_foot": cop_foot,
            "cop_valid": np.array(valid),
            "com": truth.com[-1].copy(),
            "wrench_sole": wrench.copy(),
        }

    def _state(
        self, truth: FeetTruth, joint_velocity: NDArray[np.float64], command: Command
    ) -> NDArray[np.float32]:
        x_up, y_up, z_up = truth.R_world_torso[-1, 2].tolist()
        joints = joint_velocity.size
        state = np.empty(self._table.size, dtype=np.float32)
        state[:joints] = truth.joint_position[-1]
        state[joints : 2 * joints] = joint_velocity
        state[2 * joints :] = [
            atan2(y_up, z_up),
            atan2(-x_up, (y_up * y_up + z_up * z_up) ** 0.5),
            *truth.gyroscope[-1].tolist(),
            *command_state(command),
        ]
        return state
