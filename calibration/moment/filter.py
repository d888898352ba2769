"""How the moment filter runs over a stream; its theory is in :mod:`surefoot.calibration.moment.config`."""

from typing import Any

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.calibration.front_end.readings import FrontEnd, Sample
from surefoot.calibration.moment.blocks import Block, Blocks
from surefoot.calibration.moment.columns import Columns, Spread, first_mean, first_variance
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.faults import ChannelFaults, ChannelState
from surefoot.calibration.moment.health import (
    contact_probability,
    map_covariance,
    uncertainty,
)
from surefoot.calibration.moment.model import Model, Rows
from surefoot.calibration.moment.modes import (
    FIRST_CHANCE,
    FREE,
    MODES,
    STEADY,
    begin_momentum,
    learn,
    mix,
    support_probability,
    weigh_modes,
)
from surefoot.calibration.moment.motion import Track
from surefoot.calibration.moment.repairs import Repairs
from surefoot.calibration.moment.reweigh import reweigh
from surefoot.calibration.moment.severity import Severity, Weighed
from surefoot.calibration.moment.state import (
    Belief,
    Kept,
    MomentState,
    Publication,
    TareState,
    TiltState,
    VersusStartState,
)
from surefoot.calibration.moment.still import Still
from surefoot.calibration.moment.suspects import CONTRAST, Leap
from surefoot.calibration.moment.tare import NOISE_TIME, Tare
from surefoot.calibration.moment.versus_start import VersusStart
from surefoot.calibration.reference import MomentumReference, Reference
from surefoot.calibration.setup import OnlineMethod, OnlineSetup

LEAP, LEAP_RATE = 0.25, 75.0
"""Change of a cell's force from one sample to the next in body weights that no foot makes, and the same by
the time between samples in body weights a second: a G1 by two policies lands with up to 1.5 weights on one
corner within 20 ms."""

LEAP_ALONE, LEAP_ALONE_RATE = 0.075, 12.0
"""The same of one cell of a foot that is surely on the ground: 0.15 at 80 Hz, which no cell of a NAO, OP3 or
T1 exceeded."""

SHARES_TIME = 20.0  # time in s over which is learnt how the cells of a foot share its load

KEPT_TIME = 1.5
"""Time in s between states that are kept to go back to: a fall takes a second before anybody notices. None
is kept while something speaks against the readings."""

LONGEST_PAUSE = 3600.0  # time in s beyond which a pause adds no more drift
PRODUCT_TIME = 20.0  # time in s over which a zero that drifts is one error and not many

LARGEST_ERROR = 0.5
"""Vertical force in W that is off by no error of calibration: the robot is not on its feet."""

LEVEL, ANY_WAY = 0.7, -2.0
"""Cosine of a flat sole's angle to the ground below which nobody stands on it, 45 degrees; and one that no
angle has, for feet that are balls."""

LEAST_READ = 0.25
"""Share of a block's samples that must be read of each channel: chips at 27 Hz read at 80 Hz."""

HELD_CHANCE = 0.9
"""Probability of support above which HELD is set: one false alarm in ten while nothing is known yet."""


class MomentFilter:
    """The moment filter for one setup: pure functions that share constants.

    Args:
        setup: The robot.
        config: Options.

    Attributes:
        setup: The same.
        config: The same.
        columns: The unknowns.
        spread: How sure they are at the start, as stated.
        first_variance: Variances at the start, shape (N,).
        reading_noise: Standard deviation of a channel's reading in N.
        ahead: Mean time in s from the readings that a map was learnt from to those that it is applied to.
        level: :data:`LEVEL`, or :data:`ANY_WAY`.
        front_end: The way of a sample.
        faults: Finds faults of channels.
        repairs: Finds wrong readings by the robot's motion.
        blocks: Makes blocks of samples.
        model: Makes rows of blocks.
        tare: Tares feet.
        still: Keeps scales from what readings of a robot that stands still change by.
    """

    def __init__(self, setup: OnlineSetup, config: Moment) -> None:
        self.setup, self.config = setup, config
        layout = setup.layout
        self._channels = layout.channels
        self.columns = columns = Columns.of(layout)
        self.spread = spread = Spread.of(setup, config)
        self.front_end = FrontEnd(setup, imu=False, momentum=True)
        self.model = Model(setup, config, columns)
        self.tare, self._severity = Tare(setup, config, columns, spread), Severity(columns, spread)
        self.still = Still.of(columns, spread, self.tare.variance)
        six_axis = all(sensor.six_axis for foot in layout.feet for sensor in foot.sensors)
        # The words of a six-axis sensor come together: one that leaps away alone is a landing.
        leaps = max(LEAP, LEAP_RATE * setup.dt), max(LEAP_ALONE, LEAP_ALONE_RATE * setup.dt)
        leaps = (np.inf, np.inf) if six_axis else leaps
        self.faults = ChannelFaults(setup, *leaps, SHARES_TIME / config.block)
        self.repairs = Repairs(layout, setup.weight, self.faults, columns, VersusStart(columns, config))
        self.blocks = Blocks(self.front_end, config.block, self.faults)
        self._first_mean, self.first_variance = first_mean(columns), first_variance(columns, spread, config)
        self.reading_noise = config.tare_noise * float(np.sqrt(NOISE_TIME / setup.dt)) * setup.weight
        # A block is learnt from a sample after its end, of late readings, and its map holds for a block.
        self.ahead = 0.5 * config.block + (setup.lag + 1) * setup.dt
        self.level = LEVEL if all(foot.flat for foot in layout.feet) else ANY_WAY

    @property
    def limits(self) -> dict[str, tuple[Any, Any]]:
        """Limits of the state: scales are of order one, forces and momenta are in body weights."""
        most, weight = self.setup.plausible_weights, self.setup.weight
        shares = dict.fromkeys(("chance", "undetermined"), (0.0, 1.0))
        return (
            self.front_end.limits | shares | {"mean": (-most, most), "shift": (-most * weight, most * weight)}
        )

    def init(self, raw: Array) -> MomentState:
        """Return the state before any sample; see :class:`~surefoot.calibration.setup.OnlineMethod`."""
        front, columns = self.front_end.init(raw), self.columns
        J = len(MODES)
        covariance = np.tile(np.diag(self.first_variance), (J, 1, 1))
        belief = Belief(np.tile(self._first_mean, (J, 1)), covariance, FIRST_CHANCE.copy(), np.zeros(2))
        published = self._weigh(belief, 0.0).publish(belief.chance)
        zero = np.zeros(self._channels)
        tare = self.tare.init()
        resting = np.asarray(self.setup.initial.scale) * front.raw + np.asarray(self.setup.initial.offset)
        return MomentState(
            front=front,
            track=Track.begin(front.motion),
            faults=self.faults.init(resting),
            pending=np.zeros((self.blocks.capacity, self.blocks.width)),
            before=np.zeros(self.blocks.width),
            waiting=-1,
            linked=0,
            point=np.zeros(3),
            time=0.0,
            belief=belief,
            drifted=0.0,
            tare=tare,
            still=self.still.init(),
            suspects=self.repairs.suspects.init(self.blocks.capacity),
            versus_start=VersusStartState.begin(columns.components),
            tilt=TiltState(np.zeros(2), 0.0),
            shift=zero,
            published=published,
            covariance=self._map_covariance(published, 1.0),
            kept=Kept.begin(belief, published, tare),
            status=0,
        )

    def retract(self, state: MomentState) -> MomentState:
        """Take back the last seconds' learning; see :class:`~surefoot.calibration.setup.OnlineMethod`."""
        belief, published, tare = state.kept[:3]
        # How fast zeros drift was seen, whatever came of it.
        tare = tare._replace(rate=state.tare.rate, followed=state.tare.followed)
        return self.blocks.break_off(state)._replace(
            belief=belief,
            published=published,
            tare=tare,
            covariance=self._map_covariance(published, tare.rate),
            kept=Kept.begin(belief, published, tare),
        )

    def adopt(self, state: MomentState, share: float) -> MomentState:
        """Go on from a saved state; see :class:`~surefoot.calibration.setup.OnlineMethod`."""
        fresh = self.init(np.zeros(self._channels))
        if share != 1.0:
            state = reweigh(state, fresh, share, self.columns)
            published = self._weigh(state.belief, state.drifted).publish(state.belief.chance)
            state = state._replace(
                published=published,
                covariance=self._map_covariance(published, state.tare.rate),
                kept=Kept.begin(state.belief, published, state.tare),
            )
        # Sensors may have changed while the robot was off.
        return state._replace(versus_start=fresh.versus_start)

    def update(
        self, state: MomentState, raw: Array, reference: Reference | MomentumReference, dt: float
    ) -> tuple[MomentState, Estimate]:
        """Take in one sample; see :class:`~surefoot.calibration.setup.OnlineMethod`."""
        faults, kinds = state.faults, state.faults.kind
        scale = state.published.mean[self.columns.scale]

        def repair(force: Array, read: Array) -> tuple[Array, Array]:
            nonlocal faults, kinds
            faults, force, sure, kinds = self.faults.sample(
                state.faults, force, read, scale, reference.stance
            )
            return force - state.shift, sure

        front, sample = self.front_end.observe(state.front, raw, reference, dt, repair)
        if len(front.history) > 2:
            # The newest reading may still turn out to be an outlier.
            history, weight = front.history.copy(), self.setup.weight
            before, row, after = history[-3:, : 2 * self._channels]
            row[:] = self.faults.smooth(before, row, after, weight)
            front = front._replace(history=history)
        # The other channels of a plate stand in for one that is out.
        stands_in = (faults.lost > 0.5) & (self.faults.stand_in.count_lost(faults.lost) < 1.5)
        silent = np.where(stands_in, 0.0, sample.silent)
        front, sample = front._replace(silent=silent), sample._replace(silent=silent)
        state = state._replace(front=front, faults=faults)
        if sample.gap and 0.0 < dt < np.inf:
            state = self._age(state, min(dt, LONGEST_PAUSE))
        if self._lies(sample):
            # The learning of the fall is taken back, once.
            state = self.retract(state) if state.track.samples else state
            state = state._replace(status=int(Flag.REJECTED))
        else:
            state = self.blocks.collect(state, sample, isinstance(reference, MomentumReference), dt)
        nis, rows = np.nan, 0.0
        if self.blocks.full(state):
            state, nis, rows = self._learn(state)
            kinds = kinds | state.faults.kind
        return state, self._estimate(state, sample, kinds, nis, rows)

    def _begin_again(self, state: MomentState, faults: ChannelState) -> MomentState:
        """Know nothing but the readings' faults and what feet in the air showed."""
        fresh = self.init(state.front.raw)
        belief = self.tare.repeat(fresh.belief, state.tare, state.time, faults.lost)
        published = self._weigh(belief, 0.0).publish(belief.chance)
        return self.blocks.break_off(state)._replace(
            faults=faults,
            belief=belief,
            drifted=0.0,
            suspects=fresh.suspects,
            versus_start=fresh.versus_start,
            published=published,
            covariance=self._map_covariance(published, state.tare.rate),
            kept=Kept.begin(belief, published, state.tare),
            status=0,
        )

    def _lies(self, sample: Sample) -> bool:
        """Return whether no sole is level enough to stand on."""
        _, rotation = self.front_end.motions.columns.soles(sample.motion)
        return bool(sample.sound and rotation[:, 2, 2].max() < self.level)

    def _age(self, state: MomentState, duration: float) -> MomentState:
        """Let scales and zeros drift for a time in s."""
        walked = self.spread.walk * state.tare.rate**2 * duration
        covariance = state.belief.covariance.copy()
        columns = self.columns
        at = np.arange(columns.scale.stop)
        drift = at + columns.drift.start
        covariance[:, at, at] += walked[0]
        covariance[:, drift, drift] += walked[1] * state.published.mean[at] ** 2
        return state._replace(
            belief=state.belief._replace(covariance=covariance),
            drifted=state.drifted + float(walked[0, 0]),
            time=state.time + duration,
        )

    def _learn(self, state: MomentState) -> tuple[MomentState, float, float]:
        """Learn from the block that is full; return its innovation squared, normalised, and its rows too."""
        block = self.blocks.block(state)
        state = self._age(state, block.duration)
        faults, idle = self.faults.silent(state.faults, block.force * self.setup.weight, block.read)
        if idle:
            # All that was learnt made up for a cell that bore nothing.
            return self._begin_again(state, faults), np.nan, 0.0
        if (faults.lost > state.faults.lost).any():
            # The last seconds' learning came from wrong readings.
            return self.retract(state)._replace(faults=faults), np.nan, 0.0
        state = self.blocks.begin(state)._replace(faults=faults, status=0)
        if ((block.read.mean(axis=0) < LEAST_READ) & (faults.lost < 0.5)).any():
            return self._rest(state, block, good=False)._replace(linked=0), np.nan, 0.0
        known, lost, time = state.published.mean, faults.lost, state.time
        belief, still, tare = self.still.take(block, time, state.belief, known, state.still, state.tare, lost)
        state = state._replace(still=still)
        belief, published, tare, wrong_zero = self.tare.take(block, time, belief, known, tare, lost)
        if wrong_zero:
            return self._begin_again(state._replace(tare=tare), faults), np.nan, 0.0
        if (self.faults.stand_in.count_lost(faults.lost) > 1.5).any():
            # Nothing stands in for two cells of a plate; zeros are seen without them.
            zeros = state.published._replace(mean=published)
            state = state._replace(published=zeros, linked=0)
            return self._rest(state, block, good=False), np.nan, 0.0
        spare = faults.spare if faults.lost.any() else None
        rows = self.model.rows(block, published, self._lasting(state, tare), spare)
        belief, tilt = self.model.allow_for_tilt(belief, state.tilt, rows, block.duration)
        state = state._replace(tilt=tilt)
        # Accelerations of a robot of which no foot stands are held by nothing: its feet are tared, no more.
        follows, rejected = bool(state.linked and state.track.valid), False
        if follows:
            state, belief, wrong, ahead = self._follow(state, block, rows, published, belief)
            if wrong is not None:
                return self.repairs.repair(self.retract(state), wrong), np.nan, 0.0
            rejected = abs(ahead) > 0.5 * LARGEST_ERROR * block.duration
        if follows and not rejected:
            belief, weighed, nis = self._update(belief, rows, block.duration, state.drifted)
        else:
            belief = begin_momentum(belief, rows, self.columns)
            weighed, nis = self._weigh(belief, state.drifted), np.nan
        if not (np.isfinite(belief.mean).all() and np.isfinite(belief.covariance).all()):
            state = state._replace(linked=0, status=int(Flag.SINGULAR))
            return self._rest(state, block, good=False), np.nan, 0.0
        if not state.linked:
            suspects = self.repairs.suspects.read(state.suspects, block.force)
            state = state._replace(suspects=suspects._replace(before=rows.at_end))
        publication = weighed.publish(belief.chance)
        held = int(Flag.HELD) if support_probability(belief, self.columns) > HELD_CHANCE else 0
        status = int(Flag.REJECTED) if rejected else held
        state = state._replace(
            belief=belief,
            tare=tare,
            linked=int(state.track.valid),
            point=rows.point,
            published=publication,
            covariance=self._map_covariance(publication, tare.rate),
            status=status,
        )
        return self._rest(state, block, good=not status), nis, float(len(rows.measured))

    def _follow(
        self, state: MomentState, block: Block, rows: Rows, published: Array, belief: Belief
    ) -> tuple[MomentState, Belief, int | Leap | None, float]:
        """Move on to a block's point, and hold all suspects against the block.

        Returns:
            The state, the belief, what is wrong, and the innovation of the vertical momentum in W s.
        """
        transition, added = self.model.move(rows.point - state.point, block.velocity.mean(axis=0))
        belief = belief._replace(
            mean=belief.mean @ transition.T + added,
            covariance=transition @ belief.covariance @ transition.T,
        )
        likeliest = belief.mean[belief.chance.argmax()]
        ahead = rows.measured[0] - rows.mean[0] @ likeliest - rows.mean_rest[0]
        if MODES[belief.chance.argmax()] is STEADY:
            # Its wrench is known, and no error of the readings.
            wrench = self.columns.wrench
            rows = rows._replace(mean_rest=rows.mean_rest + rows.mean[:, wrench] @ likeliest[wrench])
        state, wrong = self.repairs.weigh(state, block, rows, published, belief, transition, added)
        return state, belief, wrong, float(ahead)

    def _update(
        self, belief: Belief, rows: Rows, duration: float, drifted: float
    ) -> tuple[Belief, Weighed, float]:
        """Update all modes by a block; return the posterior, its severities, and the NIS."""
        mixed = mix(belief, rows, self.columns, duration)
        step = learn(mixed, rows, self.columns, duration)
        before = self._severity.evidence(mixed.mean, mixed.covariance, drifted)
        weighed = self._weigh(step.belief, drifted)
        chance = weigh_modes(mixed.chance, step.likelihood + weighed.evidence - before)
        return step.belief._replace(chance=chance), weighed, step.nis

    def _rest(self, state: MomentState, block: Block, good: bool) -> MomentState:
        """Keep the state now and then, and learn how cells share loads."""
        a, b = self._line(state)
        faults = self.faults.learn(state.faults, a * block.force * self.setup.weight + b, good)
        kept = state.kept
        trusted = float(state.suspects.score.max()) < CONTRAST
        if kept.age + block.duration >= KEPT_TIME and trusted:
            kept = kept.keep(state.belief, state.published, state.tare)
        else:
            kept = kept._replace(age=kept.age + block.duration)
        return state._replace(faults=faults, kept=kept)

    def _lasting(self, state: MomentState, tare: TareState) -> Array:
        """Return variances of forces in W^2 that last and that no unknown stands for, shape (K,).

        The force that a zero has drifted by since its tare is as unsure as the scale is, and channels that
        are out are made of the others. Both last longer than an outside wrench: the variance is as much
        larger as that is shorter.
        """
        variance = np.diagonal(state.published.covariance)
        since = (state.time - np.maximum(tare.time, 0.0))[self.setup.layout.foot_of_channel]
        longer, longest = (
            np.maximum(np.minimum(time, PRODUCT_TIME) / (2.0 * FREE.time), 1.0) for time in (since, np.inf)
        )
        drifted = np.minimum(self.spread.walk[1] * tare.rate**2 * since, variance[self.columns.drift])
        product = longer * variance[self.columns.scale] * drifted
        lasting: Array = product + longest * (state.faults.spare_std / self.setup.weight) ** 2
        return lasting

    def _weigh(self, belief: Belief, drifted: float) -> Weighed:
        """Weigh all severities in each mode."""
        return self._severity.weigh(belief.mean, belief.covariance, drifted)

    def _map_covariance(self, published: Publication, rate: float) -> Array:
        """Return the covariance of (a, b) while a map is applied, of sensors that drift at a rate."""
        walked = self.spread.walk * rate**2 * self.ahead
        return map_covariance(published.mean, published.covariance, self.columns, self.setup.weight, walked)

    def _line(self, state: MomentState) -> tuple[Array, Array]:
        """Return a, and b in N, as they are handed out, shape (K,) each."""
        columns, mean = self.columns, state.published.mean
        return mean[columns.scale], (mean[columns.offset] + mean[columns.drift]) * self.setup.weight

    def _estimate(
        self, state: MomentState, sample: Sample, kinds: Array, nis: float, rows: float
    ) -> Estimate:
        """Apply the map, and say how sure it is."""
        setup, faults = self.setup, state.faults
        a, b = self._line(state)
        c, d = a * np.asarray(setup.initial.scale), a * (np.asarray(setup.initial.offset) - state.shift) + b
        force, ahead, aligned = (
            None if part is None else faults.spare @ (a * part + b)
            for part in (sample.force, sample.ahead, sample.aligned)
        )
        worse = int(Flag.WORSE_THAN_START) if state.versus_start.is_worse else 0
        flags = kinds | state.status | worse
        estimate = self.front_end.report(sample, force, c, d, flags, None, ahead, aligned)
        learnt = state.covariance
        return estimate._replace(
            **uncertainty(estimate, sample, learnt, faults.spare, faults.spare_std),
            nis=np.asarray(nis),
            nis_rows=np.asarray(rows),
            undetermined=state.published.undetermined,
            contact_probability=contact_probability(
                estimate.vgrf, sample.rows[:, 0], learnt, sample.force,
                self.reading_noise, setup.weight,
            ),
        )  # fmt: skip


def moment_filter(setup: OnlineSetup, config: Moment | None = None) -> OnlineMethod:
    """Return the moment filter as pure functions.

    Args:
        setup: The robot.
        config: Options.
    """
    made = MomentFilter(setup, config or Moment())
    return OnlineMethod(made.init, made.update, made.retract, made.limits, made.adopt)
