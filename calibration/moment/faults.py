"""Faults of single channels: what gives them away, and what is done about them; private.

Three things give a channel away:

* **It leaps.** A reading that is away from the last by more than a foot can is held, for a few samples.
* **It is silent**: no reading arrives, or always the same one while the foot's other channels move.
* **The robot's motion contradicts it.** Newton and Euler about the whole robot leave residuals e. Each
  hypothesis changes the forces, and so the residuals: a channel's force is what the others of its foot say
  (it is out), it is the other way round (flipped), or two are exchanged (swapped). One that explains what is
  otherwise unexplained, and much better than any about other channels, is accepted.

The robot may also have been given a load, which no channel is to blame for
(:mod:`surefoot.calibration.moment.load_rival`). What it leaves is held against what the hypotheses about
channels
leave. While a robot stands quite still, a load and a broken cell look alike, and neither is accepted.
Otherwise the one that explains it alone is.

A channel that is out is reconstructed (:mod:`surefoot.calibration.moment.stand_in`); flipped and swapped ones
are
put right, as if the cable were plugged in again. What was learnt in the last seconds is forgotten then,
because it was learnt from wrong readings. A channel that agrees with its reconstruction again comes back.
"""

from typing import Any, NamedTuple

import numpy as np
from array_api_compat import device as device_of
from numpy.typing import NDArray

from surefoot.calibration._constants import Constants, anywhere, namespace_of
from surefoot.calibration._setup import OnlineSetup
from surefoot.calibration.estimate import Flag
from surefoot.calibration.moment.load_rival import LoadRival
from surefoot.calibration.moment.rows import Misfit
from surefoot.calibration.moment.stand_in import StandIn

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""

LONGEST_LEAP = 3
"""Samples in a row that a reading may be away before it is believed."""

_ALONE = 4.0
"""How many times further than any other cell of its foot a reading must leap to be an error."""

_SUSPICION = 4.0
"""Mean squared normalised residual of a block above which something is thought to be wrong."""

TRUST = 10.0
"""Blocks in which all must have seemed well before the robot's motion can speak against a channel."""

_WAIT = 6.0
"""Blocks that learning waits for while channels are under suspicion."""

_PATIENCE = 10
"""Blocks after which a suspicion that nothing explains is dropped."""

_RELIEF = 0.4
"""Share of it that may be left by a hypothesis that is accepted."""

_CONTRAST = 0.6
"""The same against the best hypothesis about other channels, and against a load."""

_LOAD_CONTRAST = 0.4
"""The same of a load against the best hypothesis about any channel."""

_NOISE = 1.0
"""Mean square that noise leaves: added before a load is compared, as what explains all is not told apart."""

_LOAD_BLOCKS = 3.0
"""Blocks after which a load is believed: while it is put on it is none that stays the same."""

_LEAST_ERROR = 0.1
"""Error of a force in body weights that a fault amounts to at least, for the motion to tell of it."""

_HEAVIEST = 2.0
"""Load of a cell in body weights beyond which a reading that does not change is at the end of its range."""

_RETURN_BLOCKS = 15
"""Blocks that a channel must agree with its reconstruction for, while its load changes, to come back."""


class FaultState(NamedTuple):
    """What is known of faults; any leading batch dimensions ``...``; H hypotheses.

    Attributes:
        last: Last readings that were believed, F0 in N, shape (..., K).
        leaps: Samples in a row that were held for leaping, shape (..., K).
        trust: Blocks in which nothing seemed wrong, shape (...).
        doubt: Blocks since something seemed wrong, 0 while nothing does, shape (...).
        scores: Mean squared residuals of these blocks without a fault, by each hypothesis, and with a load,
            shape (..., 1 + H + 1).
        size: Largest error of a force in N over these blocks, by each hypothesis, shape (..., H).
        load: Normal equations of a load over these blocks, the right-hand side last, shape (..., 3, 4).
        moments: How cells share loads, shape (..., K, K).
        lost: Channels that are out (0 or 1), shape (..., K).
        kind: Flags of what is wrong with each channel, shape (..., K).
        wiring: Signed permutation that puts exchanged and turned channels right, shape (..., K, K).
        spare: How forces are made of the channels that are heard, shape (..., K, K).
        spare_std: Standard deviation of a reconstructed force in N, 0 for others, shape (..., K).
        agreed: Blocks that a lost channel has agreed for, shape (..., K).
        altered: Whether any channel of the batch is out, turned or exchanged, 0 or 1.
    """

    last: Array
    leaps: Array
    trust: Array
    doubt: Array
    scores: Array
    size: Array
    load: Array
    moments: Array
    lost: Array
    kind: Array
    wiring: Array
    spare: Array
    spare_std: Array
    agreed: Array
    altered: int


class Faults:
    """Finds faults for one setup.

    Args:
        setup: What the method was told about the robot.
        leap: Change of a reading in one sample in body weights that no foot makes.
        change: Standard deviations of what a load changes, (centre of mass in foot lengths (2), mass), shape
            (3,).
        memory: Blocks that shares of load are remembered for.
    """

    def __init__(self, setup: OnlineSetup, leap: float, change: NDArray[np.float64], memory: float) -> None:
        K = setup.layout.channels
        self.stand_in = StandIn(setup, memory)
        self._rival = LoadRival(change)
        self._leap, self._weight, self._channels = leap * setup.weight, setup.weight, K
        cells = np.nonzero(self.stand_in.cells)[0]
        pairs = [(i, j) for i in cells for j in cells if i < j]
        self._first = np.array([i for i, _ in pairs], dtype=np.intp)
        self._second = np.array([j for _, j in pairs], dtype=np.intp)
        # Which channels each hypothesis is about: out (K), flipped (K), swapped (pairs), and swapped between
        # bridges that are wired the other way round (pairs).
        pair = np.zeros((len(pairs), K), dtype=bool)
        for row, both in zip(pair, pairs, strict=True):
            row[list(both)] = True
        about = np.concatenate([np.eye(K, dtype=bool), np.eye(K, dtype=bool), pair, pair])
        possible = np.concatenate([np.tile(self.stand_in.cells, 2), np.ones(2 * len(pairs), dtype=bool)])
        same_foot = setup.layout.foot_of_channel[:, None] == setup.layout.foot_of_channel[None, :]
        self._hypotheses = len(about)
        self._constants = Constants(
            possible.astype(float),
            (about.astype(float) @ about.T > 0.5).astype(float),
            np.eye(K),
            about.astype(float),
            same_foot.astype(float) - np.eye(K),
            self.stand_in.cells.astype(float),
            # Putting a channel right is preferred to losing it.
            np.where(np.arange(len(about)) < K, 1.15, 1.0),
            np.arange(len(about)),
        )

    def init(self, raw: Array, resting: Array) -> FaultState:
        """Begin with sound channels; see :class:`FaultState`."""
        xp, device = namespace_of(raw), device_of(raw)
        zero = xp.zeros_like(raw)
        identity = self._constants.like(raw)[2] + 0.0 * zero[..., None]
        return FaultState(
            last=resting + zero,
            leaps=xp.zeros(raw.shape, dtype=xp.int64, device=device) + LONGEST_LEAP,
            trust=xp.zeros(raw.shape[:-1], dtype=raw.dtype, device=device),
            doubt=xp.zeros(raw.shape[:-1], dtype=raw.dtype, device=device),
            scores=xp.zeros((*raw.shape[:-1], self._hypotheses + 2), dtype=raw.dtype, device=device),
            size=xp.zeros((*raw.shape[:-1], self._hypotheses), dtype=raw.dtype, device=device),
            load=xp.zeros((*raw.shape[:-1], 3, 4), dtype=raw.dtype, device=device),
            moments=self.stand_in.init(zero),
            lost=zero,
            kind=xp.zeros(raw.shape, dtype=xp.int64, device=device),
            wiring=identity,
            spare=identity,
            spare_std=zero,
            agreed=zero,
            altered=0,
        )

    def sample(self, state: FaultState, force: Array, read: Array) -> tuple[FaultState, Array, Array, Array]:
        """Put channels right and hold leaps, sample by sample.

        Args:
            state: What is known.
            force: Forces by the starting map in N, shape (..., K).
            read: Whether they were read just now (bool), shape (..., K).

        Returns:
            The state; forces to use; whether each may be learnt from (bool); and flags of each channel.
        """
        xp = namespace_of(force)
        if state.altered:
            force = (state.wiring @ force[..., None])[..., 0]
            read = (xp.abs(state.wiring) @ xp.astype(read, force.dtype)[..., None])[..., 0] > 0.5
        step = xp.abs(force - state.last)
        leaping = step > self._leap
        if not anywhere(leaping):
            return state._replace(last=force, leaps=state.leaps * 0), force, read, state.kind
        # A foot that lands moves several of its cells.
        *_, same_foot, _, _, _ = self._constants.like(force)
        others = xp.max(step[..., None, :] * same_foot, axis=-1)
        leaping = leaping & read & (state.leaps < LONGEST_LEAP) & (step > _ALONE * others)
        leaps = xp.where(leaping, state.leaps + 1, xp.where(read, 0, state.leaps))
        used = xp.where(leaping, state.last, force)
        flags = state.kind | int(Flag.SPIKE) * leaping
        return state._replace(last=used, leaps=leaps), used, read & ~leaping, flags

    def silent(self, state: FaultState, force: Array, read: Array) -> FaultState:
        """Find channels that say nothing, or always the same.

        Args:
            state: What is known.
            force: Forces by the starting map of the samples that wait in N, shape (..., n, K).
            read: Whether they were read (0 or 1), shape (..., n, K).
        """
        xp = namespace_of(force)
        *_, same_foot, cells, _, _ = self._constants.like(force)
        high, low = xp.max(force, axis=-2), xp.min(force, axis=-2)
        spread = high - low
        flat = spread == 0.0
        moving = xp.astype(spread > 0.02 * self._weight, force.dtype) @ same_foot > 0.5
        heard = xp.mean(read, axis=-2)
        missing = (heard < 0.5) & (xp.max(heard, axis=-1) >= 0.5)[..., None]
        again = (heard > 0.99) & ~flat & ((state.kind & int(Flag.MISSING)) > 0) & (state.lost > 0.5)
        state = self._return(state, again)
        stuck = flat & moving & (heard > 0.99)
        dead = stuck & (xp.abs(high) <= 0.1 * self._weight)
        rail = stuck & ~dead & (xp.abs(high) > _HEAVIEST * self._weight)
        kind = int(Flag.DEAD) * dead | int(Flag.SATURATED) * rail | int(Flag.STUCK) * (stuck & ~dead & ~rail)
        kind = kind | int(Flag.MISSING) * missing
        fresh = (stuck | missing) & (state.lost < 0.5) & (cells > 0.5)
        return self._lose(state, fresh, kind)

    def contradicted(
        self,
        state: FaultState,
        misfit: Misfit,
        channel_rows: Array,
        reading: Array,
        gain: Array,
        force: Array,
        loads: Array,
        mass: Array,
    ) -> tuple[FaultState, Array, Array]:
        """Hold hypotheses against the robot's motion.

        Args:
            state: What is known.
            misfit: What the m Newton-Euler rows of a block leave unexplained.
            channel_rows: What a newton on each channel does to them, shape (..., m, K).
            reading: Forces by the starting map of each row in N, shape (..., m, K).
            gain: Gains a, shape (..., K).
            force: Calibrated forces of each row in N, shape (..., m, K).
            loads: Columns of what a load changes, (centre of mass (2), mass), shape (..., m, 3).
            mass: Believed mass over the estimated one, less 1, shape (...).

        Returns:
            The state; and, both of shape (...), whether a fault was found (bool), and whether it is a load.
        """
        residual, there = misfit.residual, misfit.there
        xp, K = namespace_of(residual), self._channels
        possible, related, identity, about, _, _, handicap, order = self._constants.like(residual)
        nothing = misfit.mean
        state = state._replace(trust=state.trust + xp.astype(nothing < 0.5 * _SUSPICION, residual.dtype))
        # Most of the time nothing is wrong with anybody, and no hypothesis needs to be tried.
        if not bool(xp.any((nothing > _SUSPICION) | (state.doubt > 0.5))):
            return state, nothing < 0.0, nothing < 0.0
        alone, _ = self.stand_in.others(state.moments, state.lost)
        said = force @ alone.mT
        scaled = channel_rows * gain[..., None, :]
        first, second = self._first, self._second
        straight = reading[..., first] - reading[..., second]
        crossed = reading[..., first] + reading[..., second]
        # What each hypothesis changes of a force, and what a newton of that does to the rows.
        errors = xp.concat([force - said, 2.0 * reading, straight, crossed], axis=-1)
        felt = [channel_rows, scaled, scaled[..., first] - scaled[..., second]]
        felt = xp.concat([*felt, scaled[..., first] + scaled[..., second]], axis=-1)
        size = xp.max(xp.abs(errors) * there[..., None], axis=-2)

        # The block in which a fault begins is half right: what counts are those behind it.
        doubt = state.doubt + (state.doubt > 0.5)
        # Sums go on from the second whole block.
        load = state.load * xp.astype(doubt > 2.5, residual.dtype)[..., None, None]
        load, change, plausible = self._rival.fit(load, misfit, loads, mass)
        most = xp.maximum(state.size * xp.astype(doubt > 1.5, residual.dtype)[..., None], size)
        changes = xp.concat([felt * errors, change[..., None]], axis=-1)
        mean = xp.concat([nothing[..., None], misfit.mean_with(changes)], axis=-1)

        whole = xp.where(doubt > 1.5, doubt - 1.0, 1.0)[..., None]
        scores = xp.where(doubt[..., None] > 1.5, state.scores + (mean - state.scores) / whole, 0.0)
        begins = (doubt < 0.5) & (mean[..., 0] > _SUSPICION)
        doubt = xp.where(begins, 1.0, doubt)
        ends = (doubt > _PATIENCE) | ((doubt > 1.5) & (scores[..., 0] < 0.4 * _SUSPICION))
        doubt = xp.where(ends, 0.0, doubt)

        now = scores[..., 0]
        heard = 1.0 - xp.astype((state.lost @ about.mT) > 0.5, residual.dtype)
        # What small errors of the reference could be as well is not put down to a channel.
        least_error = _LEAST_ERROR * self._weight
        each = xp.where(possible * heard > 0.5, scores[..., 1:-1] * handicap, 1e9)
        # Between its turns a broken cell carries little, and still explains what was wrong in them.
        channels = xp.min(xp.where(most > least_error, each, 1e9), axis=-1)
        each = xp.where(size > least_error, each, 1e9)
        loaded = xp.where(plausible, scores[..., -1], 1e9)
        best = xp.argmin(each, axis=-1)
        chosen = xp.astype(best[..., None] == order, residual.dtype)
        least = xp.min(each, axis=-1)
        rivals = xp.where(chosen @ related > 0.5, 1e9, each)
        rival = xp.min(rivals, axis=-1)
        ripe = (doubt > 1.5) & (state.trust >= TRUST) & (now > _SUSPICION)
        found = ripe & (least < _RELIEF * now) & (least < _CONTRAST * rival)
        found = found & (least + _NOISE < _CONTRAST * (loaded + _NOISE))
        taken = ripe & ~found & (doubt >= _LOAD_BLOCKS) & (loaded < _RELIEF * now)
        taken = taken & (loaded + _NOISE < _LOAD_CONTRAST * (channels + _NOISE))
        accepted = chosen * xp.astype(found, residual.dtype)[..., None]

        state = state._replace(scores=scores, doubt=xp.where(found | taken, 0.0, doubt))
        state = state._replace(size=most, load=load, trust=xp.where(taken, TRUST, state.trust))
        if not bool(xp.any(found)):
            return state, found, taken
        pairs, out, flipped = len(self._first), accepted[..., :K], accepted[..., K : 2 * K]
        straight, crossed = accepted[..., 2 * K : 2 * K + pairs], accepted[..., 2 * K + pairs :]
        state = self._lose(state, out > 0.5, int(Flag.DEAD) * (out > 0.5))
        turn = identity * (1.0 - 2.0 * flipped)[..., None]
        exchange = identity
        for swapped, sign in ((straight, 1.0), (crossed, -1.0)):
            one = swapped @ about[2 * K : 2 * K + pairs]
            cross = one[..., None] * one[..., None, :] * (1.0 - identity)
            exchange = (identity * (1.0 - one)[..., None] + sign * cross) @ exchange
        exchanged = (straight + crossed) @ about[2 * K : 2 * K + pairs] > 0.5
        kind = state.kind ^ (int(Flag.FLIPPED) * (flipped > 0.5))
        kind = kind ^ (int(Flag.SWAPPED) * exchanged)
        wiring = turn @ exchange @ state.wiring
        return state._replace(wiring=wiring, kind=kind, altered=1), found, taken

    def suspects(self, state: FaultState, misfit: Misfit) -> Array:
        """Tell whether to wait with learning, as something has begun to seem wrong (bool), shape (...)."""
        begun = (misfit.mean > _SUSPICION) | (state.doubt > 0.5)
        return begun & (state.doubt < _WAIT) & (state.trust >= TRUST)

    def baffled(self, state: FaultState) -> Array:
        """Tell where something has long seemed wrong and no channel explains it (bool), shape (...)."""
        return (state.doubt >= _WAIT) & (state.scores[..., 0] > _SUSPICION)

    def learn(self, state: FaultState, force: Array, good: Array) -> FaultState:
        """Learn how cells share loads while nothing is wrong, and let channels come back.

        Args:
            state: What is known.
            force: Calibrated forces of a block by the channels' own readings in N, shape (..., n, K).
            good: Whether the block could be learnt from (bool), shape (...).
        """
        xp = namespace_of(force)
        well = good & (state.doubt < 0.5) & xp.all(state.lost < 0.5, axis=-1)
        state = state._replace(moments=self.stand_in.learn(state.moments, force, well))
        if not state.altered:
            return state
        said = force @ state.spare.mT
        error = xp.max(xp.abs(said - force), axis=-2)
        load = xp.max(xp.abs(said), axis=-2)
        moved = xp.max(said, axis=-2) - xp.min(said, axis=-2) > 0.03 * self._weight
        near = error < 0.03 * self._weight + 0.2 * load
        agreed = xp.where(near, state.agreed + xp.astype(moved, force.dtype), 0.0) * state.lost
        back = (agreed >= _RETURN_BLOCKS) & (state.lost > 0.5)
        if not bool(xp.any(back)):
            return state._replace(agreed=agreed)
        return self._return(state._replace(agreed=xp.where(back, 0.0, agreed)), back)

    def _return(self, state: FaultState, back: Array) -> FaultState:
        """Take channels in again."""
        xp = namespace_of(state.last)
        if not bool(xp.any(back)):
            return state
        gone = int(Flag.LOST | Flag.DEAD | Flag.STUCK | Flag.SATURATED | Flag.MISSING)
        kind = xp.where(back, state.kind & ~gone, state.kind)
        return self._rebuild(state._replace(lost=xp.where(back, 0.0, state.lost), kind=kind))

    def _lose(self, state: FaultState, fresh: Array, kind: Array) -> FaultState:
        """Take channels out."""
        xp = namespace_of(state.last)
        if not bool(xp.any(fresh)):
            return state
        lost = xp.where(fresh, 1.0, state.lost)
        kind = state.kind | xp.where(fresh, kind | int(Flag.LOST), 0)
        return self._rebuild(state._replace(lost=lost, kind=kind))

    def _rebuild(self, state: FaultState) -> FaultState:
        """Work out how to do without what is lost."""
        identity = self._constants.like(state.last)[2]
        coefficients, spread = self.stand_in.others(state.moments, state.lost)
        spare = identity * (1.0 - state.lost)[..., None] + coefficients * state.lost[..., None]
        return state._replace(spare=spare, spare_std=spread * state.lost, altered=1)
