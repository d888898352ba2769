"""Differences between the episodes of an evaluation, paired by seed; what was not run is left out."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from surefoot.experiments.episodes.scores import Run, controllers_of, difference, severities_of
from surefoot.experiments.study.figures import short_label
from surefoot.experiments.study.page import flat
from surefoot.experiments.study.statistics import Interval
from surefoot.experiments.study.tables import Frame, Verdict

__all__ = ["CALIBRATED", "COMPARISONS", "NOBODY", "Comparison", "Difference"]

CALIBRATED = "moment"
"""The feed that is compared with the others."""

NOBODY = "zero"
"""The controller that does nothing."""

_PAIRS = (
    ("true", "none", "true less drifting"),
    (CALIBRATED, "none", "moment less drifting"),
    (CALIBRATED, "window", "moment less window"),
    (CALIBRATED, "quasi-static", "moment less quasi-static"),
    (CALIBRATED, "weights", "moment less weights"),
    ("true", CALIBRATED, "true less moment"),
)

_INPUTS = ("frozen", "swapped", "shuffled")


@dataclass(frozen=True)
class Difference:
    """Two runs of the same seeds.

    Attributes:
        controller: Who acted in the first.
        what: Which is taken from which, in words.
        severity: Of the sensors; ``None`` where all feet are true.
        interval: First less second, in return.
        judged: Whether more is better: what true feet are ahead by is a cost, and no merit.
    """

    controller: str
    what: str
    severity: float | None
    interval: Interval
    judged: bool = True

    @property
    def clear(self) -> str:
        """Whether the difference is clear; where it is judged, with whether that is good."""
        if not (self.interval.apart and self.judged):
            return "yes" if self.interval.apart else "no"
        return Verdict.of(self.interval.mean > 0.0, "yes")


def feed_differences(frame: Frame) -> list[Difference]:
    """Return differences of feeds, for each controller that looks at them and each severity."""
    return [
        Difference(controller, what, severity, interval, judged=first != "true")
        for controller in controllers_of(frame)
        for first, second, what in _PAIRS
        if controller != NOBODY
        for severity in severities_of(frame)
        for interval in _found(
            frame, Run(first, "given", controller), Run(second, "given", controller), severity
        )
    ]


def nobody_differences(frame: Frame) -> list[Difference]:
    """Return what each controller is ahead of nobody, on each feed and severity, if nobody was run."""
    # Nobody looks at what is fed back, so that any feed would do: the true one is run once.
    nobody = Run("true", "given", NOBODY)
    return [
        Difference(
            controller,
            f"{'drifting' if feed == 'none' else short_label(feed)} less nobody",
            severity,
            interval,
        )
        for controller in controllers_of(frame)
        if controller != NOBODY
        for feed in dict.fromkeys(frame["feed"])
        for severity in (severities_of(frame) if feed != "true" else [None])
        for interval in _found(frame, Run(feed, "given", controller), nobody, severity)
    ]


def input_differences(frame: Frame) -> list[Difference]:
    """Return what another input costs each controller on the true feet."""
    return [
        Difference(controller, f"given less {cop_input}", None, interval, judged=False)
        for controller in controllers_of(frame)
        for cop_input in _INPUTS
        for interval in _found(frame, Run("true", "given", controller), Run("true", cop_input, controller))
    ]


def _found(frame: Frame, first: Run, second: Run, severity: float | None = None) -> Iterator[Interval]:
    interval = difference(frame, first, second, severity)
    if interval is not None:
        yield interval


_NOBODY = """
    Returns less those of the zero action, which leaves the robot to its pattern: who acts on wrong readings
    may do worse than nobody."""

_OTHER_INPUTS = """
    True feet, but the controller is given a CoP that is held (frozen), that of another episode (swapped), or
    that of another episode in random order (shuffled). Who uses the CoP loses by it."""


@dataclass(frozen=True)
class Comparison:
    """A kind of differences: one table, one figure and one section of a page.

    Attributes:
        name: Short name, for files.
        table: Title of the table.
        title: Title of the section.
        text: What is compared.
        find: Finds the differences in the rows of a study.
    """

    name: str
    table: str
    title: str
    text: tuple[str, ...]
    find: Callable[[Frame], list[Difference]]


COMPARISONS = (
    Comparison("differences", "Paired differences of returns", "Feet against feet", (), feed_differences),
    Comparison("nobody", "What acting is worth", "Is acting worth it?", (flat(_NOBODY),), nobody_differences),
    Comparison(
        "inputs", "What another CoP costs", "Is the CoP used?", (flat(_OTHER_INPUTS),), input_differences
    ),
)
"""All comparisons, in the order of the page."""
