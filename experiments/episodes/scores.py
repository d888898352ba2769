"""Numbers of a study's rows: paired differences, losses won back, the severity at which half fall.

Differences are feet against feet, acting against nobody, and whether domain randomisation is enough: {trained
clean, trained randomised} x {drifting, calibrated}. Pairs that were not run are left out.

A difference is *clear* if its 95 % interval leaves zero out.

**The share of a loss that is won back** is that of means over the seeds in common; its interval is a
bootstrap over these seeds. It cannot be told where drifting feet do not clearly cost something, nor where its
interval is wider than a hundred percent to either side.

**The severity at which half fall** is where the share of falls crosses one half, linearly between the
severities that were run, once it is made not to decrease (isotonic regression); its 95 % interval is that of
2,000 resamples of the seeds, which are paired over severities. An end of it may lie beyond the severities
that were run.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize

from surefoot.arrays import Floats
from surefoot.experiments.study.figures import short_label
from surefoot.experiments.study.page import Words
from surefoot.experiments.study.statistics import Interval, mean_interval
from surefoot.experiments.study.tables import Column, Frame, Verdict, decimal

_SHARE_RESAMPLES = 4000  # bootstrap samples of the seeds behind a share that is won back
_CROSSING_RESAMPLES = 2000  # resamples of the seeds behind the severity at which half fall
_STREAM = 0x5EED  # seed of these resamples
WIDEST = 2.0  # a share whose interval is wider than this is not reported


class Run(NamedTuple):
    """Episodes that differ by nothing but severity and seed; there may be but one controller."""

    feed: str
    controller: str | None = None


def controllers_of(frame: Frame) -> list[str]:
    """Return each controller once, as they come."""
    return list(dict.fromkeys(frame["controller"]))


def severities_of(frame: Frame) -> list[float]:
    """Return all severities at which feet other than the true ones were run."""
    return [float(severity) for severity in sorted(frame[frame["feed"] != "true"]["severity"].unique())]


def seeds_text(seeds: Iterable[int]) -> str:
    """Return seeds in words.

    >>> seeds_text([3, 1, 2]), seeds_text([7, 3, 1, 2])
    ('1 to 3', '4 of 1 to 7')
    """
    numbers = {int(seed) for seed in seeds}
    first, last = min(numbers), max(numbers)
    text = f"{first} to {last}" if len(numbers) > 1 else f"{first}"
    return text if len(numbers) == last - first + 1 else f"{len(numbers)} of {text}"


def same_seeds(frame: Frame) -> bool:
    """Return whether all runs are of the same seeds."""
    seeds = frame.groupby(["controller", "feed", "severity"], sort=False)["seed"]
    return len({frozenset(of) for _, of in seeds}) <= 1


def difference(frame: Frame, first: Run, second: Run, severity: float | None = None) -> Interval | None:
    """Return first less second of returns over the seeds of both, ``None`` if there are none."""
    a, b = (_returns(frame, run, severity) for run in (first, second))
    both = a.index.intersection(b.index)
    return None if both.empty else mean_interval(a[both].to_numpy() - b[both].to_numpy())


class Recovery(NamedTuple):
    """The share of a controller's loss on drifting feet that a feed wins back, with its 95 % interval."""

    share: float
    low: float
    high: float
    loss: Interval  # in return; the share is NaN unless it is clear

    @property
    def narrow(self) -> bool:
        """Whether the interval is narrow enough for the share to say anything."""
        return self.high - self.low <= WIDEST


def recovery_share(frame: Frame, feed: str, severity: float) -> Recovery | None:
    """Return the share that a feed wins back; ``None`` if it is no calibration, or 'true' or 'none' lack."""
    if feed in ("true", "none"):
        return None
    runs = [_returns(frame, Run(name), severity) for name in (feed, "none", "true")]
    common = runs[0].index.intersection(runs[1].index).intersection(runs[2].index)
    own, drifting, true = (run[common].to_numpy() for run in runs)
    if common.empty:
        return None
    loss = mean_interval(true - drifting)
    if not (loss.apart and loss.mean > 0.0):
        return Recovery(*(float("nan"),) * 3, loss)
    draws = np.random.default_rng(0).integers(len(own), size=(_SHARE_RESAMPLES, len(own)))
    won: Floats = (own - drifting)[draws].mean(axis=1) / (true - drifting)[draws].mean(axis=1)
    low, high = np.quantile(won, [0.025, 0.975])
    return Recovery(float((own - drifting).mean() / (true - drifting).mean()), float(low), float(high), loss)


def _returns(frame: Frame, run: Run, severity: float | None) -> Column:
    wanted = frame["feed"] == run.feed
    if run.controller is not None:
        wanted &= frame["controller"] == run.controller
    # The true feet know no severity: they are run once.
    if severity is not None and run.feed != "true":
        wanted &= frame["severity"] == severity
    found = frame[wanted].set_index("seed")["return"].sort_index()
    if not found.index.is_unique:
        raise ValueError(
            f"Feed '{run.feed}' was run more than once with the same seed; name a severity and a controller."
        )
    return found


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
    draws = rng.integers(len(fell), size=(_CROSSING_RESAMPLES, len(fell)))
    crossings = np.sort([_crossing(severities, fell[draw].mean(axis=0)) for draw in draws])
    # Without interpolation: between a number and infinity lies none.
    low, high = (crossings[int(part * _CROSSING_RESAMPLES) - k] for part, k in ((0.025, 0), (0.975, 1)))
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


_say = Words("episodes")

CALIBRATED = "moment"  # the feed that is compared with the others
NOBODY = "zero"  # the controller that does nothing

_PAIRS = (
    ("true", "none", "true less drifting"),
    (CALIBRATED, "none", "moment less drifting"),
    (CALIBRATED, "window", "moment less window"),
    (CALIBRATED, "quasi-static", "moment less quasi-static"),
    (CALIBRATED, "weights", "moment less weights"),
    ("true", CALIBRATED, "true less moment"),
)


@dataclass(frozen=True)
class Difference:
    """Two runs of the same seeds."""

    controller: str  # who acted in the first
    what: str  # which is taken from which, in words
    severity: float | None  # ``None`` where all feet are true
    interval: Interval  # first less second, in return
    judged: bool = True  # whether more is better: what true feet are ahead by is a cost, and no merit

    @property
    def clear(self) -> str:
        """Whether the difference is clear; where it is judged, with whether that is good."""
        if not (self.interval.apart and self.judged):
            return "yes" if self.interval.apart else "no"
        return Verdict.of(self.interval.mean > 0.0, "yes")


Pair = tuple[Run, Run, str, float | None, bool]  # two runs, in words, severity, whether more is better


def _feeds(frame: Frame, who: str) -> Iterator[Pair]:
    """Pair the feeds of a controller that looks at them, at each severity."""
    for first, second, what in _PAIRS if who != NOBODY else ():
        for severity in severities_of(frame):
            yield Run(first, who), Run(second, who), what, severity, first != "true"


def _acting(frame: Frame, who: str) -> Iterator[Pair]:
    """Pair a controller with nobody, who looks at no feed: he is run on the true one, once."""
    for feed in dict.fromkeys(frame["feed"]) if who != NOBODY else ():
        what = f"{'drifting' if feed == 'none' else short_label(feed)} less nobody"
        for severity in severities_of(frame) if feed != "true" else [None]:
            yield Run(feed, who), Run("true", NOBODY), what, severity, True


def trainings(frame: Frame) -> tuple[str, str] | None:
    """Return the first policy of each training, on true feet and on randomised sensors, if both were run."""
    found = dict(zip(frame["trained"][::-1], frame["controller"][::-1], strict=True))
    return (found["true"], found["randomised"]) if {"true", "randomised"} <= found.keys() else None


def _randomisation(frame: Frame, who: str) -> Iterator[Pair]:
    """Pair the gain of training on randomised sensors with that of calibration, at each severity."""
    pair = trainings(frame)
    if pair is None or who != pair[1]:
        return
    (clean, calibrated), (wild, both) = ((Run("none", name), Run(CALIBRATED, name)) for name in pair)
    for severity in severities_of(frame):
        for first, second, what in (
            (wild, clean, "randomised less clean, both drifting"),
            (calibrated, clean, "calibrated less drifting, both clean"),
            (calibrated, wild, "calibration alone less randomisation alone"),
            (both, calibrated, "both together less calibration alone"),
            (both, wild, "both together less randomisation alone"),
        ):
            yield first, second, what, severity, True
    yield Run("true", pair[1]), Run("true", pair[0]), "both on true feet", None, True


@dataclass(frozen=True)
class Comparison:
    """A kind of differences: one table, one figure and one section of a page."""

    name: str
    table: str
    title: str
    text: tuple[str, ...]
    pairs: Callable[[Frame, str], Iterator[Pair]]

    def find(self, frame: Frame) -> list[Difference]:
        """Return the differences in the rows of a study."""
        return [
            Difference(first.controller or who, what, severity, interval, judged)
            for who in controllers_of(frame)
            for first, second, what, severity, judged in self.pairs(frame, who)
            if (interval := difference(frame, first, second, severity)) is not None
        ]


COMPARISONS = (
    Comparison("differences", "Paired differences of returns", "Feet against feet", (), _feeds),
    Comparison("nobody", "What acting is worth", "Is acting worth it?", (_say("nobody"),), _acting),
    Comparison(
        "randomisation_differences",
        "What randomisation and calibration are worth",
        "Is domain randomisation enough?",
        (_say("randomisation"),),
        _randomisation,
    ),
)
"""All comparisons, in the order of the page."""
