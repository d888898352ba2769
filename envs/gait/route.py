"""A route: legs of walking, turning and standing, one after another."""

from collections.abc import Sequence
from itertools import groupby
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from surefoot.envs.gait.footsteps import (
    CONTROL_RATE,
    Footstep,
    GaitTiming,
    check_gait,
    end_of_path,
    place_footsteps,
)
from surefoot.envs.gait.ground import Walk
from surefoot.envs.options import numbers_of

LEAST_STAND = 0.5  # shortest leg of standing in s: the weight has to settle


class Leg(NamedTuple):
    """A part of a route."""

    duration: float  # how long it takes in s
    speed: float  # forward speed in m/s, negative backwards
    turn_rate: float
    """Change of heading in rad/s, positive to the left. With the speed zero as well, the leg stands still."""

    @property
    def stands(self) -> bool:
        """Whether the robot stands still."""
        return self.speed == 0.0 and self.turn_rate == 0.0


def parse_route(route: Any) -> tuple[Leg, ...]:
    """Make legs of an option's value: (duration in s, speed in m/s, turn rate in rad/s), as lists or tuples.

    ValueError if it is not a sequence of such legs, naming the first that is none.

    >>> parse_route([[8.0, 0.04, 0.0], [3.0, 0, 0]])[1].stands
    True
    """
    try:
        rows = [list(leg) for leg in route]
    except TypeError:
        rows = []
    if not rows or isinstance(route, str):
        raise ValueError(
            "'route' must hold one or more legs (duration in s, speed in m/s, turn rate in rad/s), such as "
            f"[[8.0, 0.04, 0.0], [3.0, 0.0, 0.0]], got {route!r}."
        )
    legs = []
    for index, row in enumerate(rows):
        numbers = numbers_of(row)
        if len(numbers) != 3 or not all(map(isfinite, numbers)) or numbers[0] <= 0.0:
            raise ValueError(
                f"'route' leg {index} must be (duration in s, speed in m/s, turn rate in rad/s), three "
                f"finite numbers with a positive duration, got {row!r}."
            )
        legs.append(Leg._make(numbers))
    return tuple(legs)


def plan_legs(legs: Sequence[Leg], timing: GaitTiming) -> tuple[tuple[Walk, ...], int]:
    """Place the footsteps of a route that begins after the first stand of a pattern.

    Returns the walks, legs without a stand between them being one, and the control step at which the route
    ends; ValueError if a leg is too fast for the legs of the robot, or too short for two steps or a stand.
    """
    tick, walks = timing.stand_ticks, []
    where = (0.0, 0.0, 0.0)
    for stands, group in groupby(enumerate(legs), key=lambda numbered: numbered[1].stands):
        numbers, run = zip(*group, strict=True)
        start = tick
        tick += round(sum(leg.duration for leg in run) * CONTROL_RATE)
        if stands:
            if (tick - start) / CONTROL_RATE < LEAST_STAND:
                raise ValueError(
                    f"'route' leg {numbers[0]} stands for {run[0].duration} s; stand for at least "
                    f"{LEAST_STAND} s, in which the weight can settle."
                )
            continue
        footsteps, where = _walk(numbers, run, timing, where)
        walks.append(Walk(start, footsteps))
    return tuple(walks), tick


def _walk(
    numbers: Sequence[int], run: Sequence[Leg], timing: GaitTiming, where: tuple[float, float, float]
) -> tuple[tuple[Footstep, ...], tuple[float, float, float]]:
    """Footsteps of legs that flow into each other, and where they lead."""
    ends = np.cumsum([leg.duration for leg in run]) * CONTROL_RATE
    # The last leg leaves time to bring the weight back between the feet.
    ends[-1] = round(ends[-1]) - timing.double_ticks
    steps = np.diff(np.floor(ends / timing.step_ticks).astype(int), prepend=0)
    length, turn = [], []
    for number, leg, count in zip(numbers, run, steps, strict=True):
        if count < 2:
            least = 3 * timing.step_time + timing.double_support * timing.step_time
            raise ValueError(
                f"'route' leg {number} lasts {leg.duration} s, too short for two steps; "
                f"{least:.2f} s are enough."
            )
        try:
            check_gait(leg.speed, leg.turn_rate, timing.step_time)
        except ValueError as error:
            raise ValueError(f"'route' leg {number}: {error}") from error
        length += [leg.speed * timing.step_time] * int(count)
        turn += [leg.turn_rate * timing.step_time] * int(count)
    # The last step makes no move: it closes the feet.
    moves = np.array(length[:-1]), np.array(turn[:-1])
    return place_footsteps(*moves, where), end_of_path(*moves, where)
