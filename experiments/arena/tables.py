"""Tables of the comparison: one for each scenario, one over all of them, faults, alarms and time."""

import numpy as np
from scipy import stats

from surefoot.experiments.arena.options import TRUE_MAP
from surefoot.experiments.arena.scenarios import Scenario
from surefoot.experiments.study.figures import in_order, look_of, short_label
from surefoot.experiments.study.tables import Frame, Table, number, with_interval

__all__ = [
    "alarm_table",
    "consistent",
    "fault_table",
    "overview_table",
    "scenario_table",
    "seconds_text",
    "timing_table",
]

_COLUMNS = (
    "method",
    "CoP (mm)",
    "vGRF (N)",
    "cell (N)",
    "scale (%)",
    "offset (N)",
    "converged (s)",
    "spread (mm)",
    "NEES",
    "NEES, CoP",
    "NIS",
    "ends worse",
    "bound on CoP (mm)",
)


def scenario_table(scores: Frame, scenario: Scenario) -> Table:
    """Return all scores of a scenario.

    Args:
        scores: One row a run, as :func:`surefoot.experiments.arena.run.run_arena` makes them.
        scenario: Which one.
    """
    part = scores[scores["scenario"] == scenario.name]
    rows = []
    for method in in_order(part["method"]):
        runs = part[part["method"] == method]
        rows.append(
            (
                look_of(method).label,
                with_interval(runs["cop"], 1e3),
                with_interval(runs["vgrf"]),
                with_interval(runs["cell"]),
                with_interval(runs["scale"], 1e2),
                with_interval(runs["offset"]),
                _converged(runs) if method != TRUE_MAP else "–",
                with_interval(runs["spread"], 1e3),
                _nees(runs),
                number(float(runs["nees_cop"].mean())),
                _nis(runs),
                f"{int(runs['worse'].sum())} of {len(runs)}" if method != TRUE_MAP else "–",
                with_interval(runs["bound_cop"], 1e3),
            )
        )
    return Table(
        f"scenario_{scenario.name}",
        f"{scenario.title[:1].upper()}{scenario.title[1:]}: means over runs and their 95 % intervals",
        _COLUMNS,
        tuple(rows),
        "converged: median time after the walk began from which the error of 2 s stays within twice that of "
        "the last 10 s. NEES: of scales and offsets at the end of the walk, over its degrees of freedom, "
        "with the 95 % interval of a consistent estimator in brackets. That of the CoP, a mean over time, "
        "and NIS are over their degrees of freedom as well.",
    )


def overview_table(scores: Frame, scenarios: tuple[Scenario, ...]) -> Table:
    """Return the CoP errors of all scenarios and methods."""
    methods = in_order(scores["method"])
    rows = []
    for scenario in scenarios:
        part = scores[scores["scenario"] == scenario.name]
        if not len(part):
            continue
        cells = [with_interval(part[part["method"] == m]["cop"], 1e3) for m in methods]
        rows.append((scenario.title, str(part["seed"].nunique()), *cells))
    columns = ("scenario", "runs", *(look_of(method).label for method in methods))
    return Table("overview", "CoP rmse in mm, all scenarios", columns, tuple(rows))


def fault_table(scores: Frame, scenarios: tuple[Scenario, ...]) -> Table | None:
    """Return what became of faults, or ``None`` where there were none."""
    rows = []
    for scenario in scenarios:
        part = scores[scores["scenario"] == scenario.name] if scenario.faults else scores[:0]
        for method in in_order(part["method"]):
            runs = part[part["method"] == method]
            silent = method == TRUE_MAP
            found = runs["found"].to_numpy()
            known = np.isfinite(found)
            share = "–" if silent else f"{int((found <= 1.0).sum())} of {len(runs)}"
            rows.append(
                (
                    f"{scenario.title}, {short_label(method)}",
                    share,
                    number(float(np.median(found[known]))) if known.any() and not silent else "–",
                    "–" if silent else f"{int(runs['isolated'].sum())} of {len(runs)}",
                    "–" if silent else f"{int(runs['named'].sum())} of {len(runs)}",
                    with_interval(runs["after"], 1e3),
                )
            )
    columns = (
        "fault, method",
        "found within 1 s",
        "found after (s), median",
        "right cell",
        "right name",
        "CoP afterwards (mm)",
    )
    note = "CoP afterwards: rmse from 1 s after the fault to the end of the walk."
    return (
        Table("faults", "Cells that fail while the robot walks", columns, tuple(rows), note) if rows else None
    )


def alarm_table(scores: Frame) -> Table:
    """Return how often a healthy cell was accused."""
    rows = []
    for method in in_order(scores["method"]):
        runs = scores[scores["method"] == method]
        if method == TRUE_MAP:
            continue
        alarms, hours = float(runs["alarms"].sum()), float(runs["hours"].sum())
        # Exact interval of a Poisson rate (Garwood, 1936).
        low = float(stats.chi2.ppf(0.025, 2 * alarms)) / 2 if alarms else 0.0
        high = float(stats.chi2.ppf(0.975, 2 * alarms + 2)) / 2
        rows.append(
            (
                look_of(method).label,
                f"{hours:.2f}",
                f"{alarms:.0f}",
                number(alarms / hours),
                f"{number(low / hours)} to {number(high / hours)}",
            )
        )
    columns = ("method", "hours without a fault", "alarms", "per hour", "95 % interval")
    return Table("alarms", "False alarms in all walks", columns, tuple(rows))


def timing_table(timing: Frame, scores: Frame) -> Table:
    """Return the time of one robot's update and the share of it in a batch."""
    rows = []
    for row in timing.itertuples():
        batch = scores[scores["method"] == row.method]["batch_us"]
        rows.append(
            (look_of(row.method).label, number(row.median_us), number(row.mean_us), number(batch.mean()))
        )
    columns = ("method", "one robot, median (µs)", "one robot, mean (µs)", "in a batch, each (µs)")
    return Table("timing", "Time of one update", columns, tuple(rows))


def consistent(runs: Frame) -> tuple[float, float]:
    """Return the 95 % interval of the mean NEES of an estimator that is as sure as it should be."""
    degrees = float((runs["nees_end"].notna() * runs["parameters"]).sum())
    low, high = (float(stats.chi2.ppf(share, degrees)) / degrees for share in (0.025, 0.975))
    return low, high


def _nees(runs: Frame) -> str:
    if not runs["nees_end"].notna().any():
        return "–"
    low, high = consistent(runs)
    return f"{number(float(runs['nees_end'].mean()))} [{number(low)}, {number(high)}]"


def _nis(runs: Frame) -> str:
    rows = float(runs["nis_rows"].sum())
    if rows == 0.0:
        return "–"
    return number(float((runs["nis"] * runs["nis_rows"]).sum() / rows))


def _converged(runs: Frame) -> str:
    return seconds_text(float(runs["converged"].median()))


def seconds_text(value: float) -> str:
    """Return a time in s, or that it never came."""
    return "never" if value == float("inf") else number(value)
