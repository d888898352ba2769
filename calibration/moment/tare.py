r"""A foot in the air shows its zeros, if nothing is borne.

The mean reading r of an unloaded channel obeys a r + b + u = 0, where the drift u of the zero is 0 at the
start, so that the first tare ties b to a. From then on u is *defined* as -(a r + b). Estimating it from this
row would bias the scale down. The change since the last tare, with reading r0, only shows the force that the
zero has drifted by,

    a r0 + b + u = -a (r - r0),

with the published a on the right.

The reference reports a swing where a foot's lowest part is higher than that of another foot. On soft ground
or under a rolling sole such a foot may bear load. Whether it does is a matter of evidence: of the readings

* their **roughness** v, the variance within a block over that of the noise. The load of a foot that touches
  the ground varies much more than the noise of a reading,
* their **change** since the last tare, compared with drift and noise, or before the first tare their distance
  from the starting map, compared with the offsets expected. A load changes them by any amount, and only
  upwards.

A row enters with the variance that it may be loaded after all, so that a doubtful tare changes little. The
zero in use has a probability of its own, and a likelier one replaces it: readings of a block that was taken
for a load become the zero if the next block in swing repeats them. That includes blocks of the same swing, so
that the constant load of a foot wrongly reported in swing can be taken for the zero. If a zero that no second
swing has confirmed turns out to be too high, the foot was loaded, and the filter begins again. From tare to
tare the readings show how fast zeros drift, and scales are assumed to drift in proportion.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array
from surefoot.calibration.moment.blocks import Block
from surefoot.calibration.moment.columns import Columns, Spread
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.health import MOST_LOAD
from surefoot.calibration.moment.modes import update
from surefoot.calibration.moment.severity import FIRST_RATE, LIKELY, SEVERITIES
from surefoot.calibration.moment.state import Belief, TareState
from surefoot.calibration.setup import OnlineSetup

LEAST_SHARE = 0.45  # minimum share of a block's time that a foot must be in swing
NOISE_TIME = 0.2  # time in s that the noise of a tare is stated for

LEAST_APART = 0.3
"""Minimum time in s from the end of a swing to the next one. Blocks of one swing contain no information about
drift."""

RATE_SHARE, SMALLEST_RATE, LARGEST_RATE, LARGEST_SURPRISE = 0.15, 0.1, 10.0, 9.0
"""Minimum weight of one tare in the learnt drift rate; bounds of the rate, in stated ones, for good and for
neglected cells; and the largest squared surprise, in expected ones, that counts (three standard
deviations)."""

STATED_RATE = 2.0  # tares that the rate to start from counts for

LEAP = 5.0
"""Standard deviations of drift and noise above which a zero has jumped, so that its drift since the last tare
is unknown: a false alarm in 1.7 million."""

LARGEST_LOAD = 0.3
"""Largest change of a zero that jumps, in body weights: three offsets of sensors three times as bad as
stated."""

ROUGH_DENSITY = 0.1
"""Density of a loaded foot's roughness by its logarithm. Measured between 4 and 1e5 on a G1 and a T1 that
walk and dance, on hard and on soft ground: a tenth per factor of e."""

NOISE_SPREAD = 1.4
"""Standard deviation of the logarithm of a sensor's noise variance by the stated one: noise twice as large as
stated is one standard deviation."""

ZERO_JUMP = 1e-3
"""Probability that a zero jumps between two tares, by a shock or a step of the supply."""

ROUGHEST = 1e9  # roughness that stands for that of a foot that has not been in swing yet

UNCONFIRMED = 0.99
"""Largest probability of a zero that only one swing has shown. A foot may rest on an edge in its first."""


class Tare:
    """The tares of one setup.

    Args:
        setup: The robot.
        config: Options.
        columns: The unknowns.
        spread: How sure they are at the start.

    Attributes:
        variance: Variance of a channel's mean reading times the time in the air, in W^2 s, shape (K,).
        loaded: Squared force of each channel of a foot that bears the largest load, in W^2, shape (K,).
    """

    def __init__(self, setup: OnlineSetup, config: Moment, columns: Columns, spread: Spread) -> None:
        self._columns, self._unit, self._feet = columns, spread.unit, setup.layout.slices
        self._foot_of_channel = setup.layout.foot_of_channel
        self.variance = (config.tare_noise * spread.unit) ** 2 * NOISE_TIME
        self.loaded = (
            MOST_LOAD * spread.unit / np.bincount(self._foot_of_channel)[self._foot_of_channel]
        ) ** 2
        self._vertical = setup.layout.wrench_map[:, 2].sum(axis=0)
        self._drift, self._offset, self._block = spread.walk[1], spread.offset, config.block

    def init(self) -> TareState:
        """Return the state of feet that have not been in swing yet."""
        zero, feet = np.zeros_like(self._unit), len(self._feet)
        return TareState(
            reading=zero,
            moved=zero,
            time=np.full(feet, -1.0),
            sure=np.zeros(feet),
            offered=zero,
            offer=np.zeros(feet),
            rough=np.full(feet, ROUGHEST),
            rate=FIRST_RATE,
            followed=0,
        )

    def take(
        self, block: Block, time: float, belief: Belief, published: Array, state: TareState, lost: Array
    ) -> tuple[Belief, Array, TareState, bool]:
        """Tare the feet that hang in a block.

        Args:
            block: The samples.
            time: Time at its end in s.
            belief: Posteriors of the modes.
            published: The published map, shape (M,).
            state: Results of earlier tares.
            lost: Channels that are out (0 or 1), shape (K,).

        Returns:
            The belief, the published map with the present drift, the state, and whether a zero that was in
            use turned out to be that of a loaded foot.
        """
        columns, rate, followed, wrong = self._columns, state.rate, state.followed, False
        published, shown, times = published.copy(), state.reading.copy(), state.time.copy()
        moved, sure, rough = state.moved.copy(), state.sure.copy(), state.rough.copy()
        offered, offer = state.offered.copy(), state.offer.copy()
        for foot, at, swing in self._hanging(block, lost):
            last = times[foot]
            rough[foot] = max(min(rough[foot], swing.rough), 1.0)
            a, noise = published[columns.scale][at], rough[foot] * self.variance[at] / swing.seconds
            change = swing.reading - shown[at]
            walked = 2.0 * noise + rate**2 * self._drift[at] * (time - max(last, 0.0))
            repeated = swing.reading - offered[at]
            odds = self._weigh(
                at, change, repeated, walked, swing.rough, rough[foot], sure[foot], offer[foot]
            )
            if odds.same + odds.other < 0.5:
                sure[foot], offer[foot], offered[at] = odds.right, odds.other, swing.reading
                continue
            first, replaced = last < 0.0, odds.other > odds.same
            if replaced and not first:
                wrong = wrong or bool(change @ self._vertical[at] < 0.0 and sure[foot] <= UNCONFIRMED)
            again = not first and time - last > LEAST_APART
            if again:
                rate, followed = self._learn_rate(rate, followed, change, walked), followed + 1
            # The drift of a zero that jumped is unknown.
            steady = np.full(len(at), first) | (change**2 <= LEAP**2 * walked)
            before = swing.reading if first else shown[at] + moved[at]
            variance = a**2 * (noise + (1.0 - odds.same - odds.other) * self.loaded[at])
            asked = -a * (swing.reading - before)
            belief = self._learn(belief, *(part[steady] for part in (at, before, asked, variance)))
            if not first:
                belief = self._redefine(belief, at, swing.reading, variance)
            published[columns.drift.start + at] = -a * swing.reading - published[columns.offset.start + at]
            shown[at], moved[at], times[foot], offer[foot] = swing.reading, 0.0, time, 0.0
            if replaced:
                sure[foot] = min(odds.other, UNCONFIRMED)
            elif again:
                sure[foot] = odds.same
        state = TareState(shown, moved, times, sure, offered, offer, rough, rate, followed)
        return belief, published, state, wrong

    def _weigh(
        self,
        at: NDArray[np.int64],
        change: Array,
        repeated: Array,
        walked: Array,
        rough: float,
        smooth: float,
        sure: float,
        offer: float,
    ) -> "Odds":
        """Weigh what the readings of a foot in swing may be.

        Beforehand a foot that its kinematics show in swing is loaded or unloaded with equal probability.

        Args:
            at: The foot's channels, shape (m,).
            change: Change of their readings since the last tare in W, shape (m,).
            repeated: Change since the last block that was taken for a load in W, shape (m,).
            walked: Variance of a change by drift and noise in W^2, shape (m,).
            rough: Roughness of the readings.
            smooth: Roughness without load.
            sure: Probability that the zero in use is right.
            offer: Probability that the block that was taken for a load showed the zero.
        """
        count, over, sure = len(at), rough / smooth, sure * (1.0 - ZERO_JUMP)
        flat = np.exp(-0.5 * count * (over - 1.0 - np.log(over)) - 0.5 * (np.log(smooth) / NOISE_SPREAD) ** 2)
        spread = walked + np.square(SEVERITIES)[:, None] * self._offset[at]
        same = sure * flat * np.exp(_log_density(change, walked))
        again = offer * flat * np.exp(_log_density(repeated, walked))
        new = max(1.0 - sure - offer, 0.0) * flat * np.dot(LIKELY, np.exp(_log_density(change, spread)))
        loaded = ROUGH_DENSITY * np.prod(1.0 / np.sqrt(self.loaded[at]))
        # Load is never negative.
        right = same + loaded * sure * (change @ self._vertical[at] > 0.0)
        total = right + again + new + loaded * (1.0 - sure)
        return Odds(float(same / total), float((again + new) / total), float(right / total))

    def repeat(self, belief: Belief, state: TareState, time: float, lost: Array) -> Belief:
        """Tare the feet once more as they read last, with a belief that knows nothing yet.

        Args:
            belief: The modes' posteriors, with scales of 1.
            state: Results of tares before.
            time: Now in s.
            lost: Channels that are out (0 or 1), shape (K,).
        """
        last = state.time[self._foot_of_channel]
        at = np.flatnonzero((last >= 0.0) & (lost < 0.5))
        rough, sure = state.rough[self._foot_of_channel], state.sure[self._foot_of_channel]
        noise = rough * self.variance / self._block + (1.0 - sure) * self.loaded
        variance = noise + state.rate**2 * self._drift * (time - last)
        return self._learn(belief, at, (state.reading + state.moved)[at], np.zeros(len(at)), variance[at])

    def rows(self, block: Block, known: Array) -> tuple[Array, Array]:
        """Write the rows of the feet that hang in a block.

        Args:
            block: The samples.
            known: True scales, offsets and drift, shape (M,).

        Returns:
            Rows, shape (m, N), and their variance, shape (m, m).
        """
        columns = self._columns
        a, b, u = (known[part] for part in (columns.scale, columns.offset, columns.drift))
        zero = -(b + u) / a
        found, variance = [np.zeros((0, columns.size))], [np.zeros(0)]
        for _, at, swing in self._hanging(block, np.zeros(len(a))):
            found.append(self._write(at, zero[at]))
            variance.append(a[at] ** 2 * self.variance[at] / swing.seconds)
        return np.vstack(found), np.diag(np.concatenate(variance))

    def _hanging(self, block: Block, lost: Array) -> Iterator[tuple[int, NDArray[np.int64], "Swing"]]:
        """Find the feet in swing: each with its channels that are not lost, and their readings."""
        for foot, of_foot in enumerate(self._feet):
            channels = np.flatnonzero(lost[of_foot] < 0.5) + of_foot.start
            swing = self._read(block, foot, channels)
            if channels.size and swing.seconds >= LEAST_SHARE * block.duration:
                yield foot, channels, swing

    def _write(self, channels: NDArray[np.int64], reading: Array) -> Array:
        """Return the rows a r + b + u of some channels, shape (m, N)."""
        columns, rows = self._columns, np.arange(len(channels))
        H = np.zeros((len(channels), columns.size))
        H[rows, channels + columns.scale.start] = reading
        H[rows, channels + columns.offset.start] = H[rows, channels + columns.drift.start] = 1.0
        return H

    def _read(self, block: Block, foot: int, channels: NDArray[np.int64]) -> "Swing":
        """Return a foot's readings in swing."""
        swing = block.swing[:, foot] > 0.5
        # The sample before and the one after are in the air as well.
        sure = swing[1:] & swing[:-1] & np.append(swing[2:], swing[-1])
        sure &= (block.read[:, channels] > 0.5).all(axis=1)
        count, seconds = int(sure.sum()), float(block.dt[sure].sum())
        if count == 0 or len(channels) == 0:
            return Swing(np.zeros(len(channels)), 0.0, 1.0)
        force = block.force[np.ix_(sure, channels)]
        reading = force.mean(axis=0)
        noise = self.variance[channels] * count / seconds
        rough = float((np.square(force - reading) / noise).sum()) / (max(count - 1, 1) * len(channels))
        return Swing(reading, seconds, max(rough, 1.0))

    def _learn(
        self,
        belief: Belief,
        channels: NDArray[np.int64],
        reading: Array,
        asked: Array,
        variance: Array,
    ) -> Belief:
        """Let all modes know that readings are forces ``asked``, of a variance in W^2, shapes (m,)."""
        H, found = self._write(channels, reading), []
        for mean, covariance in zip(belief.mean, belief.covariance, strict=True):
            found.append(update(mean, covariance, H, asked - H @ mean, np.diag(variance), self._columns.mass))
        means, covariances = (np.stack(part) for part in zip(*found, strict=True))
        return belief._replace(mean=means, covariance=covariances)

    def _redefine(
        self, belief: Belief, channels: NDArray[np.int64], reading: Array, variance: Array
    ) -> Belief:
        """Define the drift again by readings without load, of forces of a variance in W^2, shapes (m,)."""
        columns = self._columns
        drift, turned = channels + columns.drift.start, np.eye(columns.size)
        turned[drift] = -self._write(channels, reading)
        turned[drift, drift] = 0.0
        covariance = turned @ belief.covariance @ turned.T
        covariance[:, drift, drift] += variance
        return belief._replace(mean=belief.mean @ turned.T, covariance=covariance)

    def _learn_rate(self, rate: float, followed: int, change: Array, expected: Array) -> float:
        """Return by how many times sensors drift faster than stated, by changes since the last tare.

        A change that a foot's channels share is not drift alone: a sole's own inertia is in it.
        """
        count = len(change)
        own = (change - change.mean()) ** 2 * count / max(count - 1, 1)
        surprise = float(np.minimum(own / expected, LARGEST_SURPRISE).mean())
        share = max(RATE_SHARE, 1.0 / (followed + STATED_RATE))
        return float(np.clip(rate * np.sqrt(1.0 + share * (surprise - 1.0)), SMALLEST_RATE, LARGEST_RATE))


class Odds(NamedTuple):
    """Probabilities of what a foot in swing shows."""

    same: float  # that it is unloaded and the zero in use is right
    other: float  # that it is unloaded and the zero in use is wrong
    right: float  # that the zero in use is right, whether the foot is loaded or not


class Swing(NamedTuple):
    """Readings of a foot that is in swing by its kinematics; m channels."""

    reading: Array  # mean of each channel in W, shape (m,)
    seconds: float  # for how long the foot was in swing
    rough: float  # variance of the readings by that of the noise as stated, at least 1


def _log_density(change: Array, variance: Array) -> Array:
    """Return the logarithm of the density of independent normal changes, shapes (..., m) to (...)."""
    found: Array = -0.5 * (change**2 / variance + np.log(2.0 * np.pi * variance)).sum(axis=-1)
    return found
