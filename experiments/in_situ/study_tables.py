"""Tables of the simulated in-situ experiment, beside what the paper printed."""

from collections.abc import Callable, Sequence

import numpy as np

from surefoot.experiments.in_situ.methods import METHODS
from surefoot.experiments.in_situ.printed import PRINTED
from surefoot.experiments.in_situ.study import InSituStudyResults
from surefoot.experiments.in_situ.study_pieces import KINDS, MOTIONS
from surefoot.experiments.in_situ.targets import consistency, over_bound, targets_of
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import Frame, Table, number, with_interval

__all__ = [
    "bound_table",
    "exact_table",
    "limb_table",
    "mass_table",
    "motion_table",
    "place_table",
    "refusal_table",
    "semi_axes_table",
    "target_table",
]

_SHOWN = ("surefoot", "paper", "manufacturer")


def target_table(results: InSituStudyResults) -> Table:
    """Lay out what was to be reached, and what was."""
    rows = [
        (
            target.name,
            f"{target.most:g}",
            _short(np.median(target.values)) if len(target.values) else "–",
            _short(np.max(target.values)) if len(target.values) else "–",
            f"{100 * target.share:.1f}",
            str(target.refused),
            target.printed or "–",
            "yes" if target.met else "no",
        )
        for target in targets_of(results)
    ]
    columns = (
        "what", "at most", "median", "worst", "within it (%)", "refused", "the paper printed", "met by all",
    )  # fmt: skip
    note = "Foot and leg, all seeds, all sets that were not fitted: one number each."
    return Table("targets", "What it must show", columns, tuple(rows), note)


def exact_table(results: InSituStudyResults) -> Table:
    """Lay out the relative errors of the paper's method where the sensor has no error."""
    columns = ["offset", "matrix_force", "matrix_torque", "limb", "first_moment"]
    rows = tuple((row["sensor"], *(f"{row[c]:.1e}" for c in columns)) for _, row in results.exact.iterrows())
    heads = ("sensor", "offset (III-B)", "matrix, forces (III-C)", "matrix, torques", "mass", "first moment")
    return Table("exact", "Relative errors without noise", heads, rows)


def semi_axes_table(results: InSituStudyResults) -> Table:
    """Lay out the semi-axes of the force ellipsoids (in-situ paper, Table I)."""

    def cells(part: Frame) -> list[str]:
        axes = " / ".join(number(part[f"axis_{i}"].mean()) for i in (1, 2, 3))
        return [axes, with_interval(part["ratio"], digits=4), number(part["ratio"].max(), 4)]

    def printed(key: tuple[str, int]) -> list[str]:
        row = PRINTED[key]
        return [
            " / ".join(number(a) for a in row.axes), f"{row.ratio:.2f}",
            f"{row.axes_maker[0] / row.axes_maker[2]:.2f}",
        ]  # fmt: skip

    heads = ("axes (N)", "longest / shortest", "worst")
    return _by_set(
        results,
        "table1",
        "Table I: semi-axes of the force of sets that were not fitted",
        heads,
        cells,
        ("printed: axes (N)", "printed: ratio", "printed: ratio, manufacturer"),
        printed,
        "The paper's leg was another one, of unknown weight: its axes are smaller for III-C's attenuation.",
    )


def mass_table(results: InSituStudyResults) -> Table:
    """Lay out the added masses as the sensors weigh them (in-situ paper, Table II)."""

    def cells(part: Frame) -> list[str]:
        return [_kilograms(part["mass"]), f"{part['mass_error'].max():.4f}"]

    def printed(key: tuple[str, int]) -> list[str]:
        row = PRINTED[key]
        return [f"{row.mass:.2f}", f"{row.mass_maker:.2f}"]

    return _by_set(
        results,
        "table2",
        "Table II: added mass in kg",
        ("mass", "worst error"),
        cells,
        ("printed: proposed", "printed: manufacturer"),
        printed,
        "What the sensor weighs less the limb that the method found; the manufacturer's less the paper's.",
    )


def place_table(results: InSituStudyResults) -> Table:
    """Lay out where the added masses hang (in-situ paper, Table III)."""

    def cells(part: Frame) -> list[str]:
        middle = " / ".join(f"{100 * part[f'place_{axis}'].mean():.1f}" for axis in "xyz")
        return [middle, f"{100 * part['place_error'].max():.2f}"]

    def printed(key: tuple[str, int]) -> list[str]:
        row = PRINTED[key]
        if row.place is None or row.place_maker is None:
            return ["–", "–"]
        return [" / ".join(f"{x:g}" for x in place) for place in (row.place, row.place_maker)]

    return _by_set(
        results,
        "table3",
        "Table III: place of the added mass in cm",
        ("x / y / z", "worst error, any axis"),
        cells,
        ("printed: proposed", "printed: manufacturer"),
        printed,
        "In print the minus signs were lost.",
        only=results.sets["added"] > 0.0,
    )


def limb_table(results: InSituStudyResults) -> Table:
    """Lay out how heavy the limb comes out, which no sphere and no added mass shows."""
    rows = []
    for (sensor, method), part in results.fits.groupby(["sensor", "method"], sort=False):
        errors = 100.0 * part["limb_error"].dropna()
        rows.append(
            (
                f"{sensor}, {METHODS[str(method)]}",
                with_interval(errors),
                number(errors.std()),
                number(errors.abs().max()),
                f"{100.0 * float(np.mean(errors.abs() <= 1.0)):.0f}" if len(errors) else "–",
                number(100.0 * part["force_error"].mean()),
                number(100.0 * part["torque_error"].mean()),
                str(int((part["said"] != "").sum())),
            )
        )
    columns = (
        "sensor, method", "limb's weight, error (%)", "spread (%)", "worst (%)", "within 1 % (% of seeds)",
        "forces (%)", "torques (%)", "refused",
    )  # fmt: skip
    note = (
        "Forces and torques: rms of (C A - I) w over that of w, under the loads of the sets that were not "
        "fitted. The manufacturer's matrix weighs no limb: it is beside the paper's."
    )
    return Table("limb", "Absolute weight of the limb, and the matrix", columns, tuple(rows), note)


def bound_table(results: InSituStudyResults) -> Table:
    """Lay out errors over their bounds, and how well fits know themselves."""
    rows = []
    for (kind, sensor), part in results.white.groupby(["kind", "sensor"], sort=False):
        known = consistency(part)
        rows.append(
            (
                f"{sensor}, {KINDS[str(kind)]}",
                *(number(over_bound(part, what)) for what in ("force", "torque", "limb")),
                number(known.mean),
                f"{known.low:.3f} to {known.high:.3f}",
                "yes" if known.inside else "no",
                str(int((part["said"] != "").sum())),
            )
        )
    columns = (
        "sensor, errors", "offset, forces / bound", "offset, torques / bound", "limb's mass / bound",
        "NEES / unknowns", "95 % of consistent ones", "inside", "refused",
    )  # fmt: skip
    note = (
        "Limb at rest, gravity exact. The Cramér-Rao bound is that of white noise and zeros that do not "
        "drift; what else a sensor suffers is reported, not bounded. Part of that is a matter of words: "
        "with hysteresis a sensor has no one slope, and the truth is that at the ends of a large swing."
    )
    return Table(
        "bound", "Against the Cramér-Rao bound and the claimed covariance", columns, tuple(rows), note
    )


def motion_table(results: InSituStudyResults) -> Table:
    """Lay out what minutes of each motion are worth."""
    rows = []
    for (index, sensor), part in results.motions.groupby(["motion", "sensor"], sort=False):
        motion = MOTIONS[int(index)]
        errors = 100.0 * part["limb_error"].dropna()
        said = part["said"][part["said"] != ""]
        rows.append(
            (
                f"{sensor}: {motion.name}, {motion.duration:g} s a set",
                number(part["minutes"].iloc[0], 2),
                with_interval(errors),
                number(errors.abs().max()),
                number(100.0 * part["force_error"].mean()),
                number(100.0 * part["torque_error"].mean()),
                f"{len(said)} of {len(part)}",
            )
        )
    columns = (
        "sensor: motion", "minutes of data", "limb's weight, error (%)", "worst (%)", "forces (%)",
        "torques (%)", "refused",
    )  # fmt: skip
    note = "Four sets; before the swings the limb rests in many postures for a minute, for the accelerometer."
    return Table("motion", "Slow and fast motion", columns, tuple(rows), note)


def refusal_table(results: InSituStudyResults) -> Table:
    """Lay out what spoilt experiments are answered with."""
    rows = []
    for case, part in results.refusals.groupby("case", sort=False):
        said = part["said"][part["said"] != ""]
        rows.append(
            (
                str(case),
                f"{int(part['refused'].sum())} of {len(part)}",
                said.iloc[0] if len(said) else "–",
                *(
                    number(100.0 * part[column].mean())
                    for column in ("force_error", "torque_error", "paper_force", "paper_torque")
                ),
            )
        )
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
    results: InSituStudyResults,
    name: str,
    title: str,
    heads: tuple[str, ...],
    cells: Callable[[Frame], list[str]],
    printed_heads: tuple[str, ...],
    printed: Callable[[tuple[str, int]], list[str]],
    note: str,
    only: Frame | None = None,
) -> Table:
    """Lay out a row a sensor and set: all methods side by side, then what the paper printed."""
    frame = results.sets if only is None else results.sets[only]
    rows = []
    for (sensor, number_of_set), part in frame.groupby(["sensor", "set"], sort=False):
        row = [f"{sensor}, set {number_of_set}", f"{part['added'].iloc[0]:.3f}"]
        for method in _SHOWN:
            found = part[part["method"] == method]
            row += cells(found) if len(found) else ["–"] * len(heads)
        rows.append((*row, *printed((str(sensor), int(number_of_set)))))
    columns = ["sensor, set", "added (kg)"]
    columns += [f"{_TITLES[method]}: {head}" for method in _SHOWN for head in heads]
    return Table(name, title, (*columns, *printed_heads), tuple(rows), note)


_TITLES = {"surefoot": "surefoot", "paper": "III-B, III-C", "manufacturer": "manufacturer"}


def _kilograms(values: Sequence[float] | Frame) -> str:
    interval = mean_interval(values)
    return f"{interval.mean:.4f}" if interval.n < 2 else f"{interval.mean:.4f} ± {interval.half:.4f}"


def _short(value: float) -> str:
    return f"{value:.1e}" if 0.0 < abs(value) < 1e-4 else number(value, 4)
