"""Arrays as the modules of this package write them."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = Any
"""A NumPy array, or a NumPy number where its shape is (); GPU modules hold tensors in the same records."""

MAD_TO_STD = 1.4826
"""Standard deviations in a median absolute deviation of normal noise."""


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
