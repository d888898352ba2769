"""Parity: rows of feet with several instruments, which must all measure the same wrench."""

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.distal import DistalMasses
from surefoot.calibration.moment.rows import Block, Rows
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.setup import OnlineSetup


class Parity:
    """Writes the rows of one setup.

    Args:
        setup: The robot.
        config: Options of the filter.
        unknowns: The unknowns.

    Attributes:
        matters: Whether any foot has several instruments.
    """

    def __init__(self, setup: OnlineSetup, config: MomentFilterConfig, unknowns: Unknowns) -> None:
        self.unknowns, self.config = unknowns, config
        self._distal = DistalMasses(setup.layout, setup.gravity, setup.dt, config.span)
        scale = np.repeat([1.0, 1.0 / setup.length], 3)[None, :, None]
        parity = (_differences(setup.layout) * scale / setup.weight).reshape(-1, setup.layout.channels)
        parity = parity[(parity != 0.0).any(axis=1)]
        self.matters = len(parity) > 0
        self._errors = np.zeros((len(parity), unknowns.size - unknowns.map.stop))
        self._parity = parity

    def rows(self, mean: Array, block: Block) -> Rows:
        """Write that the instruments of one foot measure the same wrench.

        Args:
            mean: The unknowns as they are estimated, shape (N,).
            block: The samples.

        Returns:
            For each axis that two instruments of a foot see, one row for each half of the block.
        """
        settle, half, unknowns = self.config.settle, self.config.every // 2, self.unknowns
        by_offset = unknowns.by_offset(self._parity, mean)
        y = by_offset @ mean[unknowns.offset]
        if self._distal.matter:
            y = y + self._parity @ self._distal.felt(block.motion)
        variance = np.full(len(y), self.config.parity_noise**2)
        halves = []
        for start in (settle, settle + half):
            part = slice(start, start + half)
            reading = block.force[part].mean(axis=0)
            by_scale = unknowns.by_scale(self._parity, unknowns.tared(mean, reading))
            rows = Rows(np.hstack([by_scale, by_offset, self._errors]), y, variance)
            halves.append(rows if (block.use[part] > 0.5).all() else rows.none())
        return halves[0].beside(halves[1])


def _differences(layout: FeetLayout) -> NDArray[np.float64]:
    """Return what each further instrument of a foot measures less what the first does, (pairs, 6, K)."""
    pairs = []
    for foot, where in zip(layout.feet, layout.slices, strict=True):
        first, *others = foot.sensors
        for other in others:
            both = (first.wrench_map != 0.0).any(axis=1) & (other.wrench_map != 0.0).any(axis=1)
            difference = np.zeros((6, layout.channels))
            for sensor, sign in ((first, -1.0), (other, 1.0)):
                columns = np.arange(where.start, where.stop)[sensor.channels]
                difference[:, columns] = sign * sensor.wrench_map * both[:, None]
            pairs.append(difference)
    return np.array(pairs).reshape(-1, 6, layout.channels)
