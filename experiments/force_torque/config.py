"""Settings of a log of in-situ sets, in the TOML file beside it; docs/in-situ-log.md describes them."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, StrictBool, model_validator

from surefoot.arrays import Floats
from surefoot.calibration.imu import AccelerometerModel
from surefoot.calibration.in_situ import InSituOptions
from surefoot.experiments.force_torque.icub import read_matrix
from surefoot.experiments.logs import mapping
from surefoot.experiments.logs.settings import Number, Positive, Settings, array_of, must_be
from surefoot.experiments.logs.table import LogError
from surefoot.files import read_toml
from surefoot.names import page

SI = mapping.SI | {"degC": 0.0, "K": -273.15}
"""SI value of each unit: a factor; for temperatures, a term to add."""
Axes = tuple[str, str, str]
Place = Annotated[Floats, array_of(3)]
Range = Annotated[tuple[Number, Number], must_be("[lowest, highest]", lambda ends: ends[0] < ends[1])]
Scales = Annotated[Floats, array_of(6), must_be("positive N and N m", lambda scale: (scale > 0).all())]
Matrix = Annotated[Floats, array_of(6, None), must_be("of 6 channels or more", lambda C: C.shape[1] >= 6)]
Rotation = Annotated[
    Floats,
    array_of(3, 3),
    must_be(
        "a rotation (orthonormal rows, determinant +1)",
        lambda R: np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0.0,
    ),
]


class Columns(Settings):
    """Names of the table's columns; ``None`` where the default name, or a pattern, finds them."""

    time: str | None = None  # empty for samples without an order in time
    set: str | None = None
    raw: Annotated[tuple[str, ...], Field(min_length=6)] | None = None
    specific_force: Axes | None = None
    gravity: Axes | None = None
    angular_velocity: Axes | Literal[""] | None = None  # empty for a gyroscope that shall not be used
    temperature: str | None = None
    added_mass: str | None = None
    added_com: Axes | None = None


class Units(Settings):
    """Units of the columns, keys of :data:`SI`."""

    raw: Literal["count", "N"] = "count"  # "N": a driver's wrench in N and N m
    time: Literal["s", "ms", "us", "ns"] = "s"
    acceleration: Literal["m/s^2", "g", "mg"] = "m/s^2"
    angular_velocity: Literal["rad/s", "deg/s"] = "rad/s"
    temperature: Literal["degC", "K"] = "degC"

    @property
    def of_raw(self) -> str:
        """Unit of the channels in tables."""
        return "counts" if self.raw == "count" else "N, N m"


class Accelerometer(Settings):
    """How the IMU sits on the limb."""

    R_sensor_accelerometer: Rotation = Field(default_factory=lambda: np.eye(3))
    position_m: Place = Field(default_factory=lambda: np.zeros(3))
    calibrate: AccelerometerModel | None = None  # fitted before all else


class Sensor(Settings):
    """Known values of the six-axis sensor."""

    name: str = ""
    range_count: Range | None = None
    full_scale: Scales | None = None


class Factory(Settings):
    """The maker's matrix, given or in a file, which :func:`read_config` reads."""

    matrix: Matrix | None = None
    file: str | None = None


class Limb(Settings):
    """The bare limb beyond the sensor, as a pair of scales shows it."""

    mass_kg: Positive | None = None
    mass_std_kg: Positive | None = None  # with it the known mass enters the fit; else it is only compared

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.mass_std_kg is not None and self.mass_kg is None:
            raise ValueError("'mass_std_kg' needs 'mass_kg' beside it")
        return self


class Fit(Settings):
    """Which sets make the fit, and its options."""

    sets: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    """The others are kept aside to prove it. All by default."""
    drift: StrictBool = InSituOptions.drift
    robust: StrictBool = InSituOptions.robust
    hysteresis: StrictBool = InSituOptions.hysteresis
    estimate_rotation: StrictBool = InSituOptions.estimate_rotation
    factory_std: tuple[Number, ...] | None = None
    keep_matrix: StrictBool = False
    """Whether the factory matrix stays as it is, and bias, mass and centre of mass are found."""

    @model_validator(mode="after")
    def _sound(self) -> Self:
        self.options(Sensor())
        return self

    def options(self, sensor: Sensor) -> InSituOptions:
        """Return the options of the fit for a sensor."""
        scale = None if sensor.full_scale is None else tuple(sensor.full_scale.tolist())
        given = self.model_dump(exclude={"sets", "keep_matrix"})
        return InSituOptions(**given, code_range=sensor.range_count, full_scale=scale)


class AddedMass(Settings):
    """Mass on the limb during one set: kg, and m in the sensor's frame."""

    name: str
    added_mass_kg: Annotated[Number, Field(ge=0.0)] = 0.0
    added_com_m: Place = Field(default_factory=lambda: np.zeros(3))

    @model_validator(mode="after")
    def _require_place(self) -> Self:
        if self.added_mass_kg > 0.0 and "added_com_m" not in self.model_fields_set:
            raise ValueError(
                f"set '{self.name}' has {self.added_mass_kg:g} kg and no 'added_com_m'; give the place of "
                "its centre of mass in the sensor's frame"
            )
        return self


class InSituConfig(Settings):
    """Everything that the table leaves open."""

    columns: Columns = Columns()
    units: Units = Units()
    csv: mapping.Csv = mapping.Csv()
    accelerometer: Accelerometer = Accelerometer()
    sensor: Sensor = Sensor()
    factory: Factory = Factory()
    limb: Limb = Limb()
    fit: Fit = Fit()
    sets: tuple[AddedMass, ...] | None = None
    """``None`` if the file lists none: then the masses stand in columns, or nothing was added."""

    @model_validator(mode="before")
    @classmethod
    def _driver(cls, given: Any) -> Any:
        """Take a driver's wrench for the maker's: its matrix is part of the readings."""
        units = given.get("units") if isinstance(given, Mapping) else None
        raw = units.get("raw") if isinstance(units, Mapping) else getattr(units, "raw", None)
        return {**given, "factory": given.get("factory") or {"matrix": np.eye(6)}} if raw == "N" else given

    @property
    def of_driver(self) -> bool:
        """Whether the matrix that the readings are held against is the driver's own, in which they come."""
        matrix = self.factory.matrix
        return self.units.raw == "N" and matrix is not None and np.array_equal(matrix, np.eye(6))

    @model_validator(mode="after")
    def _reject_duplicates(self) -> Self:
        twice = [name for name, n in Counter(one.name for one in self.sets or ()).items() if n > 1]
        if twice:
            raise ValueError(f"set '{twice[0]}' is listed twice; list each set once")
        return self

    def override(self, **names: Any) -> "InSituConfig":
        """Return it with names of columns from the command line, ``None`` for none; LogError if not right."""
        given = {key: value for key, value in names.items() if value is not None}
        # One of the two sources of gravity named on the command line stands for both.
        if len(given.keys() & {"gravity", "specific_force"}) == 1:
            given = {"gravity": None, "specific_force": None} | given
        columns = Columns.read(self.columns.model_dump() | given, "the command line")
        return self.model_copy(update={"columns": columns})


def config_beside(log: Path) -> InSituConfig:
    """Read the TOML file of the log's name beside it; defaults if there is none."""
    beside = log.with_suffix(".toml")
    return read_config(beside) if beside.is_file() else InSituConfig()


def read_config(path: Path) -> InSituConfig:
    """Read the TOML file, and the factory matrix that it names; LogError if it is none, or is wrong."""
    if not path.is_file():
        raise LogError(f"{path}: no such file; {page('in-situ-log')} says what it holds.")
    config = InSituConfig.read(read_toml(path, LogError), path.name)
    factory, sensor = config.factory, config.sensor
    if factory.file is None:
        return config
    if factory.matrix is not None:
        raise LogError(f"{path.name}: 'factory' holds both a 'matrix' and a 'file'; give one of them.")
    matrix, full_scale = read_matrix(path.parent / factory.file)
    if sensor.full_scale is None:
        sensor = sensor.model_copy(update={"full_scale": full_scale})
    return config.model_copy(update={"factory": Factory(matrix=matrix), "sensor": sensor})
