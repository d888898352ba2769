"""Checks of arguments and of configurations, and configurations from mappings (JSON, TOML)."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeGuard, TypeVar

Config = TypeVar("Config")


def check_not_negative(**values: float) -> None:
    """Raise ValueError if an argument is negative or not finite; the message names it."""
    for name, value in values.items():
        if not 0.0 <= value < float("inf"):
            raise ValueError(f"'{name}' must be finite and not negative, got {value}.")


def check_whole(**values: int) -> None:
    """Raise ValueError if an argument is no positive whole number; the message names it."""
    for name, value in values.items():
        if not (is_whole(value) and value > 0):
            raise ValueError(f"'{name}' must be a positive whole number, got {value!r}.")


def is_whole(value: object) -> TypeGuard[int]:
    """Return whether a value is a whole number; ``True`` and ``False`` are none."""
    return isinstance(value, int) and not isinstance(value, bool)


def require(condition: bool, config: object, field: str, rule: str) -> None:
    """Check one field of a configuration.

    Raises:
        ValueError: If the condition does not hold; the message has the field, the rule and the value.
    """
    if not condition:
        raise ValueError(f"{type(config).__name__}.{field} must {rule}, got {getattr(config, field)!r}.")


def require_not_negative(config: object, *names: str) -> None:
    """Raise ValueError if a field is negative or not finite."""
    for name in names:
        value = getattr(config, name)
        require(_is_number(value) and 0.0 <= value < float("inf"), config, name, "be finite and not negative")


def require_positive(config: object, *names: str) -> None:
    """Raise ValueError if a field is not positive or not finite."""
    for name in names:
        value = getattr(config, name)
        require(_is_number(value) and 0.0 < value < float("inf"), config, name, "be finite and positive")


def require_whole(config: object, *names: str) -> None:
    """Raise ValueError if a field is no positive whole number."""
    for name in names:
        value = getattr(config, name)
        require(is_whole(value) and value > 0, config, name, "be a positive whole number")


def from_mapping(kind: type[Config], mapping: Mapping[str, Any]) -> Config:
    """Make a configuration of a mapping, such as ``dataclasses.asdict`` and JSON return.

    Args:
        kind: The configuration's class.
        mapping: Values for some of its fields; the others keep their defaults. Lists become tuples,
            and mappings the configurations that those fields hold.

    Raises:
        ValueError: If a key is no field (the message lists the fields), or if a value is refused.
    """
    defaults = {field.name: field.default for field in fields(kind)}  # type: ignore[arg-type]
    if unknown := sorted(set(mapping) - set(defaults)):
        raise ValueError(f"{kind.__name__} has no field {unknown}; it has {list(defaults)}.")

    def plain(key: str, value: Any) -> Any:
        if isinstance(value, Mapping) and is_dataclass(defaults[key]):
            return from_mapping(type(defaults[key]), value)
        return tuple(value) if isinstance(value, list) else value

    return kind(**{key: plain(key, value) for key, value in mapping.items()})


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
