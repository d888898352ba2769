r"""Six-axis force-torque sensors: wrenches in, counts out.

Six strain gauges feel all six components of a wrench, and a matrix of the maker's turns them back. The error
of that matrix is a matrix as well: on its diagonal the errors of the scales, beside it the cross-talk of one
axis into another. Each axis has an offset. Scales and offsets drift, and the converter adds noise, clips and
rounds:

.. math:: s = \mathrm{round}\big(K ((I + D E D^{-1}) w + z) + n\big),

with the counts :math:`K` per newton and newton metre, the full scales :math:`D` of the axes, without which a
cross-talk between forces and torques would have no meaning, the errors :math:`E`, the offset :math:`z` in N
and N m and noise :math:`n`. The map that undoes it is the in-situ paper's
(Traversaro, Pucci and Nori, 2015, Eq. 2),

.. math:: w = C (s - o), \qquad C = (I + D E D^{-1})^{-1} K^{-1}, \quad o = K z.

Channels are (fx, fy, fz, tx, ty, tz) of one sensor after the other. The codes reach the host over a wire
(:mod:`surefoot.sensors.transport.wire`). The converters read all axes at once, 100 times a second and more:
none has a clock here. :mod:`surefoot.sensors.devices.strain_gauges` is the finer model of the same kind of
sensor, with creep, hysteresis, temperature and crossed gauges.
"""

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.sensors.configuration import (
    Error,
    ErrorField,
    NotNegative,
    Positive,
    Whole,
    check_fields,
    require,
)
from surefoot.sensors.corruption import Corruption, Rng, check_channels, device, limit
from surefoot.sensors.randomness import normal
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE
from surefoot.sensors.transport.wire import DIRECT, Wire, wire

AXES = 6  # channels of a sensor, the components of a wrench (fx, fy, fz, tx, ty, tz)

MOST_ERROR = 0.25
"""Largest ``initial_scale_std + 5 cross_talk_std`` (one axis and the five others) for which the matrices of
all sensors that can be drawn are invertible."""


@dataclass(frozen=True)
class ForceTorque:
    """A set of six-axis sensors; the defaults are like the FTSens in an iCub's ankles, by the maker's matrix.

    Resolution and noise are those seen on a real iCub (steps of 0.05 to 0.068 N and 1.1 mN m, 0.10 to 0.15 N
    and 2 to 3 mN m at rest). The scales of its maker's matrix were off by 11 to 19 %, the offsets in a leg
    were up to 290 N; the defaults take the offsets of a sensor that was tared before it was mounted.
    """

    sensors: Whole = 2
    """Number of sensors: (left, right)."""

    full_scale_force: Positive = 1500.0
    """Largest force along each axis in N, where the converter clips."""

    full_scale_torque: Positive = 35.0
    """Largest torque about each axis in N m, where the converter clips. With the largest force it also sets
    what cross-talk between forces and torques means: shares of the full scales."""

    resolution_force: NotNegative = 0.06
    """What a count stands for by the maker's matrix in N; 0, for both resolutions together, leaves the
    converter out: readings are in N and N m then, without rounding or clipping."""

    resolution_torque: NotNegative = 0.0011
    """What a count stands for by the maker's matrix in N m."""

    noise_force: Error = 0.12
    """Standard deviation of the noise of a reading in N."""

    noise_torque: Error = 0.0025
    """Standard deviation of the noise of a reading in N m."""

    initial_scale_std: Error = 0.08
    """Standard deviation of the relative error of each axis's scale at power-up."""

    cross_talk_std: Error = 0.01
    """Standard deviation of what one axis feels of another, in shares of the full scales; constant from
    power-up."""

    initial_offset_force_std: Error = 5.0
    """Standard deviation of a force's offset at power-up in N."""

    initial_offset_torque_std: Error = 0.1
    """Standard deviation of a torque's offset at power-up in N m."""

    scale_drift: Error = 0.002 * PER_SQRT_MINUTE
    """Random walk of each axis's scale per sqrt(s); 0.2 % per square root of a minute."""

    offset_drift_force: Error = 0.2 * PER_SQRT_MINUTE
    """Random walk of a force's offset in N/sqrt(s); 0.2 N per square root of a minute."""

    offset_drift_torque: Error = 0.004 * PER_SQRT_MINUTE
    """Random walk of a torque's offset in N m/sqrt(s); 4 mN m per square root of a minute."""

    averaged: bool = True
    """Whether a reading is the mean since the host read before, as of a board that samples a thousand times a
    second and averages, and so stands for the middle of that time; ``False`` takes the value of the instant.
    """

    wire: Annotated[Wire, ErrorField()] = DIRECT
    """What happens to a code on its way to the host: spikes, wrong words, repeats, losses, delay."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value is impossible."""
        check_fields(self)
        require(
            not (self.wire.wrong_words and not self.converts),
            self,
            "resolution_force",
            "be above 0 where words can be wrong",
        )
        require(
            (self.resolution_force == 0.0) == (self.resolution_torque == 0.0),
            self,
            "resolution_torque",
            f"be zero if and only if resolution_force ({self.resolution_force!r}) is",
        )
        require(
            self.initial_scale_std + 5.0 * self.cross_talk_std <= MOST_ERROR,
            self,
            "cross_talk_std",
            f"keep initial_scale_std + 5 cross_talk_std within {MOST_ERROR}, "
            "or some sensors could not be inverted",
        )

    @property
    def channels(self) -> int:
        """Number of channels K, six a sensor."""
        return AXES * self.sensors

    @property
    def converts(self) -> bool:
        """Whether readings are counts rather than N and N m."""
        return self.resolution_force > 0.0

    @property
    def full_scale(self) -> Floats:
        """Largest component along each channel in N and N m, shape (K,)."""
        return self._per_channel(self.full_scale_force, self.full_scale_torque)

    @property
    def slope(self) -> Floats:
        """Nominal counts per N and N m, shape (K,)."""
        if not self.converts:
            return np.ones(self.channels)
        return 1.0 / self._per_channel(self.resolution_force, self.resolution_torque)

    @property
    def zero_code(self) -> float:
        """The reading of an unloaded, perfect sensor in counts."""
        return 0.0

    @property
    def code_range(self) -> tuple[Floats, Floats]:
        """Lowest and highest reading in counts, each of shape (K,)."""
        most = np.floor(self.full_scale * self.slope) if self.converts else np.full(self.channels, np.inf)
        return -most, most

    @property
    def word_bits(self) -> int:
        """Bits of a two's complement word that holds every code; 0 without a converter."""
        return int(self.code_range[1].max()).bit_length() + 1 if self.converts else 0

    @property
    def nominal_age(self) -> float:
        """Age in s of a reading when the host takes it, by the data sheet: the delay of the wire.

        For ``averaged`` sensors half of the time between two readings, which is the host's, comes on top.
        """
        return self.wire.delay

    @property
    def nominal_scale(self) -> Floats:
        """N and N m per count by the maker's matrix, shape (K,)."""
        return 1.0 / self.slope

    @property
    def nominal_matrix(self) -> Floats:
        """The maker's matrix in N and N m per count, which knows of no error, shape (sensors, 6, 6)."""
        return np.stack([np.diag(part) for part in self.nominal_scale.reshape(self.sensors, AXES)])

    def _per_channel(self, force: float, torque: float) -> Floats:
        return np.tile(per_axis(force, torque), self.sensors)


class ForceTorqueState(NamedTuple):
    """Sensors in use."""

    error: Floats
    """E, relative errors of the scales on the diagonal and cross-talk in shares of the full scales beside it
    (row: the channel that reads, column: the load), shape (sensors, 6, 6)."""
    offset: Floats  # z in N and N m, shape (sensors, 6)
    wire: Any = ()  # state of the wire; ``()`` where nothing happens to codes


@device
def force_torque(config: ForceTorque) -> Corruption[ForceTorqueState]:
    """Build six-axis sensors.

    ``init(shape, rng)`` takes the shape of the readings, (K,) with K = 6 sensors. ``apply(wrench, state, rng,
    dt)`` takes the true wrenches that are read in N and N m, at and in the sensors' frames, and returns
    counts; both (K,). Who reads ``averaged`` sensors hands over their mean over dt.

    Args:
        config: The instrument.
    """
    eye = np.eye(AXES)
    spread = config.initial_scale_std * eye + config.cross_talk_std * (1.0 - eye)
    ratio = full_scale_ratio(config)
    offset_std = per_axis(config.initial_offset_force_std, config.initial_offset_torque_std)
    offset_walk = per_axis(config.offset_drift_force, config.offset_drift_torque)
    scale_walk = config.scale_drift
    noise = np.tile(per_axis(config.noise_force, config.noise_torque), config.sensors)
    slope, converts, (low, high) = config.slope, config.converts, config.code_range
    rated = config.full_scale * slope
    way = wire(config.wire, rated, (low, high), config.word_bits) if config.wire.acts else None

    def init(shape: tuple[int, ...], rng: Rng) -> ForceTorqueState:
        check_channels(shape, config.channels)
        error = spread * normal(rng, (config.sensors, AXES, AXES))
        offset = offset_std * normal(rng, (config.sensors, AXES))
        return ForceTorqueState(error, offset, way.init(shape, rng) if way else ())

    def apply(
        wrench: Floats, state: ForceTorqueState, rng: Rng, dt: float
    ) -> tuple[Floats, ForceTorqueState]:
        of_scale, of_offset, of_noise = normal(rng, (3, *state.offset.shape))
        error = state.error + (scale_walk * dt**0.5) * of_scale[:, :, None] * eye
        offset = state.offset + dt**0.5 * offset_walk * of_offset
        true = wrench.reshape(offset.shape)
        felt = true + (error * ratio * true[:, None]).sum(axis=2) + offset
        read = felt.ravel() + of_noise.ravel() * noise
        if converts:
            read = np.rint(limit(read * slope, low, high))
        brought = state.wire
        if way:
            read, brought = way.apply(read, brought, rng, dt)
        return read, ForceTorqueState(error, offset, brought)

    return Corruption(init, apply)


def true_matrix(config: ForceTorque, state: ForceTorqueState) -> tuple[Floats, Floats]:
    """Return the map that would undo the sensors' errors at this moment: the true wrench is C (s - o).

    C is in N and N m per count, shape (sensors, 6, 6), and o in counts, shape (sensors, 6).
    """
    slope = config.slope[:AXES]
    return np.linalg.inv(np.eye(AXES) + state.error * full_scale_ratio(config)) / slope, state.offset * slope


def full_scale_ratio(config: ForceTorque) -> Floats:
    """Return factors that turn E into D E D^-1: full scale of the row by that of the column, shape (6, 6)."""
    full = config.full_scale[:AXES]
    return full[:, None] / full


def per_axis(force: float, torque: float) -> Floats:
    """Return a number for each axis, shape (6,), of those of forces and of torques."""
    return np.repeat([force, torque], 3)
