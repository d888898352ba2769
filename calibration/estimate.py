"""The result of an online calibrator for every sample."""

from enum import IntFlag
from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array


class Flag(IntFlag):
    """Warnings about a channel of an estimate, as bits that can be combined.

    >>> Flag(3)
    <Flag.MISSING|OUT_OF_RANGE: 3>
    >>> Flag(np.int64(9216))  # of an array
    <Flag.DEAD|LOST: 9216>
    """

    _value_: int
    words: str  # the flag in a few words, for tables and messages

    def __new__(cls, value: int, words: str = "") -> "Flag":
        """Create a flag from its bit and its words. Combinations of flags have no words."""
        flag = int.__new__(cls, value)
        flag._value_, flag.words = value, words
        return flag

    @property
    def label(self) -> str:
        """The names of the flags for a figure or a page.

        >>> (Flag.DEAD | Flag.OUT_OF_RANGE).label
        'out of range, dead'
        """
        return ", ".join(str(flag.name).lower().replace("_", " ") for flag in self)

    @classmethod
    def _missing_(cls, value: object) -> "Flag":
        return cls(int(value)) if isinstance(value, np.integer) else super()._missing_(value)

    MISSING = 1, "no reading arrived; the last one is held"
    """No reading arrived (NaN). The last one is held."""

    OUT_OF_RANGE = 2, "a reading that no foot can give, or a jump; the last one is held"
    """The reading is infinite, larger than any force on a foot, or a jump. The last one is held."""

    REFERENCE = 4, "the motion is not known or not physical; nothing is learnt"
    """The reference is not finite or not plausible for a robot (are lengths in metres?). The last one is
    held, and nothing is learnt from it."""

    GAP = 8, "the clock jumped; filters start again"
    """The time since the last sample is zero, negative or far too long. Filters and windows start again."""

    NO_CONTACT = 16, "too little weight on the feet to learn from"
    """The window holds too few samples with weight on the feet. Parameters do not change."""

    SINGULAR = 32, "the data do not separate the parameters, which do not change"
    """The normal equations are close to singular. Parameters do not change."""

    STANDING = 64, "still collecting the standing start"
    """The standing start is still being collected. Parameters are the initial ones."""

    REJECTED = 128, "the data require an implausible map; rejected"
    """The data require parameters that no sensor has. Parameters do not change."""

    SPIKE = 256, "a single reading far off"
    """The reading was out of range for up to three samples, and has returned."""

    STUCK = 512, "the channel keeps one value"
    """The reading does not change although the load does. The channel is not used."""

    DEAD = 1024, "the channel does not follow the load"
    """The reading does not follow the load. The channel is not used."""

    FLIPPED = 2048, "the channel has the wrong sign"
    """The reading follows the load with the wrong sign. Its sign is reversed."""

    SWAPPED = 4096, "the channel reads another channel's load"
    """The reading follows another channel's load. The two channels are exchanged."""

    LOST = 8192, "the channel is not used; its force is estimated from the others"
    """The channel is not used. Its force is reconstructed from the foot's other channels."""

    SATURATED = 16384, "the channel is at the end of its range"
    """The reading is at an end of its range. The channel is not used until it returns."""

    HELD = 32768, "an external force carries or pushes the robot; nothing is learnt from its motion"
    """An external force carries or pushes the robot. Nothing is learnt from its motion."""

    WORSE_THAN_START = 65536, "the starting map agrees better with the motion than the learnt map does"
    """On samples from which neither map was learnt, the starting map agrees better with the robot's motion
    and weight than the learnt map does. Reset the calibration, or look for an error in the robot's model."""


ALL_FLAGS = int(~Flag(0))  # every flag at once


class Estimate(NamedTuple):
    """Calibrated readings of one sample. In a replay, each field has the samples on its first axis.

    Forces, wrenches and parameters are always finite. A centre of pressure is NaN exactly where its
    validity is false. Forces and single feet are as they were read. If readings are older by the setup's
    ``age``, ``cop`` is extrapolated to the current time. The aligned values belong to one common moment,
    ``FootCalibrator.aligned_lag`` samples ago (:mod:`surefoot.calibration.front_end.ages`).

    Attributes:
        force: Calibrated channels in N (or the channel's own unit), shape (K,).
        wrench: Wrenches of the ground on the robot at and in the sole frames in N and N m, shape (2, 6).
        vgrf: Vertical force on each foot in the level frame in N, shape (2,).
        cop: Centre of pressure of both feet in the level frame of the reference in m, shape (2,).
        cop_foot: Centres of pressure in the sole frames in m, shape (2, 2).
        cop_valid: Whether ``cop`` is defined (bool), shape ().
        cop_foot_valid: Whether ``cop_foot`` is defined (bool), shape (2,).
        scale: Newtons per unit of the reading (a count), shape (K,).
        offset: Force at a reading of zero in N, shape (K,).
        covariance: Covariance of (scale, offset) relative to the starting map, that is of (a, b) in
            F = a F0 + b, shape (2K, 2K). ``None`` if the method does not report one.
        flags: :class:`Flag` bits of each channel (integers), shape (K,).
        force_std: Standard deviation of ``force`` by that covariance in N, shape (K,), or ``None``.
        cop_covariance: Covariance of ``cop`` by it in m^2, shape (2, 2), NaN if ``cop`` is not defined, or
            ``None``.
        nis: Normalised innovation squared of the update at this sample, shape (), NaN at samples without
            one; or ``None``.
        nis_rows: Number of rows, its degrees of freedom, shape (), or ``None``.
        cop_measured: Centre of pressure of the forces without extrapolation, in m, shape (2,), NaN if it is
            not defined. It equals ``cop`` if readings have no age.
        force_aligned: Calibrated channels at the common moment, shape (K,).
        cop_aligned: Centre of pressure of both feet at that moment in m, in the level frame of ``cop``, shape
            (2,), NaN if it is not defined.
        cop_foot_aligned: Centres of pressure in the sole frames at that moment in m, shape (2, 2), NaN if
            they are not defined.
        undetermined: Posterior variance of each scale as a share of its prior variance, from 0 to 1, shape
            (K,). At 1 the data have not determined the scale. Or ``None``.
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
    force_aligned: Array | None = None
    cop_aligned: Array | None = None
    cop_foot_aligned: Array | None = None
