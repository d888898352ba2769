"""Tables of the comparison: one for each scenario, one over all of them, faults, alarms and time."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import stats

from surefoot.experiments.study.figures import by_way, in_order, look_of, short_label
from surefoot.experiments.study.page import Words
from surefoot.experiments.study.tables import (
    Cell,
    Frame,
    Table,
    Valued,
    count_of,
    laid_out,
    mean_of,
    number,
    sentence,
    with_interval,
)
from surefoot.experiments.walks.options import TRUE_MAP
from surefoot.experiments.walks.scenarios import Scenario

METRICS = (
    ("cop", 1e3, "CoP rmse (mm)", 2.0),
    ("cop_foot", 1e3, "foot's CoP rmse (mm)", 2.0),
    ("vgrf", 1.0, "vGRF rmse (N)", 0.4),
    ("cell", 1.0, "single cell rmse (N)", 0.4),
)
"""Errors with the factor to their unit, what to call them, and what was set out to be reached."""


def consistent(runs: Frame) -> tuple[float, float]:
    """Return the 95 % interval of the mean NEES of an estimator that is as sure as it should be."""
    degrees = float((runs["nees_end"].notna() * runs["parameters"]).sum())
    low, high = stats.chi2.ppf([0.025, 0.975], degrees) / degrees
    return float(low), float(high)


def seconds_text(value: float) -> str:
    """Return a time in s, or that it never came."""
    return "never" if value == float("inf") else number(value)


def _method(runs: Frame) -> str:
    return str(runs["method"].iloc[0])


def _of_methods(cell: Cell) -> Cell:
    """Leave a cell out where it would be about the true map, which is no method."""
    return lambda runs: "–" if _method(runs) == TRUE_MAP else cell(runs)


def _nees(runs: Frame) -> str:
    if not runs["nees_end"].notna().any():
        return "–"
    (low, high), mean = consistent(runs), float(runs["nees_end"].mean())
    text = f"{number(mean)} [{number(low)}, {number(high)}]"
    return Valued.of(text, {"value": mean, "from": low, "to": high})


def _nis(runs: Frame) -> str:
    rows = float(runs["nis_rows"].sum())
    return number(float((runs["nis"] * runs["nis_rows"]).sum() / rows)) if rows else "–"


def _found_after(runs: Frame) -> str:
    known = runs["found"][np.isfinite(runs["found"])]
    return number(float(known.median())) if len(known) else "–"


_SCORES: Mapping[str, Cell] = {
    "method": lambda runs: look_of(_method(runs)).label,
    "CoP (mm)": mean_of("cop", 1e3),
    "foot's CoP (mm)": mean_of("cop_foot", 1e3),
    "vGRF (N)": mean_of("vgrf"),
    "cell (N)": mean_of("cell"),
    "scale (%)": mean_of("scale", 1e2),
    "offset (N)": mean_of("offset"),
    "converged (s)": _of_methods(lambda runs: seconds_text(float(runs["converged"].median()))),
    "spread (mm)": mean_of("spread", 1e3),
    "NEES": _nees,
    "NEES, CoP": lambda runs: number(float(runs["nees_cop"].mean())),
    "NIS": _nis,
    "ends worse": _of_methods(count_of("worse")),
    "feet end worse": _of_methods(count_of("worse_foot")),
    "bound on CoP (mm)": mean_of("bound_cop", 1e3),
}

_FAULTS: Mapping[str, Cell] = {
    "found within 1 s": lambda runs: f"{int((runs['found'] <= 1.0).sum())} of {len(runs)}",
    "found after (s), median": _found_after,
    "right cell": count_of("isolated"),
    "right name": count_of("named"),
}


def scenario_table(scores: Frame, scenario: Scenario) -> Table:
    """Return all scores of a scenario, from one row a run."""
    title = f"{sentence(scenario.title)}: means over runs and their 95 % intervals"
    parts = by_way(scores[scores["scenario"] == scenario.name])
    return laid_out(
        f"scenario_{scenario.name}", title, _SCORES, parts.values(), Words("walks", "scenarios")("scores")
    )


def overview_table(scores: Frame, scenarios: Sequence[Scenario]) -> Table:
    """Return the CoP errors of all scenarios and methods."""

    def error_of(method: str) -> Cell:
        return lambda item: with_interval(item[1][item[1]["method"] == method]["cop"], 1e3)

    columns: dict[str, Cell] = {
        "scenario": lambda item: item[0].title,
        "runs": lambda item: str(item[1]["seed"].nunique()),
        **{look_of(method).label: error_of(method) for method in in_order(scores["method"])},
    }
    parts = [(scenario, scores[scores["scenario"] == scenario.name]) for scenario in scenarios]
    return laid_out("overview", "CoP rmse in mm, all scenarios", columns, [p for p in parts if len(p[1])])


def fault_table(scores: Frame, scenarios: Sequence[Scenario]) -> Table | None:
    """Return what became of faults, or ``None`` where there were none."""
    titles = {scenario.name: scenario.title for scenario in scenarios if scenario.faults}
    parts = [
        runs for name in titles for runs in by_way(scores[scores["scenario"] == name]).values() if len(runs)
    ]
    columns: dict[str, Cell] = {
        "fault, method": lambda runs: f"{titles[runs['scenario'].iloc[0]]}, {short_label(_method(runs))}",
        **{name: _of_methods(cell) for name, cell in _FAULTS.items()},
        "CoP afterwards (mm)": mean_of("after", 1e3),
    }
    title = "Cells that fail while the robot walks"
    note = "CoP afterwards: rmse from 1 s after the fault to the end of the walk."
    return laid_out("faults", title, columns, parts, note) if parts else None


def alarm_table(scores: Frame) -> Table:
    """Return how often a healthy cell was accused."""

    def exact(runs: Frame) -> str:
        # Interval of a Poisson rate (Garwood, 1936).
        alarms, hours = float(runs["alarms"].sum()), float(runs["hours"].sum())
        low = stats.chi2.ppf(0.025, 2 * alarms) / 2 if alarms else 0.0
        return f"{number(low / hours)} to {number(stats.chi2.ppf(0.975, 2 * alarms + 2) / 2 / hours)}"

    columns: dict[str, Cell] = {
        "method": _SCORES["method"],
        "hours without a fault": lambda runs: f"{runs['hours'].sum():.2f}",
        "alarms": lambda runs: f"{runs['alarms'].sum():.0f}",
        "per hour": lambda runs: number(float(runs["alarms"].sum() / runs["hours"].sum())),
        "95 % interval": exact,
    }
    parts = by_way(scores[scores["method"] != TRUE_MAP]).values()
    return laid_out("alarms", "False alarms in all walks", columns, parts)


def timing_table(timing: Frame) -> Table:
    """Return the time of one robot's update."""
    columns: dict[str, Cell] = {
        "method": lambda row: look_of(row.method).label,
        "median (µs)": lambda row: number(row.median_us),
        "mean (µs)": lambda row: number(row.mean_us),
    }
    return laid_out("timing", "Time of one update", columns, timing.itertuples())
