"""Limits that findings are held against: each a number with its unit and where it comes from.

What they decide is in the checks that use them; constants of algorithms stand beside these. ``accept`` of
:func:`~surefoot.calibration.in_situ.calibrate_in_situ` passes any limit with a reason.
"""

from typing import Self


class Limit(float):
    """A number with its unit and its evidence.

    Attributes:
        unit: Of the number.
        source: Where it comes from.
    """

    unit: str
    source: str

    def __new__(cls, value: float, unit: str, source: str) -> Self:
        """Return the number with what is said of it."""
        limit = super().__new__(cls, value)
        limit.unit, limit.source = unit, source
        return limit


# At the door: channels, masses, gravity.
SAMPLES = Limit(4, "samples", "a mean and three slopes of gravity")
SATURATED = Limit(0.002, "share of samples", "spikes; a clipped channel of the spoilt logs has 0.03 and more")
TIES = Limit(5, "samples", "equal readings at an end; noise without a converter has one")
TIES_RATIO = Limit(5.0, "over the mean of the next values", "a rounded turning point has up to 3")
HEAVIEST = Limit(100.0, "kg", "nobody hangs more on a limb; 0.1 kg in grams")
FARTHEST = Limit(5.0, "m", "no limb is longer; 5 mm in mm")
SHORTEST_GRAVITY = Limit(8.8, "m/s^2", "9.78 less a bias of 1, ten times that of a bad MEMS sensor")
LONGEST_GRAVITY = Limit(10.8, "m/s^2", "9.83 and such a bias")
SAME_UNIT = Limit(0.2, "share", "units are factors of 9.8 apart; a bias and a scale make 0.15")
SPEEDING = Limit(0.05, "share of gravity", "a leg swung at 38 degrees a second without a gyroscope")
TILT = Limit(0.02, "share of gravity", "1 degree to either side: noise of 0.1 m/s^2 shows 0.01")
EARTH = Limit(0.006, "share of gravity", "9.780 m/s^2 at the equator to 9.832 at the poles")
ACCELEROMETER = Limit(3.0, "deviations", "0.3 % of sound logs get a word")
LATE = Limit(1e-3, "s", "half of a sample at 500 Hz")
LATEST = Limit(1.0, "s", "no driver buffers longer")

# Within sets: samples left out, what no rigid limb explains, temperature.
REJECTED = Limit(
    0.05, "share of samples", "sound logs leave out up to 0.002; a touch of 3 s a minute is 0.05"
)
REJECTED_MOVING = Limit(0.1, "share of samples", "a differentiated gyroscope's error has long tails")
STRAY = Limit(0.002, "share of samples", "spikes of a bus; sound logs stay below")
FEW_REJECTED = Limit(0.01, "share of samples", "beyond it causes are judged by all samples")
RESIDUAL = Limit(0.03, "share of a set's spread", "hysteresis of 1.5 % that is not fitted leaves 0.01")
NOISY = Limit(0.3, "share of a set's spread", "white noise of rows without an order; beyond it is no sensor")
BENDING = Limit(0.003, "share of a set's spread", "a leg with a slack of 0.005 rad has 0.004")
BENDING_BESIDE = Limit(0.0105, "share of a set's spread", "hysteresis of 1 % in sets too short to show it")
BENDS_MOSTLY = Limit(0.7, "share of the residual", "of a bending limb's residual squares explain 0.9")
BENDS_PARTLY = Limit(0.2, "share of the residual", "the same beside hysteresis that was fitted")
WARMING = Limit(0.3, "K", "sensors read to 0.1 K; gauges drift by some counts a K")
NOT_GRAVITY = Limit(0.1, "share of a temperature's spread", "its coefficient is ten times less sure there")
COEFFICIENTS = Limit(3.0, "deviations", "0.3 % of sensors whose coefficient is one")

# Between sets.
STRAINED = Limit(3.0, "over the squares that noise explains", "sound sets with hysteresis have up to 2")
MASS = Limit(0.05, "share of the largest added mass, or its lever", "kitchen scales and rulers: 0.01")
MASS_LOOKED = Limit(0.0075, "the same", "from where on a set by itself is looked at")
CULPRIT = Limit(0.8, "share of what is left", "of one wrong mass it explains 0.95")
MASS_ALONE = Limit(0.015, "share of the largest added mass", "of one set that explains what is left")
TURNED = Limit(0.025, "rad", "an IMU that is screwed on: 1.4 degrees")
TURNED_SIGMAS = Limit(4.0, "deviations", "1 in 16,000 by chance")
SLOW = Limit(0.15, "share of gravity's spread that a drift leaves", "the answer is seven times less sure")
STILL = Limit(0.02, "share of gravity", "a direction that it did not turn along, as at the door")

# The answer.
SCALE = Limit(0.1, "share of the limb's mass", "makers' scales of aged sensors are off by 0.11 and 0.19")
AXIS = Limit(0.5, "share of an axis's load", "an axis that is known to half of it was not seen")
LONGEST_ARM = Limit(1.0, "m", "a humanoid's leg has its centre of mass within 0.5")
LEAST_GAIN = Limit(0.4, "over the maker's", "sensors that had aged had 0.8 to 1.2")
LARGEST_GAIN = Limit(2.5, "over the maker's", "the same; a pound is 0.45 kg")
LIMB_SIGMAS = Limit(4.0, "deviations", "1 in 16,000 by chance")
FACTORY_APART = Limit(0.3, "logarithm of masses", "scales of two aged sensors were off by 0.11 and 0.19")
KNOWN = Limit(0.9, "share of the information", "the prior makes deviations smaller by 5 %")

# A factory matrix against the readings.
FACTORY_MISSES = Limit(0.1, "share of what hangs there", "an aged sensor; a turned sign misses more")
MISPRINT = Limit(0.7, "share of a row's largest entry", "a lost sign or digit; sensors age by less")
READ_BETTER = Limit(0.7, "share of what is missed", "another way to read a matrix that is worth a look")
CLEARER = Limit(10.0, "nats", "1 in 22,000")
FACTORY_SCALE = Limit(0.6931471805599453, "logarithm", "a factor of two: sensors age by less")
OTHER_UNIT = Limit(0.5, "share of that logarithm", "twice as near to another unit")
AXES_APART = Limit(3.0, "factor between axes", "axes age by less, units change all alike")
