"""How the moment filter runs over a stream.

Its theory and options are in :mod:`surefoot.calibration.moment.config`, its rows in
:mod:`surefoot.calibration.moment.rows`. Samples wait until a block is full, so that most samples cost no
more than applying the map.
"""

from typing import Any

import numpy as np
from array_api_compat import device as device_of

from surefoot.calibration.arrays import Array, Constants, any_along, cast, in_a_row, namespace_of
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.calibration.front_end.readings import FrontEnd, Sample
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.faults import TRUST, ChannelFaults, ChannelState
from surefoot.calibration.moment.hypotheses import Contradiction
from surefoot.calibration.moment.kalman import KalmanStep, kalman_step
from surefoot.calibration.moment.newton_euler import NewtonEuler
from surefoot.calibration.moment.noise import FIRST_MISFIT, FIRST_NOISE, followed_misfit, followed_noise
from surefoot.calibration.moment.parity import Parity
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

_LOADED = 0.36
"""Share of the variance down to which the mass is estimated, which it exceeds once a load was picked up: it
begins with a quarter, and is only considered until then."""

_LOAD_STD = 4.0
"""Standard deviations of a foot's load that a foot in the air may seem to carry besides ``swing_load``."""

_UNSURE = 0.06
"""Standard deviation in body weights from which on a reconstructed force is no use to learn with."""

_LONGEST_PAUSE = 3600.0
"""Time in s beyond which a pause adds no more drift."""

_SHARED = 8.0
"""Rows of a kind that share the product of the errors of scale and offset: until a foot swings, no offset is
known. More serve sensors that are worse than stated, fewer those on a robot that only stands."""

_REACH = 10.0
"""Standard deviations from the starting map beyond which a sensor is not thought to be."""

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
        scale, offset = (np.asarray(part, dtype=np.float64) for part in setup.initial)
        wide = np.ones(unknowns.size)
        wide[unknowns.map] = FIRST_WIDTH
        std = unknowns.std * wide
        self._constants = Constants(
            start=unknowns.start,
            covariance=np.diag(std**2),
            wide=wide,
            walk=np.diag(unknowns.walk * config.every * setup.dt),
            drift=unknowns.walk[unknowns.map] * config.every * setup.dt,
            learnt=unknowns.learnt,
            sure=unknowns.sure,
            identity=np.eye(unknowns.size),
            unit=unknowns.unit,
            scale=scale,
            offset=offset,
            change=np.diag(unknowns.change**2),
        )

    def init(self, raw: Array) -> MomentState:
        """Return the state before any sample; see :class:`~surefoot.calibration.online.OnlineMethod`."""
        front = self._front_end.init(raw)
        xp, device = namespace_of(raw), device_of(raw)
        batch, own = tuple(raw.shape[:-1]), self._constants.like(raw)

        def zeros(*tail: int, dtype: Any = raw.dtype) -> Array:
            return xp.zeros((*batch, *tail), dtype=dtype, device=device)

        mean, covariance = zeros(1) + own.start, zeros(1, 1) + own.covariance
        begun = MomentState(
            front=front,
            step=0,
            pending=zeros(self.config.span, self._pending.sound.stop),
            mean=mean,
            covariance=covariance,
            drift=zeros(own.drift.shape[-1]),
            given=mean,
            given_covariance=covariance[..., self.unknowns.map, self.unknowns.map],
            learnt=zeros(2 * self.setup.layout.channels, 1),
            spread=zeros(3, 1),
            kept_mean=zeros(2, 1) + own.start,
            kept_covariance=zeros(2, 1, 1) + own.covariance,
            noise=zeros(self.newton_euler.kinds) + FIRST_NOISE,
            misfit=zeros() + FIRST_MISFIT,
            unproven=zeros(),
            quiet=zeros(),
            anchor=zeros(self.setup.layout.channels),
            status=zeros(dtype=xp.int64),
            faults=self._faults.init(raw, own.scale * front.raw + own.offset),
        )
        return self._doubted(begun, xp.isfinite(begun.misfit))

    def retract(self, state: MomentState, which: Array) -> MomentState:
        """Take back what was learnt of late; see :class:`~surefoot.calibration.setup.OnlineMethod`."""
        xp, means, covariances = namespace_of(state.mean), state.kept_mean, state.kept_covariance
        state = self._back(state, which)._replace(
            kept_mean=xp.where(which[..., None, None], means[..., :1, :], means),
            kept_covariance=xp.where(which[..., None, None, None], covariances[..., :1, :, :], covariances),
        )
        return self._doubted(state, which)

    def update(
        self, state: MomentState, raw: Array, reference: Reference, dt: float
    ) -> tuple[MomentState, Estimate]:
        """Take in one sample; see :class:`~surefoot.calibration.online.OnlineMethod`."""
        xp = namespace_of(raw)
        faults, kinds = state.faults, state.faults.kind

        def repair(force: Array, read: Array) -> tuple[Array, Array]:
            nonlocal faults, kinds
            faults, force, sure, kinds = self._faults.sample(state.faults, force, read)
            return force, sure

        front, sample = self._front_end.observe(state.front, raw, reference, dt, repair)
        pending = state.pending * 0.0 if sample.gap else state.pending
        stand = any_along(sample.stance)[..., None]
        notes = xp.concat([sample.read, sample.swing, stand, sample.sound[..., None]], axis=-1)
        newest = xp.concat([sample.past, sample.motion, cast(notes, raw.dtype)], axis=-1)
        pending = xp.concat([pending[..., 1:, :], newest[..., None, :]], axis=-2)
        state = state._replace(front=front, step=state.step + 1, pending=pending, faults=faults)
        if sample.gap and 0.0 < dt < float("inf"):
            state = self._walked(state, min(dt, _LONGEST_PAUSE) / (self.config.every * self.setup.dt))
        if state.step % self.config.every:
            nothing = 0.0 * state.noise[..., 0]
            return state, self._estimate(state, sample, kinds, nothing + xp.nan, nothing)
        state, step = self._learn(state)
        return state, self._estimate(state, sample, kinds | state.faults.kind, step.nis, step.rows)

    def _learn(self, state: MomentState) -> tuple[MomentState, KalmanStep]:
        """Update the unknowns by the block that is full."""
        xp, mean, own = namespace_of(state.mean), state.mean, self._constants.like(state.mean)
        config = self.config
        block, read = self._block(state)
        faults = self._faults.silent(state.faults, block.force, read)
        block = block._replace(use=block.use * self._complete(faults, read))
        before, state = state.covariance, self._walked(state, 1.0)
        covariance = state.covariance
        spare = (faults.spare, faults.spare_std) if faults.altered else ()
        mass = self.unknowns.mass
        loaded = covariance[..., mass, mass] > _LOADED * self.unknowns.sure[mass]
        carried = {"loaded": loaded} if bool(xp.any(loaded)) else {}
        rows, places = self.newton_euler.rows(mean, block, state.noise, *spare, **carried)
        assumed = rows.variance / xp.concat([state.noise] * (config.every // config.average), axis=-1)
        rows = self._bilinear(rows, places, covariance)
        residuals = Residuals.of(rows, mean, covariance)
        newton, rejected = self._plausible(rows, residuals, covariance, assumed)
        waiting = self._faults.suspects(faults, residuals)
        # What still seems wrong when no channel was found to be is the robot itself.
        changed = self._changed(mean, covariance, newton) | self._faults.unexplained(faults)
        changed = changed & (faults.trust >= _SETTLED) & ~waiting
        faults = faults._replace(trust=xp.where(changed, TRUST, faults.trust))
        covariance = covariance + xp.where(changed[..., None, None], own.change, 0.0)
        quiet, anchor, learnt_from = self._quiet(state, block, newton)
        if bool(xp.any(block.swing > 0.5)):
            tare, doubted = self._tare(mean, covariance, state.drift, block, faults)
            learnt_from, rejected = learnt_from.beside(tare), rejected | doubted
        if self.parity.matters:
            parity = self.parity.rows(mean, block)
            if faults.altered:
                parity = parity.keep(xp.astype(xp.all(faults.lost < 0.5, axis=-1), mean.dtype)[..., None])
            learnt_from = learnt_from.beside(parity)
        learnt_from = learnt_from.keep(xp.astype(~waiting, mean.dtype)[..., None])
        # The mass only while it is much less sure than it began, the centre of mass until strides repeat.
        unsure = xp.linalg.diagonal(covariance) > own.sure
        learnt = own.learnt * xp.astype(unsure, mean.dtype)
        step = kalman_step(mean, covariance, *learnt_from, learnt, own.identity, config.gate)
        low, high = self._limits(state.drift)
        clipped = xp.clip(step.mean, low, high)
        rejected = rejected | xp.any(clipped != step.mean, axis=-1)
        finite = xp.all(xp.isfinite(step.mean), axis=-1)
        finite = finite & xp.all(xp.isfinite(step.covariance), axis=(-2, -1))
        # A robot of which nothing is used, as somebody holds it, says nothing of the motion that it had.
        unused = waiting | ~xp.any(newton.H != 0.0, axis=(-2, -1))
        state = state._replace(
            unproven=xp.where(unused, state.unproven, xp.clip(state.unproven - 1.0, 0.0, None)),
            mean=xp.where(finite[..., None], clipped, mean),
            covariance=xp.where(finite[..., None, None], step.covariance, before),
            misfit=xp.where(unused, state.misfit, followed_misfit(state.misfit, residuals)),
            quiet=quiet,
            anchor=anchor,
            status=int(Flag.REJECTED) * rejected | int(Flag.SINGULAR) * (~finite),
        )
        state = self._watch(state, faults, mean, block, rows, places, residuals)
        # What no fault and no load explains is noise; a robot that stands shows little of it.
        kept = unused | (quiet > 0.5) | self._faults.explicable(state.faults)
        noise = xp.where(kept[..., None], state.noise, followed_noise(state.noise, residuals))
        return state._replace(noise=noise), step

    def _bilinear(self, rows: Rows, places: Array, covariance: Array) -> Rows:
        """Allow for the product of the errors of scales and offsets, which columns leave out."""
        xp, unknowns, own = namespace_of(covariance), self.unknowns, self._constants.like(covariance)
        variance = xp.linalg.diagonal(covariance)
        # Hardly any sensor is as far off in both as the filter begins with.
        product = unknowns.own_scales(variance) * variance[..., unknowns.offset] / FIRST_WIDTH**2
        lever = places * own.unit
        more = _SHARED * ((lever * lever) @ product[..., None])[..., 0]
        return rows._replace(variance=rows.variance + more)

    def _walked(self, state: MomentState, blocks: float) -> MomentState:
        """Return the state after the time of some blocks in which the unknowns have drifted."""
        own = self._constants.like(state.mean)
        of_map = self.unknowns.map
        return state._replace(
            covariance=state.covariance + blocks * own.walk,
            drift=state.drift + blocks * own.drift,
            given_covariance=state.given_covariance + blocks * own.walk[of_map, of_map],
        )

    def _back(self, state: MomentState, which: Array) -> MomentState:
        """Return the state with what some robots, shape (...), knew some seconds ago."""
        xp, those = namespace_of(state.mean), which[..., None, None]
        return state._replace(
            mean=xp.where(which[..., None], state.kept_mean[..., 0, :], state.mean),
            covariance=xp.where(those, state.kept_covariance[..., 0, :, :], state.covariance),
            pending=xp.where(those, 0.0, state.pending),
        )

    def _doubted(self, state: MomentState, which: Array) -> MomentState:
        """Return the state in which some robots, shape (...), hand out what they know now for a while."""
        xp = namespace_of(state.mean)
        proven = state._replace(unproven=xp.where(which, 0.0, state.unproven))
        proven = self._given(proven, xp.where(which[..., None], xp.nan, state.mean))
        return proven._replace(unproven=xp.where(which, float(self._keep_every), state.unproven))

    def _limits(self, drift: Array) -> tuple[Array, Array]:
        """Return the bounds of what a sensor can be, by where it began and how far it can have drifted."""
        xp, own = namespace_of(drift), self._constants.like(drift)
        # Errors of the reference may change, when a load is picked up; a sensor only drifts.
        others = xp.inf + own.start[self.unknowns.map.stop :] + 0.0 * drift[..., :1]
        sensors = xp.sqrt(self._severity.first(drift))
        reach = _REACH * xp.concat([sensors, others], axis=-1)
        return own.start - reach, own.start + reach

    def _given(self, state: MomentState, before: Array) -> MomentState:
        """Return the state with what is handed out: the unknowns by a prior that was learnt as well.

        It moves only where the unknowns did, as without new rows only the uncertainty changes, and not while
        they are unproven: a fall shows some moments after it has begun.
        """
        xp, of_map = namespace_of(state.mean), self.unknowns.map
        learnt, covariance = self._severity.reweighted(
            state.mean, state.covariance, state.drift, state.misfit
        )
        mean = xp.concat([learnt, state.mean[..., of_map.stop :]], axis=-1)
        proven = state.unproven < 0.5
        mean = xp.where((any_along(state.mean != before) & proven)[..., None], mean, state.given)
        covariance = xp.where(proven[..., None, None], covariance, state.given_covariance)
        of_channels = self._uncertainty.of_parameters(mean, covariance)
        return state._replace(
            given=mean,
            given_covariance=covariance,
            learnt=of_channels,
            spread=self._uncertainty.of_channels(of_channels),
        )

    def _watch(
        self,
        state: MomentState,
        faults: ChannelState,
        before: Array,
        block: Block,
        rows: Rows,
        places: Array,
        residuals: Residuals,
    ) -> MomentState:
        """Look for faults in what the block left unexplained; and go back to before one that is found."""
        xp, unknowns, own = namespace_of(before), self.unknowns, self._constants.like(before)
        reading = self.newton_euler.readings(block)
        force = unknowns.force(before[..., None, :], reading, own.unit)
        fresh = xp.any(faults.lost != state.faults.lost, axis=-1)
        seen = Contradiction(
            residuals=residuals,
            places=places,
            reading=reading,
            scale=unknowns.own_scales(before),
            force=force,
            load=rows.H[..., unknowns.load],
            mass=before[..., unknowns.mass],
        )
        faults, found, loaded = self._faults.contradicted(faults, seen)
        found = found | fresh
        used = xp.all(block.use > 0.5, axis=-1) & ~found
        given = unknowns.force(state.given[..., None, :], reading, own.unit)
        faults = self._faults.learn(faults, given, used)
        more = xp.where(loaded[..., None, None], own.change, 0.0)
        state = state._replace(faults=faults, covariance=state.covariance + more)
        if bool(xp.any(found)):
            state = self._back(state, found)
        state = self._given(state, before)
        if (state.step // self.config.every) % self._keep_every == 0:
            state = state._replace(
                kept_mean=xp.stack([state.kept_mean[..., 1, :], state.mean], axis=-2),
                kept_covariance=xp.stack([state.kept_covariance[..., 1, :, :], state.covariance], axis=-3),
            )
        return state

    def _complete(self, faults: ChannelState, read: Array) -> Array:
        """Return which samples have all readings that they need (0 or 1), shape (..., n)."""
        xp = namespace_of(read)
        replaced = (faults.lost > 0.5) & (faults.spare_std < _UNSURE * self.setup.weight)
        complete = xp.all((read > 0.5) | replaced[..., None, :], axis=-1)
        complete = complete & xp.all((faults.lost < 0.5) | replaced, axis=-1)[..., None]
        return xp.astype(complete, read.dtype)

    def _block(self, state: MomentState) -> tuple[Block, Array]:
        """Return the samples that wait as a block, and which channels were read, shape (..., n, K)."""
        pending, at = state.pending, self._pending
        motion = pending[..., at.motion]
        _, _, physical = self._front_end.motions.ground(motion)
        sound, stand = pending[..., at.sound][..., 0], pending[..., at.stand][..., 0]
        use = sound * namespace_of(pending).astype(physical, pending.dtype)
        block = Block(pending[..., at.force], motion, pending[..., at.swing], use, stand)
        return block, pending[..., at.read]

    def _quiet(self, state: MomentState, block: Block, rows: Rows) -> tuple[Array, Array, Rows]:
        """Take a robot that stands still for one measurement, however long it stands.

        Without a change of load all blocks measure the same; what their readings still do is noise and drift,
        and a scale that should explain why the motion does not follow them would come out too small.
        """
        xp = namespace_of(block.force)
        high, low = xp.max(block.force, axis=-2), xp.min(block.force, axis=-2)
        middle, limit = 0.5 * (high + low), self.config.still * self._constants.like(block.force).unit
        moved = xp.any((high - low >= 2.0 * limit) | (xp.abs(middle - state.anchor) > limit), axis=-1)
        quiet = xp.where(moved, 0.0, state.quiet + 1.0)
        anchor = xp.where(moved[..., None], middle, state.anchor)
        return quiet, anchor, rows._replace(variance=rows.variance * ((1.0 + quiet) ** 2)[..., None])

    def _plausible(
        self, rows: Rows, residuals: Residuals, covariance: Array, assumed: Array
    ) -> tuple[Rows, Array]:
        """Leave out groups of rows that no error of calibration explains, such as of a lifted robot.

        Noise that is learnt, or expected at first, is no reason to learn from such rows: they are held
        against the variances that are assumed, shape (..., m), and sensors against what is stated of them.
        """
        e, kinds = residuals.residual, self.newton_euler.kinds
        xp = namespace_of(e)
        H = rows.H / self._constants.like(e).wide
        variance = xp.sum((H @ covariance) * H, axis=-1) + assumed
        wrong = (xp.abs(e) > self.config.reject) & (e * e > _REJECT_STD**2 * variance)
        groups = xp.any(xp.reshape(wrong, (*e.shape[:-1], -1, kinds)), axis=-1)
        keep = xp.reshape(xp.stack([~groups] * kinds, axis=-1), tuple(e.shape))
        return rows.keep(xp.astype(keep, e.dtype)), xp.any(groups, axis=-1)

    def _changed(self, mean: Array, covariance: Array, rows: Rows) -> Array:
        """Return where the force of a whole block leaps away from what the motion asks for (bool)."""
        xp, which = namespace_of(mean), slice(self.newton_euler.vertical, None, self.newton_euler.kinds)
        H = rows.H[..., which, :]
        there = xp.astype(xp.any(H != 0.0, axis=-1), mean.dtype)
        count = xp.sum(there, axis=-1)
        count = xp.where(count > 0.5, count, 1.0)
        row = xp.sum(H, axis=-2) / count[..., None]
        e = xp.sum(rows.y[..., which], axis=-1) / count - xp.sum(row * mean, axis=-1)
        spread = (row[..., None, :] @ covariance @ row[..., None])[..., 0, 0]
        spread = spread + xp.sum(rows.variance[..., which] * there, axis=-1) / count**2
        return (e * e > _LEAP_STD**2 * spread) & (xp.abs(e) > _LEAST_CHANGE * self.config.mass_change)

    def _tare(
        self, mean: Array, covariance: Array, drift: Array, block: Block, faults: ChannelState
    ) -> tuple[Rows, Array]:
        """Write the tare of feet that hang, unless they carry weight."""
        xp, of_map = namespace_of(mean), self.unknowns.map
        count, reading = self.tare.hanging(block)
        load, row = self.tare.load(mean, reading, faults.spare if faults.altered else None)
        # As it is known to, and before anything was learnt to what is stated.
        stated = xp.sum(row * row * self._severity.stated(drift)[..., None, :], axis=-1)
        known = xp.sum((row @ covariance[..., of_map, of_map]) * row, axis=-1)
        spread = xp.where(known < stated, known, stated)
        limit = self.config.swing_load + _LOAD_STD * xp.sqrt(xp.clip(spread, 0.0, None))
        doubted = (count > 0.5) & (xp.abs(load) > limit)
        # Not all feet of a robot that stands are in the air.
        doubted = doubted | xp.all(count > 0.5, axis=-1)[..., None]
        count = xp.where(doubted, 0.0, count)
        rows = self.tare.rows(mean, block, count, reading)
        return rows.keep(1.0 - faults.lost) if faults.altered else rows, xp.any(doubted, axis=-1)

    def _estimate(
        self, state: MomentState, sample: Sample, kinds: Array, nis: Array, nis_rows: Array
    ) -> Estimate:
        """Apply the map to the newest sample, with how sure it is."""
        unknowns, own = self.unknowns, self._constants.like(sample.force)
        forces = [
            unknowns.force(state.given, part, own.unit)
            for part in (sample.force, sample.ahead)
            if part is not None
        ]
        if state.faults.altered:
            forces = [(state.faults.spare @ force[..., None])[..., 0] for force in forces]
        a, b = unknowns.own_scales(state.given), unknowns.offsets(state.given, own.unit)
        status = state.status[..., None] | kinds
        maps = a * own.scale, a * own.offset + b
        estimate = self._front_end.report(sample, forces[0], *maps, status, None, *forces[1:])
        sure = self._uncertainty.of_estimate(estimate, sample, state)
        return estimate._replace(**sure, nis=nis, nis_rows=nis_rows)


def moment_filter(setup: OnlineSetup, config: MomentFilterConfig | None = None) -> OnlineMethod:
    """Return the moment filter as a pair of pure functions.

    Args:
        setup: The robot.
        config: Options.
    """
    stream = MomentStream(setup, config or MomentFilterConfig())
    return OnlineMethod(stream.init, stream.update, stream.retract)
