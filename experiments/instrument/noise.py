r"""A channel at rest: its conversions, its noise and its drift.

The Allan deviation over :math:`m` conversions of length :math:`\tau_0` (IEEE 952),

.. math:: \sigma^2(m \tau_0) = \tfrac12 \langle (\bar y_{k+1} - \bar y_k)^2 \rangle,

of means over m conversions, falls as :math:`\sigma_n / \sqrt m` for white noise and rises as
:math:`q \sqrt{\tau / 3}` for a random walk of density q per square root of a second.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from surefoot.arrays import Floats
from surefoot.experiments.logs.clock import MAX_GAP

FEWEST = 16  # samples of a stretch at rest: shorter ones show no more than their own slope
BLOCK = 0.5  # s in which a channel rests or does not
QUIET = 3.0  # spread of a block in that of the quietest ones up to which a channel rests in it
WHITE = 0.3  # least ratio of von Neumann of a block at rest: white noise has 1, a slope 0
ROUNDING = 1.0 / 12.0  # variance of rounding in steps squared
SLOWER = 0.02  # share of repeated rows from which a chip may be slower than the rows
BY_CHANCE = 8.0  # variance, by chance, of the number of conversions in as many rows as are counted together
REGULAR = 0.25  # share of it below which a clock makes the repeats: a clock's is below 1
NORMAL = 0.6745  # median of |z| for z ~ N(0, 1)
ONE_SQUARED = 0.455  # median of chi squared with one degree of freedom
LEAP = 4.0  # usual times between two rows from which on the clock leaps, if it is longer than a log's gap


class Stretch(NamedTuple):
    """Conversions of one channel at rest, in order."""

    time: Floats  # in s, shape (n,)
    value: Floats  # in counts, shape (n,)


class Allan(NamedTuple):
    """Allan deviations of a channel."""

    tau: Floats  # in s, shape (T,)
    deviation: Floats  # in counts, shape (T,)
    pairs: Floats  # independent differences behind each, shape (T,)


class Noise(NamedTuple):
    """White noise and random walk of a channel."""

    white: float  # std of one conversion in counts, without its rounding
    walk: float  # density of the random walk in counts per sqrt(s)
    interval: float  # s between conversions


class Conversions(NamedTuple):
    """The rows of a channel in which a conversion was read."""

    rows: NDArray[np.intp]
    repeats: float  # share of rows that repeat the one before
    slower: bool  # whether the chip's own clock makes them: it is slower than the rows


def conversions(raw: Floats) -> Conversions:
    """Find the rows in which a new conversion was read.

    A slow chip repeats its readings at the rate of its own clock, so that the number of its conversions in a
    given number of rows varies by one or two only. A channel whose noise is as small as its steps repeats
    readings by chance: this number then has a binomial variance, and every row is a conversion.
    """
    there = np.flatnonzero(np.isfinite(raw))
    fresh = np.concatenate([[True], np.diff(raw[there]) != 0.0])[: len(there)]
    repeats = float(1.0 - fresh[1:].mean()) if len(there) > 1 else 0.0
    chance = repeats * (1.0 - repeats)
    rows = int(np.ceil(BY_CHANCE / chance)) if repeats > SLOWER and chance > 0.0 else len(there) + 1
    windows = len(there) // rows
    if windows < FEWEST // 2:
        return Conversions(there, repeats, False)
    counts = fresh[: windows * rows].reshape(windows, rows).sum(axis=1)
    # The median of windows leaves out those in which the load moves every reading, or rows were lost.
    variance = 0.5 * float(np.median(np.diff(counts) ** 2)) / ONE_SQUARED
    slower = variance < REGULAR * BY_CHANCE
    return Conversions(there[fresh] if slower else there, repeats, slower)


def step_of(raw: Floats) -> float:
    """Return the smallest step between two readings: the unit of the converter, or of another rounding."""
    values = np.unique(raw[np.isfinite(raw)])
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * max(np.abs(values).max(initial=0.0), 1e-300)]
    return float(gaps.min()) if len(gaps) else float("nan")


def rests(time: Floats, raw: Floats, unloaded: NDArray[np.bool_]) -> list[Stretch]:
    """Return the stretches in which a channel is unloaded or, if none is known, in which it is quietest."""
    rows = conversions(raw).rows
    if len(rows) < FEWEST:
        return []
    t, y = time[rows], raw[rows]
    if not (np.diff(t) > 0.0).any():
        return []
    still = unloaded[rows] if unloaded.any() else _quiet(t, y)
    cuts = np.flatnonzero((np.diff(t) <= 0.0) | find_leaps(t) | np.diff(still)) + 1
    parts = np.split(np.arange(len(t)), cuts)
    return [Stretch(t[part], y[part]) for part in parts if still[part[0]] and len(part) >= FEWEST]


def find_leaps(time: Floats) -> NDArray[np.bool_]:
    """Return which steps between increasing times in s, shape (N,), are gaps, shape (N - 1,)."""
    steps = np.diff(time)
    leaps: NDArray[np.bool_] = steps > max(MAX_GAP, LEAP * _usual_step(time))
    return leaps


def _usual_step(time: Floats) -> float:
    """Return the median of the positive steps of time in s."""
    steps = np.diff(time)
    return float(np.median(steps[steps > 0.0]))


def find_settled(parts: Sequence[Stretch]) -> list[Stretch]:
    """Return the longest part of each stretch in which means over half a second change as usual.

    A plate relaxes for some seconds after somebody has left it, and trembles when somebody walks by. A column
    of loads may also change some rows before or after the load does. Stretches of less than three means are
    returned unchanged.
    """
    sizes = [max(1, round(BLOCK / float(np.diff(one.time).mean()))) for one in parts]
    steps = [np.abs(np.diff(_means(one, size))) for one, size in zip(parts, sizes, strict=True)]
    every = np.concatenate([np.zeros(0), *steps])
    limit = QUIET / NORMAL * float(np.median(every)) if len(every) else 0.0
    found = []
    for one, size, step in zip(parts, sizes, steps, strict=True):
        runs = np.split(np.arange(len(step) + 1), np.flatnonzero(step > limit) + 1)
        run = max(runs, key=len)
        end = size * (run[-1] + 1)
        rest = one.value[end:] if run[-1] == len(step) else one.value[:0]
        if len(rest) and abs(rest.mean() - one.value[end - size : end].mean()) <= limit * np.sqrt(
            size / len(rest)
        ):
            end = len(one.value)
        rows = slice(size * run[0], end)
        if len(step) < 2:
            found.append(one)
        elif len(run) > 2:
            found.append(Stretch(one.time[rows], one.value[rows]))
    return found


def _means(one: Stretch, size: int) -> Floats:
    blocks: Floats = one.value[: len(one.value) // size * size].reshape(-1, size)
    means: Floats = blocks.mean(axis=1)
    return means


def _quiet(time: Floats, value: Floats) -> NDArray[np.bool_]:
    """Return the rows in which a channel is about as quiet as in its quietest parts."""
    size = max(FEWEST // 2, round(BLOCK / _usual_step(time)))
    blocks = len(value) // size
    if blocks < 2:
        return np.ones(len(value), dtype=bool)
    parts = value[: blocks * size].reshape(blocks, size)
    spread = parts.std(axis=1)
    quiet = spread <= QUIET * max(float(np.quantile(spread, 0.1)), np.sqrt(ROUNDING))
    quiet &= (np.diff(parts, axis=1) ** 2).mean(axis=1) >= 2.0 * WHITE * spread**2
    # Two quiet blocks at different loads are two rests.
    jump = np.abs(np.diff(parts.mean(axis=1))) > QUIET * np.maximum(spread[1:], spread[:-1])
    found = np.repeat(quiet, size)
    found[size * (np.flatnonzero(jump) + 1)] = False
    return np.concatenate([found, np.zeros(len(value) - len(found), dtype=bool)])


def allan(stretches: Sequence[Stretch]) -> Allan:
    """Return the overlapping Allan deviations of all stretches together, at octaves of conversions."""
    longest = max((len(one.value) for one in stretches), default=0)
    taus, deviations, pairs = [], [], []
    interval = float(np.concatenate([np.diff(one.time) for one in stretches]).mean()) if stretches else np.nan
    for m in 2 ** np.arange(0, max(int(np.log2(max(longest / 3, 1))), 0) + 1):
        squares, count, independent = 0.0, 0, 0.0
        for one in stretches:
            if len(one.value) < 2 * m + 1:
                continue
            sums = np.concatenate([[0.0], np.cumsum(one.value - one.value[0])])
            means = (sums[m:] - sums[:-m]) / m
            difference = means[m:] - means[:-m]
            squares, count = squares + float(difference @ difference), count + len(difference)
            independent += len(one.value) / m - 1.0
        if count and independent >= 2.0:
            taus.append(m * interval)
            deviations.append(np.sqrt(0.5 * squares / count))
            pairs.append(independent)
    return Allan(*(np.array(part, dtype=np.float64) for part in (taus, deviations, pairs)))


def noise_of(curve: Allan) -> Noise:
    """Fit white noise and a random walk to Allan variances, weighed by how well each is known."""
    if not len(curve.tau):
        return Noise(float("nan"), float("nan"), float("nan"))
    interval, largest = float(curve.tau[0]), float(curve.deviation.max())
    if largest == 0.0:
        return Noise(0.0, 0.0, interval)
    variance = np.maximum(curve.deviation, 1e-9 * largest) ** 2
    A = np.column_stack([interval / curve.tau, curve.tau / 3.0 * (1.0 + 0.5 * (interval / curve.tau) ** 2)])
    # The spread of a variance is itself times sqrt(2 / pairs).
    weight = np.sqrt(curve.pairs / 2.0) / variance
    size = np.linalg.norm(A * weight[:, None], axis=0)
    found = nnls(A * weight[:, None] / size, variance * weight)[0] / size
    return Noise(float(np.sqrt(found[0])), float(np.sqrt(found[1])), interval)
