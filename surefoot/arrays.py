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
    return type(record)(*(None if part is None else _as_rows(part)[where] for part in record))


class HeldRows:
    """N rows of which most repeat the row before, stored once for each run of equal rows.

    It is indexed like an array of shape (N, ...), and ``np.asarray`` makes that array. A filter's covariance
    changes once in several samples, and would otherwise take more memory than all its other results.
    """

    def __init__(self, values: NDArray[Any], row: NDArray[np.intp]) -> None:
        self.values, self.row = values, row  # the rows that differ, and which of them each of the N rows is
        self.shape = (len(row), *values.shape[1:])
        self.dtype, self.ndim = values.dtype, values.ndim

    def __len__(self) -> int:
        """The number of rows, N."""
        return len(self.row)

    def __getitem__(self, key: Any) -> Any:
        """Return rows, or parts of them; the first index is that of the rows."""
        first, *rest = key if isinstance(key, tuple) else (key,)
        arrays = [np.ndim(one) > 0 for one in (first, *rest) if one is not Ellipsis]
        # Arrays beside an array for the rows select single elements together, and masks may have more axes.
        paired = np.ndim(first) > 1 or (np.ndim(first) > 0 and sum(arrays) > 1)
        if first is Ellipsis or first is None or paired:
            return np.asarray(self)[key]
        return self.values[(slice(None), *rest)][self.row[first]]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return all N rows as an array."""
        if copy is False:
            raise ValueError("The rows are stored in runs, so an array of them is always a copy.")
        return self.values[self.row].astype(dtype or self.dtype, copy=False)


class RowCollector:
    """Collect a named tuple of arrays per row into one whose fields have N rows, without keeping the tuples.

    Args:
        rows: Number of rows N.
        held: Names of fields that seldom change, which are returned as :class:`HeldRows`.
    """

    def __init__(self, rows: int, held: Sequence[str] = ()) -> None:
        self._rows, self._held, self._kind = rows, held, tuple
        self._columns: list[NDArray[Any] | None] = []
        self._runs: dict[int, _Runs] = {}

    def put(self, row: int, record: Any) -> None:
        """Store one row; rows come in order."""
        if not self._columns:
            self._begin(record)
        for column, part in zip(self._columns, record, strict=True):
            if column is not None:
                column[row] = part
        for field, runs in self._runs.items():
            runs.put(row, record[field])

    def collect(self) -> Any:
        """Return the rows as one named tuple."""
        parts: list[Any] = list(self._columns)
        for field, runs in self._runs.items():
            parts[field] = runs.collect()
        return self._kind(*parts)

    def _begin(self, record: Any) -> None:
        self._kind = type(record)
        for i, (name, part) in enumerate(zip(record._fields, record, strict=True)):
            like = np.asarray(part)
            if part is None or name in self._held:
                self._columns.append(None)
            else:
                self._columns.append(np.empty((self._rows, *like.shape), like.dtype))
            if part is not None and name in self._held:
                self._runs[i] = _Runs(self._rows, like)


class _Runs:
    """Rows of one array as runs of equal rows, which grow in place."""

    def __init__(self, rows: int, like: NDArray[Any]) -> None:
        self._values, self._count = np.empty((64, *like.shape), like.dtype), 0
        self._row = np.empty(rows, dtype=np.intp)

    def put(self, row: int, value: Any) -> None:
        last = self._count - 1
        if last < 0 or not np.array_equal(self._values[last], value, equal_nan=True):
            if self._count == len(self._values):
                self._values.resize((3 * self._count // 2, *self._values.shape[1:]), refcheck=False)
            self._values[self._count] = value
            self._count += 1
        self._row[row] = self._count - 1

    def collect(self) -> HeldRows:
        self._values.resize((self._count, *self._values.shape[1:]), refcheck=False)
        return HeldRows(self._values, self._row)


def _as_rows(part: Any) -> Any:
    return part if isinstance(part, HeldRows) else np.asarray(part)
