"""What a log must hold before a calibrator is shown it; private to :mod:`surefoot.experiments`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["LogError", "check_columns", "check_time"]


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
    missing = [name for name in names if name not in columns]
    if missing:
        shown = ", ".join(missing[:4]) + (f" and {len(missing) - 4} more" if len(missing) > 4 else "")
        raise LogError(f"{file}: missing column {shown}; docs/log-format.md lists every column and its unit.")
    values = {name: _numbers(columns[name], name, file) for name in names}
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


def _numbers(column: Any, name: str, file: str) -> NDArray[np.float64]:
    try:
        return np.asarray(column, dtype=np.float64)
    except (TypeError, ValueError):
        raise LogError(
            f"{file}: column '{name}' does not hold numbers; check the separator and the decimal point."
        ) from None


def _check_quaternion(values: dict[str, NDArray[np.float64]], stem: str, file: str) -> None:
    length = np.sqrt(sum(values[f"{stem}{axis}"] ** 2 for axis in "wxyz"))
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
    if len(time) < 2:
        raise LogError(f"{file}: {len(time)} rows are no walk; a log needs at least two.")
    step = np.diff(time)
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 1
        raise LogError(
            f"{file}: column 'time_s' does not increase at row {row} "
            f"({time[row - 1]:.6g} s, then {time[row]:.6g} s); sort the rows and drop repeated times."
        )
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
            "cut the log there and calibrate the parts one by one."
        )
