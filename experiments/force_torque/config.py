"""What a log of in-situ sets leaves open: names, units, frames, masses.

A TOML file beside the log holds it; ``docs/in-situ-log.md`` lists every key. Unknown keys are refused, since
a misspelt one would leave a default standing that nobody meant.
"""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY
from surefoot.calibration.imu import AccelerometerModel
from surefoot.calibration.in_situ import InSituOptions
from surefoot.experiments.force_torque.icub import read_matrix
from surefoot.experiments.logs.table import LogError

__all__ = ["AddedMass", "Columns", "InSituConfig", "read_config"]

Place = tuple[float, float, float]

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "acceleration": {"m/s^2": 1.0, "g": GRAVITY, "mg": 1e-3 * GRAVITY},
    "angular_velocity": {"rad/s": 1.0, "deg/s": float(np.pi / 180.0)},
    "temperature": {"degC": 0.0, "K": -273.15},
}
"""What each unit that a configuration may name is worth in SI: a factor, for temperatures what is added."""


@dataclass(frozen=True)
class Columns:
    """Names of the table's columns; ``None`` where the default name, or a pattern, finds them."""

    time: str | None = None
    """Empty for samples without an order in time."""
    set: str | None = None
    raw: tuple[str, ...] | None = None
    specific_force: tuple[str, ...] | None = None
    gravity: tuple[str, ...] | None = None
    angular_velocity: tuple[str, ...] | None = None
    temperature: str | None = None
    added_mass: str | None = None
    added_com: tuple[str, ...] | None = None


@dataclass(frozen=True)
class AddedMass:
    """What hung on the limb during one set: kg, and m in the sensor's frame."""

    mass: float = 0.0
    com: Place = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class InSituConfig:
    """Everything that the table leaves open."""

    columns: Columns = field(default_factory=Columns)
    units: Mapping[str, str] = field(default_factory=dict)
    """A name of :data:`UNITS` by quantity; SI and degrees Celsius where none is given."""
    separator: str = ","
    decimal: str = "."
    R_sensor_accelerometer: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    position_imu: Place = (0.0, 0.0, 0.0)
    accelerometer_model: AccelerometerModel | None = None
    """What is fitted to the accelerometer before all else; nothing by default."""
    sensor: str = ""
    range_count: tuple[float, float] | None = None
    full_scale: NDArray[np.float64] | None = None
    factory_matrix: NDArray[np.float64] | None = None
    limb_mass: float | None = None
    """Of the bare limb beyond the sensor in kg, as a pair of scales shows it."""
    limb_mass_std: float | None = None
    """With it the known mass enters the fit; without it the fit is only compared with it."""
    fit_sets: tuple[str, ...] | None = None
    """Sets that make the fit; the others are kept aside to prove it. All by default."""
    options: InSituOptions = field(default_factory=InSituOptions)
    sets: Mapping[str, AddedMass] | None = None
    """``None`` if the file lists none: then the masses stand in columns, or nothing was added."""
    file: str = "the configuration"

    def unit(self, quantity: str) -> float:
        """Return what the unit of a quantity is worth in SI."""
        units = UNITS[quantity]
        return units[self.units[quantity]] if quantity in self.units else next(iter(units.values()))

    def override(self, **names: Any) -> "InSituConfig":
        """Return it with names of columns from the command line; ``None`` keeps what there was.

        Raises:
            LogError: If there are too few or too many names for a quantity.
        """
        given = {key: value for key, value in names.items() if value is not None}
        try:
            given = {key: _column(f"columns.{key}", value) for key, value in given.items()}
        except ValueError as error:
            raise LogError(f"the command line: {error}.") from None
        # One of the two sources of gravity named on the command line stands for both.
        if "gravity" in given and "specific_force" not in given:
            given["specific_force"] = None
        elif "specific_force" in given and "gravity" not in given:
            given["gravity"] = None
        return replace(self, columns=replace(self.columns, **given))


def read_config(path: Path) -> InSituConfig:
    """Read the TOML file.

    Raises:
        LogError: If it is not there, not TOML, holds an unknown key, or a value of the wrong kind.
    """
    if not path.is_file():
        raise LogError(f"{path}: no such file; see docs/in-situ-log.md for what it holds.")
    try:
        return _config(tomllib.loads(path.read_text(encoding="utf-8")), path)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise LogError(f"{path.name}: not TOML: {error}.") from None
    except LogError:
        raise
    except ValueError as error:
        raise LogError(f"{path.name}: {error}; see docs/in-situ-log.md.") from None


def _config(given: Mapping[str, Any], path: Path) -> InSituConfig:
    _known(given, tuple(TABLES), "")
    found: dict[str, Any] = {"file": path.name, "columns": {}, "units": {}}
    for name, keys in TABLES.items():
        table = given.get(name, {})
        if name == "sets":
            continue
        if not isinstance(table, dict):
            raise ValueError(f"'{name}' must be a table, such as [{name}]")
        _known(table, keys, f"{name}.")
        if name == "factory" and len(table) > 1:
            raise ValueError("'factory' holds both a 'matrix' and a 'file'; give one of them")
        for key, value in table.items():
            if name in ("columns", "units"):
                found[name][key] = (_column if name == "columns" else _unit)(f"{name}.{key}", value)
            elif (place := _FIELDS.get(f"{name}.{key}")) is not None:
                found[place[0]] = place[1](f"{name}.{key}", value)
    found["columns"] = Columns(**found["columns"])
    if "file" in given.get("factory", {}):
        found["factory_matrix"], full_scale = read_matrix(path.parent / str(given["factory"]["file"]))
        found.setdefault("full_scale", full_scale)
    if "limb_mass_std" in found and "limb_mass" not in found:
        raise ValueError("'limb.mass_std_kg' needs 'limb.mass_kg' beside it")
    found["options"] = _options(given.get("fit", {}), found.get("range_count"))
    if "sets" in given:
        found["sets"] = _sets(given["sets"])
    return InSituConfig(**found)


def _known(table: Mapping[str, Any], known: tuple[str, ...], stem: str) -> None:
    for key in table:
        if key not in known:
            raise ValueError(
                f"unknown key '{stem}{key}'; there are {', '.join(stem + name for name in known)}"
            )


def _numbers(key: str, value: Any, shape: tuple[int, ...] | None) -> NDArray[np.float64]:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"'{key}' must hold numbers, got {value!r}") from None
    if isinstance(value, str | bool) or not np.isfinite(array).all():
        raise ValueError(f"'{key}' must hold finite numbers, got {value!r}")
    if shape is not None and array.shape != shape:
        raise ValueError(f"'{key}' must have shape {shape}, got {array.shape}")
    return array


def _place(key: str, value: Any) -> Place:
    x, y, z = _numbers(key, value, (3,)).tolist()
    return x, y, z


def _column(key: str, value: Any) -> Any:
    """Check a name, or names, of a field of :class:`Columns`."""
    name = key.partition(".")[2]
    if name not in ("raw", "specific_force", "gravity", "angular_velocity", "added_com"):
        if not isinstance(value, str):
            raise ValueError(f"the column of '{name}' must be a name, got {value!r}")
        return value
    if not isinstance(value, list | tuple) or not all(isinstance(one, str) for one in value):
        raise ValueError(f"columns of '{name}' must be a list of names, got {value!r}")
    if name == "raw" and len(value) < 6:
        raise ValueError(
            f"columns of 'raw' name {len(value)} channels ({', '.join(value)}), and a six-axis sensor has "
            "at least 6; name them all"
        )
    if name != "raw" and len(value) != 3:
        raise ValueError(f"columns of '{name}' must be three (x, y, z), got {len(value)}: {', '.join(value)}")
    return tuple(value)


def _unit(key: str, value: Any) -> str:
    units = UNITS[key.partition(".")[2]]
    if value not in units:
        raise ValueError(f"'{key}' must be one of {', '.join(units)}, got {value!r}")
    return str(value)


def _character(key: str, value: Any) -> str:
    if not isinstance(value, str) or len(value) != 1:
        raise ValueError(f"'{key}' must be one character, got {value!r}")
    return value


def _rotation(key: str, value: Any) -> NDArray[np.float64]:
    R = _numbers(key, value, (3, 3))
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-3) or np.linalg.det(R) < 0.0:
        raise ValueError(f"'{key}' must be a rotation (orthonormal rows, determinant +1), got {R.tolist()}")
    return R


def _model(key: str, value: Any) -> str:
    if value not in get_args(AccelerometerModel):
        raise ValueError(f"'{key}' must be one of {', '.join(get_args(AccelerometerModel))}, got {value!r}")
    return str(value)


def _range(key: str, value: Any) -> tuple[float, float]:
    low, high = _numbers(key, value, (2,)).tolist()
    if low >= high:
        raise ValueError(f"'{key}' must be [lowest, highest], got {[low, high]}")
    return low, high


def _full_scale(key: str, value: Any) -> NDArray[np.float64]:
    scale = _numbers(key, value, (6,))
    if not (scale > 0.0).all():
        raise ValueError(f"'{key}' must be positive N and N m, got {scale.tolist()}")
    return scale


def _matrix(key: str, value: Any) -> NDArray[np.float64]:
    matrix = _numbers(key, value, None)
    if matrix.ndim != 2 or matrix.shape[0] != 6 or matrix.shape[1] < 6:
        raise ValueError(f"'{key}' must have 6 rows (fx fy fz tx ty tz), got {matrix.shape}")
    return matrix


def _mass(key: str, value: Any) -> float:
    mass = float(_numbers(key, value, ()))
    if mass <= 0.0:
        raise ValueError(f"'{key}' must be above 0 kg, got {mass:g}")
    return mass


def _set_names(key: str, value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not value:
        raise ValueError(f"'{key}' must be a list of names of sets, got {value!r}")
    return tuple(str(name) for name in value)


_FIELDS: dict[str, tuple[str, Callable[[str, Any], Any]]] = {
    "csv.separator": ("separator", _character),
    "csv.decimal": ("decimal", _character),
    "accelerometer.R_sensor_accelerometer": ("R_sensor_accelerometer", _rotation),
    "accelerometer.position_m": (
        "position_imu",
        lambda key, value: tuple(_numbers(key, value, (3,)).tolist()),
    ),
    "accelerometer.calibrate": ("accelerometer_model", _model),
    "sensor.name": ("sensor", lambda _, value: str(value)),
    "sensor.range_count": ("range_count", _range),
    "sensor.full_scale": ("full_scale", _full_scale),
    "factory.matrix": ("factory_matrix", _matrix),
    "limb.mass_kg": ("limb_mass", _mass),
    "limb.mass_std_kg": ("limb_mass_std", _mass),
    "fit.sets": ("fit_sets", _set_names),
}
"""The field of :class:`InSituConfig` that a key fills, and what checks its value."""

TABLES = {
    "columns": tuple(one.name for one in fields(Columns)),
    "units": tuple(UNITS),
    "csv": ("separator", "decimal"),
    "accelerometer": ("R_sensor_accelerometer", "position_m", "calibrate"),
    "sensor": ("name", "range_count", "full_scale"),
    "factory": ("matrix", "file"),
    "limb": ("mass_kg", "mass_std_kg"),
    "fit": ("sets", "drift", "robust", "hysteresis", "estimate_rotation", "factory_std"),
    "sets": ("name", "added_mass_kg", "added_com_m"),
}
"""The keys that a file may hold, by table."""


def _options(table: Mapping[str, Any], code_range: tuple[float, float] | None) -> InSituOptions:
    given: dict[str, Any] = {
        key: tuple(v) if isinstance(v, list) else v for key, v in table.items() if key != "sets"
    }
    for key in ("robust", "hysteresis", "estimate_rotation"):
        if key in given and not isinstance(given[key], bool):
            raise ValueError(f"'fit.{key}' must be true or false, got {given[key]!r}")
    try:
        return InSituOptions(**given, code_range=code_range)
    except (TypeError, ValueError) as error:
        raise ValueError(f"'fit': {str(error).rstrip('.')}") from None


def _sets(given: Any) -> dict[str, AddedMass]:
    if not isinstance(given, list) or not all(isinstance(entry, dict) for entry in given):
        raise ValueError("'sets' must be a list of tables, each under its own [[sets]]")
    found: dict[str, AddedMass] = {}
    for i, entry in enumerate(given):
        _known(entry, TABLES["sets"], "sets.")
        if "name" not in entry:
            raise ValueError(f"number {i + 1} of [[sets]] has no 'name'; name it as the log does")
        name = str(entry["name"])
        mass = float(_numbers(f"added_mass_kg of set '{name}'", entry.get("added_mass_kg", 0.0), ()))
        if mass < 0.0:
            raise ValueError(
                f"set '{name}' has added_mass_kg = {mass:g}; a mass is at least 0 (take the limb without "
                "its part as the bare one)"
            )
        if mass > 0.0 and "added_com_m" not in entry:
            raise ValueError(
                f"set '{name}' has {mass:g} kg and no 'added_com_m'; give the place of its centre of mass "
                "in the sensor's frame"
            )
        added = AddedMass(mass, _place(f"added_com_m of set '{name}'", entry.get("added_com_m", (0, 0, 0))))
        if name in found:
            before = found[name]
            same = "twice" if before == added else f"with {before.mass:g} kg and with {mass:g} kg"
            raise ValueError(f"set '{name}' is listed {same}; list each set once")
        found[name] = added
    return found
