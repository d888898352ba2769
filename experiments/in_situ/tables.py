"""Tables of the simulated in-situ experiment, beside what the paper printed."""

from collections.abc import Callable
from typing import Any

import numpy as np

from surefoot.experiments.in_situ.cases import KINDS, MOTIONS
from surefoot.experiments.in_situ.claims import consistency, limits_of, over_bound
from surefoot.experiments.in_situ.methods import METHODS
from surefoot.experiments.in_situ.printed import PRINTED, PrintedRow
from surefoot.experiments.in_situ.study import InSituStudyResults
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import Column, Frame, Table, Verdict, number, with_interval

__all__ = ["all_tables"]

_SHOWN = {"measurement": "measurement space", "paper": "III-B, III-C", "manufacturer": "manufacturer"}
"""Methods of the tables by set, with their names in headings."""


def all_tables(results: InSituStudyResults) -> dict[str, Table]:
    """Return all tables by name, in the order of the page."""
    spheres = (_semi_axes(results), _masses(results), _places(results))
    others = (_limb(results), _bound(results), _motion(results), _refusals(results), _exact(results))
    return {table.name: table for table in (_targets(results), *spheres, *others)}


def _targets(results: InSituStudyResults) -> Table:
    rows = tuple(
        (
            limit.name,
            f"{limit.most:g}",
            _short(np.median(limit.values)) if len(limit.values) else "–",
            _short(np.max(limit.values)) if len(limit.values) else "–",
            f"{100 * limit.share:.1f}",
            str(limit.refused),
            limit.printed or "–",
            Verdict.of(limit.met),
        )
        for limit in limits_of(results)
    )
    columns = (
        "what", "at most", "median", "worst", "within it (%)", "refused", "the paper printed", "met by all",
    )  # fmt: skip
    note = "Foot and leg, all seeds, all sets that were not fitted: one number each."
    return Table("targets", "What it must show", columns, rows, note)


def _exact(results: InSituStudyResults) -> Table:
    columns = ["offset", "matrix_force", "matrix_torque", "limb", "first_moment"]
    rows = tuple((row["sensor"], *(f"{row[c]:.1e}" for c in columns)) for _, row in results.exact.iterrows())
    heads = ("sensor", "offset (III-B)", "matrix, forces (III-C)", "matrix, torques", "mass", "first moment")
    return Table("exact", "Relative errors without noise", heads, rows)


def _semi_axes(results: InSituStudyResults) -> Table:
    def cells(part: Frame) -> list[str]:
        axes = " / ".join(number(part[f"axis_{i}"].mean()) for i in (1, 2, 3))
        return [axes, with_interval(part["ratio"], digits=4), number(part["ratio"].max(), 4)]

    def printed(row: PrintedRow) -> list[str]:
        of_maker = row.axes_maker[0] / row.axes_maker[2]
        return [" / ".join(number(a) for a in row.axes), f"{row.ratio:.2f}", f"{of_maker:.2f}"]

    return _by_set(
        results.sets,
        "table1",
        "Table I: semi-axes of the force of sets that were not fitted",
        {"axes (N)": "axes (N)", "longest / shortest": "ratio", "worst": "ratio, manufacturer"},
        cells,
        printed,
        "The paper's leg was another one, of unknown weight: its axes are smaller for III-C's attenuation.",
    )


def _masses(results: InSituStudyResults) -> Table:
    def cells(part: Frame) -> list[str]:
        interval = mean_interval(part["mass"])
        spread = "" if interval.n < 2 else f" ± {interval.half:.4f}"
        return [f"{interval.mean:.4f}{spread}", f"{part['mass_error'].max():.4f}"]

    return _by_set(
        results.sets,
        "table2",
        "Table II: added mass in kg",
        {"mass": "proposed", "worst error": "manufacturer"},
        cells,
        lambda row: [f"{row.mass:.2f}", f"{row.mass_maker:.2f}"],
        "What the sensor weighs less the limb that the method found; the manufacturer's less the paper's.",
    )


def _places(results: InSituStudyResults) -> Table:
    def cells(part: Frame) -> list[str]:
        middle = " / ".join(f"{100 * part[f'place_{axis}'].mean():.1f}" for axis in "xyz")
        return [middle, f"{100 * part['place_error'].max():.2f}"]

    def printed(row: PrintedRow) -> list[str]:
        places = (row.place or (), row.place_maker or ())
        return [" / ".join(f"{x:g}" for x in place) or "–" for place in places]

    return _by_set(
        results.sets[results.sets["added"] > 0.0],
        "table3",
        "Table III: place of the added mass in cm",
        {"x / y / z": "proposed", "worst error, any axis": "manufacturer"},
        cells,
        printed,
        "In print the minus signs were lost.",
    )


def _limb(results: InSituStudyResults) -> Table:
    rows = []
    for (sensor, method), part in results.fits.groupby(["sensor", "method"], sort=False):
        errors = 100.0 * part["limb_error"].dropna()
        cells = (
            with_interval(errors),
            number(errors.std()),
            number(errors.abs().max()),
            f"{100.0 * float(np.mean(errors.abs() <= 1.0)):.0f}" if len(errors) else "–",
            *_shares(part, "force_error", "torque_error"),
            str(_refused(part)),
        )
        rows.append((f"{sensor}, {METHODS[str(method)]}", *cells))
    columns = (
        "sensor, method", "limb's weight, error (%)", "spread (%)", "worst (%)", "within 1 % (% of seeds)",
        "forces (%)", "torques (%)", "refused",
    )  # fmt: skip
    note = (
        "Forces and torques: rms of (C A - I) w over that of w, under the loads of the sets that were not "
        "fitted. The manufacturer's matrix weighs no limb: it is beside the paper's."
    )
    return Table("limb", "Absolute weight of the limb, and the matrix", columns, tuple(rows), note)


def _bound(results: InSituStudyResults) -> Table:
    rows = []
    for (kind, sensor), part in results.white.groupby(["kind", "sensor"], sort=False):
        known = consistency(part)
        cells = (
            *(number(over_bound(part, what)) for what in ("force", "torque", "limb")),
            number(known.mean),
            f"{known.low:.3f} to {known.high:.3f}",
            Verdict.of(known.inside),
            str(_refused(part)),
        )
        rows.append((f"{sensor}, {KINDS[str(kind)]}", *cells))
    columns = (
        "sensor, errors", "offset, forces / bound", "offset, torques / bound", "limb's mass / bound",
        "NEES / unknowns", "95 % of consistent ones", "inside", "refused",
    )  # fmt: skip
    note = (
        "Limb at rest, gravity exact. The Cramér-Rao bound is that of white noise and offsets that do not "
        "drift; what else a sensor suffers is reported, not bounded. Part of that is a matter of words: "
        "with hysteresis a sensor has no one slope, and the truth is that at the ends of a large swing."
    )
    title = "Against the Cramér-Rao bound and the covariance of the fit"
    return Table("bound", title, columns, tuple(rows), note)


def _motion(results: InSituStudyResults) -> Table:
    rows = []
    for (index, sensor), part in results.motions.groupby(["motion", "sensor"], sort=False):
        motion = MOTIONS[int(index)]
        errors = 100.0 * part["limb_error"].dropna()
        cells = (
            number(part["minutes"].iloc[0], 2),
            with_interval(errors),
            number(errors.abs().max()),
            *_shares(part, "force_error", "torque_error"),
            f"{_refused(part)} of {len(part)}",
        )
        rows.append((f"{sensor}: {motion.name}, {motion.duration:g} s a set", *cells))
    columns = (
        "sensor: motion", "minutes of data", "limb's weight, error (%)", "worst (%)", "forces (%)",
        "torques (%)", "refused",
    )  # fmt: skip
    note = "Four sets; before the swings the limb rests in many postures for a minute, for the accelerometer."
    return Table("motion", "Slow and fast motion", columns, tuple(rows), note)


def _refusals(results: InSituStudyResults) -> Table:
    rows = []
    for case, part in results.refusals.groupby("case", sort=False):
        reasons = part["refusal"][part["refusal"] != ""]
        cells = (
            f"{int(part['refused'].sum())} of {len(part)}",
            reasons.iloc[0] if len(reasons) else "–",
            *_shares(part, "force_error", "torque_error", "paper_force", "paper_torque"),
        )
        rows.append((str(case), *cells))
    columns = (
        "experiment", "refused", "reason", "forces (%)", "torques (%)", "III-C, forces (%)",
        "III-C, torques (%)",
    )  # fmt: skip
    note = (
        "Errors of the answer or, where it was refused, of a fit without that check (a dash where there is "
        "no such answer), and those of the paper's III-C, which has but the rank to go by."
    )
    return Table("refusals", "Experiments that went wrong (leg)", columns, tuple(rows), note)


def _by_set(
    frame: Frame,
    name: str,
    title: str,
    heads: dict[str, str],
    cells: Callable[[Frame], list[str]],
    printed: Callable[[PrintedRow], list[str]],
    note: str,
) -> Table:
    """Return a row a sensor and set: all methods side by side, then what the paper printed.

    Args:
        frame: Rows of ``sets``.
        name: Of the table.
        title: Of the table.
        heads: Headings of a method's cells, each with that of a printed cell.
        cells: Makes a method's cells.
        printed: Makes the printed cells.
        note: How to read it.
    """
    rows: list[tuple[str, ...]] = []
    for (sensor, index), part in frame.groupby(["sensor", "set"], sort=False):
        row = [f"{sensor}, set {index}", f"{part['added'].iloc[0]:.3f}"]
        for method in _SHOWN:
            found = part[part["method"] == method]
            row += cells(found) if len(found) else ["–"] * len(heads)
        rows.append((*row, *printed(PRINTED[str(sensor), int(index)])))
    of_methods = [f"{label}: {head}" for label in _SHOWN.values() for head in heads]
    columns = ("sensor, set", "added (kg)", *of_methods, *(f"printed: {head}" for head in heads.values()))
    return Table(name, title, columns, tuple(rows), note)


def _shares(part: Frame, *columns: str) -> tuple[str, ...]:
    """Return means of columns in percent."""
    return tuple(number(100.0 * part[column].mean()) for column in columns)


def _refused(part: Column) -> int:
    return int((part["refusal"] != "").sum())


def _short(value: Any) -> str:
    return f"{value:.1e}" if 0.0 < abs(value) < 1e-4 else number(float(value), 4)
