"""Sentences that follow from the numbers: nothing in them is written beforehand but their grammar."""

import numpy as np
from scipy import stats

from surefoot.experiments.demo.paper_tables import WALKING_TABLES
from surefoot.experiments.study.figures import in_order, short_label
from surefoot.experiments.study.statistics import Interval, mean_interval
from surefoot.experiments.study.tables import Frame, Table, number

__all__ = ["baseline_findings", "loop_findings", "sensitivity_findings", "target_table", "truth_findings"]


def _pivot(scores: Frame, condition: str, against: str, speed: float, metric: str) -> Frame:
    """One row a seed, one column a method."""
    part = scores[
        (scores["condition"] == condition) & (scores["against"] == against) & (scores["speed"] == speed)
    ]
    return part.pivot(index="seed", columns="method", values=metric)


def baseline_findings(scores: Frame, condition: str) -> tuple[str, ...]:
    """Say how the paper's method and Han's compare in the way that the paper scores.

    Args:
        scores: As in :func:`surefoot.experiments.demo.tables.walking_table`.
        condition: Name of the paper's conditions in ``scores``.
    """
    said = []
    for speed in sorted(scores["speed"].unique()):
        published = WALKING_TABLES.get(speed)
        table = {m: _pivot(scores, condition, "baseline", speed, m) for m in ("cop", "vgrf")}
        if not {"window", "quasi-static"} <= set(table["cop"].columns):
            continue
        window = mean_interval(table["cop"]["window"])
        gap = mean_interval(table["cop"]["quasi-static"] - table["cop"]["window"])
        force_gap = mean_interval(table["vgrf"]["quasi-static"] - table["vgrf"]["window"])
        against_paper = ""
        if published is not None:
            printed = 1e3 * published["window"].cop
            word = "under" if 1e3 * window.mean <= printed else "over"
            against_paper = f" ({word} the paper's {number(printed)} mm)"
        said.append(
            f"{speed:g} m/s, the paper's conditions and scoring: the window is "
            f"{_amount(window, 1e3, 'mm')} from the bench-calibrated baseline{against_paper}; Han's lies "
            f"{_difference(gap, 1e3, 'mm')} in CoP and {_difference(force_gap, 1.0, 'N')} in vGRF."
        )
    return tuple(said)


def truth_findings(scores: Frame, condition: str, title: str) -> tuple[str, ...]:
    """Say which methods are better and which are worse than doing nothing, against the truth.

    Args:
        scores: As in :func:`surefoot.experiments.demo.tables.walking_table`.
        condition: Name of the condition in ``scores``.
        title: What to call it.
    """
    said = []
    for speed in sorted(scores["speed"].unique()):
        cop = _pivot(scores, condition, "truth", speed, "cop")
        if "none" not in cop:
            continue
        text = (
            f"{speed:g} m/s, {title}, against the truth: raw {_amount(mean_interval(cop['none']), 1e3, 'mm')}"
        )
        if "floor" in cop:
            text += f" (floor {_amount(mean_interval(cop['floor']), 1e3, 'mm')})"
        for method in in_order(cop.columns):
            if method in ("none", "baseline", "floor", "reference"):
                continue
            change = mean_interval(cop[method] - cop["none"])
            worse = int((cop[method] > cop["none"]).sum())
            text += (
                f"; {short_label(method)} {_amount(mean_interval(cop[method]), 1e3, 'mm')}, "
                f"{_verdict(change, 'worse than raw', 'better than raw')} "
                f"(worse in {worse} of {len(cop)} seeds)"
            )
        said.append(text + "." + _reason(cop))
    return tuple(said)


def _reason(cop: Frame) -> str:
    """Say what window and Han follow, where that is further from the truth than the readings are."""
    if "reference" not in cop:
        return ""
    reference, raw = mean_interval(cop["reference"]), mean_interval(cop["none"])
    asked = _amount(reference, 1e3, "mm")
    if reference.mean > raw.mean:
        return (
            f" The reference that window and Han follow is itself {asked} off, further than the "
            "readings: following it leads away from the truth."
        )
    return f" The reference that window and Han follow is {asked} off."


def loop_findings(runs: Frame, horizon: float) -> tuple[str, ...]:
    """Say who fell, paired by seed.

    Args:
        runs: As in :func:`surefoot.experiments.demo.tables.loop_table`.
        horizon: End of a walk in s.
    """
    said = []
    for severity, walks in runs.groupby("severity", sort=False):
        for feed in in_order(walks["feed"]):
            part = walks[walks["feed"] == feed]
            falls = int(part["fell"].sum())
            text = (
                f"Severity {severity:g}, {_feed_name(feed)} CoP: {falls} of {len(part)} walks end in a fall "
                f"within {horizon:g} s"
            )
            if feed not in ("true", "none") and "none" in set(walks["feed"]):
                text += _saved(walks, feed)
            said.append(text + ".")
        said += _tolerance(walks, severity)
    return tuple(said)


def _saved(walks: Frame, feed: str) -> str:
    """Compare a feed with raw readings, walk by walk."""
    paired = walks.pivot(index=["speed", "seed"], columns="feed", values="fell").astype(bool)
    saved = int((paired["none"] & ~paired[feed]).sum())
    lost = int((~paired["none"] & paired[feed]).sum())
    p = stats.binomtest(min(saved, lost), saved + lost).pvalue if saved + lost else 1.0
    return (
        f": {saved} walks that fall on drifting raw CoP are saved and {lost} that do not fall on it are lost "
        f"(sign test p = {p:.2g})"
    )


def _tolerance(walks: Frame, severity: float) -> list[str]:
    """Say how wrong the raw CoP was for those who fell and for those who did not."""
    raw = walks[walks["feed"] == "none"]
    fell, stood = raw[raw["fell"]], raw[~raw["fell"]]
    if not len(fell) or not len(stood):
        return []
    off = [_amount(mean_interval(part["cop_error"]), 1e3, "mm") for part in (fell, stood)]
    return [
        f"Severity {severity:g}: the drifting raw CoP of walkers that fell was {off[0]} off up to the fall, "
        f"that of walkers that did not {off[1]}."
    ]


def sensitivity_findings(runs: Frame) -> tuple[str, ...]:
    """Say how far each weight moves the window's CoP error.

    Args:
        runs: As in :func:`surefoot.experiments.demo.tables.sensitivity_table`.
    """
    said = []
    for weight in dict.fromkeys(runs["weight"]):
        means = runs[runs["weight"] == weight].groupby(["speed", "factor"])["cop"].mean().unstack()
        if 1.0 not in means:
            continue
        ratio = means.div(means[1.0], axis=0)
        low, high = float(ratio.to_numpy().min()), float(ratio.to_numpy().max())
        said.append(
            f"{weight} from × {means.columns.min():g} to × {means.columns.max():g} moves the CoP error by "
            f"{100 * (low - 1):+.0f} to {100 * (high - 1):+.0f} % over all speeds."
        )
    return tuple(said)


def target_table(
    scores: Frame,
    loop: Frame,
    *,
    paper_condition: str,
    coefficient: float,
    bench: tuple[float, float],
    update_ms: float,
) -> Table:
    """Hold what was measured against what had been set out to be reached.

    Args:
        scores: As in :func:`surefoot.experiments.demo.tables.walking_table`.
        loop: As in :func:`surefoot.experiments.demo.tables.loop_table`.
        paper_condition: Name of the paper's conditions in ``scores``.
        coefficient: Largest relative difference to a coefficient of the paper's Table 2.
        bench: CoP rmse in m and vGRF rmse in N of the bench's held-out placements.
        update_ms: Median time of an update of the window in ms.
    """
    rows: list[tuple[str, str, str, str]] = []

    def row(what: str, target: str, measured: str, reached: bool) -> None:
        rows.append((what, target, measured, "yes" if reached else "no"))

    row("Table 2 coefficients, relative", "≤ 1e-8", f"{coefficient:.1e}", coefficient <= 1e-8)
    row("bench, held-out CoP (mm)", "≤ 0.5", number(1e3 * bench[0]), bench[0] <= 5e-4)
    row("bench, held-out vGRF (N)", "≤ 0.08", number(bench[1]), bench[1] <= 0.08)
    for speed, published in WALKING_TABLES.items():
        for metric, unit, factor in (("cop", "mm", 1e3), ("vgrf", "N", 1.0)):
            table = _pivot(scores, paper_condition, "baseline", speed, metric)
            if not {"window", "quasi-static"} <= set(table.columns):
                continue
            window = mean_interval(table["window"])
            limit = getattr(published["window"], metric)
            name = (
                f"window at {speed:g} m/s, {'CoP' if metric == 'cop' else 'vGRF'} against baseline ({unit})"
            )
            row(
                name, f"≤ {number(factor * limit)}", _amount(window, factor, "").strip(), window.mean <= limit
            )
            gap = mean_interval(table["quasi-static"] - table["window"])
            row(
                name.replace("against baseline", "less than Han's by"),
                "> 0",
                _amount(gap, factor, "").strip(),
                gap.mean > 0 and gap.apart,
            )
    row("one update of the window, median (ms)", "< 1", number(update_ms), update_ms < 1)
    for (severity, feed), part in loop.groupby(["severity", "feed"], sort=False):
        share = float(part["fell"].mean())
        name = f"severity {severity:g}, {_feed_name(feed)} CoP fed back: share that falls"
        if feed == "none":
            row(name, "> 50 %", f"{100 * share:.0f} %", share > 0.5)
        elif feed in ("window", "moment", "true"):
            row(name, "0 %", f"{100 * share:.0f} %", share == 0)
    return Table("targets", "Set out to reach", ("what", "target", "measured", "reached"), tuple(rows))


def _feed_name(feed: str) -> str:
    return {"true": "true", "none": "drifting raw"}.get(feed, f"{short_label(feed)}-calibrated")


def _amount(interval: Interval, factor: float, unit: str) -> str:
    mean = number(factor * interval.mean)
    decimals = len(mean.partition(".")[2])
    half = "" if np.isnan(interval.half) else f" ± {factor * interval.half:.{decimals}f}"
    return f"{mean}{half} {unit}"


def _difference(gap: Interval, factor: float, unit: str) -> str:
    word = "further off" if gap.mean > 0 else "nearer"
    sure = "" if gap.apart else ", which the interval does not tell from nothing"
    return f"{_amount(Interval(abs(gap.mean), gap.half, gap.n), factor, unit)} {word}{sure}"


def _verdict(change: Interval, worse: str, better: str) -> str:
    if not change.apart:
        return "no different from raw within the interval"
    return worse if change.mean > 0 else better
