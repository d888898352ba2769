"""Which feet surely stand and which surely swing, by their own load, for a robot without joint angles.

Offsets of the map may be wrong. A foot swings where its load is flat at the low end of its range, and stands
where it bears a good part of that range. A foot that is neither is left open, and no calibrator learns from
it. :func:`contacts_from_load` takes a whole recording, and :class:`LoadContacts` a stream.
"""

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d, uniform_filter1d

from surefoot.arrays import Floats
from surefoot.calibration.reference import GRAVITY, Reference

Bools = NDArray[np.bool_]

SURE, SURE_ALOFT = 0.05, 0.025
"""Times in s by which a contact must hold before and after a moment to be sure of it, and by which a sole
must be seen in the air: there its height is a margin of its own."""

SWINGS, LOADED = 0.5, 0.3
"""Range of a foot's load in weights from which it is thought to step at all, and the share of its range above
which it surely bears load."""

MOSTLY = 0.4  # share of rows with a reading that is enough: chips at half the rows' rate have about a half
FLAT = 0.01  # std of a foot's load in weights up to which it may hang in the air

WINDOW = 10.0  # time in s over which a stream's range of load is taken: some steps
AHEAD = SURE + 0.025  # time in s after a sample that its contacts are decided by


def contacts_from_load(load: Floats, weight: float, dt: float) -> tuple[Bools, Bools]:
    """Guess stance and swing, (N, F) each, from the feet's vertical force in N by the starting map, (N, F).

    The map's offsets may be wrong: a foot swings where its load is flat at the low end of its range. A foot
    whose range is less than half the weight never leaves the ground; it is neither.
    """
    low, span = load_range(load)
    steps = span > SWINGS * weight
    read, near = np.isfinite(load), 2 * round(SURE / dt) + 1
    load = np.where(read, load, 0.0)
    share, mean, square = (uniform_filter1d(read * load**p, near, axis=0, mode="nearest") for p in (0, 1, 2))
    mean, square = np.stack([mean, square]) / np.maximum(share, 1.0 / near)
    known = share > MOSTLY
    flat = np.sqrt(np.maximum(square - mean**2, 0.0)) < FLAT * weight
    low = np.where(flat & known, mean, np.inf).min(axis=0)
    swing = flat & (np.abs(mean - low) < 2.0 * FLAT * weight) & steps & known
    stance = (np.where(read, load, mean) > low + LOADED * span) & steps & known
    return erode(stance, dt, SURE_ALOFT), erode(swing, dt, SURE_ALOFT)


def load_range(load: Floats) -> tuple[Floats, Floats]:
    """Return the least load in N and its range of each foot, (F,) each; 0 of a foot that was never read."""
    read = np.where(np.isfinite(load).any(axis=0), load, 0.0)
    low, high = np.nanpercentile(read, (2.0, 98.0), axis=0)
    return low, high - low


def reference_of_contacts(stance: Bools, swing: Bools, position_sole: Any) -> Reference:
    """Make the reference of feet alone: contacts, (..., F), and level soles in m, (..., F, 3)."""
    still = np.zeros((*stance.shape[:-1], 3))
    return Reference(
        com=still,
        com_acceleration=still,
        angular_momentum_rate=still,
        position_sole=position_sole,
        R_level_sole=np.tile(np.eye(3), (*stance.shape, 1, 1)),
        stance=stance,
        swing=swing,
        accelerometer=still + np.array([0.0, 0.0, GRAVITY]),
        gyroscope=still,
    )


def erode(held: Bools, dt: float, margin: float = SURE) -> Bools:
    """Samples whose neighbours up to a margin in s hold as well."""
    kept = minimum_filter1d(held.astype(np.int8), 2 * round(margin / dt) + 1, axis=0, mode="nearest")
    return np.asarray(kept > 0)


class LoadContacts:
    """Contacts by load of a stream: :func:`contacts_from_load` over the last :data:`WINDOW` seconds.

    Args:
        weight: The robot's weight in N.
        feet: Number of the feet, F.
        dt: Time in s between samples.

    Attributes:
        lag: How many samples ago the contacts are of; pass it to the calibrator.

    >>> contacts = LoadContacts(weight=52.0, feet=2, dt=1 / 80)
    >>> step = np.repeat([[52.0, 0.0], [0.0, 52.0]], 40, axis=0)
    >>> for load in np.tile(step, (5, 1)):
    ...     stance, swing = contacts.update(load)
    >>> contacts.lag, stance, swing
    (6, array([False,  True]), array([ True, False]))
    """

    def __init__(self, weight: float, feet: int, dt: float) -> None:
        self._weight, self._dt, self.lag = weight, dt, round(AHEAD / dt)
        self._loads: deque[Floats] = deque(maxlen=round(WINDOW / dt))
        self._nothing = np.zeros(feet, dtype=bool)

    def update(self, load: Any) -> tuple[Bools, Bools]:
        """Take in the feet's vertical force in N by the starting map, (F,); NaN if it was not read.

        Returns:
            Feet that surely stood, and that surely swung, :attr:`lag` samples ago, shape (F,) each.
        """
        self._loads.append(np.asarray(load, dtype=np.float64))
        if len(self._loads) < 2 * self.lag + 2:
            return self._nothing.copy(), self._nothing.copy()
        stance, swing = contacts_from_load(np.array(self._loads), self._weight, self._dt)
        return stance[-1 - self.lag], swing[-1 - self.lag]
