"""A sensor is a chain of small corruptions, each a pair of pure functions.

``init`` draws the constants of a device from power-up on (its scale, its offset, the phase of its clock), and
``apply`` passes one reading on. State is a value and randomness an argument: an old state stays as it was,
and a constant over an episode cannot become a random walk over episodes.

A device is that of one robot, and its readings are one row, shape (K,), for K channels. A stage reckons in
float64 and writes into none of its arguments.
"""

from collections.abc import Callable, Mapping
from functools import partial, wraps
from typing import Any, Generic, NamedTuple, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.sensors.randomness import Stream

Rng = np.random.Generator | Stream  # where chance comes from

State = TypeVar("State")

Arguments = ParamSpec("Arguments")


class Corruption(NamedTuple, Generic[State]):
    """One link of a sensor's error chain.

    Attributes:
        init: ``init(shape, rng) -> state`` for readings of the given shape, (K,).
        apply: ``apply(reading, state, rng, dt) -> (reading, state)`` with dt, the time in s since the
            reading before.
    """

    init: Callable[[tuple[int, ...], Rng], State]
    apply: Callable[[Floats, State, Rng, float], tuple[Floats, State]]

    def __reduce__(self) -> tuple[Any, ...]:
        return getattr(self.init, "built_by", (Corruption, tuple(self)))


def device(build: Callable[Arguments, Corruption[State]]) -> Callable[Arguments, Corruption[State]]:
    """Let the result of a function of configurations be pickled: as that function and its arguments."""

    @wraps(build)
    def make(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Corruption[State]:
        corruption = build(*args, **kwargs)
        corruption.init.built_by = partial(make, **kwargs), args  # type: ignore[attr-defined]
        return corruption

    return make


def limit(reading: ArrayLike, low: Any, high: Any) -> Floats:
    """Clip readings to a range: cheaper than ``clip`` on small arrays."""
    limited: Floats = np.minimum(np.maximum(reading, low), high)
    return limited


def check_channels(shape: tuple[int, ...], channels: int) -> None:
    """Raise ValueError if a device of so many channels is to read another shape."""
    if shape != (channels,):
        raise ValueError(
            f"A reading must hold the {channels} channels, got shape {shape}; give ({channels},)."
        )


def stateless(function: Callable[[Floats, Rng, float], Floats]) -> Corruption[tuple[()]]:
    """Make a corruption of ``function(reading, rng, dt)``, which remembers nothing."""

    def init(shape: tuple[int, ...], rng: Rng) -> tuple[()]:
        return ()

    def apply(reading: Floats, state: tuple[()], rng: Rng, dt: float) -> tuple[Floats, tuple[()]]:
        return function(reading, rng, dt), state

    return Corruption(init, apply)


def parts(kind: type[State], on: Mapping[str, Corruption[Any]]) -> Corruption[State]:
    """Pass readings through named corruptions, in their order.

    The state is a ``NamedTuple`` of the ``kind``; its fields are ``()`` for parts that are not on.
    """
    off: Any = kind(*((),) * len(kind._fields))  # type: ignore[attr-defined]

    def init(shape: tuple[int, ...], rng: Rng) -> State:
        started: State = off._replace(**{name: part.init(shape, rng) for name, part in on.items()})
        return started

    def apply(reading: Floats, state: State, rng: Rng, dt: float) -> tuple[Floats, State]:
        after = {}
        for name, part in on.items():
            reading, after[name] = part.apply(reading, getattr(state, name), rng, dt)
        return reading, off._replace(**after)

    return Corruption(init, apply)


def chain(*corruptions: Corruption[Any]) -> Corruption[tuple[Any, ...]]:
    """Pass readings through corruptions in their order, the order of the stages in the instrument.

    Args:
        *corruptions: The stages; none leaves readings as they are.

    >>> import numpy as np
    >>> from surefoot.sensors import chain, scale, offset, quantize
    >>> cell = chain(scale(3.0), offset(0.4), quantize(1.0))
    >>> rng = np.random.default_rng(0)
    >>> cell.apply(np.array([1.0, 2.0]), cell.init((2,), rng), rng, 0.0125)[0]
    array([3., 6.])
    """

    def init(shape: tuple[int, ...], rng: Rng) -> tuple[Any, ...]:
        return tuple(stage.init(shape, rng) for stage in corruptions)

    def apply(reading: Floats, state: tuple[Any, ...], rng: Rng, dt: float) -> tuple[Floats, tuple[Any, ...]]:
        states = []
        for stage, stage_state in zip(corruptions, state, strict=True):
            reading, stage_state = stage.apply(reading, stage_state, rng, dt)
            states.append(stage_state)
        return reading, tuple(states)

    return Corruption(init, apply)
