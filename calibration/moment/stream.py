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
from surefoot.calibration.moment.uncertainty import Uncertainty, variances
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
        self._uncertainty, self._severity = Uncertainty(unknowns), LearntSeverity(unknowns)
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
        self._change = np.diag(unknowns.change**2)

    @property
    def limits(self) -> dict[str, tuple[Any, Any]]:
        """Limits of the state: unknowns are of order one, offsets in body weights."""
        most = self.setup.plausible_weights
        return self._front_end.limits | dict.fromkeys(("mean", "given", "kept_mean"), (-most, most))

    def init(self, raw: Array) -> MomentState:
        """Return the state before any sample; see :class:`~surefoot.calibration.online.OnlineMethod`."""
        front, unknowns = self._front_end.init(raw), self.unknowns
        channels, feet = self.setup.layout.channels, len(self.setup.layout.feet)
        mean, covariance = unknowns.start.copy(), self._covariance.copy()
        begun = MomentState(
            front=front,
            step=0,
            pending=np.zeros((self.config.span, self._pending.sound.stop)),
            mean=mean,
            covariance=covariance,
            drift=np.zeros(unknowns.map.stop),
            given=mean,
            given_covariance=covariance[unknowns.map, unknowns.map],
            learnt=np.zeros((2 * channels, 2 * channels)),
            spread=np.zeros((3, channels)),
            kept_mean=np.stack([mean, mean]),
            kept_covariance=np.stack([covariance[unknowns.lower]] * 2),
            noise=np.full(self.newton_euler.kinds, FIRST_NOISE),
            misfit=FIRST_MISFIT,
            rate=1.0,
            swing_zero=np.zeros(channels),
            swing_ago=np.full(feet, -1.0),
            swing_sum=np.zeros(channels),
            swing_samples=np.zeros(feet),
            unproven=0.0,
            due=0.0,
            quiet=0.0,
            anchor=np.zeros(channels),
            status=0,
            faults=self._faults.init(self._scale * front.raw + self._offset),
        )
        return self._doubted(begun)

    def retract(self, state: MomentState) -> MomentState:
        """Take back what was learnt of late; see :class:`~surefoot.calibration.setup.OnlineMethod`."""
        state = self._back(state)._replace(
            kept_mean=np.stack([state.kept_mean[0]] * 2),
            kept_covariance=np.stack([state.kept_covariance[0]] * 2),
        )
        return self._doubted(state)

    def update(
        self, state: MomentState, raw: Array, reference: Reference, dt: float
    ) -> tuple[MomentState, Estimate]:
        """Take in one sample; see :class:`~surefoot.calibration.online.OnlineMethod`."""
        faults, kinds, every = state.faults, state.faults.kind, self.config.every

        def repair(force: Array, read: Array) -> tuple[Array, Array]:
            nonlocal faults, kinds
            scale = self.unknowns.own_scales(state.given)
            faults, force, sure, kinds = self._faults.sample(state.faults, force, read, scale)
            return force, sure

        front, sample = self._front_end.observe(state.front, raw, reference, dt, repair)
        pending = np.zeros_like(state.pending) if sample.gap else state.pending.copy()
        notes = [*sample.swing, sample.stance.any(), sample.sound]
        pending[2 * self.config.settle + state.step % every] = np.concatenate(
            [sample.past, sample.motion, sample.read, notes]
        )
        state = state._replace(front=front, step=state.step + 1, pending=pending, faults=faults)
        if sample.gap and 0.0 < dt < float("inf"):
            state = self._walked(state, min(dt, _LONGEST_PAUSE) / (every * self.setup.dt))
        nis, rows = np.nan, 0.0
        if state.step % every == 0:
            state, (nis, rows) = self._learn(state)
            kinds = kinds | state.faults.kind
        if state.step % every == min(1, every - 1) and state.due > 0.5:
            state = self._given(state)
        return state, self._estimate(state, sample, kinds, nis, rows)

    def _learn(self, state: MomentState) -> tuple[MomentState, tuple[float, float]]:
        """Update the unknowns by the block that is full; return what it is to be checked by as well.

        That is the normalised innovation squared of all rows that were learnt from, and their number.
        """
        block, read = self._block(state)
        faults = self._faults.silent(state.faults, block.force, read)
        block = block._replace(use=block.use * self._complete(faults, read))
        state = self._walked(state, 1.0)

        # A foot that hangs comes first, so that the columns of all other rows hold offsets that are known.
        count, reading, doubted = self._hanging(state, block, faults)
        state, anew = self._product.forgotten(state, block, count, reading, faults.lost)
        if anew:
            # What rows left unexplained before was that of wrong columns.
            state = state._replace(noise=np.full_like(state.noise, FIRST_NOISE))
            faults = faults._replace(trust=0.0)
        unlearnt = KalmanStep(state.mean, state.covariance, 0.0, 0.0)
        tared, sound = self._tared(state, unlearnt, block, faults, count, reading)

        # Evidence: what the robot's motion asks for, and what of it the feet leave unexplained.
        written, places, assumed = self._written(state, tared, block, faults)
        residuals = Residuals.of(written, tared.mean, tared.covariance)
        newton, rejected = self._plausible(written, residuals, tared.covariance, assumed)

        # Decision: is a channel to blame, or, where none was found to be, the robot itself?
        waiting = self._faults.suspects(faults, residuals)
        changed = self._changed(tared, newton) or self._faults.unexplained(faults)
        changed = changed and faults.trust >= _SETTLED and not waiting
        if changed:
            faults = faults._replace(trust=TRUST)

        # Action: learn from it, unless something is to be waited for.
        quiet, anchor = self._quiet(state, block)
        state = self._drifting.followed(state, count, reading, 1.0 - faults.lost)
        rows = newton._replace(variance=newton.variance * (1.0 + quiet) ** 2)
        known, drifted = np.diagonal(tared.covariance), self._product.drifted(state, count)
        rows = self._product.since_swing(rows, places, known, drifted)
        if self.parity.matters:
            parity = self.parity.rows(tared.mean, block)
            rows = rows.beside(parity if (faults.lost < 0.5).all() else parity.none())
        prior = tared
        if waiting:
            prior, rows = unlearnt, rows.none()
        wider = prior.covariance + self._change if changed else prior.covariance
        step, finite = self._step(state, prior.mean, wider, rows)
        clipped = np.clip(step.mean, *self._limits(state.drift))
        rejected = rejected or doubted or bool((clipped != step.mean).any())
        # A robot of which nothing is used, as somebody holds it, says nothing of the motion that it had.
        unused = waiting or not newton.H.any()
        state = state._replace(
            unproven=state.unproven if unused else max(state.unproven - 1.0, 0.0),
            mean=clipped if finite else unlearnt.mean,
            covariance=step.covariance if finite else unlearnt.covariance,
            misfit=state.misfit if unused else followed_misfit(state.misfit, residuals),
            quiet=quiet,
            anchor=anchor,
            status=(int(Flag.REJECTED) if rejected else 0) | (0 if finite and sound else int(Flag.SINGULAR)),
        )
        state = self._watch(state, faults, unlearnt.mean, tared.mean, block, written, places, residuals)
        # What no fault and no load explains is noise; a robot that stands shows little of it.
        if not (unused or quiet > 0.5 or self._faults.explicable(state.faults)):
            state = state._replace(noise=followed_noise(state.noise, residuals))
        # The next block begins with the last samples of this one.
        pending, every = state.pending.copy(), self.config.every
        pending[:-every] = state.pending[every:]
        return state._replace(pending=pending), (step.nis + prior.nis, step.rows + prior.rows)

    def _written(
        self, state: MomentState, tared: KalmanStep, block: Block, faults: ChannelState
    ) -> tuple[Rows, Array, Array]:
        """Return the rows of Newton and Euler, less sure by what they leave out.

        And what a newton on each channel does to them, shape (m, K), and the variances that are assumed of
        them before noise is learnt, shape (m,).
        """
        spare = (faults.spare, faults.spare_std) if faults.altered else ()
        rows, places = self.newton_euler.rows(tared.mean, block, state.noise, *spare)
        factor = np.tile(state.noise, self.config.every // self.config.average)
        assumed = rows.variance / factor
        return self._product.unsure(rows, places, np.diagonal(tared.covariance), factor), places, assumed

    def _step(
        self, state: MomentState, mean: Array, covariance: Array, rows: Rows
    ) -> tuple[KalmanStep, bool]:
        """Learn from rows, and say whether all of what came is finite."""
        since = state.swing_ago * (self.config.every * self.setup.dt)
        walks = ((since >= 0.0) & (since <= _STRIDE)).any()
        # The mass only while it is much less sure than it began, the centre of mass until strides repeat.
        sure = self.unknowns.sure if walks else self.unknowns.sure_still
        learnt = self.unknowns.learnt * (np.diagonal(covariance) > sure)
        step = kalman_step(mean, covariance, *rows, learnt, self.config.gate)
        return step, bool(np.isfinite(step.mean).all() and np.isfinite(step.covariance).all())

    def _walked(self, state: MomentState, blocks: float) -> MomentState:
        """Return the state after the time of some blocks in which the unknowns have drifted."""
        of_map, walk = self.unknowns.map, blocks * self._drifting.walk(state)
        return state._replace(
            covariance=state.covariance + np.diag(walk),
            drift=state.drift + walk[of_map],
            given_covariance=state.given_covariance + np.diag(walk[of_map]),
            swing_ago=np.where(state.swing_ago < 0.0, state.swing_ago, state.swing_ago + blocks),
        )

    def _back(self, state: MomentState) -> MomentState:
        """Return the state with what was known some seconds ago."""
        covariance = np.zeros_like(state.covariance)
        covariance[self.unknowns.lower] = state.kept_covariance[0]
        return state._replace(
            mean=state.kept_mean[0],
            covariance=covariance + np.tril(covariance, -1).T,
            pending=np.zeros_like(state.pending),
        )

    def _doubted(self, state: MomentState) -> MomentState:
        """Return the state that hands out what is known now for a while."""
        proven = self._given(state._replace(unproven=0.0, due=_ALL))
        return proven._replace(unproven=float(self._keep_every))

    def _limits(self, drift: Array) -> tuple[Array, Array]:
        """Return the bounds of what a sensor can be, by where it began and how far it can have drifted."""
        # Errors of the reference may change, when a load is picked up; a sensor only drifts.
        start, reach = self.unknowns.start, np.full(self.unknowns.size, np.inf)
        reach[self.unknowns.map] = _REACH * np.sqrt(self._severity.first(drift))
        return start - reach, start + reach

    def _given(self, state: MomentState) -> MomentState:
        """Return the state with what is handed out: the unknowns by a prior that was learnt as well.

        It moves only where the unknowns did, as without new rows only the uncertainty changes, and not while
        they are unproven: a fall shows some moments after it has begun.
        """
        if state.unproven < 0.5:
            learnt, covariance = self._severity.reweighted(
                state.mean, state.covariance, state.drift, state.misfit
            )
            # They have drifted since they were learnt.
            state = state._replace(given_covariance=covariance + np.diag(self._drifting.aged(state)))
            if state.due >= _ALL:
                state = state._replace(given=np.concatenate([learnt, state.mean[len(learnt) :]]))
        of_channels = self._uncertainty.of_parameters(state.given, state.given_covariance)
        return state._replace(learnt=of_channels, spread=self._uncertainty.of_channels(of_channels), due=0.0)

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
        unknowns, reading = self.unknowns, self.newton_euler.readings(block)
        fresh = bool((faults.lost != state.faults.lost).any())
        seen = Contradiction(
            residuals=residuals,
            places=places,
            reading=reading,
            scale=unknowns.own_scales(mean),
            force=unknowns.force(mean, reading),
            load=rows.H[:, unknowns.load],
            mass=mean[unknowns.mass],
        )
        faults, found, loaded = self._faults.contradicted(faults, seen)
        found = found or fresh
        used = bool((block.use > 0.5).all()) and not found
        state = state._replace(faults=self._faults.learn(faults, unknowns.force(state.given, reading), used))
        if loaded:
            state = state._replace(covariance=state.covariance + self._change)
        if found:
            state = self._back(state)
        moved = (np.abs(state.mean - before) > _ROUNDING).any()
        state = state._replace(due=_ALL if moved else _SPREAD)
        if found:
            # What a fault has spoilt is put right at once.
            state = self._given(state)
        if (state.step // self.config.every) % self._keep_every == 0:
            state = state._replace(
                kept_mean=np.stack([state.kept_mean[1], state.mean]),
                kept_covariance=np.stack([state.kept_covariance[1], state.covariance[unknowns.lower]]),
            )
        return state

    def _complete(self, faults: ChannelState, read: Array) -> Array:
        """Return which samples have all readings that they need (bool), shape (n,)."""
        replaced = (faults.lost > 0.5) & (faults.spare_std < _UNSURE * self.setup.weight)
        bearable = ((faults.lost < 0.5) | replaced).all()
        return ((read > 0.5) | replaced).all(axis=1) & bearable

    def _block(self, state: MomentState) -> tuple[Block, Array]:
        """Return the samples that wait as a block, and which channels were read, shape (n, K)."""
        pending, at = state.pending, self._pending
        motion = pending[:, at.motion]
        physical = [self._front_end.motions.ground(one)[2] for one in motion]
        use, stand = pending[:, at.sound.start] * physical, pending[:, at.stand.start]
        return Block(pending[:, at.force], motion, pending[:, at.swing], use, stand), pending[:, at.read]

    def _quiet(self, state: MomentState, block: Block) -> tuple[float, Array]:
        """Return for how many blocks the robot has stood still, and the readings since when.

        All of them count as one measurement, however long it stands. Without a change of load all blocks
        measure the same; what their readings still do is noise and drift, and a scale that should explain why
        the motion does not follow them would come out too small.
        """
        high, low = block.force.max(axis=0), block.force.min(axis=0)
        middle, limit = 0.5 * (high + low), self.config.still * self.unknowns.unit
        moved = (high - low >= 2.0 * limit) | (np.abs(middle - state.anchor) > limit)
        return (0.0, middle) if moved.any() else (state.quiet + 1.0, state.anchor)

    def _plausible(
        self, rows: Rows, residuals: Residuals, covariance: Array, assumed: Array
    ) -> tuple[Rows, bool]:
        """Leave out groups of rows that no error of calibration explains, such as of a lifted robot.

        Noise that is learnt, or expected at first, is no reason to learn from such rows: they are held
        against the variances that are assumed, shape (m,), and sensors against what is stated of them.
        """
        e, kinds = residuals.residual, self.newton_euler.kinds
        variance = variances(rows.H / self._wide, covariance) + assumed
        wrong = (np.abs(e) > self.config.reject) & (e * e > _REJECT_STD**2 * variance)
        groups = wrong.reshape(-1, kinds).any(axis=1)
        return rows.keep(~groups.repeat(kinds)), bool(groups.any())

    def _changed(self, tared: KalmanStep, rows: Rows) -> bool:
        """Return whether the force of a whole block leaps away from what the motion asks for."""
        vertical = slice(self.newton_euler.vertical, None, self.newton_euler.kinds)
        H = rows.H[vertical]
        there = (H != 0.0).any(axis=1)
        count = max(there.sum(), 1)
        row = H.sum(axis=0) / count
        e = rows.y[vertical].sum() / count - row @ tared.mean
        spread = row @ tared.covariance @ row + (rows.variance[vertical] * there).sum() / count**2
        return bool(e * e > _LEAP_STD**2 * spread and abs(e) > _LEAST_CHANGE * self.config.mass_change)

    def _hanging(self, state: MomentState, block: Block, faults: ChannelState) -> tuple[Array, Array, bool]:
        """Find the samples in which feet surely hang and carry no weight.

        Returns:
            Their number for each foot, shape (F,), means of the forces over them, shape (K,), and whether any
            foot was doubted.
        """
        if not (block.swing > 0.5).any():
            return np.zeros_like(state.swing_samples), np.zeros_like(state.swing_sum), False
        of_map = self.unknowns.map
        spare = faults.spare if faults.altered else None
        count, reading = self.tare.hanging(state.mean, block, spare)
        stated = self._severity.stated(state.drift)
        load, row = self.tare.load(state.mean, reading, spare)
        spread = np.minimum(variances(row, state.covariance[of_map, of_map]), (row * row) @ stated)
        unseen = (state.swing_ago < 0.0) & (state.swing_samples < 0.5)
        if unseen.any():
            # What was learnt before a first swing was learnt with offsets that nobody knew.
            begun, row = self.tare.load(self.unknowns.start, reading, spare)
            load = np.where(unseen, begun, load)
            spread = np.where(unseen, (row * row) @ stated, spread)
        limit = self.config.swing_load + _LOAD_STD * np.sqrt(np.maximum(spread, 0.0))
        hangs = count > 0.5
        # Not all feet of a robot that stands are in the air.
        doubted = hangs & ((np.abs(load) > limit) | hangs.all())
        return np.where(doubted, 0.0, count), reading, bool(doubted.any())

    def _tared(
        self,
        state: MomentState,
        unlearnt: KalmanStep,
        block: Block,
        faults: ChannelState,
        count: Array,
        reading: Array,
    ) -> tuple[KalmanStep, bool]:
        """Learn from feet that hang, and say whether all of what came is finite."""
        if not (count > 0.5).any():
            return unlearnt, True
        rows = self.tare.rows(unlearnt.mean, block, count, reading).keep(1.0 - faults.lost)
        step, finite = self._step(state, unlearnt.mean, unlearnt.covariance, rows)
        return step if finite else unlearnt, finite

    def _estimate(
        self, state: MomentState, sample: Sample, kinds: Array, nis: float, nis_rows: float
    ) -> Estimate:
        """Apply the map to the newest sample, with how sure it is."""
        unknowns, spare = self.unknowns, state.faults.spare
        forces = [
            unknowns.force(state.given, part) for part in (sample.force, sample.ahead) if part is not None
        ]
        if state.faults.altered:
            forces = [spare @ force for force in forces]
        a, b = unknowns.own_scales(state.given), unknowns.offsets(state.given)
        maps = a * self._scale, a * self._offset + b
        estimate = self._front_end.report(sample, forces[0], *maps, state.status | kinds, None, *forces[1:])
        sure = self._uncertainty.of_estimate(estimate, sample, state)
        return estimate._replace(**sure, nis=nis, nis_rows=nis_rows)


def moment_filter(setup: OnlineSetup, config: MomentFilterConfig | None = None) -> OnlineMethod:
    """Return the moment filter as a pair of pure functions.

    Args:
        setup: The robot.
        config: Options.
    """
    stream = MomentStream(setup, config or MomentFilterConfig())
    return OnlineMethod(stream.init, stream.update, stream.retract, stream.limits)
