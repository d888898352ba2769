"""Strain-gauge load cells on converters of their own: newtons in, counts out.

The order of the stages is the order in the instrument. The spring element acts on the load
(:mod:`surefoot.sensors.stages.mechanics`), unless it is left ideal. A bridge turns the load into a voltage
with a scale that is not quite the data sheet's and adds an offset; both drift. The converter averages over
a conversion, and over its last few ones if it has a filter, adds noise, clips, rounds, and finishes a
conversion when its own clock says so. The host reads the codes that the wire
(:mod:`surefoot.sensors.transport.wire`) brings.

    s = round(s_0 + k ((1 + g) F + z) + n)

with the nominal counts per newton k (negative for a bridge wired the other way round), the code s_0
of an unloaded cell, the relative error g of the scale, the offset z in N and noise n. Both errors start
anywhere, walk at random and, where the cells warm up, follow the temperature. All that a robot may know of
it is the *nominal* map F_0 = c_0 s + d_0 with c_0 = 1 / k and d_0 = -s_0 / k.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.sensors.corruption import Corruption, Rng, check_channels, device, limit, stateless
from surefoot.sensors.devices.load_cell_config import LoadCells
from surefoot.sensors.randomness import normal
from surefoot.sensors.stages.clock import (
    init_clock,
    init_window,
    integrate,
    latest_conversion,
    most_conversions,
    settle,
)
from surefoot.sensors.stages.mechanics import mechanics, offset_shift
from surefoot.sensors.stages.moving_average import moving_average
from surefoot.sensors.stages.nonlinearity import bent
from surefoot.sensors.stages.shear import shear
from surefoot.sensors.stages.temperature import temperature_rise
from surefoot.sensors.transport.wire import wire


class LoadCellState(NamedTuple):
    """Load cells in use."""

    period: Floats  # time between conversions in s, shape (K,); constant from power-up
    due: Floats  # time to the next conversion in s, shape (K,)
    charge: Floats  # integral of the load since the last conversion up to now in N s, shape (K,)
    held: Floats  # the last conversion in counts, shape (K,); NaN before the first
    error: Floats
    """The drifting errors, shape (2, K): the relative error of the scale (row :data:`SCALE`), and the offset
    of the bridge in N at the nominal scale (row :data:`OFFSET`)."""
    thermal: Floats
    """For cells that warm up, shape (3, K): the change of the two errors by a kelvin, in 1/K and N/K, and the
    rise of the temperature since power-up in K (row :data:`RISE`); empty, shape (0,), for others."""
    window: Any = ()
    """For converters that average, their last conversions in N (see
    :func:`~surefoot.sensors.stages.clock.settle`; without a clock a
    :class:`~surefoot.sensors.stages.moving_average.MovingAverageState`); ``()`` for others."""
    mechanics: Any = ()  # state of the spring elements; ``()`` where nothing happens to loads
    wire: Any = ()  # state of the wire; ``()`` where nothing happens to codes
    shear: Any = ()
    """Shares of the horizontal forces along x and y that a cell reads, shape (2, K); ``()`` for none."""


SCALE, OFFSET, RISE = 0, 1, 2
"""Rows of :attr:`LoadCellState.error` and :attr:`LoadCellState.thermal`."""


@device
def load_cells(config: LoadCells) -> Corruption[LoadCellState]:
    """Build load cells: all of their stages in one function, which draws each step's numbers at once.

    ``init(shape, rng)`` takes the shape of the readings, (K,). ``apply(block, state, rng, dt)`` takes true
    loads in N in S equal substeps that fill dt, shape (S, K), or (S, 3 K) of cells that feel shear
    (:mod:`~surefoot.sensors.stages.shear`), and returns counts, shape (K,). Cells with a clock average the
    load over each conversion; others take the last substep's, or the mean if they are ``averaged``.

    The spring elements are stepped once a block, at the load of its last conversion; the conversions before
    it, which the host never reads, leave no trace in them.

    In cells that remember loads (``mechanics``, ``settling``), the conversion of a load that is not finite
    reads NaN and leaves no trace; the next block goes on from the last finite load.
    """
    rate, averaged, settling, errors = config.rate, config.averaged, config.settling, _Errors(config)
    drawn_per_step = len(errors.walking) + (config.noise_counts > 0.0)
    average, convert = moving_average(settling), _converter(config)
    element = mechanics(config.mechanics, config.capacity) if config.mechanics.acts else _NOTHING
    way = _way(config)
    sideways = shear(config.shear_std) if config.shear_std else _NOTHING
    remembers = config.mechanics.acts or settling > 1

    def init(shape: tuple[int, ...], rng: Rng) -> LoadCellState:
        check_channels(shape, config.channels)
        nothing = np.zeros(shape)
        shares = sideways.init(shape, rng)
        period, due = (nothing, nothing) if rate is None else init_clock(rate, shape, rng)
        window: Any = ()
        if settling > 1:
            window = average.init(shape, rng) if rate is None else init_window(settling, shape)
        felt, (error, thermal) = element.init(shape, rng), errors.init(shape, rng)
        held, brought = np.full(shape, np.nan), way.init(shape, rng)
        return LoadCellState(period, due, nothing, held, error, thermal, window, felt, brought, shares)

    def apply(block: Floats, state: LoadCellState, rng: Rng, dt: float) -> tuple[Floats, LoadCellState]:
        if block.ndim != 2 or block.shape[1] != config.loads:
            raise ValueError(f"Loads must have the shape (S, {config.loads}), got {block.shape}.")
        period, due, charge, held, error, thermal, window, felt, brought, shares = state
        block, _ = sideways.apply(block, shares, rng, dt)
        if remembers:
            block = np.where(np.isfinite(block), block, np.nan)
        load = block.mean(axis=0) if averaged else block[-1] + 0.0
        converts: Any = True
        if rate is not None:
            number, at, due = latest_conversion(period, due, dt)
            converts = number >= 0.0
            load, charge = integrate(block, charge, period, number, at, dt)
        load, felt = element.apply(load, felt, rng, dt)
        drawn = normal(rng, (drawn_per_step, *load.shape)) if drawn_per_step else np.zeros(0)
        error, thermal = errors.drift(error, thermal, drawn, dt)
        bridge = load * (1.0 + error[SCALE]) + error[OFFSET]
        if settling > 1 and rate is None:
            bridge, window = average.apply(bridge, window, rng, dt)
        elif settling > 1 and rate is not None:
            bridge, window = settle(window, bridge, number, most_conversions(rate, dt))
        held = np.where(converts, convert(bridge, drawn), held)
        counts, brought = way.apply(held, brought, rng, dt)
        return counts, LoadCellState(period, due, charge, held, error, thermal, window, felt, brought, shares)

    return Corruption(init, apply)


_NOTHING: Corruption[Any] = stateless(lambda reading, rng, dt: reading)


def _way(config: LoadCells) -> Corruption[Any]:
    """Make the wire that brings codes to the host."""
    rated, bits = config.counts_per_newton * config.capacity, config.adc_bits
    return wire(config.wire, rated, config.code_range, bits, config.coding) if config.wire.acts else _NOTHING


def _converter(config: LoadCells) -> Callable[[Floats, Floats], Floats]:
    """Make the converter of bridges in N to counts; its noise is the last row that is drawn."""
    low, high = config.code_range
    noise, slope, zero_code, rounds = config.noise_counts, config.slope, config.zero_code, config.adc_bits > 0

    def convert(bridge: Floats, drawn: Floats) -> Floats:
        counts = bridge * slope + zero_code
        if noise:
            counts = counts + noise * drawn[-1]
        return np.rint(limit(counts, low, high)) if rounds else counts

    return convert


class _Errors:
    """The drifting errors of cells: they walk at random, and follow the temperature of cells that warm up.

    Attributes:
        walking: Rows of errors that walk.
    """

    def __init__(self, config: LoadCells) -> None:
        self._config = config
        self._walks = np.array([[config.scale_drift], [config.offset_drift]])
        self.walking = np.flatnonzero(self._walks > 0.0)

    def init(self, shape: tuple[int, ...], rng: Rng) -> tuple[Floats, Floats]:
        """Draw ``error`` and ``thermal`` of :class:`LoadCellState`."""
        config, warms = self._config, self._config.warms
        # In the order of the single stages: scale, offset, each with its coefficient in cells that warm up.
        drawn = normal(rng, (4 if warms else 2, *shape))
        error = drawn[:: 2 if warms else 1] * [[config.initial_scale_std], [config.initial_offset_std]]
        if not warms:
            return error, np.zeros(0)
        tempco = drawn[1::2] * [[config.scale_tempco], [config.offset_tempco]]
        return error, np.concatenate([tempco, np.zeros((1, *shape))])

    def drift(self, error: Floats, thermal: Floats, drawn: Floats, dt: float) -> tuple[Floats, Floats]:
        """Return both after dt, of normal numbers for the errors that walk, in front of ``drawn``."""
        config, walking = self._config, self.walking
        if len(walking):
            error = error.copy()
            error[walking] += dt**0.5 * self._walks[walking] * drawn[: len(walking)]
        if config.warms:
            tempco, before = thermal[:RISE], thermal[RISE]
            temperature = temperature_rise(before, config.temperature_ramp, config.temperature_rise, dt)
            error = error + tempco * (temperature - before)
            thermal = np.concatenate([tempco, temperature[None]])
        return error, thermal


def static_counts(config: LoadCells, state: LoadCellState, load: Floats, rng: np.random.Generator) -> Floats:
    """Return readings of loads at rest, such as known weights: one conversion each, without drift between.

    True loads in N, of one weighing, shape (K,), or several, (N, K), give counts of the same shape. The state
    is one of ``load_cells(config).init((K,), rng)``, and is not changed.

    >>> config = LoadCells(adc_bits=0, input_noise=0.0, initial_scale_std=0.0, initial_offset_std=0.0,
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
    if state.mechanics:
        if state.mechanics.nonlinearity:
            load = bent(load, state.mechanics.nonlinearity, config.capacity)
        load = load + offset_shift(config.mechanics, state.mechanics)
    counts: Floats = config.zero_code + config.slope * (
        (1.0 + state.error[SCALE]) * load + state.error[OFFSET]
    )
    counts += config.noise_counts * rng.standard_normal(load.shape)
    if config.adc_bits:
        counts = np.rint(np.clip(counts, *config.code_range))
    return counts


def true_map(config: LoadCells, state: LoadCellState) -> tuple[Floats, Floats]:
    """Return the map that would undo the errors of the cells' scales and offsets at this moment.

    The true load is scale * counts + offset, in N per count and N, (K,) each. The effect of impacts and
    overloads is part of the offsets. Nonlinearity, hysteresis, creep and shear, which no map of counts can
    undo, are left out.
    """
    scale_true = 1.0 + state.error[SCALE]
    scale = 1.0 / (config.slope * scale_true)
    offset = -config.zero_code * scale - state.error[OFFSET] / scale_true
    if state.mechanics:
        offset = offset - offset_shift(config.mechanics, state.mechanics)
    return scale, offset


def with_true_map(config: LoadCells, state: LoadCellState, scale: Floats, offset: Floats) -> LoadCellState:
    """Return cells whose errors are such that this map, shape (K,) each, undoes them now.

    The inverse of :func:`true_map`, for the cells of a robot that known weights have shown; ValueError if an
    unloaded cell would read what the converter cannot.
    """
    low, high = config.code_range
    unloaded = -offset / scale
    if config.adc_bits and not ((low < unloaded) & (unloaded < high)).all():
        raise ValueError(
            f"Unloaded, these cells read {unloaded.min():.4g} to {unloaded.max():.4g} counts, and the "
            f"converter of LoadCells {low:.4g} to {high:.4g}: choose 'coding' and 'adc_bits' as yours."
        )
    scale_true = 1.0 / (config.slope * scale)
    shift = offset_shift(config.mechanics, state.mechanics) if state.mechanics else 0.0
    error = np.array([scale_true - 1.0, -scale_true * (config.zero_code * scale + offset + shift)])
    return state._replace(error=error)
