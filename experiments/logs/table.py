"""Tables of logs: the named columns of a Parquet or CSV file as numbers, or the reason why not."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as pq
from numpy.typing import NDArray

_SHOWN = 4  # missing columns that a message names


class LogError(ValueError):
    """A log that cannot be used; the message names the file, the column and the cure."""


@dataclass(frozen=True, eq=False)
class LogTable:
    """The columns of one file, which messages name."""

    file: str
    data: pa.Table

    def __contains__(self, name: object) -> bool:
        """Whether there is a column of that name."""
        return name in self.data.column_names

    def __len__(self) -> int:
        """The number of rows."""
        return int(self.data.num_rows)

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return list(self.data.column_names)

    def require(self, names: Sequence[str], cure: str, purpose: str = "") -> tuple[str, ...]:
        """Return names of columns; raise LogError with their purpose and a cure if one is not there."""
        missing = [name for name in names if name not in self]
        if missing:
            more = f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
            shown = ", ".join(missing[:_SHOWN]) + more + (f" for {purpose}" if purpose else "")
            raise LogError(f"{self.file}: missing column {shown}; {cure}")
        return tuple(names)

    def numbers(self, name: str, *, flags: bool = False) -> NDArray[np.float64]:
        """Return a column as floats, NaN where empty, (rows,); LogError at anything else but flags."""
        column = self.data.column(name)
        kind = column.type
        if pa.types.is_null(kind):
            return np.full(len(self), np.nan)
        if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
            return np.asarray(column.cast(pa.float64()).to_numpy(), dtype=np.float64)
        found = np.full(len(self), np.nan)
        for row, value in enumerate(column.to_pylist()):
            try:
                if isinstance(value, bool) and not flags:
                    raise TypeError
                found[row] = np.nan if value is None else float(value)
            except (TypeError, ValueError):
                raise LogError(
                    f"{self.file}: column '{name}' holds {value!r} at row {row}, which is no number; leave "
                    "the cell empty where no sample arrived, and check the separator and the decimal point."
                ) from None
        return found

    def stacked(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return columns side by side, shape (rows, columns)."""
        return np.stack([self.numbers(name) for name in names], axis=-1)


def read_table(path: Path, absent: str, *, separator: str = ",", decimal: str = ".") -> LogTable:
    """Read a ``.parquet`` or ``.csv`` file, or raise LogError; ``absent`` is said where there is none."""
    if not path.is_file():
        raise LogError(f"{path}: no such file; {absent}")
    if path.suffix not in (".parquet", ".csv"):
        raise LogError(f"{path.name}: a log ends in .parquet or .csv; rename or convert the file.")
    try:
        if path.suffix == ".parquet":
            data = pq.read_table(path)
        else:
            parse = csv.ParseOptions(delimiter=separator)
            # An empty cell in a column of names is no name.
            convert = csv.ConvertOptions(decimal_point=decimal, strings_can_be_null=True)
            data = csv.read_csv(path, parse_options=parse, convert_options=convert)
        names = data.column_names
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise LogError(
            f"{path.name}: not a readable table ({str(error).splitlines()[0]}); write a line of column names "
            "and every row whole, and leave a cell empty where no sample arrived."
        ) from None
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise LogError(f"{path.name}: column '{twice[0]}' is there twice; rename one of them.")
    return LogTable(path.name, data)
