r"""Statistics of paired episodes: differences, shares of a loss won back, the severity at which half fall.

The same seed is the same episode on every feed, so that feeds are compared by differences :math:`d_s` of
episodes. The interval of a mean difference is Student's t: over seeds for one trained policy, and over the
means of the trainings for several, because episodes of one training share its policy.

The **share of a loss that is won back** is :math:`\rho = \bar a / \bar b` with :math:`a` the feed less raw
and :math:`b` true less raw. Its interval is Fieller's (1954): all :math:`\rho` for which
:math:`|\overline{a - \rho b}|` is within its t interval. It is unbounded where the loss itself is not clear.

The **interquartile mean**, the **worst decile** (mean of the lowest tenth) and the **probability of
improvement** (share of pairs in which the first is better, ties counted half) have intervals from a bootstrap
that draws trainings and, within each, seeds, as rliable does for runs (Agarwal et al., 2021).

The **severity at which half fall** is where the share of falls crosses one half, linearly between severities
after isotonic regression; its interval comes from resampled seeds.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize
from scipy.special import stdtrit

from surefoot.arrays import Floats
from surefoot.experiments.study.statistics import Interval, mean_interval
from surefoot.experiments.study.tables import Column, Frame, decimal

RESAMPLES = 2000  # of a bootstrap: the ends of a 95 % interval are then good to a tenth of its width
_STREAM = 0x5EED  # seed of the resamples

RAW, TRUE = "raw", "true"  # feeds that others are held against
NOBODY = "zero"  # the policy that does nothing, against which others are held if it is there


class Estimate(NamedTuple):
    """A number with the ends of its 95 % interval."""

    value: float
    low: float
    high: float


class Run(NamedTuple):
    """Episodes that differ by nothing but training and seed."""

    policy: str
    feed: str
    severity: float  # not regarded for true feet, which have none


def returns_of(frame: Frame, run: Run) -> Column:
    """Return the returns of a run by training and seed."""
    wanted = (frame["policy"] == run.policy) & (frame["feed"] == run.feed)
    if run.feed != TRUE:
        wanted &= frame["severity"] == run.severity
    return frame[wanted].set_index(["training", "seed"])["return"].sort_index()


def pair(frame: Frame, *runs: Run) -> list[Column]:
    """Return the returns of runs over the trainings and seeds that all of them have.

    Runs of different policies are paired by seed, over the means of each one's trainings.
    """
    found = [returns_of(frame, run) for run in runs]
    if len({run.policy for run in runs}) > 1:
        found = [one.groupby("seed").mean() for one in found]
    both = found[0].index
    for one in found[1:]:
        both = both.intersection(one.index)
    return [one[both] for one in found]


def mean_over(values: Column) -> Interval:
    """Return the mean of one number per episode, over trainings if there are several."""
    return mean_interval(_units(values))


def difference(frame: Frame, first: Run, second: Run) -> Interval | None:
    """Return first less second of returns; ``None`` if they share no episode."""
    a, b = pair(frame, first, second)
    return mean_over(a - b) if len(a) else None


def share_won_back(frame: Frame, run: Run) -> Estimate | None:
    """Return the share of the loss on raw readings that a feed wins back.

    ``None`` where there is nothing to compare; NaN where the loss is not clear.
    """
    if run.feed in (RAW, TRUE):
        return None
    own, raw, true = pair(frame, run, run._replace(feed=RAW), run._replace(feed=TRUE))
    if not len(own):
        return None
    return fieller(_units(own - raw), _units(true - raw))


def fieller(numerator: ArrayLike, denominator: ArrayLike) -> Estimate:
    """Return the ratio of the means of paired samples with Fieller's 95 % interval.

    NaN where the denominator's mean is not clearly positive.

    >>> a = np.array([0.9, 2.1, 2.8, 4.2, 5.1, 5.9])
    >>> ratio = fieller(a, np.arange(1.0, 7.0))
    >>> round(ratio.value, 2), ratio.low < 1.0 < ratio.high
    (1.0, True)
    """
    a, b = np.asarray(numerator, dtype=np.float64), np.asarray(denominator, dtype=np.float64)
    nan = float("nan")
    if len(a) < 2:
        return Estimate(nan, nan, nan)
    spread = np.cov(a, b) * stdtrit(len(a) - 1, 0.975) ** 2 / len(a)
    mean_a, mean_b = a.mean(), b.mean()
    # mean_b^2 - spread_bb > 0: the loss is clear, and both roots are finite.
    square = mean_b**2 - spread[1, 1]
    if not (square > 0.0 and mean_b > 0.0):
        return Estimate(nan, nan, nan)
    middle = mean_a * mean_b - spread[0, 1]
    root = np.sqrt(max(middle**2 - square * (mean_a**2 - spread[0, 0]), 0.0))
    low, high = (middle - root) / square, (middle + root) / square
    return Estimate(float(mean_a / mean_b), float(low), float(high))


def interquartile_mean(values: Floats) -> Any:
    """Return the mean of the middle half of the last axis."""
    ordered = np.sort(values, axis=-1)
    cut = ordered.shape[-1] // 4
    return ordered[..., cut : ordered.shape[-1] - cut].mean(axis=-1)


def worst_decile(values: Floats) -> Any:
    """Return the mean of the lowest tenth of the last axis, of one value at least."""
    ordered = np.sort(values, axis=-1)
    return ordered[..., : max(round(0.1 * ordered.shape[-1]), 1)].mean(axis=-1)


def improvement(differences: Floats) -> Any:
    """Return the share of positive differences in the last axis; ties count half."""
    return np.mean((differences > 0.0) + 0.5 * (differences == 0.0), axis=-1)


def bootstrap(values: Column, statistic: Callable[[Floats], Any]) -> Estimate:
    """Return a statistic of episodes with its interval over trainings and seeds."""
    if not len(values):
        return Estimate(*(float("nan"),) * 3)
    rng = np.random.default_rng(_STREAM)
    if "training" in values.index.names:
        groups = [group.to_numpy(dtype=np.float64) for _, group in values.groupby("training")]
    else:
        groups = [values.to_numpy(dtype=np.float64)]
    drawn = np.concatenate([_draw_episodes(groups, rng) for _ in groups], axis=1)
    low, high = np.quantile(statistic(drawn), [0.025, 0.975])
    return Estimate(float(statistic(np.concatenate(groups))), float(low), float(high))


def _draw_episodes(groups: list[Floats], rng: np.random.Generator) -> Floats:
    """Draw one training for each resample, and its episodes with replacement."""
    size = min(map(len, groups))
    drawn = np.empty((RESAMPLES, size))
    chosen = rng.integers(len(groups), size=RESAMPLES)
    for i, group in enumerate(groups):
        here = chosen == i
        drawn[here] = group[rng.integers(len(group), size=(int(here.sum()), size))]
    return drawn


def _units(values: Column) -> Floats:
    """Return independent values: means of trainings if there are several, else episodes."""
    if "training" in values.index.names and values.index.get_level_values("training").nunique() > 1:
        values = values.groupby("training").mean()
    found: Floats = values.to_numpy(dtype=np.float64)
    return found


def severities_of(frame: Frame) -> list[float]:
    """Return all severities at which feet other than the true ones were run."""
    return [float(severity) for severity in sorted(frame[frame["feed"] != TRUE]["severity"].unique())]


def seeds_text(seeds: Iterable[int]) -> str:
    """Return seeds in words.

    >>> seeds_text([3, 1, 2]), seeds_text([7, 3, 1, 2])
    ('1 to 3', '4 of 1 to 7')
    """
    numbers = {int(seed) for seed in seeds}
    first, last = min(numbers), max(numbers)
    text = f"{first} to {last}" if len(numbers) > 1 else f"{first}"
    return text if len(numbers) == last - first + 1 else f"{len(numbers)} of {text}"


@dataclass(frozen=True)
class HalfFall:
    """The severity at which half the episodes end in a fall, with the ends of its 95 % interval.

    Each is infinite where it lies beyond all severities that were run, from ``lowest`` to ``highest``, and
    minus infinite where below.
    """

    severity: float
    low: float
    high: float
    lowest: float
    highest: float

    def words(self) -> str:
        """Return it as a cell of a table.

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
            below = f"below {self.lowest:g}" if self.lowest > 0.0 else "more than half at 0"
            return f"above {self.highest:g}" if value > 0 else below
        return decimal(value, ".3g")


def half_fall(rows: Frame) -> HalfFall | None:
    """Return the severity at which half fall; ``None`` where fewer than two severities share seeds."""
    table = rows.pivot_table(index="seed", columns="severity", values="fell", aggfunc="mean").dropna()
    if table.shape[1] < 2 or not len(table):
        return None
    severities, fell = table.columns.to_numpy(dtype=np.float64), table.to_numpy(dtype=np.float64)
    rng = np.random.default_rng(_STREAM)
    draws = rng.integers(len(fell), size=(RESAMPLES, len(fell)))
    crossings = np.sort([_crossing(severities, fell[draw].mean(axis=0)) for draw in draws])
    # Without interpolation: there is no number between another one and infinity.
    low, high = (crossings[int(part * RESAMPLES) - k] for part, k in ((0.025, 0), (0.975, 1)))
    ends = float(severities[0]), float(severities[-1])
    return HalfFall(_crossing(severities, fell.mean(axis=0)), float(low), float(high), *ends)


def _crossing(severities: Floats, share: Floats) -> float:
    rising: Any = share if (np.diff(share) >= 0.0).all() else optimize.isotonic_regression(share).x
    if rising[-1] < 0.5:
        return float("inf")
    if rising[0] >= 0.5:
        return float("-inf") if rising[0] > 0.5 else float(severities[0])
    k = int(np.argmax(rising >= 0.5))
    part = (0.5 - rising[k - 1]) / (rising[k] - rising[k - 1])
    return float(severities[k - 1] + part * (severities[k] - severities[k - 1]))
