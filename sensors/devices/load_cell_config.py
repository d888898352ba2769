"""A set of load cells: its data sheet, its errors and the map that a robot may know."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from surefoot.arrays import Floats
from surefoot.sensors.configuration import (
    Bits,
    Error,
    ErrorField,
    NotNegative,
    Positive,
    Whole,
    check_fields,
    require,
)
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE
from surefoot.sensors.stages.mechanics import CELLS_OF_A_FOOT, IDEAL, Mechanics
from surefoot.sensors.stages.shear import AXES
from surefoot.sensors.transport.errors import CODINGS
from surefoot.sensors.transport.wire import DIRECT, Wire


@dataclass(frozen=True)
class LoadCells:
    """A set of load cells; the defaults are HX711 chips under an uncalibrated robot."""

    channels: Whole = 8
    """Number of cells: four a foot, (left FL, FR, RL, RR, right FL, FR, RL, RR)."""

    capacity: Positive = 98.1
    """Rated load of a cell in N: where the bridge puts out its rated output."""

    rated_output: Positive = 1.0e-3
    """Bridge voltage at the rated load per volt of excitation (1 mV/V)."""

    excitation: Positive = 5.0
    """Supply of the bridge in V; the converter is ratiometric to it."""

    adc_gain: Positive = 128.0
    """Gain of the amplifier before the converter: 128 on channel A of an HX711."""

    adc_bits: Bits = 24
    """Bits of the converter, whose input spans +-excitation / (2 adc_gain). 0 leaves it out: readings
    are in newtons then, without rounding or clipping."""

    coding: str = "offset-binary"
    """``"offset-binary"`` (no load reads about 2^23: drivers that flip the top bit) or
    ``"two's complement"`` (about 0, as the chip puts out)."""

    polarity: tuple[int, ...] = (-1, 1, -1, 1)
    """Sign of each bridge, +1 or -1, repeated along the channels. Han's shoes alternate."""

    input_noise: Error = 90.0e-9
    """Noise of one conversion in V rms at the converter's input (HX711 at 80 SPS)."""

    rate: tuple[float, float] | None = (78.0, 94.0)
    """Lowest and highest conversion rate in 1/s; each chip draws its own rate and its own phase, and a
    conversion is the mean load since the one before. ``None`` converts when the host reads."""

    averaged: bool = False
    """Whether cells without a clock give the mean load since they were last read, as ideal ones do, or the
    load of that instant. Those with a clock average over their conversions, whatever this says."""

    initial_scale_std: Error = 0.12
    """Standard deviation of the relative error of a scale at power-up; 0.12 for cells never calibrated."""

    initial_offset_std: Error = 1.5
    """Standard deviation of an offset at power-up in N."""

    scale_drift: Error = 0.02 * PER_SQRT_MINUTE
    """Random walk of the scale's relative error per sqrt(s); 2 % per square root of a minute."""

    offset_drift: Error = 1.0 * PER_SQRT_MINUTE
    """Random walk of the offset in N/sqrt(s); 1 N per square root of a minute."""

    scale_tempco: Error = 0.0
    """Standard deviation of the relative change of a scale per kelvin in 1/K, each cell its own; 5e-5 is
    typical of a bar cell."""

    offset_tempco: Error = 0.0
    """Standard deviation of the change of an offset per kelvin in N/K, each cell its own; 0.005 (5e-5 of the
    capacity) is a good cell's, 0.03 a cheap one's, and the converter adds 1.2e-4."""

    temperature_ramp: NotNegative = 0.0
    """Rate at which the cells warm up from power-up on in K/s; 0.033 is 20 K in ten minutes."""

    temperature_rise: NotNegative = 0.0
    """Where the warming levels off in K, exponentially; 0 for a ramp that goes on. 14 with a ramp of 14/900
    is what a robot's foot was seen to do."""

    shear_std: Error = 0.0
    """Standard deviation of the share of a horizontal force that a cell reads as a vertical one, newtons a
    newton, along each axis of the sole, each cell its own; such a cell feels three forces. Data sheets of bar
    cells do not give it; 0.1 is chosen, for a bar that a sole above its axis bends."""

    settling: Whole = 1
    """Over how many conversions a converter averages. 4 is an HX711's by its data sheet, which makes readings
    1.5 conversions later than 1 does."""

    stamped: bool = False
    """Whether the host learns when each conversion ended, as a controller does that timestamps the chips'
    data-ready signals. Calibrators then know the age of each reading. Needs a clock, and a wire on which
    nothing happens."""

    mechanics: Annotated[Mechanics, ErrorField()] = IDEAL
    """What happens to a load before the bridge: nonlinearity, hysteresis, creep, jumps of the offset."""

    wire: Annotated[Wire, ErrorField()] = DIRECT
    """What happens to a code on its way to the host: spikes, wrong words, repeats, losses, delay."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value is impossible."""
        check_fields(self)
        require(self.coding in CODINGS, self, "coding", f"be one of {CODINGS}")
        require(
            isinstance(self.polarity, tuple)
            and len(self.polarity) > 0
            and all(sign in (-1, 1) for sign in self.polarity)
            and self.channels % len(self.polarity) == 0,
            self,
            "polarity",
            f"hold +1 or -1 for each of the {self.channels} channels, or a pattern that repeats along them",
        )
        require(
            self.rate is None
            or (
                isinstance(self.rate, tuple)
                and len(self.rate) == 2
                and 0.0 < self.rate[0] <= self.rate[1] < float("inf")
            ),
            self,
            "rate",
            "be None or (lowest, highest) with 0 < lowest <= highest",
        )
        require(
            not self.mechanics.jumps or self.channels % CELLS_OF_A_FOOT == 0,
            self,
            "channels",
            f"be whole feet of {CELLS_OF_A_FOOT} cells where impacts move their offsets",
        )
        require(
            not (self.wire.wrong_words and self.adc_bits == 0),
            self,
            "adc_bits",
            "be above 0 where words can be wrong",
        )

        require(
            not self.stamped or (self.rate is not None and not self.wire.acts),
            self,
            "stamped",
            "be False for cells without a clock ('rate') or with errors of the wire ('wire')",
        )

    @property
    def warms(self) -> bool:
        """Whether temperature matters: the cells warm up, and an error depends on it."""
        return self.temperature_ramp > 0.0 and (self.scale_tempco > 0.0 or self.offset_tempco > 0.0)

    @property
    def loads(self) -> int:
        """Number of forces that the cells feel: K, or 3 K with shear, all vertical ones first."""
        return self.channels * (AXES if self.shear_std else 1)

    @property
    def counts_per_newton(self) -> float:
        """Size of the nominal slope k; 1 without a converter."""
        if self.adc_bits == 0:
            return 1.0
        counts_per_volt = self.adc_gain * 2.0**self.adc_bits / self.excitation
        return self.rated_output * self.excitation / self.capacity * counts_per_volt

    @property
    def zero_code(self) -> float:
        """The reading s_0 of an unloaded, perfect cell in counts."""
        return 2.0 ** (self.adc_bits - 1) if self.adc_bits and self.coding == "offset-binary" else 0.0

    @property
    def code_range(self) -> tuple[float, float]:
        """Lowest and highest reading in counts."""
        if self.adc_bits == 0:
            return -float("inf"), float("inf")
        half = 2.0 ** (self.adc_bits - 1)
        return self.zero_code - half, self.zero_code + half - 1.0

    @property
    def noise_counts(self) -> float:
        """Standard deviation of the noise of one conversion in counts (N without a converter)."""
        if self.adc_bits == 0:
            return self.input_noise * self.capacity / (self.rated_output * self.excitation)
        return self.input_noise * self.adc_gain * 2.0**self.adc_bits / self.excitation

    @property
    def slope(self) -> Floats:
        """Nominal counts per newton with their signs, k, shape (K,)."""
        signs = np.array(self.polarity * (self.channels // len(self.polarity)), dtype=np.float64)
        return signs * self.counts_per_newton

    @property
    def nominal_scale(self) -> Floats:
        """N per count by the data sheet, c_0, shape (K,)."""
        return 1.0 / self.slope

    @property
    def nominal_offset(self) -> Floats:
        """N at code zero by the data sheet, d_0, shape (K,): the load is c_0 s + d_0."""
        return -self.zero_code / self.slope

    @property
    def residue(self) -> float:
        """Share of a load that a cell typically still reads after it is gone, by the data sheet.

        Hysteresis and creep leave at most their whole share behind, and half of it on average.
        """
        return 0.5 * (self.mechanics.hysteresis + sum(self.mechanics.creep_shares))

    @property
    def nominal_age(self) -> float:
        """Mean age in s of a reading when the host takes it, by the data sheet.

        It is half a conversion for which it waits, half of those that it is the mean of, and the delay of
        the wire. For cells that convert when they are read (``rate`` None) the filter's part is not in it: it
        depends on how often the host reads.
        """
        sampled = 0.0 if self.rate is None else (1 + self.settling) / (self.rate[0] + self.rate[1])
        return sampled + self.wire.delay
