"""The product of the errors of a scale and of its offset, which linear rows leave out.

In F = a (F0 + o) the column of a scale holds the estimated offset. While that is off by d, the column is off
by d as well, in all rows alike, and no covariance of linear rows shows it. Three things allow for it, beside
the tare that is learnt before other rows are written:

* **Rows are less sure** by a small share of the product. It is small so that a robot that only stands, and
  never shows its zeros, learns as well.
* **A first swing** shows the offsets of a foot. If any was wrong, scales and offsets of the foot are
  forgotten: they were learnt with a wrong column. A robot that has rocked for long may know its offsets, and
  keeps its scales.
* **Between swings** an offset drifts, and in the columns of scales this looks like a load that moves. All
  rows since the swing share the error, so that each of them is less sure by as many times its variance.
"""

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.rows import Block, Rows
from surefoot.calibration.moment.state import MomentState
from surefoot.calibration.moment.tare import Tare
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.setup import OnlineSetup

_SHARED = 0.015
"""How often the product of the errors is added to a row's variance, over its noise factor."""

_WRONG = 0.003
"""Error of an offset in body weights (times foot lengths for a torque) beyond which what was learnt of its
foot is forgotten: the scale of a channel that reads an eighth of the weight would be off by two percent."""

_SURE_STD = 3.0
"""Standard deviations of a tare by which it must be off besides."""

_LONGEST_STANCE = 4.0
"""Time in s since a swing that counts at most: a robot that stands is to learn as well."""


class ErrorProduct:
    """Allows for the product in one setup.

    Args:
        setup: The robot.
        config: Options of the filter.
        unknowns: The unknowns.
        tare: The rows of feet in the air.
        start: Covariance of the unknowns to start from, shape (N, N).
    """

    def __init__(
        self, setup: OnlineSetup, config: MomentFilterConfig, unknowns: Unknowns, tare: Tare, start: Array
    ) -> None:
        self.unknowns, self.tare = unknowns, tare
        self._start = start
        block = config.every * setup.dt
        self._walk, self._longest = unknowns.walk[unknowns.offset] * block, _LONGEST_STANCE / block

    def forgotten(
        self, state: MomentState, block: Block, count: Array, reading: Array, lost: Array
    ) -> tuple[MomentState, bool]:
        """Forget what a foot was learnt with offsets that its first swing proves wrong.

        The states to go back to forget it as well.

        Args:
            state: The state.
            block: The samples.
            count: Samples in which each foot surely hangs, shape (F,).
            reading: Mean reading of each channel over them in N, shape (K,).
            lost: Channels that are out (0 or 1), shape (K,).

        Returns:
            The state, and whether anything was forgotten.
        """
        unknowns = self.unknowns
        first = (count > 0.5) & (state.swing_ago < 0.0) & (state.swing_samples < 0.5)
        if not first.any():
            return state, False
        tare = self.tare.rows(state.mean, block, count, reading)
        off = np.abs(tare.y - state.mean[unknowns.offset])
        seen = (off > _WRONG + _SURE_STD * np.sqrt(tare.variance)) & (lost < 0.5)
        feet = first & (self.tare.by_channel @ seen > 0.5)
        wrong = feet @ self.tare.by_channel > 0.5
        gone = np.zeros(unknowns.size, dtype=bool)
        gone[unknowns.scale], gone[unknowns.offset] = wrong[unknowns.inp], wrong
        pair = gone[:, None] | gone
        state = state._replace(
            mean=np.where(gone, unknowns.start, state.mean),
            covariance=np.where(pair, self._start, state.covariance),
            kept_mean=np.where(gone, unknowns.start, state.kept_mean),
            kept_covariance=np.where(
                pair[unknowns.lower], self._start[unknowns.lower], state.kept_covariance
            ),
        )
        return state, bool(wrong.any())

    def unsure(self, rows: Rows, places: Array, known: Array, factor: Array) -> Rows:
        """Return rows of the robot's motion that are less sure by a share of the product.

        Args:
            rows: The m rows.
            places: What a newton on each channel does to them, shape (m, K).
            known: Variances of the unknowns, shape (N,).
            factor: By how many times rows' variances are larger than assumed, shape (m,).
        """
        return self._wider(rows, places, known, known[self.unknowns.offset], _SHARED * factor)

    def since_swing(self, rows: Rows, places: Array, known: Array, drifted: Array) -> Rows:
        """Return rows that are less sure by what offsets have drifted by since their feet swung.

        Args:
            rows: The m rows.
            places: What a newton on each channel does to them, shape (m, K).
            known: Variances of the unknowns, shape (N,).
            drifted: As :meth:`drifted` returns it, shape (K,).
        """
        return self._wider(rows, places, known, drifted, float(len(rows.y)))

    def drifted(self, state: MomentState, count: Array) -> Array:
        """Return the variances that offsets drifted by since their feet swung, times blocks since then.

        Args:
            state: The state.
            count: Samples of the last block in which each foot surely hung, shape (F,).

        Returns:
            Shape (K,); 0 for a foot that hangs, or never swung. The last block counts.
        """
        blocks = np.clip(state.swing_ago + 1.0, 0.0, self._longest) * (count < 0.5)
        return (state.rate * blocks * blocks) @ self.tare.by_channel * self._walk

    def _wider(self, rows: Rows, places: Array, known: Array, offset: Array, share: Array | float) -> Rows:
        """Return rows with the product of scales' errors and of offsets' of such variances, so many times."""
        lever = places * self.unknowns.unit
        more = (lever * lever) @ (self.unknowns.own_scales(known) * offset)
        return rows._replace(variance=rows.variance + share * more)
