"""The description of the robot that belongs to the table of a log, as JSON."""

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast

import numpy as np
from pydantic import ConfigDict, Field, PlainValidator, model_validator

from surefoot.calibration.front_end.motion import FARTHEST
from surefoot.calibration.layout import FeetLayout, FootLayout, FootSensor
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.weights.curves import Curves
from surefoot.experiments.logs.settings import Number, Positive, Settings

_UNITS = {"position_cell_sole": "_m", "mass_below": "_kg", "com_below_sole": "_m"}
"""Units that are appended to field names of feet and sensors in keys."""

_MAP = ("scale_N_per_count", "offset_N")

_FIELDS = {
    "layout": "layout", "mass_kg": "mass", "nominal": "nominal", "calibrated": "calibrated", "dt_s": "dt",
    "lag_samples": "lag", "seed": "seed", "about": "about",
}  # fmt: skip
"""Fields of :class:`Log` by their keys in the description."""

Seconds = Annotated[Number, Field(ge=0.0, lt=10.0)]


class MotionFacts(Settings):
    """The part ``motion`` of a description: how references are computed from joints and IMU."""

    model: Path  # MJCF or URDF file; paths are relative to the folder of the log
    torso: str  # its floating body
    imu: str  # site or body fixed to the torso
    soles: tuple[str, str]  # sites or bodies of the left and of the right sole frame
    table: Path | None = None  # separate table of joints and IMU, None if they are in the log
    dt_s: Annotated[Seconds, Field(gt=0.0)] = np.nan  # step of the joints, by default of the log
    delay_s: Seconds = 0.0  # time from the measurement of joints and IMU to their ``time_s``
    readings_age_s: Seconds = 0.0  # the same for the readings of the feet
    averaged: bool = False  # whether a row of the IMU is the mean since the previous row
    held_rad: dict[str, Number] = Field(default_factory=dict)  # angles of joints without a column

    @model_validator(mode="after")
    def _two_places(self) -> Self:
        if self.soles[0] == self.soles[1]:
            raise ValueError(f"'soles' must name two places, left then right, got {list(self.soles)}")
        return self

    def of_log(self, folder: Path, dt: float) -> "MotionFacts":
        """Return a copy with paths resolved from the folder of a log, and the step of the log as default."""
        found: dict[str, Any] = {"model": folder / self.model}
        if self.table is not None:
            found["table"] = folder / self.table
        if np.isnan(self.dt_s):
            found["dt_s"] = dt
        return self.model_copy(update=found)


def _layout(given: Any) -> FeetLayout:
    try:
        return FeetLayout(tuple(map(_foot, given)))
    except KeyError as lacking:
        raise ValueError(f"lacks {lacking}, where the load cells of a foot are") from None
    except (AttributeError, TypeError) as error:
        raise ValueError(f"describes no feet: {error}") from None


def _foot(given: Any) -> FootLayout:
    if given.get("wrench_map") is not None:
        return cast(FootLayout, _record(FootLayout, given))
    below = {key: given[key + unit] for key, unit in _UNITS.items() if "below" in key and key + unit in given}
    return FootLayout.load_cells(
        given["name"], given["position_cell_sole_m"], given.get("channel_names"), **below
    )


def _map(given: Any) -> Parameters:
    try:
        scale = np.asarray(given["scale_N_per_count"], dtype=np.float64)
        offset = given.get("offset_N", np.full(scale.shape, np.nan))
        return Parameters(scale, np.asarray(offset, dtype=np.float64))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"is no map, {type(error).__name__} {error}") from None


class Description(Settings):
    """The description of a log. Other keys are ignored."""

    model_config = ConfigDict(extra="ignore")

    format: Literal["surefoot-log"]
    format_version: Literal[1]
    layout: Annotated[FeetLayout, PlainValidator(_layout)]
    mass_kg: Positive  # mass of the robot as the robot knows it
    nominal: Annotated[Parameters, PlainValidator(_map)]  # offsets are optional
    calibrated: Annotated[Parameters, PlainValidator(_map)] | None = None
    curves: list[Any] | None = None  # of nonlinear channels, as `surefoot calibrate weights` writes them
    dt_s: Positive = np.nan  # nominal time between rows; by default their median
    lag_samples: Annotated[int, Field(ge=0)] = 0
    seed: int | None = None  # of a simulated walk
    about: dict[str, Any] = Field(default_factory=dict)
    motion: MotionFacts | None = None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        channels = len(self.straightening.knots)
        unread = np.isnan(self.nominal.offset).all()
        for values in (*self.nominal[: 1 if unread else 2], *(self.calibrated or ())):
            if values.shape != (channels,) or not np.isfinite(values).all():
                raise ValueError(f"a map needs {channels} finite scales and offsets, one a channel")
        for foot in self.layout.feet:
            places = foot.position_cell_sole
            if places is not None and (reach := float(np.abs(places).max())) > FARTHEST:
                raise ValueError(
                    f"'position_cell_sole_m' of the {foot.name} foot go to {reach:.4g}, and no foot reaches "
                    f"farther than {FARTHEST:g} m; give metres"
                )
        if self.motion is None and "lag_samples" not in self.model_fields_set:
            raise ValueError(
                "lacks 'lag_samples', by how many rows the reference is late; of feet alone give 0"
            )
        if self.motion is not None and self.lag_samples != 0:
            raise ValueError(
                f"'lag_samples' is {self.lag_samples} beside 'motion', whose references are made for the "
                "very moment of each row; leave it out, and give motion.readings_age_s for old readings of "
                "the feet or motion.delay_s for old joints and IMU, in seconds"
            )
        return self

    @property
    def straightening(self) -> Curves:
        """The linearisation curves that are applied before the maps."""
        channels = self.layout.channels
        return Curves.from_plain([None] * channels if self.curves is None else self.curves, channels)

    def facts(self) -> dict[str, Any]:
        """Return the fields of a log that the description contains."""
        return {field: getattr(self, key) for key, field in _FIELDS.items()}


def describe(log: Any) -> dict[str, Any]:
    """Return the description of a log for the header of its file."""
    facts = {key: _plain(getattr(log, field)) for key, field in _FIELDS.items()}
    return {"format": "surefoot-log", "format_version": 1, **facts}


def _plain(value: Any) -> Any:
    """Return feet, sensors and maps as values that JSON can hold."""
    if isinstance(value, FeetLayout):
        value = value.feet
    if isinstance(value, Parameters):
        return {key: np.asarray(part, dtype=float).tolist() for key, part in zip(_MAP, value, strict=True)}
    if is_dataclass(value):
        return {
            f"{field.name}{_UNITS.get(field.name, '')}": _plain(getattr(value, field.name))
            for field in fields(value)
        }
    if isinstance(value, slice):
        return [value.start, value.stop]
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def _record(kind: type[Any], given: Any) -> Any:
    """Return the foot or the sensor of which :func:`_plain` made this."""
    values: dict[str, Any] = {}
    for field in fields(kind):
        value = given.get(f"{field.name}{_UNITS.get(field.name, '')}")
        if field.name == "channels":
            value = slice(*value)
        elif field.name == "sensors":
            value = tuple(_record(FootSensor, one) for one in value or ())
        elif field.name == "channel_names":
            value = tuple(value)
        elif isinstance(value, list):
            value = np.asarray(value, dtype=np.float64)
        if value is not None:
            values[field.name] = value
    return kind(**values)
