"""Arrays, and records of arrays whose rows are samples."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def stack_rows(rows: Sequence[Any]) -> Any:
    """Stack named tuples of one kind, N of them, into one whose fields have N rows."""
    return type(rows[0])(*map(np.array, zip(*rows, strict=True)))


def take_rows(record: Any, where: Any) -> Any:
    """Take rows of every field of a named tuple but ``None``: one by its number, or those of a slice."""
    return type(record)(*(None if part is None else np.asarray(part)[where] for part in record))
