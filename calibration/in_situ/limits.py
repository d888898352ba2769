"""Limits of checks, each with its unit and its source.

These are thresholds of checks only. Constants of algorithms are defined in their own modules. A result beyond
any limit can be accepted with a reason by ``accept`` of
:func:`~surefoot.calibration.in_situ.calibrate_in_situ`. "Sound" is the largest value of ten sound logs of
``tests/spoilt/_spoilt_in_situ.py`` (five seeds, with a gyroscope and without), followed by values of its
spoilt logs. A limit that was not measured is marked "chosen".
"""

from typing import Self


class Limit(float):
    """A number with its unit and its evidence."""

    unit: str  # of the number
    source: str  # where it comes from

    def __new__(cls, value: float, unit: str, source: str) -> Self:
        """Return the number with its unit and source."""
        limit = super().__new__(cls, value)
        limit.unit, limit.source = unit, source
        return limit


# Input: channels, masses, gravity.
SAMPLES = Limit(4, "samples", "a mean and three slopes of gravity")
REPEATED = Limit(0.03, "share of samples", "chosen: six channels with noise seldom read the same twice")
HELD = Limit(0.05, "share of the spread", "sound 0; an accelerometer that is held for 1 s 0.07")
STUCK = Limit(0.5, "share of the spread", "sound 0.25, poses that settle; an accelerometer that hangs 0.98")
CAME = Limit(0.67, "share of gravity's jump", "rounded gravity 1/2, held for n samples 1 - 1/n")
SATURATED = Limit(0.002, "share of samples", "chosen; channels of spoilt logs end in 0.03 and more")
TIES = Limit(5, "samples", "equal readings at an end; chosen")
TIES_RATIO = Limit(5.0, "over the mean of the next values", "chosen: turning points end by rounding as well")
ROUNDED = Limit(4.0, "deviations", "a sum of six rounded values is off by 4.2 at most")
HEAVIEST = Limit(100.0, "kg", "more than any added mass; 0.1 kg in grams is 100")
FARTHEST = Limit(5.0, "m", "no limb is longer; 5 mm in mm")
SHORTEST_GRAVITY = Limit(8.8, "m/s^2", "9.78 less a bias of 1")
LONGEST_GRAVITY = Limit(10.8, "m/s^2", "9.83 and such a bias")
SAME_UNIT = Limit(0.2, "share", "units are factors of 9.8 apart")
SPEEDING = Limit(0.05, "share of gravity", "sound 0.0007; a leg at 38 degrees a second 0.0035")
TILT = Limit(0.02, "share of gravity", "a turn of 2 degrees to either side")
EARTH = Limit(0.006, "share of gravity", "9.780 m/s^2 at the equator to 9.832 at the poles")
ACCELEROMETER = Limit(3.0, "deviations", "0.3 % of sound logs get a word")
LATE = Limit(1e-3, "s", "half of a sample at 500 Hz")
VERY_LATE = Limit(0.1, "s", "chosen: sound logs have up to 0.05")
LATEST = Limit(1.0, "s", "chosen: a longer lag is no delay")

# Within sets: rejected samples, residuals, temperature.
REJECTED = Limit(
    0.05, "share of samples", "sound 0; a push of 3 s in a minute 0.05, a foot on the floor 0.13"
)
REJECTED_MOVING = Limit(0.1, "share of samples", "sound 0; a differentiated gyroscope's error has long tails")
REJECTED_POSES = Limit(0.2, "share of samples", "chosen: without times each row stands for itself")
STRAY = Limit(0.002, "share of samples", "sound 0; a warning alone")
FEW_REJECTED = Limit(0.01, "share of samples", "chosen: beyond it causes are judged by all samples")
RESIDUAL = Limit(0.03, "share of a set's spread", "sound 0.0036; a leg at 76 degrees a second 0.037")
NOISY = Limit(
    0.12,
    "share of a set's spread",
    "without times: white noise of sound sets 0.05, a tool that was changed 0.22",
)
BENDING = Limit(0.003, "share of a set's spread", "sound 0.0015; a knee that gives by 0.005 rad/(N m) 0.004")
BENDING_BESIDE = Limit(0.0105, "share of a set's spread", "hysteresis of sets too short to show it")
BENDS_MOSTLY = Limit(0.7, "share of the residual", "sound 0.67; the knee 0.83 and more")
BENDS_PARTLY = Limit(
    0.45, "share of the residual", "five squares of 100 numbers of another law of hysteresis: 1 in 1,000"
)
HYSTERESIS = Limit(0.01, "share of the swing", "chosen, as a deviation: cheap gauges have 2 %")
HIDDEN = Limit(0.003, "share of the swing", "chosen: a third of that")
WARMING = Limit(0.3, "K", "three times the 0.1 K to which thermistors read")
NOT_GRAVITY = Limit(0.1, "share of a temperature's spread", "its coefficient is ten times less sure there")

# Between sets.
STRAINED = Limit(
    3.0, "over the squares that noise explains", "sound 2.5; a mass off by 10 % 15, an IMU by 5 deg 4.6"
)
MASS = Limit(0.05, "share of the largest added mass, or its lever", "sound 0.0095; a mass off by 10 % 0.078")
MASS_SEEN = Limit(0.012, "the same", "a word: sound 0.0095; a cable's pull of 8 % of the limb's weight 0.019")
MOVED = Limit(
    0.03, "share of contact loads", "by a slight contradiction's cause: an IMU turned by 3 degrees 0.054"
)
SLOW = Limit(0.15, "share of gravity's spread that a drift leaves", "the answer is seven times less sure")
STILL = Limit(0.02, "share of gravity", "a direction along which it did not turn, as TILT")

# The answer.
SCALE = Limit(
    0.1, "share of the limb's mass", "scales of two sensors that had aged were off by 0.11 and 0.19"
)
AXIS = Limit(0.5, "share of an axis's load", "an axis whose gain is unsure by half is unobservable")
LONGEST_ARM = Limit(1.0, "m", "a humanoid's leg has its centre of mass within 0.5")
LEAST_GAIN = Limit(0.4, "over the maker's", "sensors that had aged had 0.8 to 1.2; a pound is 0.45 kg")
LARGEST_GAIN = Limit(2.5, "over the maker's", "the same")
LIMB_SIGMAS = Limit(4.0, "deviations", "1 in 16,000 by chance")
FACTORY_APART = Limit(
    0.3, "logarithm of masses", "scales of two sensors that had aged were off by 0.11 and 0.19"
)

# A factory matrix against the readings.
FACTORY_MISSES = Limit(0.1, "share of the load", "sensors that had aged were off by as much")
MISPRINT = Limit(0.7, "share of a row's largest entry", "a lost sign or digit; sensors age by less")
READ_BETTER = Limit(
    0.7, "share of what is missed", "chosen: another way to read a matrix that is worth a look"
)
