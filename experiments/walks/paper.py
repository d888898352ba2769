"""Tables of the CoP paper's study, and what the paper (PMC12899417) printed in its Tables 2 to 6."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from surefoot.calibration.layout import nao_shoe_layout
from surefoot.experiments.study.figures import by_way, look_of
from surefoot.experiments.study.statistics import mean_interval, survival
from surefoot.experiments.study.tables import (
    Cell,
    Frame,
    Table,
    Verdict,
    count_of,
    laid_out,
    mean_of,
    number,
    plural,
    with_interval,
)


class WeightTable(NamedTuple):
    """Codes of eight cells under known loads and the lines through them, as in Table 2."""

    channel_names: tuple[str, ...]
    load: np.ndarray  # in kg, shape (n,)
    code: np.ndarray  # of the converters, shape (8, n)
    scale: np.ndarray  # in kg per count, shape (8,)
    offset: np.ndarray  # in kg, shape (8,)


class MethodErrors(NamedTuple):
    """Root-mean-square errors of the centre of pressure in m and of the vertical force in N."""

    cop: float
    vgrf: float


TABLE_2 = WeightTable(
    channel_names=nao_shoe_layout().channel_names,
    load=np.array([0.0, 0.01, 0.05, 0.2]),
    code=np.array(
        [
            [8347750, 8344582, 8326926, 8264253],
            [8347750, 8344582, 8301298, 8264254],
            [8322914, 8317325, 8301301, 8264263],
            [8322914, 8317325, 8301299, 8264278],
            [8322914, 8317426, 8301297, 8264254],
            [8322914, 8317356, 8301289, 8264261],
            [8322914, 8317320, 8301299, 8264262],
            [8321583, 8317321, 8301297, 8264267],
        ],
        dtype=np.float64,
    ),
    scale=np.array(
        [-2.38250654, -2.20853048, -3.47692594, -3.47779548, -3.4736872, -3.47589563, -3.47698378, -3.5299719]
    )
    * 1e-6,
    offset=np.array(
        [19.8895457, 18.4277626, 28.9285295, 28.9357592, 28.9017197, 28.9199912, 28.9290027, 29.3677097]
    ),
)
"""The paper's weighing. Six of the eight cells share one code for no load; two rows share three codes."""

TABLE_3 = {"initial": MethodErrors(0.1839, 5.298), "calibrated": MethodErrors(0.0005, 0.08)}
"""Before and after the paper's manual calibration from weights."""

WALKING_TABLES = {
    0.02: {"window": MethodErrors(0.0059, 0.4339), "quasi-static": MethodErrors(0.0108, 1.2949)},
    0.04: {"window": MethodErrors(0.0108, 0.5324), "quasi-static": MethodErrors(0.0166, 1.8646)},
    0.1: {"window": MethodErrors(0.0134, 1.0387), "quasi-static": MethodErrors(0.0199, 2.5220)},
}
"""Tables 4 to 6 by walking speed in m/s, against the paper's own offline-calibrated baseline."""


PAPER_TABLE_NUMBER = {0.02: "4", 0.04: "5", 0.1: "6"}

METRICS = (("cop", "CoP", "mm", 1e3), ("vgrf", "vGRF", "N", 1.0))


def lead_table(yardsticks: Frame, loop: Frame, condition: str, title: str) -> Table:
    """Return what one wants to know first: how far off each way to read the feet is, and who falls."""
    own = yardsticks[(yardsticks["condition"] == condition) & (yardsticks["against"] == "truth")]
    raw = int(loop[loop["feed"] == "none"]["fell"].sum())

    def error(metric: str, factor: float) -> Cell:
        def cell(way: tuple[str, Frame]) -> str:
            errors = own[own["method"] == way[0]][metric]
            return with_interval(errors, factor) if len(errors) else "0"

        return cell

    def fall(way: tuple[str, Frame]) -> str:
        falls, said = int(way[1]["fell"].sum()), count_of("fell")(way[1])
        return said if falls == raw else Verdict.of(falls < raw, said)

    columns: dict[str, Cell] = {
        "what reads the feet": lambda way: look_of(way[0]).label,
        "CoP off by (mm)": error("cop", 1e3),
        "vertical force off by (N)": error("vgrf", 1.0),
        "walks that fall": fall,
    }
    note = (
        "Errors while walking at the bad start, rms from the settling time on. Falls: the controller is fed "
        f"the CoP of cells that are {loop['severity'].iloc[0]:g} times as bad; green, fewer than on raw "
        "readings."
    )
    return laid_out("lead", title, columns, by_way(loop, "feed").items(), note)


def walking_table(scores: Frame, speed: float, conditions: Sequence[tuple[str, str]]) -> Table:
    """Return one speed as the paper's Tables 4 to 6 and the truth; the first condition is the paper's."""
    rows = []
    here = scores[scores["speed"] == speed]
    for condition, title in conditions:
        published = WALKING_TABLES.get(speed, {}) if condition == conditions[0][0] else {}
        for method, runs in by_way(here[here["condition"] == condition]).items():
            baseline, truth = (runs[runs["against"] == against] for against in ("baseline", "truth"))
            cells = [title, look_of(method).label]
            for metric, _, _, factor in METRICS:
                same = len(baseline) and float(baseline[metric].max()) < 1e-9
                cells.append("0 *" if same else with_interval(baseline[metric], factor))
                paper = published.get(method)
                cells.append("" if paper is None else number(factor * getattr(paper, metric)))
            cells += [with_interval(truth[metric], factor) for metric, _, _, factor in METRICS]
            rows.append((*cells, with_interval(truth["cell"])))
    columns = ["condition", "method"]
    for _, what, unit, _ in METRICS:
        columns += [f"{what} against baseline ({unit})", "paper"]
    columns += [f"{what} against truth ({unit})" for _, what, unit, _ in METRICS]
    name = PAPER_TABLE_NUMBER.get(speed)
    note = (
        f"rmse, mean ± 95 % interval over {plural(here['seed'].nunique(), 'seed')}. "
        "* By construction: these readings are the baseline."
    )
    return Table(
        f"walking_{speed:g}".replace(".", "_"),
        f"Table {name}: {speed:g} m/s" if name else f"{speed:g} m/s",
        (*columns, "single cell against truth (N)"),
        tuple(rows),
        note,
    )


def loop_table(runs: Frame, horizon: float) -> Table:
    """Return the closed loop: who fell, and when; one row a walk comes in, which lasts so many s at most."""

    def halved(part: Frame) -> str:
        curve = survival(part["time"], part["fell"])
        times = curve.time[curve.share <= 0.5]
        return number(float(times[0])) if len(times) else f"> {horizon:g}"

    columns: dict[str, Cell] = {
        "severity": lambda part: f"{part['severity'].iloc[0]:g}",
        "speed (m/s)": lambda part: f"{part['speed'].iloc[0]:g}",
        "CoP fed back": lambda part: look_of(part["feed"].iloc[0]).label,
        "falls": count_of("fell"),
        "half have fallen after (s)": halved,
        f"time on its feet (s), of {horizon:g}": mean_of("time"),
        "error of the CoP fed back (mm)": mean_of("cop_error", 1e3),
        "true CoP from its plan (mm)": mean_of("tracking", 1e3),
    }
    note = "Paired: the same seeds, pushes, ground and sensors under every feedback. Errors up to the fall."
    groups = runs.groupby(["severity", "speed"], sort=False)
    parts = [part for _, walks in groups for part in by_way(walks, "feed").values()]
    return laid_out("closed_loop", "The walker on different feet", columns, parts, note)


def sensitivity_table(runs: Frame, title: str) -> Table:
    """Return how far the window's errors move with each of its weights."""
    factors = sorted(runs["factor"].unique())
    rows: list[tuple[Any, ...]] = []
    for weight in dict.fromkeys(runs["weight"]):
        for speed, part in runs[runs["weight"] == weight].groupby("speed"):
            for metric, what, unit, factor in METRICS:
                means = [factor * mean_interval(part[part["factor"] == f][metric]).mean for f in factors]
                base = means[factors.index(1.0)] if 1.0 in factors else float("nan")
                change = f"{100 * (min(means) / base - 1):+.0f} to {100 * (max(means) / base - 1):+.0f} %"
                rows.append((weight, f"{speed:g}", f"{what} ({unit})", *map(number, means), change))
    columns = ("weight", "speed (m/s)", "rmse", *(f"× {factor:g}" for factor in factors), "change")
    name = "sensitivity_" + title.partition(",")[0].replace(" ", "_").replace("'", "")
    return Table(name, f"The window's weights, each scaled alone: {title}", columns, tuple(rows))
