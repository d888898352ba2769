"""The observation of a robot on two feet that follows a pattern: its state and the forces under its feet.

Everything is made from the last row of the control step's sensor data, for one robot or for many.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.envs.command import Command, command_state, rotate_level
from surefoot.envs.instrumentation.means import FootPlaces
from surefoot.envs.instrumentation.truth import centres, ground_at_feet
from surefoot.envs.numbers import ONE, Number, Numbers

Observation = dict[str, NDArray[Any]]

FORCE_BOUND: Final = 1000.0
"""Largest force that is shown in N, but of heavy robots."""

COP_BOUND: Final = 1.0
"""Largest coordinate of a centre of pressure that is shown in m."""


class Places(NamedTuple):
    """Where in a row of sensor data things are that are shown: of each, the first of its numbers.

    Attributes:
        feet: The loads of the feet.
        axes_torso: The torso's axes one after another (9).
        position_torso: Its origin (3).
        gyroscope: Its angular velocity in its own axes (3).
        joints: Angles of the J hinge joints.
        joint_dofs: Where their speeds are in ``qvel``.
    """

    feet: FootPlaces
    axes_torso: int
    position_torso: int
    gyroscope: int
    joints: slice
    joint_dofs: NDArray[np.intp]


class FeetObserver:
    """Turns truth and command into an observation; holds the last valid centres of pressure.

    Args:
        places: Where things are in a row.
        force_bound: Largest force of a cell that is shown in N.

    Attributes:
        space: The observation space.
        state_layout: Where each part lies in the state vector.
        numbers: Whether it sees one robot, or many.
    """

    numbers: Numbers = ONE

    def __init__(self, places: Places, force_bound: float) -> None:
        self._places = places
        joints = places.joint_dofs.size
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
                "cop_valid": spaces.Box(0.0, 1.0, (3,), np.float32),
            }
        )
        self._cop: list[list[Number]] = [[0.0, 0.0] for _ in range(3)]

    def reset(self, robots: Any = True) -> None:
        """Start with centres of pressure at the origin; of many robots, for those of a mask."""
        where = self.numbers.where
        self._cop = [[where(robots, 0.0, part) for part in place] for place in self._cop]

    def observe(
        self, last: NDArray[np.float64], row: Any, qvel: NDArray[np.float64], command: Command
    ) -> tuple[Observation, dict[str, NDArray[np.float64]]]:
        """Show the last row of a control step.

        Args:
            last: The row, shape (..., columns).
            row: Its parts.
            qvel: MuJoCo's velocities at that instant, shape (..., nv).
            command: The robot's command at its end.

        Returns:
            The observation, and the centre of pressure of that instant, of which rewards are made:
            ``cop_world`` (..., 2) m and ``cop_valid`` (..., 3).
        """
        m, places = self.numbers, self._places.feet
        feet = [
            [*row[i : i + 9], *row[j : j + 3], *row[k : k + 9]]
            for i, j, k in zip(places.contact, places.position_sole, places.axes_sole, strict=True)
        ]
        wrench, common = ground_at_feet(feet, places.up)
        (x, y), *cop_foot, valid = centres(wrench, common, places.flat, m)
        middle_x, middle_y, heading = places.level(row, m)
        level = rotate_level(x - middle_x, y - middle_y, heading, m)
        for there, place, held in zip(valid, (level, *cop_foot), self._cop, strict=True):
            held[0], held[1] = m.where(there, place[0], held[0]), m.where(there, place[1], held[1])

        assert places.force_cell is not None
        force_cell = places.force_cell(last, m.array(wrench).reshape(*last.shape[:-1], 12))
        force = force_cell.astype(np.float32)
        np.maximum(force, -self._force_bound, out=force)
        np.minimum(force, self._force_bound, out=force)
        return {
            "state": self._state(last, row, qvel, command),
            "foot_force": force,
            "cop_foot": m.array([_clip_cop(place, m) for place in self._cop[1:]], dtype=np.float32),
            "cop": m.array(_clip_cop(self._cop[0], m), dtype=np.float32),
            "cop_valid": m.array(valid, dtype=np.float32),
        }, {"cop_world": m.array([x, y]), "cop_valid": m.array(valid)}

    def _state(
        self, last: NDArray[np.float64], row: Any, qvel: NDArray[np.float64], command: Command
    ) -> NDArray[np.float32]:
        m, places, torso, gyro = self.numbers, self._places, self._places.axes_torso, self._places.gyroscope
        x_up, y_up, z_up = row[torso + 2], row[torso + 5], row[torso + 8]
        joints = places.joint_dofs.size
        state = np.empty((*last.shape[:-1], self._high.size), dtype=np.float32)
        state[..., :joints] = last[..., places.joints]
        state[..., joints : 2 * joints] = qvel[..., places.joint_dofs]
        state[..., 2 * joints :] = m.array(
            [
                m.atan2(y_up, z_up),
                -m.asin(m.clip(x_up, -1.0, 1.0)),
                *row[gyro : gyro + 3],
                *command_state(command, m),
            ]
        )
        np.maximum(state, self._low, out=state)
        np.minimum(state, self._high, out=state)
        return state


def _clip_cop(place: list[Number], m: Numbers) -> list[Number]:
    """Bring the coordinates of a centre of pressure in m into their bounds."""
    return [m.clip(part, -COP_BOUND, COP_BOUND) for part in place]
