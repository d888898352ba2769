"""Checks of arguments: each raises an error that names the argument, the rule and the given value."""

from typing import Any

import numpy as np

from surefoot.calibration.arrays import Array

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


def check_count(config: Any, *fields: str) -> None:
    """Convert fields of a frozen dataclass to int, or raise ValueError unless they are whole and positive."""
    for field in fields:
        value = getattr(config, field)
        if not is_whole(value) or value < 1:
            raise ValueError(f"'{field}' must be a whole number from 1 on, got {value}.")
        object.__setattr__(config, field, int(value))


def check_kind(name: str, value: Any, kind: type) -> None:
    """Raise TypeError unless a value is an instance of a class."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise TypeError(
            f"'{name}' must be {article} {kind.__name__}, got {value!r} of {type(value).__name__}."
        )


def check_value(name: str, value: Any, *, positive: bool) -> None:
    """Raise TypeError unless a value is a number, ValueError unless it is finite and positive (or zero)."""
    number = as_number(name, value)
    if positive and not 0.0 < number < np.inf:
        raise ValueError(f"'{name}' must be positive and finite, got {value}.")
    if not 0.0 <= number < np.inf:
        raise ValueError(f"'{name}' must not be negative and must be finite, got {value}.")


def check_flag(name: str, value: Any) -> None:
    """Raise TypeError unless a value is a boolean: the string "no" would count as true."""
    if not isinstance(value, bool | np.bool_):
        raise TypeError(f"'{name}' must be True or False, got {value!r}.")


def as_number(name: str, value: Any) -> float:
    """Return a number as a float, or raise TypeError for text, sequences and other types."""
    try:
        if not isinstance(value, str | bytes) and np.ndim(value) == 0:
            return float(value)
    except (TypeError, ValueError, OverflowError):
        pass
    raise TypeError(f"'{name}' must be a number, got {value!r} of type {type(value).__name__}.")


def is_whole(value: Any) -> bool:
    """Return whether a value is a whole number. It is false for infinities, NaN and other types."""
    try:
        return not isinstance(value, bool) and bool(value == int(value))
    except (TypeError, ValueError, OverflowError):
        return False
