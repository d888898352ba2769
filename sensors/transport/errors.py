r"""Errors of a reading on its way to the host: spikes, wrong words, stale repeats, gaps.

**Spikes** are single readings that are off. They come as a Poisson process of the rate :math:`r` in each
channel, so that a reading which stands for the time :math:`\Delta t` is off with the probability
:math:`1 - e^{-r \Delta t}`, and by a normal number: a few are far out and some hide in the noise, which is
the reason why they are hard to gate.

**Wrong words**: a bit of a code arrives the wrong way round, because of an interrupt between two clock edges
of a bit-banged bus or noise on its line. Which bit it is decides the effect: from one count, which nobody
sees, to half of the range. Readings of HX711 chips were seen off by 320,000 counts now and then
(esphome#2996); how often depends on the host, and nobody has published a rate.

**Stale repeats**: a reader that finds no new value returns the last one again. A reader that polls its chips
in turn, and a bus that misses one, keep their old value: in a log of a NAO's feet 73 % of the values repeat
the one before. Each reading is a repeat with the probability p, independent of the others, so that a value
stays for 1 / (1 - p) readings in the mean. (:func:`~surefoot.sensors.stages.clock.sample_and_hold` repeats
because clocks differ.)

**Gaps**: packets get lost, and seldom one alone. A link is good or bad (Gilbert, 1960; Elliott, 1963), and a
bad one loses everything. It turns bad at the rate :math:`\mu` and good again at the rate :math:`\lambda`, in
continuous time, so that with the mean length of a gap :math:`1 / \lambda` the share of the time that is lost
and the correlation over a time :math:`t` are

.. math:: p = \frac{\mu}{\lambda + \mu}, \qquad \rho(t) = e^{-(\lambda + \mu) t}, \qquad
          \lambda + \mu = \frac{\lambda}{1 - p},

however finely time is stepped. A log of an iCub has a gap of 0.17 s, one of a balance board's radio a gap of
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
"""How a word stands for a number; the names of :class:`~surefoot.sensors.LoadCells`."""


class RepeatState(NamedTuple):
    """The last output of a reader."""

    held: Floats  # shape (K,); NaN before the first


class GapState(NamedTuple):
    """Whether the link is up."""

    lost: Floats  # 1 within a gap and 0 elsewhere, shape (1,)


def spikes(
    rate: float, size: ArrayLike, *, code_range: tuple[ArrayLike, ArrayLike] | None = None
) -> Corruption[tuple[()]]:
    """Add spikes at random, so many of a channel in a second in the mean; 0 adds none.

    Their standard deviation is in the unit of the readings, a number or shape (K,). Readings beyond the
    lowest and the highest code of a converter, if there is one, are clipped to it and rounded.
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
    """Turn one bit of a reading over now and then, every bit alike.

    Readings are counts, whole numbers that the word can hold; NaN stays as it is.

    Args:
        probability: Probability that a word is wrong, for each channel and reading on its own.
        bits: Bits of a word, 1 to 32.
        coding: ``"offset-binary"``, from 0 to 2^bits - 1, or ``"two's complement"``, from -2^(bits - 1) to
            2^(bits - 1) - 1, of which the highest bit counts negative.

    Raises:
        ValueError: If the probability does not lie in [0, 1], or there is no such word.

    >>> rng = np.random.default_rng(0)
    >>> word = wrong_words(1.0, bits=3, coding="two's complement")
    >>> {int(word.apply(np.array([2.0]), (), rng, 1.0)[0][0]) for _ in range(100)} == {0, 3, -2}
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
    # A reading adds what the bit is worth where it was 0 and loses it where it was 1.
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
    """Repeat the last value with a probability in [0, 1), all channels together.

    Where there is none, before the first reading and after one that was lost, the new one passes.
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
    """Lose readings in bursts: they are NaN, all channels together as they travel in one packet.

    Args:
        share: Share of the time that is lost in the long run in [0, 1); 0 loses nothing.
        mean_length: Mean length of a gap in s. Where it is not long against the time between
            readings, gaps that fall between two of them are not seen, and those that are seem longer.
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
