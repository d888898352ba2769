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
        self.unknowns, self.tare = unknowns, tare
        block = config.every * setup.dt
        self._walk, self._age = unknowns.walk * block, unknowns.age / block

    def walk(self, state: MomentState) -> Array:
        """Return the variances by which the unknowns drift in one block, shape (..., N)."""
        unknowns, rate = self.unknowns, state.rate[..., None]
        scale = np.clip(unknowns.own_scales(state.mean), 1.0, _LARGEST_SCALE)
        walk: Array = self._walk + 0.0 * state.mean
        walk[..., : unknowns.channels] *= rate * scale**4
        walk[..., unknowns.offset] *= rate
        return walk

    def aged(self, state: MomentState) -> Array:
        """Return the variances by which scales and offsets drifted since they were learnt, (..., P + K)."""
        return self._age * self.walk(state)[..., self.unknowns.map]

    def followed(self, state: MomentState, count: Array, reading: Array, sound: Array) -> MomentState:
        """Return the state with the rate that swings show which end with this block.

        Args:
            state: The state.
            count: Samples of this block in which each foot surely hangs, shape (..., F).
            reading: Means of the forces by the starting map over them in N, shape (..., K).
            sound: Channels that are not lost (0 or 1), shape (..., K).
        """
        of_foot, air = self.tare.by_channel, count > 0.5
        ends = ~air & (state.swing_samples >= _FEWEST_SAMPLES)
        number = np.maximum(state.swing_samples, 1.0) @ of_foot
        zero = state.swing_sum / number
        sound = sound * (ends @ of_foot)
        channels = np.maximum(sound @ of_foot.T, 1.0)
        moved = (zero - state.swing_zero) * sound
        moved = moved - ((moved @ of_foot.T / channels) @ of_foot) * sound
        expected = state.rate[..., None] * self._walk[self.unknowns.offset] * (state.swing_ago @ of_foot)
        expected = (expected + 2.0 * self.tare.variance(number)) * ((1.0 - 1.0 / channels) @ of_foot)
        square = np.clip(moved * moved / np.where(expected > 0.0, expected, 1.0), 0.0, _LARGEST_SQUARE)
        surplus = ((square - 1.0) * sound) @ of_foot.T / channels
        seen = ends & (state.swing_ago > 0.0) & (channels > _FEWEST_CHANNELS)
        rate = state.rate * (1.0 + _MEMORY * (surplus * seen).sum(axis=-1))
        # The first swing is the first however short it was.
        ends = ends | (~air & (state.swing_ago < 0.0) & (state.swing_samples > 0.5))
        ends_of, air_of = (ends @ of_foot) > 0.5, (air @ of_foot) > 0.5
        added = state.swing_sum + reading / self.unknowns.unit * (count @ of_foot)
        return state._replace(
            rate=np.clip(rate, 1.0, _FASTEST),
            swing_zero=np.where(ends_of, zero, state.swing_zero),
            swing_ago=np.where(ends, 0.0, state.swing_ago),
            swing_sum=np.where(air_of, added, 0.0),
            swing_samples=np.where(air, state.swing_samples + count, 0.0),
        )
