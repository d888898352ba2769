"""Findings of a study of walks: in sentences that are made of them, and against its claims."""

from collections.abc import Iterator

import numpy as np
from scipy import stats

from surefoot.experiments.study.figures import by_way, in_order, short_label
from surefoot.experiments.study.statistics import Interval, mean_interval
from surefoot.experiments.study.tables import (
    Claim,
    Column,
    Frame,
    at_least,
    at_most,
    decimal,
    interval_text,
    number,
    percent,
    plural,
    share,
    span,
    with_interval,
)
from surefoot.experiments.walks.options import TRUE_MAP
from surefoot.experiments.walks.scenarios import PLAIN, SPEEDS, Scenario
from surefoot.experiments.walks.tables import METRICS, PAPER_METRICS, WALKING_TABLES, consistent, seconds_text

START = "none"  # the method that leaves the readings as the starting map gives them
_CALIBRATED = ("window", "moment", "true")  # feeds that nobody was to fall on


def scenario_findings(scores: Frame, scenario: Scenario, left_out: int = 0) -> tuple[str, ...]:
    """Sentences about a scenario, from one row a run of all of them, and from how many were left out."""
    part = scores[scores["scenario"] == scenario.name]
    if not len(part):
        return (f"No walk lasted long enough to be scored: {left_out} of {left_out} ended in a fall.",)
    errors = part.pivot(index="seed", columns="method", values="cop")
    methods = {name: runs for name, runs in by_way(part).items() if name not in (TRUE_MAP, START)}
    said = [_ranking(errors), *(_method(runs, errors, name) for name, runs in methods.items())]
    if scenario.faults:
        said += [_fault(runs, name) for name, runs in methods.items()]
    elif scenario.name != PLAIN and (scores["scenario"] == PLAIN).any():
        plain = scores[scores["scenario"] == PLAIN].groupby("method")["cop"].mean()
        ratios = {name: runs["cop"].mean() / plain.get(name, np.nan) for name, runs in methods.items()}
        pieces = [f"{short_label(name)} {number(float(r))}" for name, r in ratios.items() if np.isfinite(r)]
        said.append(f"CoP error over that of plain walking at 0.04 m/s: {', '.join(pieces)}.")
    falls = int(part.drop_duplicates("seed")["fell"].sum())
    if falls or left_out:
        said.append(
            f"{falls + left_out} of {len(errors) + left_out} walks ended in a fall "
            f"(scored up to 1 s before it: {falls}; left out: {left_out})."
        )
    return tuple(said)


def summary_findings(scores: Frame) -> tuple[str, ...]:
    """Return for every method in how many scenarios it leads, and whether it ever did harm."""
    healthy = scores[(scores["after"].isna()) & (scores["method"] != TRUE_MAP)]
    means = healthy.groupby(["scenario", "method"])["cop"].mean().unstack().dropna(how="all")
    best = means.idxmin(axis=1)
    said = []
    for method in in_order(means.columns):
        harm = "" if method == START else f"; {_harm(scores[scores['method'] == method])}"
        said.append(
            f"{short_label(method)}: the smallest mean CoP error in {int((best == method).sum())} of "
            f"{len(means)} scenarios{harm}."
        )
    return tuple(said)


def _ranking(errors: Frame) -> str:
    """Return who is nearest to the truth, and whether that is clear of the next."""
    ranked = sorted((m for m in errors.columns if m != TRUE_MAP), key=lambda m: float(errors[m].mean()))
    if not ranked:
        return "Only the true map was run."
    best = ranked[0]
    error = with_interval(errors[best], 1e3)
    text = f"Nearest to the truth is {short_label(best)} with {error} mm of CoP error"
    if TRUE_MAP in errors:
        text += f" (true map {with_interval(errors[TRUE_MAP], 1e3)} mm)"
    if len(ranked) > 1:
        gap = errors[ranked[1]] - errors[best]
        text += f"; {short_label(ranked[1])} is {with_interval(gap, 1e3)} mm further off"
        if not mean_interval(gap).mean > mean_interval(gap).half:
            text += ", which is no clear difference"
    return text + "."


def _method(runs: Frame, errors: Frame, method: str) -> str:
    text = f"{short_label(method)}: CoP {with_interval(errors[method], 1e3)} mm"
    if START in errors:
        text += f", {_change(errors, method)}"
    text += f"; a foot's CoP {with_interval(runs['cop_foot'], 1e3)} mm; vGRF {with_interval(runs['vgrf'])} N"
    text += f"; cells {with_interval(runs['cell'])} N; {_harm(runs)}"
    limits = runs["bound_cop"]
    if limits.notna().any():
        text += f"; {number(float((runs['cop'] / limits).mean()))} times the bound"
    if not runs["finite"].all():
        text += f"; in {plural(int((~runs['finite'].astype(bool)).sum()), 'run')} a force was not finite"
    return text + "."


def _change(errors: Frame, method: str) -> str:
    """Compare with the readings as they are, run by run."""
    change = mean_interval(errors[START] - errors[method])
    ratio = float(errors[START].mean() / errors[method].mean())
    if not abs(change.mean) > change.half:
        return "no clear difference to the readings as they are"
    if change.mean > 0:
        return f"{number(ratio)} times smaller than by the starting map"
    return f"{number(1.0 / ratio)} times LARGER than by the starting map"


def _harm(runs: Frame) -> str:
    worse, feet, cells = (int(runs[name].sum()) for name in ("worse", "worse_foot", "worse_cell"))
    if worse == 0:
        text = f"none of {len(runs)} runs ends with a worse CoP than it started with"
    else:
        verb = "ends" if worse == 1 else "end"
        text = f"{worse} of {len(runs)} runs {verb} with a worse CoP than the starting map's"
    return text + (f" ({feet} with worse feet, {cells} with worse cells)" if feet or cells else "")


def _fault(runs: Frame, method: str) -> str:
    found = runs["found"][np.isfinite(runs["found"])]
    within = int((runs["found"] <= 1.0).sum())
    text = f"{short_label(method)}: the fault is found within 1 s in {within} of {len(runs)} runs"
    if len(found):
        text += f" (median {number(float(found.median()))} s where it is found)"
        text += f", the right cell alone is accused in {int(runs['isolated'].sum())}"
    return f"{text}; CoP afterwards {with_interval(runs['after'], 1e3)} mm."


def claims_of(scores: Frame, timing: Frame) -> list[Claim]:
    """Return the claims about the moment filter, of a row a run and one a method; none if it was not run."""
    method = "moment"
    own = scores[scores["method"] == method]
    if not len(own):
        return []
    claims = []
    for speed in SPEEDS:
        here = scores[scores["scenario"] == f"speed-{speed:g}"]
        runs, window = (here[here["method"] == name] for name in (method, "window"))
        at = f"speed {speed:g} m/s, "
        for metric, factor, unit, limit in METRICS if len(runs) else ():
            mean = factor * float(runs[metric].mean())
            claims.append(at_most(at + unit, mean, limit, with_interval(runs[metric], factor)))
        if len(runs) and len(window):
            ratio = float(window["cop"].mean() / runs["cop"].mean())
            claims.append(at_least(f"{at}window's CoP error over its", ratio, 4.0))
    plain = own[own["scenario"] == PLAIN]
    if len(plain):
        taken = float(plain["converged"].quantile(0.95))
        what = "time to within twice the final error (s), 95 % of runs"
        claims.append(at_most(what, taken, 10.0, seconds_text(taken)))
    if plain["nees_end"].notna().any():
        low, high = consistent(plain)
        mean = float(plain["nees_end"].mean())
        claims.append(Claim("NEES", span(low, high, "#.3g"), number(mean), low <= mean <= high))
    worse = int(own["worse"].sum())
    what = "runs that end worse than the start, all scenarios"
    claims.append(Claim(what, number(0.0), share(worse, len(own)), worse == 0))
    faulty = own[own["after"].notna()]
    if len(faulty):
        found = float((faulty["found"] <= 1.0).mean())
        claims.append(Claim("faults found within 1 s", "≥ 95 %", percent(found), found >= 0.95))
        after = 1e3 * float(faulty["after"].mean())
        claims.append(at_most("CoP after a fault (mm)", after, 6.0, with_interval(faulty["after"], 1e3)))
    hours = float(own["hours"].sum())
    rate = float(own["alarms"].sum()) / hours
    claims.append(at_most(f"false alarms per hour (in {hours:.2f} h)", rate, 1.0))
    times = timing.set_index("method")
    if method in times.index:
        median = float(times.loc[method, "median_us"])
        claims.append(at_most("one update of one robot, median (µs)", median, 100.0))
        if "window" in times.index:
            ratio = float(times.loc["window", "mean_us"] / times.loc[method, "mean_us"])
            claims.append(at_least("window's time per sample over its", ratio, 10.0))
    return claims


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


def reference_findings(scores: Frame) -> Iterator[str]:
    """Say how far the reference that window and quasi-static follow is from the truth."""
    for (condition, speed), part in scores[scores["against"] == "truth"].groupby(["condition", "speed"]):
        errors = {method: part[part["method"] == method]["cop"] for method in ("reference", "none")}
        if all(map(len, errors.values())) and errors["reference"].mean() > errors["none"].mean():
            yield (
                f"{speed:g} m/s, condition '{condition}': the reference that window and quasi-static follow "
                f"is itself {_mm(errors['reference'])} off, further than the readings: following it leads "
                "away from the truth."
            )


def loop_findings(runs: Frame, horizon: float) -> Iterator[str]:
    """Say who fell within a time in s, paired by seed."""
    for severity, walks in runs.groupby("severity", sort=False):
        for feed, part in by_way(walks, "feed").items():
            text = (
                f"Severity {severity:g}, {feed_name(feed)} CoP: {int(part['fell'].sum())} of {len(part)} "
                f"walks end in a fall within {horizon:g} s"
            )
            if feed not in ("true", "none") and "none" in set(walks["feed"]):
                text += _compare_falls(walks, feed)
            yield text + "."
        # How wrong the raw CoP was for those who fell and for those who did not.
        raw = walks[walks["feed"] == "none"]
        fell, stood = raw[raw["fell"]]["cop_error"], raw[~raw["fell"]]["cop_error"]
        if len(fell) and len(stood):
            yield (
                f"Severity {severity:g}: the drifting raw CoP of walkers that fell was {_mm(fell)} off up to "
                f"the fall, that of walkers that did not {_mm(stood)}."
            )


def _compare_falls(walks: Frame, feed: str) -> str:
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
    """One sentence about the closed loops of one severity."""
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
    """Name of the CoP that is fed back."""
    return {"true": "true", "none": "drifting raw"}.get(feed, f"{short_label(feed)}-calibrated")


def _mm(errors: Column) -> str:
    return f"{with_interval(errors, 1e3)} mm"


def _difference(gaps: Column, factor: float, unit: str) -> str:
    gap = mean_interval(gaps)
    word = "further off" if gap.mean > 0 else "nearer"
    sure = "" if gap.apart else ", which is no clear difference"
    return f"{interval_text(Interval(abs(gap.mean), gap.half, gap.n), factor)} {unit} {word}{sure}"


def weight_claims(coefficient: float, cop: float, vgrf: float) -> list[Claim]:
    """Return the claims about known weights: of a relative difference, CoP rmse in m, vGRF rmse in N."""
    return [
        at_most("Table 2 coefficients, relative", coefficient, 1e-8, decimal(coefficient, ".1e")),
        at_most("known weights, held-out CoP (mm)", 1e3 * cop, 0.5),
        at_most("known weights, held-out vGRF (N)", vgrf, 0.08),
    ]


def walking_claims(scores: Frame, condition: str, update_ms: float) -> list[Claim]:
    """Return the claims about the window, against the paper and quasi-static, and about an update in ms."""
    claims = []
    for speed, published in WALKING_TABLES.items():
        for metric, title, unit, factor in PAPER_METRICS:
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
        fell = float(part["fell"].mean())
        what = f"severity {severity:g}, {feed_name(feed)} CoP fed back: share that falls"
        if feed == "none":
            claims.append(Claim(what, "> 50 %", percent(fell), fell > 0.5))
        elif feed in _CALIBRATED:
            claims.append(Claim(what, percent(0.0), percent(fell), fell == 0))
    return claims
