"""What an online calibrator hands back for every sample."""

from enum import IntFlag
from typing import Any, NamedTuple

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""


class Flag(IntFlag):
    """What a channel of an estimate should be read with; bits that add up.

    >>> Flag(3)
    <Flag.MISSING|OUT_OF_RANGE: 3>
    """

    MISSING = 1
    """No reading arrived (NaN): the last one is held."""

    OUT_OF_RANGE = 2
    """The reading is infinite or stands for a force that no foot can see: the last one is held."""

    REFERENCE = 4
    """The reference is not finite or not physical: the last one is held and nothing is learnt from it."""

    GAP = 8
    """The time since the last sample was no time or far too long: filter and window began anew."""

    NO_CONTACT = 16
    """The window holds too few samples with weight on the feet to learn from: parameters unchanged."""

    SINGULAR = 32
    """The normal equations cannot be solved safely: parameters unchanged."""

    STANDING = 64
    """Still collecting the standing start: parameters as they were given."""

    REJECTED = 128
    """What the data asked for was refused as impossible for a sensor: parameters unchanged."""


class Estimate(NamedTuple):
    """Calibrated readings of one sample; any leading batch dimensions, written as ``...``.

    Forces, wrenches and parameters are always finite. A centre of pressure is NaN exactly where its
    validity says that there is none.

    Attributes:
        force: Calibrated channels in N (or the channel's own unit), shape (..., K).
        wrench: Wrenches of the ground on the robot at and in the sole frames in N and N m, shape (..., 2, 6).
        vgrf: Vertical force on each foot in the level frame in N, shape (..., 2).
        cop: Centre of pressure of both feet in the level frame of the reference in m, shape (..., 2).
        cop_foot: Centres of pressure in the sole frames in m, shape (..., 2, 2).
        cop_valid: Where ``cop`` exists (bool), shape (...).
        cop_foot_valid: Where ``cop_foot`` exists (bool), shape (..., 2).
        scale: Newtons per unit of the reading (a count), shape (..., K).
        offset: Force that a reading of zero stands for in N, shape (..., K).
        covariance: Covariance of (scale, offset) relative to the starting map, that is of (a, b) in
            F = a F0 + b, shape (..., 2K, 2K); ``None`` for a method that claims none.
        flags: :class:`Flag` bits of each channel (integers), shape (..., K).
    """

    force: Array
    wrench: Array
    vgrf: Array
    cop: Array
    cop_foot: Array
    cop_valid: Array
    cop_foot_valid: Array
    scale: Array
    offset: Array
    covariance: Array | None
    flags: Array
