r"""A foot in the air shows its zeros.

Its mean reading r obeys a r + b + u = 0, where the zero's drift u is 0 at the start, so that the first tare
ties b to a. From then on u is *defined* by it, u = -(a r + b): learnt from this row, drift would say that a
scale is small. What it says of the time since the last tare, at which r0 was read, is a force that must have
drifted away,

    a r0 + b + u = -a (r - r0),

with the published a on the right; a zero that leaps says nothing. From tare to tare the readings show how
fast zeros drift, and scales are thought to drift with them.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array
from surefoot.calibration.moment.blocks import Block
from surefoot.calibration.moment.columns import Columns, Spread
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.modes import update
from surefoot.calibration.moment.state import Belief, TareState
from surefoot.calibration.setup import OnlineSetup

LEAST_SHARE = 0.45  # share of a block's time that a foot must surely be in the air for
NOISE_TIME = 0.2  # time in s that the noise of a tare is stated for

LEAST_APART = 0.3
"""Time in s from the end of a swing to the next: blocks of one swing say nothing of drift, and the first of
them shows how the foot reads in the air."""

RATE_SHARE, SMALLEST_RATE, LARGEST_RATE, LARGEST_SURPRISE = 0.15, 0.1, 10.0, 9.0
"""How much of the learnt drift rate one tare decides at least, after the first few; the rates in stated ones
that it is believed between, of good cells and of neglected ones; and the squared surprise, in expected ones,
of which more counts no more (three standard deviations)."""

STATED_RATE = 2.0  # tares that the rate to start from counts for

LEAP = 5.0
"""Standard deviations of drift and noise beyond which a zero has leapt, and says nothing of the time since: a
false alarm in 1.7 million."""

LARGEST_LOAD, LARGEST_SUM = 0.3, 0.4
"""Change of a channel's mean reading since the last tare, or since the start, and of a foot's sum, in body
weights by the starting map, from which on a foot is not in the air after all: three offsets of sensors three
times as bad as stated, and less than half of what a foot bears that stands."""


TOUCH = 0.1
"""Load in body weights from which on a foot touches the ground, above that of its swing a moment ago or the
least but one of a block's samples, whichever is less: no sole's own inertia comes near it, and a foot that
lands on soft ground before its plan passes it within a sample or two."""


class Tare:
    """The tares of one setup.

    Args:
        setup: The robot.
        config: Options.
        columns: The unknowns.
        spread: How sure they are at the start.

    Attributes:
        variance: Of a channel's mean reading by the time in the air in W^2 s, shape (K,).
    """

    def __init__(self, setup: OnlineSetup, config: Moment, columns: Columns, spread: Spread) -> None:
        self._columns, self._unit, self._feet = columns, spread.unit, setup.layout.slices
        self._foot_of_channel = setup.layout.foot_of_channel
        self.variance = (config.tare_noise * spread.unit) ** 2 * NOISE_TIME
        self._drift, self._block = spread.walk[1], config.block

    def take(
        self,
        block: Block,
        time: float,
        belief: Belief,
        published: Array,
        state: TareState,
        lost: Array,
    ) -> tuple[Belief, Array, TareState]:
        """Tare the feet that hang in a block.

        Args:
            block: The samples.
            time: At its end in s.
            belief: The modes' posteriors.
            published: The published map, shape (M,).
            state: Results of tares before.
            lost: Channels that are out (0 or 1), shape (K,).

        Returns:
            The belief, the published map with the drift of now, and the state.
        """
        columns, rate, followed = self._columns, state.rate, state.followed
        published, shown, times = published.copy(), state.reading.copy(), state.time.copy()
        moved = state.moved.copy()
        in_swing = (times >= 0.0) & (time - times <= LEAST_APART)
        in_air = np.where(in_swing[self._foot_of_channel], shown, np.inf)
        for foot, at, reading, seconds in self._hanging(block, lost, in_air, state.reading):
            a, noise, last = published[columns.scale][at], self.variance[at] / seconds, times[foot]
            before, steady = reading if last < 0.0 else shown[at] + moved[at], np.ones(len(at), dtype=bool)
            unseen = reading - before
            if last >= 0.0:
                change = reading - shown[at]
                walked = 2.0 * noise + rate**2 * self._drift[at] * (time - last)
                steady = change**2 <= LEAP**2 * walked
                if time - last > LEAST_APART:
                    rate, followed = self._learn_rate(rate, followed, change, walked), followed + 1
            variance, asked = a**2 * noise, -a * unseen
            belief = self._learn(belief, *(part[steady] for part in (at, before, asked, variance)))
            if last >= 0.0:
                belief = self._redefine(belief, at, reading, variance)
            published[columns.drift.start + at] = -a * reading - published[columns.offset.start + at]
            shown[at], moved[at], times[foot] = reading, 0.0, time
        return belief, published, TareState(shown, moved, times, rate, followed)

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
        variance = self.variance / self._block + state.rate**2 * self._drift * (time - last)
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
        for _, at, _, seconds in self._hanging(block, np.zeros(len(a)), np.full(len(a), np.inf), -b / a):
            found.append(self._write(at, zero[at]))
            variance.append(a[at] ** 2 * self.variance[at] / seconds)
        return np.vstack(found), np.diag(np.concatenate(variance))

    def _hanging(
        self, block: Block, lost: Array, before: Array, last: Array
    ) -> Iterator[tuple[int, NDArray[np.int64], Array, float]]:
        """Find feet that hang: each with its channels that are not lost, their mean reading, and seconds.

        ``before`` are the readings of swings a moment ago, infinite where there is none, and ``last`` those
        of the last tare, 0 where there is none, shape (K,).
        """
        for foot, of_foot in enumerate(self._feet):
            channels = np.flatnonzero(lost[of_foot] < 0.5) + of_foot.start
            reading, seconds = self._reading(block, foot, channels, before[channels], last[channels])
            if seconds >= LEAST_SHARE * block.duration:
                yield foot, channels, reading, seconds

    def _write(self, channels: NDArray[np.int64], reading: Array) -> Array:
        """Return the rows a r + b + u of some channels, shape (m, N)."""
        columns, rows = self._columns, np.arange(len(channels))
        H = np.zeros((len(channels), columns.size))
        H[rows, channels + columns.scale.start] = reading
        H[rows, channels + columns.offset.start] = H[rows, channels + columns.drift.start] = 1.0
        return H

    def _reading(
        self, block: Block, foot: int, channels: NDArray[np.int64], before: Array, last: Array
    ) -> tuple[Array, float]:
        """Return a foot's mean reading in the air, and how long it hung in s."""
        swing = block.swing[:, foot] > 0.5
        # The sample before and the one after are in the air as well.
        sure = swing[1:] & swing[:-1] & np.append(swing[2:], swing[-1])
        sure &= (block.read[:, channels] > 0.5).all(axis=1)
        if not (sure.any() and channels.size):
            return np.zeros(len(channels)), 0.0
        load = (block.force[:, channels] / self._unit[channels]).sum(axis=1)
        least = min(np.sort(load[sure])[:2][-1], (before / self._unit[channels]).sum())
        sure &= load <= least + TOUCH
        if not sure.any():
            return np.zeros(len(channels)), 0.0
        reading = block.force[np.ix_(sure, channels)].mean(axis=0)
        change = (reading - last) / self._unit[channels]
        in_air = np.abs(change).max() <= LARGEST_LOAD and abs(change.sum()) <= LARGEST_SUM
        return reading, float(block.dt[sure].sum()) * in_air

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
