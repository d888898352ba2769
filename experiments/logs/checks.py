"""The data that a log of a walk must hold, and the decision about findings on a file."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration import CalibrationRefused
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.reference import Reference
from surefoot.calibration.results import Finding, decide
from surefoot.experiments.logs.table import LogError, LogTable, join_names
from surefoot.names import page

LISTED = f"{page('log-format')} lists every column and its unit."

OF_USE = re.compile(r"(raw|reference|momentum|truth|command|joint|accelerometer|gyroscope)_.*|packet|time_s")
"""Columns of a walk; others may hold anything."""

FARTHEST = 5.0  # distance in m of a robot's centre of mass from its soles that none goes beyond
LARGEST = 1e9  # magnitude at which absurd values are clipped, so that their squares stay finite


def naming_cure(table: LogTable, wanted: Sequence[str]) -> str:
    """Cure for missing columns: where they are listed, and how columns get their names."""
    others = [
        name
        for name in table.names
        if not OF_USE.fullmatch(name) or (name.startswith("raw_") and name not in wanted)
    ]
    file = Path(table.file)
    if not others or file.suffix.lower() not in (".csv", ".parquet"):
        return LISTED
    return f"there are {join_names(others)}: name them under [columns] in {file.stem}.toml. {LISTED}"


def check_columns(table: LogTable, names: Sequence[str], cure: str = "") -> dict[str, Floats]:
    """Return columns as floats; LogError if one is missing or wrong; raw readings may be NaN: no sample.

    ``cure`` is said besides of missing columns.
    """
    table.require(names, f"{naming_cure(table, names)} {cure}".rstrip())
    values = {name: table.numbers(name, flags=True) for name in names}
    for name, column in values.items():
        at, is_raw = f"{table.file}: column '{name}'", name.startswith("raw_")
        allowed = np.isfinite(column) | (np.isnan(column) & is_raw)
        if not allowed.all():
            row = int(np.argmin(allowed))
            cure = "write NaN where no sample arrived" if is_raw else "drop the row or interpolate the column"
            raise LogError(f"{at} is {column[row]} at row {row}; {cure}.")
        flags = np.isin(column, (0.0, 1.0))
        if name.endswith(("_stance", "_swing", "_contact")) and not flags.all():
            row = int(np.argmin(flags))
            raise LogError(f"{at} is {column[row]} at row {row}; it must be 0 or 1.")
    for name in names:
        if name.endswith("_qw"):
            _check_quaternion(values, name[:-1], table.file)
    return values


def _check_quaternion(values: dict[str, Floats], stem: str, file: str) -> None:
    # Clipped, as squares of absurd values overflow; they are refused all the same.
    length = np.sqrt(sum(np.clip(values[f"{stem}{axis}"], -LARGEST, LARGEST) ** 2 for axis in "wxyz"))
    wrong = np.abs(length - 1.0) > 1e-3
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(
            f"{file}: columns '{stem}w' to '{stem}z' have length {length[row]:.4g} at row {row}; "
            "a rotation is a quaternion (w, x, y, z) of length 1."
        )


def check_time(time: Floats, dt: float, max_gap: float, file: str) -> None:
    """Raise LogError if times in s, shape (N,), leap or do not step as the description says."""
    check_increasing(time, file)
    step = np.diff(time)
    median = float(np.median(step))
    if abs(median / dt - 1.0) > 0.1:
        units = {"ms": 1e3, "us": 1e6, "ns": 1e9}
        toml = f"{file.rpartition('.')[0]}.toml"
        near = [name for name, u in units.items() if abs(median / dt / u - 1.0) < 0.1]
        cure = "give time in seconds and the step that belongs to it."
        if abs(float(step.mean()) / dt - 1.0) < 0.1:
            cure = f"rows come in bursts: give the times of readings, or in '{toml}' [rates], rows a second."
        if near:
            cure = f"it looks like {near[0]}: say so in '{toml}', [units] time_s = \"{near[0]}\"."
        raise LogError(
            f"{file}: column 'time_s' steps by {median:.6g} where the description says dt_s = {dt:.6g}; "
            f"{cure}"
        )
    # Seconds since 1970 are as coarse as that.
    leaps = step > max_gap + 1e-6
    if leaps.any():
        row = int(np.argmax(leaps)) + 1
        raise LogError(
            f"{file}: column 'time_s' leaps by {step[row - 1]:.3g} s at row {row} (at most {max_gap:g} s); "
            "cut the log there and calibrate the parts one by one, or bridge it with --split-gaps."
        )


def check_load_cells(layout: FeetLayout, what: str) -> None:
    """Raise LogError unless a layout is of two feet on load cells, which the live page shows."""
    if len(layout.feet) != 2 or any(foot.position_cell_sole is None for foot in layout.feet):
        raise LogError(f"The page shows two feet on load cells, and this {what} has others.")


def check_increasing(time: Floats, file: str, *, repeats: bool = False) -> None:
    """Raise LogError if times are not increasing; with ``repeats`` packets that arrive together may be."""
    if len(time) < 2:
        raise LogError(f"{file}: one row alone is no log; record some seconds.")
    # Written so that a NaN, which compares as neither, is refused as well.
    step = np.diff(time)
    wrong = ~((step >= 0) if repeats else (step > 0))
    if wrong.any():
        row = int(np.argmax(wrong)) + 1
        cure = "sort the rows" if repeats else "sort the rows and drop repeated times"
        more = f"; {wrong.sum()} such rows in all" if wrong.sum() > 1 else ""
        raise LogError(
            f"{file}: column 'time_s' does not increase at row {row} "
            f"({time[row - 1]:.13g} s, then {time[row]:.13g} s{more}); {cure}."
        )


def check_reference(reference: Reference, file: str) -> None:
    """Raise LogError if references, N rows, cannot be in metres or metres per second squared."""
    apart = np.asarray(reference.com) - np.asarray(reference.position_sole).mean(axis=1)
    reach = float(np.median(_length(apart)))
    if reach > FARTHEST:
        raise LogError(
            f"{file}: columns 'reference_com_x_m' to '_z_m' lie {reach:.4g} from the soles, and no robot's "
            f"centre of mass is farther than {FARTHEST:g} m from them; give both in metres and in one frame."
        )
    felt = float(np.median(_length(np.asarray(reference.accelerometer))))
    if 0.9 < felt < 1.1 or felt > 100.0:
        raise LogError(
            f"{file}: columns 'reference_accelerometer_x_m_s2' to '_z_m_s2' have a median length of "
            f"{felt:.4g}, and a robot at rest feels 9.81 m/s^2; give m/s^2, gravity included."
        )


def _length(vectors: Floats) -> Floats:
    """Lengths of vectors, finite for absurd ones too."""
    return np.asarray(np.linalg.norm(np.clip(vectors, -LARGEST, LARGEST), axis=-1))


def pass_or_refuse(
    findings: Sequence[Finding], accept: str, file: str, written: str
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return notices of accepted findings, and of weaker ones.

    Raises CalibrationRefused with all that refuses, if ``accept`` holds no reason to go on; messages name the
    file, and the files that are ``written`` with the reason, such as ``"every file"``.
    """
    decision = decide(findings, accept)
    if decision.refused:
        first, *others = decision.refused
        more = "".join(f" Also: {other.reason}" for other in others)
        more += f" If you know better: --accept REASON goes on, and {written} says so."
        raise CalibrationRefused(f"{file}: {first.reason}", f"{first.cure}{more}")
    passed = tuple(f"{file}: accepted ({accept}): {one.reason} {one.cure}" for one in decision.passed)
    return passed, tuple(f"{file}: {text}" for text in decision.warnings)
