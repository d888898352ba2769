"""The way of a foot through the air, and how it rolls: off over the toe, and down onto the heel.

Both the way along the ground and the lift are polynomials of the phase of the swing, with zero velocity and
acceleration at either end, so that a foot leaves and lands without a jolt. A foot that rolls lifts its heel
before it leaves while its toe stays where it is, and lands on its heel before it lays its toe down. While it
does, it touches the ground with one edge only, where it then carries its load: its centre of pressure
leaves the middle of the sole.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats

TOE_AND_HEEL = (0.10897, -0.06103)
"""How far ahead of the sole's origin the sole's front and rear edges lie, in m."""

LIFT_HEIGHT = 0.015  # how high a foot is lifted, in m
MAX_ROLL = 0.2  # largest pitch in rad: the rear of the sole is then 34 mm above the ground

ROLL_SHARE = 0.5
"""Share of a double support that a foot takes to roll, at its end with light load or after its landing."""


class FootRoll(NamedTuple):
    """The pitch of one foot from the double support before its swing to the one after it."""

    before: Floats  # during the double support before, shape (double,), rad, positive toe down
    swing: Floats  # in the air, shape (single,), rad
    after: Floats  # during the double support after, shape (double,), rad


def minimum_jerk(phase: ArrayLike) -> Floats:
    """Go from 0 to 1 with zero velocity and acceleration at both ends.

    The quintic of Flash and Hogan (1985). Phases outside [0, 1] are held at the ends.

    >>> minimum_jerk([0.0, 0.5, 1.0])
    array([0. , 0.5, 1. ])
    """
    s = np.clip(np.asarray(phase, dtype=np.float64), 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def lift(phase: ArrayLike) -> Floats:
    """Rise from the ground to :data:`LIFT_HEIGHT` at half the swing and come down again, never below it.

    Zero velocity and acceleration at both ends: ``64 s³ (1 - s)³`` of the height at the phase s of the swing,
    which is held at the ends outside [0, 1].

    >>> lift([0.0, 0.5, 1.0])
    array([0.   , 0.015, 0.   ])
    """
    s = np.clip(np.asarray(phase, dtype=np.float64), 0.0, 1.0)
    return LIFT_HEIGHT * 64.0 * (s * (1.0 - s)) ** 3


def check_roll(angle: float) -> float:
    """Return a pitch as a number, or raise ValueError if it is negative, too large or no number."""
    try:
        number = float(angle)
    except (TypeError, ValueError):
        number = math.nan
    if not 0.0 <= number <= MAX_ROLL:
        raise ValueError(
            f"'foot_roll' is a pitch between 0 (flat feet) and {MAX_ROLL} rad, got {angle!r}; try 0.05."
        )
    return number


def roll_of_step(angle: float, double: int, single: int) -> FootRoll:
    """Pitch a foot through one step, with zero rate and acceleration where a phase begins or ends.

    ``angle`` is the pitch at lift-off, toe down, and at touch-down, heel down, in rad; negative for a step
    backwards, which leaves with the heel and lands on the toe. A double support and a swing have so many
    control steps.
    """
    ticks = max(round(ROLL_SHARE * double), 1)
    rolling = np.arange(ticks)
    before, after = np.zeros(double), np.zeros(double)
    before[double - ticks :] = angle * minimum_jerk((rolling + 1.0) / ticks)
    after[:ticks] = -angle * minimum_jerk(1.0 - rolling / ticks)
    air = (np.arange(single) + 1.0) / (single + 1.0)
    swing = angle * (minimum_jerk(1.0 - 2.0 * air) - minimum_jerk(2.0 * air - 1.0))
    return FootRoll(before, swing, after)


def pivot_of(pitch: ArrayLike) -> tuple[Floats, Floats]:
    """Find how far forward and up in m a sole's origin moves when it pitches about the edge that stays down.

    The pitch is in rad, positive toe down, of any shape.

    >>> [round(float(part), 4) for part in pivot_of(0.1)]
    [0.0005, 0.0109]
    """
    angle = np.asarray(pitch, dtype=np.float64)
    edge = np.where(angle > 0.0, *TOE_AND_HEEL)
    return edge * (1.0 - np.cos(angle)), edge * np.sin(angle)
