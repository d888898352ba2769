"""The TOML file beside a table, which maps its columns, units and rates to those of the log format.

It does for tables what the mapping file of topics does for bags. Further tables may have their own rates:
their columns are brought onto the rows of the first table. docs/log-recipes.md lists the keys.
"""

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
from pydantic import Field

from surefoot.calibration import GRAVITY
from surefoot.experiments.logs.bag import Bag, Series
from surefoot.experiments.logs.checks import OF_USE, clock_of
from surefoot.experiments.logs.clock import CLOCKS
from surefoot.experiments.logs.settings import Number, Positive, Settings
from surefoot.experiments.logs.table import LogError, LogTable, join_names, read_table
from surefoot.files import read_toml

UNITS = {
    "s": {"s": 1.0} | CLOCKS,
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "m_s2": {"m/s^2": 1.0, "g": GRAVITY, "mg": 1e-3 * GRAVITY},
    "rad": {"rad": 1.0, "deg": np.pi / 180.0},
    "rad_s": {"rad/s": 1.0, "deg/s": np.pi / 180.0},
    "Nm": {"N m": 1.0, "N mm": 1e-3},
}
"""Factors from units to SI, by the ending of the column's name."""

SI = {unit: float(factor) for units in UNITS.values() for unit, factor in units.items()}

Character = Annotated[str, Field(min_length=1, max_length=1)]


class Csv(Settings):
    """How a CSV file is written; ``None`` means that its first lines decide."""

    separator: Character | None = None
    decimal: Character | None = None


class TableMapping(Settings):
    """The contents of the TOML file."""

    columns: dict[str, str] = Field(default_factory=dict)  # of the log itself: the documented name = yours
    tables: dict[str, dict[str, str]] = Field(default_factory=dict)  # the same of further tables, by file
    units: dict[str, str] = Field(default_factory=dict)
    """By documented names, with * for any letters, and, for one table of several, its file and a colon.

    Of several patterns that fit a column the most specific one counts.
    """
    rates: dict[str, Positive] = Field(default_factory=dict)  # rows a second of tables without times, by file
    offsets_s: dict[str, Number] = Field(default_factory=dict)  # added to the times of tables, by file
    csv: Csv = Csv()

    @classmethod
    def beside(cls, log: Path) -> "TableMapping":
        """Read the ``.toml`` file with the log's name, if it exists; LogError if it is not valid."""
        path = log.with_suffix(".toml")
        mapping = cls.read(read_toml(path, LogError), path.name) if path.is_file() else cls()
        files = {log.name, *mapping.tables}
        unknown = [name for name in (*mapping.rates, *mapping.offsets_s) if name not in files]
        if unknown:
            raise LogError(
                f"{path.name}: names the table '{unknown[0]}'; there are {', '.join(sorted(files))}."
            )
        return mapping

    def read_by_mapping(self, path: Path, absent: str, own: Mapping[str, str] | None = None) -> LogTable:
        """Read one table with the documented names and in SI units.

        ``own`` maps the documented names to those of the file, by default as ``tables`` does. Raises LogError
        with the hint ``absent`` if the file does not exist, or if a column or unit does not fit.
        """
        table = read_table(path, absent, separator=self.csv.separator, decimal=self.csv.decimal)
        own = self.tables.get(path.name, {}) if own is None else own
        columns = _rename(table, own)
        if path.name in self.rates:
            columns["time_s"] = pa.array(np.arange(len(table)) / self.rates[path.name])

        def change(name: str, factor: float, offset: float = 0.0) -> None:
            values = LogTable(table.file, pa.table({name: columns[name]})).numbers(name)
            columns[name] = pa.array(factor * values + offset)

        for name in columns:
            patterns = [pattern for pattern in self.units if _fits(pattern, path.name, name)]
            if patterns:
                change(name, _factor(name, self.units[max(patterns, key=_specificity)]))
        if path.name in self.offsets_s and "time_s" in columns:
            change("time_s", 1.0, self.offsets_s[path.name])
        data = pa.table(columns, metadata=table.data.schema.metadata)
        return LogTable(table.file, data, table.notices)

    def check_units(self, tables: Sequence[LogTable]) -> None:
        """Raise LogError if a pattern of ``units`` matches no column of any table."""
        names = [(table.file, name) for table in tables for name in table.names]
        for pattern in self.units:
            if not any(_fits(pattern, file, name) for file, name in names):
                there = join_names([name for _, name in names])
                raise LogError(f"units: no column is called '{pattern}'; there are {there}.")

    def read_all(self, path: Path, absent: str) -> list[LogTable]:
        """Read a log's table and all further tables; LogError if one cannot be used."""
        others = (
            self.read_by_mapping(path.parent / name, "[tables] gives its path.") for name in self.tables
        )
        return [self.read_by_mapping(path, absent, self.columns), *others]


def merge(tables: Sequence[LogTable]) -> Bag:
    """Return tables as one on the rows of the first; LogError if the times of one cannot be used."""
    parts = tuple(map(_series, tables))
    notices = (f"{part.topic}: {len(part.time)} rows, {1.0 / part.period:.4g} a second." for part in parts)
    return Bag(tables[0].file, parts, tuple(notices))


def _fits(pattern: str, file: str, name: str) -> bool:
    return fnmatchcase(f"{file}:{name}" if ":" in pattern else name, pattern)


def _specificity(pattern: str) -> tuple[bool, int]:
    """Return how specific a pattern is: whether it names a file, and its number of letters besides ``*``."""
    return ":" in pattern, len(pattern.replace("*", ""))


def _rename(table: LogTable, own: Mapping[str, str]) -> dict[str, Any]:
    table.require(list(own.values()), f"which the TOML file names; there are {join_names(table.names)}.")
    found = {name: table.data.column(theirs) for name, theirs in own.items()}
    rest = {name: table.data.column(name) for name in table.names if name not in own.values()}
    return rest | found


def _factor(name: str, unit: str) -> float:
    """Factor from a unit of a column to SI; LogError if the column has no such unit."""
    kinds = sorted((kind for kind in UNITS if name.endswith(f"_{kind}")), key=len)
    known = UNITS[kinds[-1]] if kinds else {}
    if unit not in known:
        there = f"there are {', '.join(known)}" if known else "it has no unit"
        if name.startswith("raw_"):
            there = "what one is in newtons says nominal.scale_N_per_count of the description"
        raise LogError(f"units: '{name}' cannot be in '{unit}'; {there}.")
    return known[unit]


def _series(table: LogTable) -> Series:
    """Return the columns of a walk that a table holds."""
    table.require(["time_s"], "name it under its table, or say under [rates] how many rows a second it has.")
    time = clock_of(table.numbers("time_s"), table.file).time
    names = [name for name in table.names if OF_USE.fullmatch(name) and name != "time_s"]
    if not names:
        raise LogError(
            f"{table.file}: holds no column of a log; there are {join_names(table.names)}. Name them under "
            f'[tables."{table.file}"].'
        )
    return Series(table.file, time, {name: table.numbers(name, flags=True) for name in names})
