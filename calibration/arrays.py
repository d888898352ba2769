"""What keeps the array API cheap in a loop that runs at every sample: short ways and constants by name.

Finding an array's library and converting constants to its kind cost microseconds at every call, as much as
the arithmetic of one sample: a loop on a robot pays for them once. So do some of NumPy's functions before
they hand on to the methods that they stand for.
"""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import array_api_compat
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""

# NumPy from 2.1 on follows the standard by itself, without the wrappers of array_api_compat.
_PLAIN_NUMPY = hasattr(np, "astype") and hasattr(np, "matrix_transpose")


def namespace_of(array: Array) -> Any:
    """Return the library of an array: ``array_namespace`` with a short way for NumPy."""
    if _PLAIN_NUMPY and isinstance(array, np.ndarray | np.generic):
        return np
    return array_api_compat.array_namespace(array)


def shaped(array: Array, shape: tuple[int, ...]) -> Array:
    """Return an array in another shape: ``reshape`` with a short way for NumPy."""
    if isinstance(array, np.ndarray):
        return array.reshape(shape)
    return array_api_compat.array_namespace(array).reshape(array, shape)


def cast(array: Array, dtype: Any) -> Array:
    """Return an array in another dtype: ``astype`` with a short way for NumPy."""
    if isinstance(array, np.ndarray | np.generic):
        return array.astype(dtype)
    return array_api_compat.array_namespace(array).astype(array, dtype)


def all_along(flags: Array) -> Array:
    """Return whether all along the last axis are true: ``all`` with a short way for NumPy."""
    if isinstance(flags, np.ndarray):
        return np.logical_and.reduce(flags, axis=-1)
    return array_api_compat.array_namespace(flags).all(flags, axis=-1)


def any_along(flags: Array) -> Array:
    """Return whether any along the last axis is true: ``any`` with a short way for NumPy."""
    if isinstance(flags, np.ndarray):
        return np.logical_or.reduce(flags, axis=-1)
    return array_api_compat.array_namespace(flags).any(flags, axis=-1)


def anywhere(flags: Array) -> bool:
    """Return whether any of all flags is true: ``bool(any)`` with a short way for NumPy."""
    if isinstance(flags, np.ndarray):
        return bool(flags.any())
    return bool(array_api_compat.array_namespace(flags).any(flags))


def surely(flags: Array) -> bool:
    """Return whether all are true, where looking costs next to nothing: with NumPy; else ``False``.

    What is nearly always so may take a shorter way to the same numbers then.
    """
    return isinstance(flags, np.ndarray | np.generic) and bool(flags.all() if flags.ndim else flags)


def constant_like(values: Any, like: Array) -> Array:
    """Return constants in the library, dtype and device of an array.

    Args:
        values: Numbers, a NumPy array, or an array of the same library.
        like: The floating-point array whose kind is wanted.
    """
    return array_api_compat.array_namespace(like).asarray(
        values, dtype=like.dtype, device=array_api_compat.device(like)
    )


class Constants:
    """NumPy constants by name, handed out in the library, dtype and device of an array.

    >>> Constants(identity=np.eye(2)).like(np.zeros(1, np.float32)).identity
    array([[1., 0.],
           [0., 1.]], dtype=float32)
    """

    def __init__(self, **values: ArrayLike) -> None:
        self._values = {name: np.asarray(value) for name, value in values.items()}
        self._cache: dict[Any, Any] = {}

    def like(self, array: Array) -> Any:
        """Return the constants as floating-point arrays of this one's kind, an attribute each."""
        key = (type(array), array.dtype, getattr(array, "device", None))
        known = self._cache.get(key)
        if known is None:
            named = {name: constant_like(value, array) for name, value in self._values.items()}
            known = self._cache[key] = SimpleNamespace(**named)
        return known


def in_a_row(*widths: int) -> Iterator[slice]:
    """Yield the slices of parts of these widths, side by side.

    >>> list(in_a_row(3, 1))
    [slice(0, 3, None), slice(3, 4, None)]
    """
    end = 0
    for width in widths:
        yield slice(end, end := end + width)


def skew(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return [v]x, shape (3, 3): [v]x a = v x a."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
