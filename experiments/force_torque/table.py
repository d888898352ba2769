"""One table of in-situ samples as arrays in SI units; private to the log's reader."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from surefoot.experiments.force_torque.config import Columns, InSituConfig
from surefoot.experiments.logs.checks import LogError

__all__ = ["Names", "Samples", "read_samples"]

_RAW = re.compile(r"raw_(.+)_count")


@dataclass(frozen=True)
class Names:
    """The columns that were found, in the file's own words."""

    raw: tuple[str, ...]
    acceleration: tuple[str, ...]
    points_down: bool
    """Whether the acceleration is gravity (down) rather than specific force (up at rest)."""
    time: str | None
    angular_velocity: tuple[str, ...] | None
    temperature: str | None
    set: str | None
    added_mass: str | None
    added_com: tuple[str, ...] | None


@dataclass(frozen=True, eq=False)
class Samples:
    """Rows of one set of one file, in SI units and in the accelerometer's own axes."""

    name: str
    file: str
    names: Names
    rows: NDArray[np.int64]
    """Their numbers in the file, shape (n,), which messages give."""
    raw: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    time: NDArray[np.float64] | None
    angular_velocity: NDArray[np.float64] | None
    temperature: NDArray[np.float64] | None
    added_mass: NDArray[np.float64] | None
    added_com: NDArray[np.float64] | None

    def take(self, keep: NDArray[Any]) -> "Samples":
        """Keep some of the rows."""

        def part(array: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
            return None if array is None else array[keep]

        return Samples(
            self.name,
            self.file,
            self.names,
            self.rows[keep],
            self.raw[keep],
            self.acceleration[keep],
            part(self.time),
            part(self.angular_velocity),
            part(self.temperature),
            part(self.added_mass),
            part(self.added_com),
        )


def read_samples(path: Path, config: InSituConfig) -> list[Samples]:
    """Read one file and part it into its sets.

    Raises:
        LogError: If it is no table, lacks a column, or holds what is not a number.
    """
    table = _read_table(path, config)
    names = _names_of(table.column_names, config.columns, path.name)
    units, file = config.units, path.name
    if table.num_rows == 0:
        raise LogError(f"{file}: holds no rows; record the limb's samples, one a row.")

    def vectors(columns: Sequence[str] | None) -> NDArray[np.float64] | None:
        return None if columns is None else np.stack([_numbers(table, name, file) for name in columns], -1)

    def scalars(column: str | None) -> NDArray[np.float64] | None:
        return None if column is None else _numbers(table, column, file)

    time, spin, temperature = scalars(names.time), vectors(names.angular_velocity), scalars(names.temperature)
    raw, acceleration = vectors(names.raw), vectors(names.acceleration)
    assert raw is not None
    assert acceleration is not None
    whole = Samples(
        name=path.stem,
        file=file,
        names=names,
        rows=np.arange(table.num_rows),
        raw=raw,
        acceleration=acceleration * units.metre_per_second_squared,
        time=None if time is None else time * units.second,
        angular_velocity=None if spin is None else spin * units.radian_per_second,
        temperature=None if temperature is None else temperature + units.zero_celsius,
        added_mass=scalars(names.added_mass),
        added_com=vectors(names.added_com),
    )
    if names.set is None:
        return [whole]
    labels = _labels(table, names.set, file)
    return [_named(whole.take(labels == name), name) for name in dict.fromkeys(labels.tolist())]


def _named(samples: Samples, name: str) -> Samples:
    return replace(samples, name=name)


def _read_table(path: Path, config: InSituConfig) -> pa.Table:
    if not path.is_file():
        raise LogError(f"{path}: no such file; 'surefoot calibrate ft --sample' shows one that works.")
    try:
        if path.suffix == ".parquet":
            return pq.read_table(path)
        if path.suffix == ".csv":
            parse = csv.ParseOptions(delimiter=config.separator)
            # An empty cell in a column of names is no name.
            convert = csv.ConvertOptions(decimal_point=config.decimal, strings_can_be_null=True)
            return csv.read_csv(path, parse_options=parse, convert_options=convert)
    except (pa.ArrowInvalid, pa.ArrowTypeError, OSError, UnicodeDecodeError) as error:
        text = str(error).splitlines()[0]
        if "Empty CSV" in text:
            raise LogError(
                f"{path.name}: is empty; record a line of column names and a row a sample."
            ) from None
        if "Expected" in text and "columns" in text:
            raise LogError(
                f"{path.name}: columns are of unequal length ({text}); write every row whole, and leave a "
                "cell empty where no sample arrived."
            ) from None
        raise LogError(f"{path.name}: not a readable table ({text}).") from None
    raise LogError(f"{path.name}: a log ends in .parquet or .csv; rename or convert the file.")


def _names_of(given: list[str], columns: Columns, file: str) -> Names:
    twice = sorted({name for name in given if given.count(name) > 1})
    if twice:
        raise LogError(f"{file}: column '{twice[0]}' is there twice; rename one of them.")

    def need(names: Sequence[str], what: str) -> tuple[str, ...]:
        missing = [name for name in names if name not in given]
        if missing:
            alone = " (if the separator is not ',', say csv.separator)" if len(given) == 1 else ""
            raise LogError(
                f"{file}: missing column {', '.join(missing)} for {what}; there are {_listed(given)}{alone}. "
                "Name your columns under [columns] in the TOML file, or on the command line."
            )
        return tuple(names)

    def optional(chosen: Sequence[str] | None, default: Sequence[str], what: str) -> tuple[str, ...] | None:
        if chosen is not None:
            return need(chosen, what)
        there = [name for name in default if name in given]
        return need(default, what) if there else None

    raw = columns.raw
    if raw is None:
        found = [(match[1], name) for name in given if (match := _RAW.fullmatch(name))]
        if found and all(key.isdigit() for key, _ in found):
            found.sort(key=lambda pair: int(pair[0]))
        raw = tuple(name for _, name in found)
        if len(raw) < 6:
            need(tuple(f"raw_{i}_count" for i in range(6)), "the sensor's channels")
    gravity = optional(columns.gravity, _vector("gravity", "m_s2"), "gravity")
    force = optional(columns.specific_force, _vector("specific_force", "m_s2"), "specific force")
    if columns.gravity is None and columns.specific_force is not None:
        gravity = None
    elif columns.specific_force is None and columns.gravity is not None:
        force = None
    if gravity is not None and force is not None:
        raise LogError(
            f"{file}: has both {gravity[0]} and {force[0]}, which say the same with opposite signs; name the "
            "one to use under [columns]."
        )
    chosen = gravity or force or need(_vector("specific_force", "m_s2"), "the accelerometer")
    return Names(
        raw=need(raw, "the sensor's channels"),
        acceleration=chosen,
        points_down=gravity is not None,
        time=_time(columns.time, need),
        angular_velocity=optional(
            columns.angular_velocity, _vector("angular_velocity", "rad_s"), "the gyroscope"
        ),
        temperature=_one(optional(_many(columns.temperature), ("temperature_degC",), "the temperature")),
        set=_one(optional(_many(columns.set), ("set",), "the sets")),
        added_mass=_one(optional(_many(columns.added_mass), ("added_mass_kg",), "the added mass")),
        added_com=optional(columns.added_com, _vector("added_com", "m"), "the added mass's place"),
    )


def _time(chosen: str | None, need: Any) -> str | None:
    if chosen == "":
        return None
    return str(need((chosen or "time_s",), 'the time (or say time = "" for samples without an order)')[0])


def _vector(stem: str, unit: str) -> tuple[str, ...]:
    return tuple(f"{stem}_{axis}_{unit}" for axis in "xyz")


def _many(name: str | None) -> tuple[str, ...] | None:
    return None if name is None else (name,)


def _one(names: tuple[str, ...] | None) -> str | None:
    return None if names is None else names[0]


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(f"'{name}'" for name in names[:24])
    return shown + (f" and {len(names) - 24} more" if len(names) > 24 else "")


def _numbers(table: pa.Table, name: str, file: str) -> NDArray[np.float64]:
    column = table.column(name)
    if pa.types.is_null(column.type):
        return np.full(table.num_rows, np.nan)
    if not (
        pa.types.is_integer(column.type)
        or pa.types.is_floating(column.type)
        or pa.types.is_decimal(column.type)
    ):
        for row, value in enumerate(column.to_pylist()):
            try:
                float(value) if value is not None else None
                sound = not isinstance(value, bool)
            except (TypeError, ValueError):
                sound = False
            if not sound:
                raise LogError(
                    f"{file}: column '{name}' holds {value!r} at row {row}, which is no number; leave the "
                    "cell empty where no sample arrived, and check csv.separator and csv.decimal."
                )
        return np.array([np.nan if v is None else float(v) for v in column.to_pylist()], dtype=np.float64)
    return np.asarray(column.cast(pa.float64()).to_numpy(), dtype=np.float64)


def _labels(table: pa.Table, name: str, file: str) -> NDArray[Any]:
    values = table.column(name).to_pylist()
    for row, value in enumerate(values):
        if value is None or value != value:
            raise LogError(f"{file}: column '{name}' is empty at row {row}; name or number every row's set.")
    # A number that passed through a table with empty cells comes back as 1.0.
    return np.array([f"{v:g}" if isinstance(v, float) else str(v) for v in values], dtype=object)
