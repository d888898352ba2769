"""What the moment filter was set out to reach in the comparison, and whether it does."""

from surefoot.experiments.arena.scenarios import PLAIN, SPEEDS
from surefoot.experiments.arena.tables import consistent, seconds_text
from surefoot.experiments.study.claims import Claim, at_least, at_most
from surefoot.experiments.study.tables import Frame, number, with_interval

_METRICS = (
    ("cop", "CoP rmse (mm)", 2.0, 1e3),
    ("vgrf", "vGRF rmse (N)", 0.4, 1.0),
    ("cell", "single cell rmse (N)", 0.4, 1.0),
)


def claims_of(scores: Frame, timing: Frame, method: str = "moment") -> list[Claim]:
    """Return the claims about a method, from one row a run and one a method; none if it was not run."""
    own = scores[scores["method"] == method]
    if not len(own):
        return []
    claims = []
    for speed in SPEEDS:
        here = scores[scores["scenario"] == f"speed-{speed:g}"]
        runs, window = (here[here["method"] == name] for name in (method, "window"))
        at = f"speed {speed:g} m/s, "
        for metric, unit, limit, factor in _METRICS if len(runs) else ():
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
        claims.append(Claim("NEES", f"{number(low)} to {number(high)}", number(mean), low <= mean <= high))
    worse = int(own["worse"].sum())
    what = "runs that end worse than the start, all scenarios"
    claims.append(Claim(what, "0", f"{worse} of {len(own)}", worse == 0))
    faulty = own[own["after"].notna()]
    if len(faulty):
        share = float((faulty["found"] <= 1.0).mean())
        claims.append(Claim("faults found within 1 s", "≥ 95 %", f"{100 * share:.0f} %", share >= 0.95))
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
