"""The online methods: one interface, one table.

An online method is a set of pure functions over a state that is a value,

    init, update, retract = online_method("moment", setup)
    state = init(raw)                                       # of one robot
    state, estimate = update(state, raw, reference, dt)     # one sample
    state = retract(state)                                  # the learning while the robot began to fall

of NumPy's arrays in float64, for one robot. A state is a ``NamedTuple`` of arrays and numbers: keeping one,
copying one, and :func:`surefoot.calibration.state.save_state` lose nothing.

Methods differ in their data. The common part (checks, the delay of the reference, what an
estimate holds) is described in :mod:`surefoot.calibration.front_end.readings`:

| name | learns | from |
|---|---|---|
| ``"moment"`` | scales, offsets, what holds the robot, faults | the robot's momentum, feet in the air |
| ``"window"`` | scales and offsets | the robot's motion, standing and walking (CoP paper, Eqs. 12-14) |
| ``"quasi-static"`` | scales and offsets | the centre of mass alone (Han's method) |
| ``"tare"`` | offsets | feet in the air |
| ``"none"`` | nothing | |

:func:`register_method` adds one of your own.
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

MethodOptions = Moment | Window | SwingTare  # options of a method as a value, which names the method as well


class MethodEntry(NamedTuple):
    """One line of the table."""

    build: Callable[..., OnlineMethod]
    """``build(setup, config) -> OnlineMethod``; a method without options takes no config."""
    config: type[Any] | None = None  # the dataclass of its options, or ``None``
    certain: bool = False  # whether it reports a covariance
    momentum: bool = False
    """Whether it would rather learn from a :class:`~surefoot.calibration.reference.MomentumReference`."""
    contact: bool = False  # whether it reports how likely feet bear load, and how much is undetermined


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
    """Give an online method of your own a name, to be used wherever the methods of this package are.

    Where your module is not imported, such as on the command line and in other processes, name it as well:
    ``"module:name"``. Registering the same function again, as a module that is imported twice does, is no
    error.

    A method is an :class:`OnlineMethod` of pure functions. Its state is a
    :class:`~surefoot.calibration.front_end.readings.FrontState`, or a ``NamedTuple`` of arrays that holds one
    as ``front``: the :class:`~surefoot.calibration.front_end.readings.FrontEnd` checks readings, waits for
    the reference and makes estimates.

    Args:
        name: A new name.
        build: ``build(setup, config)``, or ``build(setup)`` without a config, returns the method.
        config: A dataclass of options, each with a default.
        certain: Whether estimates have a covariance, a standard deviation of forces and one of the CoP.
        replace: Whether a method of yours of that name is replaced.

    Raises:
        TypeError: If ``build`` cannot be called, or ``config`` is no dataclass.
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
    """Return whether both are one function of one file, under whatever name its module was imported."""
    where = [(f.__code__.co_filename, f.__qualname__) for f in (one, other) if hasattr(f, "__code__")]
    return one is other or (len(where) == 2 and where[0] == where[1])


def method_entry(name: str) -> MethodEntry:
    """Return a method's line of the table; ``"module:name"`` imports a module first. ValueError without."""
    plain = plain_name(name)
    if plain not in METHODS:
        available = ", ".join(repr(key) for key in METHODS)
        raise ValueError(f"Method {name!r} does not exist. Available: {available}.")
    return METHODS[plain]


def resolve_method(method: Any, options: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the name of a method, given by name or as a value of its options, and its options.

    TypeError if it is neither, ValueError if an option is given twice.

    >>> resolve_method(Moment(scale_std=0.2), {"mass": 5.3})
    ('moment', {'mass': 5.3, 'scale_std': 0.2})
    """
    kind = type(method)
    found = [name for name, entry in METHODS.items() if entry.config is not None and kind is entry.config]
    if not found:
        return method_name(method), dict(options)
    own = {field.name: getattr(method, field.name) for field in fields(method)}
    own = {field.name: own[field.name] for field in fields(method) if own[field.name] != field.default}
    if twice := own.keys() & options.keys():
        raise ValueError(
            f"{min(twice)!r} is given twice, in {kind.__name__}(...) and as a keyword; leave one out."
        )
    return found[0], {**options, **own}


def online_method(name: str, setup: OnlineSetup, **options: Any) -> OnlineMethod:
    """Build a method by its name.

    Args:
        name: A key of :data:`METHODS`, ``"module:name"`` for one of yours.
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
    entry = method_entry(name)
    build, config = entry.build, entry.config
    known = [] if config is None else [field.name for field in fields(config)]
    unknown = [option for option in options if option not in known]
    if unknown:
        raise ValueError(f"Method {name!r} has no option {unknown[0]!r}. Available: {known}.")
    return build(setup) if config is None else build(setup, config(**options))
