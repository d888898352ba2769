r"""Errors in the transport of readings to the host: spikes, bit errors, stale repeats, gaps.

**Spikes** are single wrong readings. They follow a Poisson process with the rate :math:`r` in each channel,
so that a reading that covers the time :math:`\Delta t` is wrong with the probability
:math:`1 - e^{-r \Delta t}`. The error is normally distributed: some spikes are large and some are within the
noise, so that a threshold does not find them all.

**Bit errors**: one bit of a code is flipped, because of an interrupt between two clock edges of a bit-banged
bus or noise on its line. The effect depends on the bit and ranges from one count to half of the range.
Occasional errors of 320,000 counts were reported for HX711 chips (esphome#2996). The rate depends on the host
and is not published.

**Stale repeats**: a reader that finds no new value returns the last one again. A reader that polls its chips
in turn, and a bus that misses one, keep their old value. In a log of a NAO's feet, 73 % of the values equal
the previous one. Each reading is a repeat with the probability p, independent of the others, so that a value
stays for 1 / (1 - p) readings in the mean. (:func:`~surefoot.sensors.stages.clock.sample_and_hold` repeats
because clocks differ.)

**Gaps**: packets are lost, mostly in bursts. A link is good or bad (Gilbert, 1960, and Elliott, 1963), and a
bad one loses everything. It turns bad at the rate :math:`\mu` and good again at the rate :math:`\lambda`, in
continuous time, so that with the mean length of a gap :math:`1 / \lambda` the share of the time that is lost
and the correlation over a time :math:`t` are

.. math:: p = \frac{\mu}{\lambda + \mu}, \qquad \rho(t) = e^{-(\lambda + \mu) t}, \qquad
          \lambda + \mu = \frac{\lambda}{1 - p},

for any time step. A log of an iCub has a gap of 0.17 s, one of a balance board's radio a gap of
22.6 s.

All of these are properties of an instrument. A break in one channel at a given time is a
:class:`~surefoot.sensors.Fault`.
"""

from math import expm1
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.checks import is_whole
from surefoot.sensors.configuration import check_not_negative
from surefoot.sensors.corruption import Corruption, Rng, limit, stateless
from surefoot.sensors.randomness import normal, uniform

CODINGS = ("offset-binary", "two's complement")
"""Binary codes of readings, by the names that :class:`~surefoot.sensors.LoadCells` uses."""


class RepeatState(NamedTuple):
    """The last output of a reader."""

    held: Floats  # shape (K,), NaN before the first


class GapState(NamedTuple):
    """Whether the link is up."""

    lost: Floats  # 1 within a gap and 0 elsewhere, shape (1,)


def spikes(
    rate: float, size: ArrayLike, *, code_range: tuple[ArrayLike, ArrayLike] | None = None
) -> Corruption[tuple[()]]:
    """Add random spikes at a mean rate in 1/s per channel.

    ``size`` is their standard deviation in the unit of the readings, a number or shape (K,). With a
    ``code_range``, the lowest and highest code of a converter, spikes are clipped to it and rounded.
    """
    check_not_negative(rate=rate)
    sizes = np.asarray(size, dtype=np.float64)
    if not np.all((sizes >= 0.0) & np.isfinite(sizes)):
        raise ValueError(f"'size' must be finite and not negative, got {size!r}.")

    def add(reading: Floats, rng: Rng, dt: float) -> Floats:
        hit = uniform(rng, 0.0, 1.0, reading.shape) < -expm1(-rate * dt)
        off = reading + sizes * normal(rng, reading.shape)
        if code_range is not None:
            off = np.rint(limit(off, *code_range))
        return np.where(hit, off, reading)

    return stateless(add)


def wrong_words(probability: float, bits: int = 24, coding: str = "offset-binary") -> Corruption[tuple[()]]:
    """Flip one bit of a reading at random, each bit with equal probability.

    Readings are counts, whole numbers within the range of the code. NaN is not changed.

    Args:
        probability: Probability of a bit error, independent for each channel and reading.
        bits: Number of bits, 1 to 32.
        coding: ``"offset-binary"``, from 0 to 2^bits - 1, or ``"two's complement"``, from -2^(bits - 1) to
            2^(bits - 1) - 1, with a negative highest bit.

    Raises:
        ValueError: If the probability is not in [0, 1], or the number of bits or the coding is not allowed.

    >>> rng = np.random.default_rng(0)
    >>> flip = wrong_words(1.0, bits=3, coding="two's complement")
    >>> {int(flip.apply(np.array([2.0]), (), rng, 1.0)[0][0]) for _ in range(100)} == {0, 3, -2}
    True
    """
    if not 0.0 <= probability <= 1.0:
        raise ValueError(f"'probability' must lie in [0, 1], got {probability}.")
    if not (is_whole(bits) and 1 <= bits <= 32):
        raise ValueError(f"'bits' must be a whole number from 1 to 32, got {bits!r}.")
    if coding not in CODINGS:
        raise ValueError(f"'coding' must be one of {CODINGS}, got {coding!r}.")
    places = 2.0 ** np.arange(bits)
    signs = np.where((places == places[-1]) & (coding == CODINGS[1]), -1.0, 1.0)
    # Flipping a bit from 0 to 1 adds its value, and from 1 to 0 subtracts it.
    worths = places * signs

    def turn_over(reading: Floats, rng: Rng, dt: float) -> Floats:
        hit = uniform(rng, 0.0, 1.0, reading.shape) < probability
        which = (uniform(rng, 0.0, 1.0, reading.shape) * bits).astype(np.intp)
        # Halving rounds down, so negative words show the bits of their two's complement.
        above = np.floor(reading / places[which])
        bit = above - 2.0 * np.floor(above / 2.0)
        return np.where(hit, reading + (1.0 - 2.0 * bit) * worths[which], reading)

    return stateless(turn_over)


def stale_repeats(probability: float) -> Corruption[RepeatState]:
    """Repeat the last value with a probability in [0, 1), for all channels together.

    Before the first reading, and after a lost one, the new reading is not changed.
    """
    if not 0.0 <= probability < 1.0:
        raise ValueError(f"'probability' must lie in [0, 1), got {probability}.")

    def init(shape: tuple[int, ...], rng: Rng) -> RepeatState:
        return RepeatState(np.full(shape, np.nan))

    def apply(reading: Floats, state: RepeatState, rng: Rng, dt: float) -> tuple[Floats, RepeatState]:
        stale = uniform(rng, 0.0, 1.0, (1,)) < probability
        read = np.where(stale & ~np.isnan(state.held), state.held, reading)
        return read, RepeatState(read)

    return Corruption(init, apply)


def burst_gaps(share: float, mean_length: float) -> Corruption[GapState]:
    """Lose readings in bursts: they become NaN, in all channels together, since a packet has all of them.

    Args:
        share: Long-term share of the time that is lost, in [0, 1).
        mean_length: Mean length of a gap in s. If it is not much longer than the time between readings, short
            gaps between two readings are not visible, and the visible ones seem longer.
    """
    if not 0.0 <= share < 1.0:
        raise ValueError(f"'share' must lie in [0, 1), got {share}.")
    if not 0.0 < mean_length < float("inf"):
        raise ValueError(f"'mean_length' must be finite and positive, got {mean_length}.")

    def init(shape: tuple[int, ...], rng: Rng) -> GapState:
        return GapState((uniform(rng, 0.0, 1.0, (1,)) < share).astype(np.float64))

    def apply(reading: Floats, state: GapState, rng: Rng, dt: float) -> tuple[Floats, GapState]:
        drawn = uniform(rng, 0.0, 1.0, state.lost.shape)
        decayed = -expm1(-dt / (mean_length * (1.0 - share)))
        lost = drawn < state.lost * (1.0 - decayed) + decayed * share
        return reading + np.where(lost, np.nan, 0.0), GapState(lost.astype(np.float64))

    return Corruption(init, apply)
