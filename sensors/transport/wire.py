"""The errors of a code between a converter and the host: on its wire, its bus and its radio.

In this order: spikes couple into the converter, bits of words turn over, a reader repeats its last,
packets get lost, alone and in bursts (:mod:`~surefoot.sensors.transport.errors`), and the others come late
(:mod:`~surefoot.sensors.transport.link`). A lost reading is NaN. Every part is off where its field is zero,
costs nothing then and draws nothing.
"""

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

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
from surefoot.sensors.corruption import Corruption, Rng, parts
from surefoot.sensors.transport.errors import burst_gaps, spikes, stale_repeats, wrong_words
from surefoot.sensors.transport.link import latency

ALONE = 1e-9  # mean length in s of a gap of a single packet: far below any time between packets


@dataclass(frozen=True)
class Wire:
    """The wire from an instrument to the host; by default all codes arrive, right and at once."""

    spike_rate: Error = 0.0
    """Mean number of spikes of a channel in a second in 1/s."""

    spike_size: NotNegative = 0.1
    """Standard deviation of a spike in shares of the rated load."""

    wrong_words: Annotated[Error, ErrorField(1.0)] = 0.0
    """Probability that one bit of a reading arrives the wrong way round. 1 to 5 % of the values of one
    bit-banged HX711 were wrong, most of other people's never."""

    stale_repeats: Annotated[Error, ErrorField(0.95)] = 0.0
    """Probability that the host is handed its last reading again; 0.73 in a log of a NAO's feet."""

    packet_loss: Annotated[Error, ErrorField(0.95)] = 0.0
    """Share of the readings that get lost, each on its own, all channels together."""

    gap_share: Annotated[Error, ErrorField(0.95)] = 0.0
    """Share of the time that is lost in bursts, all channels together. A gap of 0.125 s a minute is 0.002."""

    gap_length: Positive = 0.125
    """Mean length of a burst in s; gaps of 0.17 s (iCub) and 22.6 s (balance board) were seen."""

    delay: Error = 0.0
    """Mean delay of a reading in s; 0.020 over the CoP paper's wireless network."""

    jitter: Error = 0.0
    """Standard deviation of the delay in s; 0.004 there. No reading overtakes the one before it."""

    under_way: Whole = 8
    """How many readings can be under way: at least the delay over the time between two of them."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value is impossible."""
        check_fields(self)
        require(self.wrong_words <= 1.0, self, "wrong_words", "be at most 1")
        for name in ("stale_repeats", "packet_loss", "gap_share"):
            require(getattr(self, name) < 1.0, self, name, "be below 1")

    @property
    def late(self) -> bool:
        """Whether readings come later than they were made."""
        return self.delay > 0.0 or self.jitter > 0.0

    @property
    def acts(self) -> bool:
        """Whether anything happens to a code at all."""
        errors = self.spike_rate, self.wrong_words, self.stale_repeats, self.packet_loss, self.gap_share
        return any(errors) or self.late


DIRECT = Wire()  # a wire at the end of which everything arrives, right and at once


class Wired(Protocol):
    """An instrument with a wire: :class:`~surefoot.sensors.LoadCells`, for instance."""

    @property
    def wire(self) -> Wire:
        """The stages on a code on its way to the host."""


def check_wire(config: Wire | Wired, dt: float) -> None:
    """Raise ValueError if a wire cannot hold the readings under way, ``dt`` s apart.

    The message says how many are; call it before the first step.

    >>> from surefoot.sensors import preset
    >>> check_wire(preset("hx711-bar-cells"), dt=0.0125)
    """
    on = config if isinstance(config, Wire) else config.wire
    if on.late and on.delay >= on.under_way * dt:
        raise ValueError(
            f"With readings {dt:.3g} s apart and {on.delay:.3g} s late, more are under way than "
            f"Wire.under_way = {on.under_way}; give at least {int(on.delay / dt) + 2}."
        )


class WireState(NamedTuple):
    """A wire in use; ``()`` for every part that is off or remembers nothing."""

    spikes: Any  # always ``()``
    wrong_words: Any  # always ``()``
    stale_repeats: Any  # a ``RepeatState``
    packet_loss: Any  # a ``GapState``
    gaps: Any  # a ``GapState``
    latency: Any  # a ``LatencyState``


def wire(
    config: Wire,
    rated: ArrayLike,
    code_range: tuple[ArrayLike, ArrayLike],
    bits: int,
    coding: str = "two's complement",
) -> Corruption[WireState]:
    """Build the wire to the host; readings are counts, shape (K,).

    Args:
        config: The wire.
        rated: Rated load in counts, a number or shape (K,).
        code_range: Lowest and highest code, numbers or shapes (K,).
        bits: Bits of a word; 0 for an instrument without a converter, whose readings are no words.
        coding: How a word stands for a number (see :func:`~surefoot.sensors.transport.errors.wrong_words`).

    Raises:
        ValueError: If words of an instrument without a converter are to be wrong; from ``apply`` if readings
            follow each other so fast that the wire cannot hold them (see :func:`check_wire`).
    """
    if config.wrong_words and not bits:
        raise ValueError("Wire.wrong_words must be 0 for an instrument without a converter: it has no words.")
    on: dict[str, Corruption[Any]] = {}
    if config.spike_rate:
        size = config.spike_size * np.abs(np.asarray(rated))
        on["spikes"] = spikes(config.spike_rate, size, code_range=code_range if bits else None)
    if config.wrong_words:
        on["wrong_words"] = wrong_words(config.wrong_words, bits, coding)
    if config.stale_repeats:
        on["stale_repeats"] = stale_repeats(config.stale_repeats)
    if config.packet_loss:
        on["packet_loss"] = burst_gaps(config.packet_loss, ALONE)
    if config.gap_share:
        on["gaps"] = burst_gaps(config.gap_share, config.gap_length)
    if config.late:
        on["latency"] = latency(config.delay, config.jitter, config.under_way)
    links = parts(WireState, on)

    def apply(counts: Floats, state: WireState, rng: Rng, dt: float) -> tuple[Floats, WireState]:
        check_wire(config, dt)
        return links.apply(counts, state, rng, dt)

    return Corruption(links.init, apply)
