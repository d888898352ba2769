"""Checks of single arguments. Each error names the argument, the rule and the value that was given."""

from typing import Any, TypeGuard

import numpy as np


def as_number(name: str, value: Any) -> float:
    """Return a number as a float; raise TypeError for a text, several numbers or anything else."""
    try:
        if not isinstance(value, str | bytes) and np.ndim(value) == 0:
            return float(value)
    except (TypeError, ValueError, OverflowError):
        pass
    raise TypeError(f"'{name}' must be a number, got {value!r} of type {type(value).__name__}.")


def check_value(name: str, value: Any, *, positive: bool) -> float:
    """Return a finite number that is positive or, unless it must be positive, zero."""
    number = as_number(name, value)
    if positive and not 0.0 < number < np.inf:
        raise ValueError(f"'{name}' must be finite and positive, got {value}.")
    if not 0.0 <= number < np.inf:
        raise ValueError(f"'{name}' must be finite and not negative, got {value}.")
    return number


def check_count(name: str, value: Any, least: int = 1) -> int:
    """Return a whole number that is not smaller than ``least``; files may contain it as a float."""
    whole = value.is_integer() if isinstance(value, float | np.floating) else is_whole(value)
    if not whole or value < least:
        raise ValueError(f"'{name}' must be a whole number from {least} on, got {value!r}.")
    return int(value)


def check_flag(name: str, value: Any) -> None:
    """Raise TypeError unless a value is True or False; a text such as "no" would count as true."""
    if not isinstance(value, bool | np.bool_):
        raise TypeError(f"'{name}' must be True or False, got {value!r}.")


def check_kind(name: str, value: Any, kind: type) -> None:
    """Raise TypeError if a value is of another class."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise TypeError(
            f"'{name}' must be {article} {kind.__name__}, got {value!r} of {type(value).__name__}."
        )


def is_whole(value: object) -> TypeGuard[int]:
    """Return whether a value is a whole number of Python or NumPy; booleans are not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)
