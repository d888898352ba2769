"""Arrays as the modules of this package write them."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from surefoot.arrays import Floats

Array = Any
"""A NumPy array, or a NumPy number where its shape is (); GPU modules hold tensors in the same records."""

MAD_TO_STD = 1.4826  # standard deviations in a median absolute deviation of normal noise


ROUNDING = 1e-13
"""Singular values at or below this share of the largest, for columns of unit length, are rounding."""


def in_a_row(*widths: int) -> Iterator[slice]:
    """Yield the slices of parts of these widths, side by side.

    >>> list(in_a_row(3, 1))
    [slice(0, 3, None), slice(3, 4, None)]
    """
    end = 0
    for width in widths:
        yield slice(end, end := end + width)


def skew(vectors: Floats) -> Floats:
    """Return [v]x of vectors, shapes (..., 3) and (..., 3, 3): [v]x a = v x a."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*np.shape(vectors), 3)


def of_unit_length(columns: Floats) -> tuple[Floats, Floats]:
    """Return columns over their lengths, and the lengths; one for a column of zeros."""
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    return columns / size, size


def orthonormal(columns: Floats, rounding: float = ROUNDING) -> tuple[Floats, Floats]:
    """Return an orthonormal basis of columns X, shape (n, p), and X^+ by that basis, shape (c, p)."""
    unit, size = of_unit_length(columns)
    left, singular, right = np.linalg.svd(unit, full_matrices=False)
    seen = singular > rounding * singular[0]
    return left[:, seen], right[seen].T / singular[seen] / size[:, None]


def triangle(columns: Floats) -> Floats:
    """Return R of a QR decomposition with as many rows as columns, also of fewer samples."""
    width = columns.shape[1]
    if len(columns) < width:
        columns = np.concatenate([columns, np.zeros((width - len(columns), width))])
    return np.asarray(np.linalg.qr(columns, mode="r"))
