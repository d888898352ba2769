"""Sentences that follow from the numbers: nothing in them is written before but their grammar."""

from collections.abc import Iterator

from scipy import stats

from surefoot.experiments.study.figures import by_way, in_order, short_label
from surefoot.experiments.study.statistics import Interval, mean_interval
from surefoot.experiments.study.tables import (
    Claim,
    Column,
    Frame,
    at_most,
    interval_text,
    number,
    plural,
    with_interval,
)
from surefoot.experiments.walks.paper import METRICS, WALKING_TABLES


def errors_of(scores: Frame, condition: str, against: str, speed: float, metric: str) -> Frame:
    """Return errors of one condition, yardstick and speed: one row a seed, one column a method."""
    chosen = (scores["condition"] == condition) & (scores["against"] == against) & (scores["speed"] == speed)
    return scores[chosen].pivot(index="seed", columns="method", values=metric)


def baseline_findings(scores: Frame, condition: str) -> Iterator[str]:
    """Say how the window and the quasi-static method compare in the paper's conditions and scoring."""
    for speed in sorted(scores["speed"].unique()):
        cop, vgrf = (errors_of(scores, condition, "baseline", speed, metric) for metric in ("cop", "vgrf"))
        if not {"window", "quasi-static"} <= set(cop.columns):
            continue
        against_paper = ""
        if speed in WALKING_TABLES:
            printed = WALKING_TABLES[speed]["window"].cop
            word = "under" if float(cop["window"].mean()) <= printed else "over"
            against_paper = f" ({word} the paper's {number(1e3 * printed)} mm)"
        yield (
            f"{speed:g} m/s, the paper's conditions and scoring: the window is {_mm(cop['window'])} from the "
            f"baseline from weights{against_paper}; the quasi-static method lies "
            f"{_difference(cop['quasi-static'] - cop['window'], 1e3, 'mm')} in CoP and "
            f"{_difference(vgrf['quasi-static'] - vgrf['window'], 1.0, 'N')} in vGRF."
        )


def truth_findings(scores: Frame, condition: str, title: str) -> Iterator[str]:
    """Say which methods are better and which are worse than doing nothing, against the truth."""
    for speed in sorted(scores["speed"].unique()):
        cop = errors_of(scores, condition, "truth", speed, "cop")
        if "none" not in cop:
            continue
        text = f"{speed:g} m/s, {title}, against the truth: raw {_mm(cop['none'])}"
        if "floor" in cop:
            text += f" (floor {_mm(cop['floor'])})"
        for method in in_order(cop.columns):
            if method in ("none", "baseline", "floor", "reference"):
                continue
            change = mean_interval(cop[method] - cop["none"])
            verdict = "no different from raw within the interval"
            if change.apart:
                verdict = "worse than raw" if change.mean > 0 else "better than raw"
            worse = int((cop[method] > cop["none"]).sum())
            text += f"; {short_label(method)} {_mm(cop[method])}, {verdict} "
            text += f"(worse in {worse} of {len(cop)} seeds)"
        text += "."
        if "reference" in cop:
            # What window and quasi-static follow may be further from the truth than the readings.
            astray = cop["reference"].mean() > cop["none"].mean()
            off = f"{'itself ' if astray else ''}{_mm(cop['reference'])} off"
            why = ", further than the readings: following it leads away from the truth" if astray else ""
            text += f" The reference that window and quasi-static follow is {off}{why}."
        yield text


def loop_findings(runs: Frame, horizon: float) -> Iterator[str]:
    """Say who fell within a time in s, paired by seed."""
    for severity, walks in runs.groupby("severity", sort=False):
        for feed, part in by_way(walks, "feed").items():
            text = (
                f"Severity {severity:g}, {feed_name(feed)} CoP: {int(part['fell'].sum())} of {len(part)} "
                f"walks end in a fall within {horizon:g} s"
            )
            if feed not in ("true", "none") and "none" in set(walks["feed"]):
                text += _saved(walks, feed)
            yield text + "."
        # How wrong the raw CoP was for those who fell and for those who did not.
        raw = walks[walks["feed"] == "none"]
        fell, stood = raw[raw["fell"]]["cop_error"], raw[~raw["fell"]]["cop_error"]
        if len(fell) and len(stood):
            yield (
                f"Severity {severity:g}: the drifting raw CoP of walkers that fell was {_mm(fell)} off up to "
                f"the fall, that of walkers that did not {_mm(stood)}."
            )


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


def sensitivity_findings(runs: Frame) -> Iterator[str]:
    """Say how far each weight moves the window's CoP error."""
    for weight, part in runs.groupby("weight", sort=False):
        means = part.groupby(["speed", "factor"])["cop"].mean().unstack()
        if 1.0 in means:
            ratio = means.div(means[1.0], axis=0).to_numpy()
            yield (
                f"{weight} from × {means.columns.min():g} to × {means.columns.max():g} moves the CoP error "
                f"by {100 * (ratio.min() - 1):+.0f} to {100 * (ratio.max() - 1):+.0f} % over all speeds."
            )


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


def _mm(errors: Column) -> str:
    return f"{with_interval(errors, 1e3)} mm"


def _difference(gaps: Column, factor: float, unit: str) -> str:
    gap = mean_interval(gaps)
    word = "further off" if gap.mean > 0 else "nearer"
    sure = "" if gap.apart else ", which is no clear difference"
    return f"{interval_text(Interval(abs(gap.mean), gap.half, gap.n), factor)} {unit} {word}{sure}"


_CALIBRATED = ("window", "moment", "true")  # feeds that nobody was to fall on


def weight_claims(coefficient: float, cop: float, vgrf: float) -> list[Claim]:
    """Return the claims about known weights: of a relative difference, CoP rmse in m, vGRF rmse in N."""
    return [
        Claim("Table 2 coefficients, relative", "≤ 1e-8", f"{coefficient:.1e}", coefficient <= 1e-8),
        Claim("known weights, held-out CoP (mm)", "≤ 0.5", number(1e3 * cop), cop <= 5e-4),
        at_most("known weights, held-out vGRF (N)", vgrf, 0.08),
    ]


def walking_claims(scores: Frame, condition: str, update_ms: float) -> list[Claim]:
    """Return the claims about the window, against the paper and quasi-static, and about an update in ms."""
    claims = []
    for speed, published in WALKING_TABLES.items():
        for metric, title, unit, factor in METRICS:
            table = errors_of(scores, condition, "baseline", speed, metric)
            if not {"window", "quasi-static"} <= set(table.columns):
                continue
            window, limit = mean_interval(table["window"]), getattr(published["window"], metric)
            name, shown = f"window at {speed:g} m/s, {title}", interval_text(window, factor)
            aim = f"≤ {number(factor * limit)}"
            claims.append(Claim(f"{name} against baseline ({unit})", aim, shown, window.mean <= limit))
            gap = mean_interval(table["quasi-static"] - table["window"])
            what = f"{name} less than quasi-static by ({unit})"
            claims.append(Claim(what, "> 0", interval_text(gap, factor), gap.mean > 0 and gap.apart))
    what = "one update of the window, median (ms)"
    return [*claims, Claim(what, "< 1", number(update_ms), update_ms < 1)]


def loop_claims(loop: Frame) -> list[Claim]:
    """Return the claims about who falls in the closed loop."""
    claims = []
    for (severity, feed), part in loop.groupby(["severity", "feed"], sort=False):
        share = float(part["fell"].mean())
        what = f"severity {severity:g}, {feed_name(feed)} CoP fed back: share that falls"
        shown = f"{100 * share:.0f} %"
        if feed == "none":
            claims.append(Claim(what, "> 50 %", shown, share > 0.5))
        elif feed in _CALIBRATED:
            claims.append(Claim(what, "0 %", shown, share == 0))
    return claims
