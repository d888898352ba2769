"""Base class of the settings in TOML and JSON files. The types of its fields define the valid values."""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    model_validator,
)

from surefoot.arrays import Floats
from surefoot.experiments.logs.table import LogError

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0.0)]


_WORDS = {
    "missing": "is missing",
    "model_type": "must be a table of keys with values",
    "too_short": "needs at least {min_length}, and has {actual_length}",
}
"""Messages for some errors in place of those of pydantic, by the type of the error."""


class Settings(BaseModel):
    """A table of keys. Unknown keys are errors, because a misspelt key would silently keep a default."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", arbitrary_types_allowed=True, coerce_numbers_to_str=True
    )

    @model_validator(mode="before")
    @classmethod
    def _check_known(cls, given: Any) -> Any:
        unknown = [key for key in given if key not in cls.model_fields] if isinstance(given, Mapping) else []
        if unknown and cls.model_config["extra"] == "forbid":
            raise ValueError(f"unknown key '{unknown[0]}'; there are {', '.join(cls.model_fields)}")
        return given

    @classmethod
    def read(cls, given: Any, where: str) -> Self:
        """Return the settings of a file; LogError names the file, the key, the rule and the value."""
        try:
            return cls.model_validate(given)
        except ValidationError as error:
            first = error.errors()[0]
            # For unions, pydantic adds the name of the type to the location.
            key = ".".join(str(part) for part in first["loc"] if "[" not in str(part))
            value = first["input"]
            words = _WORDS.get(first["type"], first["msg"].removeprefix("Value error, ").rstrip("."))
            wrong = words.format(**first.get("ctx", {})) if first["type"] in _WORDS else words
            found = f", got {value!r}" if isinstance(value, str | int | float | list) else ""
            raise LogError(f"{where}: {f'{key}: ' if key else ''}{wrong}{found}.") from None


def must_be(what: str, holds: Callable[[Any], Any]) -> AfterValidator:
    """Make a validator that refuses values for which ``holds`` is false."""

    def check(value: Any) -> Any:
        if not holds(value):
            raise ValueError(f"must be {what}")
        return value

    return AfterValidator(check)


def array_of(*shape: int | None) -> PlainValidator:
    """Make a validator of finite arrays of a shape. ``None`` stands for any length."""

    def check(value: Any) -> Floats:
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise ValueError("must hold numbers, as many in each row") from None
        if isinstance(value, str | bool) or not np.isfinite(array).all():
            raise ValueError("must hold finite numbers")
        fits = array.ndim == len(shape) and all(
            wanted in (None, length) for wanted, length in zip(shape, array.shape, strict=True)
        )
        if not fits:
            raise ValueError(f"must have shape {shape}, and has {array.shape}")
        return array

    return PlainValidator(check)
