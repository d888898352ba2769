r"""Means, shares and survival with their 95 % intervals.

**Survival** is the product-limit estimate of Kaplan and Meier (1958). Its band is Greenwood's (1926) on the
scale of :math:`\ln(-\ln S)` (Kalbfleisch and Prentice, 1980), which stays within 0 and 1. Both are SciPy's.
"""

import warnings
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from surefoot.arrays import Floats


class Interval(NamedTuple):
    """A mean and how sure it is."""

    mean: float  # of the finite values
    half: float  # half the width of the two-sided 95 % interval (Student t); NaN below two values
    n: int  # number of finite values

    @property
    def apart(self) -> bool:
        """Whether the interval leaves zero out; never below two values."""
        return self.n > 1 and abs(self.mean) > self.half


def mean_interval(values: ArrayLike) -> Interval:
    """Return the mean of one number a seed and its interval by Student's t, of those that are finite.

    >>> interval = mean_interval([1.0, 2.0, 3.0])
    >>> print(f"{interval.mean:.2f} +- {interval.half:.4f}")
    2.00 +- 2.4841
    """
    sample = np.asarray(values, dtype=np.float64).ravel()
    sample = sample[np.isfinite(sample)]
    n = len(sample)
    if n == 0:
        return Interval(float("nan"), float("nan"), 0)
    if n == 1:
        return Interval(float(sample[0]), float("nan"), 1)
    half = stdtrit(n - 1, 0.975) * np.std(sample, ddof=1) / np.sqrt(n)
    return Interval(float(np.mean(sample)), float(half), n)


class Share(NamedTuple):
    """A share of falls with its 95 % interval (Wilson, 1927), and of how many."""

    share: float
    low: float
    high: float
    n: int


def fall_share(fell: ArrayLike) -> Share:
    """Return the share of those that fell.

    >>> fall_share([True, False, False, False]).share
    0.25
    """
    events = np.asarray(fell, dtype=bool)
    if not events.size:
        return Share(*(float("nan"),) * 3, 0)
    from scipy import stats  # takes half a second

    interval = stats.binomtest(int(events.sum()), events.size).proportion_ci(0.95, method="wilson")
    return Share(float(events.mean()), float(interval.low), float(interval.high), events.size)


class Survival(NamedTuple):
    """A survival curve: from each time on, the share on its feet and its 95 % band, shape (n,) each."""

    time: Floats  # in s, from 0 on
    share: Floats
    low: Floats  # NaN where nothing is known of it
    high: Floats


def survival(time: ArrayLike, fell: ArrayLike) -> Survival:
    """Return the share of walkers on their feet, of times at which each fell or was last seen, in s, (n,).

    >>> curve = survival([2.0, 5.0, 9.0, 9.0], [True, True, False, False])
    >>> curve.share
    array([1.  , 0.75, 0.5 , 0.5 ])
    >>> curve.low.round(3)
    array([1.   , 0.128, 0.058, 0.058])
    """
    ends, events = np.asarray(time, dtype=np.float64), np.asarray(fell, dtype=bool)
    if not ends.size:
        return Survival(np.zeros(1), *(np.ones(1),) * 3)
    from scipy import stats  # takes half a second

    curve = stats.ecdf(stats.CensoredData(uncensored=ends[events], right=ends[~events])).sf
    with warnings.catch_warnings():
        # Of a share of 1 or 0 the formula says nothing.
        warnings.filterwarnings("ignore", "The confidence interval is undefined", RuntimeWarning)
        band = curve.confidence_interval(method="log-log")
    share = curve.probabilities
    low, high = (np.where(share == 1.0, 1.0, part.probabilities) for part in (band.low, band.high))
    first = np.ones(1)
    return Survival(
        np.concatenate([[0.0], curve.quantiles]), *(np.concatenate([first, p]) for p in (share, low, high))
    )
