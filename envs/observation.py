"""What a robot on two feet shows that follows a pattern: its state and its feet, part by part with bounds."""

from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.envs.numbers import ONE, Number, Numbers

Observation = dict[str, NDArray[Any]]

FORCE_BOUND: Final = 1000.0
"""Largest force that is shown in N, but of heavy robots."""

COP_BOUND: Final = 1.0
"""Largest coordinate of a centre of pressure that is shown in m."""


class ObservationTable:
    """The parts of an observation in their order, with their bounds.

    Args:
        joints: Number J of hinge joints.
        force_bound: Largest force of a cell that is shown in N.

    Attributes:
        space: The observation space.
        state_layout: Where each part lies in the state vector.
        size: Length of the state vector.
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
        self.size = end
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

    def bounded(
        self,
        state: NDArray[np.float32],
        force_cell: NDArray[np.float64],
        cop_foot: list[list[Number]],
        cop: list[Number],
        valid: list[Any],
        m: Numbers = ONE,
    ) -> Observation:
        """Bring what is shown into its bounds.

        Args:
            state: Its parts in the units of their names, shape (..., size); it is changed.
            force_cell: Forces of the cells in N, shape (..., 8).
            cop_foot: Centres of pressure of both feet in the sole frames in m, shape (2, 2).
            cop: Centre of pressure of both feet in the level frame in m, shape (2,).
            valid: Whether the total, the left and the right centre of pressure are defined, shape (3,).
            m: Whether these are numbers of one robot, or of many.
        """
        np.maximum(state, self._low, out=state)
        np.minimum(state, self._high, out=state)
        force = force_cell.astype(np.float32)
        np.maximum(force, -self._force_bound, out=force)
        np.minimum(force, self._force_bound, out=force)
        return {
            "state": state,
            "foot_force": force,
            "cop_foot": m.array([_bounded(place, m) for place in cop_foot], dtype=np.float32),
            "cop": m.array(_bounded(cop, m), dtype=np.float32),
            "cop_valid": m.array(valid, dtype=np.int8),
        }


def _bounded(place: list[Number], m: Numbers) -> list[Number]:
    """Bring the coordinates of a centre of pressure in m into their bounds."""
    return [m.clip(part, -COP_BOUND, COP_BOUND) for part in place]
