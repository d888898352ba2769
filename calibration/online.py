"""The online methods: one interface, one table.

An online method is a set of pure functions over a state that is a value,

    init, update, retract = online_method("moment", setup)
    state = init(raw)                                       # the kind and batch shape of readings to come
    state, estimate = update(state, raw, reference, dt)     # one sample
    state = retract(state, fell)                            # what robots learnt as they began to fall

on the array API standard: NumPy for one robot or many, torch on any device. A state is a ``NamedTuple`` of
arrays and whole numbers: keeping one, copying one, and :func:`surefoot.calibration.state.save_state` lose
nothing.

Methods differ in what they learn from. What they share (checks, the delay of the reference, what an
estimate holds) is described in :mod:`surefoot.calibration.front_end.readings`:

| name | learns | from |
|---|---|---|
| ``"moment"`` | scales, offsets, the reference's errors, faults | the robot's motion, feet in the air |
| ``"window"`` | scales and offsets | the robot's motion, standing and walking (CoP paper, Eqs. 12-14) |
| ``"quasi-static"`` | scales and offsets | the centre of mass alone (Han's method) |
| ``"tare"`` | offsets | feet in the air |
| ``"none"`` | nothing | |
"""

from collections.abc import Callable
from dataclasses import fields
from types import MappingProxyType
from typing import Any, NamedTuple

from surefoot.calibration.baselines import TareConfig, tare, uncorrected
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.stream import moment_filter
from surefoot.calibration.setup import OnlineMethod, OnlineSetup, method_name
from surefoot.calibration.window.config import WindowConfig
from surefoot.calibration.window.stream import quasi_static, window

__all__ = ["METHODS", "MethodEntry", "OnlineMethod", "OnlineSetup", "method_name", "online_method"]


class MethodEntry(NamedTuple):
    """One line of the table.

    Attributes:
        build: ``build(setup, config) -> OnlineMethod``; a method without options takes no config.
        config: The dataclass of its options, or ``None``.
    """

    build: Callable[..., OnlineMethod]
    config: type[Any] | None


METHODS = MappingProxyType(
    {
        "moment": MethodEntry(moment_filter, MomentFilterConfig),
        "window": MethodEntry(window, WindowConfig),
        "quasi-static": MethodEntry(quasi_static, WindowConfig),
        "tare": MethodEntry(tare, TareConfig),
        "none": MethodEntry(uncorrected, None),
    }
)
"""All online methods by name."""


def online_method(name: str, setup: OnlineSetup, **options: Any) -> OnlineMethod:
    """Build a method by its name.

    Args:
        name: A key of :data:`METHODS`, or an old name, with a ``DeprecationWarning``.
        setup: The robot.
        options: Fields of the method's config.

    Raises:
        ValueError: If no such method or option exists, or an option has a value without meaning.

    >>> online_method("windows", ...)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    ValueError: Method 'windows' does not exist. Available: 'moment', 'window', ..., 'tare', 'none'.
    """
    name = method_name(name)
    if name not in METHODS:
        available = ", ".join(repr(key) for key in METHODS)
        raise ValueError(f"Method {name!r} does not exist. Available: {available}.")
    build, config = METHODS[name]
    known = [] if config is None else [field.name for field in fields(config)]
    unknown = [option for option in options if option not in known]
    if unknown:
        raise ValueError(f"Method {name!r} has no option {unknown[0]!r}. Available: {known}.")
    return build(setup) if config is None else build(setup, config(**options))
