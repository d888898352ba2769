r"""A foot in the air shows its zeros.

Its mean reading r obeys a (r + u) + b = 0. At the first tare that ties b to a; from then on u is the drift of
the zeros since, known by definition, u = r_first - r, and the row says the same of scales as then.
From tare to tare the readings show how fast zeros drift, and scales are thought to drift with them.
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

LEAST_SHARE = 0.45
"""Share of a block's time that a foot must surely be in the air for."""

NOISE_TIME = 0.2
"""Time in s that the noise of a tare is stated for."""

LEAST_APART = 0.3
"""Time in s from the end of a swing to the next: blocks of one swing say nothing of drift, and the first of
them shows how the foot reads in the air."""

RATE_SHARE, SMALLEST_RATE, LARGEST_RATE, LARGEST_SURPRISE = 0.15, 0.1, 10.0, 9.0
"""How much of the learnt drift rate one tare decides at least, after the first few; the rates in stated ones
that it is believed between, of good cells and of neglected ones; and the squared surprise, in expected ones,
of which more counts no more (three standard deviations)."""

STATED_RATE = 2.0
"""Tares that the rate to start from counts for."""

LEAP = 5.0
"""Standard deviations of drift and noise beyond which zeros have leapt: a false alarm in 1.7 million."""

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
        self, block: Block, time: float, belief: Belief, published: Array, state: TareState, lost: Array
    ) -> tuple[Belief, Array, TareState]:
        """Tare the feet that hang in a block.

        Args:
            block: The samples.
            time: At its end in s.
            belief: The modes' posteriors.
            published: The published map, about which a u is linear, shape (M,).
            state: Results of tares before.
            lost: Channels that are out (0 or 1), shape (K,).

        Returns:
            The belief, the published map with the drift of now, and the state.
        """
        in_swing = (state.time >= 0.0) & (time - state.time <= LEAST_APART)
        before = np.where(in_swing[self._foot_of_channel], state.reading, np.inf)
        for foot, channels, reading, seconds in self._hanging(block, lost, before, state.reading):
            belief, published, state = self._tare(
                foot, channels, reading, seconds, time, belief, published, state
            )
        return belief, published, state

    def repeat(self, belief: Belief, state: TareState) -> tuple[Belief, TareState]:
        """Tare the feet once more as they read last, with a belief that knows nothing yet.

        Args:
            belief: The modes' posteriors, with scales of 1.
            state: Results of tares before.
        """
        at = np.flatnonzero(state.time[self._foot_of_channel] >= 0.0)
        reading, centre = state.reading[at], state.centre.copy()
        centre[at] = reading
        belief = self._learn(belief, at, reading, np.ones(len(at)), reading, self.variance[at] / self._block)
        return belief, state._replace(centre=centre)

    def rows(self, block: Block, known: Array) -> tuple[Array, Array]:
        """Write the rows of the feet that hang in a block.

        Args:
            block: The samples.
            known: True scales, offsets and drift, shape (M,).

        Returns:
            Rows, shape (m, N), and their variance, shape (m, m).
        """
        columns = self._columns
        a, b = known[columns.scale], known[columns.offset]
        found, variance = [np.zeros((0, columns.size))], [np.zeros(0)]
        for _, at, _, seconds in self._hanging(block, np.zeros(len(a)), np.full(len(a), np.inf), -b / a):
            found.append(self._write(at, -b[at] / a[at], a[at]))
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

    def _write(self, channels: NDArray[np.int64], centre: Array, a: Array) -> Array:
        """Return the rows a centre + b + a u of some channels, shape (m, N)."""
        columns, rows = self._columns, np.arange(len(channels))
        H = np.zeros((len(channels), columns.size))
        H[rows, channels + columns.scale.start] = centre
        H[rows, channels + columns.offset.start] = 1.0
        H[rows, channels + columns.drift.start] = a
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

    def _tare(
        self,
        foot: int,
        channels: NDArray[np.int64],
        reading: Array,
        seconds: float,
        time: float,
        belief: Belief,
        published: Array,
        state: TareState,
    ) -> tuple[Belief, Array, TareState]:
        columns = self._columns
        at = channels
        scale, drift = at + columns.scale.start, at + columns.drift.start
        a, last = published[scale], float(state.time[foot])
        noise = self.variance[channels] / seconds
        centre = reading + published[drift] if last < 0.0 else state.centre[channels]

        walked = noise * 2.0
        leapt = np.zeros(len(at), dtype=bool)
        rate, followed = state.rate, state.followed
        change = reading - state.reading[channels]
        if last >= 0.0:
            walked = walked + rate**2 * self._drift[channels] * (time - last)
            leapt = change**2 > LEAP**2 * walked
            if time - last > LEAST_APART:
                rate, followed = self._follow(rate, followed, change, walked), followed + 1
        if leapt.any():
            covariance = belief.covariance.copy()
            covariance[:, drift[leapt], drift[leapt]] += change[leapt] ** 2
            belief = belief._replace(covariance=covariance)
        belief = self._learn(belief, at, centre, a, reading, noise)
        published = published.copy()
        published[drift] = centre - reading
        shown, centres, times = state.reading.copy(), state.centre.copy(), state.time.copy()
        shown[channels], centres[channels], times[foot] = reading, centre, time
        return belief, published, TareState(shown, centres, times, rate, followed)

    def _learn(
        self,
        belief: Belief,
        channels: NDArray[np.int64],
        centre: Array,
        a: Array,
        reading: Array,
        noise: Array,
    ) -> Belief:
        """Let all modes know what channels read of no load; ``noise`` is the readings' variance."""
        H, variance = self._write(channels, centre, a), np.diag(a**2 * noise)
        asked = a * (centre - reading)
        found = [
            update(mean, covariance, H, asked - H @ mean, variance, self._columns.mass)
            for mean, covariance in zip(belief.mean, belief.covariance, strict=True)
        ]
        means, covariances = (np.stack(part) for part in zip(*found, strict=True))
        return belief._replace(mean=means, covariance=covariances)

    def _follow(self, rate: float, followed: int, change: Array, expected: Array) -> float:
        """Return by how many times sensors drift faster than stated, by changes since the last tare.

        A change that a foot's channels share is not drift alone: a sole's own inertia is in it.
        """
        count = len(change)
        own = (change - change.mean()) ** 2 * count / max(count - 1, 1)
        surprise = float(np.minimum(own / expected, LARGEST_SURPRISE).mean())
        share = max(RATE_SHARE, 1.0 / (followed + STATED_RATE))
        return float(np.clip(rate * np.sqrt(1.0 + share * (surprise - 1.0)), SMALLEST_RATE, LARGEST_RATE))
