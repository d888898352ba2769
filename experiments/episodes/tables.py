"""Tables of both presets: means and shares over episodes, and differences of runs."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from surefoot.experiments.episodes.comparisons import Difference
from surefoot.experiments.episodes.scores import controllers_of, half_fall, same_seeds, won_back
from surefoot.experiments.policy.controllers import labels
from surefoot.experiments.study.figures import in_order, short_label
from surefoot.experiments.study.statistics import fall_share
from surefoot.experiments.study.tables import (
    Column,
    Frame,
    Table,
    Verdict,
    interval_text,
    number,
    plural,
    with_interval,
)

__all__ = ["difference_table", "failure_table", "half_table", "outcome_table", "score_table", "worst_table"]

FEW_FALLS = 5
"""Falls below which the mean time to fall has no interval worth the name."""

MOST_FAILURES = 50
"""Failed episodes that are listed."""

Cell = Callable[[Frame], str]
"""Makes one cell of a table of the rows that it is about."""

_OUTCOMES: Mapping[str, Cell] = {
    "episodes": lambda runs: str(len(runs)),
    "fell (%)": lambda runs: "{:.0f} ({:.0f} to {:.0f})".format(
        *(100 * x for x in fall_share(runs["fell"])[:3])
    ),
    "on its feet (s)": lambda runs: with_interval(runs["time"]),
    "return": lambda runs: with_interval(runs["return"], digits=4),
    "CoP error fed back (mm)": lambda runs: with_interval(runs["cop_error"], 1e3),
    "CoP off its plan (mm)": lambda runs: with_interval(runs["tracking"], 1e3),
}

_WHICH: Mapping[str, Callable[[Any], str]] = {
    "case": lambda row: str(row["case"]),
    "controller": lambda row: row["controller"],
    "feed": lambda row: short_label(row["feed"]),
    "scenario": lambda row: row["scenario"],
    "severity": lambda row: f"{row['severity']:g}",
    "seed": lambda row: str(row["seed"]),
}


def score_table(frame: Frame, name: str = "policy", title: str = "Feet of different kinds") -> Table:
    """Return the scores of an evaluation: a row for each controller, feed, input and severity.

    Args:
        frame: Rows of the study. Where there is but one controller, it has no column.
        name: Of the table.
        title: Of the table.
    """
    if same_seeds(frame):
        means = f"Means of {frame['seed'].nunique()} paired episodes"
    else:
        means = "Means of as many episodes as 'falls' says, not of the same seeds in all rows,"
    controllers = controllers_of(frame)
    brief, several = labels(controllers), len(controllers) > 1
    rows = []
    for who in controllers:
        own = frame[frame["controller"] == who]
        for (feed, cop_input, severity), runs in own.groupby(["feed", "cop_input", "severity"], sort=False):
            share = won_back(own, feed, severity)
            row = (
                feed if cop_input == "given" else f"{feed}, {cop_input}",
                _severity(feed, severity),
                with_interval(runs["return"], digits=4),
                "" if share is None else "{:.1f} % ({:.0f} to {:.0f})".format(*(100 * x for x in share)),
                f"{int(runs['fell'].sum())} of {len(runs)}",
                _times_to_fall(runs.loc[runs["fell"].astype(bool), "time"]),
                with_interval(runs["cop_error"], 1e3),
                with_interval(runs["tracking"], 1e3),
            )
            rows.append((brief[who], *row) if several else row)
    columns = (
        *("controller",) * several,
        "CoP fed back",
        "severity",
        "return",
        "loss won back",
        "falls",
        "time to fall / s",
        "CoP error / mm",
        "tracking error / mm",
    )
    note = (
        f"{means} with 95 % intervals; 'loss won back' only where drifting feet cost something beyond the "
        f"interval; of fewer than {FEW_FALLS} falls the shortest and the longest time."
    )
    return Table(name, title, columns, tuple(rows), note)


def outcome_table(rows: Frame, scenario: str, title: str) -> Table:
    """Return what came of one scenario of a sweep: a row a controller, feed and severity."""
    part = rows[rows["scenario"] == scenario]
    names = labels(controllers_of(rows))
    lines = [
        (
            names[controller],
            short_label(feed),
            _severity(feed, severity),
            *(cell(runs) for cell in _OUTCOMES.values()),
        )
        for controller, feed, own in _pairs(part)
        for severity, runs in own.groupby("severity")
    ]
    note = (
        "Means over episodes with 95 % intervals (Student t; falls: Wilson). Times count up to the end of "
        "the episode for those that stood. Errors are rms of an episode from where the controller is asked."
    )
    return Table(
        f"outcome_{scenario}", title, ("controller", "feed", "severity", *_OUTCOMES), tuple(lines), note
    )


def half_table(rows: Frame, titles: Mapping[str, str]) -> Table | None:
    """Return the severities at which half fall; ``None`` where one severity alone was run."""
    names = labels(controllers_of(rows))
    found = [
        (title, names[controller], short_label(feed), half_fall(runs))
        for scenario, title in titles.items()
        for controller, feed, runs in _pairs(rows[(rows["scenario"] == scenario) & (rows["feed"] != "true")])
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
    """Return the worst episodes, with whole names: those who did not come last are not there."""
    lines = tuple(
        (
            *(cell(row) for cell in _WHICH.values()),
            number(row["time"]),
            Verdict.of(not row["fell"], "yes" if row["fell"] else "no"),
            number(row["return"], 4),
        )
        for row in worst.to_dict("records")
    )
    columns = (*_WHICH, "on its feet (s)", "fell", "return")
    return Table("worst", "The worst episodes: the earliest falls, then the lowest returns", columns, lines)


def failure_table(failed: Frame) -> Table | None:
    """Return the episodes that could not be run through, with the last line of what was raised."""
    if not len(failed):
        return None
    lines = tuple(
        (*(cell(row) for cell in _WHICH.values()), row["error"].splitlines()[-1])
        for row in failed.head(MOST_FAILURES).to_dict("records")
    )
    note = "The whole text is in the column 'error' of episodes.parquet."
    if len(failed) > len(lines):
        note = f"{len(failed) - len(lines)} more are left out here. {note}"
    title = f"{plural(len(failed), 'episode')} failed"
    return Table("failed", title, (*_WHICH, "raised"), lines, note)


def difference_table(found: Sequence[Difference], name: str, title: str) -> Table:
    """Return differences of runs; a clear one is good or bad where its first side is to be the better one."""
    brief = labels(list(dict.fromkeys(one.controller for one in found)))
    rows = tuple(
        (
            brief[one.controller],
            one.what,
            "–" if one.severity is None else f"{one.severity:g}",
            interval_text(one.interval),
            str(one.interval.n),
            one.clear,
        )
        for one in found
    )
    note = (
        "Means of differences between episodes of the same seed, over as many seeds as both have, with 95 % "
        "intervals (Student t); clear: the interval leaves zero out. That happens by chance to one in twenty "
        f"differences that are nothing, and these are {len(rows)}."
    )
    columns = ("controller", "difference", "severity", "return", "seeds", "clear")
    return Table(name, title, columns, rows, note)


def _severity(feed: Any, severity: Any) -> str:
    return "–" if feed == "true" else f"{severity:g}"


def _times_to_fall(times: Column) -> str:
    """Return a mean with its interval, or of few falls the shortest and the longest."""
    if len(times) >= FEW_FALLS or len(times) < 2:
        return with_interval(times)
    return f"{number(times.min(), 3)} to {number(times.max(), 3)}"


def _pairs(rows: Frame) -> list[tuple[str, str, Frame]]:
    """Return the rows of each controller, in the order of the plan, and feed, in that of all figures."""
    return [
        (controller, feed, own[own["feed"] == feed])
        for controller in controllers_of(rows.sort_values("case"))
        for own in [rows[rows["controller"] == controller]]
        for feed in in_order(own["feed"])
    ]
