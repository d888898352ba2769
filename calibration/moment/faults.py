"""Faults of single channels: their signs and their repair.

Four things give a channel away:

* **It leaps.** A force that differs from the last one by more than a foot can cause is held for a few
  samples. Cells of a foot that is not surely on the ground may change far more, as it may land on a corner.
  Nothing is held while several channels leap within seconds, as those of a robot that bounces do.
* **It is silent**: no reading arrives, or always the same one while the foot's other channels move.
* **It bears nothing**: it moves by less than a tenth of what the other cells of its plate say that it bears,
  and the robot's motion misses that load. So is a cell found that is dead from the start: scales of the
  others would make up for it.
* **The robot's motion contradicts it**: see :mod:`surefoot.calibration.moment.suspects`.

A channel that is out is reconstructed (:mod:`surefoot.calibration.moment.stand_in`); flipped and swapped ones
are put right. The last seconds' learning is dropped then, because it came from wrong
readings. A channel that agrees with its reconstruction again comes back.
"""

from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.estimate import Flag
from surefoot.calibration.front_end.readings import MOVING
from surefoot.calibration.moment.stand_in import StandIn
from surefoot.calibration.setup import OnlineSetup

LONGEST_LEAP = 3  # samples in a row that a reading may be away before it is believed

USABLE_SCALES = 0.3, 3.0
"""Least and greatest scale by which leaps and loads are converted, in case the estimate is wrong."""

_BACK = 0.25
"""Share of the least leap within which a reading that comes back is where it was: what loads change by in two
or three samples. One that stays away was a load's."""

_ALONE = 4.0
"""How many times further than any other cell of its foot a reading must leap to be an error."""

_SPIKE = 0.02
"""Load in body weights that a reading is away by from both of its neighbours in time to be an error."""

_BUMPY = 1.5
"""Leaps of other channels of late from which on leaps are blows: a robot that bounces, and no faulty cell."""

_BUMP_MEMORY = 0.993
"""Share of the count of leaps that a sample keeps: it is that of some 140 samples."""

_ONCE = 0.5  # recent count of leaps above which there was one

_MOSTLY_MISSING, _ALL_READ = 0.5, 0.99
"""Share of a block's readings below which a channel is silent, and above which it is fully there."""

_IDLE = 0.1
"""Share of its plate's changes that a cell that bears load shows at least: one that shows less would need a
scale beyond ten. Sound cells with three times the errors of cheap ones show 0.12 and more, others 0.34."""

_PLATE_MOVED = 0.2
"""Changes of a cell's load from block to block, by the others of its plate, from which on it must have shown
them: their squares in body weights, summed up. Those of some ten steps: after three a sound cell of a G1 had
shown 0.05."""

_LARGEST_CHANGE = 0.15
"""Change of a cell's load between blocks in body weights of which more counts no more, so that ten blocks
at least speak: a robot that falls strikes the ground for fewer."""

_MISSED = 0.5
"""Share of the load that its plate says from which on the robot's motion misses a cell's rather than not."""

_NO_LOAD = 0.1
"""Load of a cell in body weights up to which a reading that does not change is one of no load at all."""

_HEAVIEST = 2.0
"""Load of a cell in body weights beyond which a reading that does not change is at the end of its range."""

_RETURN_BLOCKS = 15
"""Blocks that a channel must agree with its reconstruction for, while its load changes, to come back."""

_AGREE, _AGREE_SHARE = 0.03, 0.2
"""Error of a reconstruction that counts as agreeing: in body weights, and besides as a share of the load.
A load that changes by less than the first shows nothing."""


class ChannelState(NamedTuple):
    """Knowledge of the channels' faults."""

    last: Array  # last readings that were believed, F0 in N, shape (K,)
    leaps: Array
    """Samples in a row that were held for leaping, shape (K,); more than are held where the last one was not
    read."""
    leapt: Array  # how often each channel leapt of late, shape (K,)
    moments: Array  # how cells share loads, shape (K, K)
    lost: Array  # channels that are out (0 or 1), shape (K,)
    kind: Array  # flags of each channel's faults, shape (K,)
    wiring: Array  # signed permutation that puts exchanged and turned channels right, shape (K, K)
    spare: Array  # how forces are made of the channels that are not out, shape (K, K)
    spare_std: Array  # standard deviation of a reconstructed force in N, 0 for others, shape (K,)
    agreed: Array  # blocks that a lost channel has agreed for, shape (K,)
    level: Array  # mean of F0 of the last block in body weights, shape (K,)
    shown: Array
    """Squared changes of that mean since it was last held against its plate, summed up, shape (K,); -1 before
    the first block."""
    expected: Array  # those by the other cells of its plate, shape (K,)
    missed: Array
    """Momentum that the starting map leaves unexplained, times that of the load that its plate says, summed
    up, shape (K,)."""
    offered: Array  # the square of the latter, summed up, shape (K,)
    alive: Array  # whether it has ever moved with its plate (0 or 1), shape (K,)
    altered: int  # whether any channel is or was out, turned or exchanged, 0 or 1


class ChannelFaults:
    """Finds faults for one setup.

    Args:
        setup: The robot.
        leap: Change of a force in one sample in body weights that no foot makes.
        leap_alone: The same of one cell of a foot that stands.
        memory: Blocks that shares of load are remembered for.

    Attributes:
        stand_in: How cells share loads.
        by_others: How each channel follows from the others by the plate alone, shape (K, K).
        leap: Change of a force in one sample in N that no foot makes.
        leap_alone: The same of a foot that stands in N, shape (K,).
    """

    def __init__(self, setup: OnlineSetup, leap: float, leap_alone: float, memory: float) -> None:
        self.stand_in = StandIn(setup, memory)
        self.leap = leap * setup.weight
        self._weight = setup.weight
        self._foot_of_channel = foot = setup.layout.foot_of_channel
        self._plates = self.stand_in.together - np.eye(setup.layout.channels)
        self.by_others = self.stand_in.others(self.stand_in.init(), np.zeros(setup.layout.channels))[0]
        self._same_foot = (foot[:, None] == foot) - np.eye(setup.layout.channels)
        # A foot of one cell has none that could tell its landing from an error.
        self.leap_alone = np.where(self._same_foot.any(axis=1), leap_alone, leap) * setup.weight

    def init(self, resting: Array) -> ChannelState:
        """Return the state of sound channels, of which F0 is ``resting``; see :class:`ChannelState`."""
        K = len(resting)
        zero = np.zeros(K)
        return ChannelState(
            last=resting,
            leaps=np.full(K, LONGEST_LEAP + 1, dtype=np.int64),
            leapt=zero,
            moments=self.stand_in.init(),
            lost=zero,
            kind=np.zeros(K, dtype=np.int64),
            wiring=np.eye(K),
            spare=np.eye(K),
            spare_std=zero,
            agreed=zero,
            level=zero,
            shown=zero - 1.0,
            expected=zero,
            missed=zero,
            offered=zero,
            alive=zero,
            altered=0,
        )

    def sample(
        self, state: ChannelState, force: Array, read: Array, scale: Array, stance: Array
    ) -> tuple[ChannelState, Array, Array, Array]:
        """Put channels right and hold leaps, sample by sample.

        Args:
            state: Faults so far.
            force: Forces by the starting map in N, shape (K,).
            read: Whether they were read just now (bool), shape (K,).
            scale: Newtons per newton by the starting map, as published, shape (K,).
            stance: Whether each foot stands by the robot's plan (bool), shape (F,).

        Returns:
            The state; forces to use; whether each may be learnt from (bool); and flags of each channel.
        """
        if state.altered:
            force, read = state.wiring @ force, np.abs(state.wiring) @ read > 0.5
        step = np.abs(force - state.last) * np.clip(np.abs(scale), *USABLE_SCALES)
        most = np.where(stance[self._foot_of_channel], self.leap_alone, self.leap)
        state = state._replace(leapt=_BUMP_MEMORY * state.leapt)
        leaping = step > most
        was_away = (state.leaps > 0) & (state.leaps <= LONGEST_LEAP)
        kind = state.kind | int(Flag.SPIKE) * (was_away & read & (step < _BACK * most))
        if not leaping.any():
            leaps = np.where(read, 0, LONGEST_LEAP + 1)
            return state._replace(last=force, leaps=leaps), force, read, kind
        # A foot that lands moves several of its cells.
        others = (step * self._same_foot).max(axis=1)
        leaping = leaping & read & (step > _ALONE * others)
        leaping = leaping & (state.leaps < LONGEST_LEAP)
        leapt = state.leapt + (leaping & (state.leaps == 0))
        leaping = leaping & (state.leapt.sum() - state.leapt < _BUMPY)
        leaps = np.where(leaping, state.leaps + 1, np.where(read, 0, LONGEST_LEAP + 1))
        used = np.where(leaping, state.last, force)
        flags = kind | int(Flag.OUT_OF_RANGE) * leaping
        state = state._replace(last=used, leaps=leaps, leapt=leapt)
        return state, used, read & ~leaping, flags

    def smooth(self, before: Array, row: Array, after: Array, weight: float) -> Array:
        """Put readings that were wrong for one sample between their neighbours.

        A plate shares its load among its cells: no load comes and goes in one of them alone.

        Args:
            before: F0 and whether it was read (0 or 1) of the sample before, shape (2K,).
            row: The same of the sample.
            after: Of the sample after it.
            weight: The robot's weight in the unit of F0.
        """
        K = len(self._plates)
        past, now, coming = before[:K], row[:K], after[:K]
        away = np.abs(now - np.clip(now, np.minimum(past, coming), np.maximum(past, coming)))
        spike = (away > _SPIKE * weight) & (away > _ALONE * (self._plates * away).max(axis=1))
        spike &= (self._plates.sum(axis=1) > 0.5) & (row[K:] > 0.5)
        if not spike.any():
            return row
        return np.concatenate([np.where(spike, 0.5 * (past + coming), now), row[K:]])

    def silent(self, state: ChannelState, force: Array, read: Array) -> tuple[ChannelState, bool]:
        """Find channels that are silent, always read the same, or bear nothing of their plate's load.

        Args:
            state: Faults so far.
            force: Forces by the starting map of the samples that wait in N, shape (n, K).
            read: Whether they were read (0 or 1), shape (n, K).

        Returns:
            The state, and whether one is found that was dead from the start.
        """
        high, spread = force.max(axis=0), np.ptp(force, axis=0)
        flat = spread == 0.0
        moving = (spread > MOVING * self._weight) @ self._same_foot > 0.5
        share = read.mean(axis=0)
        # A reading that was held for leaping is none that is missing.
        missing = (share < _MOSTLY_MISSING) & (share.max() >= _MOSTLY_MISSING) & (state.leapt < _ONCE)
        was_missing = (state.kind & int(Flag.MISSING)) > 0
        state = self._return(state, (share > _ALL_READ) & ~flat & was_missing & (state.lost > 0.5))

        stuck = flat & moving & (share > _ALL_READ)
        kind = np.where(np.abs(high) > _HEAVIEST * self._weight, int(Flag.SATURATED), int(Flag.STUCK))
        kind = np.where(np.abs(high) <= _NO_LOAD * self._weight, int(Flag.DEAD), kind)
        kind = np.where(stuck, kind, 0) | int(Flag.MISSING) * missing
        state, idle = self._compare_with_plate(state, force.mean(axis=0) / self._weight)
        kind = np.where(idle & (kind == 0), int(Flag.DEAD), kind)
        fresh = (stuck | missing | idle) & (state.lost < 0.5) & self.stand_in.cells
        return self._lose(state, fresh, kind), bool((idle & (state.alive < 0.5)).any())

    def _compare_with_plate(self, state: ChannelState, level: Array) -> tuple[ChannelState, Array]:
        """Find cells that do not change while all others of their plate say so, by the mean of a block."""
        whole = self.stand_in.count_lost(state.lost) < 0.5
        change = np.where(state.shown < 0.0, 0.0, level - state.level)
        size = np.abs(change)
        alone = size > _ALONE * (self._plates * size).max(axis=1)  # no plate's load
        change = np.where(self.stand_in.together @ alone > 0.5, 0.0, change)
        told = np.clip(self.by_others @ change, -_LARGEST_CHANGE, _LARGEST_CHANGE)
        change = np.clip(change, -_LARGEST_CHANGE, _LARGEST_CHANGE)
        shown = whole * (np.maximum(state.shown, 0.0) + change**2)
        expected = whole * (state.expected + told**2)
        enough = expected > _PLATE_MOVED
        idle = enough & (shown < _IDLE**2 * expected)
        # On an edge of its plate a sound cell bears nothing as well: then nothing is missed.
        idle &= state.missed > _MISSED * state.offered
        # Of two on a plate nobody knows: a third one that shows too much looks like them.
        idle &= self.stand_in.together @ idle < 1.5
        alive = np.maximum(state.alive, enough & (shown >= _IDLE**2 * expected))
        if (idle & (alive < 0.5)).any():
            # Shares were learnt with it.
            state = state._replace(moments=self.stand_in.init())
        summed = {"shown": shown, "expected": expected}
        summed |= {"missed": whole * state.missed, "offered": whole * state.offered}
        again = {name: ~enough * one for name, one in summed.items()}
        return state._replace(level=level, alive=alive, **again), idle

    def miss(self, state: ChannelState, error: Array, by_plate: Array) -> ChannelState:
        """Note the momentum that the starting map, tared, leaves unexplained in a block.

        Args:
            state: Faults so far.
            error: That momentum, shape (C,).
            by_plate: The momentum by each channel if it bore what its plate says instead, shape (C, K).
        """
        return state._replace(
            missed=state.missed + error @ by_plate, offered=state.offered + (by_plate**2).sum(axis=0)
        )

    def restart(self, state: ChannelState) -> ChannelState:
        """Begin again to hold cells against their plates: readings mean something else from now on."""
        zero = np.zeros_like(state.shown)
        return state._replace(shown=zero - 1.0, expected=zero, missed=zero, offered=zero)

    def lose(self, state: ChannelState, channel: int) -> ChannelState:
        """Take a channel out that is dead."""
        out = np.arange(len(state.lost)) == channel
        return self._lose(state, out, int(Flag.DEAD) * out)

    def rewire(self, state: ChannelState, turned: Array, kind: Array) -> ChannelState:
        """Put channels right by a signed permutation, and turn flags of them, shapes (K, K) and (K,)."""
        return state._replace(wiring=turned @ state.wiring, kind=state.kind ^ kind, altered=1)

    def learn(self, state: ChannelState, force: Array, good: bool) -> ChannelState:
        """Learn how cells share loads while nothing is wrong, and let channels come back.

        Args:
            state: Faults so far.
            force: Calibrated forces of a block by the channels' own readings in N, shape (n, K).
            good: Whether the block could be learnt from.
        """
        if good and (state.lost < 0.5).all():
            state = state._replace(moments=self.stand_in.learn(state.moments, force))
        if not state.altered:
            return state
        expected = force @ state.spare.T
        error, load = np.abs(expected - force).max(axis=0), np.abs(expected).max(axis=0)
        moved = np.ptp(expected, axis=0) > _AGREE * self._weight
        near = error < _AGREE * self._weight + _AGREE_SHARE * load
        agreed = np.where(near, state.agreed + moved, 0.0) * state.lost
        back = (agreed >= _RETURN_BLOCKS) & (state.lost > 0.5)
        return self._return(state._replace(agreed=np.where(back, 0.0, agreed)), back)

    def _return(self, state: ChannelState, back: Array) -> ChannelState:
        """Take channels in again."""
        if not back.any():
            return state
        gone = int(Flag.LOST | Flag.DEAD | Flag.STUCK | Flag.SATURATED | Flag.MISSING)
        kind = np.where(back, state.kind & ~gone, state.kind)
        return self._rebuild(state._replace(lost=np.where(back, 0.0, state.lost), kind=kind))

    def _lose(self, state: ChannelState, fresh: Array, kind: Array) -> ChannelState:
        """Take channels out."""
        if not fresh.any():
            return state
        lost = np.where(fresh, 1.0, state.lost)
        kind = state.kind | np.where(fresh, kind | int(Flag.LOST), 0)
        return self._rebuild(state._replace(lost=lost, kind=kind))

    def _rebuild(self, state: ChannelState) -> ChannelState:
        """Work out how to do without lost channels."""
        coefficients, spread = self.stand_in.others(state.moments, state.lost)
        spare = np.diag(1.0 - state.lost) + coefficients * state.lost[:, None]
        return state._replace(spare=spare, spare_std=spread * state.lost, altered=1)
