"""Arithmetic that is written once, for one robot and for many.

The few numbers of one robot are fastest as plain floats, those of many as columns: arrays with a number of
each robot. Sums and products read alike for both. Others are here, with the same bits for both: a sine
is Python's own for each robot, since NumPy's differs from it in the last digit.
"""

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Number = Any
"""A float of one robot, or a column of many."""


class Numbers(NamedTuple):
    """How numbers of one robot, or of many, are handled.

    Attributes:
        sin, cos, asin, acos, atan2, hypot, exp: As in :mod:`math`.
        where: (condition, one, other): the one where the condition holds, and the other elsewhere.
        clip: (number, lowest, highest).
        parts: Takes an array apart: nested lists of floats, or columns, the axis of the robots last.
        array: (nested parts, type of number): the array that they make, with the axis of the robots first.
    """

    sin: Callable[[Number], Number]
    cos: Callable[[Number], Number]
    asin: Callable[[Number], Number]
    acos: Callable[[Number], Number]
    atan2: Callable[[Number, Number], Number]
    hypot: Callable[[Number, Number], Number]
    exp: Callable[[Number], Number]
    where: Callable[[Any, Any, Any], Any]
    clip: Callable[[Number, float, float], Number]
    parts: Callable[[NDArray[Any]], Any]
    array: Callable[..., NDArray[Any]]


def _each(function: Callable[..., float]) -> Callable[..., NDArray[np.float64]]:
    """Return a function of columns that asks the given one for each robot."""
    return lambda *columns: np.array(list(map(function, *(column.tolist() for column in columns))))


def _columns(array: NDArray[Any]) -> NDArray[Any]:
    return np.ascontiguousarray(array.transpose(*range(1, array.ndim), 0))


def _together(parts: Any, dtype: Any = None) -> NDArray[Any]:
    if any(isinstance(part, float) for part in parts):
        parts = np.broadcast_arrays(*parts)
    stacked = np.array(parts, dtype)
    return np.ascontiguousarray(stacked.transpose(-1, *range(stacked.ndim - 1)))


_FUNCTIONS: dict[str, Callable[..., float]] = {
    name: getattr(math, name) for name in ("sin", "cos", "asin", "acos", "atan2", "hypot", "exp")
}

ONE: Final = Numbers(
    **_FUNCTIONS,
    where=lambda condition, one, other: one if condition else other,
    clip=lambda number, lowest, highest: min(max(number, lowest), highest),
    parts=lambda array: array.tolist(),
    array=np.array,
)
"""For one robot."""

MANY: Final = Numbers(
    **{name: _each(function) for name, function in _FUNCTIONS.items()},
    where=np.where,
    clip=lambda number, lowest, highest: np.minimum(np.maximum(number, lowest), highest),
    parts=_columns,
    array=_together,
)
"""For many robots."""
