"""Tables of logs: named columns of Parquet and CSV files as numbers."""

import codecs
import re
from collections.abc import Sequence
from csv import reader
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as pq

from surefoot.arrays import Floats
from surefoot.experiments.logs.clock import read_clock

_SHOWN, _LISTED = 4, 24  # largest number of missing columns, and of existing columns, in a message

_KINDS = {
    b"\x89PNG": "is a PNG picture",
    b"PAR1": "is a Parquet table, whose name must end in .parquet",
    b"PK\x03\x04": "is a ZIP archive or a spreadsheet",
    b"\x1f\x8b": "is a gzip archive",
}
"""First bytes of files that are not text."""

_HEAD = 1 << 16  # bytes at the start of a file from which its format is determined
_LARGEST = 1 << 32  # largest unpacked size in bytes: 60 columns at 1 kHz for two hours
_SEPARATORS = (",", ";", "\t")
_COMMENT, _SEP = re.compile(r"#\s*"), re.compile("sep=.?$")  # start of a comment, separator line of Excel
_NO_TEXT = re.compile("[\x00-\x08\x0e-\x1f]")  # control characters that do not occur in text


class LogError(ValueError):
    """A log cannot be used. The message names the file, the column and the remedy."""


def join_names(names: Sequence[str], columns: int = 1) -> str:
    """Return the names of columns for a message. ``columns`` is the number of columns of the table."""
    shown = ", ".join(f"'{name}'" for name in names[:_LISTED])
    shown += f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    alone = " (if the separator is none of ',', ';' and tab, say csv.separator)"
    return shown + alone if len(names) == columns == 1 else shown


@dataclass(frozen=True, eq=False)
class LogTable:
    """The columns of one file. Messages name the file."""

    file: str
    data: pa.Table
    notices: tuple[str, ...] = ()  # about conversions while the file was read

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

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the columns of readings, ``raw_<channel>_count``."""
        return tuple(name for name in self.names if re.fullmatch("raw_.+_count", name))

    @property
    def step(self) -> float:
        """Median time between two rows in s."""
        return read_clock(self.numbers("time_s")).step

    def require(self, names: Sequence[str], cure: str, purpose: str = "") -> tuple[str, ...]:
        """Return names of columns; raise LogError with their purpose and a remedy if one is missing."""
        missing = [name for name in names if name not in self]
        if missing:
            more = f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
            shown = ", ".join(missing[:_SHOWN]) + more + (f" for {purpose}" if purpose else "")
            raise LogError(f"{self.file}: missing column {shown}; {cure}")
        return tuple(names)

    def numbers(self, name: str, *, flags: bool = False) -> Floats:
        """Return a column as floats, (rows,), NaN where empty; LogError for text, or flags unless allowed."""
        column = self.data.column(name)
        kind = column.type
        if pa.types.is_null(kind):
            return np.full(len(self), np.nan)
        if pa.types.is_timestamp(kind):  # a date and a time of day: seconds since 1970
            column = column.cast(pa.timestamp("ns", kind.tz)).cast(pa.int64())
            return 1e-9 * LogTable(self.file, pa.table({name: column})).numbers(name)
        if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
            # Times in nanoseconds since 1970 are larger than floats hold exactly; 0.3 microseconds do.
            column = column if pa.types.is_float64(kind) else column.cast(pa.float64(), safe=False)
            if column.null_count or not column.num_chunks:
                return np.asarray(column.to_numpy(), dtype=np.float64)
            # to_numpy() imports pandas, which takes longer than to read a log. One chunk needs no copy.
            chunks: list[Any] = [np.from_dlpack(chunk) for chunk in column.chunks]
            return chunks[0] if len(chunks) == 1 else np.concatenate(chunks)
        if pa.types.is_time(kind):  # a time of day: seconds since midnight
            values = column.cast(pa.time64("ns")).cast(pa.int64())
            return 1e-9 * LogTable(self.file, pa.table({name: values})).numbers(name)
        found = np.full(len(self), np.nan)
        for row, value in enumerate(column.to_pylist()):
            try:
                if isinstance(value, bool) and not flags:
                    raise TypeError
                clock = _TIME_OF_DAY.fullmatch(value.strip()) if isinstance(value, str) else None
                found[row] = np.nan if value is None else _seconds(clock) if clock else float(value)
            except (TypeError, ValueError):
                raise LogError(
                    f"{self.file}: column '{name}' holds {value!r} at row {row}, which is no number; leave "
                    "the cell empty where no sample arrived, and check the separator and the decimal point."
                ) from None
        return found

    def stack_columns(self, names: Sequence[str]) -> Floats:
        """Return columns side by side, shape (rows, columns)."""
        return np.stack([self.numbers(name) for name in names], axis=-1)


_TIME_OF_DAY = re.compile(
    r"(?:[\d./-]+[T ]+)?(?:(?P<h>\d{1,2}):)?(?P<m>\d{1,2}):(?P<s>\d{1,2}(?:[.,]\d+)?)\s*(?P<half>[AaPp][Mm])?"
)
"""A time of day, optionally after a date, which is ignored because the clock continues at midnight."""


def _seconds(clock: re.Match[str]) -> float:
    """Return a time of day in seconds since midnight."""
    hours, half = int(clock["h"] or 0), (clock["half"] or "").lower()
    if half:
        hours = hours % 12 + 12 * (half == "pm")
    return 3600.0 * hours + 60.0 * int(clock["m"]) + float(clock["s"].replace(",", "."))


def read_table(
    path: Path, absent: str, *, separator: str | None = None, decimal: str | None = None
) -> LogTable:
    """Read a ``.parquet`` or ``.csv`` file, or raise LogError, with the hint ``absent`` if there is no file.

    A CSV file may be in UTF-8, UTF-16 or Latin-1. By default its separator and decimal point are determined
    from its first lines.
    """
    if not path.is_file():
        raise LogError(f"{path}: no such file; {absent}")
    if path.suffix.lower() not in (".parquet", ".csv"):
        raise LogError(f"{path.name}: a log ends in .parquet or .csv; rename or convert the file.")
    if not path.stat().st_size:
        raise LogError(f"{path.name}: is empty; a log has a line of column names, and a row a sample.")
    notices: tuple[str, ...] = ()
    try:
        if path.suffix.lower() == ".parquet":
            data = _parquet_of(path)
        else:
            data, notices = _csv_of(path, separator, decimal)
        names = [name.strip() for name in data.column_names]
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        text = str(error).splitlines()[0]
        cells = re.search(r"Expected (\d+) columns, got (\d+)", text)
        more = cells is not None and int(cells[1]) < int(cells[2])
        comma = " Decimal commas need another separator, such as ';'." if more else ""
        raise LogError(
            f"{path.name}: not a readable table ({text}); write a line of column names and every row whole, "
            f"and leave a cell empty where no sample arrived.{comma}"
        ) from None
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise LogError(f"{path.name}: column '{twice[0]}' is there twice; rename one of them.")
    if not data.num_rows:
        raise LogError(f"{path.name}: holds no rows of samples, only names of columns.")
    named = data.rename_columns(names).replace_schema_metadata(data.schema.metadata)
    return LogTable(path.name, named, notices)


def _csv_of(path: Path, separator: str | None, decimal: str | None) -> tuple[pa.Table, tuple[str, ...]]:
    """Read a CSV file, and return notices about lines that are not part of the table."""
    source, head = _text_of(path)
    form = _find_table(head, separator)
    names = form.names if form.commented else None
    read = csv.ReadOptions(skip_rows=form.above, skip_rows_after_names=form.units, column_names=names)
    notices = (f"{path.name}: the row below the names holds no number, and was left out.",) * form.units
    cut: list[str] = []

    def skip(row: csv.InvalidRow) -> str:
        """Skip the last row if it was cut off, as when a logger lost its supply."""
        last = row.actual_columns < row.expected_columns and not cut and _ends_with(path, row.text)
        cut.append(row.text)
        return "skip" if last else "error"

    parse = csv.ParseOptions(delimiter=form.separator, invalid_row_handler=skip)
    # An empty cell of a text column is a missing value, not an empty text.
    convert = csv.ConvertOptions(decimal_point=decimal or form.decimal, strings_can_be_null=True)
    data = csv.read_csv(source, read, parse, convert)
    return data, notices + tuple(f"{path.name}: the last row is cut off, and was left out." for _ in cut)


def _ends_with(path: Path, row: str) -> bool:
    """Whether the last line of a file is this row."""
    size = 4 * len(row) + 64  # a character takes at most four bytes
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - size, 0))
        tail = file.read().replace(b"\0", b"").rstrip(b"\r\n")
    return tail.endswith((row.strip().encode(), row.strip().encode("cp1252", "ignore")))


def _parquet_of(path: Path) -> pa.Table:
    """Read a Parquet file; LogError if its unpacked size is too large."""
    with pq.ParquetFile(path) as file:
        rows, columns = file.metadata.num_rows, file.metadata.num_columns
        if 8 * rows * columns > _LARGEST:
            raise LogError(
                f"{path.name}: {rows} rows of {columns} columns unpack to more than {_LARGEST} bytes; leave "
                "out columns that are not needed, or cut the log."
            )
        # Reading a file at once takes three times the memory of its columns.
        columns = [file.read(columns=[name]).column(0) for name in file.schema_arrow.names]
        return pa.Table.from_arrays(columns, schema=file.schema_arrow)


def _text_of(path: Path) -> tuple[Any, str]:
    """Return a source in UTF-8 for pyarrow, and the start of its text; LogError if it is not text."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    encoding = _encoding(path, head)
    text = head.decode(encoding, errors="replace")
    kind = next((kind for start, kind in _KINDS.items() if head.startswith(start)), "")
    if _NO_TEXT.search(text):
        kind = kind or "holds bytes that no text has"
    if kind:
        raise LogError(f"{path.name}: not a table of text: it {kind}; export the samples as CSV or Parquet.")
    if encoding == "utf-8-sig":
        return path, text
    # Invalid bytes are replaced, so that the numbers can be read.
    return pa.BufferReader(path.read_bytes().decode(encoding, errors="replace").encode()), text


def _encoding(path: Path, head: bytes) -> str:
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    # Column names start with ASCII letters, whose second byte in UTF-16 is zero.
    for first, encoding in (((1, 3), "utf-16-le"), ((0, 2), "utf-16-be")):
        if [i for i, byte in enumerate(head[:4]) if byte == 0] == list(first):
            return encoding
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        with path.open("rb") as file:
            while part := file.read(_HEAD):
                decoder.decode(part)
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


class _Form(NamedTuple):
    """The layout of the table in a CSV file."""

    above: int  # lines above the names, or above the first row if the names are a comment
    names: list[str]  # column names, if they were found
    commented: bool  # whether the names are in a comment
    units: bool  # whether the row below the names contains units
    separator: str
    decimal: str


def _find_table(head: str, separator: str | None) -> _Form:
    """Find the column names below comments, Excel's line ``sep=;`` and a preamble.

    The names are the first line that has as many cells as most rows, and a row with a number below it. A row
    of units may be between the two, and the names may be in a comment.
    """
    lines = [(i, line) for i, line in enumerate(head.splitlines()) if line.strip() and not _SEP.match(line)]
    forms = [_find_names(lines, one) for one in ([separator] if separator else _SEPARATORS)]
    form = max(forms, key=lambda one: len(one.names))
    alone = form.names[0] if len(form.names) == 1 and not separator else ""
    if not form.names or any(one in alone for one in _SEPARATORS):
        form = _without_names(lines, separator)
    below = [line for i, line in lines if i >= form.above]
    return form._replace(decimal=_decimal_of(below, form.separator))


def _find_names(lines: list[tuple[int, str]], separator: str) -> _Form:
    rows = [_cells(_COMMENT.sub("", line), separator) for _, line in lines]
    widths = [len(row) for row in rows[1:]]
    width = max(widths, key=widths.count, default=0)
    numbers = [len(row) == width and any(map(_is_number, row)) for row in rows]
    words = [len(row) == width and any(row) and not any(map(_is_number, row)) for row in rows]
    for k, (is_words, is_numbers) in enumerate(zip(words, numbers[1:], strict=False)):
        if is_words and is_numbers:
            # Units are shorter than the names above them. A line of a preamble is not.
            units = k > 0 and words[k - 1] and len("".join(rows[k])) < len("".join(rows[k - 1]))
            first = k - units
            commented = _COMMENT.match(lines[first][1]) is not None
            return _Form(lines[first][0] + commented, rows[first], commented, units, separator, ".")
    return _Form(0, [], False, False, separator, ".")


def _without_names(lines: list[tuple[int, str]], separator: str | None) -> _Form:
    """Use the first line that is not a comment as names. The reader reports errors in it."""
    above, first = next(((i, line) for i, line in lines if not _COMMENT.match(line)), (0, ""))
    names = re.sub('"[^"]*"', "", first)
    return _Form(above, [], False, False, separator or max(_SEPARATORS, key=names.count), ".")


def _cells(line: str, separator: str) -> list[str]:
    return [cell.strip() for cell in next(reader([line], delimiter=separator), [])]


def _is_number(cell: str) -> bool:
    """Return whether a cell starts like a number or a time."""
    return re.match(r"[-+.,]?\d", cell) is not None


def _decimal_of(lines: list[str], separator: str) -> str:
    """Determine the decimal point from the rows of a table."""
    cells = [cell.strip('" ') for line in lines for cell in line.split(separator)]
    comma = separator != "," and any(re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?", cell) for cell in cells)
    return "," if comma else "."
