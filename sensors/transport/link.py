"""A link that brings readings late: by a mean delay, with jitter, but in the order in which they left.

Two faces of one model. :func:`latency` is a stage like any other: it holds the newest reading that has
arrived. :func:`send` and :func:`receive` deliver every packet with the time of its arrival, for a host that
needs them all.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.sensors.configuration import Error, Positive, check_fields, require
from surefoot.sensors.corruption import Corruption, Rng
from surefoot.sensors.randomness import normal

ROUNDING = 1e-9
"""Time in s by which a packet may be late and still count: one that arrives with the host's own step must not
miss it by rounding."""

JITTER_BOUND = 6.0  # standard deviations of a wire's or a link's jitter that no word is late by


@dataclass(frozen=True)
class Link:
    """The link of a robot's own telemetry to the host; the defaults are the CoP paper's wireless NAOqi."""

    rate: Positive | None = 100.0
    """Packets per second. ``None`` sends one just before the host reads."""

    delay: Error = 0.020
    """Mean delay in s."""

    jitter: Error = 0.004
    """Standard deviation of the delay in s. A packet never overtakes the one before it."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value is impossible."""
        check_fields(self)
        require(self.rate is not None or self.delay == 0.0, self, "delay", "be 0 for a link without a rate")


class LatencyState(NamedTuple):
    """The last D readings that were sent, the oldest first."""

    due: Floats  # time until each arrives in s, shape (D, 1); 0 or less for one that has
    readings: Floats  # shape (D, K); NaN before the first
    held: Floats  # the last that arrived, shape (K,); NaN before the first


def latency(delay: float, jitter: float = 0.0, depth: int = 8) -> Corruption[LatencyState]:
    """Hold the newest reading that has arrived by a link, late by a mean delay with jitter in s.

    So many readings, the depth, can be under way; those that have not arrived after as many are dropped.
    """
    Link(delay=delay, jitter=jitter)
    if depth < 1:
        raise ValueError(f"'depth' must be at least 1, got {depth}.")

    def init(shape: tuple[int, ...], rng: Rng) -> LatencyState:
        due = np.full((depth, 1), -np.inf)
        readings = np.full((depth, *shape), np.nan)
        return LatencyState(due, readings, np.full(shape, np.nan))

    def apply(reading: Floats, state: LatencyState, rng: Rng, dt: float) -> tuple[Floats, LatencyState]:
        drawn = jitter * normal(rng, (1,)) + delay
        waiting = state.due - dt
        due = np.maximum(np.maximum(drawn, 0.0), waiting[-1])
        due = np.concatenate([waiting[1:], due[None]])
        # Readings come in order, so their number is the row. Row 0, for none, is the last that came before.
        rows = np.concatenate([state.held[None], state.readings[1:], reading[None]])
        held = rows[np.count_nonzero(due <= 0.0)].copy()
        return held, LatencyState(due, rows[1:], held)

    return Corruption(init, apply)


class Packet(NamedTuple):
    """One packet of telemetry."""

    number: int  # number of the packet since power-up: the robot's own clock
    arrival: float  # when the host has it, in s of the host's clock
    values: Floats  # content, shape (C,)


Packets = tuple[Packet, ...]  # packets under way, in order: the state of a link


def send(values: Floats, number: int, time: float, under_way: Packets, config: Link, rng: Rng) -> Packets:
    """Return the packets under way after one more was sent, with a content, (C,), a number and a time.

    It leaves at the time in s of the host's clock; jitter comes from ``rng``.
    """
    delay = config.delay
    if config.jitter:
        delay = max(0.0, delay + config.jitter * float(normal(rng, ())))
    arrival = time + delay
    if under_way:
        arrival = max(arrival, under_way[-1].arrival)
    return (*under_way, Packet(number, arrival, values))


def receive(under_way: Packets, time: float) -> tuple[Packets, Packets]:
    """Separate packets that have arrived by a time from those still under way: both in order."""
    count = sum(packet.arrival <= time + ROUNDING for packet in under_way)
    return under_way[:count], under_way[count:]
