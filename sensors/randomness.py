"""Draws from a NumPy or a torch generator, so that no stage needs to know which one it was given.

torch is never imported here: a caller with a ``torch.Generator`` has imported it.
"""

import sys
from typing import Any

import numpy as np

Array = Any


def _is_torch(rng: Any) -> bool:
    return type(rng).__module__.startswith("torch")


def _check(rng: Any, dtype: Any) -> None:
    of_torch = type(dtype).__module__.startswith("torch")
    if not _is_torch(rng) and not isinstance(rng, np.random.Generator):
        raise TypeError(
            "Sensors draw from a numpy.random.Generator or a torch.Generator, "
            f"got {type(rng).__name__}; pass numpy.random.default_rng(seed)."
        )
    if dtype is not None and of_torch != _is_torch(rng):
        raise TypeError(
            f"Readings of type {dtype} cannot be mixed with a {type(rng).__module__}.{type(rng).__name__}: "
            "torch tensors need a torch.Generator, NumPy arrays a numpy.random.Generator."
        )


def normal(rng: Any, shape: tuple[int, ...], dtype: Any = None) -> Array:
    """Draw standard normal numbers.

    Args:
        rng: A NumPy or a torch generator; torch draws on the generator's device.
        shape: The shape of the result.
        dtype: A floating dtype of the same library; by default the library's own default.

    Raises:
        TypeError: If the generator and the dtype belong to different libraries.
    """
    if type(rng) is np.random.Generator and (dtype is None or dtype == np.float64):
        return rng.standard_normal(shape)
    _check(rng, dtype)
    if _is_torch(rng):
        return sys.modules["torch"].randn(shape, generator=rng, device=rng.device, dtype=dtype)
    return rng.standard_normal(shape, dtype=dtype)


def uniform(rng: Any, low: float, high: float, shape: tuple[int, ...], dtype: Any = None) -> Array:
    """Draw numbers uniformly from [low, high); arguments as for :func:`normal`."""
    _check(rng, dtype)
    if _is_torch(rng):
        drawn = sys.modules["torch"].rand(shape, generator=rng, device=rng.device, dtype=dtype)
    else:
        drawn = rng.random(shape, dtype=np.float64 if dtype is None else dtype)
    return drawn if (low, high) == (0.0, 1.0) else low + (high - low) * drawn


def filled(rng: Any, value: float, shape: tuple[int, ...], dtype: Any = None) -> Array:
    """Return an array of the generator's library and device, filled with one value; nothing is drawn."""
    _check(rng, dtype)
    if _is_torch(rng):
        torch = sys.modules["torch"]
        return torch.full(shape, value, device=rng.device, dtype=dtype or torch.get_default_dtype())
    return np.full(shape, value, dtype=dtype or np.float64)


def constant(rng: Any, value: Any, dtype: Any = None) -> Array:
    """Return a NumPy array (or a number) as an array of the generator's library, on its device."""
    _check(rng, dtype)
    if _is_torch(rng):
        torch = sys.modules["torch"]
        return torch.as_tensor(value, device=rng.device, dtype=dtype or torch.get_default_dtype())
    return np.asarray(value, dtype=dtype or np.float64)
