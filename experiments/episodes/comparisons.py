"""Differences between the episodes of an evaluation, paired by seed; pairs that were not run are left out.

Feet against feet, acting against nobody, the own feet against another input, and whether domain randomisation
is enough: {trained clean, trained randomised} x {drifting, calibrated}.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from surefoot.experiments.episodes.scores import Run, controllers_of, difference, severities_of
from surefoot.experiments.study.figures import short_label
from surefoot.experiments.study.page import Words
from surefoot.experiments.study.statistics import Interval
from surefoot.experiments.study.tables import Frame, Verdict

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
            yield Run(first, "given", who), Run(second, "given", who), what, severity, first != "true"


def _acting(frame: Frame, who: str) -> Iterator[Pair]:
    """Pair a controller with nobody, who looks at no feed: he is run on the true one, once."""
    for feed in dict.fromkeys(frame["feed"]) if who != NOBODY else ():
        what = f"{'drifting' if feed == 'none' else short_label(feed)} less nobody"
        for severity in severities_of(frame) if feed != "true" else [None]:
            yield Run(feed, "given", who), Run("true", "given", NOBODY), what, severity, True


def _inputs(frame: Frame, who: str) -> Iterator[Pair]:
    """Pair a controller's inputs on the true feet with other inputs."""
    for other in ("frozen", "swapped", "shuffled"):
        yield Run("true", "given", who), Run("true", other, who), f"given less {other}", None, False


def trainings(frame: Frame) -> tuple[str, str] | None:
    """Return the first policy of each training, on true feet and on randomised sensors, if both were run."""
    trained = frame["trained"] if "trained" in frame else frame["controller"].map(lambda _: "")
    found = dict(zip(trained[::-1], frame["controller"][::-1], strict=True))
    return (found["true"], found["randomised"]) if {"true", "randomised"} <= found.keys() else None


def _randomisation(frame: Frame, who: str) -> Iterator[Pair]:
    """Pair the gain of training on randomised sensors with that of calibration, at each severity."""
    pair = trainings(frame)
    if pair is None or who != pair[1]:
        return
    (clean, calibrated), (wild, both) = (
        (Run("none", "given", name), Run(CALIBRATED, "given", name)) for name in pair
    )
    for severity in severities_of(frame):
        for first, second, what in (
            (wild, clean, "randomised less clean, both drifting"),
            (calibrated, clean, "calibrated less drifting, both clean"),
            (calibrated, wild, "calibration alone less randomisation alone"),
            (both, calibrated, "both together less calibration alone"),
            (both, wild, "both together less randomisation alone"),
        ):
            yield first, second, what, severity, True
    yield Run("true", "given", pair[1]), Run("true", "given", pair[0]), "both on true feet", None, True


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
    Comparison("inputs", "What another CoP costs", "Is the CoP used?", (_say("inputs"),), _inputs),
    Comparison(
        "randomisation_differences",
        "What randomisation and calibration are worth",
        "Is domain randomisation enough?",
        (_say("randomisation"),),
        _randomisation,
    ),
)
"""All comparisons, in the order of the page."""
