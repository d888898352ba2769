r"""What the rows of a sweep say: who stands for how long, and how bad feet may be before half fall.

**Survival** is the product-limit estimate of Kaplan and Meier (1958), :math:`S(t) = \prod_{t_i \le t} (1 -
d_i / n_i)` with :math:`d_i` falls among :math:`n_i` at risk. Its 95 % band is Greenwood's (1926) on the scale
of :math:`\ln(-\ln S)` (Kalbfleisch and Prentice, 1980), which stays within 0 and 1:

.. math:: S(t)^{\exp(\pm 1.96\, \sigma(t))}, \qquad
   \sigma^2(t) = \frac{1}{\ln^2 S(t)} \sum_{t_i \le t} \frac{d_i}{n_i (n_i - d_i)}.

**The severity at which half fall** is where the share of falls crosses one half, linearly between the
severities that were run, once it is made not to decrease (isotonic regression); its 95 % interval is that of
2,000 resamples of the seeds, which are paired over severities. An end of it may lie beyond what was run.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, stats

from surefoot.experiments.study.tables import Frame

__all__ = ["HalfFall", "Survival", "fall_share", "half_fall", "survival"]

RESAMPLES = 2000
_STREAM = 0x5EED


class Survival(NamedTuple):
    """A survival curve: from each time on, the share on its feet lies probably between two others.

    Attributes:
        time: Times in s from 0 on, shape (n,).
        share: Share that stands from each on, shape (n,).
        low: Lower end of the 95 % band, shape (n,); NaN where nothing is known of it.
        high: Upper end, shape (n,).
    """

    time: NDArray[np.float64]
    share: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def survival(time: ArrayLike, fell: ArrayLike) -> Survival:
    """Estimate the share of walkers on their feet over time.

    Args:
        time: When each fell or was last seen, in s, shape (n,).
        fell: Whether it fell, shape (n,).

    >>> curve = survival([2.0, 5.0, 9.0, 9.0], [True, True, False, False])
    >>> curve.share
    array([1.  , 0.75, 0.5 , 0.5 ])
    >>> curve.low.round(3)
    array([1.   , 0.128, 0.058, 0.058])
    """
    ends, events = np.asarray(time, dtype=np.float64), np.asarray(fell, dtype=bool)
    moments = np.unique(ends)
    at_risk = (ends[:, None] >= moments).sum(axis=0)
    falls = (events[:, None] & (ends[:, None] == moments)).sum(axis=0)
    share = np.cumprod(1.0 - falls / at_risk)
    low, high = np.ones_like(share), np.ones_like(share)
    known = (share > 0.0) & (share < 1.0)
    spread = np.cumsum(falls / (at_risk * np.maximum(at_risk - falls, 1)))[known]
    reach = stats.norm.ppf(0.975) * np.sqrt(spread) / -np.log(share[known])
    low[known], high[known] = share[known] ** np.exp(reach), share[known] ** np.exp(-reach)
    low[share == 0.0], high[share == 0.0] = np.nan, np.nan
    return Survival(
        np.concatenate([[0.0], moments]), *(np.concatenate([[1.0], part]) for part in (share, low, high))
    )


class Share(NamedTuple):
    """A share of falls with its 95 % interval (Wilson, 1927), and of how many."""

    share: float
    low: float
    high: float
    n: int


def fall_share(fell: ArrayLike) -> Share:
    """Count falls.

    >>> fall_share([True, False, False, False]).share
    0.25
    """
    events = np.asarray(fell, dtype=bool)
    if not events.size:
        return Share(*(float("nan"),) * 3, 0)
    interval = stats.binomtest(int(events.sum()), events.size).proportion_ci(0.95, method="wilson")
    return Share(float(events.mean()), float(interval.low), float(interval.high), events.size)


@dataclass(frozen=True)
class HalfFall:
    """The severity at which half the episodes end in a fall.

    Attributes:
        severity: It; infinite where it lies beyond all that were run, minus infinite where below.
        low: Lower end of its 95 % interval, likewise.
        high: Upper end, likewise.
        lowest: Lowest severity that was run.
        highest: Highest one.
    """

    severity: float
    low: float
    high: float
    lowest: float
    highest: float

    def words(self) -> str:
        """Say it in a cell of a table.

        >>> HalfFall(float("inf"), 2.5, float("inf"), 0.0, 4.0).words()
        'not reached up to 4 (2.5 to above 4)'
        """
        if np.isposinf(self.severity):
            middle = f"not reached up to {self.highest:g}"
        else:
            middle = self._number(self.severity)
        if self.low == self.high:
            return middle
        return f"{middle} ({self._number(self.low)} to {self._number(self.high)})"

    def _number(self, value: float) -> str:
        if np.isinf(value):
            return f"above {self.highest:g}" if value > 0 else f"below {self.lowest:g}"
        return f"{value:.3g}"


def half_fall(rows: Frame) -> HalfFall | None:
    """Find the severity at which half fall.

    Args:
        rows: Of one controller, feed and scenario: ``severity``, ``seed``, ``fell``.

    Returns:
        It, or ``None`` where fewer than two severities have been run on the same seeds.
    """
    table = rows.pivot_table(index="seed", columns="severity", values="fell", aggfunc="mean").dropna()
    if table.shape[1] < 2 or not len(table):
        return None
    severities, fell = table.columns.to_numpy(dtype=np.float64), table.to_numpy(dtype=np.float64)
    rng = np.random.default_rng(_STREAM)
    draws = rng.integers(len(fell), size=(RESAMPLES, len(fell)))
    crossings = np.sort([_crossing(severities, fell[draw].mean(axis=0)) for draw in draws])
    # Without interpolation: between a number and infinity lies none.
    low, high = crossings[int(0.025 * RESAMPLES)], crossings[int(0.975 * RESAMPLES) - 1]
    ends = float(severities[0]), float(severities[-1])
    return HalfFall(_crossing(severities, fell.mean(axis=0)), float(low), float(high), *ends)


def _crossing(severities: NDArray[np.float64], share: NDArray[np.float64]) -> float:
    rising: Any = share if (np.diff(share) >= 0.0).all() else optimize.isotonic_regression(share).x
    if rising[-1] < 0.5:
        return float("inf")
    if rising[0] >= 0.5:
        return float("-inf") if rising[0] > 0.5 else float(severities[0])
    k = int(np.argmax(rising >= 0.5))
    part = (0.5 - rising[k - 1]) / (rising[k] - rising[k - 1])
    return float(severities[k - 1] + part * (severities[k] - severities[k - 1]))
