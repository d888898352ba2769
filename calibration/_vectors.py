"""Vectors as matrices; private."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["skew"]


def skew(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """[v]x, shape (3, 3): [v]x a = v x a."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
