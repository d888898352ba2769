"""Helpers for code on the array API standard; private to :mod:`surefoot.sensors`."""

from typing import Any

import numpy as np
from array_api_compat import array_namespace
from array_api_compat import device as device_of
from numpy.typing import ArrayLike

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""


def namespace(array: Array) -> Any:
    """Return an array's library; NumPy first, where the time of the look-up matters."""
    return np if type(array) is np.ndarray else array_namespace(array)


def cast_like(value: Array, reading: Array) -> Array:
    """Give a value of the reading's library the dtype of the reading."""
    if value.dtype == reading.dtype:
        return value
    return array_namespace(reading).astype(value, reading.dtype)


def on_host(array: Array) -> bool:
    """Return whether an array's values can be looked at without waiting for another device."""
    return type(array) is np.ndarray or str(getattr(array, "device", "cpu")) == "cpu"


def round_off(array: Array) -> Array:
    """Round to whole numbers, halves to even."""
    return np.rint(array) if type(array) is np.ndarray else array_namespace(array).round(array)


def limit(array: Array, low: Any, high: Any) -> Array:
    """Clip to a range: cheaper than ``clip`` on small arrays."""
    if type(array) is np.ndarray:
        return np.minimum(np.maximum(array, low), high)
    return array_namespace(array).clip(array, low, high)


class Table:
    """Constants, available in the library, dtype and device of any array.

    Args:
        values: The constants.
    """

    def __init__(self, values: ArrayLike) -> None:
        self.values = np.asarray(values, dtype=np.float64)
        self._made: dict[Any, Array] = {}

    def like(self, array: Array, tail: int = 0) -> Array:
        """Return them for use with an array; they are converted once and kept.

        Args:
            array: Gives library, dtype and device.
            tail: How many axes of length one to append.
        """
        key: Any = (array.dtype, tail)
        if type(array) is not np.ndarray:
            key = (*key, device_of(array))
        if key not in self._made:
            values = self.values.reshape(self.values.shape + (1,) * tail)
            self._made[key] = array_namespace(array).asarray(
                values, dtype=array.dtype, device=device_of(array)
            )
        return self._made[key]
