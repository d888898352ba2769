"""The tare: rows of a foot in the air, whose channels read nothing but what is beyond their sensors."""

import numpy as np

from surefoot.calibration.arrays import Array, Constants, namespace_of
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
    """

    def __init__(self, setup: OnlineSetup, config: MomentFilterConfig, unknowns: Unknowns) -> None:
        layout = setup.layout
        self.unknowns, self.config = unknowns, config
        self._weight = setup.weight
        self._distal = DistalMasses(layout, setup.dt, config.span)
        self._constants = Constants(
            by_channel=np.eye(len(layout.feet))[:, layout.foot_of_channel],
            vertical=layout.wrench_map[:, _UP],
            offsets=np.eye(layout.channels, unknowns.size, unknowns.offset.start),
            unit=unknowns.unit,
        )

    def hanging(self, block: Block) -> tuple[Array, Array]:
        """Average readings while feet surely hang, with ``settle`` samples to spare on either side.

        Returns:
            Samples of each foot that count, shape (..., F), and the mean reading of each channel over its
            foot's, shape (..., K).
        """
        xp, settle, every = namespace_of(block.force), self.config.settle, self.config.every
        by_channel, middle = self._constants.like(block.force).by_channel, self.config.middle
        sure = block.swing[..., :every, :]
        for shift in range(1, 2 * settle + 1):
            sure = sure * block.swing[..., shift : shift + every, :]
        sure = sure * block.use[..., middle][..., None]
        count = xp.sum(sure, axis=-2)
        total = xp.sum((sure @ by_channel) * block.force[..., middle, :], axis=-2)
        number = count @ by_channel
        return count, total / xp.where(number > 0.5, number, 1.0)

    def load(self, mean: Array, reading: Array, spare: Array | None = None) -> tuple[Array, Array]:
        """Write the vertical force of each foot for a mean reading, about a level sole.

        Args:
            mean: The unknowns as they are estimated, shape (..., N).
            reading: Forces by the starting map in N, shape (..., K).
            spare: How forces of lost channels are made of the others', shape (..., K, K), or ``None``.

        Returns:
            In body weights, shape (..., F), and what scales and offsets do to it, shape (..., F, P + K).
        """
        xp, own = namespace_of(reading), self._constants.like(reading)
        up = own.vertical if spare is None else own.vertical @ spare
        unknowns, up = self.unknowns, up / self._weight
        scales = unknowns.by_scale(up, unknowns.tared(mean, reading, own.unit))
        offsets = unknowns.by_offset(up + 0.0 * scales[..., :1], mean, own.unit)
        load = (scales @ mean[..., unknowns.scale, None])[..., 0]
        return load, xp.concat([scales, offsets], axis=-1)

    def rows(self, mean: Array, block: Block, count: Array, reading: Array) -> Rows:
        """Write that feet in the air read nothing but what is beyond their sensors.

        Divided by the scales, this is a row of the offsets alone.

        Args:
            mean: The unknowns as they are estimated, shape (..., N).
            block: The samples.
            count: Samples of each foot that count, shape (..., F).
            reading: Mean reading of each channel over them, shape (..., K).

        Returns:
            One row a channel.
        """
        xp, own = namespace_of(reading), self._constants.like(reading)
        number = count @ own.by_channel
        H = own.offsets + 0.0 * reading[..., None]
        y = -reading / own.unit
        if self._distal.matter:
            y = y + self._distal.felt(block.motion) / (own.unit * self.unknowns.own_scales(mean))
        few = xp.where(number > 1.0, number, 1.0)
        variance = self.config.swing_noise**2 * _SWING_SAMPLES / few
        return Rows(H, y, variance).keep(xp.astype(number > 0.5, reading.dtype))
