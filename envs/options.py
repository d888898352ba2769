"""Checks of the environments' options: each message names the option, the rule and the given value."""

from collections.abc import Sequence
from math import isfinite, nan
from typing import Any

import numpy as np

from surefoot.arrays import Floats
from surefoot.checks import check_value


def positive(name: str, value: float, *, or_zero: bool = False) -> float:
    """Return a finite number that is positive or, if allowed, zero; ValueError for all other values."""
    try:
        return check_value(name, value, positive=not or_zero)
    except TypeError as error:
        raise ValueError(str(error)) from None


def check_range(name: str, value: Sequence[float]) -> tuple[float, float]:
    """Return (lowest, highest), or raise ValueError unless 0 <= lowest <= highest."""
    numbers = numbers_of(value)
    if len(numbers) != 2 or not all(map(isfinite, numbers)) or not 0.0 <= numbers[0] <= numbers[1]:
        raise ValueError(
            f"'{name}' must be (lowest, highest) with 0 <= lowest <= highest, got {value!r}; "
            "give the same number twice for no randomness."
        )
    return numbers[0], numbers[1]


def check_time_constant(name: str, value: float) -> float:
    """Return a contact's time constant in s, or raise ValueError if steps of 1.25 ms cannot follow it."""
    number = number_of(value)
    if not 0.005 <= number <= 0.1:
        raise ValueError(f"'{name}' must lie between 0.005 s (hard) and 0.1 s (very soft), got {value!r}.")
    return number


def check_stiffness(value: Sequence[float]) -> tuple[float, ...]:
    """Return eight stiffnesses, or raise ValueError if they are not eight or not positive."""
    numbers = numbers_of(value)
    if len(numbers) != 8 or not all(isfinite(number) and number > 0.0 for number in numbers):
        raise ValueError(
            "'cell_stiffness' must hold eight positive finite numbers, left then right, each (front-left, "
            f"front-right, rear-left, rear-right), got {value!r}; eight ones make all cells equal."
        )
    return numbers


def check_action(
    action: Any, names: tuple[str, ...], each: str, cure: str, robots: tuple[int, ...] = ()
) -> Floats:
    """Return an action, clipped to -1 ... 1, of one robot, or of N with ``robots`` (N,).

    ``names`` are the joints that it moves. Messages have the name of ``each`` of its numbers, and the
    ``cure`` of one that is not finite: other shapes and numbers that are not finite are refused with a
    ValueError.
    """
    try:
        numbers = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"An action holds numbers, {each} {names}; got {action!r}.") from None
    if numbers.shape != (shape := (*robots, len(names))):
        raise ValueError(f"An action has shape {shape}, {each} {names}; got shape {numbers.shape}.")
    if not np.isfinite(numbers).all():
        raise ValueError(f"An action must be finite, got {numbers.tolist()}; {cure}.")
    return np.minimum(np.maximum(numbers, -1.0), 1.0)


def check_render_mode(mode: str | None, modes: Sequence[str]) -> None:
    """Raise ValueError if an environment has no such render mode."""
    if mode not in (None, *modes):
        raise ValueError(f"There is no render mode '{mode}'; choose one of {modes} or None.")


def number_of(value: Any) -> float:
    """Return a number as a float, NaN for other values."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return nan


def check_number(name: str, value: Any) -> float:
    """Return a finite number as a float, or raise ValueError for other values."""
    if not isfinite(number := number_of(value)):
        raise ValueError(f"'{name}' must be finite, got {value!r}.")
    return number


def numbers_of(value: Any) -> tuple[float, ...]:
    """Return a sequence of numbers: NaN for other values, empty for no sequence."""
    try:
        return tuple(number_of(number) for number in value)
    except TypeError:
        return ()
