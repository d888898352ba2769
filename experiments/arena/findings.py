"""What the numbers of the comparison say, in sentences that are made of them."""

import numpy as np

from surefoot.experiments.arena.options import TRUE_MAP
from surefoot.experiments.arena.scenarios import PLAIN, Scenario
from surefoot.experiments.study.figures import in_order, short_label
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import Frame, number, plural, with_interval

__all__ = ["scenario_findings", "summary_findings"]

START = "none"
"""The method that leaves the readings as the starting map gives them."""


def scenario_findings(scores: Frame, scenario: Scenario, left_out: int = 0) -> tuple[str, ...]:
    """Return what a scenario shows.

    Args:
        scores: One row a run, of all scenarios.
        scenario: Which one.
        left_out: Walks that ended in a fall before they were worth a score.
    """
    part = scores[scores["scenario"] == scenario.name]
    if not len(part):
        return (f"No walk lasted long enough to be scored: {left_out} of {left_out} ended in a fall.",)
    errors = part.pivot(index="seed", columns="method", values="cop")
    said = [_ranking(errors)]
    said += [_method(part, errors, m) for m in in_order(errors) if m not in (TRUE_MAP, START)]
    special = scenario.name != PLAIN and not scenario.faults
    if special and (scores["scenario"] == PLAIN).any():
        said.append(_against_plain(scores, part))
    if scenario.faults:
        said += _faults(part)
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
        runs = scores[scores["method"] == method]
        leads = int((best == method).sum())
        text = f"{short_label(method)}: the smallest mean CoP error in {leads} of {len(means)} scenarios"
        if method != START:
            text += f"; {_harm(runs)}"
        said.append(text + ".")
    return tuple(said)


def _ranking(errors: Frame) -> str:
    """Return who is nearest to the truth, and whether that is clear of the next."""
    methods = [m for m in errors.columns if m != TRUE_MAP]
    ranked = sorted(methods, key=lambda m: float(errors[m].mean()))
    if not ranked:
        return "Only the true map was run."
    best = ranked[0]
    text = (
        f"Nearest to the truth is {short_label(best)} with {with_interval(errors[best], 1e3)} mm of CoP error"
    )
    if TRUE_MAP in errors:
        text += f" (true map {with_interval(errors[TRUE_MAP], 1e3)} mm)"
    if len(ranked) > 1:
        gap = mean_interval(errors[ranked[1]] - errors[best])
        lead = with_interval(errors[ranked[1]] - errors[best], 1e3)
        text += f"; {short_label(ranked[1])} is {lead} mm further off"
        if not gap.mean > gap.half:
            text += ", which is no clear difference"
    return text + "."


def _method(part: Frame, errors: Frame, method: str) -> str:
    runs = part[part["method"] == method]
    text = f"{short_label(method)}: CoP {with_interval(errors[method], 1e3)} mm"
    if START in errors:
        text += f", {_change(errors, method)}"
    text += f"; vGRF {with_interval(runs['vgrf'])} N; cells {with_interval(runs['cell'])} N; {_harm(runs)}"
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
    worse, cells = int(runs["worse"].sum()), int(runs["worse_cell"].sum())
    if worse == 0:
        text = f"none of {len(runs)} runs ends with a worse CoP than it started with"
    else:
        verb = "ends" if worse == 1 else "end"
        text = f"{worse} of {len(runs)} runs {verb} with a worse CoP than the starting map's"
    return text + (f" ({cells} with worse cells)" if cells else "")


def _against_plain(scores: Frame, part: Frame) -> str:
    """Return what the scenario costs each method against plain walking."""
    plain = scores[scores["scenario"] == PLAIN]
    pieces = []
    for method in in_order(part["method"]):
        here = part[part["method"] == method]["cop"].mean()
        there = plain[plain["method"] == method]["cop"].mean()
        if method not in (TRUE_MAP, START) and np.isfinite(there) and there > 0:
            pieces.append(f"{short_label(method)} {number(float(here / there))}")
    return f"CoP error over that of plain walking at 0.04 m/s: {', '.join(pieces)}."


def _faults(part: Frame) -> list[str]:
    said = []
    for method in in_order(part["method"]):
        runs = part[part["method"] == method]
        if method in (TRUE_MAP, START):
            continue
        found = runs["found"].to_numpy()
        within = int((found <= 1.0).sum())
        text = f"{short_label(method)}: the fault is found within 1 s in {within} of {len(runs)} runs"
        if np.isfinite(found).any():
            text += f" (median {number(float(np.median(found[np.isfinite(found)])))} s where it is found)"
            text += f", the right cell alone is accused in {int(runs['isolated'].sum())}"
        said.append(text + f"; CoP afterwards {with_interval(runs['after'], 1e3)} mm.")
    return said
