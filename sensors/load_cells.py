"""Strain-gauge load cells on converters of their own: newtons in, counts out.

The order of the stages is the order in the instrument. A bridge scales the load by a gain that is not
quite the data sheet's and adds a zero, both of which wander; the converter adds noise, clips, rounds,
and finishes a conversion when its own clock says so; the host reads what it finds.

    s = round(s_0 + k ((1 + g) F + z) + n)

with the nominal counts per newton k (negative for a bridge wired the other way round), the code s_0
of an unloaded cell, the error g of the gain, the zero z in N and noise n. All that a robot may know of
it is the *nominal* map F_0 = c_0 s + d_0 with c_0 = 1 / k and d_0 = -s_0 / k.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.sensors._arrays import Table, cast_like, limit, namespace, round_off
from surefoot.sensors.clock import init_clock, interpolate, latest_conversion, sample_and_hold
from surefoot.sensors.configuration import require, require_not_negative, require_positive
from surefoot.sensors.corruption import Array, Corruption, Rng, chain
from surefoot.sensors.drift import PER_SQRT_MINUTE, drift, gain_drift
from surefoot.sensors.gain import gain, offset
from surefoot.sensors.noise import white_noise
from surefoot.sensors.quantize import quantize, saturate
from surefoot.sensors.randomness import filled, normal


@dataclass(frozen=True)
class LoadCells:
    """A set of load cells; the defaults are HX711 chips under an uncalibrated robot."""

    channels: int = 8
    """Number of cells: four a foot, (left FL, FR, RL, RR, right FL, FR, RL, RR)."""

    capacity: float = 98.1
    """Rated load of a cell in N: where the bridge puts out its rated output."""

    rated_output: float = 1.0e-3
    """Bridge voltage at the rated load per volt of excitation (1 mV/V)."""

    excitation: float = 5.0
    """Supply of the bridge in V; the converter is ratiometric to it."""

    adc_gain: float = 128.0
    """Gain of the amplifier before the converter: 128 on channel A of an HX711."""

    adc_bits: int = 24
    """Bits of the converter, whose input spans +-excitation / (2 adc_gain). 0 leaves it out: readings
    are in newtons then, without rounding or clipping."""

    coding: str = "offset-binary"
    """``"offset-binary"`` (no load reads about 2^23, as drivers that flip the top bit hand out) or
    ``"two's complement"`` (about 0, as the chip puts out)."""

    polarity: tuple[int, ...] = (-1, 1, -1, 1)
    """Sign of each bridge, +1 or -1, repeated along the channels. Han's shoes alternate."""

    input_noise: float = 90.0e-9
    """Noise of one conversion in V rms at the converter's input (HX711 at 80 SPS)."""

    rate: tuple[float, float] | None = (78.0, 94.0)
    """Lowest and highest conversion rate in 1/s; each chip draws its own rate and its own phase.
    ``None`` converts at the instant the host reads."""

    initial_gain_std: float = 0.12
    """Standard deviation of the relative error of a gain at power-up; 0.12 was never calibrated."""

    initial_zero_std: float = 1.5
    """Standard deviation of a zero at power-up in N."""

    gain_drift: float = 0.02 * PER_SQRT_MINUTE
    """Random walk of the gain's relative error per sqrt(s); 2 % per square root of a minute."""

    zero_drift: float = 1.0 * PER_SQRT_MINUTE
    """Random walk of the zero in N/sqrt(s); 1 N per square root of a minute."""

    def __post_init__(self) -> None:
        """Refuse what no instrument can be."""
        require(
            isinstance(self.channels, int) and self.channels > 0,
            self,
            "channels",
            "be a positive whole number",
        )
        require_positive(self, "capacity", "rated_output", "excitation", "adc_gain")
        require(
            isinstance(self.adc_bits, int) and 0 <= self.adc_bits <= 32, self, "adc_bits", "lie in 0 to 32"
        )
        require(
            self.coding in ("offset-binary", "two's complement"),
            self,
            "coding",
            "be 'offset-binary' or \"two's complement\"",
        )
        require(
            isinstance(self.polarity, tuple)
            and len(self.polarity) > 0
            and all(sign in (-1, 1) for sign in self.polarity)
            and self.channels % len(self.polarity) == 0,
            self,
            "polarity",
            f"hold +1 or -1 for each of the {self.channels} channels, or a pattern that repeats along them",
        )
        require_not_negative(
            self, "input_noise", "initial_gain_std", "initial_zero_std", "gain_drift", "zero_drift"
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
    def slope(self) -> NDArray[np.float64]:
        """Nominal counts per newton with their signs, k, shape (K,)."""
        signs = np.array(self.polarity * (self.channels // len(self.polarity)), dtype=np.float64)
        return signs * self.counts_per_newton

    @property
    def nominal_scale(self) -> NDArray[np.float64]:
        """N per count by the data sheet, c_0, shape (K,)."""
        return 1.0 / self.slope

    @property
    def nominal_offset(self) -> NDArray[np.float64]:
        """N at code zero by the data sheet, d_0, shape (K,): the load is c_0 s + d_0."""
        return -self.zero_code / self.slope

    @property
    def nominal_age(self) -> float:
        """Mean age in s of a reading when the host takes it, by the data sheet: half a conversion."""
        return 0.0 if self.rate is None else 1.0 / (self.rate[0] + self.rate[1])


class LoadCellState(NamedTuple):
    """Load cells in use.

    Attributes:
        period: Time between conversions in s, shape (..., K); constant from power-up.
        due: Time to the next conversion in s, shape (..., K).
        previous: Load at the end of the block before in N, shape (..., K).
        held: The last conversion in counts, shape (..., K); NaN before the first.
        error: What wanders, shape (2, ..., K): the relative error of the gain, and the zero of the bridge
            in N at the nominal gain.
    """

    period: Array
    due: Array
    previous: Array
    held: Array
    error: Array


def load_cell_chain(config: LoadCells) -> Corruption[Any]:
    """Build load cells from the single stages: the definition that :func:`load_cells` is tested against.

    With a clock the reading is a block of substeps (see :func:`~surefoot.sensors.sample_and_hold`).
    """
    bridge = [
        gain_drift(config.initial_gain_std, config.gain_drift),
        drift(config.initial_zero_std, config.zero_drift),
    ]
    converter: list[Corruption[Any]] = [gain(config.slope), offset(config.zero_code)]
    converter.append(white_noise(config.noise_counts))
    if config.adc_bits:
        converter += [saturate(*config.code_range), quantize(1.0)]
    if config.rate is None:
        return chain(*bridge, *converter)
    return sample_and_hold(chain(*bridge, *converter), config.rate)


def load_cells(config: LoadCells) -> Corruption[LoadCellState]:
    """Build load cells with their stages fused, for speed.

    ``init(shape, rng)`` takes the shape of the readings, (..., K). ``apply(block, state, rng, dt)`` takes
    true loads in N at the ends of S equal substeps that fill dt, shape (..., S, K), and returns counts,
    shape (..., K).

    Args:
        config: The instrument.
    """
    low, high = config.code_range
    zero_code, rate, clipped = config.zero_code, config.rate, config.adc_bits > 0
    walks, noise = (config.gain_drift, config.zero_drift), config.noise_counts
    drawn_per_step = sum(walk > 0.0 for walk in walks) + (noise > 0.0)
    slopes, both_walks = Table(config.slope), Table(walks)
    initial_std = Table([config.initial_gain_std, config.initial_zero_std])

    def init(shape: tuple[int, ...], rng: Rng, dtype: Any = None) -> LoadCellState:
        if not shape or shape[-1] != config.channels:
            raise ValueError(f"The last axis must hold the {config.channels} channels, got shape {shape}.")
        nothing = filled(rng, 0.0, shape, dtype)
        period, due = (nothing, nothing) if rate is None else init_clock(rate, shape, rng, dtype)
        drawn = normal(rng, (2, *shape), dtype)
        error = drawn * initial_std.like(drawn, len(shape))
        return LoadCellState(period, due, nothing, nothing + float("nan"), error)

    def apply(block: Array, state: LoadCellState, rng: Rng, dt: float) -> tuple[Array, LoadCellState]:
        if state.error.dtype != block.dtype:
            state = LoadCellState(*(cast_like(part, block) for part in state))
        xp = namespace(block)
        period, due, previous, held, error = state
        load = last = block[..., -1, :] + 0.0
        drawn = number = last
        if rate is not None:
            number, at, due = latest_conversion(period, due, dt)
            load = interpolate(block, previous, at * (block.shape[-2] / dt))
        if drawn_per_step:
            drawn = normal(rng, (drawn_per_step, *load.shape), load.dtype)
        if all(walks):
            error = error + drawn[:2] * (dt**0.5 * both_walks.like(load, load.ndim))
        elif any(walks):
            step = max(walks) * dt**0.5 * drawn[0]
            error = xp.stack([error[0] + step, error[1]] if walks[0] else [error[0], error[1] + step])
        counts = (load * (1.0 + error[0]) + error[1]) * slopes.like(load) + zero_code
        if noise:
            counts = counts + noise * drawn[-1]
        if clipped:
            counts = round_off(limit(counts, low, high))
        if rate is not None:
            counts = xp.where(number >= 0.0, counts, held)
        return counts, LoadCellState(period, due, last, counts, error)

    return Corruption(init, apply)


def static_counts(
    config: LoadCells, state: LoadCellState, load: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Read loads at rest, such as weights on a bench: one fresh conversion each, and no drift meanwhile.

    Args:
        config: The instrument.
        state: Its state from ``load_cells(config).init((K,), rng)``; it is not changed.
        load: True loads in N, shape (..., K).
        rng: Where the noise comes from.

    Returns:
        Counts, shape (..., K).

    >>> config = LoadCells(adc_bits=0, input_noise=0.0, initial_gain_std=0.0, initial_zero_std=0.0,
    ...                    polarity=(1,), channels=4)
    >>> rng = np.random.default_rng(0)
    >>> static_counts(config, load_cells(config).init((4,), rng), np.array([[1.0, 2.0, 3.0, 4.0]]), rng)
    array([[1., 2., 3., 4.]])
    """
    load = np.asarray(load, dtype=np.float64)
    if load.shape[-1:] != (config.channels,):
        raise ValueError(
            f"'load' must hold {config.channels} cells on its last axis, got shape {load.shape}."
        )
    counts: NDArray[np.float64] = config.zero_code + config.slope * (
        (1.0 + state.error[0]) * load + state.error[1]
    )
    counts += config.noise_counts * rng.standard_normal(load.shape)
    if config.adc_bits:
        counts = np.rint(np.clip(counts, *config.code_range))
    return counts


def true_map(config: LoadCells, state: LoadCellState) -> tuple[Array, Array]:
    """Compute the map that would undo the cells' errors at this moment.

    Returns:
        Scale in N per count and offset in N, both (..., K): the true load is scale * counts + offset.
    """
    gain_true = 1.0 + state.error[0]
    scale = 1.0 / (Table(config.slope).like(gain_true) * gain_true)
    return scale, -config.zero_code * scale - state.error[1] / gain_true
