"""A TOML or JSON file beside a table: the types of fields define its values."""

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
"""What is said of some errors in place of pydantic's words, by their types."""


class Settings(BaseModel):
    """A table of keys; one that is not a field is refused: misspelt, it would leave a default standing."""

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
        """Return the settings that a file states; LogError names file, key, flaw and value."""
        try:
            return cls.model_validate(given)
        except ValidationError as error:
            first = error.errors()[0]
            # Where a key may hold one of several kinds, pydantic puts the kind's name into its place.
            key = ".".join(str(part) for part in first["loc"] if "[" not in str(part))
            value = first["input"]
            words = _WORDS.get(first["type"], first["msg"].removeprefix("Value error, ").rstrip("."))
            wrong = words.format(**first.get("ctx", {})) if first["type"] in _WORDS else words
            found = f", got {value!r}" if isinstance(value, str | int | float | list) else ""
            raise LogError(f"{where}: {f'{key}: ' if key else ''}{wrong}{found}.") from None


def must_be(what: str, holds: Callable[[Any], Any]) -> AfterValidator:
    """Make a validator that refuses values of which something does not hold."""

    def check(value: Any) -> Any:
        if not holds(value):
            raise ValueError(f"must be {what}")
        return value

    return AfterValidator(check)


def array_of(*shape: int | None) -> PlainValidator:
    """Make a validator of finite arrays of a shape, in which ``None`` is any length."""

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
