"""How configurations are checked and how they come back from JSON."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

Config = TypeVar("Config")


def require(condition: bool, config: object, field: str, rule: str) -> None:
    """Refuse a value, naming the field, the rule and what was given.

    Raises:
        ValueError: If the condition does not hold.
    """
    if not condition:
        raise ValueError(f"{type(config).__name__}.{field} must {rule}, got {getattr(config, field)!r}.")


def require_not_negative(config: object, *names: str) -> None:
    """Refuse fields that are negative or not finite."""
    for name in names:
        value = getattr(config, name)
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        require(number and 0.0 <= value < float("inf"), config, name, "be finite and not negative")


def require_positive(config: object, *names: str) -> None:
    """Refuse fields that are not positive and finite."""
    for name in names:
        value = getattr(config, name)
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        require(number and 0.0 < value < float("inf"), config, name, "be finite and positive")


def require_whole(config: object, *names: str) -> None:
    """Refuse fields that are not positive whole numbers."""
    for name in names:
        value = getattr(config, name)
        whole = isinstance(value, int) and not isinstance(value, bool)
        require(whole and value > 0, config, name, "be a positive whole number")


def from_mapping(kind: type[Config], mapping: Mapping[str, Any]) -> Config:
    """Make a configuration of a mapping, such as ``dataclasses.asdict`` and JSON hand back.

    Args:
        kind: The configuration's class.
        mapping: Values for some of its fields; the others keep their defaults. Lists become tuples,
            and mappings the configurations that those fields hold.

    Raises:
        ValueError: If a key is no field, naming it and what there is, or if a value is refused.
    """
    known = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    unknown = sorted(set(mapping) - set(known))
    if unknown:
        raise ValueError(f"{kind.__name__} has no field {unknown}; it has {known}.")
    defaults = {field.name: field.default for field in fields(kind)}  # type: ignore[arg-type]

    def plain(key: str, value: Any) -> Any:
        if isinstance(value, Mapping) and is_dataclass(defaults[key]):
            return from_mapping(type(defaults[key]), value)
        return tuple(value) if isinstance(value, list) else value

    return kind(**{key: plain(key, value) for key, value in mapping.items()})
