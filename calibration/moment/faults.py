"""Detection and repair of faults of single channels.

A fault shows in one of four ways:

* **The channel jumps.** If the force changes by more than a foot can cause, the last one is held for a few
  samples. The limit is much higher for cells of a foot that may be landing, possibly on a corner. Nothing is
  held while several channels jump within seconds, as on a robot that bounces.
* **The channel is silent.** Readings are missing, or constant while the foot's other channels change.
* **The channel is idle.** It changes by less than a tenth of the load that the other cells of its plate
  predict, and the robot's motion needs that load. This also finds a cell that is dead from the start, which
  the scales of the others would compensate.
* **The robot's motion contradicts the channel**: see :mod:`surefoot.calibration.moment.suspects`.

A lost channel is reconstructed (:mod:`surefoot.calibration.moment.stand_in`). Flipped and swapped channels
are corrected. The learning of the last seconds is undone, because it used wrong readings. A lost channel is
used again once it agrees with its reconstruction.
"""

from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.estimate import Flag
from surefoot.calibration.front_end.readings import MOVING
from surefoot.calibration.moment.stand_in import StandIn
from surefoot.calibration.setup import OnlineSetup

LONGEST_LEAP = 3  # largest number of consecutive samples that are held. A longer jump is a load

USABLE_SCALES = 0.3, 3.0
"""Bounds of the scale that converts jumps and loads to newtons, in case the estimated scale is wrong."""

_BACK = 0.25
"""Share of the threshold of a jump within which a reading has returned to its former value. Loads change by
this much in two or three samples. A reading that does not return shows a load."""

_ALONE = 4.0
"""Minimum ratio of the jump of an erroneous reading to that of any other cell of its foot."""

_SPIKE = 0.02
"""Minimum distance in body weights of a spike from both of its neighbours in time."""

_BUMPY = 1.5
"""Recent number of jumps of other channels above which a jump is an impact of a bouncing robot."""

_BUMP_MEMORY = 0.993
"""Decay per sample of the recent number of jumps, which covers about 140 samples."""

_ONCE = 0.5  # minimum recent number of jumps of a channel that has jumped

_MOSTLY_MISSING, _ALL_READ = 0.5, 0.99
"""Minimum share of a block's readings of a channel that is not silent, and of one that is complete."""

_IDLE = 0.1
"""Minimum change of a loaded cell as a share of the change that its plate predicts. A smaller one would need
a scale above ten. Sound cells with three times the errors of cheap ones show at least 0.12, others 0.34."""

_PLATE_MOVED = 0.2
"""Minimum evidence for an idle cell: the sum over blocks of squared changes in body weights that the other
cells of its plate predict. About ten steps reach it. After three, a sound cell of a G1 had reached 0.05."""

_LARGEST_CHANGE = 0.15
"""Largest change of a cell's load between blocks in body weights that counts, so that at least ten blocks are
needed. The impacts of a fall last fewer."""

_MISSED = 0.5
"""Fraction of the predicted load above which the motion is inconsistent with an idle cell."""

_NO_LOAD = 0.1
"""Largest load of a cell in body weights at which a constant reading counts as unloaded."""

_HEAVIEST = 2.0
"""Load of a cell in body weights above which a constant reading is at the end of its range."""

_RETURN_BLOCKS = 15
"""Number of blocks with a changing load in which a lost channel must agree with its reconstruction."""

_AGREE, _AGREE_SHARE = 0.03, 0.2
"""Largest error of a reconstruction that agrees: the sum of a constant in body weights and a share of the
load. Changes of the load below the constant are not informative."""


class ChannelState(NamedTuple):
    """Knowledge of the channels' faults."""

    last: Array  # last readings that were believed, F0 in N, shape (K,)
    leaps: Array
    """Number of consecutive samples held as jumps, shape (K,), or more than the maximum after a missing
    reading."""
    leapt: Array  # recent number of jumps of each channel, shape (K,)
    moments: Array  # how cells share loads, shape (K, K)
    lost: Array  # channels that are out (0 or 1), shape (K,)
    kind: Array  # flags of each channel's faults, shape (K,)
    wiring: Array  # signed permutation that corrects swapped and flipped channels, shape (K, K)
    spare: Array  # matrix of forces from the channels that are not lost, shape (K, K)
    spare_std: Array  # standard deviation of a reconstructed force in N, 0 for others, shape (K,)
    agreed: Array  # blocks that a lost channel has agreed for, shape (K,)
    level: Array  # mean of F0 of the last block in body weights, shape (K,)
    shown: Array
    """Sum of squared changes of that mean since the last comparison with its plate, shape (K,), -1 before the
    first block."""
    expected: Array  # the sum that the other cells of its plate predict, shape (K,)
    missed: Array
    """Sum of products of the momentum that the starting map leaves unexplained and that of the load that the
    plate predicts, shape (K,)."""
    offered: Array  # sum of squares of the latter, shape (K,)
    alive: Array  # whether it has ever moved with its plate (0 or 1), shape (K,)
    altered: int  # whether any channel is or was out, turned or exchanged, 0 or 1


class ChannelFaults:
    """Finds faults for one setup.

    Args:
        setup: The robot.
        leap: Change of a force in one sample in body weights that no foot makes.
        leap_alone: The same for one cell of a foot in stance.
        memory: Blocks that shares of load are remembered for.

    Attributes:
        stand_in: How cells share loads.
        by_others: How each channel follows from the others by the plate alone, shape (K, K).
        leap: Change of a force in one sample in N that no foot makes.
        leap_alone: The same for a foot in stance in N, shape (K,).
    """

    def __init__(self, setup: OnlineSetup, leap: float, leap_alone: float, memory: float) -> None:
        self.stand_in = StandIn(setup, memory)
        self.leap = leap * setup.weight
        self._weight = setup.weight
        self._foot_of_channel = foot = setup.layout.foot_of_channel
        self._plates = self.stand_in.together - np.eye(setup.layout.channels)
        self.by_others = self.stand_in.others(self.stand_in.init(), np.zeros(setup.layout.channels))[0]
        self._same_foot = (foot[:, None] == foot) - np.eye(setup.layout.channels)
        # With a single cell, a landing cannot be distinguished from an error.
        self.leap_alone = np.where(self._same_foot.any(axis=1), leap_alone, leap) * setup.weight

    def init(self, resting: Array) -> ChannelState:
        """Return the :class:`ChannelState` of sound channels with the forces ``resting`` (F0)."""
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
        """Correct channels and hold jumps, sample by sample.

        Args:
            state: Faults so far.
            force: Forces by the starting map in N, shape (K,).
            read: Whether they were read just now (bool), shape (K,).
            scale: Newtons per newton by the starting map, as published, shape (K,).
            stance: Whether each foot stands by the robot's plan (bool), shape (F,).

        Returns:
            The state, the forces to use, whether each may be learnt from (bool), and flags of each channel.
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
        """Replace readings that were wrong for one sample by the mean of their neighbours.

        A plate distributes its load over its cells, so that a real load never appears in a single cell.

        Args:
            before: F0 and whether it was read (0 or 1) of the sample before, shape (2K,).
            row: The same of the sample.
            after: The same of the sample after it.
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
        """Find channels that are silent, constant or idle.

        Args:
            state: Faults so far.
            force: Forces by the starting map of the samples that wait in N, shape (n, K).
            read: Whether they were read (0 or 1), shape (n, K).

        Returns:
            The state, and whether a channel was found that has been dead from the start.
        """
        high, spread = force.max(axis=0), np.ptp(force, axis=0)
        flat = spread == 0.0
        moving = (spread > MOVING * self._weight) @ self._same_foot > 0.5
        share = read.mean(axis=0)
        # Readings held as jumps do not count as missing.
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
        """Find cells whose block mean does not change as all other cells of their plate predict."""
        whole = self.stand_in.count_lost(state.lost) < 0.5
        change = np.where(state.shown < 0.0, 0.0, level - state.level)
        size = np.abs(change)
        alone = size > _ALONE * (self._plates * size).max(axis=1)  # not a load of a plate
        change = np.where(self.stand_in.together @ alone > 0.5, 0.0, change)
        told = np.clip(self.by_others @ change, -_LARGEST_CHANGE, _LARGEST_CHANGE)
        change = np.clip(change, -_LARGEST_CHANGE, _LARGEST_CHANGE)
        shown = whole * (np.maximum(state.shown, 0.0) + change**2)
        expected = whole * (state.expected + told**2)
        enough = expected > _PLATE_MOVED
        idle = enough & (shown < _IDLE**2 * expected)
        # If the load is on an edge of the plate, a sound cell is idle too, but the motion needs no load.
        idle &= state.missed > _MISSED * state.offered
        # Two idle cells on one plate are ambiguous: a third cell that reads too much has the same effect.
        idle &= self.stand_in.together @ idle < 1.5
        alive = np.maximum(state.alive, enough & (shown >= _IDLE**2 * expected))
        if (idle & (alive < 0.5)).any():
            # The learnt shares include the dead cell.
            state = state._replace(moments=self.stand_in.init())
        summed = {"shown": shown, "expected": expected}
        summed |= {"missed": whole * state.missed, "offered": whole * state.offered}
        again = {name: ~enough * one for name, one in summed.items()}
        return state._replace(level=level, alive=alive, **again), idle

    def miss(self, state: ChannelState, error: Array, by_plate: Array) -> ChannelState:
        """Add the momentum of a block that the tared starting map leaves unexplained.

        Args:
            state: Faults so far.
            error: That momentum, shape (C,).
            by_plate: Its change if a channel carries the load that its plate predicts, shape (C, K).
        """
        return state._replace(
            missed=state.missed + error @ by_plate, offered=state.offered + (by_plate**2).sum(axis=0)
        )

    def restart(self, state: ChannelState) -> ChannelState:
        """Restart the comparison of cells with their plates after the meaning of readings has changed."""
        zero = np.zeros_like(state.shown)
        return state._replace(shown=zero - 1.0, expected=zero, missed=zero, offered=zero)

    def lose(self, state: ChannelState, channel: int) -> ChannelState:
        """Mark a dead channel as lost."""
        out = np.arange(len(state.lost)) == channel
        return self._lose(state, out, int(Flag.DEAD) * out)

    def rewire(self, state: ChannelState, turned: Array, kind: Array) -> ChannelState:
        """Correct channels by a signed permutation, shape (K, K), and toggle flags, shape (K,)."""
        return state._replace(wiring=turned @ state.wiring, kind=state.kind ^ kind, altered=1)

    def learn(self, state: ChannelState, force: Array, good: bool) -> ChannelState:
        """Learn how cells share loads while all are sound, and restore channels that agree again.

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
        """Restore lost channels."""
        if not back.any():
            return state
        gone = int(Flag.LOST | Flag.DEAD | Flag.STUCK | Flag.SATURATED | Flag.MISSING)
        kind = np.where(back, state.kind & ~gone, state.kind)
        return self._rebuild(state._replace(lost=np.where(back, 0.0, state.lost), kind=kind))

    def _lose(self, state: ChannelState, fresh: Array, kind: Array) -> ChannelState:
        """Mark channels as lost."""
        if not fresh.any():
            return state
        lost = np.where(fresh, 1.0, state.lost)
        kind = state.kind | np.where(fresh, kind | int(Flag.LOST), 0)
        return self._rebuild(state._replace(lost=lost, kind=kind))

    def _rebuild(self, state: ChannelState) -> ChannelState:
        """Compute the reconstruction of lost channels."""
        coefficients, spread = self.stand_in.others(state.moments, state.lost)
        spare = np.diag(1.0 - state.lost) + coefficients * state.lost[:, None]
        return state._replace(spare=spare, spare_std=spread * state.lost, altered=1)
