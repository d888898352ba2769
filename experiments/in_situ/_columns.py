"""Names of the columns of a table of in-situ samples; private to the log's reader."""

from dataclasses import dataclass
from typing import Any

from surefoot.experiments.logs.checks import LogError

__all__ = ["Columns", "check_column_names"]

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
