"""Tables of both presets: means and shares over episodes, and differences of runs."""

from collections.abc import Mapping, Sequence
from math import isnan
from typing import Any

from surefoot.experiments.episodes.scores import (
    CALIBRATED,
    Difference,
    controllers_of,
    half_fall,
    recovery_share,
    same_seeds,
    severities_of,
)
from surefoot.experiments.policy.controllers import labels
from surefoot.experiments.study.figures import by_way, short_label
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
    span,
    table_of,
    with_interval,
)

FEW_FALLS = 5  # falls below which the mean time to fall has no interval worth the name


def percent_interval(share: Sequence[float]) -> str:
    """Return a share with the ends of its interval in percent.

    >>> percent_interval((0.64, 0.52, 0.75)), percent_interval((0.64, 0.52, 0.75)).value
    ('64.0 % (52 to 75)', {'percent': 64.0, 'from': 52.0, 'to': 75.0})
    """
    percent, low, high = parts = [100 * part for part in share]
    both = dict(zip(("percent", "from", "to"), parts, strict=True))
    return Valued.of(f"{percent:.1f} % ({low:.0f} to {high:.0f})", both)


def _severity(runs: Frame) -> str:
    return NOTHING if runs["feed"].iloc[0] == "true" else decimal(runs["severity"].iloc[0])


def _times_to_fall(runs: Frame) -> str:
    """Return a mean with its interval, or of few falls the shortest and the longest."""
    times: Column = runs.loc[runs["fell"].astype(bool), "time"]
    if len(times) >= FEW_FALLS or len(times) < 2:
        return with_interval(times)
    ends = {"from": times.min(), "to": times.max()}
    return Valued.of(" to ".join(map(number, ends.values())), ends)


_SCORES: Mapping[str, Cell] = {
    "falls": count_of("fell"),
    "time to fall / s": _times_to_fall,
    "CoP error / mm": mean_of("cop_error", 1e3),
    "tracking error / mm": mean_of("tracking", 1e3),
}

_WORST: Mapping[str, Cell] = {
    "case": lambda row: decimal(row["case"], "d"),
    "controller": lambda row: row["controller"],
    "feed": lambda row: short_label(row["feed"]),
    "scenario": lambda row: row["scenario"],
    "severity": lambda row: decimal(row["severity"]),
    "seed": lambda row: decimal(row["seed"], "d"),
    "on its feet (s)": lambda row: number(row["time"]),
    "fell": lambda row: Verdict.of(not row["fell"], "yes" if row["fell"] else "no"),
    "return": lambda row: number(row["return"], 4),
}


def score_table(frame: Frame, name: str = "policy", title: str = "Feet of different kinds") -> Table:
    """Return a row for each controller (named if several), feed, input and severity."""
    if same_seeds(frame):
        means = f"Means of {plural(frame['seed'].nunique(), 'paired episode')}"
    else:
        means = "Means of as many episodes as 'falls' says, not of the same seeds in all rows,"
    controllers = controllers_of(frame)
    brief = labels(controllers)
    own = {who: frame[frame["controller"] == who] for who in controllers}

    def share(runs: Frame) -> str:
        first = runs.iloc[0]
        found = recovery_share(own[first["controller"]], first["feed"], first["severity"])
        if found is None:
            return ""
        if found.narrow:
            return percent_interval(found[:3])
        if isnan(found.share):
            return Valued.of(f"cannot be told (cost {interval_text(found.loss)})", None)
        return Valued.of(f"cannot be told ({span(100 * found.low, 100 * found.high, '.0f')} %)", None)

    columns: dict[str, Cell] = {
        "controller": lambda runs: brief[runs["controller"].iloc[0]],
        "CoP fed back": lambda runs: str(runs["feed"].iloc[0]),
        "severity": _severity,
        "return": mean_of("return", digits=4),
        "loss won back": share,
        **_SCORES,
    }
    if len(controllers) < 2:
        del columns["controller"]
    keys = ["feed", "severity"]
    rows = [runs for part in own.values() for _, runs in part.groupby(keys, sort=False)]
    note = (
        f"{means} with 95 % intervals; 'loss won back' needs the feeds 'true' and 'none', and cannot be told "
        "where drifting feet cost nothing beyond the interval, or that of the share is wider than 100 % to "
        f"either side; of fewer than {FEW_FALLS} falls the shortest and the longest time."
    )
    return table_of(name, title, columns, rows, note)


def half_table(rows: Frame, titles: Mapping[str, str]) -> Table | None:
    """Return the severities at which half fall; ``None`` where one severity alone was run."""
    names = labels(controllers_of(rows))
    found: list[tuple[Any, ...]] = [
        (title, names[runs["controller"].iloc[0]], short_label(runs["feed"].iloc[0]), half_fall(runs))
        for scenario, title in titles.items()
        for runs in _pairs(rows[(rows["scenario"] == scenario) & (rows["feed"] != "true")])
    ]
    lines = tuple((*which, half.words()) for *which, half in found if half is not None)
    if not lines:
        return None
    return Table(
        "half",
        "Severity at which half the episodes end in a fall",
        ("scenario", "controller", "feed", "severity (95 % interval)"),
        lines,
        "Linear between the severities that were run, after making the share of falls not decrease; "
        "intervals from 2,000 resamples of the seeds, which are too narrow for a handful of them.",
    )


def worst_table(worst: Frame) -> Table:
    """Return the worst episodes, with full names of controllers."""
    title = "The worst episodes: the earliest falls, then the lowest returns"
    return table_of("worst", title, _WORST, worst.to_dict("records"))


def two_by_two(frame: Frame, clean: str, randomised: str) -> Table:
    """Return {trained clean, trained randomised} x {drifting, calibrated}, beside the true feet.

    Returns are means over the seeds that both policies have on the same feet.
    """
    feeds = {"true": "true feet", "none": "drifting", CALIBRATED: "calibrated"}
    columns: dict[str, Cell] = {"trained on": lambda who: who[0]}
    seeds = []
    for severity in (0.0, *severities_of(frame)):
        for feed in [feed for feed in feeds if (feed == "true") == (severity == 0.0)]:
            runs = frame[(frame["feed"] == feed) & (frame["severity"] == severity)]
            returns = runs.pivot_table(index="seed", columns="controller", values="return")
            returns = returns.reindex(columns=[clean, randomised]).dropna()
            heading = feeds[feed] + (f", {severity:g}" if severity else "")
            columns[heading] = lambda who, of=returns: with_interval(of[who[1]], digits=4)  # type: ignore[misc]
            seeds.append(f"{heading}: {len(returns)}")
    note = (
        "Means with 95 % intervals over the seeds that both policies have; numbers beside drifting and "
        f"calibrated are severities. Seeds: {', '.join(seeds)}."
    )
    title = "Return by what the policy was trained on, and what it is given"
    policies = (("true feet", clean), ("randomised feet", randomised))
    return table_of("randomisation", title, columns, policies, note)


def difference_table(found: Sequence[Difference], name: str, title: str) -> Table:
    """Return differences of runs; a clear one is good or bad where its first side is to be the better one."""
    brief = labels(list(dict.fromkeys(one.controller for one in found)))
    columns: dict[str, Cell] = {
        "controller": lambda one: brief[one.controller],
        "difference": lambda one: one.what,
        "severity": lambda one: NOTHING if one.severity is None else decimal(one.severity),
        "return": lambda one: interval_text(one.interval),
        "seeds": lambda one: decimal(one.interval.n, "d"),
        "clear": lambda one: one.clear,
    }
    note = (
        "Means of differences between episodes of the same seed, over as many seeds as both have, with 95 % "
        "intervals (Student t); clear: the interval leaves zero out. That happens by chance to one in twenty "
        f"differences that are nothing, and these are {len(found)}."
    )
    return table_of(name, title, columns, found, note)


def _pairs(rows: Frame) -> list[Frame]:
    """Return the rows of each controller, in the order of the plan, and feed, in that of all figures."""
    controllers = controllers_of(rows.sort_values("case"))
    parts = [by_way(rows[rows["controller"] == name], "feed") for name in controllers]
    return [runs for part in parts for runs in part.values()]
