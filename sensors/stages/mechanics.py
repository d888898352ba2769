"""Stages on a load before a bridge turns it into a voltage: the metal's part of a load cell.

In this order: the characteristic bends (:mod:`~surefoot.sensors.stages.nonlinearity`), the element lags
(:mod:`~surefoot.sensors.stages.hysteresis`) and creeps (:mod:`~surefoot.sensors.stages.creep`), impacts move
the offsets of a foot's cells (:mod:`~surefoot.sensors.stages.mounting`), and so does an overload
(:mod:`~surefoot.sensors.stages.overload`).
Every part is off where its field is zero, costs nothing then and draws nothing.
"""

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.sensors.configuration import Error, ErrorField, NotNegative, Positive, check_fields, require
from surefoot.sensors.corruption import Corruption, Rng, parts
from surefoot.sensors.stages.creep import check_creep, creep
from surefoot.sensors.stages.hysteresis import hysteresis
from surefoot.sensors.stages.mounting import WARP, mounting
from surefoot.sensors.stages.nonlinearity import random_nonlinearity
from surefoot.sensors.stages.overload import overload

CELLS_OF_A_FOOT = len(WARP)  # mounting acts on whole feet of this many cells

SMALLEST_LOOP = 2.0**-7
"""Share of the capacity down to which loops of hysteresis are resolved: 0.8 N of 98.1 N."""


@dataclass(frozen=True)
class Mechanics:
    """The spring elements of a set of cells and how they are mounted; by default ideal."""

    nonlinearity: Annotated[Error, ErrorField(0.08)] = 0.0
    """Largest departure from the straight line through zero and the capacity, at half of the capacity, in
    shares of the capacity; each cell draws its own, uniformly and of either sign. 2e-4 is a bar cell of class
    C3's, 5e-4 a cheap one's, 2e-3 a ring's (data sheets)."""

    hysteresis: Annotated[Error, ErrorField(0.12)] = 0.0
    """Width of a loop at mid-load over the load's swing, of loops larger than 1/128 of the capacity. 2e-4,
    5e-4 and 2e-3 by the same data sheets."""

    creep_shares: Annotated[tuple[float, ...], ErrorField()] = ()
    """What each exponential of the creep adds in the end in shares of the load. A cheap bar cell's add up to
    5e-4 in 30 minutes, a good one's to 1.5e-4 (data sheets)."""

    creep_time_constants: tuple[float, ...] = ()
    """Time constants of the exponentials in s; most of a kitchen scale's creep was seen within 60 s."""

    mounting_warp_std: Error = 0.0
    """Standard deviation of what an impact adds to each offset along the warp (+, -, -, +) of a foot of four
    cells in N. Offsets of force plates were seen to change by 2.5 and 6 N along it; nobody has published
    what one impact does."""

    mounting_common_std: Error = 0.0
    """Standard deviation of what an impact adds to all offsets of a foot alike in N."""

    impact_threshold: NotNegative = 10.0
    """Change of a foot's load from one reading to the next beyond which there is an impact, in N."""

    overload_share: Annotated[Error, ErrorField(1.0)] = 0.0
    """Share of a load's excess over the safe overload that stays in the offset for good. Data sheets do not
    give it."""

    safe_overload: Positive = 1.5
    """Largest load that leaves no trace in shares of the capacity; 1.5 by most data sheets."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value is impossible."""
        check_fields(self)
        require(self.nonlinearity < 1.0 / 12.0, self, "nonlinearity", "be below 1/12")
        require(self.hysteresis < 0.125, self, "hysteresis", "be below 1/8")
        require(self.overload_share <= 1.0, self, "overload_share", "be at most 1")
        check_creep(self)

    @property
    def jumps(self) -> bool:
        """Whether impacts move the offsets."""
        return self.mounting_warp_std > 0.0 or self.mounting_common_std > 0.0

    @property
    def acts(self) -> bool:
        """Whether anything happens to a load at all."""
        creeps = any(self.creep_shares)
        return bool(self.nonlinearity or self.hysteresis or creeps or self.jumps or self.overload_share)


IDEAL = Mechanics()  # spring elements that leave the load as it is


class MechanicsState(NamedTuple):
    """Spring elements in use; ``()`` for every part that is off."""

    nonlinearity: Any  # a ``NonlinearityState``
    hysteresis: Any  # a ``HysteresisState``
    creep: Any  # a ``CreepState``
    mounting: Any  # a ``MountingState``
    overload: Any  # an ``OverloadState``


def mechanics(config: Mechanics, capacity: float) -> Corruption[MechanicsState]:
    """Build the spring elements of cells; readings are loads in N, shape (K,).

    A load that is not finite, as of a simulation that blew up, comes out as NaN and leaves no trace.

    Args:
        config: The elements and their mounting.
        capacity: Rated load of a cell in N.

    >>> import numpy as np
    >>> element, rng = mechanics(Mechanics(overload_share=0.1), 100.0), np.random.default_rng(0)
    >>> state = element.init((1,), rng)
    >>> _, state = element.apply(np.array([250.0]), state, rng, 0.0125)
    >>> element.apply(np.array([0.0]), state, rng, 0.0125)[0]
    array([10.])
    """
    on: dict[str, Corruption[Any]] = {}
    if config.nonlinearity:
        on["nonlinearity"] = random_nonlinearity(config.nonlinearity, capacity)
    if config.hysteresis:
        on["hysteresis"] = hysteresis(config.hysteresis, capacity, smallest=SMALLEST_LOOP)
    if any(config.creep_shares):
        on["creep"] = creep(config.creep_shares, config.creep_time_constants)
    if config.jumps:
        on["mounting"] = mounting(
            config.impact_threshold, config.mounting_warp_std, config.mounting_common_std
        )
    if config.overload_share:
        on["overload"] = overload(config.overload_share, config.safe_overload * capacity)
    elements = parts(MechanicsState, on)

    def apply(load: Floats, state: MechanicsState, rng: Rng, dt: float) -> tuple[Floats, MechanicsState]:
        return elements.apply(np.where(np.isfinite(load), load, np.nan), state, rng, dt)

    return Corruption(elements.init, apply)


def offset_shift(config: Mechanics, state: MechanicsState) -> Floats | float:
    """Return the change of offsets by impacts and overloads in N, shape (K,); 0.0 without."""
    offset: Floats | float = 0.0
    if state.mounting:
        offset = offset + state.mounting.offset
    if state.overload:
        offset = offset + config.overload_share * (state.overload.excess[0] + state.overload.excess[1])
    return offset
