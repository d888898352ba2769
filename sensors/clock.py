"""Converters with clocks of their own, read by a host at its own rate.

Each chip's oscillator is off by some percent and starts when it likes. The host sees the last finished
conversion: at times the same one twice, at times one is lost, and every reading is up to a period old.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from array_api_compat import array_namespace
from array_api_compat import device as device_of
from numpy.typing import NDArray

from surefoot.sensors._arrays import cast_like, namespace
from surefoot.sensors.corruption import Array, Corruption, Rng
from surefoot.sensors.randomness import filled, uniform


class ClockState(NamedTuple):
    """The clocks of K chips and what they last put out.

    Attributes:
        period: Time between conversions in s, shape (..., K); constant from power-up.
        due: Time from now to the next conversion in s, shape (..., K).
        previous: The signal at the end of the block before, shape (..., K).
        held: The last finished conversion, shape (..., K); NaN before the first.
        inner: State of what happens to a signal when it is converted.
    """

    period: Array
    due: Array
    previous: Array
    held: Array
    inner: Any


def init_clock(
    rate: tuple[float, float], shape: tuple[int, ...], rng: Rng, dtype: Any = None
) -> tuple[Array, Array]:
    """Draw the periods of chips and the times to their first conversions, both in s."""
    period = 1.0 / uniform(rng, rate[0], rate[1], shape, dtype)
    return period, uniform(rng, 0.0, 1.0, shape, dtype) * period


def latest_conversion(period: Array, due: Array, dt: float) -> tuple[Array, Array, Array]:
    """Find the last conversion of each chip in a block of length dt.

    Returns:
        How many conversions follow the first one in the block, -1 where there is none; the time of the last
        one since the start of the block in s, negative where there is none; and the time from the end of the
        block to the next one; each (..., K).
    """
    number = namespace(period).floor((dt - due) / period)
    at = due + number * period
    return number, at, at + (period - dt)


def interpolate(block: Array, previous: Array, position: Array) -> Array:
    """Read a block of substeps between its rows, linearly.

    Args:
        block: Signals at the ends of S substeps, shape (..., S, K).
        previous: Signals at the block's start, shape (..., K).
        position: Where to read, from 0 (the start) to S (the last row), shape (..., K); beyond, the result is
            of no use.

    Returns:
        Signals, shape (..., K).
    """
    substeps = block.shape[-2]
    if type(block) is np.ndarray and block.ndim == 2:
        channels = block.shape[1]
        rows = np.empty((substeps + 1, channels), dtype=block.dtype)
        rows[0], rows[1:] = previous, block
        low = np.minimum(position.astype(np.intp), substeps - 1)
        index = low * channels + _channel_numbers(channels)
        # A position before the start wraps around within the block: the reading is not used.
        start = rows.take(index, mode="wrap")
        part = np.subtract(position, low, dtype=block.dtype)
        return start + part * (rows.take(index + channels, mode="wrap") - start)
    xp = array_namespace(block)
    rows = xp.concat([previous[..., None, :], block], axis=-2)
    numbers = xp.arange(substeps + 1, dtype=position.dtype, device=device_of(position))
    weight = 1.0 - xp.abs(position[..., None, :] - numbers[:, None])
    return xp.sum(xp.clip(weight, 0.0, 1.0) * rows, axis=-2)


@cache
def _channel_numbers(channels: int) -> NDArray[np.intp]:
    return np.arange(channels)


def sample_and_hold(
    inner: Corruption[Any], rate: tuple[float, float] = (80.0, 80.0)
) -> Corruption[ClockState]:
    """Convert a signal by unsynchronised chips and hold each conversion until the next.

    The reading handed to ``apply`` is a *block*: the signal at the ends of S equal substeps that fill
    dt, shape (..., S, K). The result has shape (..., K). Between substeps the signal is interpolated.

    Args:
        inner: What happens to the signal at a conversion, such as noise and rounding. It is stepped
            once a block; chips that finish no conversion in it keep their last.
        rate: Lowest and highest conversion rate of a chip in 1/s; each draws its own.

    Raises:
        ValueError: If the rates are not positive and in order.
    """
    check_rate(rate)

    def init(shape: tuple[int, ...], rng: Rng, dtype: Any = None) -> ClockState:
        period, due = init_clock(rate, shape, rng, dtype)
        return ClockState(
            period,
            due,
            filled(rng, 0.0, shape, dtype),
            filled(rng, float("nan"), shape, dtype),
            inner.init(shape, rng, dtype),
        )

    def apply(block: Array, state: ClockState, rng: Rng, dt: float) -> tuple[Array, ClockState]:
        period, due, previous, held = (cast_like(part, block) for part in state[:4])
        number, at, due = latest_conversion(period, due, dt)
        signal = interpolate(block, previous, at * (block.shape[-2] / dt))
        converted, inner_state = inner.apply(signal, state.inner, rng, dt)
        held = namespace(block).where(number >= 0.0, converted, held)
        return held, ClockState(period, due, block[..., -1, :] + 0.0, held, inner_state)

    return Corruption(init, apply)


def check_rate(rate: tuple[float, float]) -> None:
    """Refuse rates that are not positive, finite and in order."""
    if len(rate) != 2 or not 0.0 < rate[0] <= rate[1] < float("inf"):
        raise ValueError(f"'rate' must be (lowest, highest) with 0 < lowest <= highest in 1/s, got {rate}.")
