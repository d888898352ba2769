"""What was set out to reach in the CoP paper's study, and whether it was."""

from surefoot.experiments.demo.findings import errors_of, feed_name
from surefoot.experiments.demo.published import WALKING_TABLES
from surefoot.experiments.study.claims import Claim, at_most
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import Frame, interval_text, number

_METRICS = (("cop", "CoP", "mm", 1e3), ("vgrf", "vGRF", "N", 1.0))

_CALIBRATED = ("window", "moment", "true")
"""Feeds that nobody was to fall on."""


def weight_claims(coefficient: float, cop: float, vgrf: float) -> list[Claim]:
    """Return the claims about known weights.

    From the largest relative difference to a coefficient of Table 2, and the CoP rmse in m and the vGRF rmse
    in N of held-out placements.
    """
    return [
        Claim("Table 2 coefficients, relative", "≤ 1e-8", f"{coefficient:.1e}", coefficient <= 1e-8),
        Claim("known weights, held-out CoP (mm)", "≤ 0.5", number(1e3 * cop), cop <= 5e-4),
        at_most("known weights, held-out vGRF (N)", vgrf, 0.08),
    ]


def walking_claims(scores: Frame, condition: str, update_ms: float) -> list[Claim]:
    """Return the claims about the window while walking: against the paper's numbers and quasi-static.

    From the scores of :func:`surefoot.experiments.demo.tables.walking_table` in the paper's conditions, and
    the median time of an update in ms.
    """
    claims = []
    for speed, published in WALKING_TABLES.items():
        for metric, title, unit, factor in _METRICS:
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
