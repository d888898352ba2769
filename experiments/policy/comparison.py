"""Differences between the episodes of an evaluation, paired by seed; what was not run is left out.

A difference is *clear* if its 95 % interval leaves zero out.
"""

from typing import NamedTuple

from surefoot.experiments.policy.controllers import labels
from surefoot.experiments.policy.scores import Run, controllers_of, paired_difference
from surefoot.experiments.study.figures import short_label
from surefoot.experiments.study.statistics import Interval
from surefoot.experiments.study.tables import Frame, Table, interval_text

__all__ = [
    "CALIBRATED",
    "NOBODY",
    "Difference",
    "difference",
    "difference_table",
    "differences",
    "input_differences",
    "nobody_differences",
    "severities_of",
]

CALIBRATED = "moment"
"""The feed that is held against the others."""

NOBODY = "zero"
"""The controller that does nothing."""

_PAIRS = (
    ("true", "none", "true less drifting"),
    (CALIBRATED, "none", "moment less drifting"),
    (CALIBRATED, "window", "moment less window"),
    (CALIBRATED, "quasi-static", "moment less Han"),
    (CALIBRATED, "bench", "moment less bench"),
    ("true", CALIBRATED, "true less moment"),
)

_INPUTS = ("frozen", "swapped", "shuffled")


class Difference(NamedTuple):
    """Two runs of the same seeds.

    Attributes:
        controller: Who acted in the first.
        what: Which is taken from which, in words.
        severity: Of the sensors; NaN where all feet are true.
        interval: First less second, in return.
    """

    controller: str
    what: str
    severity: float
    interval: Interval


def severities_of(frame: Frame) -> list[float]:
    """All severities at which feet other than the true ones were run."""
    return [float(severity) for severity in sorted(frame[frame["feed"] != "true"]["severity"].unique())]


def differences(frame: Frame) -> list[Difference]:
    """Compare feeds, for each controller that looks at them and each severity.

    Args:
        frame: Of :func:`~surefoot.experiments.policy.scores.episodes_frame`.
    """
    found = []
    for controller in controllers_of(frame):
        for first, second, what in _PAIRS if controller != NOBODY else ():
            for severity in severities_of(frame):
                runs = (Run(first, "felt", controller), Run(second, "felt", controller))
                interval = difference(frame, *runs, severity)
                if interval is not None:
                    found.append(Difference(controller, what, severity, interval))
    return found


def nobody_differences(frame: Frame) -> list[Difference]:
    """Compare each controller, on each feed and severity, with nobody acting; needs the controller ``zero``.

    Args:
        frame: Of :func:`~surefoot.experiments.policy.scores.episodes_frame`.
    """
    # Nobody looks at what is fed back, so that any feed would do: the true one is run once.
    nobody = Run("true", "felt", NOBODY)
    found = []
    for controller in controllers_of(frame):
        for feed in dict.fromkeys(frame["feed"] if controller != NOBODY else ()):
            for severity in severities_of(frame) if feed != "true" else [float("nan")]:
                interval = difference(frame, Run(feed, "felt", controller), nobody, severity)
                if interval is not None:
                    what = f"{'drifting' if feed == 'none' else short_label(feed)} less nobody"
                    found.append(Difference(controller, what, severity, interval))
    return found


def input_differences(frame: Frame) -> list[Difference]:
    """Compare what was done to the true centre of pressure with nothing done to it, for each controller."""
    found = []
    for controller in controllers_of(frame):
        for cop_input in _INPUTS:
            runs = (Run("true", "felt", controller), Run("true", cop_input, controller))
            interval = difference(frame, *runs, None)
            if interval is not None:
                found.append(Difference(controller, f"felt less {cop_input}", float("nan"), interval))
    return found


def difference_table(found: list[Difference], name: str, title: str) -> Table:
    """Lay differences out."""
    brief = labels(list(dict.fromkeys(one.controller for one in found)))
    rows = tuple(
        (
            brief[one.controller],
            one.what,
            "–" if one.severity != one.severity else f"{one.severity:g}",
            interval_text(one.interval),
            str(one.interval.n),
            "yes" if one.interval.apart else "no",
        )
        for one in found
    )
    return Table(
        name,
        title,
        ("controller", "difference", "severity", "return", "seeds", "clear"),
        rows,
        "Means of differences between episodes of the same seed, over as many seeds as both have, with 95 % "
        "intervals (Student t); clear: the interval leaves zero out. That happens by chance to one in twenty "
        f"differences that are nothing, and these are {len(rows)}.",
    )


def difference(frame: Frame, first: Run, second: Run, severity: float | None) -> Interval | None:
    """Compare two runs, see :func:`~surefoot.experiments.policy.scores.paired_difference`, where both are."""
    try:
        return paired_difference(frame, first, second, severity)
    except ValueError:
        return None
