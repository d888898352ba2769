"""What a log of in-situ sets does not say itself: names, units, frames, masses; private to the log's reader.

A TOML file beside the log holds it; ``docs/in-situ-log.md`` lists every key. Unknown keys are refused, since
a misspelt one would leave a default standing that nobody meant.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY
from surefoot.calibration.imu.accelerometer import AccelerometerModel
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.experiments.force_torque.icub import read_matrix
from surefoot.experiments.logs.checks import LogError

__all__ = ["AddedMass", "Columns", "InSituConfig", "read_config"]

_VECTORS = ("specific_force", "gravity", "angular_velocity", "added_com")


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


def check_column_names(key: str, value: Any, file: str) -> None:
    """Check what was given for a field of :class:`Columns`.

    Args:
        key: The field.
        value: A name, or names.
        file: Where it was given, for messages.

    Raises:
        LogError: If it is no name, or not as many names as the field asks for.
    """
    if key in ("raw", *_VECTORS):
        if not isinstance(value, list | tuple) or not all(isinstance(name, str) for name in value):
            raise LogError(f"{file}: columns of '{key}' must be a list of names, got {value!r}.")
        if key == "raw" and len(value) < 6:
            raise LogError(
                f"{file}: columns of 'raw' name {len(value)} channels ({', '.join(value)}), and a six-axis "
                "sensor has at least 6; name them all."
            )
        if key != "raw" and len(value) != 3:
            raise LogError(
                f"{file}: columns of '{key}' must be three (x, y, z), got {len(value)}: {', '.join(value)}."
            )
    elif not isinstance(value, str):
        raise LogError(f"{file}: the column of '{key}' must be a name, got {value!r}.")


_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_ACCELERATION = {"m/s^2": 1.0, "g": GRAVITY, "mg": 1e-3 * GRAVITY}
_ANGULAR_VELOCITY = {"rad/s": 1.0, "deg/s": float(np.pi / 180.0)}
_TEMPERATURE = {"degC": 0.0, "K": -273.15}

UNITS = {
    "time": _TIME,
    "acceleration": _ACCELERATION,
    "angular_velocity": _ANGULAR_VELOCITY,
    "temperature": _TEMPERATURE,
}
"""What each unit that a configuration may name is worth in SI, by the fields of :class:`Units`."""


@dataclass(frozen=True)
class Units:
    """What one unit of a column is worth in SI."""

    time: str = "s"
    acceleration: str = "m/s^2"
    angular_velocity: str = "rad/s"
    temperature: str = "degC"

    @property
    def second(self) -> float:
        return _TIME[self.time]

    @property
    def metre_per_second_squared(self) -> float:
        return _ACCELERATION[self.acceleration]

    @property
    def radian_per_second(self) -> float:
        return _ANGULAR_VELOCITY[self.angular_velocity]

    @property
    def zero_celsius(self) -> float:
        return _TEMPERATURE[self.temperature]


@dataclass(frozen=True)
class AddedMass:
    """What hung on the limb during one set: kg, and m in the sensor's frame."""

    mass: float
    com: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class InSituConfig:
    """Everything that the table leaves open."""

    columns: Columns = field(default_factory=Columns)
    units: Units = field(default_factory=Units)
    separator: str = ","
    decimal: str = "."
    R_sensor_accelerometer: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    position_imu: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accelerometer_model: AccelerometerModel | None = None
    """What is fitted to the accelerometer before all else; nothing by default."""
    sensor: str = ""
    range_count: tuple[float, float] | None = None
    full_scale: NDArray[np.float64] | None = None
    factory_matrix: NDArray[np.float64] | None = None
    limb_mass: float | None = None
    """Of the bare limb beyond the sensor in kg, as a pair of scales tells."""
    limb_mass_std: float | None = None
    """With it the known mass enters the fit; without it the fit is only held against it."""
    fit_sets: tuple[str, ...] | None = None
    """Sets that make the fit; the others are kept aside to prove it. All by default."""
    options: InSituOptions = field(default_factory=InSituOptions)
    sets: Mapping[str, AddedMass] | None = None
    """``None`` if the file lists none: then the masses stand in columns, or nothing was added."""
    file: str = "the configuration"

    def override(self, **names: Any) -> "InSituConfig":
        """Replace names of columns by those of the command line; ``None`` keeps what there was."""
        given = {key: value for key, value in names.items() if value is not None}
        # One of the two sources of gravity named on the command line stands for both.
        if "gravity" in given and "specific_force" not in given:
            given["specific_force"] = None
        elif "specific_force" in given and "gravity" not in given:
            given["gravity"] = None
        for key, value in given.items():
            if value is not None:
                check_column_names(key, value, "the command line")
        return replace(self, columns=replace(self.columns, **given)) if given else self


def read_config(path: Path) -> InSituConfig:
    """Read the TOML file.

    Raises:
        LogError: If it is not there, not TOML, holds an unknown key, or a value of the wrong kind.
    """
    if not path.is_file():
        raise LogError(f"{path}: no such file; see docs/in-situ-log.md for what it holds.")
    try:
        told = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise LogError(f"{path.name}: not TOML: {error}.") from None
    return _Reader(path).config(told)


_TABLES = {
    "columns": tuple(f.name for f in fields(Columns)),
    "units": tuple(f.name for f in fields(Units)),
    "csv": ("separator", "decimal"),
    "accelerometer": ("R_sensor_accelerometer", "position_m", "calibrate"),
    "sensor": ("name", "range_count", "full_scale"),
    "factory": ("matrix", "file"),
    "limb": ("mass_kg", "mass_std_kg"),
    "fit": ("sets", "drift", "robust", "hysteresis", "estimate_rotation", "factory_std"),
    "sets": ("name", "added_mass_kg", "added_com_m"),
}


class _Reader:
    """Reads one file; carries its name into every message."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def config(self, told: Mapping[str, Any]) -> InSituConfig:
        self._known(told, tuple(_TABLES), "")
        tables = {name: told.get(name, {}) for name in _TABLES if name != "sets"}
        for name, table in tables.items():
            if not isinstance(table, dict):
                raise self._error(f"'{name}' must be a table, such as [{name}]")
            self._known(table, _TABLES[name], f"{name}.")
        accelerometer, sensor, csv = tables["accelerometer"], tables["sensor"], tables["csv"]
        found: dict[str, Any] = {"columns": self._columns(tables["columns"]), "file": self.path.name}
        found["units"] = self._units(tables["units"])
        for key in ("separator", "decimal"):
            if key in csv:
                if not isinstance(csv[key], str) or len(csv[key]) != 1:
                    raise self._error(f"'csv.{key}' must be one character, got {csv[key]!r}")
                found[key] = csv[key]
        if "R_sensor_accelerometer" in accelerometer:
            found["R_sensor_accelerometer"] = self._rotation(accelerometer["R_sensor_accelerometer"])
        if "position_m" in accelerometer:
            position = self._numbers(accelerometer["position_m"], "accelerometer.position_m", (3,))
            found["position_imu"] = tuple(position.tolist())
        if "calibrate" in accelerometer:
            if accelerometer["calibrate"] not in get_args(AccelerometerModel):
                raise self._error(
                    f"'accelerometer.calibrate' must be one of {', '.join(get_args(AccelerometerModel))}, "
                    f"got {accelerometer['calibrate']!r}"
                )
            found["accelerometer_model"] = accelerometer["calibrate"]
        found["sensor"] = str(sensor.get("name", ""))
        if "range_count" in sensor:
            low, high = self._numbers(sensor["range_count"], "sensor.range_count", (2,)).tolist()
            if low >= high:
                raise self._error(f"'sensor.range_count' must be [lowest, highest], got {[low, high]}")
            found["range_count"] = (low, high)
        found["factory_matrix"], found["full_scale"] = self._factory(tables["factory"])
        if "full_scale" in sensor:
            scale = self._numbers(sensor["full_scale"], "sensor.full_scale", (6,))
            if not (scale > 0.0).all():
                raise self._error(f"'sensor.full_scale' must be positive N and N m, got {scale.tolist()}")
            found["full_scale"] = scale
        for key, value in tables["limb"].items():
            number = float(self._numbers(value, f"limb.{key}", ()))
            if number <= 0.0:
                raise self._error(f"'limb.{key}' must be above 0 kg, got {number:g}")
            found["limb_mass" if key == "mass_kg" else "limb_mass_std"] = number
        if "limb_mass_std" in found and "limb_mass" not in found:
            raise self._error("'limb.mass_std_kg' needs 'limb.mass_kg' beside it")
        fit = dict(tables["fit"])
        if "sets" in fit:
            names = fit.pop("sets")
            if not isinstance(names, list) or not names:
                raise self._error(f"'fit.sets' must be a list of names of sets, got {names!r}")
            found["fit_sets"] = tuple(str(name) for name in names)
        found["options"] = self._options(fit, found.get("range_count"))
        if "sets" in told:
            found["sets"] = self._sets(told["sets"])
        return InSituConfig(**found)

    def _columns(self, table: Mapping[str, Any]) -> Columns:
        found: dict[str, Any] = {}
        for key, value in table.items():
            check_column_names(key, value, self.path.name)
            found[key] = tuple(value) if isinstance(value, list) else value
        return Columns(**found)

    def _units(self, table: Mapping[str, Any]) -> Units:
        for key, value in table.items():
            if value not in UNITS[key]:
                raise self._error(f"'units.{key}' must be one of {', '.join(UNITS[key])}, got {value!r}")
        return Units(**table)

    def _options(self, table: Mapping[str, Any], code_range: tuple[float, float] | None) -> InSituOptions:
        given: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in table.items()
        }
        for key in ("robust", "hysteresis", "estimate_rotation"):
            if key in given and not isinstance(given[key], bool):
                raise self._error(f"'fit.{key}' must be true or false, got {given[key]!r}")
        try:
            return InSituOptions(**given, code_range=code_range)
        except (TypeError, ValueError) as error:
            raise self._error(f"'fit': {str(error).rstrip('.')}") from None

    def _rotation(self, value: Any) -> NDArray[np.float64]:
        R = self._numbers(value, "accelerometer.R_sensor_accelerometer", (3, 3))
        if not np.allclose(R @ R.T, np.eye(3), atol=1e-3) or np.linalg.det(R) < 0.0:
            raise self._error(
                "'accelerometer.R_sensor_accelerometer' must be a rotation (orthonormal rows, determinant "
                f"+1), got {R.tolist()}"
            )
        return R

    def _factory(
        self, table: Mapping[str, Any]
    ) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
        if len(table) > 1:
            raise self._error("'factory' holds both a 'matrix' and a 'file'; give one of them")
        if "file" in table:
            return read_matrix(self.path.parent / str(table["file"]))
        if "matrix" in table:
            matrix = self._numbers(table["matrix"], "factory.matrix", None)
            if matrix.ndim != 2 or matrix.shape[0] != 6 or matrix.shape[1] < 6:
                raise self._error(
                    f"'factory.matrix' must have 6 rows (fx fy fz tx ty tz), got {matrix.shape}"
                )
            return matrix, None
        return None, None

    def _sets(self, told: Any) -> dict[str, AddedMass]:
        if not isinstance(told, list) or not all(isinstance(entry, dict) for entry in told):
            raise self._error("'sets' must be a list of tables, each begun by [[sets]]")
        found: dict[str, AddedMass] = {}
        for i, entry in enumerate(told):
            self._known(entry, _TABLES["sets"], "sets.")
            if "name" not in entry:
                raise self._error(f"number {i + 1} of [[sets]] has no 'name'; name it as the log does")
            name = str(entry["name"])
            mass = float(self._numbers(entry.get("added_mass_kg", 0.0), f"added_mass_kg of set '{name}'", ()))
            if mass < 0.0:
                raise self._error(
                    f"set '{name}' has added_mass_kg = {mass:g}; a mass is at least 0 (take the limb without "
                    "its part as the bare one)"
                )
            if mass > 0.0 and "added_com_m" not in entry:
                raise self._error(
                    f"set '{name}' has {mass:g} kg and no 'added_com_m'; give the place of its centre of "
                    "mass in the sensor's frame"
                )
            com = self._numbers(entry.get("added_com_m", (0, 0, 0)), f"added_com_m of set '{name}'", (3,))
            given = AddedMass(mass, (float(com[0]), float(com[1]), float(com[2])))
            if name in found:
                before = found[name]
                same = "twice" if before == given else f"with {before.mass:g} kg and with {given.mass:g} kg"
                raise self._error(f"set '{name}' is listed {same}; list each set once")
            found[name] = given
        return found

    def _numbers(self, value: Any, key: str, shape: tuple[int, ...] | None) -> NDArray[np.float64]:
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise self._error(f"'{key}' must hold numbers, got {value!r}") from None
        if isinstance(value, str | bool) or not np.isfinite(array).all():
            raise self._error(f"'{key}' must hold finite numbers, got {value!r}")
        if shape is not None and array.shape != shape:
            raise self._error(f"'{key}' must have shape {shape}, got {array.shape}")
        return array

    def _known(self, table: Mapping[str, Any], known: tuple[str, ...], stem: str) -> None:
        for key in table:
            if key not in known:
                raise self._error(
                    f"unknown key '{stem}{key}'; there are {', '.join(stem + name for name in known)}"
                )

    def _error(self, text: str) -> LogError:
        return LogError(f"{self.path.name}: {text}; see docs/in-situ-log.md.")
