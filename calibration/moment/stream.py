"""How the moment filter runs over a stream.

Its theory and options are in :mod:`surefoot.calibration.moment.config`, its rows in
:mod:`surefoot.calibration.moment.rows`. Samples wait until a block is full, so that most samples cost no
more than applying the map. What was learnt of it is handed out with the next sample, under the prior that it
asks for: no sample has both to do, and a robot's controller waits for neither long.
"""

from typing import Any

import numpy as np

from surefoot.calibration.arrays import Array, in_a_row
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.calibration.front_end.readings import FrontEnd, Sample
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.drift import LearntDrift
from surefoot.calibration.moment.faults import TRUST, ChannelFaults, ChannelState
from surefoot.calibration.moment.hypotheses import Contradiction
from surefoot.calibration.moment.kalman import KalmanStep, kalman_step
from surefoot.calibration.moment.newton_euler import NewtonEuler
from surefoot.calibration.moment.noise import FIRST_MISFIT, FIRST_NOISE, followed_misfit, followed_noise
from surefoot.calibration.moment.parity import Parity
from surefoot.calibration.moment.product import ErrorProduct
from surefoot.calibration.moment.rows import Block, Residuals, Rows
from surefoot.calibration.moment.severity import FIRST_WIDTH, LearntSeverity
from surefoot.calibration.moment.state import BlockColumns, MomentState
from surefoot.calibration.moment.tare import Tare
from surefoot.calibration.moment.uncertainty import Uncertainty
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.reference import Reference
from surefoot.calibration.setup import OnlineMethod, OnlineSetup

_REJECT_STD = 8.0
"""Standard deviations beyond which a large innovation is no error of calibration."""

_LEAP_STD = 5.0
"""Standard deviations of a block's mean vertical force beyond which the mass itself is doubted."""

_LEAST_CHANGE = 0.5
"""Share of ``mass_change`` that the vertical force must be off by as well for that."""

_SETTLED = 50.0
"""Blocks without doubt that must have passed before the mass is doubted."""

_LOAD_STD = 4.0
"""Standard deviations of a foot's load that a foot in the air may seem to carry besides ``swing_load``."""

_UNSURE = 0.06
"""Standard deviation in body weights from which on a reconstructed force is no use to learn with."""

_LONGEST_PAUSE = 3600.0
"""Time in s beyond which a pause adds no more drift."""

_REACH = 12.0
"""Standard deviations of the prior that the filter begins with beyond which a sensor is not thought to be."""

_STRIDE = 1.5
"""Time in s without the end of a swing from which on a robot does not walk."""

_ROUNDING = 1e-12
"""Change of an unknown up to which it has not moved: two processors do not round alike."""

_SPREAD, _ALL = 1.0, 2.0
"""What is due to be handed out of a block: how sure the unknowns are, or they themselves as well."""

_KEPT = 1.5
"""Time in s between the states that are kept to go back to, and after which what is learnt is handed out."""


class MomentStream:
    """The moment filter for one setup: ``init`` and ``update`` are pure functions that share constants."""

    def __init__(self, setup: OnlineSetup, config: MomentFilterConfig) -> None:
        self.setup, self.config = setup, config
        self.unknowns = unknowns = Unknowns(setup, config)
        self.newton_euler = NewtonEuler(setup, config, unknowns)
        self.tare, self.parity = Tare(setup, config, unknowns), Parity(setup, config, unknowns)
        self._front_end = FrontEnd(setup, imu=False)
        self._uncertainty, self._severity = Uncertainty(setup, unknowns), LearntSeverity(unknowns)
        self._drifting = LearntDrift(setup, config, unknowns, self.tare)
        self._faults = ChannelFaults(
            setup,
            config.leap,
            unknowns.change[unknowns.load],
            config.stand_in_memory / (config.every * setup.dt),
        )
        self._keep_every = max(1, round(_KEPT / (config.every * setup.dt)))
        channels, feet = setup.layout.channels, len(setup.layout.feet)
        motion = self._front_end.motions.columns.size
        self._pending = BlockColumns(*in_a_row(channels, motion, channels, feet, 1, 1))
        self._scale, self._offset = (np.asarray(part, dtype=np.float64) for part in setup.initial)
        self._wide = np.ones(unknowns.size)
        self._wide[unknowns.map] = FIRST_WIDTH
        self._covariance = np.diag((unknowns.std * self._wide) ** 2)
        self._product = ErrorProduct(setup, config, unknowns, self.tare, self._covariance)
        self._identity = np.eye(unknowns.size)
        self._change = np.diag(unknowns.change**2)

    def init(self, raw: Array) -> MomentState:
        """Return the state before any sample; see :class:`~surefoot.calibration.online.OnlineMethod`."""
        front = self._front_end.init(raw)
        batch = raw.shape[:-1]

        def zeros(*tail: int, dtype: Any = np.float64) -> Array:
            return np.zeros((*batch, *tail), dtype=dtype)

        mean, covariance = zeros(1) + self.unknowns.start, zeros(1, 1) + self._covariance
        channels, feet = self.setup.layout.channels, len(self.setup.layout.feet)
        begun = MomentState(
            front=front,
            step=0,
            pending=zeros(self.config.span, self._pending.sound.stop),
            mean=mean,
            covariance=covariance,
            drift=zeros(self.unknowns.map.stop),
            given=mean,
            given_covariance=covariance[..., self.unknowns.map, self.unknowns.map],
            learnt=zeros(2 * channels, 1),
            spread=zeros(3, 1),
            kept_mean=zeros(2, 1) + self.unknowns.start,
            kept_covariance=zeros(2, 1, 1) + self._covariance,
            noise=zeros(self.newton_euler.kinds) + FIRST_NOISE,
            misfit=zeros() + FIRST_MISFIT,
            rate=zeros() + 1.0,
            swing_zero=zeros(channels),
            swing_ago=zeros(feet) - 1.0,
            swing_sum=zeros(channels),
            swing_samples=zeros(feet),
            unproven=zeros(),
            due=zeros(),
            quiet=zeros(),
            anchor=zeros(channels),
            status=zeros(dtype=np.int64),
            faults=self._faults.init(raw, self._scale * front.raw + self._offset),
        )
        return self._doubted(begun, np.isfinite(begun.misfit))

    def retract(self, state: MomentState, which: Array) -> MomentState:
        """Take back what was learnt of late; see :class:`~surefoot.calibration.setup.OnlineMethod`."""
        means, covariances = state.kept_mean, state.kept_covariance
        state = self._back(state, which)._replace(
            kept_mean=np.where(which[..., None, None], means[..., :1, :], means),
            kept_covariance=np.where(which[..., None, None, None], covariances[..., :1, :, :], covariances),
        )
        return self._doubted(state, which)

    def update(
        self, state: MomentState, raw: Array, reference: Reference, dt: float
    ) -> tuple[MomentState, Estimate]:
        """Take in one sample; see :class:`~surefoot.calibration.online.OnlineMethod`."""
        faults, kinds = state.faults, state.faults.kind

        def repair(force: Array, read: Array) -> tuple[Array, Array]:
            nonlocal faults, kinds
            scale = self.unknowns.own_scales(state.given)
            faults, force, sure, kinds = self._faults.sample(state.faults, force, read, scale)
            return force, sure

        front, sample = self._front_end.observe(state.front, raw, reference, dt, repair)
        pending = state.pending * 0.0 if sample.gap else state.pending.copy()
        stand = sample.stance.any(axis=-1)[..., None]
        notes = np.concatenate([sample.read, sample.swing, stand, sample.sound[..., None]], axis=-1)
        row = 2 * self.config.settle + state.step % self.config.every
        pending[..., row, :] = np.concatenate([sample.past, sample.motion, notes], axis=-1)
        state = state._replace(front=front, step=state.step + 1, pending=pending, faults=faults)
        if sample.gap and 0.0 < dt < float("inf"):
            state = self._walked(state, min(dt, _LONGEST_PAUSE) / (self.config.every * self.setup.dt))
        rows = 0.0 * state.noise[..., 0]
        nis, of_block = rows + np.nan, state.step % self.config.every
        if of_block == 0:
            state, step = self._learn(state)
            kinds, nis, rows = kinds | state.faults.kind, step.nis, step.rows
        if of_block == min(1, self.config.every - 1):
            state = self._given(state, state.due > 0.5)
        return state, self._estimate(state, sample, kinds, nis, rows)

    def _learn(self, state: MomentState) -> tuple[MomentState, KalmanStep]:
        """Update the unknowns by the block that is full."""
        config = self.config
        block, read = self._block(state)
        faults = self._faults.silent(state.faults, block.force, read)
        block = block._replace(use=block.use * self._complete(faults, read))
        state = self._walked(state, 1.0)
        count, reading, doubted = self._hanging(state, block, faults)
        state, anew = self._product.forgotten(state, block, count, reading, faults.lost)
        # What rows left unexplained before was that of wrong columns.
        state = state._replace(noise=np.where(anew[..., None], FIRST_NOISE, state.noise))
        faults = faults._replace(trust=np.where(anew, 0.0, faults.trust))
        nothing = 0.0 * state.misfit
        unlearnt = KalmanStep(state.mean, state.covariance, nis=nothing, rows=nothing)
        # First of all, so that the columns of all other rows hold the offsets that are known by now.
        tared, sound = self._tared(state, unlearnt, block, faults, count, reading)
        mean, covariance = tared.mean, tared.covariance
        spare = (faults.spare, faults.spare_std) if faults.altered else ()
        rows, places = self.newton_euler.rows(mean, block, state.noise, *spare)
        factor = np.concatenate([state.noise] * (config.every // config.average), axis=-1)
        assumed = rows.variance / factor
        known = np.linalg.diagonal(covariance)
        rows = self._product.unsure(rows, places, known, factor)
        residuals = Residuals.of(rows, mean, covariance)
        newton, rejected = self._plausible(rows, residuals, covariance, assumed)
        waiting = self._faults.suspects(faults, residuals)
        # What still seems wrong when no channel was found to be is the robot itself.
        changed = self._changed(mean, covariance, newton) | self._faults.unexplained(faults)
        changed = changed & (faults.trust >= _SETTLED) & ~waiting
        faults = faults._replace(trust=np.where(changed, TRUST, faults.trust))
        quiet, anchor, learnt_from = self._quiet(state, block, newton)
        state = self._drifting.followed(state, count, reading, 1.0 - faults.lost)
        drifted = self._product.drifted(state, count)
        learnt_from = self._product.since_swing(learnt_from, places, known, drifted)
        if self.parity.matters:
            parity = self.parity.rows(mean, block)
            if faults.altered:
                parity = parity.keep((faults.lost < 0.5).all(axis=-1)[..., None])
            learnt_from = learnt_from.beside(parity)
        learnt_from = learnt_from.keep(~waiting[..., None])
        tared = KalmanStep(*(_where(waiting, *parts) for parts in zip(unlearnt, tared, strict=True)))
        wider = tared.covariance + np.where(changed[..., None, None], self._change, 0.0)
        step, finite = self._step(state, tared.mean, wider, learnt_from)
        low, high = self._limits(state.drift)
        clipped = np.clip(step.mean, low, high)
        rejected = rejected | doubted | (clipped != step.mean).any(axis=-1)
        # A robot of which nothing is used, as somebody holds it, says nothing of the motion that it had.
        unused = waiting | ~(newton.H != 0.0).any(axis=(-2, -1))
        state = state._replace(
            unproven=np.where(unused, state.unproven, np.maximum(state.unproven - 1.0, 0.0)),
            mean=_where(finite, clipped, unlearnt.mean),
            covariance=_where(finite, step.covariance, state.covariance),
            misfit=np.where(unused, state.misfit, followed_misfit(state.misfit, residuals)),
            quiet=quiet,
            anchor=anchor,
            status=int(Flag.REJECTED) * rejected | int(Flag.SINGULAR) * ~(finite & sound),
        )
        state = self._watch(state, faults, unlearnt.mean, mean, block, rows, places, residuals)
        # What no fault and no load explains is noise; a robot that stands shows little of it.
        kept = unused | (quiet > 0.5) | self._faults.explicable(state.faults)
        noise = np.where(kept[..., None], state.noise, followed_noise(state.noise, residuals))
        both = step._replace(nis=step.nis + tared.nis, rows=step.rows + tared.rows)
        # The next block begins with the last samples of this one.
        pending, every = state.pending.copy(), config.every
        pending[..., :-every, :] = state.pending[..., every:, :]
        return state._replace(noise=noise, pending=pending), both

    def _step(
        self, state: MomentState, mean: Array, covariance: Array, rows: Rows
    ) -> tuple[KalmanStep, Array]:
        """Learn from rows, and say whether all of what came is finite."""
        since = state.swing_ago * (self.config.every * self.setup.dt)
        walks = ((since >= 0.0) & (since <= _STRIDE)).any(axis=-1)
        # The mass only while it is much less sure than it began, the centre of mass until strides repeat.
        sure = np.where(walks[..., None], self.unknowns.sure, self.unknowns.sure_still)
        unsure = np.linalg.diagonal(covariance) > sure
        learnt = self.unknowns.learnt * unsure
        step = kalman_step(mean, covariance, *rows, learnt, self._identity, self.config.gate)
        finite = np.isfinite(step.mean).all(axis=-1)
        return step, finite & np.isfinite(step.covariance).all(axis=(-2, -1))

    def _walked(self, state: MomentState, blocks: float) -> MomentState:
        """Return the state after the time of some blocks in which the unknowns have drifted."""
        of_map = self.unknowns.map
        walk = blocks * self._drifting.walk(state)
        walked = walk[..., None] * self._identity
        return state._replace(
            covariance=state.covariance + walked,
            drift=state.drift + walk[..., of_map],
            given_covariance=state.given_covariance + walked[..., of_map, of_map],
            swing_ago=np.where(state.swing_ago < 0.0, state.swing_ago, state.swing_ago + blocks),
        )

    def _back(self, state: MomentState, which: Array) -> MomentState:
        """Return the state with what some robots, shape (...), knew some seconds ago."""
        those = which[..., None, None]
        return state._replace(
            mean=np.where(which[..., None], state.kept_mean[..., 0, :], state.mean),
            covariance=np.where(those, state.kept_covariance[..., 0, :, :], state.covariance),
            pending=np.where(those, 0.0, state.pending),
        )

    def _doubted(self, state: MomentState, which: Array) -> MomentState:
        """Return the state in which some robots, shape (...), hand out what they know now for a while."""
        proven = state._replace(
            unproven=np.where(which, 0.0, state.unproven), due=np.where(which, _ALL, state.due)
        )
        proven = self._given(proven, which)
        return proven._replace(unproven=np.where(which, float(self._keep_every), state.unproven))

    def _limits(self, drift: Array) -> tuple[Array, Array]:
        """Return the bounds of what a sensor can be, by where it began and how far it can have drifted."""
        # Errors of the reference may change, when a load is picked up; a sensor only drifts.
        start = self.unknowns.start
        others = np.inf + start[self.unknowns.map.stop :] + 0.0 * drift[..., :1]
        sensors = np.sqrt(self._severity.first(drift))
        reach = _REACH * np.concatenate([sensors, others], axis=-1)
        return start - reach, start + reach

    def _given(self, state: MomentState, which: Array) -> MomentState:
        """Return the state with what some robots hand out: the unknowns by a prior that was learnt as well.

        It moves only where the unknowns did, as without new rows only the uncertainty changes, and not while
        they are unproven: a fall shows some moments after it has begun.
        """
        if not which.any():
            return state
        of_map = self.unknowns.map
        learnt, covariance = self._severity.reweighted(
            state.mean, state.covariance, state.drift, state.misfit
        )
        mean = np.concatenate([learnt, state.mean[..., of_map.stop :]], axis=-1)
        proven = which & (state.unproven < 0.5)
        mean = np.where((proven & (state.due >= _ALL))[..., None], mean, state.given)
        # They have drifted since they were learnt.
        covariance = covariance + self._drifting.aged(state)[..., None] * self._identity[of_map, of_map]
        covariance = np.where(proven[..., None, None], covariance, state.given_covariance)
        of_channels = self._uncertainty.of_parameters(mean, covariance)
        of_channels = np.where(which[..., None, None], of_channels, state.learnt)
        return state._replace(
            given=mean,
            given_covariance=covariance,
            learnt=of_channels,
            spread=self._uncertainty.of_channels(of_channels),
            due=np.where(which, 0.0, state.due),
        )

    def _watch(
        self,
        state: MomentState,
        faults: ChannelState,
        before: Array,
        mean: Array,
        block: Block,
        rows: Rows,
        places: Array,
        residuals: Residuals,
    ) -> MomentState:
        """Look for faults in what the block left unexplained; and go back to before one that is found.

        ``before`` is the mean of the unknowns before the block, ``mean`` that which rows were written with.
        """
        unknowns = self.unknowns
        reading = self.newton_euler.readings(block)
        force = unknowns.force(mean[..., None, :], reading)
        fresh = (faults.lost != state.faults.lost).any(axis=-1)
        seen = Contradiction(
            residuals=residuals,
            places=places,
            reading=reading,
            scale=unknowns.own_scales(mean),
            force=force,
            load=rows.H[..., unknowns.load],
            mass=mean[..., unknowns.mass],
        )
        faults, found, loaded = self._faults.contradicted(faults, seen)
        found = found | fresh
        used = (block.use > 0.5).all(axis=-1) & ~found
        given = unknowns.force(state.given[..., None, :], reading)
        faults = self._faults.learn(faults, given, used)
        more = np.where(loaded[..., None, None], self._change, 0.0)
        state = state._replace(faults=faults, covariance=state.covariance + more)
        if found.any():
            state = self._back(state, found)
        moved = (np.abs(state.mean - before) > _ROUNDING).any(axis=-1)
        state = state._replace(due=np.where(moved, _ALL, _SPREAD))
        # What a fault has spoilt is put right at once.
        state = self._given(state, found)
        if (state.step // self.config.every) % self._keep_every == 0:
            state = state._replace(
                kept_mean=np.stack([state.kept_mean[..., 1, :], state.mean], axis=-2),
                kept_covariance=np.stack([state.kept_covariance[..., 1, :, :], state.covariance], axis=-3),
            )
        return state

    def _complete(self, faults: ChannelState, read: Array) -> Array:
        """Return which samples have all readings that they need (0 or 1), shape (..., n)."""
        replaced = (faults.lost > 0.5) & (faults.spare_std < _UNSURE * self.setup.weight)
        complete = ((read > 0.5) | replaced[..., None, :]).all(axis=-1)
        complete = complete & ((faults.lost < 0.5) | replaced).all(axis=-1)[..., None]
        return complete.astype(np.float64)

    def _block(self, state: MomentState) -> tuple[Block, Array]:
        """Return the samples that wait as a block, and which channels were read, shape (..., n, K)."""
        pending, at = state.pending, self._pending
        motion = pending[..., at.motion]
        _, _, physical = self._front_end.motions.ground(motion)
        sound, stand = pending[..., at.sound][..., 0], pending[..., at.stand][..., 0]
        use = sound * physical
        block = Block(pending[..., at.force], motion, pending[..., at.swing], use, stand)
        return block, pending[..., at.read]

    def _quiet(self, state: MomentState, block: Block, rows: Rows) -> tuple[Array, Array, Rows]:
        """Take a robot that stands still for one measurement, however long it stands.

        Without a change of load all blocks measure the same; what their readings still do is noise and drift,
        and a scale that should explain why the motion does not follow them would come out too small.
        """
        high, low = block.force.max(axis=-2), block.force.min(axis=-2)
        middle, limit = 0.5 * (high + low), self.config.still * self.unknowns.unit
        moved = ((high - low >= 2.0 * limit) | (np.abs(middle - state.anchor) > limit)).any(axis=-1)
        quiet = np.where(moved, 0.0, state.quiet + 1.0)
        anchor = np.where(moved[..., None], middle, state.anchor)
        return quiet, anchor, rows._replace(variance=rows.variance * ((1.0 + quiet) ** 2)[..., None])

    def _plausible(
        self, rows: Rows, residuals: Residuals, covariance: Array, assumed: Array
    ) -> tuple[Rows, Array]:
        """Leave out groups of rows that no error of calibration explains, such as of a lifted robot.

        Noise that is learnt, or expected at first, is no reason to learn from such rows: they are held
        against the variances that are assumed, shape (..., m), and sensors against what is stated of them.
        """
        e, kinds = residuals.residual, self.newton_euler.kinds
        H = rows.H / self._wide
        variance = ((H @ covariance) * H).sum(axis=-1) + assumed
        wrong = (np.abs(e) > self.config.reject) & (e * e > _REJECT_STD**2 * variance)
        groups = wrong.reshape(*e.shape[:-1], -1, kinds).any(axis=-1)
        keep = np.stack([~groups] * kinds, axis=-1).reshape(e.shape)
        return rows.keep(keep), groups.any(axis=-1)

    def _changed(self, mean: Array, covariance: Array, rows: Rows) -> Array:
        """Return where the force of a whole block leaps away from what the motion asks for (bool)."""
        which = slice(self.newton_euler.vertical, None, self.newton_euler.kinds)
        H = rows.H[..., which, :]
        there = (H != 0.0).any(axis=-1).astype(np.float64)
        count = there.sum(axis=-1)
        count = np.where(count > 0.5, count, 1.0)
        row = H.sum(axis=-2) / count[..., None]
        e = rows.y[..., which].sum(axis=-1) / count - (row * mean).sum(axis=-1)
        spread = (row[..., None, :] @ covariance @ row[..., None])[..., 0, 0]
        spread = spread + (rows.variance[..., which] * there).sum(axis=-1) / count**2
        return (e * e > _LEAP_STD**2 * spread) & (np.abs(e) > _LEAST_CHANGE * self.config.mass_change)

    def _hanging(self, state: MomentState, block: Block, faults: ChannelState) -> tuple[Array, Array, Array]:
        """Find the samples in which feet surely hang and carry no weight.

        Returns:
            Their number for each foot, shape (..., F), means of the forces over them, shape (..., K), and
            whether any foot was doubted, shape (...).
        """
        if not (block.swing > 0.5).any():
            nothing = 0.0 * state.swing_samples
            return nothing, 0.0 * state.swing_sum, nothing.any(axis=-1)
        of_map = self.unknowns.map
        spare = faults.spare if faults.altered else None
        count, reading = self.tare.hanging(state.mean, block, spare)
        stated = self._severity.stated(state.drift)[..., None, :]
        load, row = self.tare.load(state.mean, reading, spare)
        known = ((row @ state.covariance[..., of_map, of_map]) * row).sum(axis=-1)
        spread = np.minimum(known, (row * row * stated).sum(axis=-1))
        unseen = (state.swing_ago < 0.0) & (state.swing_samples < 0.5)
        if unseen.any():
            # What was learnt before a first swing was learnt with offsets that nobody knew.
            begun, row = self.tare.load(self.unknowns.start + 0.0 * state.mean, reading, spare)
            load = np.where(unseen, begun, load)
            spread = np.where(unseen, (row * row * stated).sum(axis=-1), spread)
        limit = self.config.swing_load + _LOAD_STD * np.sqrt(np.maximum(spread, 0.0))
        doubted = (count > 0.5) & (np.abs(load) > limit)
        # Not all feet of a robot that stands are in the air.
        doubted = doubted | (count > 0.5).all(axis=-1)[..., None]
        return np.where(doubted, 0.0, count), reading, doubted.any(axis=-1)

    def _tared(
        self,
        state: MomentState,
        unlearnt: KalmanStep,
        block: Block,
        faults: ChannelState,
        count: Array,
        reading: Array,
    ) -> tuple[KalmanStep, Array]:
        """Learn from feet that hang, and say whether all of what came is finite."""
        if not (count > 0.5).any():
            return unlearnt, np.isfinite(unlearnt.nis)
        rows = self.tare.rows(unlearnt.mean, block, count, reading)
        rows = rows.keep(1.0 - faults.lost) if faults.altered else rows
        step, finite = self._step(state, unlearnt.mean, unlearnt.covariance, rows)
        step = KalmanStep(*(_where(finite, *parts) for parts in zip(step, unlearnt, strict=True)))
        return step, finite

    def _estimate(
        self, state: MomentState, sample: Sample, kinds: Array, nis: Array, nis_rows: Array
    ) -> Estimate:
        """Apply the map to the newest sample, with how sure it is."""
        unknowns = self.unknowns
        forces = [
            unknowns.force(state.given, part) for part in (sample.force, sample.ahead) if part is not None
        ]
        if state.faults.altered:
            forces = [(state.faults.spare @ force[..., None])[..., 0] for force in forces]
        a, b = unknowns.own_scales(state.given), unknowns.offsets(state.given)
        status = state.status[..., None] | kinds
        maps = a * self._scale, a * self._offset + b
        estimate = self._front_end.report(sample, forces[0], *maps, status, None, *forces[1:])
        sure = self._uncertainty.of_estimate(estimate, sample, state)
        return estimate._replace(**sure, nis=nis, nis_rows=nis_rows)


def _where(those: Array, these: Any, others: Any) -> Array:
    """Choose between arrays robot by robot, of which ``those`` has shape (...)."""
    return np.where(those.reshape(those.shape + (1,) * (np.ndim(these) - those.ndim)), these, others)


def moment_filter(setup: OnlineSetup, config: MomentFilterConfig | None = None) -> OnlineMethod:
    """Return the moment filter as a pair of pure functions.

    Args:
        setup: The robot.
        config: Options.
    """
    stream = MomentStream(setup, config or MomentFilterConfig())
    return OnlineMethod(stream.init, stream.update, stream.retract)
