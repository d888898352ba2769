r"""A robot that stands still bears the same loads: its readings change by their drift.

With d the change of a block's mean readings since the last, q their drift's variance in between, and K
channels, the readings of a robot that stands still change by v = mean(d^2 / q) of 1. That drift alone changes
them, and no load, has a likelihood of exp(-K / 2 (v - 1 - log v)) where v is larger. The same is asked of
their distance to a mean over some seconds, for a robot that moves slowly. So large a share of the change is
taken for drift: it says nothing of scales, which readings that drift draw to 0 otherwise.
"""

from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.moment.blocks import Block
from surefoot.calibration.moment.columns import Columns, Spread
from surefoot.calibration.moment.state import Belief, StillState, TareState

LEVEL_TIME = 4.0
"""Time in s of the mean that readings are compared with: with 2 s a G1 whose policy turns its load slowly
counts as still, and with 8 s hardly anybody does."""

LEAST_STILL = 0.01
"""Likelihood below which nobody stands still."""


class Still(NamedTuple):
    """How readings of a robot that stands still tell their drift, of one setup.

    Attributes:
        columns: The unknowns.
        drift: Variance that zeros drift by at the stated rate in W^2/s, shape (K,).
        noise: Variance of a channel's mean reading by the time that it is read for, in W^2 s, shape (K,).
    """

    columns: Columns
    drift: Array
    noise: Array

    @classmethod
    def of(cls, columns: Columns, spread: Spread, noise: Array) -> "Still":
        """Return that of a robot."""
        return cls(columns, spread.walk[1], noise)

    def init(self) -> StillState:
        """Return the state of a robot that has not been seen."""
        zero = np.zeros_like(self.drift)
        return StillState(zero, zero, -1.0)

    def take(
        self,
        block: Block,
        time: float,
        belief: Belief,
        published: Array,
        state: StillState,
        tare: TareState,
        lost: Array,
    ) -> tuple[Belief, Array, StillState, TareState]:
        """Let zeros follow the readings of a robot that stands still.

        Args:
            block: The samples.
            time: At its end in s.
            belief: The modes' posteriors, whose zeros have drifted for the block already.
            published: The published map, shape (M,).
            state: Readings until then.
            tare: Results of tares before.
            lost: Channels that are out (0 or 1), shape (K,).

        Returns:
            The belief, the published map, the state, and the tares, whose readings have moved.
        """
        reading = block.force.mean(axis=0)
        if state.time < 0.0:
            return belief, published, StillState(reading, reading, time), tare
        apart, drift, noise = time - state.time, tare.rate**2 * self.drift, self.noise / block.duration
        change, level = (
            reading - state.reading,
            state.level + min(apart / LEVEL_TIME, 1.0) * (reading - state.level),
        )
        there = lost < 0.5
        still = min(
            _likelihood(change[there], (drift * apart + 2.0 * noise)[there]),
            _likelihood((reading - level)[there], (0.5 * drift * LEVEL_TIME + noise)[there]),
        )
        state = StillState(reading, level, time)
        if still < LEAST_STILL:
            return belief, published, state, tare
        # Noise comes and goes, and is all that a sensor shows that does not drift.
        share = still * there * drift * LEVEL_TIME / (drift * LEVEL_TIME + noise)
        belief, published = self._follow(belief, published, share * change, share * drift * block.duration)
        return belief, published, state, tare._replace(moved=tare.moved + share * change)

    def _follow(self, belief: Belief, published: Array, drifted: Array, known: Array) -> tuple[Belief, Array]:
        """Let zeros drift by ``drifted`` in W; a variance ``known`` of it is no longer open, shapes (K,)."""
        scale, drift = self.columns.scale, self.columns.drift
        mean, covariance, published = belief.mean.copy(), belief.covariance.copy(), published.copy()
        mean[:, drift] -= drifted * mean[:, scale]
        covariance[:, drift] -= drifted[:, None] * covariance[:, scale]
        covariance[:, :, drift] -= drifted * covariance[:, :, scale]
        at = np.arange(drift.start, drift.stop)
        covariance[:, at, at] -= known * published[scale] ** 2
        published[drift] -= drifted * published[scale]
        return belief._replace(mean=mean, covariance=covariance), published


def _likelihood(change: Array, variance: Array) -> float:
    """Return how likely drift alone is, against any larger change, by changes of stated variances."""
    larger = max(float((change**2 / variance).mean()), 1.0) if len(change) else np.inf
    return float(np.exp(-0.5 * len(change) * (larger - 1.0 - np.log(larger)))) if larger < np.inf else 0.0
