"""What the robot commands itself at one control tick."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Command(NamedTuple):
    """One tick of a pattern: what the robot knows because it asked for it, and no truth.

    Positions are in the world of the pattern: z up, the ground at z = 0.

    Attributes:
        joint_target: Targets of the M motors in the order of the model's actuators in rad, shape (M,).
        com: Planned centre of mass in m, shape (3,).
        com_velocity: Its velocity in m/s, shape (3,).
        com_acceleration: Its acceleration in m/s^2, shape (3,).
        cop: Planned centre of pressure on the ground in m, shape (2,).
        position_sole: Planned origins of the sole frames (left, right) in m, shape (2, 3).
        yaw_sole: Planned headings of the soles in rad, shape (2,).
        stance: Feet planned to bear weight throughout the tick (bool), shape (2,).
        swing: Feet planned to be in the air throughout the tick (bool), shape (2,).
        phase: Progress through the gait cycle (left and right step), in [0, 1); 0 while standing.
    """

    joint_target: NDArray[np.float64]
    com: NDArray[np.float64]
    com_velocity: NDArray[np.float64]
    com_acceleration: NDArray[np.float64]
    cop: NDArray[np.float64]
    position_sole: NDArray[np.float64]
    yaw_sole: NDArray[np.float64]
    stance: NDArray[np.bool_]
    swing: NDArray[np.bool_]
    phase: float
