"""Checks of arrays, and of the fields of dataclasses, by the rules of :mod:`surefoot.checks`."""

from typing import Any

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.checks import check_count, check_value

ONE_ROBOT = (
    "That is of several robots, and a calibrator is of one: make a FootCalibrator for each, or wrap their "
    "environments into VectorSelfCalibration."
)
"""Remedy in messages about an array of several robots."""


def check_floating(array: Array, what: str) -> None:
    """Raise ValueError for integers and booleans, which can hold neither forces nor NaN."""
    if not hasattr(array, "dtype"):
        raise ValueError(f"'{what}' must be an array, got {type(array).__name__}.")
    if not np.isdtype(array.dtype, "real floating"):
        raise ValueError(f"'{what}' must hold floating-point numbers, got dtype {array.dtype}.")


def check_tail(array: Array, tail: tuple[int | str, ...], what: str) -> None:
    """Raise ValueError unless an array holds floats and its last axes have these lengths.

    A string, such as ``"feet"``, allows any length. ``what`` names the value in the message.
    """
    check_floating(array, what)
    shape = array.shape
    last = shape[len(shape) - len(tail) :] if len(shape) >= len(tail) else ()
    fits = [isinstance(axis, str) or axis == length for axis, length in zip(tail, last, strict=False)]
    if len(last) != len(tail) or not all(fits):
        axes = ", ".join(str(axis) for axis in tail)
        raise ValueError(f"'{what}' must have shape (..., {axes}), got {shape}.")


def check_shape(array: Array, shape: tuple[int, ...], what: str) -> None:
    """Raise ValueError unless an array has this shape, with a remedy if it holds several robots."""
    actual = getattr(array, "shape", None)
    if actual == shape:
        return
    if actual is None:
        raise ValueError(f"'{what}' must have shape {shape}, got {type(array).__name__}.")
    several = len(actual) > len(shape) and actual[len(actual) - len(shape) :] == shape
    remedy = f" {ONE_ROBOT}" if several else ""
    raise ValueError(f"'{what}' must have shape {shape}, got {actual}.{remedy}")


def check_positive(config: Any, *fields: str) -> None:
    """Raise an error that names the field and its value unless each field is positive and finite."""
    for field in fields:
        check_value(field, getattr(config, field), positive=True)


def check_not_negative(config: Any, *fields: str) -> None:
    """Raise an error that names the field and its value if a field is negative or not finite."""
    for field in fields:
        check_value(field, getattr(config, field), positive=False)


def check_counts(config: Any, *fields: str) -> None:
    """Convert fields of a frozen dataclass to int; raise ValueError unless they are whole and positive."""
    for field in fields:
        object.__setattr__(config, field, check_count(field, getattr(config, field)))
