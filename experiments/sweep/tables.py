"""Tables of a sweep's report."""

from surefoot.experiments.policy.controllers import labels
from surefoot.experiments.study.figures import in_order, short_label
from surefoot.experiments.study.tables import Frame, Table, number, with_interval
from surefoot.experiments.sweep.statistics import fall_share, half_fall

__all__ = ["failure_table", "half_table", "outcome_table", "worst_table"]

_KEYS = ["controller", "feed", "scenario"]
_MOST_FAILURES = 50


def outcome_table(rows: Frame, scenario: str, title: str) -> Table:
    """Lay out means and 95 % intervals of one scenario, one row a controller, feed and severity."""
    part = rows[rows["scenario"] == scenario]
    names, lines = labels(list(rows["controller"].unique())), []
    for controller, feed in _pairs(part):
        runs = part[(part["controller"] == controller) & (part["feed"] == feed)]
        for severity in sorted(runs["severity"].unique()):
            cell = runs[runs["severity"] == severity]
            share = fall_share(cell["fell"])
            lines.append(
                (
                    names[controller],
                    short_label(feed),
                    "–" if feed == "true" else f"{severity:g}",
                    str(len(cell)),
                    f"{100 * share.share:.0f} ({100 * share.low:.0f} to {100 * share.high:.0f})",
                    with_interval(cell["time"]),
                    with_interval(cell["return"], digits=4),
                    with_interval(cell["cop_error"], 1e3),
                    with_interval(cell["cop_tracking"], 1e3),
                )
            )
    return Table(
        f"outcome_{scenario}",
        title,
        (
            "controller",
            "feed",
            "severity",
            "episodes",
            "fell (%)",
            "on its feet (s)",
            "return",
            "CoP error fed back (mm)",
            "CoP off its plan (mm)",
        ),
        tuple(lines),
        "Means over episodes with 95 % intervals (Student t; falls: Wilson). Times count up to the end of "
        "the episode for those that stood. Errors are rms of an episode from where the controller is asked.",
    )


def half_table(rows: Frame, titles: dict[str, str]) -> Table | None:
    """Lay out the severities at which half fall; ``None`` where one severity alone was run."""
    names, lines = labels(list(rows["controller"].unique())), []
    for scenario, title in titles.items():
        part = rows[rows["scenario"] == scenario]
        for controller, feed in _pairs(part[part["feed"] != "true"]):
            runs = part[(part["controller"] == controller) & (part["feed"] == feed)]
            found = half_fall(runs)
            if found is not None:
                lines.append((title, names[controller], short_label(feed), found.words()))
    if not lines:
        return None
    return Table(
        "half",
        "Severity at which half the episodes end in a fall",
        ("scenario", "controller", "feed", "severity (95 % interval)"),
        tuple(lines),
        "Linear between the severities that were run, after making the share of falls not decrease; "
        "intervals from 2,000 resamples of the seeds, which are too narrow for a handful of them.",
    )


def worst_table(worst: Frame) -> Table:
    """Lay out the worst episodes, with whole names: those who did not come last are not there."""
    lines = tuple(
        (
            str(row["cell"]),
            row["controller"],
            short_label(row["feed"]),
            row["scenario"],
            f"{row['severity']:g}",
            str(row["seed"]),
            number(row["time"]),
            "yes" if row["fell"] else "no",
            number(row["return"], 4),
        )
        for row in worst.to_dict("records")
    )
    columns = (
        "cell",
        "controller",
        "feed",
        "scenario",
        "severity",
        "seed",
        "on its feet (s)",
        "fell",
        "return",
    )
    return Table("worst", "The worst episodes: the earliest falls, then the lowest returns", columns, lines)


def failure_table(failed: Frame) -> Table | None:
    """Lay out the cells that could not be run through, with the last line of what was raised."""
    if not len(failed):
        return None
    lines = tuple(
        (
            str(row["cell"]),
            row["controller"],
            row["feed"],
            row["scenario"],
            f"{row['severity']:g}",
            str(row["seed"]),
            row["error"].splitlines()[-1],
        )
        for row in failed.head(_MOST_FAILURES).to_dict("records")
    )
    left = len(failed) - len(lines)
    note = "The whole text is in the column 'error' of results.parquet."
    if left > 0:
        note = f"{left} more are left out here. {note}"
    columns = ("cell", "controller", "feed", "scenario", "severity", "seed", "raised")
    return Table("failed", f"{len(failed)} cells failed", columns, lines, note)


def _pairs(rows: Frame) -> list[tuple[str, str]]:
    """Controllers in the order of the plan, feeds in that of all figures."""
    return [
        (controller, feed)
        for controller in rows.sort_values("cell")["controller"].unique()
        for feed in in_order(rows[rows["controller"] == controller]["feed"])
    ]
