"""Tables of the arena: one for each scenario, one over all of them, faults, alarms, time, and targets."""

import numpy as np
from scipy import stats

from surefoot.experiments.arena.options import TRUE_MAP
from surefoot.experiments.arena.scenarios import PLAIN, Scenario
from surefoot.experiments.study.figures import in_order, look_of, short_label
from surefoot.experiments.study.tables import Frame, Table, number, with_interval

__all__ = ["alarm_table", "fault_table", "overview_table", "scenario_table", "target_table", "timing_table"]

_COLUMNS = (
    "method",
    "CoP (mm)",
    "vGRF (N)",
    "cell (N)",
    "gain (%)",
    "zero (N)",
    "converged (s)",
    "spread (mm)",
    "NEES",
    "NEES, CoP",
    "NIS",
    "ends worse",
    "bound on CoP (mm)",
)


def scenario_table(scores: Frame, scenario: Scenario) -> Table:
    """Lay out all scores of a scenario.

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
        "the last 10 s. NEES: of gains and zeros at the end of the walk, over its degrees of freedom, with "
        "the 95 % interval of a consistent estimator in brackets. That of the CoP, a mean over time, and "
        "NIS are over their degrees of freedom as well.",
    )


def overview_table(scores: Frame, scenarios: tuple[Scenario, ...]) -> Table:
    """Lay out the CoP errors of all scenarios and methods."""
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
    """Lay out what became of faults, or ``None`` where there were none."""
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
    """Lay out how often a healthy cell was accused."""
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
    """Lay out the time of one robot's update and the share of it in a batch."""
    rows = []
    for row in timing.itertuples():
        batch = scores[scores["method"] == row.method]["batch_us"]
        rows.append(
            (look_of(row.method).label, number(row.median_us), number(row.mean_us), number(batch.mean()))
        )
    columns = ("method", "one robot, median (µs)", "one robot, mean (µs)", "in a batch, each (µs)")
    return Table("timing", "Time of one update", columns, tuple(rows))


def target_table(scores: Frame, timing: Frame, method: str = "moment") -> Table | None:
    """Hold a method against what it was set out to reach, or ``None`` if it was not run.

    Args:
        scores: One row a run.
        timing: One row a method.
        method: Whose targets they are.
    """
    own = scores[scores["method"] == method]
    if not len(own):
        return None
    rows: list[tuple[str, str, str, str]] = []

    def row(what: str, target: str, measured: str, reached: bool) -> None:
        rows.append((what, target, measured, "yes" if reached else "no"))

    for name in (n for n in ("speed-0.02", "speed-0.04", "speed-0.1") if (own["scenario"] == n).any()):
        runs = own[own["scenario"] == name]
        for metric, unit, limit, factor in (
            ("cop", "CoP rmse (mm)", 2.0, 1e3),
            ("vgrf", "vGRF rmse (N)", 0.4, 1.0),
            ("cell", "single cell rmse (N)", 0.4, 1.0),
        ):
            mean = factor * float(runs[metric].mean())
            what = f"{name.replace('-', ' ')} m/s, {unit}"
            row(what, f"≤ {limit:g}", with_interval(runs[metric], factor), mean <= limit)
        window = scores[(scores["scenario"] == name) & (scores["method"] == "window")]
        if len(window):
            ratio = float(window["cop"].mean() / runs["cop"].mean())
            row(
                f"{name.replace('-', ' ')} m/s, window's CoP error over its", "≥ 4", number(ratio), ratio >= 4
            )
    plain = own[own["scenario"] == PLAIN]
    if len(plain):
        taken = float(plain["converged"].quantile(0.95))
        row("time to within twice the final error (s), 95 % of runs", "≤ 10", _seconds(taken), taken <= 10.0)
        if plain["nees_end"].notna().any():
            low, high = _consistent(plain)
            mean = float(plain["nees_end"].mean())
            row("NEES", f"{number(low)} to {number(high)}", number(mean), low <= mean <= high)
    worse = int(own["worse"].sum())
    row("runs that end worse than the start, all scenarios", "0", f"{worse} of {len(own)}", worse == 0)
    faulty = own[own["after"].notna()]
    if len(faulty):
        share = float((faulty["found"] <= 1.0).mean())
        row("faults found within 1 s", "≥ 95 %", f"{100 * share:.0f} %", share >= 0.95)
        after = 1e3 * float(faulty["after"].mean())
        row("CoP after a fault (mm)", "≤ 6", with_interval(faulty["after"], 1e3), after <= 6.0)
    hours = float(own["hours"].sum())
    rate = float(own["alarms"].sum()) / hours
    row(f"false alarms per hour (in {hours:.2f} h)", "≤ 1", number(rate), rate <= 1.0)
    times = timing.set_index("method")
    if method in times.index:
        median = float(times.loc[method, "median_us"])
        row("one update of one robot, median (µs)", "≤ 100", number(median), median <= 100.0)
        if "window" in times.index:
            ratio = float(times.loc["window", "mean_us"] / times.loc[method, "mean_us"])
            row("window's time per sample over its", "≥ 10", number(ratio), ratio >= 10.0)
    return Table("targets", "Set out to reach", ("what", "target", "measured", "reached"), tuple(rows))


def _consistent(runs: Frame) -> tuple[float, float]:
    """The 95 % interval of the mean NEES over runs of an estimator that is as sure as it should be."""
    degrees = float((runs["nees_end"].notna() * runs["parameters"]).sum())
    low, high = (float(stats.chi2.ppf(share, degrees)) / degrees for share in (0.025, 0.975))
    return low, high


def _nees(runs: Frame) -> str:
    if not runs["nees_end"].notna().any():
        return "–"
    low, high = _consistent(runs)
    return f"{number(float(runs['nees_end'].mean()))} [{number(low)}, {number(high)}]"


def _nis(runs: Frame) -> str:
    rows = float(runs["nis_rows"].sum())
    if rows == 0.0:
        return "–"
    return number(float((runs["nis"] * runs["nis_rows"]).sum() / rows))


def _converged(runs: Frame) -> str:
    return _seconds(float(runs["converged"].median()))


def _seconds(value: float) -> str:
    return "never" if value == float("inf") else number(value)
