"""Which feet surely stood, or surely swung, at the moment of a reference.

A robot that plans its steps knows; one whose policy plans nothing finds out by its own kinematics: the foot
with the lowest part is on the ground, unless the robot is falling freely, and a foot of which every part is
clearly above that is in the air.
"""

from collections import deque
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY, Reference

FREE_FALL = 0.5  # specific force as a share of gravity below which a robot falls freely

CONTACT_MARGIN = 4
"""Samples by which a planned stance or swing must hold before and after one to be sure of it: joints follow
their targets late, and feet land when the ground comes."""

LIFTED = 0.01
"""Height in m of a foot's lowest part above the lower foot's from which it is surely in the air: ten times
what encoders that are off by 1e-3 rad make of a leg of a metre."""

DOWN = 0.003  # the same height up to which a foot is down
FLAT = 0.03  # slope of a sole in rad beyond which the foot is rolling, and its height says little
COS_FLAT = 1.0 - 0.5 * FLAT * FLAT  # its cosine, to second order


def plan_window(lag: int) -> tuple[int, int]:
    """Return for how many samples a plan must have held, and how many of them are kept.

    Args:
        lag: How many samples ago a reference was.

    Returns:
        Samples that it must have held, and samples for which it is kept in mind how long it had.
    """
    return CONTACT_MARGIN + 1 + min(CONTACT_MARGIN, lag), max(lag - CONTACT_MARGIN, 0) + 1


LEANING = 0.4  # mean acceleration as a share of gravity from which a robot falls

LEAN_TIME = 0.25  # time constant in s of that mean, longer than a push or a landing

STEEPEST = 0.4
"""Sine of the slope that the soles show above which the robot does not stand on them but lies. Robots do not
walk on slopes of more than 20 degrees."""

COS_STEEPEST = sqrt(1.0 - STEEPEST**2)

LOWEST = 0.7
"""Height of the centre of mass above the lower sole, as a share of the highest in this episode, below which a
robot may rest on more than its feet."""


class Plan:
    """Finds which of F feet surely stood, or surely swung, ``lag`` samples ago, by the plan.

    Attributes:
        runs: For how many samples each foot was planned to stand and to swing, (2 F), of each sample kept.
    """

    def __init__(self, lag: int, feet: int = 2) -> None:
        self._needed, kept = plan_window(lag)
        self.runs = deque([[0] * (2 * feet)], maxlen=kept)

    def at(
        self, stance: NDArray[np.bool_], swing: NDArray[np.bool_]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Take in feet planned to stand and to swing now, and return those that surely did so then.

        All have shape (F,); then is ``lag`` samples ago.
        """
        planned = [*stance.tolist(), *swing.tolist()]
        self.runs.append([run + 1 if held else 0 for run, held in zip(self.runs[-1], planned, strict=True)])
        return _halves([run >= self._needed for run in self.runs[0]])


class Kinematics:
    """Finds which feet surely stood, or surely swung, by where they were.

    Parts of a foot that may touch are centres in its sole frame and radii in m, shape (F, n, 4). Round feet
    roll: they stand on any of their sides. Gravity is in m/s^2.

    Attributes:
        runs: For how many samples each foot has stood, and has swung, (2 F).
    """

    def __init__(self, touching: Floats, rolls: bool = False, gravity: float = GRAVITY) -> None:
        self._places, self._radius = touching[..., :3], touching[..., 3]
        self._free_fall, self._rolls = FREE_FALL * gravity, rolls
        # A soft round foot that bears load is pressed flat by no more than its radius.
        self._lifted = np.maximum(LIFTED, self._radius.max(axis=1))
        self.runs = [0] * (2 * len(touching))

    def at(self, reference: Reference, ground: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Take in the robot's beliefs of one moment, and return which feet surely stood or swung then.

        Those have shape (F,). Samples follow each other, and a foot's state has to have been the same for
        :data:`CONTACT_MARGIN` of them. Heights are measured along the normal of the ground, shape (3,).
        """
        # A foot on its toes or on an edge bears load, wherever the middle of its sole is.
        normal = ground @ reference.R_level_sole
        arm = np.einsum("fi,fni->fn", normal, self._places) - self._radius
        height = reference.position_sole @ ground + arm.min(axis=1)
        flat = self._rolls | (normal[:, 2] > COS_FLAT)
        fx, fy, fz = reference.accelerometer.tolist()
        # NaN, where nothing is known yet, compares as false.
        carried = fx * fx + fy * fy + fz * fz > self._free_fall**2
        above = height - height.min()
        seen = [*(carried & flat & (above < DOWN)).tolist(), *(carried & (above > self._lifted)).tolist()]
        self.runs = [run + 1 if now else 0 for run, now in zip(self.runs, seen, strict=True)]
        return _halves([run > CONTACT_MARGIN for run in self.runs])


def _halves(sure: list[bool]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Split a row into F feet that surely stand and F that surely swing."""
    feet = len(sure) // 2
    return np.array(sure[:feet]), np.array(sure[feet:])


class Upright:
    """Finds whether a robot stands, walks or runs: only then do its feet carry all of it.

    A robot that lies or sits rests on more than its soles, so that its weight and motion do not determine the
    load of its feet. Its soles lean far or its centre of mass is low. The mean acceleration of a robot that
    falls is large.

    Samples are ``dt`` s apart, and gravity is in m/s^2.

    Attributes:
        fell: Whether it was upright until the last moment, and no longer at it.
        upright: Whether it was upright then.
        lean: Its mean acceleration in m/s^2.
        highest: Greatest height of the centre of mass above the lower sole in this episode in m.
    """

    def __init__(self, dt: float, gravity: float = GRAVITY) -> None:
        self._leaning = LEANING * gravity
        self._share = dt / (dt + LEAN_TIME)
        self.lean = (0.0, 0.0, 0.0)
        self.highest = 0.0
        self.upright = self.fell = False

    def at(self, reference: Reference, ground: Floats) -> bool:
        """Take in the robot's beliefs of one moment, and return whether it was upright then.

        Samples follow each other. NaN, where nothing is known, passes. The ground's normal has shape (3,).
        """
        x, y, z = reference.com_acceleration.tolist()
        self.fell = False
        if x != x:
            return True
        share, (mx, my, mz) = self._share, self.lean
        self.lean = mx, my, mz = mx + share * (x - mx), my + share * (y - my), mz + share * (z - mz)
        height = float(reference.com[2]) - min(reference.position_sole[:, 2].tolist())
        self.highest = max(self.highest, height)
        upright = bool(
            mx * mx + my * my + mz * mz < self._leaning**2
            and ground[2] > COS_STEEPEST
            and height > LOWEST * self.highest
        )
        self.fell, self.upright = self.upright and not upright, upright
        return upright
