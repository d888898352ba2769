r"""Hysteresis: the reading of a spring element depends on whether the load rose or fell.

The Prandtl-Ishlinskii operator is a sum of play operators, each a slack of half-width :math:`r_i` that lags
behind the load :math:`x`,

.. math:: p_i \leftarrow \max(x - r_i, \min(x + r_i, p_i)), \qquad y = (1 - \kappa) x + \sum_i w_i p_i.

It does not depend on how fast the load changes, and a larger swing erases the memory of all smaller ones.

A cycle of amplitude :math:`a` about any mean opens the play :math:`i` by :math:`2 r_i` at mid-load where
:math:`a \ge 2 r_i`, by :math:`2 (a - r_i)` where :math:`r_i < a < 2 r_i`, and not at all beneath. With
thresholds that halve from half of the full scale down, weights all equal to the share :math:`h`, and the
smallest play standing for all those below it as well (:math:`2 h`), the widths add up to :math:`2 a h`: **the
share is the vertical width of the loop at mid-load over the load's peak-to-peak swing**, and it is the same,
not just nearly, for every amplitude from the smallest one to the full scale.

A loop that is as wide at every scale cannot have the same slope at every scale: from end to end it rises by
:math:`h` more for each doubling of the amplitude, whatever the operator's thresholds. :math:`\kappa` only
chooses at which amplitude the slope is one.
"""

from math import ceil, log2
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.sensors.configuration import check_not_negative
from surefoot.sensors.corruption import Corruption, Rng


class HysteresisState(NamedTuple):
    """The memory of a spring element."""

    plays: Floats
    """Where each slack stands in shares of the full scale, the widest first, shape (P, K); zero for an
    element that was never loaded. No plays, P = 0, where there is no hysteresis."""


def halving_slacks(share: float, smallest: float, true_at: ArrayLike = 1.0) -> tuple[Floats, Floats]:
    """Return the half-widths of the slacks in shares of the full scale, and the slope in excess of one.

    Arguments are those of :func:`hysteresis`.
    """
    count = 1 + ceil(log2(1.0 / smallest)) if share else 0
    thresholds = 0.5 ** np.arange(1.0, count + 1.0)
    weights = share * np.where(thresholds == thresholds.min(initial=1.0), 2.0, 1.0)
    return thresholds, np.maximum(1.0 - thresholds / np.asarray(true_at)[..., None], 0.0) @ weights


def hysteresis(
    share: float, full_scale: ArrayLike, *, smallest: float = 1e-4, true_at: ArrayLike = 1.0
) -> Corruption[HysteresisState]:
    """Add hysteresis: loops as wide as a share of the load's swing, at any size and speed of the swing.

    Cycles larger than the full scale, which no instrument should see, keep the width of the full scale's. A
    reading that is not finite leaves no trace.

    Args:
        share: Width of a loop at mid-load over the peak-to-peak swing of the load; 0 changes nothing.
        full_scale: Largest amplitude (half of the swing) in the unit of the readings, a number or shape (K,).
        smallest: Smallest amplitude, in shares of the full scale, at which the share holds; loops close and
            vanish towards half of it.
        true_at: Amplitude, in shares of the full scale, of the cycle about zero whose ends read true, a
            number or shape (K,). Each doubling of the amplitude adds the share to the slope.

    Raises:
        ValueError: If the share is negative or so large that readings would fall under a growing load,
            if a full scale is not positive, or if an amplitude does not lie in (0, 1].

    >>> import numpy as np
    >>> element, rng = hysteresis(0.01, 100.0), np.random.default_rng(0)
    >>> state, read = element.init((1,), rng), []
    >>> for load in (100.0, -100.0, 0.0, 100.0, 0.0):  # ends, mid-load coming up, end, mid-load going down
    ...     reading, state = element.apply(np.array([load]), state, rng, 1.0)
    ...     read.append(float(reading[0]))
    >>> read
    [100.0, -100.0, -1.0, 100.0, 1.0]
    """
    check_not_negative(share=share)
    scales, true = (np.asarray(values, dtype=np.float64) for values in (full_scale, true_at))
    if not np.all((scales > 0.0) & np.isfinite(scales)):
        raise ValueError(f"'full_scale' must be finite and positive, got {full_scale!r}.")
    for name, value in (("smallest", smallest), ("true_at", true)):
        if not np.all((value > 0.0) & (value <= 1.0)):
            raise ValueError(f"'{name}' must lie in (0, 1], shares of the full scale, got {value}.")
    thresholds, excess = halving_slacks(share, smallest, true)
    count, slacks = len(thresholds), thresholds[:, None]
    if (most := float(excess.max())) >= 1.0:
        raise ValueError(
            f"'share' must be below {share / most:.3g}, or readings would fall while a small load grows; "
            f"got {share}."
        )

    def init(shape: tuple[int, ...], rng: Rng) -> HysteresisState:
        return HysteresisState(np.zeros((count, *shape)))

    def apply(reading: Floats, state: HysteresisState, rng: Rng, dt: float) -> tuple[Floats, HysteresisState]:
        if not count:
            return reading + 0.0, state
        plays = state.plays
        # The smallest play lies within the slack of all others: fed to them, it moves none.
        load = np.where(np.isfinite(reading), reading / scales, plays[-1])
        plays = np.maximum(load - slacks, np.minimum(load + slacks, plays))
        bent = share * (plays.sum(axis=0) + plays[-1]) - excess * load
        return reading + scales * bent, HysteresisState(plays)

    return Corruption(init, apply)
