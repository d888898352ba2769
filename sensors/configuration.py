"""Checks of arguments and of configurations, and configurations from mappings (JSON, TOML)."""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from math import inf
from types import NoneType
from typing import Annotated, Any, NamedTuple, TypeVar, get_args

from surefoot.checks import check_value, is_whole

Config = TypeVar("Config")


class ErrorField(NamedTuple):
    """Marks a field of a configuration as an error: it grows with the severity, and zero is no error."""

    most: float = inf
    """The largest value to which a severity above 1 takes it. Beyond, readings would fall under a growing
    load (nonlinearity, hysteresis), more would stay of an overload than there was, more readings would be
    wrong than there are, no reading would be new, or a sensor would lose an axis."""


class Rule(NamedTuple):
    """A rule for a field of a configuration: in words, and whether a value keeps it."""

    words: str
    holds: Callable[[Any], bool]


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


NotNegative = Annotated[
    float, Rule("be finite and not negative", lambda value: _is_number(value) and 0.0 <= value < inf)
]
Positive = Annotated[
    float, Rule("be finite and positive", lambda value: _is_number(value) and 0.0 < value < inf)
]
Whole = Annotated[int, Rule("be a whole number from 1 on", lambda value: is_whole(value) and value > 0)]
Bits = Annotated[int, Rule("lie in 0 to 32", lambda value: is_whole(value) and 0 <= value <= 32)]
Error = Annotated[NotNegative, ErrorField()]  # a number that is an error


def check_not_negative(**values: float) -> None:
    """Raise an error that names the first argument that is negative or not finite."""
    for name, value in values.items():
        check_value(name, value, positive=False)


def require(condition: bool, config: object, field: str, rule: str) -> None:
    """Raise ValueError with the field, the rule and the value of a configuration unless a condition holds."""
    if not condition:
        raise ValueError(f"{type(config).__name__}.{field} must {rule}, got {getattr(config, field)!r}.")


def check_fields(config: Any) -> None:
    """Raise ValueError if a field does not keep the rule that its type names, or is to be another class."""
    for field in fields(config):
        value, types = getattr(config, field.name), (field.type, *get_args(field.type))
        if value is None and NoneType in types:
            continue
        if kind := next((kind for kind in types if kind is bool or is_dataclass(kind)), None):
            rule = "be True or False" if kind is bool else f"be a {kind.__name__}"  # type: ignore[union-attr]
            require(isinstance(value, kind), config, field.name, rule)  # type: ignore[arg-type]
        for rule in (rule for kind in types for rule in getattr(kind, "__metadata__", ())):
            if isinstance(rule, Rule):
                require(rule.holds(value), config, field.name, rule.words)


def from_mapping(kind: type[Config], mapping: Mapping[str, Any]) -> Config:
    """Make a configuration of a mapping, such as ``dataclasses.asdict`` and JSON return.

    Args:
        kind: The configuration's class.
        mapping: Values for some of its fields; the others keep their defaults. Lists become tuples,
            and mappings the configurations that those fields hold.

    Raises:
        TypeError: If it is no mapping.
        ValueError: If a key is no field (the message lists the fields), or if a value is refused.
    """
    if not isinstance(mapping, Mapping):
        raise TypeError(
            f"A {kind.__name__} is made of a mapping of its fields, got {mapping!r} of "
            f"{type(mapping).__name__}."
        )
    defaults = {field.name: field.default for field in fields(kind)}  # type: ignore[arg-type]
    if unknown := sorted(set(mapping) - set(defaults)):
        raise ValueError(f"{kind.__name__} has no field {unknown}; it has {list(defaults)}.")

    def plain(key: str, value: Any) -> Any:
        if isinstance(value, Mapping) and is_dataclass(defaults[key]):
            return from_mapping(type(defaults[key]), value)
        return tuple(value) if isinstance(value, list) else value

    return kind(**{key: plain(key, value) for key, value in mapping.items()})
