"""The tables of the demo: the CoP paper's 2 to 6 with its figures beside ours, and those that it has not."""

from collections.abc import Sequence

import numpy as np

from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.weights.channels import fit_channels
from surefoot.experiments.demo.paper_tables import TABLE_2, TABLE_3, WALKING_TABLES
from surefoot.experiments.study.figures import in_order, look_of
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import Column, Frame, Table, number, with_interval
from surefoot.experiments.walks.score import survival_curve
from surefoot.experiments.weights.weighing import WeighingReport

__all__ = ["loop_table", "paper_table_2", "sensitivity_table", "table_2", "table_3", "walking_table"]

PAPER_TABLE_NUMBER = {0.02: "4", 0.04: "5", 0.1: "6"}


def paper_table_2() -> tuple[Table, float]:
    """Fit the counts that the paper prints, and compare with the coefficients that it prints.

    Returns:
        The table, and the largest relative difference of a coefficient.
    """
    fit = fit_channels(TABLE_2.code.T, TABLE_2.load, TABLE_2.channel_names).value
    difference = np.maximum(np.abs(fit.scale / TABLE_2.scale - 1), np.abs(fit.offset / TABLE_2.offset - 1))
    rows = tuple(
        (
            name.replace("/", " foot, ").replace("-", " "),
            *(f"{code:,.0f}" for code in TABLE_2.code[i]),
            f"{1e6 * fit.scale[i]:.8f}",
            f"{1e6 * TABLE_2.scale[i]:.8f}",
            f"{fit.offset[i]:.7f}",
            f"{TABLE_2.offset[i]:.7f}",
            f"{difference[i]:.1e}",
        )
        for i, name in enumerate(TABLE_2.channel_names)
    )
    heads = tuple("no load" if load == 0 else f"{load:g} kg" for load in TABLE_2.load)
    columns = ("cell", *heads, "c, ours", "c, paper", "d, ours", "d, paper", "largest difference")
    note = (
        "Counts as printed in the paper; c in 1e-6 kg per count and d in kg by regression of load on count."
    )
    table = Table("table2_paper", "Table 2: the paper's counts, fitted again", columns, rows, note)
    return table, float(difference.max())


def table_2(report: WeighingReport) -> Table:
    """Lay out the virtual bench as the paper's Table 2: codes under known loads, and lines."""
    load = report.channel_load
    shown = [int(np.argmin(np.abs(load - wanted))) for wanted in (0.0, 0.01, 0.05, 0.2, 6.0)]
    shown = list(dict.fromkeys(shown))
    value = report.channels.value
    rows = tuple(
        (
            name.replace("/", " foot, ").replace("-", " "),
            *(f"{report.channel_code[j, i]:,.0f}" for j in shown),
            f"{1e6 * value.scale[i] / GRAVITY:.5f}",
            f"{value.offset[i] / GRAVITY:.5f}",
        )
        for i, name in enumerate(report.channel_names)
    )
    heads = tuple("no load" if load[j] == 0 else f"{load[j]:g} kg" for j in shown)
    note = (
        f"Mean codes of one second each under {len(load)} weights from 1 g to 6 kg, of which some are shown; "
        "c in 1e-6 kg per count, d in kg."
    )
    return Table("table2_bench", "The same of the virtual bench", ("cell", *heads, "c", "d"), rows, note)


def table_3(report: WeighingReport) -> Table:
    """Lay out the bench's errors on held-out holes as the paper's Table 3."""
    initial, calibrated = report.initial, report.calibrated
    paper = TABLE_3
    rows = (
        (
            "CoP (mm)",
            number(1e3 * initial.cop),
            number(1e3 * calibrated.cop),
            number(1e3 * paper["initial"].cop),
            number(1e3 * paper["calibrated"].cop),
        ),
        (
            "vGRF (N)",
            number(initial.vgrf),
            number(calibrated.vgrf),
            number(paper["initial"].vgrf),
            number(paper["calibrated"].vgrf),
        ),
    )
    columns = ("rmse", "initial, ours", "calibrated, ours", "initial, paper", "calibrated, paper")
    note = (
        f"{calibrated.placements} placements with a centre of pressure and {calibrated.weighings} weighings "
        "at holes that the fit never saw; the paper does not say how many of its were held out."
    )
    return Table("table3", "Table 3: the bench before and after calibration", columns, rows, note)


def walking_table(scores: Frame, speed: float, conditions: Sequence[tuple[str, str]]) -> Table:
    """Lay out one speed as the paper's Tables 4 to 6, with the truth beside the paper's baseline.

    Args:
        scores: One row a walk, method and yardstick: ``condition``, ``speed``, ``method``, ``against``
            (``"baseline"`` or ``"truth"``), ``cop`` (m), ``vgrf`` (N), ``cell`` (N).
        speed: Walking speed in m/s.
        conditions: Their names in ``scores``, and what to call them.
    """
    rows = []
    here = scores[scores["speed"] == speed]
    published = WALKING_TABLES.get(speed, {})
    for condition, title in conditions:
        part = here[here["condition"] == condition]
        for method in in_order(part["method"]):
            cells = [title, look_of(method).label]
            one = part[part["method"] == method]
            for metric, factor in (("cop", 1e3), ("vgrf", 1.0)):
                ours = one[one["against"] == "baseline"][metric]
                paper = published.get(method) if condition == conditions[0][0] else None
                cells.append(_against_baseline(ours, factor))
                cells.append("" if paper is None else number(factor * getattr(paper, metric)))
            for metric, factor in (("cop", 1e3), ("vgrf", 1.0), ("cell", 1.0)):
                cells.append(with_interval(one[one["against"] == "truth"][metric], factor))
            rows.append(tuple(cells))
    columns = (
        "condition",
        "method",
        "CoP against baseline (mm)",
        "paper",
        "vGRF against baseline (N)",
        "paper",
        "CoP against truth (mm)",
        "vGRF against truth (N)",
        "single cell against truth (N)",
    )
    name = PAPER_TABLE_NUMBER.get(speed)
    title = f"Table {name}: {speed:g} m/s" if name else f"{speed:g} m/s"
    note = (
        f"rmse, mean ± 95 % interval over {here['seed'].nunique()} seeds. "
        "* By construction: these readings are the baseline."
    )
    return Table(f"walking_{speed:g}".replace(".", "_"), title, columns, tuple(rows), note)


def _against_baseline(values: Column, factor: float) -> str:
    if len(values) and float(values.max()) < 1e-9:
        return "0 *"
    return with_interval(values, factor)


def loop_table(runs: Frame, horizon: float) -> Table:
    """Lay out the closed loop: who fell, and when.

    Args:
        runs: One row a walk: ``severity``, ``speed``, ``seed``, ``feed``, ``fell``, ``time`` (s),
        ``cop_error``
            (m) of what was fed back against the truth, ``tracking`` (m) of the true centre of pressure
            against its plan.
        horizon: End of a walk in s.
    """
    rows = []
    for (severity, speed), walks in runs.groupby(["severity", "speed"], sort=False):
        for feed in in_order(walks["feed"]):
            part = walks[walks["feed"] == feed]
            time, share = survival_curve(part["time"], part["fell"])
            halved = time[share <= 0.5]
            rows.append(
                (
                    f"{severity:g}",
                    f"{speed:g}",
                    look_of(feed).label,
                    f"{int(part['fell'].sum())} of {len(part)}",
                    number(float(halved[0])) if len(halved) else f"> {horizon:g}",
                    with_interval(part["time"]),
                    with_interval(part["cop_error"], 1e3),
                    with_interval(part["tracking"], 1e3),
                )
            )
    columns = (
        "severity",
        "speed (m/s)",
        "CoP fed back",
        "falls",
        "half have fallen after (s)",
        f"time on its feet (s), of {horizon:g}",
        "error of the CoP fed back (mm)",
        "true CoP from its plan (mm)",
    )
    note = "Paired: the same seeds, pushes, ground and sensors under every feedback. Errors up to the fall."
    return Table("closed_loop", "The walker on different feet", columns, tuple(rows), note)


def sensitivity_table(runs: Frame, title: str) -> Table:
    """Lay out how far the window's errors move with its weights.

    Args:
        runs: Rows ``weight``, ``factor``, ``speed``, ``seed``, ``cop`` (m), ``vgrf`` (N).
        title: What they were recorded and scored in.
    """
    factors = sorted(runs["factor"].unique())
    rows = []
    for weight in dict.fromkeys(runs["weight"]):
        for speed in sorted(runs["speed"].unique()):
            part = runs[(runs["weight"] == weight) & (runs["speed"] == speed)]
            for metric, unit, factor in (("cop", "CoP (mm)", 1e3), ("vgrf", "vGRF (N)", 1.0)):
                means = [factor * mean_interval(part[part["factor"] == f][metric]).mean for f in factors]
                base = means[factors.index(1.0)] if 1.0 in factors else float("nan")
                rows.append(
                    (
                        weight,
                        f"{speed:g}",
                        unit,
                        *(number(mean) for mean in means),
                        f"{100 * (min(means) / base - 1):+.0f} to {100 * (max(means) / base - 1):+.0f} %",
                    )
                )
    columns = ("weight", "speed (m/s)", "rmse", *(f"× {factor:g}" for factor in factors), "change")
    name = "sensitivity_" + title.partition(",")[0].replace(" ", "_").replace("'", "")
    return Table(name, f"The window's weights, each scaled alone: {title}", columns, tuple(rows))
