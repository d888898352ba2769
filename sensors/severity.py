"""One number for how bad an instrument is, for sweeps: 0 is perfect, 1 its configuration, 2 twice as bad.

The *errors* grow in proportion: spreads, noises, drifts, coefficients, shares, delays. They are the fields
that their configuration marks (:class:`~surefoot.sensors.configuration.ErrorField`). The parts that the
instrument *is* stay: its number of channels, their ranges, resolution, rate and coding, the law by which it
warms up. An instrument of severity 0 therefore still rounds, clips and has a clock of its own.

Some errors have a largest value: no wire repeats more than all of its readings. Severities above 1 take these
so far and no further, while all others go on. A configuration that is beyond already stays as it is. The
scales and the cross-talk of a :class:`~surefoot.sensors.ForceTorque` have one limit together, 0.25 for
``initial_scale_std + 5 cross_talk_std``, at which both stop.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from math import ceil, inf
from types import MappingProxyType
from typing import Any, TypeVar

from surefoot.sensors.configuration import ErrorField
from surefoot.sensors.devices.force_torque import MOST_ERROR, ForceTorque
from surefoot.sensors.transport.wire import Wire

Config = TypeVar("Config")

BELOW = 1.0 - 1e-12
"""Factor by which a limit of a sum is missed, or rounding could take the sum over it."""


def errors_of(kind: type) -> Mapping[str, float]:
    """Return the errors of a class of configurations, and the largest value of each."""
    hints: dict[str, Any] = {field.name: field.type for field in fields(kind)} if is_dataclass(kind) else {}
    marks = {
        name: mark
        for name, hint in hints.items()
        for mark in getattr(hint, "__metadata__", ())
        if isinstance(mark, ErrorField)
    }
    return MappingProxyType({name: mark.most for name, mark in marks.items()})


def scaled(config: Config, severity: float) -> Config:
    """Return an instrument that is better or worse: all of its errors times one factor.

    Args:
        config: The configuration of severity 1; it is not changed.
        severity: Factor of every error: 0 leaves none, 1 the configuration as it is, 2 doubles them, but for
            those that have reached their largest value. Every preset can be of any severity up to 5.

    Raises:
        ValueError: If the severity is negative, or so large that an error is refused.
        TypeError: If no field of the class is marked as an error.

    >>> from surefoot.sensors import LoadCells
    >>> worse = scaled(LoadCells(), 2.0)
    >>> worse.initial_offset_std, worse.adc_bits
    (3.0, 24)
    """
    if not 0.0 <= severity < float("inf"):
        raise ValueError(f"'severity' must be finite and not negative, got {severity}.")
    severity, kind = float(severity), type(config)
    if not errors_of(kind):
        raise TypeError(f"{kind.__name__} has no severity: it marks no field as an error.")
    errors = {name: _times(getattr(config, name), severity) for name in errors_of(kind)}
    if severity > 1.0:
        errors |= _at_limit(config, errors, severity)
    try:
        worse: Config = replace(config, **errors)  # type: ignore[type-var]
    except ValueError as refused:
        raise ValueError(
            f"A severity of {severity} is more than this device can have: {refused}"
        ) from refused
    return worse


def _times(value: Any, factor: float) -> Any:
    if is_dataclass(value):
        return scaled(value, factor)
    return tuple(factor * part for part in value) if isinstance(value, tuple) else factor * value


def _at_limit(config: Any, errors: Mapping[str, Any], severity: float) -> dict[str, Any]:
    """Return the values of the errors that reach a limit."""
    found = {
        name: min(errors[name], max(most, getattr(config, name)))
        for name, most in errors_of(type(config)).items()
        if most < inf
    }
    if isinstance(config, ForceTorque):
        together = config.initial_scale_std + 5.0 * config.cross_talk_std
        if severity * together > MOST_ERROR:
            factor = max(1.0, MOST_ERROR * BELOW / together)
            names = ("initial_scale_std", "cross_talk_std")
            found |= {name: factor * getattr(config, name) for name in names}
    if isinstance(config, Wire) and config.late:
        found["under_way"] = ceil(severity * config.under_way)
    return found
