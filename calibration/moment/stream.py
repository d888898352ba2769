"""How the moment filter runs over a stream; private.

Its theory and options are in :mod:`surefoot.calibration.moment.config`, its rows in
:mod:`surefoot.calibration.moment.rows`. Samples wait until a block is full, so that most samples cost no
more than applying the map.
"""

from typing import Any, NamedTuple

import numpy as np
from array_api_compat import device as device_of

from surefoot.calibration._constants import Constants, any_along, cast, namespace_of
from surefoot.calibration._setup import OnlineMethod, OnlineSetup
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.calibration.front_end.readings import FrontEnd, FrontState, Sample
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.faults import TRUST, Faults, FaultState
from surefoot.calibration.moment.kalman import KalmanStep, kalman_step
from surefoot.calibration.moment.rows import Block, Misfit, MomentRows, Rows
from surefoot.calibration.moment.uncertainty import Uncertainty
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.reference import Reference

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""

_REJECT_STD = 8.0
"""Standard deviations beyond which a large innovation is no error of calibration."""

_LOUDEST = 100.0
"""By how many times variances are taken as larger than stated at most."""

_LEAP_STD = 5.0
"""Standard deviations of a block's mean vertical force beyond which the mass itself is doubted."""

_SETTLED = 50.0
"""Blocks in which all must have seemed well before the mass is doubted."""

_NOISE_MEMORY = 0.1
"""How much of the noise's factor one update renews."""

_UNSURE = 0.06
"""Standard deviation in body weights of a reconstructed force that is no use to learn with."""

_LONGEST_PAUSE = 3600.0
"""Time in s beyond which a pause adds no more drift."""

_UNSURE_MASS = 2.0
"""How many times less sure than at the start the mass is while it is estimated."""

_REACH = 5.0
"""Standard deviations from the starting map beyond which a sensor is not thought to be."""

_KEPT = 1.5
"""Time in s between the states that are kept to go back to."""


class MomentState(NamedTuple):
    """What the moment filter remembers; any leading batch dimensions ``...``; F feet.

    Attributes:
        front: What the way of a sample remembers.
        step: Samples seen.
        pending: The newest samples, oldest first: F0, the flat reference, which channels were read, which
            feet surely swing, whether any surely stands, whether the reference is sound, shape
            (..., every + 2 settle, P).
        mean: The unknowns, shape (..., N).
        covariance: Their covariance, shape (..., N, N).
        learnt: Covariance of (a, b) of each channel, shape (..., 2K, 2K).
        spread: Of that what single forces need, shape (..., 3, K).
        kept_mean: The unknowns of two moments of the last seconds, to go back to, shape (..., 2, N).
        kept_covariance: Their covariances, shape (..., 2, N, N).
        noise: By how many times rows' variances are taken as larger than stated, shape (..., kinds).
        quiet: Blocks in which the readings have not changed, shape (...).
        anchor: The readings from which on they have not, shape (..., K).
        status: Flags of the last update, shape (...).
        faults: What is known of faults.
    """

    front: FrontState
    step: int
    pending: Array
    mean: Array
    covariance: Array
    learnt: Array
    spread: Array
    kept_mean: Array
    kept_covariance: Array
    noise: Array
    quiet: Array
    anchor: Array
    status: Array
    faults: FaultState


class MomentStream:
    """The moment filter for one setup: ``init`` and ``update`` are pure functions that share constants."""

    def __init__(self, setup: OnlineSetup, config: MomentFilterConfig) -> None:
        self.setup, self.config = setup, config
        self.unknowns = unknowns = Unknowns(setup, config)
        self.rows = MomentRows(setup, config, unknowns)
        self._front_end = FrontEnd(setup)
        self._uncertainty = Uncertainty(setup, unknowns)
        self._load = [unknowns.com.start, unknowns.com.start + 1, unknowns.mass]
        self._faults = Faults(
            setup,
            config.leap,
            unknowns.change[self._load],
            config.stand_in_memory / (config.every * setup.dt),
        )
        self._keep_every = max(1, round(_KEPT / (config.every * setup.dt)))
        self._length = config.every + 2 * config.settle
        self._constants = Constants(
            unknowns.start,
            np.diag(unknowns.std**2),
            np.diag(unknowns.walk * config.every * setup.dt),
            unknowns.learnt,
            np.eye(unknowns.size),
            unknowns.unit,
            *(np.asarray(part, dtype=np.float64) for part in setup.initial),
            np.diag(unknowns.change**2),
        )

    def init(self, raw: Array) -> MomentState:
        """Begin with nothing seen; see :class:`~surefoot.calibration.online.OnlineMethod`."""
        front = self._front_end.init(raw)
        xp, device = namespace_of(raw), device_of(raw)
        batch, feet = tuple(raw.shape[:-1]), len(self.setup.layout.feet)
        start, covariance, *_, scale, offset, _ = self._constants.like(raw)

        learnt = self._uncertainty.of_parameters(covariance)

        def zeros(*tail: int, dtype: Any = raw.dtype) -> Array:
            return xp.zeros((*batch, *tail), dtype=dtype, device=device)

        return MomentState(
            front=front,
            step=0,
            pending=zeros(self._length, 2 * self.setup.layout.channels + front.motion.shape[-1] + feet + 2),
            mean=zeros(1) + start,
            covariance=zeros(1, 1) + covariance,
            learnt=zeros(1, 1) + learnt,
            spread=zeros(1, 1) + self._uncertainty.of_channels(learnt),
            kept_mean=zeros(2, 1) + start,
            kept_covariance=zeros(2, 1, 1) + covariance,
            noise=zeros(self.rows.kinds) + 1.0,
            quiet=zeros(),
            anchor=zeros(self.setup.layout.channels),
            status=zeros(dtype=xp.int64),
            faults=self._faults.init(raw, scale * front.raw + offset),
        )

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
            walk = self._constants.like(raw)[2] * (
                min(dt, _LONGEST_PAUSE) / (self.config.every * self.setup.dt)
            )
            state = state._replace(covariance=state.covariance + walk)
        if state.step % self.config.every:
            nothing = 0.0 * state.noise[..., 0]
            return state, self._estimate(state, sample, kinds, nothing + xp.nan, nothing)
        state, step = self._learn(state)
        return state, self._estimate(state, sample, kinds | state.faults.kind, step.nis, step.rows)

    def _learn(self, state: MomentState) -> tuple[MomentState, KalmanStep]:
        """Update the unknowns by the block that is full."""
        xp, mean = namespace_of(state.mean), state.mean
        _, _, walk, learnt, identity, *_ = self._constants.like(mean)
        block, read = self._block(state)
        faults = self._faults.silent(state.faults, block.force, read)
        block = block._replace(use=block.use * self._heard(faults, read))
        covariance = state.covariance + walk
        spare = (faults.spare, faults.spare_std) if faults.altered else ()
        rows, places = self.rows.total(mean, block, state.noise, *spare)
        misfit = Misfit.of(rows, mean, covariance)
        newton, rejected = self._plausible(rows, misfit)
        waiting = self._faults.suspects(faults, misfit)
        # What still seems wrong when no channel was found to be is the robot itself.
        changed = self._changed(mean, covariance, newton) | self._faults.baffled(faults)
        changed = changed & (faults.trust >= _SETTLED) & ~waiting
        faults = faults._replace(trust=xp.where(changed, TRUST, faults.trust))
        more = self._constants.like(mean)[-1]
        covariance = covariance + xp.where(changed[..., None, None], more, 0.0)
        quiet, anchor, learnt_from = self._quiet(state, block, newton)
        if bool(xp.any(block.swing > 0.5)):
            tare, doubted = self._tare(mean, covariance, block, faults)
            learnt_from, rejected = learnt_from.beside(tare), rejected | doubted
        if self.rows.compares:
            parity = self.rows.parity(block)
            if faults.altered:
                parity = parity.keep(xp.astype(xp.all(faults.lost < 0.5, axis=-1), mean.dtype)[..., None])
            learnt_from = learnt_from.beside(parity)
        learnt_from = learnt_from.keep(xp.astype(~waiting, mean.dtype)[..., None])
        learnt = self._learnt(covariance, learnt)
        step = kalman_step(mean, covariance, *learnt_from, learnt, identity, self.config.gate)
        low, high = self._limits(state.step, mean)
        clipped = xp.clip(step.mean, low, high)
        rejected = rejected | xp.any(clipped != step.mean, axis=-1)
        finite = xp.all(xp.isfinite(step.mean), axis=-1)
        finite = finite & xp.all(xp.isfinite(step.covariance), axis=(-2, -1))
        state = state._replace(
            mean=xp.where(finite[..., None], clipped, mean),
            covariance=xp.where(finite[..., None, None], step.covariance, state.covariance),
            noise=xp.where(
                (faults.doubt > 0.5)[..., None], state.noise, self._noise(state.noise, step, newton)
            ),
            quiet=quiet,
            anchor=anchor,
            status=int(Flag.REJECTED) * rejected | int(Flag.SINGULAR) * (~finite),
        )
        return self._watch(state, faults, mean, block, rows, places, misfit), step

    def _learnt(self, covariance: Array, learnt: Array) -> Array:
        """Tell which unknowns to estimate; the mass only while it is much less sure than it began."""
        xp, mass, config = namespace_of(covariance), self.unknowns.mass, self.config
        if not config.learn_mass:
            return learnt
        unsure = covariance[..., mass, mass] > (_UNSURE_MASS * config.mass_std) ** 2
        only = self._constants.like(covariance)[4][mass, :]
        return learnt * (1.0 - only * xp.astype(~unsure, covariance.dtype)[..., None])

    def _limits(self, step: int, like: Array) -> tuple[Array, Array]:
        """Bound what a sensor can be, by where it began and by how far it can have drifted."""
        xp = namespace_of(like)
        start, spread, walk, *_ = self._constants.like(like)
        reach = xp.linalg.diagonal(spread) + xp.linalg.diagonal(walk) * (step / self.config.every)
        # Errors of the reference may change, when a load is picked up; a sensor only drifts.
        known = self.unknowns.gains + self.unknowns.channels
        reach = _REACH * xp.concat([xp.sqrt(reach[..., :known]), xp.inf + reach[..., known:]], axis=-1)
        return start - reach, start + reach

    def _watch(
        self,
        state: MomentState,
        faults: FaultState,
        before: Array,
        block: Block,
        rows: Rows,
        places: Array,
        misfit: Misfit,
    ) -> MomentState:
        """Look for faults in what the block left unexplained; and go back to before one that is found."""
        xp, unknowns = namespace_of(before), self.unknowns
        reading = self.rows.readings(block)
        force = unknowns.force(before[..., None, :], reading, self._constants.like(before)[5])
        fresh = xp.any(faults.lost != state.faults.lost, axis=-1)
        faults, found, loaded = self._faults.contradicted(
            faults,
            misfit,
            places,
            reading,
            unknowns.own_gains(before),
            force,
            rows.H[..., self._load],
            before[..., unknowns.mass],
        )
        found = found | fresh
        used = xp.all(block.use > 0.5, axis=-1) & ~found
        faults = self._faults.learn(faults, force, used)
        more = xp.where(loaded[..., None, None], self._constants.like(before)[-1], 0.0)
        state = state._replace(faults=faults, covariance=state.covariance + more)
        if bool(xp.any(found)):
            old_mean, old_covariance = state.kept_mean[..., 0, :], state.kept_covariance[..., 0, :, :]
            state = state._replace(
                mean=xp.where(found[..., None], old_mean, state.mean),
                covariance=xp.where(found[..., None, None], old_covariance, state.covariance),
                pending=xp.where(found[..., None, None], 0.0, state.pending),
            )
        learnt = self._uncertainty.of_parameters(state.covariance)
        state = state._replace(learnt=learnt, spread=self._uncertainty.of_channels(learnt))
        if (state.step // self.config.every) % self._keep_every == 0:
            state = state._replace(
                kept_mean=xp.stack([state.kept_mean[..., 1, :], state.mean], axis=-2),
                kept_covariance=xp.stack([state.kept_covariance[..., 1, :, :], state.covariance], axis=-3),
            )
        return state

    def _heard(self, faults: FaultState, read: Array) -> Array:
        """Tell which samples have all readings that they need (0 or 1), shape (..., n)."""
        xp = namespace_of(read)
        replaced = (faults.lost > 0.5) & (faults.spare_std < _UNSURE * self.setup.weight)
        heard = xp.all((read > 0.5) | replaced[..., None, :], axis=-1)
        heard = heard & xp.all((faults.lost < 0.5) | replaced, axis=-1)[..., None]
        return xp.astype(heard, read.dtype)

    def _block(self, state: MomentState) -> tuple[Block, Array]:
        """Take the waiting samples apart; and which channels were read, shape (..., n, K)."""
        pending, K, feet = state.pending, self.setup.layout.channels, len(self.setup.layout.feet)
        xp, notes = namespace_of(pending), -K - feet - 2
        motion = pending[..., K:notes]
        _, _, physical = self._front_end.motions.ground(motion)
        use = pending[..., -1] * xp.astype(physical, pending.dtype)
        block = Block(pending[..., :K], motion, pending[..., -feet - 2 : -2], use, pending[..., -2])
        return block, pending[..., notes : notes + K]

    def _quiet(self, state: MomentState, block: Block, rows: Rows) -> tuple[Array, Array, Rows]:
        """Take a robot that stands still for one measurement, however long it stands.

        Without a change of load all blocks say the same; what their readings still do is noise and drift,
        and a gain that should explain why the motion does not follow them would come out too small.
        """
        xp = namespace_of(block.force)
        high, low = xp.max(block.force, axis=-2), xp.min(block.force, axis=-2)
        middle, limit = 0.5 * (high + low), self.config.still * self._constants.like(block.force)[5]
        moved = xp.any((high - low >= 2.0 * limit) | (xp.abs(middle - state.anchor) > limit), axis=-1)
        quiet = xp.where(moved, 0.0, state.quiet + 1.0)
        anchor = xp.where(moved[..., None], middle, state.anchor)
        return quiet, anchor, rows._replace(variance=rows.variance * ((1.0 + quiet) ** 2)[..., None])

    def _plausible(self, rows: Rows, misfit: Misfit) -> tuple[Rows, Array]:
        """Leave out groups of rows that no error of calibration explains, such as of a lifted robot."""
        e = misfit.residual
        xp, kinds = namespace_of(e), self.rows.kinds
        wrong = (xp.abs(e) > self.config.reject) & (e * e > _REJECT_STD**2 * misfit.variance)
        groups = xp.any(xp.reshape(wrong, (*e.shape[:-1], -1, kinds)), axis=-1)
        keep = xp.reshape(xp.stack([~groups] * kinds, axis=-1), tuple(e.shape))
        return rows.keep(xp.astype(keep, e.dtype)), xp.any(groups, axis=-1)

    def _changed(self, mean: Array, covariance: Array, rows: Rows) -> Array:
        """Tell where the force of a whole block leaps away from what the motion asks for (bool)."""
        xp, which = namespace_of(mean), slice(self.rows.vertical, None, self.rows.kinds)
        H = rows.H[..., which, :]
        there = xp.astype(xp.any(H != 0.0, axis=-1), mean.dtype)
        count = xp.sum(there, axis=-1)
        count = xp.where(count > 0.5, count, 1.0)
        row = xp.sum(H, axis=-2) / count[..., None]
        e = xp.sum(rows.y[..., which], axis=-1) / count - xp.sum(row * mean, axis=-1)
        spread = (row[..., None, :] @ covariance @ row[..., None])[..., 0, 0]
        spread = spread + xp.sum(rows.variance[..., which] * there, axis=-1) / count**2
        return (e * e > _LEAP_STD**2 * spread) & (xp.abs(e) > 0.5 * self.config.mass_change)

    def _tare(self, mean: Array, covariance: Array, block: Block, faults: FaultState) -> tuple[Rows, Array]:
        """Write the tare of feet that hang, unless they carry weight."""
        xp = namespace_of(mean)
        count, reading = self.rows.hanging(block)
        row = self.rows.load(reading, faults.spare if faults.altered else None)
        known = row.shape[-1]
        load = (row @ mean[..., :known, None])[..., 0]
        spread = xp.sum((row @ covariance[..., :known, :known]) * row, axis=-1)
        limit = self.config.swing_load + 4.0 * xp.sqrt(xp.clip(spread, 0.0, None))
        doubted = (count > 0.5) & (xp.abs(load) > limit)
        # Not all feet of a robot that stands are in the air.
        doubted = doubted | xp.all(count > 0.5, axis=-1)[..., None]
        count = xp.where(doubted, 0.0, count)
        rows = self.rows.tare(block, count, reading)
        return rows.keep(1.0 - faults.lost) if faults.altered else rows, xp.any(doubted, axis=-1)

    def _noise(self, noise: Array, step: KalmanStep, rows: Rows) -> Array:
        """Follow how large innovations are against what is stated; never take noise for less than that."""
        xp = namespace_of(noise)
        count = rows.y.shape[-1]
        e, predicted = step.innovation[..., :count], step.predicted[..., :count]
        there = xp.astype(xp.any(rows.H != 0.0, axis=-1), noise.dtype)
        surplus = (xp.clip(e * e / (predicted + rows.variance), 0.0, 9.0) - 1.0) * there
        surplus = xp.mean(xp.reshape(surplus, (*noise.shape[:-1], -1, self.rows.kinds)), axis=-2)
        return xp.clip(noise * (1.0 + _NOISE_MEMORY * surplus), 1.0, _LOUDEST)

    def _estimate(
        self, state: MomentState, sample: Sample, kinds: Array, nis: Array, nis_rows: Array
    ) -> Estimate:
        """Apply the map to the newest sample, and say how sure it is."""
        unknowns = self.unknowns
        *_, unit, scale, offset, _ = self._constants.like(sample.force)
        force = unknowns.force(state.mean, sample.force, unit)
        faults = state.faults if state.faults.altered else None
        if faults is not None:
            force = (faults.spare @ force[..., None])[..., 0]
        a, b = unknowns.own_gains(state.mean), state.mean[..., unknowns.offset] * unit
        status = state.status[..., None] | kinds
        estimate = self._front_end.report(sample, force, a * scale, a * offset + b, status)
        sure = self._uncertainty.told(estimate, sample, state)
        return estimate._replace(**sure, nis=nis, nis_rows=nis_rows)


def moment_filter(setup: OnlineSetup, config: MomentFilterConfig | None = None) -> OnlineMethod:
    """Return the moment filter as a pair of pure functions.

    Args:
        setup: The robot.
        config: Options.
    """
    stream = MomentStream(setup, config or MomentFilterConfig())
    return OnlineMethod(stream.init, stream.update)
