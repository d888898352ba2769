"""What a log must hold before a calibrator is shown it; private to :mod:`surefoot.experiments`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.reference import Reference

__all__ = [
    "LogError",
    "check_columns",
    "check_increasing",
    "check_present",
    "check_reference",
    "check_time",
    "numbers",
]

FARTHEST = 5.0
"""Distance in m of a robot's centre of mass from its soles that none goes beyond."""


class LogError(ValueError):
    """A log that cannot be used; the message names the file, the column and the cure."""


def check_columns(
    columns: Mapping[str, Any], names: Sequence[str], file: str
) -> dict[str, NDArray[np.float64]]:
    """Take the columns that a log must have as floats.

    Args:
        columns: What the file holds.
        names: What it must hold.
        file: Its name in messages.

    Raises:
        LogError: If a column is missing, not of numbers, not finite (a raw reading may be NaN: no sample
            arrived), if a stance or swing flag is neither 0 nor 1, or if a quaternion is not of length one.
    """
    check_present(columns, names, file)
    values = {name: numbers(columns[name], name, file) for name in names}
    for name, column in values.items():
        allowed = np.isfinite(column) | (np.isnan(column) if name.startswith("raw_") else False)
        if not allowed.all():
            row = int(np.argmin(allowed))
            cure = (
                "write NaN where no sample arrived"
                if name.startswith("raw_")
                else "drop the row or interpolate the column"
            )
            raise LogError(f"{file}: column '{name}' is {column[row]} at row {row}; {cure}.")
        if name.endswith(("_stance", "_swing")) and not np.isin(column, (0.0, 1.0)).all():
            row = int(np.argmin(np.isin(column, (0.0, 1.0))))
            raise LogError(f"{file}: column '{name}' is {column[row]} at row {row}; it must be 0 or 1.")
    for name in names:
        if name.endswith("_qw"):
            _check_quaternion(values, name[:-1], file)
    return values


def check_present(columns: Mapping[str, Any], names: Sequence[str], file: str) -> None:
    """Refuse a table that lacks a column.

    Raises:
        LogError: If one is missing.
    """
    missing = [name for name in names if name not in columns]
    if missing:
        shown = ", ".join(missing[:4]) + (f" and {len(missing) - 4} more" if len(missing) > 4 else "")
        raise LogError(f"{file}: missing column {shown}; docs/log-format.md lists every column and its unit.")


def numbers(column: Any, name: str, file: str) -> NDArray[np.float64]:
    """Take a column as floats.

    Raises:
        LogError: If it does not hold numbers.
    """
    try:
        return np.asarray(column, dtype=np.float64)
    except (TypeError, ValueError):
        raise LogError(
            f"{file}: column '{name}' does not hold numbers; check the separator and the decimal point."
        ) from None


def _check_quaternion(values: dict[str, NDArray[np.float64]], stem: str, file: str) -> None:
    # Clipped, as squares of absurd values overflow; they are refused all the same.
    length = np.sqrt(sum(np.clip(values[f"{stem}{axis}"], -1e9, 1e9) ** 2 for axis in "wxyz"))
    wrong = np.abs(length - 1.0) > 1e-3
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(
            f"{file}: columns '{stem}w' to '{stem}z' have length {length[row]:.4g} at row {row}; "
            "a rotation is a quaternion (w, x, y, z) of length 1."
        )


def check_time(time: NDArray[np.float64], dt: float, max_gap: float, file: str) -> None:
    """Refuse times that do not increase, that leap, or that are not in seconds.

    Args:
        time: Column ``time_s``, shape (N,).
        dt: Time between samples in s that the description states.
        max_gap: Longest time in s allowed between two rows.
        file: Its name in messages.

    Raises:
        LogError: If there are fewer than two rows or time is not as it must be.
    """
    check_increasing(time, file)
    step = np.diff(time)
    median = float(np.median(step))
    if abs(median / dt - 1.0) > 0.1:
        raise LogError(
            f"{file}: column 'time_s' steps by {median:.6g} where the description says dt_s = {dt:.6g}; "
            "give time in seconds and the step that belongs to it."
        )
    if (step > max_gap).any():
        row = int(np.argmax(step > max_gap)) + 1
        raise LogError(
            f"{file}: column 'time_s' leaps by {step[row - 1]:.3g} s at row {row} (at most {max_gap:g} s); "
            "cut the log there and calibrate the parts one by one, or bridge it with --split-gaps."
        )


def check_increasing(time: NDArray[np.float64], file: str, *, repeats: bool = False) -> None:
    """Refuse times of which one is missing, repeated or out of order.

    Args:
        time: Column ``time_s``, shape (N,).
        file: Its name in messages.
        repeats: Whether two rows may have one time: packets that were held up arrive together.

    Raises:
        LogError: If there are fewer than two rows or time is not as it must be.
    """
    if len(time) < 2:
        raise LogError(f"{file}: {len(time)} rows are no walk; a log needs at least two.")
    # Written so that a NaN, which compares as neither, is refused as well.
    step = np.diff(time)
    wrong = ~((step >= 0) if repeats else (step > 0))
    if wrong.any():
        row = int(np.argmax(wrong)) + 1
        cure = "sort the rows" if repeats else "sort the rows and drop repeated times"
        raise LogError(
            f"{file}: column 'time_s' does not increase at row {row} "
            f"({time[row - 1]:.6g} s, then {time[row]:.6g} s); {cure}."
        )


def check_reference(reference: Reference, file: str) -> None:
    """Refuse beliefs that cannot be in metres or metres per second squared.

    Args:
        reference: N rows.
        file: The log's name in messages.

    Raises:
        LogError: If centre of mass and soles are too far apart, or the specific force is in other units.
    """
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


def _length(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of vectors, finite for absurd ones too."""
    return np.asarray(np.linalg.norm(np.clip(vectors, -1e9, 1e9), axis=-1))
