"""Is domain randomisation enough? {trained clean, trained randomised} x {drifting, calibrated}."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from surefoot.experiments._frames import Frame
from surefoot.experiments.policy.comparison import CALIBRATED, difference, severities_of
from surefoot.experiments.policy.scores import Run, controllers_of
from surefoot.experiments.score import Interval, mean_interval
from surefoot.experiments.tables import Table, interval_text

__all__ = ["AS_GOOD", "BETTER", "WORSE", "Answer", "answers", "gap_table", "trainings", "two_by_two"]

BETTER, AS_GOOD, WORSE = "better than either alone", "no worse than either alone", "worse than one alone"
"""What both together may be."""


class Answer(NamedTuple):
    """What randomisation and calibration are worth at one severity; paired differences of returns.

    Attributes:
        severity: Of the sensors.
        randomisation: Randomised less clean, both drifting.
        calibration: Calibrated less drifting, both clean.
        choice: Clean on calibrated feet less randomised on drifting ones.
        on_calibration: Both together less calibration alone.
        on_randomisation: Both together less randomisation alone.
    """

    severity: float
    randomisation: Interval
    calibration: Interval
    choice: Interval
    on_calibration: Interval
    on_randomisation: Interval

    @property
    def both(self) -> str:
        """Whether both together beat either alone, as far as the intervals tell."""
        gaps = (self.on_calibration, self.on_randomisation)
        if any(gap.apart and gap.mean < 0.0 for gap in gaps):
            return WORSE
        return BETTER if all(gap.apart and gap.mean > 0.0 for gap in gaps) else AS_GOOD

    @property
    def enough(self) -> str:
        """Whether randomisation is enough, as far as the interval tells."""
        if not self.choice.apart:
            return "cannot be told from calibration alone"
        return "is not enough" if self.choice.mean > 0.0 else "is enough"

    def words(self) -> str:
        """Say both with their numbers."""
        return (
            f"Severity {self.severity:g}: randomisation {self.enough}: calibration alone returns "
            f"{_more(self.choice)} than it. On drifting feet it returns {_more(self.randomisation)} than "
            f"clean training; the policy that was trained clean returns {_more(self.calibration)} "
            f"calibrated than drifting. Both together are {self.both}: they return "
            f"{_more(self.on_calibration)} than calibration alone and {_more(self.on_randomisation)} than "
            "randomisation alone."
        )


def trainings(frame: Frame, trained: Mapping[str, str]) -> tuple[str, str] | None:
    """Name the policy that was trained on true feet and the one of randomised sensors, if both were run.

    Args:
        frame: Of :func:`~surefoot.experiments.policy.scores.episodes_frame`.
        trained: What each controller was trained on; of several of a kind the first counts.
    """
    ran = controllers_of(frame)
    clean = next((name for name in ran if trained.get(name) == "true"), None)
    randomised = next((name for name in ran if trained.get(name) == "randomised"), None)
    return None if clean is None or randomised is None else (clean, randomised)


def answers(frame: Frame, clean: str, randomised: str) -> list[Answer]:
    """Compare randomisation with calibration, at each severity at which all four were run.

    Args:
        frame: Of :func:`~surefoot.experiments.policy.scores.episodes_frame`.
        clean: The policy that was trained on true feet.
        randomised: The one that was trained on randomised sensors.
    """
    found = []
    drifting, calibrated = (
        {who: Run(feed, "felt", who) for who in (clean, randomised)} for feed in ("none", CALIBRATED)
    )
    pairs = (
        (drifting[randomised], drifting[clean]),
        (calibrated[clean], drifting[clean]),
        (calibrated[clean], drifting[randomised]),
        (calibrated[randomised], calibrated[clean]),
        (calibrated[randomised], drifting[randomised]),
    )
    for severity in severities_of(frame):
        gaps = [difference(frame, *pair, severity) for pair in pairs]
        known = [gap for gap in gaps if gap is not None]
        if len(known) == len(pairs):
            found.append(Answer(severity, *known))
    return found


def two_by_two(frame: Frame, clean: str, randomised: str, found: Sequence[Answer]) -> Table:
    """Lay {trained clean, trained randomised} x {drifting, calibrated} out, beside the true feet.

    Args:
        frame: As in :func:`answers`.
        clean: Likewise.
        randomised: Likewise.
        found: What :func:`answers` found.
    """
    felt = frame[frame["cop_input"] == "felt"]
    cells = [(feed, answer.severity) for answer in found for feed in ("none", CALIBRATED)]
    rows = []
    for what, controller in (("true feet", clean), ("randomised feet", randomised)):
        own = felt[felt["controller"] == controller]
        row = [mean_interval(own[own["feed"] == "true"]["total"])]
        row += [
            mean_interval(own[(own["feed"] == feed) & (own["severity"] == severity)]["total"])
            for feed, severity in cells
        ]
        rows.append((what, *(interval_text(cell, digits=4) for cell in row)))
    headings = [f"{'drifting' if feed == 'none' else 'calibrated'}, {severity:g}" for feed, severity in cells]
    return Table(
        "randomisation",
        "Return by what the policy was trained on, and what it is given",
        ("trained on", "true feet", *headings),
        tuple(rows),
        "Means with 95 % intervals; numbers beside drifting and calibrated are severities.",
    )


def gap_table(frame: Frame, clean: str, randomised: str, found: Sequence[Answer]) -> Table:
    """Lay out what differs between the cells of :func:`two_by_two`, paired by seed.

    Args:
        frame: As in :func:`answers`.
        clean: Likewise.
        randomised: Likewise.
        found: What :func:`answers` found.
    """
    names = {
        "randomisation": "randomised less clean, both drifting",
        "calibration": "calibrated less drifting, both clean",
        "choice": "calibration alone less randomisation alone",
        "on_calibration": "both together less calibration alone",
        "on_randomisation": "both together less randomisation alone",
    }
    rows = [
        (words, *(interval_text(getattr(answer, name)) for answer in found)) for name, words in names.items()
    ]
    price = difference(frame, Run("true", "felt", randomised), Run("true", "felt", clean), None)
    if price is not None:
        rows.append(("randomised less clean, both on true feet", *[interval_text(price)] * len(found)))
    return Table(
        "randomisation_differences",
        "What randomisation and calibration are worth",
        ("difference of returns", *(f"severity {answer.severity:g}" for answer in found)),
        tuple(rows),
        "Means over the same seeds with 95 % intervals (Student t).",
    )


def _more(gap: Interval) -> str:
    size = interval_text(Interval(abs(gap.mean), gap.half, gap.n))
    return f"{size} {'more' if gap.mean >= 0.0 else 'less'}"
