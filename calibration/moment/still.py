r"""A robot that stands still shows nothing of its scales: its readings change by their drift.

Readings that drift are regressors with errors, which draw scales to 0: from a load that stays and a reading
that does not, a filter learns that the scale is small. With d the change of a block's mean readings since the
last, q their drift's variance in between, and K channels, drift alone changes them by v = mean(d^2 / q) of 1.
That it was drift alone, and no load, has a likelihood of exp(-K / 2 (v - 1 - log v)) where v is larger. The
same is asked of their distance to a mean over some seconds, for a robot that moves slowly. That share of a
change says nothing of scales: it is a force by the published ones, or drift, and the momentum tells which.
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

LEAST_STILL = 0.01  # likelihood below which nobody stands still


class Still(NamedTuple):
    """Keeps scales from what readings of a robot that stands still change by, for one setup."""

    columns: Columns  # the unknowns
    drift: Array  # variance that zeros drift by at the stated rate in W^2/s, shape (K,)
    noise: Array  # variance of a channel's mean reading by the time that it is read for, in W^2 s, shape (K,)

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
    ) -> tuple[Belief, StillState, TareState]:
        """Let readings of a robot that stands still change without a word of scales.

        Args:
            block: The samples.
            time: At its end in s.
            belief: The modes' posteriors.
            published: The published map, shape (M,).
            state: Readings until then.
            tare: Results of tares before.
            lost: Channels that are out (0 or 1), shape (K,).

        Returns:
            The belief, the state, and the tares, whose readings have moved.
        """
        reading = block.force.mean(axis=0)
        if state.time < 0.0:
            return belief, StillState(reading, reading, time), tare
        apart, drift, noise = time - state.time, tare.rate**2 * self.drift, self.noise / block.duration
        change = reading - state.reading
        level = state.level + min(apart / LEVEL_TIME, 1.0) * (reading - state.level)
        there = lost < 0.5
        still = min(
            _likelihood(change[there], (drift * apart + 2.0 * noise)[there]),
            _likelihood((reading - level)[there], (0.5 * drift * LEVEL_TIME + noise)[there]),
        )
        state = StillState(reading, level, time)
        if still < LEAST_STILL:
            return belief, state, tare
        # Noise comes and goes, and is all that a sensor shows that does not drift.
        moved = change * (still * there * drift * LEVEL_TIME / (drift * LEVEL_TIME + noise))
        return self._hold(belief, published, moved), state, tare._replace(moved=tare.moved + moved)

    def _hold(self, belief: Belief, published: Array, moved: Array) -> Belief:
        """Let readings move in W, shape (K,), by forces of the published scales, whatever the scales are."""
        scale, drift = self.columns.scale, self.columns.drift
        mean, covariance = belief.mean.copy(), belief.covariance.copy()
        mean[:, drift] -= moved * (mean[:, scale] - published[scale])
        covariance[:, drift] -= moved[:, None] * covariance[:, scale]
        covariance[:, :, drift] -= moved * covariance[:, :, scale]
        return belief._replace(mean=mean, covariance=covariance)


def _likelihood(change: Array, variance: Array) -> float:
    """Return how likely drift alone is, against any larger change, by changes of stated variances."""
    if not len(change):
        return 0.0
    larger = max(float((change**2 / variance).mean()), 1.0)
    return float(np.exp(-0.5 * len(change) * (larger - 1.0 - np.log(larger)))) if larger < np.inf else 0.0
