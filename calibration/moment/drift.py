r"""How fast sensors drift, learnt from what their zeros do between one swing of a foot and its next.

Options state a drift per square root of a minute; neglected sensors drift several times as fast. A channel's
mean reading in a swing, held against that of the swing before, shows its zero move by d, in which no scale
and no reference has a part. Without what all channels of the foot have in common, as a foot that touches the
ground has,

    E d^2 = rate * walk * n + 2 R

for n blocks in between, the stated variance ``walk`` of a block, and that of a tare, R. The rate follows the
mean of d^2 over what is expected of it. Where zeros drift faster than stated, scales are taken to do so as
well. The rate is never below one: quiet zeros do not prove quiet scales.

What drifts is a sensor's gain, 1/a: where a is above one, its variance grows a^4 times as fast.
"""

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.state import MomentState
from surefoot.calibration.moment.tare import Tare
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.setup import OnlineSetup

_MEMORY = 0.15
"""How much of the rate one swing renews."""

_FASTEST = 100.0
"""Largest rate."""

_LARGEST_SQUARE = 9.0
"""Largest squared normalised step that the rate follows: one beyond three deviations may be a knock."""

_FEWEST_SAMPLES = 8.0
"""Samples that a swing must have to be held against another."""

_FEWEST_CHANNELS = 2.5
"""Channels of a foot that must be more than these, for what they have in common to be told apart."""

_LARGEST_SCALE = 3.0
"""Largest scale that a gain's drift is worked out with; the least is 1."""


class LearntDrift:
    """Follows the drift of one setup's sensors.

    Args:
        setup: The robot.
        config: Options of the filter.
        unknowns: The unknowns.
        tare: The rows of feet in the air.
    """

    def __init__(
        self, setup: OnlineSetup, config: MomentFilterConfig, unknowns: Unknowns, tare: Tare
    ) -> None:
        self.unknowns, self.tare, self._slices = unknowns, tare, setup.layout.slices
        block = config.every * setup.dt
        self._walk, self._age = unknowns.walk * block, unknowns.age / block

    def walk(self, state: MomentState) -> Array:
        """Return the variances by which the unknowns drift in one block, shape (N,)."""
        unknowns, walk = self.unknowns, self._walk.copy()
        scale = np.clip(unknowns.own_scales(state.mean), 1.0, _LARGEST_SCALE)
        walk[: unknowns.channels] *= state.rate * scale**4
        walk[unknowns.offset] *= state.rate
        return walk

    def aged(self, state: MomentState) -> Array:
        """Return the variances by which scales and offsets drifted since they were learnt, shape (P + K,)."""
        return self._age * self.walk(state)[self.unknowns.map]

    def followed(self, state: MomentState, count: Array, reading: Array, sound: Array) -> MomentState:
        """Return the state with the rate that swings show which end with this block.

        Args:
            state: The state.
            count: Samples of this block in which each foot surely hangs, shape (F,).
            reading: Means of the forces by the starting map over them in N, shape (K,).
            sound: Channels that are not lost (0 or 1), shape (K,).
        """
        zero, ago = state.swing_zero.copy(), state.swing_ago.copy()
        total, samples = state.swing_sum.copy(), state.swing_samples.copy()
        surplus = 0.0
        for foot, own in enumerate(self._slices):
            if count[foot] > 0.5:
                total[own] += reading[own] / self.unknowns.unit[own] * count[foot]
                samples[foot] += count[foot]
                continue
            whole = samples[foot] >= _FEWEST_SAMPLES
            if whole:
                surplus += self._surplus(state, foot, own, sound[own])
            # The first swing is the first however short it was.
            if whole or (ago[foot] < 0.0 and samples[foot] > 0.5):
                zero[own], ago[foot] = total[own] / samples[foot], 0.0
            total[own], samples[foot] = 0.0, 0.0
        return state._replace(
            rate=float(np.clip(state.rate * (1.0 + _MEMORY * surplus), 1.0, _FASTEST)),
            swing_zero=zero,
            swing_ago=ago,
            swing_sum=total,
            swing_samples=samples,
        )

    def _surplus(self, state: MomentState, foot: int, own: slice, sound: Array) -> float:
        """Return the mean of d^2 / E d^2 - 1 over a foot's channels ``own``, as its swing ends."""
        channels = float(sound.sum())
        if state.swing_ago[foot] <= 0.0 or channels <= _FEWEST_CHANNELS:
            return 0.0
        samples = state.swing_samples[foot]
        moved = (state.swing_sum[own] / samples - state.swing_zero[own]) * sound
        moved = moved - moved.sum() / channels
        walked = state.rate * self._walk[self.unknowns.offset][own] * state.swing_ago[foot]
        expected = (walked + 2.0 * self.tare.variance(samples)) * (1.0 - 1.0 / channels)
        square = np.minimum(moved * moved / expected, _LARGEST_SQUARE)
        return float(((square - 1.0) * sound).sum()) / channels
