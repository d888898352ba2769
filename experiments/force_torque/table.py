"""One table of in-situ samples as arrays in SI units."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.experiments.force_torque.config import Columns, InSituConfig
from surefoot.experiments.logs.table import LogError, LogTable, read_table

__all__ = ["Samples", "read_samples"]

Floats = NDArray[np.float64]

_RAW = re.compile(r"raw_(.+)_count")
_ABSENT = "'surefoot calibrate ft --sample' shows one that works."
_LISTED = 24
"""Columns of the file that a message names."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Rows of one set of one file, in SI units and in the accelerometer's own axes.

    Attributes:
        name: The set.
        file: The file, for messages.
        columns: Names of the columns that were found; either ``gravity`` or ``specific_force`` is None.
        rows: Numbers of the rows in the file, for messages, shape (n,).
        raw: Counts, shape (n, k).
        acceleration: Specific force (up at rest) or gravity (down) in m/s^2, shape (n, 3).
        time: In s, shape (n,).
        angular_velocity: In rad/s, shape (n, 3).
        temperature: In degrees Celsius, shape (n,).
        added_mass: In kg, shape (n,).
        added_com: In m, shape (n, 3).
    """

    name: str
    file: str
    columns: Columns
    rows: NDArray[np.int64]
    raw: Floats
    acceleration: Floats
    time: Floats | None
    angular_velocity: Floats | None
    temperature: Floats | None
    added_mass: Floats | None
    added_com: Floats | None

    @property
    def points_down(self) -> bool:
        """Whether the acceleration is gravity (down) rather than specific force (up at rest)."""
        return self.columns.gravity is not None

    @property
    def acceleration_names(self) -> tuple[str, ...]:
        """Names of the columns of the acceleration."""
        return self.columns.gravity or self.columns.specific_force or ()

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the columns of counts."""
        return self.columns.raw or ()

    def take(self, keep: NDArray[np.bool_]) -> "Samples":
        """Return some of the rows."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        arrays: dict[str, Any] = {k: v[keep] for k, v in values.items() if isinstance(v, np.ndarray)}
        return replace(self, **arrays)


def read_samples(path: Path, config: InSituConfig) -> list[Samples]:
    """Read one file, and return the samples of each of its sets.

    Raises:
        LogError: If it is no table, lacks a column, or holds what is not a number.
    """
    table = read_table(path, _ABSENT, separator=config.separator, decimal=config.decimal)
    found = _found(table, config.columns)
    if len(table) == 0:
        raise LogError(f"{path.name}: holds no rows; record the limb's samples, one a row.")

    def vectors(columns: Sequence[str] | None, factor: float = 1.0) -> Floats | None:
        return None if columns is None else table.stacked(columns) * factor

    def scalars(column: str | None, factor: float = 1.0) -> Floats | None:
        return None if column is None else table.numbers(column) * factor

    temperature = scalars(found.temperature)
    whole = Samples(
        name=path.stem,
        file=path.name,
        columns=found,
        rows=np.arange(len(table)),
        raw=table.stacked(found.raw or ()),
        acceleration=table.stacked(found.gravity or found.specific_force or ()) * config.unit("acceleration"),
        time=scalars(found.time, config.unit("time")),
        angular_velocity=vectors(found.angular_velocity, config.unit("angular_velocity")),
        temperature=None if temperature is None else temperature + config.unit("temperature"),
        added_mass=scalars(found.added_mass),
        added_com=vectors(found.added_com),
    )
    if found.set is None:
        return [whole]
    labels = _labels(table, found.set)
    return [replace(whole.take(labels == name), name=name) for name in dict.fromkeys(labels.tolist())]


def _found(table: LogTable, columns: Columns) -> Columns:
    """Return the names of the columns that are there, by their given or default names."""
    names = table.names
    shown = ", ".join(f"'{name}'" for name in names[:_LISTED])
    shown += f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    shown += " (if the separator is not ',', say csv.separator)" if len(names) == 1 else ""
    cure = f"there are {shown}. Name your columns under [columns] in the TOML file, or on the command line."

    def optional(given: Sequence[str] | None, default: Sequence[str], what: str) -> tuple[str, ...] | None:
        if given is None and not any(name in table for name in default):
            return None
        return table.require(default if given is None else given, cure, what)

    def one(given: str | None, default: str, what: str) -> str | None:
        found = optional(None if given is None else (given,), (default,), what)
        return None if found is None else found[0]

    gravity = optional(columns.gravity, _vector("gravity", "m_s2"), "gravity")
    force = optional(columns.specific_force, _vector("specific_force", "m_s2"), "specific force")
    if columns.gravity is None and columns.specific_force is not None:
        gravity = None
    elif columns.specific_force is None and columns.gravity is not None:
        force = None
    if gravity is not None and force is not None:
        raise LogError(
            f"{table.file}: has both {gravity[0]} and {force[0]}, which say the same with opposite signs; "
            "name the one to use under [columns]."
        )
    if gravity is None and force is None:
        force = table.require(_vector("specific_force", "m_s2"), cure, "the accelerometer")
    time = None
    if columns.time != "":
        what = 'the time (or say time = "" for samples without an order)'
        time = table.require((columns.time or "time_s",), cure, what)[0]
    return Columns(
        time=time,
        set=one(columns.set, "set", "the sets"),
        raw=table.require(columns.raw or _channels(names), cure, "the sensor's channels"),
        specific_force=force,
        gravity=gravity,
        angular_velocity=optional(
            columns.angular_velocity, _vector("angular_velocity", "rad_s"), "the gyroscope"
        ),
        temperature=one(columns.temperature, "temperature_degC", "the temperature"),
        added_mass=one(columns.added_mass, "added_mass_kg", "the added mass"),
        added_com=optional(columns.added_com, _vector("added_com", "m"), "the added mass's place"),
    )


def _channels(names: Sequence[str]) -> tuple[str, ...]:
    """Return the columns that are named as channels, by number where they are numbered; at least six."""
    found = [(match[1], name) for name in names if (match := _RAW.fullmatch(name))]
    if found and all(key.isdigit() for key, _ in found):
        found.sort(key=lambda pair: int(pair[0]))
    return tuple(name for _, name in found) if len(found) >= 6 else tuple(f"raw_{i}_count" for i in range(6))


def _vector(stem: str, unit: str) -> tuple[str, ...]:
    return tuple(f"{stem}_{axis}_{unit}" for axis in "xyz")


def _labels(table: LogTable, name: str) -> NDArray[np.object_]:
    values = table.data.column(name).to_pylist()
    for row, value in enumerate(values):
        if value is None or value != value:
            raise LogError(
                f"{table.file}: column '{name}' is empty at row {row}; name or number every row's set."
            )
    # A number that passed through a table with empty cells comes back as 1.0.
    return np.array([f"{v:g}" if isinstance(v, float) else str(v) for v in values], dtype=object)
