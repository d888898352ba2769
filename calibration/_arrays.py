"""Small helps for code on the array API standard; private to :mod:`surefoot.calibration`."""

from typing import Any

from array_api_compat import array_namespace
from array_api_compat import device as device_of

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""


def constant_like(values: Any, like: Array) -> Array:
    """Bring constants to the library, dtype and device of an array.

    Args:
        values: Numbers, a NumPy array, or an array of the same library.
        like: The floating-point array whose kind is wanted.
    """
    return array_namespace(like).asarray(values, dtype=like.dtype, device=device_of(like))


def check_floating(array: Array, what: str) -> None:
    """Refuse integers and booleans, in which neither forces nor NaN can be written.

    Raises:
        ValueError: If the array is not of a real floating-point dtype.
    """
    if not hasattr(array, "dtype"):
        raise ValueError(f"'{what}' must be an array, got {type(array).__name__}.")
    if not array_namespace(array).isdtype(array.dtype, "real floating"):
        raise ValueError(f"'{what}' must hold floating-point numbers, got dtype {array.dtype}.")


def check_tail(array: Array, tail: tuple[int | str, ...], what: str) -> None:
    """Refuse an array that is not of floats or whose last axes are not as they must be.

    Args:
        array: The array.
        tail: Lengths of its last axes; a word, such as ``"feet"``, stands for any length.
        what: Its name in the message.

    Raises:
        ValueError: If the dtype is not floating or the last axes do not match.
    """
    check_floating(array, what)
    shape = tuple(array.shape)
    last = shape[len(shape) - len(tail) :] if len(shape) >= len(tail) else ()
    fits = [isinstance(wanted, str) or wanted == length for wanted, length in zip(tail, last, strict=False)]
    if len(last) != len(tail) or not all(fits):
        axes = ", ".join(str(wanted) for wanted in tail)
        raise ValueError(f"'{what}' must have shape (..., {axes}), got {shape}.")
