r"""Overload: a spring element that was loaded too far keeps part of its deformation.

Up to its safe overload, 150 % of the rated load for most cells (ring cells FRB, for instance; beyond 200 %
they break), a cell keeps its offset. Of the largest excesses so far to either side,
:math:`e_+ = \max(x - x_s, 0)` and :math:`e_- = \min(x + x_s, 0)`, a share stays in the offset,

.. math:: z = s\, (e_+ + e_-)

with the share :math:`s`. This is how an elastic-plastic element with linear hardening behaves, each side on
its own. A second overload as large as the first changes nothing. Data sheets give the end of the safe range,
not the behaviour beyond: choose the share yourself.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.sensors.configuration import check_not_negative
from surefoot.sensors.corruption import Corruption, Rng, limit


class OverloadState(NamedTuple):
    """How far spring elements were loaded beyond the safe limit."""

    excess: Floats
    """Largest excess so far of pressing (positive) and of pulling (negative) loads over the safe ones in the
    unit of the readings, shape (2, K)."""


def overload(share: float, safe: ArrayLike) -> Corruption[OverloadState]:
    """Shift the offset for good after a load beyond the safe overload, towards that load.

    A share of the excess stays, from 0, which changes nothing, to 1; safe loads are in the unit of the
    readings, a number or shape (K,). The shift shows from the reading on that is too large; one that is not
    finite leaves no trace.

    >>> import numpy as np
    >>> cell, rng = overload(0.02, 150.0), np.random.default_rng(0)
    >>> state = cell.init((1,), rng)
    >>> _, state = cell.apply(np.array([200.0]), state, rng, 0.0125)
    >>> cell.apply(np.array([0.0]), state, rng, 0.0125)[0]
    array([1.])
    """
    check_not_negative(share=share)
    limits = np.asarray(safe, dtype=np.float64)
    if share > 1.0:
        raise ValueError(f"'share' must be at most 1, got {share}.")
    if not np.all((limits > 0.0) & np.isfinite(limits)):
        raise ValueError(f"'safe' must be finite and positive, got {safe!r}.")

    def init(shape: tuple[int, ...], rng: Rng) -> OverloadState:
        return OverloadState(np.zeros((2, *shape)))

    def apply(reading: Floats, state: OverloadState, rng: Rng, dt: float) -> tuple[Floats, OverloadState]:
        highest, lowest = state.excess
        excess = reading - limit(reading, -limits, limits)
        # What is not finite is neither more nor less.
        excess = np.where(np.isfinite(excess), excess, 0.0)
        highest = np.where(excess > highest, excess, highest)
        lowest = np.where(excess < lowest, excess, lowest)
        return reading + share * (highest + lowest), OverloadState(np.stack([highest, lowest]))

    return Corruption(init, apply)
