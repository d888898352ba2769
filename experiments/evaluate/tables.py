"""Build the tables of an evaluation: scores per policy, paired differences, and worst episodes."""

from collections.abc import Iterator, Mapping
from math import isnan
from typing import Any, NamedTuple

from surefoot.experiments.evaluate.statistics import (
    NOBODY,
    RAW,
    TRUE,
    Estimate,
    Run,
    bootstrap,
    difference,
    half_fall,
    improvement,
    interquartile_mean,
    mean_over,
    pair,
    seeds_text,
    severities_of,
    share_won_back,
    worst_decile,
)
from surefoot.experiments.study.figures import by_way, in_order, short_label
from surefoot.experiments.study.statistics import Interval
from surefoot.experiments.study.tables import (
    NOTHING,
    Cell,
    Column,
    Frame,
    Table,
    Valued,
    Verdict,
    count_of,
    decimal,
    interval_text,
    mean_of,
    number,
    plural,
    sentence,
    table_of,
    with_interval,
)

FEW_FALLS = 5  # number of falls below which the range of times to fall replaces their mean
WORST = 5  # number of worst episodes in the table


class Compared(NamedTuple):
    """Two runs with the same seeds, and their difference."""

    first: Run
    second: Run
    interval: Interval  # of the difference in return, first minus second
    better: Estimate  # probability that the first run is better


def policies_of(frame: Frame) -> list[str]:
    """Return each policy once, in the order of the rows."""
    return list(dict.fromkeys(frame["policy"]))


def estimate_text(found: Estimate, factor: float = 1.0, digits: int = 3, unit: str = "") -> str:
    """Return a number with the limits of its interval.

    >>> estimate_text(Estimate(0.914, 0.78, 0.98), 100.0, 2, " %")
    '91 % (78 to 98)'
    """
    value, low, high = (factor * one for one in found)
    parts = {"value": value, "from": low, "to": high}
    return Valued.of(
        f"{number(value, digits)}{unit} ({number(low, digits)} to {number(high, digits)})", parts
    )


def trainings_text(runs: Frame) -> str:
    """Return the number of trainings and episodes of a policy in words."""
    trainings, episodes = runs["training"].nunique(), plural(runs["seed"].nunique(), "paired episode")
    seeds = f"{episodes} per feed and severity (seeds {seeds_text(runs['seed'])})"
    if trainings > 1:
        return f"{trainings} trainings, {seeds}: intervals are over trainings"
    return f"one training seed, {seeds}: intervals say nothing about another training"


def score_table(frame: Frame, name: str = "scores_0", title: str = "") -> Table:
    """Return the scores of one policy, with one row per feed and severity."""

    def recovery(runs: Frame) -> str:
        found = share_won_back(frame, _run_of(runs))
        if found is None:
            return ""
        if isnan(found.value):
            return Valued.of("loss not clear", None)
        return estimate_text(found, 100.0, 2, " %")

    def mean_return(runs: Frame) -> str:
        return interval_text(mean_over(_episodes(runs)), digits=4)

    columns: dict[str, Cell] = {
        "feed": lambda runs: short_label(runs["feed"].iloc[0]),
        "severity": lambda runs: (
            NOTHING if runs["feed"].iloc[0] == TRUE else decimal(runs["severity"].iloc[0])
        ),
        "return": mean_return,
        "loss won back": recovery,
        "falls": count_of("fell"),
        "time to fall / s": _times_to_fall,
        "interquartile mean": lambda runs: estimate_text(
            bootstrap(_episodes(runs), interquartile_mean), digits=4
        ),
        "worst decile": lambda runs: estimate_text(bootstrap(_episodes(runs), worst_decile), digits=4),
        "CoP error / mm": mean_of("cop_error", 1e3),
    }
    rows = [runs for part in by_way(frame, "feed").values() for _, runs in part.groupby("severity")]
    note = (
        f"{sentence(trainings_text(frame))}. 95 % intervals: of means Student's t, of the loss won back "
        "Fieller's, of interquartile mean and worst decile (mean of the lowest tenth) a bootstrap. 'loss won "
        f"back' is of what raw readings lose; of fewer than {FEW_FALLS} falls the shortest and the longest "
        "time is given."
    )
    return table_of(name, title or str(frame["policy"].iloc[0]), columns, rows, note)


def _run_of(runs: Frame) -> Run:
    first = runs.iloc[0]
    return Run(first["policy"], first["feed"], float(first["severity"]))


def _episodes(runs: Frame) -> Column:
    return runs.set_index(["training", "seed"])["return"]


def _times_to_fall(runs: Frame) -> str:
    """Return the mean with its interval, or the shortest and the longest time if there are few falls."""
    times: Column = runs.loc[runs["fell"].astype(bool), "time"]
    if len(times) >= FEW_FALLS or len(times) < 2:
        return with_interval(times)
    ends = {"from": times.min(), "to": times.max()}
    return Valued.of(" to ".join(map(number, ends.values())), ends)


def between_feeds(frame: Frame) -> Iterator[Compared]:
    """Compare each feed of each policy with raw and with true readings, at each severity."""
    for policy in policies_of(frame):
        feeds = in_order(frame[frame["policy"] == policy]["feed"])
        for base in (RAW, TRUE):
            for feed in feeds if base in feeds else ():
                if feed not in (TRUE, base):
                    for severity in severities_of(frame):
                        yield from _compare(frame, Run(policy, feed, severity), Run(policy, base, severity))


def between_policies(frame: Frame) -> Iterator[Compared]:
    """Compare each policy with the first one, or with a robot that does not act, on each feed."""
    policies = policies_of(frame)
    base = NOBODY if NOBODY in policies else policies[0]
    for policy in policies:
        for feed in in_order(frame["feed"]) if policy != base else ():
            for severity in severities_of(frame) if feed != TRUE else [0.0]:
                # A robot that does not act ignores the feed, so its true episodes represent all feeds.
                own = base != NOBODY or len(frame[(frame["policy"] == base) & (frame["feed"] == feed)])
                other = Run(base, feed, severity) if own and feed != TRUE else Run(base, TRUE, 0.0)
                yield from _compare(frame, Run(policy, feed, severity), other)


def _compare(frame: Frame, first: Run, second: Run) -> Iterator[Compared]:
    interval = difference(frame, first, second)
    if interval is not None:
        a, b = pair(frame, first, second)
        yield Compared(first, second, interval, bootstrap(a - b, improvement))


def difference_table(found: list[Compared], name: str, title: str) -> Table:
    """Return the paired differences. A clear difference is good if the first run is better."""

    def what(one: Compared) -> str:
        sides = [short_label(run.feed) for run in one[:2]]
        if one.first.policy != one.second.policy:
            sides = [f"{run.policy} ({feed})" for run, feed in zip(one[:2], sides, strict=True)]
        return " less ".join(sides)

    def clear(one: Compared) -> str:
        # The lead of true readings is the cost of the sensors, so it is not marked as good or bad.
        cost = one.second.feed == TRUE and one.first.policy == one.second.policy
        if cost or not one.interval.apart:
            return "yes" if one.interval.apart else "no"
        return Verdict.of(one.interval.mean > 0.0, "yes")

    columns: dict[str, Cell] = {
        "policy": lambda one: one.first.policy,
        "difference": what,
        "severity": lambda one: NOTHING if one.first.feed == TRUE else decimal(one.first.severity),
        "return": lambda one: interval_text(one.interval),
        "better in": lambda one: estimate_text(one.better, 100.0, 2, " %"),
        "clear": clear,
    }
    note = (
        "Means of differences between episodes of the same seed with 95 % intervals (Student t), and the "
        "share of episodes in which the first is better (ties half; bootstrap). Clear: the interval leaves "
        "zero out, which happens by chance to one in twenty differences that are nothing; these are "
        f"{len(found)}."
    )
    return table_of(name, title, columns, found, note)


def returns_table(frame: Frame) -> Table:
    """Return the mean returns of all policies, with one column per feed and severity."""
    columns: dict[str, Cell] = {"policy": lambda policy: str(policy)}
    kinds = [
        (feed, s)
        for feed in in_order(frame["feed"])
        for s in (severities_of(frame) if feed != TRUE else [0.0])
    ]
    for feed, severity in kinds:
        heading = short_label(feed) + (f", {severity:g}" if feed != TRUE else "")
        part = frame[(frame["feed"] == feed) & (frame["severity"] == severity)]

        def cell(policy: str, part: Frame = part) -> str:
            return interval_text(mean_over(_episodes(part[part["policy"] == policy])), digits=4)

        columns[heading] = cell
    note = (
        "Means with 95 % intervals (Student t), over trainings where there are several, else over episodes."
    )
    return table_of(
        "returns", "Return of each policy by feed and severity", columns, policies_of(frame), note
    )


def half_table(frame: Frame) -> Table | None:
    """Return the severity at which half of the episodes end in a fall, or ``None`` for a single severity."""
    lines = []
    for policy in policies_of(frame):
        for feed, runs in by_way(frame[frame["policy"] == policy], "feed").items():
            half = half_fall(runs) if feed != TRUE else None
            if half is not None:
                lines.append((policy, short_label(feed), half.words()))
    if not lines:
        return None
    return Table(
        "half",
        "Severity at which half the episodes end in a fall",
        ("policy", "feed", "severity (95 % interval)"),
        tuple(lines),
        "Linear between the severities that were run, after making the share of falls not decrease; "
        "intervals from 2,000 resamples of the seeds, which are too narrow for a handful of them.",
    )


def worst_of(frame: Frame) -> Frame:
    """Return the worst episodes: the earliest falls, followed by the lowest returns."""
    order = {"fell": False, "time": True, "return": True, "case": True}
    return frame.sort_values([*order], ascending=[*order.values()]).head(WORST)


_WORST: Mapping[str, Cell] = {
    "case": lambda row: decimal(row["case"], "d"),
    "policy": lambda row: row["policy"],
    "feed": lambda row: short_label(row["feed"]),
    "severity": lambda row: decimal(row["severity"]),
    "seed": lambda row: decimal(row["seed"], "d"),
    "time (s)": lambda row: number(row["time"]),
    "fell": lambda row: Verdict.of(not row["fell"], "yes" if row["fell"] else "no"),
    "return": lambda row: number(row["return"], 4),
}


def worst_table(frame: Frame) -> Table:
    """Return the table of the worst episodes."""
    rows: list[Any] = worst_of(frame).to_dict("records")
    return table_of("worst", "The worst episodes: the earliest falls, then the lowest returns", _WORST, rows)
