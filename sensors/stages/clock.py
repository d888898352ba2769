"""Converters with clocks of their own, read by a host at its own rate.

Each chip's oscillator is off by some percent and starts at a random phase. A conversion is the mean of the
signal since the one before, as a sigma-delta converter's is. The host reads the last finished conversion:
sometimes the same one twice, sometimes one is skipped, and every reading ends up to a period ago.
"""

from typing import Any, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.checks import check_count
from surefoot.sensors.corruption import Corruption, Rng, chain, limit
from surefoot.sensors.randomness import uniform


class ClockState(NamedTuple):
    """The clocks of K chips and their last outputs."""

    period: Floats  # time between conversions in s, shape (K,); constant from power-up
    due: Floats  # time from now to the next conversion in s, shape (K,)
    charge: Floats
    """Integral of the signal since the last conversion up to now, in its unit times s, shape (K,)."""
    held: Floats  # the last finished conversion, shape (K,); NaN before the first
    inner: Any  # state of the stages between a signal and its conversion
    window: Any
    """The last conversions (see :func:`settle`), shape (settling, K); ``()`` for a chip that settles at
    once."""
    converter: Any  # state of the stages after the mean


def init_clock(rate: tuple[float, float], shape: tuple[int, ...], rng: Rng) -> tuple[Floats, Floats]:
    """Draw the periods of chips and the times to their first conversions, both in s."""
    period = 1.0 / uniform(rng, rate[0], rate[1], shape)
    return period, uniform(rng, 0.0, 1.0, shape) * period


def latest_conversion(period: Floats, due: Floats, dt: float) -> tuple[Floats, Floats, Floats]:
    """Return the last conversion of each chip in a block of length dt.

    Returns:
        How many conversions follow the first one in the block, -1 where there is none; the time of the last
        one since the start of the block in s, negative where there is none; and the time from the end of the
        block to the next one; each (K,).
    """
    number = np.floor((dt - due) / period)
    at = due + number * period
    return number, at, at + (period - dt)


def integrate(
    block: Floats, charge: Floats, period: Floats, number: Floats, at: Floats, dt: float
) -> tuple[Floats, Floats]:
    """Average a signal over each chip's last conversion in a block.

    Args:
        block: The signal in S equal substeps, in each of which it is constant, shape (S, K).
        charge: Its integral since the last conversion before the block, shape (K,); not finite where the
            signal was not.
        period: Duration of a conversion in s, shape (K,).
        number: As of :func:`latest_conversion`, shape (K,).
        at: As there, in s, shape (K,).
        dt: Duration of the block in s.

    Returns:
        The mean over the last conversion, and over the block for a chip that finishes none in it or whose
        charge is not finite; and the integral since then. Shape (K,) each.
    """
    step = dt / len(block)
    sums = np.concatenate([np.zeros_like(block[:1]), np.cumsum(block, axis=0)]) * step
    channels = np.arange(block.shape[1])

    def until(time: Floats) -> Floats:
        row = np.minimum((time / step).astype(np.intp), len(block) - 1)
        area: Floats = sums[row, channels] + (time - row * step) * block[row, channels]
        return area

    finished, total = number >= 0.0, sums[-1]
    end = until(np.maximum(at, 0.0))
    begin = np.where(number >= 1.0, until(np.maximum(at - period, 0.0)), -charge)
    known = finished & ((number >= 1.0) | np.isfinite(charge))
    mean: Floats = np.where(known, (end - begin) / period, total / dt)
    return mean, np.where(finished, total - end, charge + total)


def settle(window: Floats, signal: Floats, number: Floats, most: int) -> tuple[Floats, Floats]:
    """Return the mean of the last conversions of chips; a block has any number of new ones.

    Of several conversions in one block only the last one's signal is known; the others are taken on the
    straight line from the last one before the block. A signal that is not finite makes its own mean NaN; in
    the window the one before stands in its place.

    Args:
        window: The last n conversions, shape (n, K): the newest one's signal, NaN before the first, and how
            far each before it lies above it, zero before the first.
        signal: The signal at the last conversion of the block, shape (K,).
        number: How many follow the first one in the block, -1 where there is none, shape (K,).
        most: Largest number of conversions that a block of this length can have.

    Returns:
        The mean, shape (K,), and the window after the block.
    """
    length = len(window)
    before, *lags = window
    sound = np.isfinite(signal)
    signal, came = np.where((number >= 0.0) & sound, signal, before), number + 1.0
    step = before - signal
    step = np.where(np.isnan(step), 0.0, step) / np.maximum(came, 1.0)
    for push in range(min(most, length - 1)):
        # 1 where there was another conversion, which goes in front, and 0 elsewhere.
        another = limit(came - float(push), 0.0, 1.0)
        pushed = [step, *(lag + step for lag in lags[:-1])]
        lags = [lag + another * (new - lag) for lag, new in zip(lags, pushed, strict=True)]
    mean = np.where(sound, signal + sum(lags[1:], lags[0]) / length, np.nan)
    return mean, np.stack([signal, *lags])


def most_conversions(rate: tuple[float, float], dt: float) -> int:
    """Return how many conversions the fastest chip can finish in a block of length dt."""
    return int(rate[1] * dt) + 1


def init_window(settling: int, shape: tuple[int, ...]) -> Any:
    """Make the window of :func:`settle` at power-up; ``()`` for chips that settle at once."""
    if settling == 1:
        return ()
    unread = np.full((1, *shape), np.nan)
    return np.concatenate([unread, np.zeros((settling - 1, *shape))])


def sample_and_hold(
    inner: Corruption[Any],
    rate: tuple[float, float] = (80.0, 80.0),
    *,
    settling: int = 1,
    converter: Corruption[Any] | None = None,
) -> Corruption[ClockState]:
    """Convert a signal by unsynchronised chips and hold each conversion until the next.

    The reading handed to ``apply`` is a *block*: the signal in S equal substeps that fill dt, shape (S, K).
    The result has shape (K,). A conversion is the mean since the one before.

    Args:
        inner: Stages on the mean of a conversion, such as noise and rounding. It is stepped
            once a block; chips that finish no conversion in it keep their last, and what their signals
            go through meanwhile is the block's mean.
        rate: Lowest and highest conversion rate of a chip in 1/s; each draws its own.
        settling: Over how many conversions a chip averages, as a sigma-delta converter's filter does: a step
            has settled after as many, and the mean is late by (settling - 1) / 2 of them.
        converter: Stages on the mean after that, once a block.

    Raises:
        ValueError: If the rates are not positive and in order, or the number is not a positive whole one.
    """
    check_rate(rate)
    check_count("settling", settling)
    converter = converter or chain()

    def init(shape: tuple[int, ...], rng: Rng) -> ClockState:
        period, due = init_clock(rate, shape, rng)
        return ClockState(
            period,
            due,
            np.zeros(shape),
            np.full(shape, np.nan),
            inner.init(shape, rng),
            init_window(settling, shape),
            converter.init(shape, rng),
        )

    def apply(block: Floats, state: ClockState, rng: Rng, dt: float) -> tuple[Floats, ClockState]:
        period, due, charge, held = state[:4]
        number, at, due = latest_conversion(period, due, dt)
        mean, charge = integrate(block, charge, period, number, at, dt)
        signal, inner_state = inner.apply(mean, state.inner, rng, dt)
        window = state.window
        if settling > 1:
            signal, window = settle(window, signal, number, most_conversions(rate, dt))
        converted, converter_state = converter.apply(signal, state.converter, rng, dt)
        held = np.where(number >= 0.0, converted, held)
        return held, ClockState(period, due, charge, held, inner_state, window, converter_state)

    return Corruption(init, apply)


def check_rate(rate: tuple[float, float]) -> None:
    """Raise ValueError if rates are not positive, finite and in order."""
    if len(rate) != 2 or not 0.0 < rate[0] <= rate[1] < float("inf"):
        raise ValueError(f"'rate' must be (lowest, highest) with 0 < lowest <= highest in 1/s, got {rate}.")
