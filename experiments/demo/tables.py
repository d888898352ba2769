"""Tables of the CoP paper's study: its 4 to 6 with its numbers beside ours, closed loops, and its weights."""

from collections.abc import Sequence

from surefoot.experiments.demo.published import WALKING_TABLES
from surefoot.experiments.study.figures import in_order, look_of
from surefoot.experiments.study.statistics import mean_interval, survival
from surefoot.experiments.study.tables import Column, Frame, Table, Verdict, number, plural, with_interval

__all__ = ["lead_table", "loop_table", "sensitivity_table", "walking_table"]

PAPER_TABLE_NUMBER = {0.02: "4", 0.04: "5", 0.1: "6"}


def lead_table(yardsticks: Frame, loop: Frame, condition: str, title: str) -> Table:
    """Return what one wants to know first: how far off each way to read the feet is, and who falls.

    Args:
        yardsticks: As in :func:`walking_table`.
        loop: As in :func:`loop_table`, of one severity.
        condition: Name of the condition in ``yardsticks``.
        title: Title of the table.
    """
    own = yardsticks[(yardsticks["condition"] == condition) & (yardsticks["against"] == "truth")]
    raw = int(loop[loop["feed"] == "none"]["fell"].sum())
    rows = []
    for feed in in_order(loop["feed"]):
        errors, walks = own[own["method"] == feed], loop[loop["feed"] == feed]
        falls = int(walks["fell"].sum())
        said = f"{falls} of {len(walks)}"
        rows.append(
            (
                look_of(feed).label,
                with_interval(errors["cop"], 1e3) if len(errors) else "0",
                with_interval(errors["vgrf"]) if len(errors) else "0",
                said if falls == raw else Verdict.of(falls < raw, said),
            )
        )
    columns = ("what reads the feet", "CoP off by (mm)", "vertical force off by (N)", "walks that fall")
    note = (
        "Errors while walking at the bad start, rms from the settling time on. Falls: the controller is fed "
        f"the CoP of cells that are {loop['severity'].iloc[0]:g} times as bad; green, fewer than on raw "
        "readings."
    )
    return Table("lead", title, columns, tuple(rows), note)


def walking_table(scores: Frame, speed: float, conditions: Sequence[tuple[str, str]]) -> Table:
    """Return one speed as the paper's Tables 4 to 6, with the truth beside the paper's baseline.

    Args:
        scores: One row a walk, method and yardstick: ``condition``, ``speed``, ``seed``, ``method``,
            ``against`` (``"baseline"`` or ``"truth"``), ``cop`` (m), ``vgrf`` (N), ``cell`` (N).
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
        f"rmse, mean ± 95 % interval over {plural(here['seed'].nunique(), 'seed')}. "
        "* By construction: these readings are the baseline."
    )
    return Table(f"walking_{speed:g}".replace(".", "_"), title, columns, tuple(rows), note)


def _against_baseline(values: Column, factor: float) -> str:
    if len(values) and float(values.max()) < 1e-9:
        return "0 *"
    return with_interval(values, factor)


def loop_table(runs: Frame, horizon: float) -> Table:
    """Return the closed loop: who fell, and when.

    Args:
        runs: One row a walk: ``severity``, ``speed``, ``seed``, ``feed``, ``fell``, ``time`` (s),
            ``cop_error`` (m) of what was fed back against the truth, ``tracking`` (m) of the true centre of
            pressure against its plan.
        horizon: End of a walk in s.
    """
    rows = []
    for (severity, speed), walks in runs.groupby(["severity", "speed"], sort=False):
        for feed in in_order(walks["feed"]):
            part = walks[walks["feed"] == feed]
            curve = survival(part["time"], part["fell"])
            halved = curve.time[curve.share <= 0.5]
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
    """Return how far the window's errors move with its weights.

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
                change = f"{100 * (min(means) / base - 1):+.0f} to {100 * (max(means) / base - 1):+.0f} %"
                rows.append((weight, f"{speed:g}", unit, *map(number, means), change))
    columns = ("weight", "speed (m/s)", "rmse", *(f"× {factor:g}" for factor in factors), "change")
    name = "sensitivity_" + title.partition(",")[0].replace(" ", "_").replace("'", "")
    return Table(name, f"The window's weights, each scaled alone: {title}", columns, tuple(rows))
