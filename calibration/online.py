"""The online methods: their interface, and a table of them by name.

An online method is a set of pure functions of a state,

    init, update, retract = online_method("moment", setup)
    state = init(raw)                                       # of one robot
    state, estimate = update(state, raw, reference, dt)     # one sample
    state = retract(state)                                  # discard what was learnt during a fall

for one robot, with NumPy arrays in float64. A state is a ``NamedTuple`` of arrays and numbers, which can be
stored, copied and saved (:func:`surefoot.calibration.state.save_state`) without loss.

Methods differ in the data that they use. What they share (checks, the delay of the reference, the contents of
an estimate) is described in :mod:`surefoot.calibration.front_end.readings`:

| name | learns | from |
|---|---|---|
| ``"moment"`` | scales, offsets, external forces, faults | the robot's momentum, feet in the air |
| ``"window"`` | scales and offsets | the robot's motion, standing and walking (CoP paper, Eqs. 12-14) |
| ``"quasi-static"`` | scales and offsets | the centre of mass alone (Han's method) |
| ``"tare"`` | offsets | feet in the air |
| ``"none"`` | nothing | |

:func:`register_method` adds a method of your own.
"""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

from surefoot.calibration.baselines import SwingTare, leave_start, tare
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.filter import moment_filter
from surefoot.calibration.setup import OnlineMethod, OnlineSetup, method_name
from surefoot.calibration.window.config import Window
from surefoot.calibration.window.stream import quasi_static, window
from surefoot.names import check_new_name, plain_name

MethodOptions = Moment | Window | SwingTare  # options of a method, whose class also identifies the method


class MethodEntry(NamedTuple):
    """One line of the table."""

    build: Callable[..., OnlineMethod]
    """``build(setup, config) -> OnlineMethod``, without ``config`` if the method has no options."""
    config: type[Any] | None = None  # the dataclass of its options, or ``None``
    certain: bool = False  # whether it reports a covariance
    momentum: bool = False
    """Whether it prefers a :class:`~surefoot.calibration.reference.MomentumReference`."""
    contact: bool = False  # whether it reports contact probabilities and undetermined shares


_METHODS = {
    "moment": MethodEntry(moment_filter, Moment, certain=True, momentum=True, contact=True),
    "window": MethodEntry(window, Window),
    "quasi-static": MethodEntry(quasi_static, Window),
    "tare": MethodEntry(tare, SwingTare),
    "none": MethodEntry(leave_start),
}

METHODS = MappingProxyType(_METHODS)
"""All online methods by name, registered ones among them."""

SHIPPED = frozenset(METHODS)  # names of the methods of this package


def register_method(
    name: str,
    build: Callable[..., OnlineMethod],
    config: type[Any] | None = None,
    *,
    certain: bool = False,
    replace: bool = False,
) -> None:
    """Register an online method of your own under a name, which is then accepted like those of this package.

    If your module is not imported, for example on the command line and in other processes, name it as well:
    ``"module:name"``. The same function may be registered again, for example by a module that is imported
    twice.

    A method is an :class:`OnlineMethod` of pure functions. Its state is a
    :class:`~surefoot.calibration.front_end.readings.FrontState`, or a ``NamedTuple`` of arrays that holds one
    as ``front``. The :class:`~surefoot.calibration.front_end.readings.FrontEnd` checks readings, delays them
    until their reference arrives, and builds estimates.

    Args:
        name: A new name.
        build: ``build(setup, config)``, or ``build(setup)`` without a config, returns the method.
        config: A dataclass of options, each with a default.
        certain: Whether estimates have a covariance, a standard deviation of forces and one of the CoP.
        replace: Whether to replace a method of your own with this name.

    Raises:
        TypeError: If ``build`` cannot be called, or ``config`` is not a dataclass.
        ValueError: If the name is taken or has no letters, or an option has no default.
    """
    if not callable(build):
        raise TypeError(f"'build' must be a function of an OnlineSetup, got {type(build).__name__}.")
    if config is not None:
        if not (isinstance(config, type) and is_dataclass(config)):
            raise TypeError(f"'config' must be a dataclass of options, or None, got {config!r}.")
        if bare := [field.name for field in fields(config) if _has_no_default(field)]:
            raise ValueError(f"{config.__name__}.{bare[0]} has no default: a method is built by its name.")
    if not (name in _METHODS and name not in SHIPPED and (replace or _same(build, _METHODS[name].build))):
        check_new_name("method", name, METHODS)
    _METHODS[name] = MethodEntry(build, config, certain)


def _has_no_default(field: Any) -> bool:
    return field.default is MISSING and field.default_factory is MISSING


def _same(one: Any, other: Any) -> bool:
    """Return whether two objects are the same function of the same file, also if it was imported twice."""
    where = [(f.__code__.co_filename, f.__qualname__) for f in (one, other) if hasattr(f, "__code__")]
    return one is other or (len(where) == 2 and where[0] == where[1])


def method_entry(name: str) -> MethodEntry:
    """Return a method's entry in the table, or raise ValueError. ``"module:name"`` imports the module."""
    plain = plain_name(name)
    if plain not in METHODS:
        available = ", ".join(repr(key) for key in METHODS)
        raise ValueError(f"Method {name!r} does not exist. Available: {available}.")
    return METHODS[plain]


def resolve_method(method: Any, options: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the name and the options of a method that is specified by its name or by its options.

    TypeError if it is neither. ValueError if an option is specified twice.

    >>> resolve_method(Moment(scale_std=0.2), {"mass": 5.3})
    ('moment', {'mass': 5.3, 'scale_std': 0.2})
    """
    kind = type(method)
    names = [name for name, entry in METHODS.items() if entry.config is not None and kind is entry.config]
    if not names:
        return method_name(method), dict(options)
    values = {field.name: (getattr(method, field.name), field.default) for field in fields(method)}
    changed = {name: value for name, (value, default) in values.items() if value != default}
    if twice := changed.keys() & options.keys():
        raise ValueError(
            f"{min(twice)!r} is given twice, in {kind.__name__}(...) and as a keyword; leave one out."
        )
    return names[0], {**options, **changed}


def online_method(name: str, setup: OnlineSetup, **options: Any) -> OnlineMethod:
    """Build a method by its name.

    Args:
        name: A key of :data:`METHODS`, or ``"module:name"`` for a method of your own.
        setup: The robot.
        options: Fields of the method's config.

    Raises:
        ValueError: If no such method or option exists, or the value of an option is out of range.

    >>> online_method("windows", ...)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    ValueError: Method 'windows' does not exist. Available: 'moment', 'window', ..., 'tare', 'none'.
    """
    name = method_name(name)
    entry = method_entry(name)
    build, config = entry.build, entry.config
    available = [] if config is None else [field.name for field in fields(config)]
    unknown = [option for option in options if option not in available]
    if unknown:
        raise ValueError(f"Method {name!r} has no option {unknown[0]!r}. Available: {available}.")
    return build(setup) if config is None else build(setup, config(**options))
