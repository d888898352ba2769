r"""The effect of impacts on a foot's offsets: bolts and plates settle, and cells press against each other.

A rigid sole on four cells has one support too many: the cells can press against each other in the one mode
that changes neither the foot's load nor its moments, (+, -, +, -) around the corners, which is **(+, -, -, +)
in the order front-left, front-right, rear-left, rear-right**. An impact changes the offset of the cell
:math:`i` by

.. math:: \Delta z_i = w_i\, \sigma_w \xi_w + \sigma_c \xi_c, \qquad \xi \sim N(0, 1),

with the same two random numbers for the whole foot, for good. A force plate was seen to keep (2.55, -2.52,
2.58, -2.60) N and another (-5.0, 6.3, -5.7, 6.3) N after it was unloaded (recordings of Kistler plates in the
files of ezc3d). Nobody has published the effect of one impact of a robot's foot: choose it within these.
"""

from typing import NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.sensors.configuration import check_not_negative
from surefoot.sensors.corruption import Corruption, Rng
from surefoot.sensors.randomness import normal

WARP = (1, -1, -1, 1)  # signs of the warp for (front-left, front-right, rear-left, rear-right)


class MountingState(NamedTuple):
    """The mounting of F feet of four cells."""

    offset: Floats  # the change of each offset by impacts, in the unit of the readings, shape (4 F,)
    load: Floats  # each foot's load at the last reading, shape (F,); NaN before the first
    impact: Floats  # for each foot 1 while its load goes on changing that fast and 0 elsewhere, shape (F,)


def mounting(threshold: float, warp_std: float, common_std: float = 0.0) -> Corruption[MountingState]:
    """Change the offsets of a foot at impacts, touch-down as well as lift-off.

    An impact begins where the foot's load, the sum of its channels, changes by more than the threshold from
    one reading to the next, and lasts as long as it does: one jump each, however many readings that takes. A
    reading that was lost or is not finite is passed over. The threshold goes with the rate at which the stage
    is stepped.

    Args:
        threshold: Change between two readings beyond which there is an impact, in the unit of the readings.
        warp_std: Standard deviation of a jump of each offset along the warp, in the unit of the readings.
        common_std: Standard deviation of the part of the jump that all cells of a foot share.
    """
    check_not_negative(threshold=threshold, warp_std=warp_std, common_std=common_std)
    cells = len(WARP)
    modes = [mode for mode in (warp_std * np.array(WARP), np.full(cells, common_std)) if mode.any()]

    def init(shape: tuple[int, ...], rng: Rng) -> MountingState:
        if len(shape) != 1 or shape[0] % cells:
            raise ValueError(f"A reading must hold whole feet of {cells} cells, got shape {shape}.")
        feet = shape[0] // cells
        return MountingState(np.zeros(shape), np.full(feet, np.nan), np.zeros(feet))

    def apply(reading: Floats, state: MountingState, rng: Rng, dt: float) -> tuple[Floats, MountingState]:
        offset, before, impact = state
        load = reading.reshape(-1, cells).sum(axis=1)
        lost = ~np.isfinite(load)
        # Neither the first reading nor one without a value is compared: NaN exceeds nothing.
        hit = (np.abs(load - before) > threshold) & ~lost
        start = hit & (impact < 0.5)
        if modes:
            jump = sum((normal(rng, (len(load), 1)) * mode for mode in modes), np.zeros(cells))
            offset = np.where(np.repeat(start, cells), offset + jump.ravel(), offset)
        load = np.where(lost, before, load)
        return reading + offset, MountingState(offset, load, hit.astype(np.float64))

    return Corruption(init, apply)
