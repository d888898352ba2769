"""Is domain randomisation enough? {trained clean, trained randomised} x {drifting, calibrated}."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from surefoot.experiments.episodes.comparisons import CALIBRATED
from surefoot.experiments.episodes.scores import Run, controllers_of, difference, severities_of
from surefoot.experiments.study.statistics import Interval, mean_interval
from surefoot.experiments.study.tables import Frame, Table, interval_text

BETTER, UNCLEAR, WORSE = "clearly better than", "not clearly different from", "clearly worse than"
"""How both together compare with either alone, as far as an interval tells."""

_FEEDS = {"none": "drifting", CALIBRATED: "calibrated"}  # feet that are compared

_GAPS = {
    "randomisation": "randomised less clean, both drifting",
    "calibration": "calibrated less drifting, both clean",
    "choice": "calibration alone less randomisation alone",
    "on_calibration": "both together less calibration alone",
    "on_randomisation": "both together less randomisation alone",
}


class Answer(NamedTuple):
    """What randomisation and calibration are worth at one severity, over the seeds that all four have."""

    severity: float
    seeds: frozenset[int]
    randomisation: Interval
    calibration: Interval
    choice: Interval
    on_calibration: Interval
    on_randomisation: Interval

    @property
    def both(self) -> str:
        """How both together compare with either alone, as far as the intervals tell."""
        first, second = _verdict(self.on_calibration), _verdict(self.on_randomisation)
        if first == second:
            return f"{first} either alone"
        return f"{first} calibration alone and {second} randomisation alone"

    @property
    def deciding(self) -> tuple[str, Interval]:
        """Which of the two alone decides whether both are worse: the difference that ends lowest."""
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
            return "is not clearly different from calibration alone"
        return "is not enough" if self.choice.mean > 0.0 else "is enough"

    def words(self) -> str:
        """Return both answers with their numbers."""
        return (
            f"Severity {self.severity:g}, by these two policies: randomisation {self.enough}: calibration "
            f"alone returns {_more(self.choice)} than it. On drifting feet it returns "
            f"{_more(self.randomisation)} than clean training; the policy that was trained clean returns "
            f"{_more(self.calibration)} calibrated than drifting. Both together are {self.both}: they return "
            f"{_more(self.on_calibration)} than calibration alone and {_more(self.on_randomisation)} than "
            "randomisation alone."
        )


def trainings(frame: Frame, trained: Mapping[str, str]) -> tuple[str, str] | None:
    """Return the first policy of each training, on true feet and on randomised sensors, if both were run."""
    kinds = {trained.get(name, ""): name for name in reversed(controllers_of(frame))}
    return (kinds["true"], kinds["randomised"]) if {"true", "randomised"} <= kinds.keys() else None


def answers(frame: Frame, clean: str, randomised: str) -> list[Answer]:
    """Return what randomisation and calibration are worth, at each severity at which all four were run."""
    runs = {(feed, who): Run(feed, "given", who) for feed in _FEEDS for who in (clean, randomised)}
    pairs = (
        (runs["none", randomised], runs["none", clean]),
        (runs[CALIBRATED, clean], runs["none", clean]),
        (runs[CALIBRATED, clean], runs["none", randomised]),
        (runs[CALIBRATED, randomised], runs[CALIBRATED, clean]),
        (runs[CALIBRATED, randomised], runs["none", randomised]),
    )
    found = []
    for severity in severities_of(frame):
        part = frame[(frame["cop_input"] == "given") & (frame["severity"] == severity)]
        ran = part.groupby(["feed", "controller"])["seed"].apply(set)
        seeds = frozenset(map(int, set.intersection(*(ran.get(pair, set()) for pair in runs))))
        if seeds:
            common = part[part["seed"].isin(seeds)]
            gaps = [difference(common, *pair, severity) for pair in pairs]
            found.append(Answer(severity, seeds, *(gap for gap in gaps if gap is not None)))
    return found


def two_by_two(frame: Frame, clean: str, randomised: str, found: Sequence[Answer]) -> Table:
    """Return {trained clean, trained randomised} x {drifting, calibrated}, beside the true feet."""
    given = frame[frame["cop_input"] == "given"]
    true = given[given["feed"] == "true"]
    on_true = set.intersection(*(set(true[true["controller"] == who]["seed"]) for who in (clean, randomised)))
    cells = [("true", 0.0, on_true)]
    cells += [(feed, answer.severity, set(answer.seeds)) for answer in found for feed in _FEEDS]
    rows = []
    for what, controller in (("true feet", clean), ("randomised feet", randomised)):
        row, own = [what], given[given["controller"] == controller]
        for feed, severity, seeds in cells:
            runs = own[(own["feed"] == feed) & (own["severity"] == severity) & own["seed"].isin(seeds)]
            row.append(interval_text(mean_interval(runs["return"]), digits=4))
        rows.append(tuple(row))
    headings = [f"{_FEEDS[feed]}, {severity:g}" for feed, severity, _ in cells[1:]]
    return Table(
        "randomisation",
        "Return by what the policy was trained on, and what it is given",
        ("trained on", "true feet", *headings),
        tuple(rows),
        "Means with 95 % intervals; numbers beside drifting and calibrated are severities. "
        f"{_seeds(found)}; true feet: {len(on_true)} that both policies have.",
    )


def gap_table(frame: Frame, clean: str, randomised: str, found: Sequence[Answer]) -> Table:
    """Return what differs between the cells of :func:`two_by_two`, paired by seed; arguments as there."""
    rows = [(words, *(interval_text(getattr(one, name)) for one in found)) for name, words in _GAPS.items()]
    price = difference(frame, Run("true", "given", randomised), Run("true", "given", clean))
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
