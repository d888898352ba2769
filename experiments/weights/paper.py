"""Known weights: Tables 2 and 3 of the CoP paper (PMC12899417), and ours."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.layout import nao_shoe_layout
from surefoot.calibration.weights.channels import fit_channels
from surefoot.experiments.study.page import Words
from surefoot.experiments.study.tables import (
    NOTHING,
    Cell,
    Frame,
    Table,
    decimal,
    number,
    table_of,
    with_deviation,
)
from surefoot.experiments.weights.weighing import MethodErrors, WeighingReport, errors_of


class WeightTable(NamedTuple):
    """Codes of eight cells under known loads and the lines through them, as in Table 2."""

    channel_names: tuple[str, ...]
    load: np.ndarray  # in kg, shape (n,)
    code: np.ndarray  # of the converters, shape (8, n)
    scale: np.ndarray  # in kg per count, shape (8,)
    offset: np.ndarray  # in kg, shape (8,)


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

_say = Words("walks", "paper")


def paper_table_2() -> tuple[Table, float]:
    """Fit the paper's counts: a table beside its coefficients, and the largest relative difference."""
    fit = fit_channels(TABLE_2.code.T, TABLE_2.load, TABLE_2.channel_names).value
    difference = np.maximum(np.abs(fit.scale / TABLE_2.scale - 1), np.abs(fit.offset / TABLE_2.offset - 1))
    columns: dict[str, Callable[[int], str]] = {
        "cell": lambda i: _cell(TABLE_2.channel_names[i]),
        **{_load(load): _code(TABLE_2.code[:, j]) for j, load in enumerate(TABLE_2.load)},
        "c, ours": lambda i: decimal(1e6 * fit.scale[i], ".8f"),
        "c, paper": lambda i: decimal(1e6 * TABLE_2.scale[i], ".8f"),
        "d, ours": lambda i: decimal(fit.offset[i], ".7f"),
        "d, paper": lambda i: decimal(TABLE_2.offset[i], ".7f"),
        "largest difference": lambda i: decimal(difference[i], ".1e"),
    }
    note = "Counts as printed in the paper; c in 1e-6 kg per count, d in kg by regression of load on count."
    title = "Table 2: the paper's counts, fitted again"
    cells = range(len(TABLE_2.channel_names))
    return table_of("table2_paper", title, columns, cells, note), float(difference.max())


def table_3(report: WeighingReport) -> Table:
    """Return the errors on held-out holes as the paper's Table 3."""
    both = (report.errors("initial"), report.errors("weights"), *TABLE_3.values())
    rows = (
        ("CoP (mm)", *(number(1e3 * errors.cop) for errors in both)),
        ("vGRF (N)", *(number(errors.vgrf) for errors in both)),
    )
    columns = ("rmse", "initial, ours", "calibrated, ours", "initial, paper", "calibrated, paper")
    calibrated = report.held_out[report.held_out["map"] == "weights"]
    note = (
        f"{calibrated['cop_x'].count()} placements with a centre of pressure and {len(calibrated)} weighings "
        "at holes that the fit never saw; the paper does not say how many of its were held out."
    )
    return Table("table3", "Table 3: before and after calibration from weights", columns, rows, note)


_MAPS = {"initial": "initial", "weights": "weights", "window": "window, walked", "moment": "moment, walked"}


def repeat_table(report: WeighingReport) -> Table:
    """Return how repeated placements agree with their holes and with each other, by map."""
    spots = ["foot", "x", "y", "load"]
    rows = report.repeats
    parts = list(rows.groupby("map", sort=False))
    published = dict(zip(_MAPS, TABLE_3.values(), strict=False))

    def spread(column: str, factor: float) -> Cell:
        # About the mean of its own hole and weight.
        return lambda part: number(factor * float(np.sqrt(part[1].groupby(spots)[column].var().mean())))

    def rmse(column: str, factor: float) -> Cell:
        return lambda part: number(factor * getattr(errors_of(part[1]), column))

    def paper(column: str, factor: float) -> Cell:
        return lambda part: (
            number(factor * getattr(published[part[0]], column)) if part[0] in published else NOTHING
        )

    columns: dict[str, Cell] = {
        "map": lambda part: _MAPS[part[0]],
        "CoP rmse (mm)": rmse("cop", 1e3),
        "CoP rmse, paper (mm)": paper("cop", 1e3),
        "std of repeats, x (mm)": spread("cop_x", 1e3),
        "std of repeats, y (mm)": spread("cop_y", 1e3),
        "vGRF rmse (N)": rmse("vgrf", 1.0),
        "vGRF rmse, paper (N)": paper("vgrf", 1.0),
        "std of repeats, vGRF (N)": spread("vgrf", 1.0),
    }
    amount = len(rows) // rows.groupby([*spots, "map"]).ngroups
    return table_of("repeats", f"{amount} repeats of each placement", columns, parts, _say("repeats"))


def hole_table(report: WeighingReport) -> Table:
    """Return where the maps see the repeated placements of the left foot, hole by hole."""
    rows = report.repeats[report.repeats["foot"] == "left"]

    def place(name: str) -> Cell:
        def cell(spot: tuple[tuple[float, float, float], Frame]) -> str:
            seen = 1e3 * spot[1][spot[1]["map"] == name][["cop_x", "cop_y"]]
            return ", ".join(map(with_deviation, seen.mean(), seen.std()))

        return cell

    columns: dict[str, Cell] = {
        "hole (mm)": lambda spot: f"{1e3 * spot[0][0]:.1f}, {1e3 * spot[0][1]:.1f}",
        "weight (kg)": lambda spot: decimal(spot[0][2]),
        **{_MAPS[name]: place(name) for name in rows["map"].unique()},
    }
    title = "CoP of repeated placements on the left foot, x, y (mm): mean ± standard deviation"
    return table_of("repeats_holes", title, columns, rows.groupby(["x", "y", "load"]))


def weight_tables(report: WeighingReport) -> tuple[Table, ...]:
    """Return all tables about known weights."""
    return (paper_table_2()[0], table_3(report), repeat_table(report), hole_table(report))


def _cell(name: str) -> str:
    return name.replace("/", " foot, ").replace("-", " ")


def _load(load: float) -> str:
    return "no load" if load == 0 else f"{load:g} kg"


def _code(codes: Floats) -> Callable[[int], str]:
    return lambda i: decimal(codes[i], ",.0f")
