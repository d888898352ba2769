"""Faults of single channels: how wires, chips and bridges break.

A fault acts on the counts that a host reads, from its start to its stop, and leaves everything before and
after as it was. Faults are applied in the order in which they are given: to swap a dead channel is not the
same as to kill a swapped one.

| Kind | The host reads | Parameters |
|------|---------------------|------------|
| ``"dead"`` | the code of an unloaded cell, whatever the load | |
| ``"stuck"`` | the last reading before the fault | |
| ``"saturated"`` | nothing beyond a load; without one, the converter's rail all the time | ``level`` |
| ``"spiking"`` | single readings that are off, up or down | ``rate``, ``size`` |
| ``"dropped"`` | NaN: no sample arrived | ``probability``, ``burst`` |
| ``"swapped"`` | another channel's counts, and that one this one's | ``other`` |
| ``"flipped"`` | the counts of the opposite load: the slope's sign is wrong | |
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from surefoot.arrays import Floats
from surefoot.checks import is_whole
from surefoot.sensors.configuration import NotNegative, Positive, check_fields, require
from surefoot.sensors.corruption import Corruption, Rng, check_channels, device, limit
from surefoot.sensors.randomness import uniform

KINDS = ("dead", "stuck", "saturated", "spiking", "dropped", "swapped", "flipped")
"""What can go wrong with a channel."""


ROUNDING = 1e-6
"""Time in s by which a fault comes early: sums of time steps are a little below or above the true time."""


class Converter(Protocol):
    """The part of an instrument that faults need, such as :class:`~surefoot.sensors.LoadCells`."""

    @property
    def slope(self) -> Floats:
        """Nominal counts per newton (or N m), shape (K,)."""

    @property
    def zero_code(self) -> Any:
        """Reading without a load in counts, one number or one a channel."""

    @property
    def code_range(self) -> tuple[Any, Any]:
        """Lowest and highest reading in counts, one number each or one a channel."""


@dataclass(frozen=True)
class Fault:
    """One fault of one channel."""

    kind: str
    """What goes wrong, one of :data:`KINDS`."""

    channel: int
    """Number of the channel that it happens to, from 0."""

    start: NotNegative = 0.0
    """Time of the first reading that is wrong in s."""

    stop: Positive | None = None
    """Time of the first reading that is right again in s; ``None`` for never."""

    level: Positive | None = None
    """Saturated: the load in N (or N m) by the data sheet beyond which nothing more is read, positive for
    loads that press; ``None`` for a reading at the rail to which such loads drive the converter."""

    rate: Positive = 1.0
    """Spiking: mean number of spikes in a second in 1/s."""

    size: Positive = 20.0
    """Spiking: by how much a reading is off in N (or N m) by the data sheet, to either side alike."""

    probability: float = 1.0
    """Dropped: share of the readings that is lost in the long run; 1 loses all."""

    burst: NotNegative = 0.0
    """Dropped: mean duration of a gap in s; 0 loses each reading on its own."""

    other: int | None = None
    """Swapped: number of the other channel, from 0."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value is impossible."""
        require(self.kind in KINDS, self, "kind", f"be one of {KINDS}")
        require(is_whole(self.channel) and self.channel >= 0, self, "channel", "be a whole number from 0")
        check_fields(self)
        if self.stop is not None:
            require(self.stop > self.start, self, "stop", f"come after the start at {self.start} s")
        require(0.0 < self.probability <= 1.0, self, "probability", "lie above 0 and at most at 1")
        swaps = self.kind == "swapped"
        require(
            (is_whole(self.other) and 0 <= self.other != self.channel) if swaps else self.other is None,
            self,
            "other",
            "name another channel" if swaps else f"be None for a channel that is {self.kind}",
        )


class FaultState(NamedTuple):
    """Channels with faults."""

    time: Floats  # time of the last reading in s, shape (1,)
    held: Floats
    """For each of F faults the last reading of its channel before it in counts, shape (F,); NaN before there
    was any."""
    lost: Floats  # for each of them 1 within a gap and 0 elsewhere, shape (F,)


@device
def channel_faults(faults: Sequence[Fault], config: Converter) -> Corruption[FaultState]:
    """Build faults of single channels, for a stream of counts.

    ``init(shape, rng)`` takes the shape of the readings, (K,), and starts the clock at 0 s: the first
    reading is that of the time ``dt``. Whether a fault is active or not, it draws the same random numbers.

    Args:
        faults: The faults, in the order in which they act.
        config: The instrument: how many counts a newton is, and where they end.

    Raises:
        ValueError: If a fault names a channel that the instrument lacks, or a rail that it has not.
    """
    faults = tuple(faults)
    channels = channels_of(config)
    _check(faults, channels)
    chance = [index for index, fault in enumerate(faults) if fault.kind in ("spiking", "dropped")]

    def init(shape: tuple[int, ...], rng: Rng) -> FaultState:
        check_channels(shape, len(channels))
        return FaultState(np.zeros(1), np.full(len(faults), np.nan), np.zeros(len(faults)))

    def apply(reading: Floats, state: FaultState, rng: Rng, dt: float) -> tuple[Floats, FaultState]:
        now, counts = float(state.time[0] + dt), reading + 0.0
        held, lost = state.held.copy(), np.zeros(len(faults))
        drawn = uniform(rng, 0.0, 1.0, (len(chance), 2)) if chance else ()
        draws = dict(zip(chance, drawn, strict=True))
        for index, fault in enumerate(faults):
            k, code = fault.channel, counts[fault.channel]
            stops = np.inf if fault.stop is None else fault.stop
            active = fault.start - ROUNDING <= now < stops - ROUNDING
            if not (np.isnan(code) or (active and not np.isnan(held[index]))):
                held[index] = code
            if not active:
                continue
            match fault.kind:
                case "swapped":
                    counts[k], counts[fault.other] = counts[fault.other], code
                case "stuck":
                    counts[k] = held[index]
                case "dropped":
                    lost[index] = _gap(fault, state.lost[index], draws[index][0], dt)
                    counts[k] = np.nan if lost[index] else code
                case _:
                    counts[k] = _misread(fault, channels[k], code, draws.get(index), dt)
        return counts, FaultState(np.array([now]), held, lost)

    return Corruption(init, apply)


def apply_faults(
    counts: Floats, time: Floats, faults: Sequence[Fault], config: Converter, rng: np.random.Generator
) -> Floats:
    """Return a log as the host would have read it with faults.

    Args:
        counts: Readings in counts, shape (N, K); they are not changed.
        time: Their times in s, increasing, shape (N,); the faults' own times are on this clock.
        faults: The faults, in the order in which they act.
        config: The instrument that was read.
        rng: Where chance comes from.

    Returns:
        Counts, shape (N, K).

    Raises:
        ValueError: If a shape is wrong, time does not increase, or a fault cannot happen to this instrument.

    >>> from surefoot.sensors import LoadCells
    >>> cells = LoadCells(channels=2, polarity=(1,), adc_bits=0)
    >>> dead = Fault("dead", channel=1, start=2.0)
    >>> apply_faults(np.full((3, 2), 5.0), np.array([1.0, 2.0, 3.0]), [dead], cells, np.random.default_rng(0))
    array([[5., 5.],
           [5., 0.],
           [5., 0.]])
    """
    counts, time = np.asarray(counts, dtype=np.float64), np.asarray(time, dtype=np.float64)
    if counts.ndim != 2 or time.shape != counts.shape[:1]:
        raise ValueError(
            f"'counts' must have shape (N, K) and 'time' (N,), got {counts.shape} and {time.shape}."
        )
    step = np.diff(time)
    if not np.isfinite(time).all() or not (step > 0.0).all():
        raise ValueError("'time' must be finite and increase from reading to reading.")
    instrument = channel_faults(faults, config)
    state = instrument.init(counts.shape[1:], rng)
    # The first reading stands for as long as the others do.
    steps = np.append(np.median(step) if len(step) else 1.0, step)
    read = np.empty_like(counts)
    for k, (row, dt) in enumerate(zip(counts, steps.tolist(), strict=True)):
        state = state._replace(time=np.array([time[k] - dt]))
        read[k], state = instrument.apply(row, state, rng, dt)
    return read


class Channel(NamedTuple):
    """One channel of an instrument: counts per newton, code without a load, ends, and whether it rounds."""

    slope: float
    unloaded: float
    low: float
    high: float
    rounds: bool

    def clip(self, code: float) -> float:
        """Return a code that a converter can put out."""
        return float(limit(code, self.low, self.high))

    def limits_at(self, level: float | None) -> tuple[float, float]:
        """Return the lowest and the highest code that is left; without a level both are the rail."""
        presses = self.slope > 0.0
        if level is None:
            return (self.high, self.high) if presses else (self.low, self.low)
        edge = self.unloaded + self.slope * level
        edge = float(np.rint(edge)) if self.rounds else edge
        return (-np.inf, edge) if presses else (edge, np.inf)


def channels_of(config: Converter) -> list[Channel]:
    """Return the channels of an instrument, whose properties are numbers or shapes (K,)."""
    slope = np.asarray(config.slope, dtype=np.float64)
    rows = (slope, np.asarray(config.zero_code), *map(np.asarray, config.code_range))
    columns = np.stack([np.broadcast_to(row, slope.shape) for row in rows], axis=-1).astype(np.float64)
    rounds = bool(np.isfinite(columns).all())
    return [Channel(k, unloaded, low, high, rounds) for k, unloaded, low, high in columns.tolist()]


def _misread(fault: Fault, channel: Channel, code: float, draws: Any, dt: float) -> float:
    """Return readings of a faulty channel by its own code and by chance; a code that never came stays NaN."""
    match fault.kind:
        case "dead":
            return code * 0.0 + channel.unloaded
        case "saturated":
            return float(limit(code, *channel.limits_at(fault.level)))
        case "spiking":
            if draws[0] >= 1.0 - np.exp(-fault.rate * dt):
                return code
            jump = code * 0.0 + (-1.0 if draws[1] < 0.5 else 1.0)
            off = channel.clip(code + jump * (abs(channel.slope) * fault.size))
            return float(np.rint(off)) if channel.rounds else off
    return channel.clip(2.0 * channel.unloaded - code)  # flipped


def _gap(fault: Fault, gap: float, drawn: float, dt: float) -> bool:
    """Return whether a reading is in a gap, by one step of a chain with two states."""
    if fault.burst == 0.0 or fault.probability == 1.0:
        return drawn < fault.probability
    leave = 1.0 - np.exp(-dt / fault.burst)
    enter = min(leave * fault.probability / (1.0 - fault.probability), 1.0)
    return bool(drawn >= leave if gap else drawn < enter)


def _check(faults: tuple[Fault, ...], channels: list[Channel]) -> None:
    """Raise ValueError if a fault names a channel or a rail that the instrument lacks."""
    for fault in faults:
        for name in ("channel", "other"):
            number = getattr(fault, name)
            require(
                number is None or number < len(channels),
                fault,
                name,
                f"be one of the instrument's {len(channels)} channels, 0 to {len(channels) - 1}",
            )
        ends = channels[fault.channel].low, channels[fault.channel].high
        require(
            fault.kind != "saturated" or fault.level is not None or bool(np.isfinite(ends).all()),
            fault,
            "level",
            "be given for an instrument without a converter, which has no rail",
        )
