"""The robot's command to itself at one control tick."""

from math import atan2, cos, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats


class Command(NamedTuple):
    """One tick of a pattern: the robot knows it because it asked for it; it is no truth.

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

    joint_target: Floats
    com: Floats
    com_velocity: Floats
    com_acceleration: Floats
    cop: Floats
    position_sole: Floats
    yaw_sole: Floats
    stance: NDArray[np.bool_]
    swing: NDArray[np.bool_]
    phase: float


def command_state(command: Command) -> list[float]:
    """Return the ten parts of the state that are commanded, from ``com_reference`` to ``phase``.

    Places are in the level frame of the commanded soles: its origin is midway between them, and its heading
    the mean of theirs.
    """
    soles, (left, right) = command.position_sole.tolist(), command.yaw_sole.tolist()
    middle_x, middle_y = 0.5 * (soles[0][0] + soles[1][0]), 0.5 * (soles[0][1] + soles[1][1])
    heading = atan2(sin(left) + sin(right), cos(left) + cos(right))
    com, velocity, cop = command.com.tolist(), command.com_velocity.tolist(), command.cop.tolist()
    angle = 2.0 * pi * command.phase
    return [
        *rotate_level(com[0] - middle_x, com[1] - middle_y, heading),
        *rotate_level(velocity[0], velocity[1], heading),
        *rotate_level(cop[0] - middle_x, cop[1] - middle_y, heading),
        *command.stance.tolist(),
        sin(angle),
        cos(angle),
    ]


def rotate_level(x: float, y: float, heading: float) -> list[float]:
    """Return a vector of the world, turned about the vertical into a frame with a heading in rad."""
    c, s = cos(heading), sin(heading)
    return [c * x + s * y, c * y - s * x]
