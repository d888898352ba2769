"""Tables of a study of walks: a scenario each, one over all; faults, alarms; the CoP paper's 4 to 6."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from surefoot.experiments.study.figures import by_way, in_order, look_of, short_label
from surefoot.experiments.study.page import Words
from surefoot.experiments.study.statistics import mean_interval, survival
from surefoot.experiments.study.tables import (
    NOTHING,
    Cell,
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
    share,
    table_of,
    with_interval,
)
from surefoot.experiments.walks.scenarios import TRUE_MAP, Scenario
from surefoot.experiments.walks.score import rms


class MethodErrors(NamedTuple):
    """Root-mean-square errors of the centre of pressure in m and of the vertical force in N."""

    cop: float
    vgrf: float


class Metric(NamedTuple):
    """An error: its column, the factor to its unit, what to call it, and what was set out to be reached."""

    column: str
    factor: float
    what: str
    unit: str
    target: float

    @property
    def label(self) -> str:
        """What it is called where it stands alone."""
        return f"{self.what} rmse ({self.unit})"

    def cell(self, runs: Frame) -> str:
        """Its mean over runs with the interval."""
        return with_interval(runs[self.column], self.factor)


METRICS = (
    Metric("cop", 1e3, "CoP", "mm", 2.0),
    Metric("cop_foot", 1e3, "foot's CoP", "mm", 2.0),
    Metric("vgrf", 1.0, "vGRF", "N", 0.4),
    Metric("cell", 1.0, "single cell", "N", 0.4),
)
PAPER_METRICS = (METRICS[0], METRICS[2])  # those that the CoP paper has


CALIBRATED = "moment"  # the method that others are held against

WALKING_TABLES = {
    0.02: {"window": MethodErrors(0.0059, 0.4339), "quasi-static": MethodErrors(0.0108, 1.2949)},
    0.04: {"window": MethodErrors(0.0108, 0.5324), "quasi-static": MethodErrors(0.0166, 1.8646)},
    0.1: {"window": MethodErrors(0.0134, 1.0387), "quasi-static": MethodErrors(0.0199, 2.5220)},
}
"""The CoP paper's Tables 4 to 6 by walking speed in m/s, against its own offline-calibrated baseline."""

PAPER_TABLE_NUMBER = {0.02: "4", 0.04: "5", 0.1: "6"}


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


def _time_to_find(runs: Frame) -> str:
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
}

_FAULTS: Mapping[str, Cell] = {
    "found within 1 s": lambda runs: share(int((runs["found"] <= 1.0).sum()), len(runs)),
    "found after (s), median": _time_to_find,
    "right cell": count_of("isolated"),
    "right name": count_of("named"),
}


def scenario_table(scores: Frame, scenario: Scenario) -> Table:
    """Return all scores of a scenario, from one row a run."""
    title = f"{sentence(scenario.title)}: means over runs and their 95 % intervals"
    own = scores[scores["scenario"] == scenario.name]
    behind = _behind(own)
    columns = {**_SCORES, BEHIND: _of_methods(lambda runs: behind(_method(runs)))}
    note = Words("walks", "scenarios")("scores")
    return table_of(f"scenario_{scenario.name}", title, columns, by_way(own).values(), note)


BEHIND = f"CoP, more than {CALIBRATED}, paired (mm)"


def _behind(runs: Frame) -> Callable[[str], str]:
    """Make cells of a method: how much farther off its CoP is than the moment filter's, walk by walk."""
    cop = runs.pivot(index="seed", columns="method", values="cop")

    def cell(method: str) -> str:
        if method == CALIBRATED or not {method, CALIBRATED} <= set(cop):
            return ""
        gap = mean_interval(cop[method] - cop[CALIBRATED])
        said = interval_text(gap, 1e3)
        return Verdict.of(gap.mean > 0.0, said) if gap.apart else said

    return cell


def overview_table(scores: Frame, scenarios: Sequence[Scenario], metric: Metric) -> Table:
    """Return an error of all scenarios and methods."""

    def error_of(method: str) -> Cell:
        return lambda item: metric.cell(item[1][item[1]["method"] == method])

    columns: dict[str, Cell] = {
        "scenario": lambda item: item[0].title,
        "runs": lambda item: decimal(item[1]["seed"].nunique(), "d"),
        **{look_of(method).label: error_of(method) for method in in_order(scores["method"])},
    }
    parts = [(scenario, scores[scores["scenario"] == scenario.name]) for scenario in scenarios]
    name = "overview" if metric.column == "cop" else f"overview_{metric.column.removeprefix('cop_')}"
    return table_of(name, f"{metric.label}, all scenarios", columns, [p for p in parts if len(p[1])])


def fault_table(scores: Frame, scenarios: Sequence[Scenario]) -> Table | None:
    """Faults found and missed, or ``None`` where there were none."""
    titles = {scenario.name: scenario.title for scenario in scenarios if scenario.faults}
    parts = [
        runs for name in titles for runs in by_way(scores[scores["scenario"] == name]).values() if len(runs)
    ]
    columns: dict[str, Cell] = {
        "fault, method": lambda runs: f"{titles[runs['scenario'].iloc[0]]}, {short_label(_method(runs))}",
        **{name: _of_methods(cell) for name, cell in _FAULTS.items()},
        "CoP afterwards (mm)": mean_of("after", 1e3),
        "foot's CoP afterwards (mm)": mean_of("after_foot", 1e3),
    }
    title = "Cells that fail while the robot walks"
    note = "CoP afterwards: rmse from 1 s after the fault to the end of the walk."
    return table_of("faults", title, columns, parts, note) if parts else None


def alarm_table(scores: Frame) -> Table:
    """Return how often a healthy cell was accused."""

    def exact(runs: Frame) -> str:
        # Interval of a Poisson rate (Garwood, 1936).
        alarms, hours = float(runs["alarms"].sum()), float(runs["hours"].sum())
        low = stats.chi2.ppf(0.025, 2 * alarms) / 2 if alarms else 0.0
        ends = float(low / hours), float(stats.chi2.ppf(0.975, 2 * alarms + 2) / 2 / hours)
        return Valued.of(" to ".join(map(number, ends)), dict(zip(("from", "to"), ends, strict=True)))

    columns: dict[str, Cell] = {
        "method": _SCORES["method"],
        "hours without a fault": lambda runs: decimal(runs["hours"].sum(), ".2f"),
        "alarms": lambda runs: decimal(runs["alarms"].sum(), ".0f"),
        "per hour": lambda runs: number(float(runs["alarms"].sum() / runs["hours"].sum())),
        "95 % interval": exact,
    }
    parts = by_way(scores[scores["method"] != TRUE_MAP]).values()
    return table_of("alarms", "False alarms in all walks", columns, parts)


def lead_table(yardsticks: Frame, loop: Frame, condition: str, title: str) -> Table:
    """Errors of each way to read the feet, and who falls by it."""
    own = yardsticks[(yardsticks["condition"] == condition) & (yardsticks["against"] == "truth")]
    raw = int(loop[loop["feed"] == "none"]["fell"].sum())
    behind = _behind(own)

    def error(metric: str, factor: float) -> Cell:
        def cell(way: tuple[str, Frame]) -> str:
            errors = own[own["method"] == way[0]][metric]
            return with_interval(errors, factor) if len(errors) else decimal(0)

        return cell

    def fall(way: tuple[str, Frame]) -> str:
        falls, said = int(way[1]["fell"].sum()), count_of("fell")(way[1])
        return said if falls == raw else Verdict.of(falls < raw, said)

    columns: dict[str, Cell] = {
        "what reads the feet": lambda way: look_of(way[0]).label,
        "walks that fall": fall,
        "CoP off by (mm)": error("cop", 1e3),
        f"more than {CALIBRATED}, paired (mm)": lambda way: behind(way[0]),
        "vertical force off by (N)": error("vgrf", 1.0),
    }
    note = (
        "Errors while walking at the bad start, rms from the settling time on; paired: on the same walks, "
        "coloured where the interval leaves zero out. Falls: the controller is fed the CoP of cells that are "
        f"{loop['severity'].iloc[0]:g} times as bad; green, fewer than on raw readings."
    )
    return table_of("lead", title, columns, by_way(loop, "feed").items(), note)


def walking_table(scores: Frame, speed: float, conditions: Sequence[tuple[str, str]]) -> Table:
    """Return one speed as the paper's Tables 4 to 6 and the truth; the first condition is the paper's."""
    rows, against_truth = [], (*PAPER_METRICS, METRICS[1], METRICS[3])
    here = scores[scores["speed"] == speed]
    for condition, title in conditions:
        published = WALKING_TABLES.get(speed, {}) if condition == conditions[0][0] else {}
        for method, runs in by_way(here[here["condition"] == condition]).items():
            baseline, truth = (runs[runs["against"] == against] for against in ("baseline", "truth"))
            cells = [title, look_of(method).label]
            for metric in PAPER_METRICS:
                same = len(baseline) and float(baseline[metric.column].max()) < 1e-9
                cells.append("0 *" if same else metric.cell(baseline))
                paper = published.get(method)
                cells.append("" if paper is None else number(metric.factor * getattr(paper, metric.column)))
            rows.append((*cells, *(metric.cell(truth) for metric in against_truth)))
    columns = ["condition", "method"]
    for metric in PAPER_METRICS:
        columns += [f"{metric.what} against baseline ({metric.unit})", "paper"]
    columns += [f"{metric.what} against truth ({metric.unit})" for metric in against_truth]
    name = PAPER_TABLE_NUMBER.get(speed)
    note = (
        f"rmse, mean ± 95 % interval over {plural(here['seed'].nunique(), 'seed')}. "
        "* By construction: these readings are the baseline."
    )
    return Table(
        f"walking_{speed:g}".replace(".", "_"),
        f"Table {name}: {speed:g} m/s" if name else f"{speed:g} m/s",
        tuple(columns),
        tuple(rows),
        note,
    )


def cycle_table(walks: Mapping[str, Frame]) -> Table:
    """Return the statistics of gait cycles, a row a method and foot in each condition, given by its title."""

    def pool(name: str, form: str, factor: float = 1.0) -> Cell:
        def cell(item: tuple[str, Frame]) -> str:
            mean, spread = factor * item[1][name].mean(), factor * rms(item[1][f"{name}_std"])
            if mean != mean:
                return NOTHING
            return Valued.of(f"{mean:{form}} ± {spread:{form}}", {"value": mean, "plus_minus": spread})

        return cell

    columns: dict[str, Cell] = {
        "condition": lambda item: item[0],
        "method": lambda item: look_of(_method(item[1])).label,
        "foot": lambda item: str(item[1]["foot"].iloc[0]),
        "cycles": lambda item: decimal(item[1]["cycles"].sum()),
        "peak vGRF (weights)": pool("peak", ".3f"),
        "duty factor (%)": pool("duty", ".1f", 100.0),
        "cycle (s)": pool("period", ".3f"),
        "CoP repeats within (mm)": lambda item: number(1e3 * rms(item[1]["repeat"])),
    }
    parts = [
        (title, part)
        for title, cycles in walks.items()
        for own in by_way(cycles).values()
        for _, part in own.groupby("foot")
    ]
    return table_of("gait_cycle", "Gait cycles", columns, parts, Words("walks", "paper")("gait_cycle"))


def loop_table(runs: Frame, horizon: float) -> Table:
    """Return the closed loop: who fell, and when; one row a walk comes in, which lasts so many s at most."""

    def time_to_half(part: Frame) -> str:
        curve = survival(part["time"], part["fell"])
        times = curve.time[curve.share <= 0.5]
        return number(float(times[0])) if len(times) else f"> {horizon:g}"

    columns: dict[str, Cell] = {
        "severity": lambda part: decimal(part["severity"].iloc[0]),
        "speed (m/s)": lambda part: decimal(part["speed"].iloc[0]),
        "CoP fed back": lambda part: look_of(part["feed"].iloc[0]).label,
        "falls": count_of("fell"),
        "half have fallen after (s)": time_to_half,
        f"time on its feet (s), of {horizon:g}": mean_of("time"),
        "error of the CoP fed back (mm)": mean_of("cop_error", 1e3),
    }
    note = "Paired: the same seeds, pushes, ground and sensors under every feedback. Errors up to the fall."
    groups = runs.groupby(["severity", "speed"], sort=False)
    parts = [part for _, walks in groups for part in by_way(walks, "feed").values()]
    return table_of("closed_loop", "The walker on different feet", columns, parts, note)
