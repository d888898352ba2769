"""Linear algebra of tall matrices: orthonormal bases and triangles."""

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

ROUNDING = 1e-13
"""Singular values at or below this share of the largest are rounding."""


def of_unit_length(columns: Matrix) -> tuple[Matrix, NDArray[np.float64]]:
    """Return columns over their lengths, and the lengths; one for a column of zeros."""
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    return columns / size, size


def orthonormal(columns: Matrix, rounding: float = ROUNDING) -> tuple[Matrix, Matrix]:
    """Return an orthonormal basis of columns X, shape (n, p), and X^+ by that basis, shape (c, p)."""
    unit, size = of_unit_length(columns)
    left, singular, right = np.linalg.svd(unit, full_matrices=False)
    seen = singular > rounding * singular[0]
    return left[:, seen], right[seen].T / singular[seen] / size[:, None]


def triangle(columns: Matrix) -> Matrix:
    """Return R of a QR decomposition with as many rows as columns, also of fewer samples."""
    width = columns.shape[1]
    if len(columns) < width:
        columns = np.concatenate([columns, np.zeros((width - len(columns), width))])
    return np.asarray(np.linalg.qr(columns, mode="r"))
