"""Findings of a study of walks: what no table says, in sentences, and the numbers against its claims."""

from collections.abc import Iterator

from scipy import stats

from surefoot.experiments.study.figures import in_order, short_label
from surefoot.experiments.study.tables import (
    Claim,
    Frame,
    at_least,
    at_most,
    number,
    percent,
    plural,
    share,
    span,
    with_interval,
)
from surefoot.experiments.walks.scenarios import PLAIN, SPEEDS, Scenario
from surefoot.experiments.walks.tables import METRICS, consistent, seconds_text


def scenario_findings(scores: Frame, scenario: Scenario, left_out: int = 0) -> tuple[str, ...]:
    """Say how many walks ended in a fall, and whose forces were not finite: of one row a run."""
    part = scores[scores["scenario"] == scenario.name]
    if not len(part):
        return (f"No walk lasted long enough to be scored: {left_out} of {left_out} ended in a fall.",)
    said, falls, walks = [], int(part.drop_duplicates("seed")["fell"].sum()), part["seed"].nunique()
    if not part["finite"].all():
        broken = part[~part["finite"].astype(bool)].groupby("method").size()
        said.append(f"Runs in which a force was not finite: {broken.to_dict()}.")
    if falls or left_out:
        said.append(
            f"{falls + left_out} of {walks + left_out} walks ended in a fall "
            f"(scored up to 1 s before it: {falls}; left out: {left_out})."
        )
    return tuple(said)


def claims_of(scores: Frame) -> list[Claim]:
    """Return the claims about the moment filter, of a row a run; none if it was not run."""
    method = "moment"
    own = scores[scores["method"] == method]
    if not len(own):
        return []
    claims = []
    for speed in SPEEDS:
        here = scores[scores["scenario"] == f"speed-{speed:g}"]
        runs, window = (here[here["method"] == name] for name in (method, "window"))
        at = f"speed {speed:g} m/s, "
        for metric in METRICS if len(runs) else ():
            mean = metric.factor * float(runs[metric.column].mean())
            claims.append(at_most(at + metric.label, mean, metric.target, metric.cell(runs)))
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
    # In less than an hour none is what one an hour looks like as well.
    if hours >= 1.0:
        rate = float(own["alarms"].sum()) / hours
        claims.append(at_most(f"false alarms per hour (in {hours:.2f} h)", rate, 1.0))
    return claims


def loop_findings(runs: Frame) -> Iterator[str]:
    """Compare each feed with drifting readings, walk by walk: who is saved from a fall, and who is not."""
    for severity, walks in runs.groupby("severity", sort=False):
        fell = walks.pivot(index=["speed", "seed"], columns="feed", values="fell").astype(bool)
        for feed in in_order(fell.columns) if "none" in fell else ():
            if feed in ("true", "none"):
                continue
            saved = int((fell["none"] & ~fell[feed]).sum())
            lost = int((~fell["none"] & fell[feed]).sum())
            p = stats.binomtest(min(saved, lost), saved + lost).pvalue if saved + lost else 1.0
            yield (
                f"Severity {severity:g}, {short_label(feed)}-calibrated CoP: of those that fall on drifting "
                f"raw CoP it saves {saved}, of those that do not it loses {lost} (sign test p = {p:.2g})."
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
