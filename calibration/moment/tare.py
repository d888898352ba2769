"""The tare: rows of a foot in the air, whose channels read nothing but what is beyond their sensors."""

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.distal import DistalMasses
from surefoot.calibration.moment.rows import Block, Rows
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.setup import OnlineSetup

_SWING_SAMPLES = 16.0
"""Samples that ``swing_noise`` is given for."""

_UP = 2
"""The row of the vertical force in a wrench map."""


class Tare:
    """Writes the rows of one setup.

    Args:
        setup: The robot.
        config: Options of the filter.
        unknowns: The unknowns.

    Attributes:
        by_channel: Takes what each foot has to its channels (0 or 1), shape (F, K).
    """

    def __init__(self, setup: OnlineSetup, config: MomentFilterConfig, unknowns: Unknowns) -> None:
        layout = setup.layout
        self.unknowns, self.config = unknowns, config
        self._weight = setup.weight
        self._distal = DistalMasses(layout, setup.gravity, setup.dt, config.span)
        self.by_channel = np.eye(len(layout.feet))[:, layout.foot_of_channel]
        self._vertical = layout.wrench_map[:, _UP]
        self._offsets = np.eye(layout.channels, unknowns.size, unknowns.offset.start)

    def hanging(self, mean: Array, block: Block, spare: Array | None = None) -> tuple[Array, Array]:
        """Average readings while feet surely hang, with ``settle`` samples to spare on either side.

        Args:
            mean: The unknowns as they are estimated, shape (N,).
            block: The samples.
            spare: How forces of lost channels are made of the others', shape (K, K), or ``None``.

        Returns:
            Samples of each foot that count, shape (F,), and the mean reading of each channel over its foot's,
            shape (K,).
        """
        settle, every, middle = self.config.settle, self.config.every, self.config.middle
        swing = (block.swing > 0.5) & ~self._landed(mean, block, spare)
        sure = np.all([swing[shift : shift + every] for shift in range(2 * settle + 1)], axis=0)
        sure = sure * block.use[middle, None]
        count, by_channel = sure.sum(axis=0), sure @ self.by_channel
        total = (by_channel * block.force[middle]).sum(axis=0)
        return count, total / np.maximum(by_channel.sum(axis=0), 1.0)

    def _landed(self, mean: Array, block: Block, spare: Array | None) -> Array:
        """Find feet that already carry weight where they should swing still, shape (n, F).

        They carry more than in another sample of the swing, whatever their offsets are.
        """
        force = self.unknowns.force(mean, block.force)
        if spare is not None:
            force = force @ spare.T
        load = force @ self._vertical.T / self._weight
        least = np.where(block.swing > 0.5, load, np.inf).min(axis=0)
        return load > least + self.config.swing_load

    def load(self, mean: Array, reading: Array, spare: Array | None = None) -> tuple[Array, Array]:
        """Write the vertical force of each foot for a mean reading, about a level sole.

        Args:
            mean: The unknowns as they are estimated, shape (N,).
            reading: Forces by the starting map in N, shape (K,).
            spare: How forces of lost channels are made of the others', shape (K, K), or ``None``.

        Returns:
            In body weights, shape (F,), and what scales and offsets do to it, shape (F, P + K).
        """
        unknowns = self.unknowns
        up = (self._vertical if spare is None else self._vertical @ spare) / self._weight
        scales = unknowns.by_scale(up, unknowns.tared(mean, reading))
        return scales @ mean[unknowns.scale], np.hstack([scales, unknowns.by_offset(up, mean)])

    def rows(self, mean: Array, block: Block, count: Array, reading: Array) -> Rows:
        """Write that feet in the air read nothing but what is beyond their sensors.

        Divided by the scales, this is a row of the offsets alone.

        Args:
            mean: The unknowns as they are estimated, shape (N,).
            block: The samples.
            count: Samples of each foot that count, shape (F,).
            reading: Mean reading of each channel over them, shape (K,).

        Returns:
            One row a channel.
        """
        number = count @ self.by_channel
        y = -reading / self.unknowns.unit
        if self._distal.matter:
            y = y + self._distal.felt(block.motion) / (self.unknowns.unit * self.unknowns.own_scales(mean))
        return Rows(self._offsets, y, self.variance(number)).keep(number > 0.5)

    def variance(self, number: Array) -> Array:
        """Return the variance of a mean reading over so many samples, in squared units of an offset."""
        return self.config.swing_noise**2 * _SWING_SAMPLES / np.maximum(number, 1.0)
