"""Is domain randomisation enough? {trained clean, trained randomised} x {drifting, calibrated}."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from surefoot.experiments.policy.comparison import CALIBRATED, difference, severities_of
from surefoot.experiments.policy.scores import Run, controllers_of, paired_difference
from surefoot.experiments.study.statistics import Interval, mean_interval
from surefoot.experiments.study.tables import Frame, Table, interval_text

__all__ = ["BETTER", "UNCLEAR", "WORSE", "Answer", "answers", "gap_table", "trainings", "two_by_two"]

BETTER, UNCLEAR, WORSE = "clearly better than", "not clearly different from", "clearly worse than"
"""What both together may be, held against either alone, as far as an interval tells."""


class Answer(NamedTuple):
    """What randomisation and calibration are worth at one severity; paired differences of returns.

    Attributes:
        severity: Of the sensors.
        seeds: Those that all four were run with: all differences are over these.
        randomisation: Randomised less clean, both drifting.
        calibration: Calibrated less drifting, both clean.
        choice: Clean on calibrated feet less randomised on drifting ones.
        on_calibration: Both together less calibration alone.
        on_randomisation: Both together less randomisation alone.
    """

    severity: float
    seeds: frozenset[int]
    randomisation: Interval
    calibration: Interval
    choice: Interval
    on_calibration: Interval
    on_randomisation: Interval

    @property
    def both(self) -> str:
        """What both together are, held against either alone, as far as the intervals tell."""
        first, second = _verdict(self.on_calibration), _verdict(self.on_randomisation)
        if first == second:
            return f"{first} either alone"
        return f"{first} calibration alone and {second} randomisation alone"

    @property
    def deciding(self) -> tuple[str, Interval]:
        """What both together are held against, and the difference, that decides whether they are worse.

        Worse than nothing is a difference whose interval ends below zero: the one that ends lowest.
        """
        gaps = {"calibration": self.on_calibration, "randomisation": self.on_randomisation}
        # One episode has no interval, and decides nothing.
        ends = {name: gap.mean + gap.half if gap.n > 1 else float("inf") for name, gap in gaps.items()}
        lowest = min(ends, key=ends.__getitem__)
        return lowest, gaps[lowest]

    @property
    def worse(self) -> bool:
        """Whether both together are clearly worse than one alone."""
        return _verdict(self.deciding[1]) == WORSE

    @property
    def enough(self) -> str:
        """Whether randomisation is enough, as far as the interval tells."""
        if not self.choice.apart:
            return "cannot be told from calibration alone"
        return "is not enough" if self.choice.mean > 0.0 else "is enough"

    def words(self) -> str:
        """Say both with their numbers."""
        return (
            f"Severity {self.severity:g}, by these two policies: randomisation {self.enough}: calibration "
            f"alone returns {_more(self.choice)} than it. On drifting feet it returns "
            f"{_more(self.randomisation)} than clean training; the policy that was trained clean returns "
            f"{_more(self.calibration)} calibrated than drifting. Both together are {self.both}: they return "
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
        felt = frame[(frame["cop_input"] == "felt") & (frame["severity"] == severity)]
        ran = [
            set(felt[(felt["feed"] == feed) & (felt["controller"] == who)]["seed"])
            for feed in ("none", CALIBRATED)
            for who in (clean, randomised)
        ]
        if seeds := frozenset(int(seed) for seed in set.intersection(*ran)):
            common = felt[felt["seed"].isin(seeds)]
            gaps = [paired_difference(common, *pair, severity) for pair in pairs]
            found.append(Answer(severity, seeds, *gaps))
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
    true = felt[felt["feed"] == "true"]
    on_true = set.intersection(*(set(true[true["controller"] == who]["seed"]) for who in (clean, randomised)))
    cells = [(feed, answer) for answer in found for feed in ("none", CALIBRATED)]
    rows = []
    for what, controller in (("true feet", clean), ("randomised feet", randomised)):
        own = felt[felt["controller"] == controller]
        row = [mean_interval(own[(own["feed"] == "true") & own["seed"].isin(on_true)]["total"])]
        for feed, answer in cells:
            cell = own[(own["feed"] == feed) & (own["severity"] == answer.severity)]
            row.append(mean_interval(cell[cell["seed"].isin(answer.seeds)]["total"]))
        rows.append((what, *(interval_text(cell, digits=4) for cell in row)))
    headings = [
        f"{'drifting' if feed == 'none' else 'calibrated'}, {answer.severity:g}" for feed, answer in cells
    ]
    return Table(
        "randomisation",
        "Return by what the policy was trained on, and what it is given",
        ("trained on", "true feet", *headings),
        tuple(rows),
        "Means with 95 % intervals; numbers beside drifting and calibrated are severities. "
        f"{_seeds(found)}; true feet: {len(on_true)} that both policies have.",
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
        f"Means over the same seeds with 95 % intervals (Student t). {_seeds(found)}.",
    )


def _seeds(found: Sequence[Answer]) -> str:
    counts = ", ".join(f"{len(answer.seeds)} at severity {answer.severity:g}" for answer in found)
    return f"Seeds that all four have: {counts}"


def _verdict(gap: Interval) -> str:
    if not gap.apart:
        return UNCLEAR
    return BETTER if gap.mean > 0.0 else WORSE


def _more(gap: Interval) -> str:
    size = interval_text(Interval(abs(gap.mean), gap.half, gap.n))
    return f"{size} {'more' if gap.mean >= 0.0 else 'less'}"
