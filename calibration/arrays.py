"""Array types and small helpers of linear algebra."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from surefoot.arrays import Floats

Array = Any
"""A NumPy array, or a NumPy number if its shape is (). GPU modules use tensors in the same tuples."""

MAD_TO_STD = 1.4826  # standard deviations in a median absolute deviation of normal noise


ROUNDING = 1e-13
"""Share of the largest singular value, for columns of unit length, at or below which one counts as zero."""


def in_a_row(*widths: int) -> Iterator[slice]:
    """Yield consecutive slices of these widths.

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
    """Return the columns divided by their lengths, and the lengths (one for a column of zeros)."""
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    return columns / size, size


def orthonormal(columns: Floats, rounding: float = ROUNDING) -> tuple[Floats, Floats]:
    """Return an orthonormal basis of columns X, shape (n, p), and X^+ by that basis, shape (c, p)."""
    unit, size = of_unit_length(columns)
    left, singular, right = np.linalg.svd(unit, full_matrices=False)
    significant = singular > rounding * singular[0]
    return left[:, significant], right[significant].T / singular[significant] / size[:, None]


def triangle(columns: Floats) -> Floats:
    """Return the square factor R of a QR decomposition, also if there are fewer rows than columns."""
    width = columns.shape[1]
    if len(columns) < width:
        columns = np.concatenate([columns, np.zeros((width - len(columns), width))])
    return np.asarray(np.linalg.qr(columns, mode="r"))
