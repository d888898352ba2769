"""Where the feet go, and when.

A walk is a path of body poses, one a step, along a straight line or an arc, and a footstep beside each of
them. The first move and the last are half as long as the others, so that the walk starts and stops gently,
and one more step brings the feet side by side.

While turning, the foot on the inside of the turn takes the yaw of two steps at once, opening the feet, and
the other follows. So the shoes toe out but never in, where their tips would touch: each foot takes the
heading of the path's next pose, or that of the other foot where it would toe in.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from surefoot.arrays import Floats

CONTROL_RATE = 80  # control steps a second

MAX_STEP_LENGTH = 0.09
"""Longest step in m: one foot ahead of the other. With bent knees the leg still reaches this far."""

MAX_STEP_TURN = 0.16  # largest turn a step in rad; the inner foot turns by twice as much
HALF_WIDTH = 0.05  # distance of either ankle from the middle in m: legs vertical below the hips

_HEEL = 0.062
"""How far the shoe reaches behind the ankle in m: a foot that opens swings its heel inwards by this much."""

LEFT, RIGHT = 0, 1


class Footstep(NamedTuple):
    """A foot on the ground."""

    foot: int  # 0 for the left, 1 for the right foot
    position: tuple[float, float]  # where the sole's origin lies in the pattern's world, in m
    yaw: float  # heading of the sole in rad


@dataclass(frozen=True)
class GaitTiming:
    """How long each part of a walk lasts."""

    step_time: float = 0.8  # from one landing to the next, in s
    double_support: float = 0.4  # share of the step during which both feet carry
    stand_time: float = 1.0  # standing before the first and after the last step, in s

    def __post_init__(self) -> None:
        """Raise ValueError if there is no double or no single support, or too little standing."""
        if not 0.3 <= self.step_time <= 3.0:
            raise ValueError(f"'step_time' must lie between 0.3 s and 3 s, got {self.step_time} s.")
        if not 0.1 <= self.double_support <= 0.8:
            raise ValueError(
                f"'double_support' is the share of a step on both feet and must lie between 0.1 and 0.8, "
                f"got {self.double_support}."
            )
        if not (math.isfinite(self.stand_time) and self.stand_time >= 0.5):
            raise ValueError(
                f"'stand_time' must be at least 0.5 s, got {self.stand_time} s: the weight has to settle."
            )

    @property
    def step_ticks(self) -> int:
        """Control steps in a step."""
        return round(self.step_time * CONTROL_RATE)

    @property
    def double_ticks(self) -> int:
        """Control steps in a double support."""
        return round(self.step_ticks * self.double_support)

    @property
    def stand_ticks(self) -> int:
        """Control steps of standing at either end."""
        return round(self.stand_time * CONTROL_RATE)

    def steps_within(self, duration: float) -> int:
        """Count the whole steps, the closing one among them, that fit into a walk of ``duration`` s."""
        free = round(duration * CONTROL_RATE) - 2 * self.stand_ticks - self.double_ticks
        return max(free // self.step_ticks, 0)


def stance_of_stand() -> tuple[Footstep, Footstep]:
    """Place the feet side by side about the origin."""
    return Footstep(LEFT, (0.0, HALF_WIDTH), 0.0), Footstep(RIGHT, (0.0, -HALF_WIDTH), 0.0)


def plan_footsteps(speed: float, turn_rate: float, steps: int, step_time: float) -> tuple[Footstep, ...]:
    """Place the footsteps of a walk that starts from, and ends in, a stand with the feet side by side.

    Speed in m/s, negative backwards, and change of heading in rad/s, positive to the left, with a number of
    footsteps, the closing one included, of ``step_time`` s. The first is by the foot on the inside of the
    turn, the left when straight. ValueError if a step would be longer, or turn further, than the legs allow,
    if fewer than two steps are asked for, or if an argument is not finite.

    >>> [step.foot for step in plan_footsteps(0.04, 0.0, 4, 0.8)]
    [0, 1, 0, 1]
    """
    check_gait(speed, turn_rate, step_time)
    if steps < 2:
        raise ValueError(f"A walk needs at least two steps, one out and one to close the feet, got {steps}.")
    moves = steps - 1
    return place_footsteps(np.full(moves, speed * step_time), np.full(moves, turn_rate * step_time))


def check_gait(speed: float, turn_rate: float, step_time: float) -> None:
    """Raise ValueError if steps are longer, or turn further, than the legs allow, or a number is not finite.

    Speed is in m/s, turn rate in rad/s and the duration of a step in s.
    """
    for name, value in {"speed": speed, "turn_rate": turn_rate}.items():
        if not math.isfinite(value):
            raise ValueError(f"'{name}' must be finite, got {value}.")
    if abs(speed) * step_time > MAX_STEP_LENGTH + 1e-12:
        raise ValueError(
            f"'speed' {speed} m/s makes steps of {abs(speed) * step_time:.3f} m, longer than the "
            f"legs' {MAX_STEP_LENGTH} m; at {step_time} s a step, walk at most "
            f"{MAX_STEP_LENGTH / step_time:.4f} m/s."
        )
    if abs(turn_rate) * step_time > MAX_STEP_TURN + 1e-12:
        raise ValueError(
            f"'turn_rate' {turn_rate} rad/s turns {abs(turn_rate) * step_time:.3f} rad a step, more than the "
            f"hips' {MAX_STEP_TURN} rad; at {step_time} s a step, turn at most "
            f"{MAX_STEP_TURN / step_time:.3f} rad/s."
        )


def place_footsteps(
    length: Floats, turn: Floats, start: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> tuple[Footstep, ...]:
    """Place moves + 1 footsteps beside a path: one a move, and then one that closes the feet.

    Moves have a length in m and a change of heading in rad, shape (moves,); the first and the last are walked
    by half. The path starts at (x, y) in m with a heading in rad, midway between the feet.
    """
    pose = _path(length, turn, start)
    steps = len(pose)
    first = RIGHT if turn[0] < 0 else LEFT
    yaw_foot = [start[2], start[2]]
    placed = []
    for index in range(steps):
        foot = (first + index) % 2
        x, y, heading = pose[index].tolist()
        ahead, other = float(pose[min(index + 1, steps - 1), 2]), yaw_foot[1 - foot]
        opens = ahead >= other if foot == LEFT else ahead <= other
        yaw_foot[foot] = ahead if opens else other
        turned_out = abs(yaw_foot[foot] - yaw_foot[1 - foot])
        aside = HALF_WIDTH + (_HEEL * math.sin(turned_out) if opens else 0.0)
        side = aside if foot == LEFT else -aside
        position = (x - side * math.sin(heading), y + side * math.cos(heading))
        placed.append(Footstep(foot, position, yaw_foot[foot]))
    return tuple(placed)


def end_of_path(
    length: Floats, turn: Floats, start: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Find where a path of :func:`place_footsteps` ends: (x, y) in m and the heading in rad."""
    x, y, heading = _path(length, turn, start)[-1].tolist()
    return x, y, heading


def _path(length: Floats, turn: Floats, start: tuple[float, float, float]) -> Floats:
    """Body poses (x, y, heading) at each footstep, shape (moves + 1, 3); the last two are the same."""
    moves = len(length)
    share = np.ones(moves)
    share[[0, -1]] = 0.5
    pose = np.zeros((moves + 1, 3))
    state = np.array(start)
    for index in range(moves):
        # The chord of an arc points along the heading in its middle.
        half = share[index] * turn[index] / 2
        chord = share[index] * length[index] * np.sinc(half / np.pi)
        state = state + np.array([chord * np.cos(state[2] + half), chord * np.sin(state[2] + half), 2 * half])
        pose[index] = state
    pose[-1] = state
    return pose
