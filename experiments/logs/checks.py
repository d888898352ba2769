"""Checks of the data in logs, and the decision about findings in a file."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration import CalibrationRefused
from surefoot.calibration.front_end.motion import FARTHEST
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.reference import Reference
from surefoot.calibration.results import Finding, decide
from surefoot.experiments.logs.clock import SLOWEST, Clock, find_gaps, longest_step, read_clock, unit_of_times
from surefoot.experiments.logs.table import LogError, LogTable, join_names
from surefoot.names import page

LISTED = f"{page('log-format')} lists every column and its unit."

OF_USE = re.compile(r"(raw|reference|momentum|truth|command|joint|accelerometer|gyroscope)_.*|packet|time_s")
"""Columns of a walk. Other columns are ignored."""

LARGEST = 1e9  # magnitude at which values are clipped, so that their squares are finite


def naming_cure(table: LogTable, wanted: Sequence[str]) -> str:
    """Return the remedy for missing columns: their documentation, and how to assign names to columns."""
    others = [
        name
        for name in table.names
        if not OF_USE.fullmatch(name) or (name.startswith("raw_") and name not in wanted)
    ]
    file = Path(table.file)
    if not others or file.suffix.lower() not in (".csv", ".parquet"):
        return LISTED
    there = join_names(others, len(table.names))
    return f"there are {there}: name them under [columns] in {file.stem}.toml. {LISTED}"


def check_columns(table: LogTable, names: Sequence[str], cure: str = "") -> dict[str, Floats]:
    """Return columns as floats; LogError if one is missing or invalid.

    Raw readings may be NaN where no sample arrived. ``cure`` is added to the message about missing columns.
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
    # Values are clipped because squares of huge values overflow. They are still refused.
    length = np.sqrt(sum(np.clip(values[f"{stem}{axis}"], -LARGEST, LARGEST) ** 2 for axis in "wxyz"))
    wrong = np.abs(length - 1.0) > 1e-3
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(
            f"{file}: columns '{stem}w' to '{stem}z' have length {length[row]:.4g} at row {row}; "
            "a rotation is a quaternion (w, x, y, z) of length 1."
        )


def clock_of(stamps: Floats, file: str, *, spread: bool = True, joined: bool | None = None) -> Clock:
    """Read a column of times in s, (N,), as :func:`read_clock` does with ``spread``.

    Raises LogError if the times are invalid, or if there are several sessions and ``joined`` is not True.
    ``joined`` is None for commands without an option to join sessions.
    """
    clock, at = read_clock(stamps, spread=spread), f"{file}: column 'time_s'"
    if clock.flaw:
        raise LogError(f"{at} {clock.flaw}; {clock.cure}")
    if clock.restart and not joined:
        raise LogError(f"{at} {clock.restart}{TWO_SESSIONS}{'.' if joined is None else SPLIT}")
    return clock


TWO_SESSIONS = (
    ", as when a logger was restarted. Sorting would mix the sessions: cut the file there and calibrate the "
    "parts one by one"
)
SPLIT = ", or keep them apart with --split-gaps."


def check_time(time: Floats, dt: float, max_gap: float, file: str) -> None:
    """Raise LogError if increasing times in s, (N,), have gaps or do not have the step of the description."""
    step = np.diff(time)
    leaps = _say_leaps(step, max_gap)
    median = float(np.median(step))
    disagrees = abs(median / dt - 1.0) > 0.1
    if disagrees or median >= SLOWEST:
        toml = f"{file.rpartition('.')[0]}.toml"
        unit = unit_of_times(median, dt if disagrees else np.nan)
        where = f"the description says dt_s = {dt:.6g}" if disagrees else "feet have several rows a second"
        cure = "give time in seconds and the step that belongs to it."
        if abs(float(step.mean()) / dt - 1.0) < 0.1 and disagrees:
            cure = f"rows come in bursts: give the times of readings, or in '{toml}' [rates], rows a second."
        if unit:
            cure = f"it looks like {unit}: say so in '{toml}', [units] time_s = \"{unit}\"."
        raise LogError(f"{file}: column 'time_s' steps by {median:.6g} where {where}; {cure}")
    if leaps:
        raise LogError(f"{file}: column 'time_s' {leaps}")


def _say_leaps(step: Floats, max_gap: float) -> str:
    """Describe the gaps in time with a remedy, or return "" if there are none."""
    leaps = find_gaps(step, max_gap)
    if not leaps.any():
        return ""
    row, many = int(np.argmax(leaps)) + 1, int(leaps.sum())
    more = f"; {many} such rows in all, the longest by {step.max():.3g} s" if many > 1 else ""
    limit = longest_step(step, max_gap)
    return (
        f"leaps by {step[row - 1]:.3g} s at row {row} (at most {limit:.3g} s{more}); cut the log there and "
        "calibrate the parts one by one, or bridge it with --split-gaps."
    )


def check_readings(raw: Floats, names: Sequence[str], file: str) -> None:
    """Raise LogError if a column of readings, (N, K), is empty, so that its offset cannot be found."""
    empty = [name for name, column in zip(names, raw.T, strict=True) if np.isnan(column).all()]
    if empty:
        more = f", as {len(empty) - 1} others," if empty[1:] else ""
        raise LogError(
            f"{file}: column '{empty[0]}'{more} holds no reading in any of {len(raw)} rows, and the "
            "description's nominal has no 'offset_N'; check its cable and its name, or give 'offset_N'."
        )


def check_load_cells(layout: FeetLayout, what: str) -> None:
    """Raise LogError unless a layout has one plate or two feet on load cells, as the live page needs."""
    if len(layout.feet) > 2 or any(foot.position_cell_sole is None for foot in layout.feet):
        raise LogError(f"The page shows one plate or two feet on load cells, and this {what} has others.")


def check_reference(reference: Reference, file: str) -> None:
    """Raise LogError if references, N rows, are not in metres and metres per second squared."""
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
    """Return lengths of vectors, which are finite for huge values too."""
    return np.asarray(np.linalg.norm(np.clip(vectors, -LARGEST, LARGEST), axis=-1))


def pass_or_refuse(
    findings: Sequence[Finding], accept: str, file: str, written: str
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return notices about accepted findings, and about weaker findings.

    Raises CalibrationRefused with all findings that refuse the file, unless ``accept`` contains a reason to
    continue. ``written`` describes the files that will contain the reason, such as ``"every file"``.
    """
    decision = decide(findings, accept)
    if decision.refused:
        first, *others = decision.refused
        more = "".join(f" Also: {other.reason}" for other in others)
        more += f" If you know better: --accept REASON goes on, and {written} says so."
        raise CalibrationRefused(f"{file}: {first.reason}", f"{first.cure}{more}")
    passed = tuple(f"{file}: accepted ({accept}): {one.reason} {one.cure}" for one in decision.passed)
    return passed, tuple(f"{file}: {text}" for text in decision.warnings)
