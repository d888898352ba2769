"""Sentences that follow from the numbers: nothing in them is written before but their grammar."""

import numpy as np
from scipy import stats

from surefoot.experiments.demo.published import WALKING_TABLES
from surefoot.experiments.study.figures import in_order, short_label
from surefoot.experiments.study.statistics import Interval, mean_interval
from surefoot.experiments.study.tables import Frame, number, plural

__all__ = [
    "amount",
    "baseline_findings",
    "errors_of",
    "feed_name",
    "lead_finding",
    "loop_findings",
    "sensitivity_findings",
    "truth_findings",
]


def errors_of(scores: Frame, condition: str, against: str, speed: float, metric: str) -> Frame:
    """Return errors of one condition, yardstick and speed: one row a seed, one column a method."""
    part = scores[
        (scores["condition"] == condition) & (scores["against"] == against) & (scores["speed"] == speed)
    ]
    return part.pivot(index="seed", columns="method", values=metric)


def baseline_findings(scores: Frame, condition: str) -> tuple[str, ...]:
    """Return how the paper's method and the quasi-static one compare in the way that the paper scores.

    Args:
        scores: As in :func:`surefoot.experiments.demo.tables.walking_table`.
        condition: Name of the paper's conditions in ``scores``.
    """
    said = []
    for speed in sorted(scores["speed"].unique()):
        published = WALKING_TABLES.get(speed)
        table = {m: errors_of(scores, condition, "baseline", speed, m) for m in ("cop", "vgrf")}
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
            f"{amount(window, 1e3, 'mm')} from the baseline from weights{against_paper}; the quasi-static "
            f"method lies {_difference(gap, 1e3, 'mm')} in CoP and {_difference(force_gap, 1.0, 'N')} in "
            "vGRF."
        )
    return tuple(said)


def truth_findings(scores: Frame, condition: str, title: str) -> tuple[str, ...]:
    """Return which methods are better and which are worse than doing nothing, against the truth.

    Args:
        scores: As in :func:`surefoot.experiments.demo.tables.walking_table`.
        condition: Name of the condition in ``scores``.
        title: What to call it.
    """
    said = []
    for speed in sorted(scores["speed"].unique()):
        cop = errors_of(scores, condition, "truth", speed, "cop")
        if "none" not in cop:
            continue
        text = (
            f"{speed:g} m/s, {title}, against the truth: raw {amount(mean_interval(cop['none']), 1e3, 'mm')}"
        )
        if "floor" in cop:
            text += f" (floor {amount(mean_interval(cop['floor']), 1e3, 'mm')})"
        for method in in_order(cop.columns):
            if method in ("none", "baseline", "floor", "reference"):
                continue
            change = mean_interval(cop[method] - cop["none"])
            worse = int((cop[method] > cop["none"]).sum())
            text += (
                f"; {short_label(method)} {amount(mean_interval(cop[method]), 1e3, 'mm')}, "
                f"{_verdict(change, 'worse than raw', 'better than raw')} "
                f"(worse in {worse} of {len(cop)} seeds)"
            )
        said.append(text + "." + _reason(cop))
    return tuple(said)


def _reason(cop: Frame) -> str:
    """Return what window and quasi-static follow, if that is further from the truth than the readings."""
    if "reference" not in cop:
        return ""
    reference, raw = mean_interval(cop["reference"]), mean_interval(cop["none"])
    asked = amount(reference, 1e3, "mm")
    if reference.mean > raw.mean:
        return (
            f" The reference that window and quasi-static follow is itself {asked} off, further than the "
            "readings: following it leads away from the truth."
        )
    return f" The reference that window and quasi-static follow is {asked} off."


def loop_findings(runs: Frame, horizon: float) -> tuple[str, ...]:
    """Return who fell, paired by seed.

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
                f"Severity {severity:g}, {feed_name(feed)} CoP: {falls} of {len(part)} walks end in a fall "
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
        f"; of those that fall on drifting raw CoP it saves {saved}, of those that do not it loses {lost} "
        f"(sign test p = {p:.2g})"
    )


def _tolerance(walks: Frame, severity: float) -> list[str]:
    """Return how wrong the raw CoP was for those who fell and for those who did not."""
    raw = walks[walks["feed"] == "none"]
    fell, stood = raw[raw["fell"]], raw[~raw["fell"]]
    if not len(fell) or not len(stood):
        return []
    off = [amount(mean_interval(part["cop_error"]), 1e3, "mm") for part in (fell, stood)]
    return [
        f"Severity {severity:g}: the drifting raw CoP of walkers that fell was {off[0]} off up to the fall, "
        f"that of walkers that did not {off[1]}."
    ]


def sensitivity_findings(runs: Frame) -> tuple[str, ...]:
    """Return how far each weight moves the window's CoP error.

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


def lead_finding(loop: Frame) -> str:
    """Return what the closed loops of one severity show, in one sentence."""
    falls = {feed: int(part["fell"].sum()) for feed, part in loop.groupby("feed", sort=False)}
    walks = int((loop["feed"] == "none").sum())
    names = {"true": "the true CoP", "moment": "that of feet that the moment filter calibrates"}
    others = [f"{name} in {falls[feed]}" for feed, name in names.items() if feed in falls]
    return (
        f"The same robot, walk and controller on load cells that are {loop['severity'].iloc[0]:g} times as "
        f"bad as cheap ones: fed the raw CoP the robot falls in {falls['none']} of {plural(walks, 'walk')}, "
        f"fed {' and '.join(others)}."
    )


def feed_name(feed: str) -> str:
    """Return what to call the CoP that is fed back."""
    return {"true": "true", "none": "drifting raw"}.get(feed, f"{short_label(feed)}-calibrated")


def amount(interval: Interval, factor: float, unit: str) -> str:
    """Return a mean with its interval and its unit."""
    mean = number(factor * interval.mean)
    decimals = len(mean.partition(".")[2])
    half = "" if np.isnan(interval.half) else f" ± {factor * interval.half:.{decimals}f}"
    return f"{mean}{half} {unit}"


def _difference(gap: Interval, factor: float, unit: str) -> str:
    word = "further off" if gap.mean > 0 else "nearer"
    sure = "" if gap.apart else ", which is no clear difference"
    return f"{amount(Interval(abs(gap.mean), gap.half, gap.n), factor, unit)} {word}{sure}"


def _verdict(change: Interval, worse: str, better: str) -> str:
    if not change.apart:
        return "no different from raw within the interval"
    return worse if change.mean > 0 else better
