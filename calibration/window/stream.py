"""How the sliding window runs over a stream: standing start, filter, window and update.

The least-squares problem itself is in :mod:`surefoot.calibration.window.gauss_newton`, its theory and options
in :mod:`surefoot.calibration.window.config`.
"""

from typing import NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.arrays import Array, in_a_row
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.calibration.front_end.filters import low_pass
from surefoot.calibration.front_end.readings import FrontEnd, FrontState, Sample
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import Reference
from surefoot.calibration.setup import OnlineMethod, OnlineSetup
from surefoot.calibration.standing import QuietStanding, StandingState
from surefoot.calibration.window.config import Window
from surefoot.calibration.window.gauss_newton import Weights, gauss_newton, linearise, shorten, typical_square

_STANDING_FORCE_NOISE = 0.004
"""Error of the mean vertical force in quiet standing, in body weights, besides that of the believed mass."""

_STANDING_COP_NOISE = 1e-3
"""Error of the mean centre of pressure in quiet standing in m, besides that of the believed centre of
mass."""


class PendingColumns(NamedTuple):
    """The places of the parts of a sample that waits for the next update."""

    force: slice
    motion: slice
    stance: slice
    sure: slice
    good: slice
    settled: slice


class SampleColumns(NamedTuple):
    """The places of the parts of a sample in the window; the first two pass the filter."""

    rows: slice
    vgrf: slice
    use: slice
    changing: slice


class WindowState(NamedTuple):
    """The state of the sliding window; F feet."""

    front: FrontState  # the state of the front end
    step: int  # samples seen
    pending: Array
    """Samples since the last update, oldest first: F0, the flat reference, which feet surely stand, which
    surely stand or swing, whether the sample may be learnt from, whether it has settled, shape (every, P);
    see :class:`PendingColumns`."""
    filter: Array
    """State of the low-pass filter over the C = 6K + 1 numbers of a sample, its rows and the vertical force
    that its motion asks for, shape (2, C)."""
    latest: Array  # the last good numbers of a sample, before the filter, shape (C,)
    started: bool  # whether there was one
    contact: Array  # feet that carried weight, and feet that were sure to stand (bool), shape (2F,)
    since_change: int  # samples since a foot gained or lost the ground
    samples: Array
    """The window, oldest first: filtered numbers, use and nearness to a change of contact, shape (N, C + 2);
    see :class:`SampleColumns`."""
    theta: Array  # (a, b / (M g)), shape (2K,)
    status: int  # flags of the last update
    standing: StandingState  # the samples of the standing start
    walking: bool  # whether the standing start is over
    all_walking: int  # the same, 0 or 1, as saved states have it


class SlidingWindow:
    """The sliding window for one setup: ``init`` and ``update`` are pure functions that share constants."""

    def __init__(self, setup: OnlineSetup, config: Window, *, quasi_static: bool) -> None:
        self.setup, self.config, self.quasi_static = setup, config, quasi_static
        self._weight, self._gross_length = setup.weight, config.gross_error * setup.length
        self.front_end = FrontEnd(setup, quasi_static=quasi_static)
        try:
            self._filter = None if config.cutoff is None else low_pass(config.cutoff, setup.dt)
        except ValueError as error:
            raise ValueError(f"{error} Give a lower one, or 'cutoff=None' to filter nothing.") from None
        self.length = max(config.every, round(config.window / setup.dt))
        self.settle = round(config.settle / setup.dt)
        self.transition = round(config.transition / setup.dt)
        self.weights = Weights(
            force=1.0 / config.delta_force / setup.weight,
            cop=1.0 / config.delta_cop / setup.length,
            threshold=setup.force_threshold,
        )
        K, feet = setup.layout.channels, len(setup.layout.feet)
        motion = self.front_end.motions.columns.size
        self._pending = PendingColumns(*in_a_row(K, motion, feet, feet, 1, 1))
        self._sample = SampleColumns(*in_a_row(6 * K, 1, 1, 1))

        def per_channel(scale: float, offset: float) -> Floats:
            return np.repeat([scale, offset], K)

        period = config.every * setup.dt
        self.spread = per_channel(config.scale_step, config.offset_step)
        self.step_bound = per_channel(config.scale_step_bound, config.offset_step_bound)
        self.rate_bound = per_channel(config.scale_rate, config.offset_rate) * period
        self.lowest = per_channel(config.scale_range[0], -config.offset_range)
        self.highest = per_channel(config.scale_range[1], config.offset_range)
        # Quiet standing is one sample over and over: all of them together count as one. Taken for
        # independent, the drift and the noise within them would be taken for load, and pull the scales down.
        repeats = float(np.sqrt(max(config.standing_duration / setup.dt, config.standing_samples)))
        # The standing start sees forces by the starting map in place of counts, so that its result is (a, b).
        self.standing = QuietStanding(
            layout=setup.layout,
            mass=setup.mass,
            gravity=setup.gravity,
            start=Parameters(np.ones(K), np.zeros(K)),
            warm_up=config.standing_warm_up,
            duration=config.standing_duration,
            minimum_samples=config.standing_samples,
            threshold=setup.force_threshold,
            scale_std=config.standing_scale_std,
            offset_std=config.standing_offset_std * setup.weight,
            force_noise=_STANDING_FORCE_NOISE * setup.weight * repeats,
            cop_noise=_STANDING_COP_NOISE * repeats,
        )

    @property
    def method(self) -> OnlineMethod:
        """The functions, and the limits of their state."""
        limits = self.front_end.limits | {"theta": (self.lowest, self.highest)}
        return OnlineMethod(self.init, self.update, limits=limits, adopt=self.adopt)

    def adopt(self, state: WindowState, share: float) -> WindowState:
        """Go on from a saved state; see :class:`~surefoot.calibration.setup.OnlineMethod`."""
        K = self.setup.layout.channels
        theta = np.concatenate([state.theta[:K], share * state.theta[K:]])
        return state._replace(theta=np.clip(theta, self.lowest, self.highest))

    def init(self, raw: Array) -> WindowState:
        """Return the state before any sample; see :class:`~surefoot.calibration.online.OnlineMethod`."""
        K, feet = self.setup.layout.channels, len(self.setup.layout.feet)
        numbers, walking = self._sample.vgrf.stop, not self.config.standing_start
        return WindowState(
            front=self.front_end.init(raw),
            step=0,
            pending=np.zeros((self.config.every, self._pending.settled.stop)),
            filter=np.zeros((2, numbers)),
            latest=np.zeros(numbers),
            started=False,
            contact=np.zeros(2 * feet, dtype=np.bool),
            since_change=0,
            samples=np.zeros((self.length, self._sample.changing.stop)),
            theta=np.repeat([1.0, 0.0], K),
            status=0,
            standing=self.standing.init(raw),
            walking=walking,
            all_walking=int(walking),
        )

    def update(
        self, state: WindowState, raw: Array, reference: Reference, dt: float
    ) -> tuple[WindowState, Estimate]:
        """Take in one sample; see :class:`~surefoot.calibration.online.OnlineMethod`."""
        K = self.setup.layout.channels
        front, sample = self.front_end.observe(state.front, raw, reference, dt)
        if not state.walking:
            state = self._stand(state, sample, dt)
        if sample.gap:
            state = _without_samples(state)
        settled = sample.clean > self.settle and state.walking
        sure = sample.stance | sample.swing
        newest = [sample.past, sample.motion, sample.stance, sure, [sample.good, settled]]
        state = state._replace(
            front=front, step=state.step + 1, pending=np.vstack([state.pending[1:], np.concatenate(newest)])
        )
        if state.step % self.config.every == 0:
            for waiting in state.pending:
                state = self._collect(state, waiting)
            state = self._solve(state)
        status = state.status if state.walking else state.status | int(Flag.STANDING)
        return state, self.front_end.estimate(sample, state.theta[:K], state.theta[K:] * self._weight, status)

    def _stand(self, state: WindowState, sample: Sample, dt: float) -> WindowState:
        """Collect the standing start and end it: by its solution, or because the robot walks already."""
        _, cop, physical = self.front_end.motions.ground(sample.motion)
        usable = sample.past if sample.good and physical else np.full_like(sample.past, np.nan)
        reference = self.front_end.motions.unflatten(sample.motion, sample.stance, sample.swing)
        # A robot that already leans towards its first step is not quite at rest: where the ground's force
        # must act by its motion takes the place of the point below its centre of mass. At rest they agree.
        reference = reference._replace(com=np.append(cop, reference.com[2]))
        step = self.setup.dt if sample.gap else dt
        standing = self.standing.update(state.standing, usable, reference, step)
        leaving = bool(sample.swing.any()) or standing.time > self.config.standing_patience
        enough = standing.samples >= self.standing.minimum_samples
        ready = enough and (leaving or self.standing.ready(standing))
        theta, walking = state.theta, leaving or ready
        if ready:
            correction = self.standing.solve(standing).correction
            solved = np.concatenate([correction.scale, correction.offset / self.setup.weight])
            theta = np.clip(solved, self.lowest, self.highest)
        return state._replace(standing=standing, theta=theta, walking=walking, all_walking=int(walking))

    def _collect(self, state: WindowState, waiting: Array) -> WindowState:
        """Pass one of the pending samples, shape (P,), through the filter into the window."""
        K, weight, config, at = self.setup.layout.channels, self._weight, self.config, self._pending
        past, motion, stance = waiting[at.force], waiting[at.motion], waiting[at.stance] > 0.5
        good, settled = waiting[at.good.start] > 0.5, waiting[at.settled.start] > 0.5

        # What the map so far makes of the sample, against what its motion asks for.
        vgrf, cop, physical = self.front_end.motions.ground(motion)
        by_foot = self.front_end.motions.rows(motion)
        calibrated = state.theta[:K] * past + state.theta[K:] * weight
        contact = np.concatenate([by_foot[:, 0] @ calibrated > self.setup.force_threshold, stance])
        rows = by_foot.sum(axis=0)
        moment = rows @ calibrated
        fz, cop_error = moment[0], np.abs(moment[1:] - cop * moment[0])
        near = bool((cop_error <= self._gross_length * fz).all())
        good = good and physical and near and abs(fz - vgrf) <= config.gross_error * weight

        # Its rows about that centre of pressure.
        rows[1:] -= cop[:, None] * rows[0]
        numbers = np.append(np.hstack([rows * past, rows * weight]), vgrf)
        latest = numbers if good else state.latest
        output, filter_state = latest, state.filter
        if self._filter is not None:
            before = state.filter if state.started else self._filter.init(latest)
            output, filter_state = self._filter.apply(latest, before)

        unchanged = (contact == state.contact).all() and (waiting[at.sure] > 0.5).all()
        since_change = state.since_change + 1 if unchanged else 0
        newest = np.append(output, [good and settled, since_change < self.transition])
        return state._replace(
            filter=filter_state,
            latest=latest,
            started=bool(state.started or good),
            contact=contact,
            since_change=since_change,
            samples=np.vstack([state.samples[1:], newest]),
        )

    def _solve(self, state: WindowState) -> WindowState:
        """Solve Eq. 14 on the window, with every bound that keeps a bad window from doing harm."""
        config, weights, last, at = self.config, self.weights, state.theta, self._sample
        phi = state.samples[:, at.rows].reshape(self.length, 3, -1)
        vgrf, use, changing = (state.samples[:, part.start] for part in (at.vgrf, at.use, at.changing))

        # Outliers about changes of contact.
        use = np.where(phi[:, 0] @ last > weights.threshold, use, 0.0)
        r = linearise(last, phi, vgrf, use, weights).residual
        square = (r * r).sum(axis=1) / 3.0
        limit = config.outlier_threshold**2 * max(typical_square(square, use), 1.0)
        use = np.where((changing > 0.5) & (square > limit), 0.0, use)

        if not state.walking:
            return state._replace(status=0)
        if use.sum() < config.minimum_share * self.length:
            return state._replace(status=int(Flag.NO_CONTACT))
        theta, solvable = gauss_newton(
            last,
            phi,
            vgrf,
            use,
            weights,
            spread=self.spread,
            bound=self.step_bound,
            iterations=config.iterations,
        )
        if not solvable:
            return state._replace(status=int(Flag.SINGULAR))
        theta = last + shorten(theta - last, self.rate_bound)
        theta = np.clip(theta, self.lowest, self.highest)
        return state._replace(theta=theta if np.isfinite(theta).all() else last, status=0)


def _without_samples(state: WindowState) -> WindowState:
    """Return the state without samples, as the next ones do not belong to them."""
    pending, samples = np.zeros_like(state.pending), np.zeros_like(state.samples)
    return state._replace(pending=pending, samples=samples, started=False)


def window(setup: OnlineSetup, config: Window | None = None) -> OnlineMethod:
    """Return the CoP paper's sliding window (Eq. 14) as pure functions; the paper's conditions by default."""
    return SlidingWindow(setup, config or Window(), quasi_static=False).method


def quasi_static(setup: OnlineSetup, config: Window | None = None) -> OnlineMethod:
    """Return the quasi-static method (Han, Jiang and Chirikjian, IROS 2022) as pure functions.

    It is the sliding window against a robot that is thought to stand still: Fz_ref = M g, p_ref = (x, y) in
    place of Eqs. 9-11, as the CoP paper compares itself with it. The faster a robot walks, the more of its
    own acceleration flows into the cells.
    """
    return SlidingWindow(setup, config or Window(), quasi_static=True).method
