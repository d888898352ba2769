"""The result of an online calibrator for every sample."""

from enum import IntFlag
from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array


class Flag(IntFlag):
    """Doubts about a channel of an estimate; bits that add up.

    >>> Flag(3)
    <Flag.MISSING|OUT_OF_RANGE: 3>
    >>> Flag(np.int64(9216))  # of an array
    <Flag.DEAD|LOST: 9216>
    """

    _value_: int
    words: str  # the flag in a few words, for tables and messages

    def __new__(cls, value: int, words: str = "") -> "Flag":
        """Make a flag of its bit and its words; combinations of flags have no words."""
        flag = int.__new__(cls, value)
        flag._value_, flag.words = value, words
        return flag

    @classmethod
    def _missing_(cls, value: object) -> "Flag":
        return cls(int(value)) if isinstance(value, np.integer) else super()._missing_(value)

    MISSING = 1, "no reading arrived; the last one is held"
    """No reading arrived (NaN): the last one is held."""

    OUT_OF_RANGE = 2, "a reading that no foot can give, or a jump; the last one is held"
    """The reading is infinite, is a force that no foot can see, or has leapt away: the last one is held."""

    REFERENCE = 4, "the motion is not known or not physical; nothing is learnt"
    """The reference is not finite or not of a robot's size (metres?): the last one is held, and nothing is
    learnt from it."""

    GAP = 8, "the clock jumped; filters start again"
    """The time since the last sample is zero, negative or far too long: filter and window are empty again."""

    NO_CONTACT = 16, "too little weight on the feet to learn from"
    """The window holds too few samples with weight on the feet to learn from: parameters unchanged."""

    SINGULAR = 32, "the data do not separate the parameters; they stay"
    """The normal equations cannot be solved safely: parameters unchanged."""

    STANDING = 64, "still collecting the standing start"
    """Still collecting the standing start: parameters as they were given."""

    REJECTED = 128, "the data ask for what no sensor does; refused"
    """What the data ask for is impossible for a sensor: parameters unchanged."""

    SPIKE = 256, "a single reading far off"
    """The reading was out of range for up to three samples, and has come back to where it was."""

    STUCK = 512, "the channel keeps one value"
    """The reading has not changed at all while the load did: the channel is out."""

    DEAD = 1024, "the channel does not follow the load"
    """The reading does not follow the load: the channel is out."""

    FLIPPED = 2048, "the channel has the wrong sign"
    """The reading follows the load with the wrong sign: it is turned round."""

    SWAPPED = 4096, "the channel reads another one's load"
    """The reading follows another channel's load: both are exchanged."""

    LOST = 8192, "the channel is out; its force comes from the others"
    """The channel is out, and its force is reconstructed from the foot's other channels."""

    SATURATED = 16384, "the channel is at the end of its range"
    """The reading stays at an end of its range: the channel is out while it does."""

    HELD = 32768, "something besides the feet carries or pushes the robot; nothing is learnt from its motion"
    """Something besides the feet carries or pushes the robot: nothing is learnt from its motion."""

    WORSE_THAN_START = 65536, "the starting map agrees better with the motion than the learnt map does"
    """The starting map would agree with the robot's motion and weight better than the learnt map does, by
    samples that neither was learnt from: reset the calibration, or look for a fault of the robot's model."""


ALL_FLAGS = int(~Flag(0))  # every flag at once


class Estimate(NamedTuple):
    """Calibrated readings of one sample; a replay of N samples has N first in each field.

    Forces, wrenches and parameters are always finite. A centre of pressure is NaN exactly where its
    validity is false. Forces, and all that is made of them, are those of now: where readings are older by the
    setup's ``age``, they are carried on from there (:mod:`surefoot.calibration.front_end.ages`).

    Attributes:
        force: Calibrated channels in N (or the channel's own unit), shape (K,).
        wrench: Wrenches of the ground on the robot at and in the sole frames in N and N m, shape (2, 6).
        vgrf: Vertical force on each foot in the level frame in N, shape (2,).
        cop: Centre of pressure of both feet in the level frame of the reference in m, shape (2,).
        cop_foot: Centres of pressure in the sole frames in m, shape (2, 2).
        cop_valid: Whether ``cop`` exists (bool), shape ().
        cop_foot_valid: Where ``cop_foot`` exists (bool), shape (2,).
        scale: Newtons per unit of the reading (a count), shape (K,).
        offset: Force that a reading of zero stands for in N, shape (K,).
        covariance: Covariance of (scale, offset) relative to the starting map, that is of (a, b) in
            F = a F0 + b, shape (2K, 2K); ``None`` for a method that claims none.
        flags: :class:`Flag` bits of each channel (integers), shape (K,).
        force_std: Standard deviation of ``force`` by that covariance in N, shape (K,), or ``None``.
        cop_covariance: Covariance of ``cop`` by it in m^2, shape (2, 2), NaN where there is no centre of
            pressure; or ``None``.
        nis: Normalised innovation squared of the update at this sample, shape (), NaN at samples without
            one; or ``None``.
        nis_rows: Number of rows, its degrees of freedom, shape (), or ``None``.
        cop_measured: Centre of pressure of the forces as they were read, in m, shape (2,), NaN where they
            have none; ``cop`` itself where readings have no age.
        undetermined: Share of each scale's variance at the start that the data have left, from 0 to 1, shape
            (K,): where it is 1, the scale is the starting map's; or ``None``.
        contact_probability: Probability that a foot bears load, shape (2,), or ``None``.
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
    force_std: Array | None = None
    cop_covariance: Array | None = None
    nis: Array | None = None
    nis_rows: Array | None = None
    cop_measured: Array | None = None
    undetermined: Array | None = None
    contact_probability: Array | None = None
