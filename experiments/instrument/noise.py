r"""Conversions, noise and drift of a channel at rest.

The Allan variance compares successive means :math:`\bar y_k` over :math:`m` conversions of length
:math:`\tau_0` (IEEE 952):

.. math:: \sigma^2(m \tau_0) = \tfrac12 \langle (\bar y_{k+1} - \bar y_k)^2 \rangle,

Its square root, the Allan deviation, falls as :math:`\sigma_n / \sqrt m` for white noise. For a random walk
of density q per square root of a second, it rises as :math:`q \sqrt{\tau / 3}`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from surefoot.arrays import Floats
from surefoot.experiments.logs.clock import MAX_GAP

FEWEST = 16  # minimum number of samples per stretch at rest (shorter ones mainly show their own slope)
BLOCK = 0.5  # length in s of the blocks that are classified as rest or motion
QUIET = 3.0  # maximum std of a block at rest, relative to the quietest blocks
WHITE = 0.3  # minimum von Neumann ratio of a block at rest: 1 for white noise, 0 for a slope
ROUNDING = 1.0 / 12.0  # variance of the rounding error in steps squared
SLOWER = 0.02  # share of repeated rows above which the chip may be slower than the rows
BY_CHANCE = 8.0  # variance of the number of conversions per window if repeats are random (sets its length)
REGULAR = 0.25  # share of BY_CHANCE below which repeats are due to a clock, whose variance is below 1
NORMAL = 0.6745  # median of |z| for z ~ N(0, 1)
ONE_SQUARED = 0.455  # median of chi squared with one degree of freedom
LEAP = 4.0  # minimum ratio of a gap in time to the usual step (a gap must also be longer than MAX_GAP)


class Stretch(NamedTuple):
    """Conversions of one channel at rest, in order."""

    time: Floats  # in s, shape (n,)
    value: Floats  # in counts, shape (n,)


class Allan(NamedTuple):
    """Allan deviations of a channel at T averaging times."""

    tau: Floats  # in s, shape (T,)
    deviation: Floats  # in counts, shape (T,)
    pairs: Floats  # number of independent differences in each deviation, shape (T,)


class Noise(NamedTuple):
    """White noise and random walk of a channel at rest."""

    white: float  # std of one conversion in counts, including its rounding
    walk: float  # density of the random walk in counts per sqrt(s)
    interval: float  # mean time between conversions in s


class Conversions(NamedTuple):
    """Rows of a channel that contain a new conversion."""

    rows: NDArray[np.intp]
    repeats: float  # share of rows that repeat the previous row
    slower: bool  # whether the repeats come from a chip that converts more slowly than rows are written


def conversions(raw: Floats) -> Conversions:
    """Find the rows that contain a new conversion.

    A slow chip converts at the rate of its own clock, so the number of its conversions per window of rows
    varies by only one or two. If the noise of a channel is as small as its steps, readings repeat by chance.
    The number of changes per window then has a binomial variance, and every row is a conversion.
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
    # The median ignores windows with lost rows, or with a moving load that changes every reading.
    variance = 0.5 * float(np.median(np.diff(counts) ** 2)) / ONE_SQUARED
    slower = variance < REGULAR * BY_CHANCE
    return Conversions(there[fresh] if slower else there, repeats, slower)


def step_of(raw: Floats) -> float:
    """Return the smallest difference between readings, the step of the converter or of a later rounding."""
    values = np.unique(raw[np.isfinite(raw)])
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * max(np.abs(values).max(initial=0.0), 1e-300)]
    return float(gaps.min()) if len(gaps) else float("nan")


def rests(time: Floats, raw: Floats, unloaded: NDArray[np.bool_]) -> list[Stretch]:
    """Return the unloaded stretches of a channel, or its quietest stretches if the load is unknown."""
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
    """Return a mask of the gaps, shape (N - 1,), between increasing times in s, shape (N,)."""
    steps = np.diff(time)
    leaps: NDArray[np.bool_] = steps > max(MAX_GAP, LEAP * _usual_step(time))
    return leaps


def _usual_step(time: Floats) -> float:
    """Return the median of the positive time steps in s."""
    steps = np.diff(time)
    return float(np.median(steps[steps > 0.0]))


def find_settled(parts: Sequence[Stretch]) -> list[Stretch]:
    """Return the longest part of each stretch without unusual changes between means over half a second.

    A plate relaxes for some seconds after a person has stepped off it, and vibrates when people walk past. A
    column of loads may also change some rows before or after the actual load. Stretches with fewer than three
    means are returned unchanged.
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
    """Return a mask of the rows where a channel is about as quiet as in its quietest blocks."""
    size = max(FEWEST // 2, round(BLOCK / _usual_step(time)))
    blocks = len(value) // size
    if blocks < 2:
        return np.ones(len(value), dtype=bool)
    parts = value[: blocks * size].reshape(blocks, size)
    spread = parts.std(axis=1)
    quiet = spread <= QUIET * max(float(np.quantile(spread, 0.1)), np.sqrt(ROUNDING))
    quiet &= (np.diff(parts, axis=1) ** 2).mean(axis=1) >= 2.0 * WHITE * spread**2
    # Quiet blocks under different loads belong to different stretches.
    jump = np.abs(np.diff(parts.mean(axis=1))) > QUIET * np.maximum(spread[1:], spread[:-1])
    found = np.repeat(quiet, size)
    found[size * (np.flatnonzero(jump) + 1)] = False
    return np.concatenate([found, np.zeros(len(value) - len(found), dtype=bool)])


def allan(stretches: Sequence[Stretch]) -> Allan:
    """Return overlapping Allan deviations of means over 1, 2, 4, ... conversions, pooled over stretches."""
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
    """Fit white noise and a random walk to Allan variances, weighted by their precision."""
    if not len(curve.tau):
        return Noise(float("nan"), float("nan"), float("nan"))
    interval, largest = float(curve.tau[0]), float(curve.deviation.max())
    if largest == 0.0:
        return Noise(0.0, 0.0, interval)
    variance = np.maximum(curve.deviation, 1e-9 * largest) ** 2
    A = np.column_stack([interval / curve.tau, curve.tau / 3.0 * (1.0 + 0.5 * (interval / curve.tau) ** 2)])
    # The relative standard error of a variance is sqrt(2 / pairs).
    weight = np.sqrt(curve.pairs / 2.0) / variance
    size = np.linalg.norm(A * weight[:, None], axis=0)
    found = nnls(A * weight[:, None] / size, variance * weight)[0] / size
    return Noise(float(np.sqrt(found[0])), float(np.sqrt(found[1])), interval)
