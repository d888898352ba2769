"""Determine which feet were certainly in stance or in swing at the time of a reference.

If the robot plans its steps, the contacts follow from the plan. Otherwise they follow from kinematics: the
foot with the lowest part is on the ground, unless the robot is in free fall. A foot is in the air if all its
parts are clearly higher. On soft ground, or if the estimated attitude is wrong, such a foot may still bear
load. The moment filter therefore weighs these contacts against the readings of the foot
(:mod:`surefoot.calibration.moment.tare`).
"""

from collections import deque
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY, Reference

FREE_FALL = 0.5  # specific force as a fraction of gravity below which a robot is in free fall

CONTACT_MARGIN = 4
"""Samples before and after a moment during which a planned stance or swing must last to be certain. Joints
lag behind their targets, and the ground may be higher or lower than planned."""

LIFTED = 0.014
"""Height of a foot's lowest part above that of the lowest foot, as a fraction of the height of the centre of
mass, above which the foot is in the air. It is fourteen times the error of legs with an encoder error of 1e-3
rad."""

DOWN = 0.004  # the same fraction, up to which a foot is on the ground
FLAT = 0.03  # sole tilt in rad above which the foot is rolling and its height is not used
COS_FLAT = 1.0 - 0.5 * FLAT * FLAT  # cosine of FLAT, to second order


def plan_window(lag: int) -> tuple[int, int]:
    """Return how long a planned contact must last to be certain, and how many samples to store.

    Args:
        lag: Age of a reference in samples.

    Returns:
        Samples for which a stance or swing must have been planned, and number of samples whose durations of
        planned contacts are stored.
    """
    return CONTACT_MARGIN + 1 + min(CONTACT_MARGIN, lag), max(lag - CONTACT_MARGIN, 0) + 1


LEANING = 0.4  # mean acceleration, as a fraction of gravity, above which a robot is falling

LEAN_TIME = 0.25  # time constant in s of that mean; longer than a push or a landing

STEEPEST = 0.4
"""Sine of the slope of the soles above which the robot is lying, not standing. Robots do not walk on slopes
of more than 20 degrees."""

COS_STEEPEST = sqrt(1.0 - STEEPEST**2)

LOWEST = 0.7
"""Height of the centre of mass above the lower sole, as a fraction of its maximum in this episode, below
which parts other than the feet may carry load."""


class Plan:
    """Determines from the plan which of F feet were certainly in stance or in swing ``lag`` samples ago.

    Attributes:
        runs: One list of 2 F numbers per stored sample: for how many samples each foot had been planned to be
            in stance, and in swing.
    """

    def __init__(self, lag: int, feet: int = 2) -> None:
        self._needed, kept = plan_window(lag)
        self.runs = deque([[0] * (2 * feet)], maxlen=kept)

    def at(
        self, stance: NDArray[np.bool_], swing: NDArray[np.bool_]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Store the planned contacts of this sample, and return the certain ones of ``lag`` samples ago.

        Args:
            stance: Feet planned to be in stance now, shape (F,).
            swing: Feet planned to be in swing now, shape (F,).

        Returns:
            Feet that were certainly in stance, and feet that were certainly in swing, shape (F,) each.
        """
        planned = [*stance.tolist(), *swing.tolist()]
        self.runs.append([run + 1 if held else 0 for run, held in zip(self.runs[-1], planned, strict=True)])
        return _halves([run >= self._needed for run in self.runs[0]])


class Kinematics:
    """Determines from kinematics which feet were certainly in stance or in swing.

    Args:
        touching: Parts of each foot that may touch the ground: centres in the sole frames and radii in m,
            shape (F, n, 4).
        rolls: Whether the feet are round and can stand on any of their sides.
        gravity: Acceleration of free fall in m/s^2.

    Attributes:
        runs: For how many samples each foot has been in stance, and in swing, 2 F numbers.
    """

    def __init__(self, touching: Floats, rolls: bool = False, gravity: float = GRAVITY) -> None:
        self._places, self._radius = touching[..., :3], touching[..., 3]
        self._free_fall, self._rolls = FREE_FALL * gravity, rolls
        # Load compresses a soft round foot by at most its radius.
        self._softest = self._radius.max(axis=1)
        self.runs = [0] * (2 * len(touching))

    def at(self, reference: Reference, ground: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Process one sample, and return which feet were certainly in stance and in swing, shape (F,) each.

        A contact is certain if it has lasted for more than :data:`CONTACT_MARGIN` consecutive samples.

        Args:
            reference: The state estimate of this sample.
            ground: Normal of the ground, along which heights are measured, shape (3,).
        """
        # Use the lowest part: a foot on its toes or on an edge carries load although its centre is higher.
        normal = ground @ reference.R_level_sole
        arm = np.einsum("fi,fni->fn", normal, self._places) - self._radius
        height = reference.position_sole @ ground + arm.min(axis=1)
        flat = self._rolls | (normal[:, 2] > COS_FLAT)
        fx, fy, fz = reference.accelerometer.tolist()
        # Comparisons with NaN (state unknown) are false.
        carried = fx * fx + fy * fy + fz * fz > self._free_fall**2
        above, size = height - height.min(), reference.com @ ground - height.min()
        lifted = np.maximum(LIFTED * size, self._softest)
        seen = [*(carried & flat & (above < DOWN * size)).tolist(), *(carried & (above > lifted)).tolist()]
        self.runs = [run + 1 if now else 0 for run, now in zip(self.runs, seen, strict=True)]
        return _halves([run > CONTACT_MARGIN for run in self.runs])


def _halves(sure: list[bool]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Split a list of 2 F flags into those for stance and those for swing."""
    feet = len(sure) // 2
    return np.array(sure[:feet]), np.array(sure[feet:])


class Upright:
    """Detects whether a robot is upright (stands, walks or runs), so that only its feet carry load.

    A robot that lies or sits also rests on other parts, so its weight and motion do not determine the load of
    its feet. In that case its soles are steep or its centre of mass is low. A falling robot has a large mean
    acceleration.

    Args:
        dt: Time between samples in s.
        gravity: Acceleration of free fall in m/s^2.

    Attributes:
        fell: Whether the robot was upright before the last sample and is not any more.
        upright: Whether the robot was upright at the last valid sample.
        lean: Low-pass filtered acceleration of the centre of mass in m/s^2.
        highest: Greatest height of the centre of mass above the lower sole in this episode in m.
    """

    def __init__(self, dt: float, gravity: float = GRAVITY) -> None:
        self._leaning = LEANING * gravity
        self._share = dt / (dt + LEAN_TIME)
        self.lean = (0.0, 0.0, 0.0)
        self.highest = 0.0
        self.upright = self.fell = False

    def at(self, reference: Reference, ground: Floats) -> bool:
        """Process one sample, and return whether the robot was upright.

        Samples must be consecutive. An unknown state (NaN) counts as upright.

        Args:
            reference: The state estimate of this sample.
            ground: Normal of the ground, shape (3,).
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
