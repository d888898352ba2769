r"""White noise, drift of the offset and drift of the scale, by the exact likelihood of channels at rest.

A channel under a constant load F is a random walk seen in noise. Differences of neighbouring conversions
have variances :math:`\tau w^2 + 2 \sigma^2` and covariances :math:`-\sigma^2`; sines (DST-I) make that
matrix diagonal, so that the j-th of n coefficients is normal and independent with variance

.. math:: \tau (q^2 + F^2 g^2) + 2 \sigma^2 \Big(1 - \cos \frac{\pi j}{n + 1}\Big)

for walks of the offset (q, in N per square root of a second) and of the scale (g, relative). A converter
that averages over its last m conversions lets :math:`\sin^2(m \omega / 2) / (m \sin(\omega / 2))^2` of the
walk through; of some m the likeliest counts. Intervals are those of the profile likelihood: where it has
fallen by half a quantile of chi squared.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.fft import dst
from scipy.optimize import brentq, minimize
from scipy.stats import chi2, norm

from surefoot.arrays import Floats
from surefoot.experiments.instrument.noise import ROUNDING, Stretch

AVERAGED = (1, 2, 4, 8)  # conversions that converters average over
ALARM = 0.999  # probability that a converter that does not average is not said to
SURE = 0.9  # probability of an interval
SLOW = 2  # first sines that are left out: creep and temperature are slow as well
BINS = 24  # of neighbouring sines that count as one: the spectrum is smooth
FAR = 1e4  # factor to either side within which an interval is looked for


class Interval(NamedTuple):
    """A value and its interval of probability :data:`SURE`."""

    value: float
    low: float
    high: float


def normal_interval(value: float, std: float) -> Interval:
    """Return the interval of a value with a normal error."""
    half = float(norm.ppf(0.5 + SURE / 2.0)) * std
    return Interval(value, value - half, value + half)


class AtRest(NamedTuple):
    """Channels at rest, in newtons and seconds."""

    noise: Interval  # std of a conversion, without its rounding
    offset: Interval  # random walk of the offset in N/sqrt(s)
    scale: Interval | None  # random walk of the scale in 1/sqrt(s); ``None`` if no load was on
    settling: int  # conversions over which the converter averages, as far as a walk shows it


class _Powers(NamedTuple):
    """Sums of squares of neighbouring sines, their number, 2 (1 - cos), interval and load squared."""

    squares: Floats
    number: Floats
    white: Floats
    tau: Floats
    load: Floats
    step: Floats  # rounding variance in N^2
    passed: Floats  # share of a walk's power that averages let through, by :data:`AVERAGED`


def fit_at_rest(stretches: Sequence[tuple[Stretch, float, float]]) -> AtRest | None:
    """Find noise and drift of stretches, each with its load in N and the N of one step of its converter.

    ``None`` if there are too few conversions. Values of stretches are in N.
    """
    powers = _powers(stretches)
    if powers is None:
        return None
    loaded = bool((powers.load > 0.0).any())
    first = float(np.sqrt(powers.squares.sum() / powers.number.sum()))
    tau = float(np.median(powers.tau))
    typical = float(np.sqrt(powers.load.max(initial=0.0))) or 1.0
    walk = 0.5 * first / np.sqrt(tau)
    start = np.log([0.5 * first, walk, walk / typical][: 2 + loaded])

    def fit(averaged: int) -> tuple[float, Floats]:
        cost = partial(_cost, powers, averaged)
        starts = [start + np.array(shift[: len(start)]) for shift in _STARTS]
        tried = (minimize(cost, one, method="Nelder-Mead", options=_OPTIONS) for one in starts)
        best = min(tried, key=lambda one: float(one.fun))
        return float(best.fun) + (averaged > 0) * 0.5 * float(chi2.ppf(ALARM, 1)), best.x

    fits = [fit(k) for k in range(len(AVERAGED))]
    k = int(np.argmin([least for least, _ in fits]))
    cost = partial(_cost, powers, k)
    best = fits[k][1]
    found = [_interval(cost, best, cost(best), i, float(start[i])) for i in range(len(start))]
    return AtRest(found[0], found[1], found[2] if loaded else None, AVERAGED[k])


_OPTIONS = {"xatol": 1e-4, "fatol": 1e-5, "maxiter": 2000}
_STARTS = ((0, 0, 0), (0, -2, -2), (-2, 0, -2), (-2, -2, 0))  # which of the three is large, in logarithms


def _powers(stretches: Sequence[tuple[Stretch, float, float]]) -> _Powers | None:
    rows: list[tuple[float, ...]] = []
    for one, load, step in stretches:
        n = len(one.value) - 1
        if n < 4 * SLOW:
            continue
        power = dst(np.diff(one.value), type=1, norm="ortho") ** 2
        tau = float(np.diff(one.time).mean())
        omega = np.pi * np.arange(1, n + 1) / (n + 1)
        white = 2.0 * (1.0 - np.cos(omega))
        passed = np.array([(np.sin(m * omega / 2.0) / (m * np.sin(omega / 2.0))) ** 2 for m in AVERAGED])
        for part in np.array_split(np.arange(SLOW, n), min(BINS, n - SLOW)):
            facts = power[part].sum(), len(part), white[part].mean(), tau, load**2, ROUNDING * step**2
            rows.append((*facts, *passed[:, part].mean(axis=1)))
    if not rows:
        return None
    table = np.array(rows, dtype=np.float64).T
    return _Powers._make([*table[:6], table[6:]])


def _cost(powers: _Powers, averaged: int, theta: Floats) -> float:
    """Return minus the log-likelihood of logarithms of noise, walk of the offset and walk of the scale."""
    sigma, q, *g = np.exp(2.0 * np.clip(theta, -60.0, 60.0))
    walk = powers.tau * (q + (powers.load * g[0] if g else 0.0))
    variance = walk * powers.passed[averaged] + powers.white * (sigma + powers.step)
    return float(0.5 * (powers.number * np.log(variance) + powers.squares / variance).sum())


def _interval(
    cost: Callable[[Floats], float], best: Floats, least: float, i: int, typical: float
) -> Interval:
    """Return the interval in which the profile of a cost rises by less than the quantile.

    If the best value is almost zero, the search for the upper end starts from a typical value.
    """
    rise = 0.5 * float(chi2.ppf(SURE, 1))

    def profile(value: float) -> float:
        rest = np.delete(best, i)
        found = minimize(lambda r: cost(np.insert(r, i, value)), rest, method="Nelder-Mead", options=_OPTIONS)
        return float(found.fun) - least - rise

    ends = [0.0, float(np.inf)]
    for k, side in enumerate((-1.0, 1.0)):
        far = max(best[i], typical if side > 0.0 else best[i]) + side * np.log(FAR)
        if profile(far) > 0.0:
            ends[k] = float(np.exp(brentq(profile, best[i], far, xtol=1e-3)))
    return Interval(float(np.exp(best[i])), *ends)
