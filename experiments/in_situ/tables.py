"""Tables of the simulated in-situ experiment, beside the paper's Tables I to III."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from surefoot.experiments.in_situ.cases import KINDS, MOTIONS
from surefoot.experiments.in_situ.claims import Limit, consistency, limits_of, over_bound
from surefoot.experiments.in_situ.methods import METHODS
from surefoot.experiments.in_situ.study import InSituStudyResults
from surefoot.experiments.study.page import Words
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import (
    Cell,
    Frame,
    Table,
    Valued,
    Verdict,
    decimal,
    mean_of,
    number,
    share,
    span,
    table_of,
    value_of,
    with_interval,
)

_say = Words("in_situ")

Triple = tuple[float, float, float]


class PrintedRow(NamedTuple):
    """A validation set in the paper, by its matrix and by the maker's; minus signs are lost."""

    axes: Triple  # semi-axes in N (Table I)
    axes_maker: Triple
    mass: float  # added, in kg (Table II)
    mass_maker: float
    place: Triple | None  # its centre of mass in cm (Table III); None where nothing was added
    place_maker: Triple | None

    @property
    def ratio(self) -> float:
        """Longest over shortest semi-axis, proposed."""
        return self.axes[0] / self.axes[2]


PRINTED = {
    ("foot", 5): PrintedRow((13.6, 13.1, 12.9), (13.5, 10.2, 4.6), 0.53, 0.06, (31, 8.8, 8.3), (273, 83, 81)),
    ("foot", 6): PrintedRow((13.5, 12.9, 12.7), (13.6, 10.5, 9.4), 0.52, 0.27, (19, 9.9, 5), (30, 18, 18)),
    ("foot", 7): PrintedRow((8.4, 7.9, 7.4), (8.5, 6.9, 6.2), -0.03, -0.13, None, None),
    ("foot", 8): PrintedRow((13.7, 12.5, 12.0), (15.7, 13.6, 10.4), 0.46, 0.45, (5.5, 9, 3.2), (8.6, 12, 10)),
    ("leg", 5): PrintedRow((34.4, 33.3, 32.5), (76.5, 49.4, 45.6), 0.51, 2.77, (28, 11, 29), (16, 6.5, 29)),
    ("leg", 6): PrintedRow((34.8, 33.5, 32.8), (82.4, 49.3, 47.3), 0.54, 3.04, (17, 9.7, 30), (12, 5.1, 27)),
    ("leg", 7): PrintedRow((30.9, 28.2, 26.9), (77.0, 44.5, 40.0), -0.04, 2.39, None, None),
    ("leg", 8): PrintedRow(
        (35.52, 33.3, 32.2), (88.9, 49.5, 48.3), 0.51, 3.25, (3.8, 8.8, 32), (7.5, 4.9, 26)
    ),
}
"""Rows by sensor and data set; the paper's limb is unknown, and so is the truth of its forces."""


_SHOWN = {"measurement": "measurement space", "paper": "III-B, III-C", "manufacturer": "manufacturer"}
"""Methods of the tables by set, with their names in headings."""


def _short(value: float) -> str:
    return decimal(value, ".1e") if 0.0 < abs(value) < 1e-4 else number(float(value), 4)


def _of_values(reduce: Callable[..., float]) -> Callable[[Limit], str]:
    return lambda limit: _short(reduce(limit.values)) if len(limit.values) else "–"


def _first(part: Frame, column: str) -> str:
    return str(part[column].iloc[0])


def _percent_of(column: str) -> Cell:
    return lambda part: number(100.0 * part[column].mean())


def _limb_error(show: Callable[[Frame], str]) -> Cell:
    """Make a cell of the errors of the limb's weight in percent."""
    return lambda part: show(100.0 * part["limb_error"].dropna())


def _count_refused(part: Frame) -> str:
    return decimal(int((part["refusal"] != "").sum()), "d")


def _motion(part: Frame) -> str:
    motion = MOTIONS[int(part["motion"].iloc[0])]
    return f"{_first(part, 'sensor')}: {motion.name}, {motion.duration:g} s a set"


_TARGETS: Mapping[str, Callable[[Limit], str]] = {
    "what": lambda limit: limit.name,
    "at most": lambda limit: decimal(limit.most, "g"),
    "median": _of_values(np.median),
    "worst": _of_values(np.max),
    "within it (%)": lambda limit: decimal(100 * limit.share, ".1f"),
    "refused": lambda limit: decimal(limit.refused, "d"),
    "the paper printed": lambda limit: limit.printed or "–",
    "met by all": lambda limit: Verdict.of(limit.met),
}

_SHARES = {"forces (%)": _percent_of("force_error"), "torques (%)": _percent_of("torque_error")}

_LIMB: Mapping[str, Cell] = {
    "sensor, method": lambda part: f"{_first(part, 'sensor')}, {METHODS[_first(part, 'method')]}",
    "limb's weight, error (%)": _limb_error(with_interval),
    "spread (%)": _limb_error(lambda errors: number(errors.std())),
    "worst (%)": _limb_error(lambda errors: number(errors.abs().max())),
    "within 1 % (% of seeds)": _limb_error(
        lambda errors: decimal(100.0 * float(np.mean(errors.abs() <= 1.0)), ".0f") if len(errors) else "–"
    ),
    **_SHARES,
    "refused": _count_refused,
}

_BOUND: Mapping[str, Cell] = {
    "sensor, errors": lambda part: f"{_first(part, 'sensor')}, {KINDS[_first(part, 'kind')]}",
    "offset, forces / bound": lambda part: number(over_bound(part, "force")),
    "offset, torques / bound": lambda part: number(over_bound(part, "torque")),
    "limb's mass / bound": lambda part: number(over_bound(part, "limb")),
    "NEES / unknowns": lambda part: number(consistency(part).mean),
    "95 % of consistent ones": lambda part: span(*consistency(part)[1:3], ".3f"),
    "inside": lambda part: Verdict.of(consistency(part).inside),
    "refused": _count_refused,
}

_MOTION: Mapping[str, Cell] = {
    "sensor: motion": _motion,
    "minutes of data": lambda part: number(part["minutes"].iloc[0], 2),
    "limb's weight, error (%)": _limb_error(with_interval),
    "worst (%)": _limb_error(lambda errors: number(errors.abs().max())),
    **_SHARES,
    "refused": lambda part: share(int(_count_refused(part)), len(part)),
}

_EXACT: Mapping[str, Cell] = {
    "sensor": lambda row: row.sensor,
    "offset (III-B)": lambda row: decimal(row.offset, ".1e"),
    "matrix, forces (III-C)": lambda row: decimal(row.matrix_force, ".1e"),
    "matrix, torques": lambda row: decimal(row.matrix_torque, ".1e"),
    "mass": lambda row: decimal(row.limb, ".1e"),
    "first moment": lambda row: decimal(row.first_moment, ".1e"),
}


def _several(cells: list[str]) -> str:
    """Join cells of numbers."""
    return Valued.of(" / ".join(cells), list(map(value_of, cells))) if cells else "–"


def _place(found: tuple[float, ...] | None) -> str:
    return _several([decimal(x) for x in found or ()])


def _mass(part: Frame) -> str:
    interval = mean_interval(part["mass"])
    text = f"{interval.mean:.4f}" + ("" if interval.n < 2 else f" ± {interval.half:.4f}")
    return Valued.of(text, {"value": interval.mean, "plus_minus": interval.half})


Printed = Callable[[PrintedRow], str]

_BY_SET: tuple[tuple[str, str, Mapping[str, Cell], Mapping[str, Printed], str], ...] = (
    (
        "table1",
        "Table I: semi-axes of the force of sets that were not fitted",
        {
            "axes (N)": lambda part: _several([number(part[f"axis_{i}"].mean()) for i in (1, 2, 3)]),
            "longest / shortest": mean_of("ratio", digits=4),
            "worst": lambda part: number(part["ratio"].max(), 4),
        },
        {
            "axes (N)": lambda row: _several([*map(number, row.axes)]),
            "ratio": lambda row: decimal(row.ratio, ".2f"),
            "ratio, manufacturer": lambda row: decimal(row.axes_maker[0] / row.axes_maker[2], ".2f"),
        },
        "The paper's leg was another one, of unknown weight: its axes are smaller for III-C's attenuation.",
    ),
    (
        "table2",
        "Table II: added mass in kg",
        {"mass": _mass, "worst error": lambda part: decimal(part["mass_error"].max(), ".4f")},
        {
            "proposed": lambda row: decimal(row.mass, ".2f"),
            "manufacturer": lambda row: decimal(row.mass_maker, ".2f"),
        },
        "What the sensor weighs less the limb that the method found; the manufacturer's less the paper's.",
    ),
    (
        "table3",
        "Table III: place of the added mass in cm",
        {
            "x / y / z": lambda part: _several(
                [decimal(100 * part[f"place_{a}"].mean(), ".1f") for a in "xyz"]
            ),
            "worst error, any axis": lambda part: decimal(100 * part["place_error"].max(), ".2f"),
        },
        {"proposed": lambda row: _place(row.place), "manufacturer": lambda row: _place(row.place_maker)},
        "In print the minus signs were lost.",
    ),
)
"""Tables of a row a sensor and set: cells of each method, and the paper's figures."""


def all_tables(results: InSituStudyResults) -> dict[str, Table]:
    """Return all tables by name, in the order of the page."""
    seen = "Foot and leg, all seeds, all sets that were not fitted: one number each."
    bound = "Against the Cramér-Rao bound and the covariance of the fit"
    motions = (
        "Four sets; before the swings the limb rests in many postures for a minute, for the accelerometer."
    )
    of_limb, of_bound = _parts(results.fits, "sensor", "method"), _parts(results.white, "kind", "sensor")
    of_motion = _parts(results.motions, "motion", "sensor")
    listed = (
        table_of("targets", "What it must show", _TARGETS, limits_of(results), seen),
        *(_by_set(results.sets, *table) for table in _BY_SET),
        table_of("limb", "Absolute weight of the limb, and the matrix", _LIMB, of_limb, _say("limb_note")),
        table_of("bound", bound, _BOUND, of_bound, _say("bound_note")),
        table_of("motion", "Slow and fast motion", _MOTION, of_motion, motions),
        table_of("exact", "Relative errors without noise", _EXACT, results.exact.itertuples()),
    )
    return {table.name: table for table in listed}


def _parts(frame: Frame, *keys: str) -> list[Frame]:
    return [part for _, part in frame.groupby(list(keys), sort=False)]


def _by_set(
    sets: Frame, name: str, title: str, ours: Mapping[str, Cell], printed: Mapping[str, Printed], note: str
) -> Table:
    def of_method(method: str, cell: Cell) -> Cell:
        return lambda part: cell(found) if len(found := part[part["method"] == method]) else "–"

    def of_paper(cell: Printed) -> Cell:
        return lambda part: cell(PRINTED[_first(part, "sensor"), int(_first(part, "set"))])

    columns: dict[str, Cell] = {
        "sensor, set": lambda part: f"{_first(part, 'sensor')}, set {_first(part, 'set')}",
        "added (kg)": lambda part: decimal(part["added"].iloc[0], ".3f"),
        **{f"{_SHOWN[m]}: {heading}": of_method(m, ours[heading]) for m in _SHOWN for heading in ours},
        **{f"printed: {heading}": of_paper(cell) for heading, cell in printed.items()},
    }
    # The bare limb has no added mass, and so no place of one.
    shown = sets[sets["added"] > 0.0] if name == "table3" else sets
    return table_of(name, title, columns, _parts(shown, "sensor", "set"), note)
