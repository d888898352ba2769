"""One table of in-situ samples as arrays in SI units."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.experiments.force_torque.config import SI, Columns, InSituConfig
from surefoot.experiments.logs.bag import is_bag, read_bag
from surefoot.experiments.logs.table import LogError, LogTable, join_names, read_table

_VECTORS = {"gravity": "m_s2", "specific_force": "m_s2", "angular_velocity": "rad_s", "added_com": "m"}
_SCALARS = {"time": "time_s", "set": "set", "temperature": "temperature_degC", "added_mass": "added_mass_kg"}
"""Names of the columns by quantity; vectors have three, with the unit."""

_PURPOSES = {
    "time": 'the time (or say time = "" for samples without an order)',
    "raw": "the sensor's channels",
    "specific_force": "the accelerometer",
    "angular_velocity": "the gyroscope",
}

WRENCH = (*(f"force_{axis}_N" for axis in "xyz"), *(f"torque_{axis}_Nm" for axis in "xyz"))
"""Names of the channels that are a driver's wrench."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Rows of one set of one file, in SI units and in the accelerometer's own axes."""

    name: str
    file: str
    columns: Columns  # that were found; either ``gravity`` or ``specific_force`` is None
    rows: NDArray[np.int64]  # numbers in the file, for messages, shape (n,)
    raw: Floats  # counts, or a driver's N and N m, shape (n, k)
    acceleration: Floats  # specific force (up at rest) or gravity (down) in m/s^2, shape (n, 3)
    time: Floats | None  # in s, shape (n,)
    angular_velocity: Floats | None  # in rad/s, shape (n, 3)
    temperature: Floats | None  # in degrees Celsius, shape (n,)
    added_mass: Floats | None  # in kg, shape (n,)
    added_com: Floats | None  # in m, shape (n, 3)

    def __str__(self) -> str:
        """Name in messages."""
        return f"{self.file}, set '{self.name}'"

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


def read_samples(
    path: Path, config: InSituConfig, notices: list[str], topics: Path | None = None
) -> list[Samples]:
    """Read one file, and return the samples of each of its sets; LogError if it is no such table.

    Each conversion is added to the notices; a bag has the mapping file ``topics``.
    """
    absent = "'surefoot calibrate ft --sample' shows one that works."
    if is_bag(path):
        table = read_bag(path, topics).table()
    else:
        table = read_table(path, absent, separator=config.csv.separator, decimal=config.csv.decimal)
    notices += table.notices
    found = _find_columns(table, config.columns, _channels(table) if config.units.raw == "count" else WRENCH)
    units = {name: SI[unit] for name, unit in config.units if name != "raw"}

    def values(names: str | Sequence[str] | None, factor: float = 1.0) -> Any:
        if names is None:
            return None
        return factor * (table.numbers(names) if isinstance(names, str) else table.stack_columns(names))

    temperature = values(found.temperature)
    whole = Samples(
        name=path.stem,
        file=path.name,
        columns=found,
        rows=np.arange(len(table)),
        raw=values(found.raw),
        acceleration=values(found.gravity or found.specific_force, units["acceleration"]),
        time=values(found.time, units["time"]),
        angular_velocity=values(found.angular_velocity, units["angular_velocity"]),
        temperature=None if temperature is None else temperature + units["temperature"],
        added_mass=values(found.added_mass),
        added_com=values(found.added_com),
    )
    if found.set is None:
        return [whole]
    labels = _labels(table, found.set)
    return [replace(whole.take(labels == name), name=name) for name in dict.fromkeys(labels.tolist())]


def _find_columns(table: LogTable, columns: Columns, channels: tuple[str, ...]) -> Columns:
    """Return the names of the columns that are there, by their given or default names."""
    there = f"there are {join_names(table.names)}."
    cure = f"{there} Name yours under [columns] in the TOML file, or on the command line."
    defaults: dict[str, Any] = {
        key: tuple(f"{key}_{axis}_{unit}" for axis in "xyz") for key, unit in _VECTORS.items()
    }
    defaults |= _SCALARS | {"raw": channels}
    needed = {"time", "raw"}
    if columns.gravity is None and not any(name in table for name in defaults["gravity"]):
        needed.add("specific_force")
    elif (columns.gravity is None) != (columns.specific_force is None):
        # The one that is named is meant, whatever else is there.
        defaults.pop("specific_force" if columns.specific_force is None else "gravity")
    found = {}
    for key, default in defaults.items():
        given = getattr(columns, key)
        wanted = default if given is None else given
        names = (wanted,) if isinstance(wanted, str) else wanted
        if wanted and (given or key in needed or any(name in table for name in names)):
            table.require(names, cure, _PURPOSES.get(key, key.replace("_", " ")))
            found[key] = wanted
    if "gravity" in found and "specific_force" in found:
        raise LogError(
            f"{table.file}: has both {found['gravity'][0]} and {found['specific_force'][0]}, which say the "
            "same with opposite signs; name the one to use under [columns]."
        )
    return Columns(**found)


def _channels(table: LogTable) -> tuple[str, ...]:
    """Return the columns that are named as channels, by number where they are numbered; at least six."""
    found = table.channels
    numbers = [name.removeprefix("raw_").removesuffix("_count") for name in found]
    if all(number.isdigit() for number in numbers):
        found = tuple(sorted(found, key=lambda name: int(name.split("_")[1])))
    return found if len(found) >= 6 else tuple(f"raw_{i}_count" for i in range(6))


def _labels(table: LogTable, name: str) -> NDArray[np.object_]:
    values = table.data.column(name).to_pylist()
    for row, value in enumerate(values):
        if value is None or value != value:
            raise LogError(
                f"{table.file}: column '{name}' is empty at row {row}; name or number every row's set."
            )
    # A number that passed through a table with empty cells comes back as 1.0.
    return np.array([f"{v:g}" if isinstance(v, float) else str(v) for v in values], dtype=object)
