"""A six-axis sensor of strain gauges: its maker's matrix, its errors and its converter."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from surefoot.arrays import Floats
from surefoot.checks import is_whole
from surefoot.sensors.configuration import (
    Error,
    ErrorField,
    NotNegative,
    Positive,
    check_fields,
    require,
)
from surefoot.sensors.devices.force_torque import AXES, per_axis
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE
from surefoot.sensors.stages.creep import check_creep
from surefoot.sensors.stages.nonlinearity import cross_slope

Matrix = tuple[tuple[float, ...], ...]
"""Rows of a matrix; nested tuples, so that configurations compare, hash and travel through JSON."""

FTSENS_SN039: Matrix = (
    (0.0005779, -0.000490904, -0.023418914, -0.000315359, -0.001963616, 0.02412886),
    (0.001296632, 0.027701899, -0.013808145, -0.001016616, 0.001016616, -0.013581635),
    (-0.021660896, 0.000138864, 0.0002347, 0.020536289, 0.020821842, 0.000678675),
    (4.9002e-05, 0.00022237, -0.000117233, -0.000336812, 0.000276541, -0.000100864),
    (0.000376392, -1.2406e-05, -0.000178406, 0.000174617, 0.000158322, 0.00019735),
    (1.482e-05, 0.00023669, 0.000215254, 8.762e-06, -1.102e-05, 0.000225245),
)
"""The maker's matrix of the FTSens number 39, in the leg of an iCub, in N and N m per count."""

FTSENS_SN142: Matrix = (
    (-3.512e-06, -0.000289165, -0.018467922, 0.000592378, 0.00014868, 0.01884489),
    (0.000141029, 0.021867615, -0.010802271, -2.0341e-05, 0.000729553, -0.010863293),
    (0.016491286, -0.000622283, -0.000247659, 0.016731108, 0.01716216, -0.00010502),
    (-8.354e-06, 0.000208576, -0.000102765, -0.000231934, 0.000255572, -0.000101284),
    (-0.000280548, 7.391e-06, -0.000166908, 0.000155331, 0.000147651, 0.000160499),
    (-1.026e-06, 0.000194068, 0.000187981, -3.185e-06, 1.097e-06, 0.000184212),
)
"""The maker's matrix of the FTSens number 142, in a foot of an iCub, in N and N m per count."""


@dataclass(frozen=True)
class StrainGauges:
    """A six-axis sensor as its k >= 6 gauges see it; the defaults are the old FTSens in an iCub's leg.

    Matrix, converter, noise and range of the offsets are published or measured figures. Those of creep and
    drift are typical of strain-gauge transducers: nobody has published them for this sensor.
    """

    matrix: Matrix = FTSENS_SN039
    """The maker's matrix C in N and N m per count, six rows of k. What the gauges put out per N and N m is
    its (pseudo-)inverse A: for more than six gauges, whose A is known, give the pseudo-inverse of it."""

    full_scale_force: Positive = 1500.0
    """Largest force along each axis in N: what cross-talk and hysteresis are shares of."""

    full_scale_torque: Positive = 35.0
    """Largest torque about each axis in N m: what cross-talk and hysteresis are shares of."""

    scale_error_std: Annotated[Error, ErrorField(0.5)] = 0.2
    """How far each axis's scale has changed since the matrix was made: standard deviation of its logarithm.
    The scales of one iCub's foot were off by 11 to 19 %."""

    cross_talk_std: Annotated[Error, ErrorField(0.5)] = 0.03
    """Standard deviation of what one axis has come to feel of another, in shares of the full scales. With a
    scale error of 0.2 the maker's matrix shows the weight of a leg of 4.9 kg as an ellipsoid whose longest
    axis is 1.9 times the shortest in the median, 1.4 to 2.8 times in 80 % of sensors; the old one in an
    iCub's leg showed 1.7 to 1.9 (in-situ paper, Table I: 77, 44 and 40 N with no mass added)."""

    offset_force: Error = 290.0
    """Offsets of the gauges at power-up lie uniformly within what the maker's matrix shows as this force in
    N on each axis (up to 290 N were seen in the legs of an iCub) ..."""

    offset_torque: Error = 1.0
    """... and this torque in N m, for which nobody has published a figure. With a leg of 4.9 kg and 0.7 kg at
    its foot, swung by 45 degrees, 0.7 % of such sensors reach the end of the converter."""

    noise_force: Error = 0.1
    """Standard deviation of a reading's white noise, as the maker's matrix shows it, in N; 0.10 to 0.15 N
    were measured on an iCub at rest."""

    noise_torque: Error = 0.0025
    """The same for torques in N m; 0.002 to 0.003 N m were measured."""

    adc_bits: int = 16
    """Bits of the converter: counts are whole and end at +-(2^(bits - 1) - 1). 0 leaves it out."""

    hysteresis: Annotated[Error, ErrorField(0.08)] = 0.01
    """Width of a loop at mid-load over the load's peak-to-peak swing, of each component of the wrench on its
    own (see :func:`~surefoot.sensors.stages.hysteresis.hysteresis`)."""

    hysteresis_true_force: Positive = 50.0
    """Amplitude in N of the cycle whose ends are read without an error of slope (a loop that is as wide at
    every scale is steeper by its share for each doubling): about the weight of a leg ..."""

    hysteresis_true_torque: Positive = 5.0
    """... and in N m what that weight does at the hip."""

    nonlinearity: Annotated[Error, ErrorField(0.08)] = 0.0
    """Largest departure of an axis's cubic term in shares of the full scale, drawn at power-up (see
    :func:`~surefoot.sensors.stages.nonlinearity.cross_nonlinearity`) ..."""

    cross_nonlinearity: Annotated[Error, ErrorField(0.018)] = 0.0
    """... and of what two axes at their full scales add to each. An affine map left errors up to 16 N of a
    sensor of an iCub3, a polynomial 6 N (arXiv 2312.09846)."""

    creep_shares: Annotated[tuple[float, ...], ErrorField()] = (0.0005, 0.0005)
    """What a constant load adds to its reading in the end, in shares of it, one exponential each."""

    creep_time_constants: tuple[float, ...] = (30.0, 600.0)
    """Time constants of the exponentials in s."""

    offset_drift_force: Error = 0.05 * PER_SQRT_MINUTE
    """Random walk of the offsets, as the maker's matrix shows it, in N/sqrt(s); 0.05 N per square root of a
    minute, or 0.4 N in an hour."""

    offset_drift_torque: Error = 0.001 * PER_SQRT_MINUTE
    """The same for torques in N m/sqrt(s)."""

    offset_tempco_force: Error = 0.05
    """Standard deviation of what a kelvin does to the offsets, as the maker's matrix shows it, in N/K, each
    sensor its own; one iCub's went by 0.71 N from 25 to 39 degrees Celsius."""

    offset_tempco_torque: Error = 0.001
    """The same for torques in N m/K."""

    scale_tempco: Error = 2e-4
    """Standard deviation of the relative change of a gauge's scale per kelvin in 1/K, each gauge its own."""

    temperature_ramp: NotNegative = 0.0
    """Rate at which the sensor warms up from power-up on in K/s; 0 has been on for long, 14/900 with a rise
    of 14 is what a robot's foot was seen to do."""

    temperature_rise: NotNegative = 0.0
    """Where the warming levels off in K, exponentially; 0 for a ramp that goes on."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value is impossible."""
        check_fields(self)
        self._check_matrix()
        for name in ("scale_error_std", "cross_talk_std"):
            require(getattr(self, name) <= 0.5, self, name, "be at most 0.5")
        possible = is_whole(self.adc_bits) and (self.adc_bits == 0 or 2 <= self.adc_bits <= 32)
        require(possible, self, "adc_bits", "be 0 or lie in 2 to 32")
        require(self.hysteresis <= 0.08, self, "hysteresis", "be at most 0.08")
        for name in ("force", "torque"):
            most = getattr(self, f"full_scale_{name}")
            field = f"hysteresis_true_{name}"
            require(getattr(self, field) <= most, self, field, f"be at most the full scale, {most}")
        possible = cross_slope(self.nonlinearity, self.cross_nonlinearity, AXES) < 1.0
        rule = "keep 5.2 nonlinearity + 30 cross_nonlinearity below 1, or two loads could have one reading"
        require(possible, self, "cross_nonlinearity", rule)
        check_creep(self)

    def _check_matrix(self) -> None:
        try:
            values = np.atleast_2d(np.array(self.matrix, dtype=np.float64))
        except (TypeError, ValueError):
            values = np.zeros((0, 0))
        rows, columns = values.shape if values.ndim == 2 else (0, 0)
        possible = rows == AXES and columns >= AXES
        require(possible, self, "matrix", "have six rows of at least six numbers")
        object.__setattr__(self, "matrix", tuple(tuple(row.tolist()) for row in values))
        shares = values / self.full_scale[:, None]
        ranked = np.isfinite(values).all() and int(np.linalg.matrix_rank(shares)) == AXES
        require(bool(ranked), self, "matrix", "be finite and have rank six")

    @property
    def channels(self) -> int:
        """Number of gauges k."""
        return len(self.matrix[0])

    @property
    def bends(self) -> bool:
        """Whether the element bends out of proportion."""
        return self.nonlinearity > 0.0 or self.cross_nonlinearity > 0.0

    @property
    def noisy(self) -> bool:
        """Whether readings have noise."""
        return self.noise_force > 0.0 or self.noise_torque > 0.0

    @property
    def walks(self) -> bool:
        """Whether offsets drift at random."""
        return self.offset_drift_force > 0.0 or self.offset_drift_torque > 0.0

    @property
    def full_scale(self) -> Floats:
        """Largest component along each axis in N and N m, shape (6,)."""
        return per_axis(self.full_scale_force, self.full_scale_torque)

    @property
    def hysteresis_true(self) -> Floats:
        """Amplitudes of the cycles whose ends are read right in shares of the full scales, shape (6,)."""
        return per_axis(self.hysteresis_true_force, self.hysteresis_true_torque) / self.full_scale

    @property
    def nominal_matrix(self) -> Floats:
        """The maker's matrix C in N and N m per count, shape (6, k)."""
        return np.array(self.matrix)

    @property
    def nominal_response(self) -> Floats:
        """Counts per N and N m by the maker's matrix, A with C A = I, shape (k, 6)."""
        scale = self.full_scale
        # In shares of the full scales, or forces and torques in their units would cost digits.
        response: Floats = np.linalg.pinv(self.nominal_matrix / scale[:, None]) / scale
        return response

    @property
    def code_range(self) -> tuple[float, float]:
        """Lowest and highest reading in counts."""
        most = 2.0 ** (self.adc_bits - 1) - 1.0 if self.adc_bits else float("inf")
        return -most, most
