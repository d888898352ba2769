"""How the sliding window runs over a stream: standing start, filter, window and update.

The least-squares problem itself is in :mod:`surefoot.calibration.window.gauss_newton`, its theory and options
in :mod:`surefoot.calibration.window.config`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array, in_a_row
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.calibration.front_end.filters import low_pass
from surefoot.calibration.front_end.readings import FrontEnd, FrontState, Sample
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import Reference
from surefoot.calibration.setup import OnlineMethod, OnlineSetup
from surefoot.calibration.standing import QuietStanding, StandingState
from surefoot.calibration.window.config import WindowConfig
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
    """What the sliding window remembers; any leading batch dimensions ``...``; F feet.

    Attributes:
        front: What the way of a sample remembers.
        step: Samples seen.
        pending: Samples since the last update, oldest first: F0, the flat reference, which feet surely
            stand, which surely stand or swing, whether the sample may be learnt from, whether it has
            settled, shape (..., every, P); see :class:`PendingColumns`.
        filter: State of the low-pass filter over the C = 6K + 1 numbers of a sample, its rows and the
            vertical force that its motion asks for, shape (..., 2, C).
        latest: The last good numbers of a sample, before the filter, shape (..., C).
        started: Whether there was one (bool), shape (...).
        contact: Feet that carried weight, and feet that were sure to stand (bool), shape (..., 2F).
        since_change: Samples since a foot gained or lost the ground, shape (...).
        samples: The window, oldest first: filtered numbers, use and nearness to a change of contact, shape
            (..., N, C + 2); see :class:`SampleColumns`.
        theta: (a, b / (M g)), shape (..., 2K).
        status: Flags of the last update, shape (...).
        standing: What the standing start has seen.
        walking: Whether the standing start is over (bool), shape (...).
        all_walking: Whether it is over for the whole batch, 0 or 1.
    """

    front: FrontState
    step: int
    pending: Array
    filter: Array
    latest: Array
    started: Array
    contact: Array
    since_change: Array
    samples: Array
    theta: Array
    status: Array
    standing: StandingState
    walking: Array
    all_walking: int


class SlidingWindow:
    """The sliding window for one setup: ``init`` and ``update`` are pure functions that share constants."""

    def __init__(self, setup: OnlineSetup, config: WindowConfig, *, quasi_static: bool) -> None:
        self.setup, self.config, self.quasi_static = setup, config, quasi_static
        self._weight, self._gross_length = setup.weight, config.gross_error * setup.length
        self._front_end = FrontEnd(setup, quasi_static=quasi_static)
        try:
            self._filter = None if config.cutoff is None else low_pass(config.cutoff, setup.dt)
        except ValueError as error:
            raise ValueError(f"{error} Give a lower one, or 'cutoff=None' to filter nothing.") from None
        self._length = max(config.every, round(config.window / setup.dt))
        self._settle = round(config.settle / setup.dt)
        self._transition = round(config.transition / setup.dt)
        self._weights = Weights(
            force=float(np.sqrt(config.force_weight)) / config.delta_force / setup.weight,
            cop=float(np.sqrt(config.cop_weight)) / config.delta_cop / setup.length,
            threshold=setup.force_threshold,
        )
        K, feet = setup.layout.channels, len(setup.layout.feet)
        motion = self._front_end.motions.columns.size
        self._pending = PendingColumns(*in_a_row(K, motion, feet, feet, 1, 1))
        self._sample = SampleColumns(*in_a_row(6 * K, 1, 1, 1))

        def per_channel(scale: float, offset: float) -> NDArray[np.float64]:
            return np.repeat([scale, offset], K)

        rigidity = 1.0 / np.sqrt(config.smoothness_weight)
        period = config.every * setup.dt
        self._spread = per_channel(config.scale_step, config.offset_step) * rigidity
        self._step_bound = per_channel(config.scale_step_bound, config.offset_step_bound)
        self._rate_bound = per_channel(config.scale_rate, config.offset_rate) * period
        self._lowest = per_channel(config.scale_range[0], -config.offset_range)
        self._highest = per_channel(config.scale_range[1], config.offset_range)
        self._identity = np.eye(2 * K)
        # Quiet standing is one sample over and over: all of them together count as one. Taken for
        # independent, the drift and the noise within them would be taken for load, and pull the scales down.
        repeats = float(np.sqrt(max(config.standing_duration / setup.dt, config.standing_samples)))
        # The standing start sees forces by the starting map in place of counts, so that its result is (a, b).
        self._standing = QuietStanding(
            layout=setup.layout,
            mass=setup.mass,
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

    def init(self, raw: Array) -> WindowState:
        """Return the state before any sample; see :class:`~surefoot.calibration.online.OnlineMethod`."""
        front = self._front_end.init(raw)
        batch, K, feet = raw.shape[:-1], self.setup.layout.channels, len(self.setup.layout.feet)
        numbers = self._sample.vgrf.stop

        def zeros(*tail: int, dtype: Any = np.float64) -> Array:
            return np.zeros((*batch, *tail), dtype=dtype)

        return WindowState(
            front=front,
            step=0,
            pending=zeros(self.config.every, self._pending.settled.stop),
            filter=zeros(2, numbers),
            latest=zeros(numbers),
            started=zeros(dtype=np.bool),
            contact=zeros(2 * feet, dtype=np.bool),
            since_change=zeros(dtype=np.int64),
            samples=zeros(self._length, self._sample.changing.stop),
            theta=zeros(2 * K) + np.repeat([1.0, 0.0], K),
            status=zeros(dtype=np.int64),
            standing=self._standing.init(raw),
            walking=zeros(dtype=np.bool) | (not self.config.standing_start),
            all_walking=int(not self.config.standing_start),
        )

    def update(
        self, state: WindowState, raw: Array, reference: Reference, dt: float
    ) -> tuple[WindowState, Estimate]:
        """Take in one sample; see :class:`~surefoot.calibration.online.OnlineMethod`."""
        K = self.setup.layout.channels
        front, sample = self._front_end.observe(state.front, raw, reference, dt)
        if not state.all_walking:
            state = self._stand(state, sample, dt)
        if sample.gap:
            state = _without_samples(state)
        notes = np.concatenate(
            [
                sample.stance,
                sample.stance | sample.swing,
                sample.good[..., None],
                (sample.clean > self._settle)[..., None] & state.walking[..., None],
            ],
            axis=-1,
        )
        newest = np.concatenate([sample.past, sample.motion, notes], axis=-1)
        state = state._replace(
            front=front,
            step=state.step + 1,
            pending=np.concatenate([state.pending[..., 1:, :], newest[..., None, :]], axis=-2),
        )
        if state.step % self.config.every == 0:
            state = self._solve(self._collect(state))
        status = state.status
        if not state.all_walking:
            status = status | int(Flag.STANDING) * (~state.walking)
        a, b = state.theta[..., :K], state.theta[..., K:] * self._weight
        return state, self._front_end.estimate(sample, a, b, status)

    def _stand(self, state: WindowState, sample: Sample, dt: float) -> WindowState:
        """Collect the standing start and end it: by its solution, or because the robot walks already."""
        _, cop, physical = self._front_end.motions.ground(sample.motion)
        usable = np.where((sample.good & physical)[..., None], sample.past, np.nan)
        reference = self._front_end.motions.unflatten(sample.motion, sample.stance, sample.swing)
        # A robot that already leans towards its first step is not quite at rest: where the ground's force
        # must act by its motion takes the place of the point below its centre of mass. At rest they agree.
        reference = reference._replace(com=np.concatenate([cop, reference.com[..., 2:]], axis=-1))
        step = self.setup.dt if sample.gap else dt
        standing = self._standing.update(state.standing, usable, reference, step)
        leaving = sample.swing.any(axis=-1) | (standing.time > self.config.standing_patience)
        leaving = leaving & ~state.walking
        ready = self._standing.ready(standing) | leaving
        ready = ready & ~state.walking & (standing.samples >= self._standing.minimum_samples)
        theta, walking = state.theta, state.walking
        if ready.any():
            correction = self._standing.solve(standing).correction
            solved = np.concatenate([correction.scale, correction.offset / self.setup.weight], axis=-1)
            solved = np.clip(solved, self._lowest, self._highest)
            theta = np.where(ready[..., None], solved, theta)
        walking = walking | ready | leaving
        return state._replace(standing=standing, theta=theta, walking=walking, all_walking=int(walking.all()))

    def _collect(self, state: WindowState) -> WindowState:
        """Pass the pending samples through the filter into the window.

        What does not depend on the order of samples is computed for all of them at once.
        """
        K, weight, config = self.setup.layout.channels, self._weight, self.config
        pending, at, every = state.pending, self._pending, self.config.every
        past, motion = pending[..., at.force], pending[..., at.motion]
        stance, sure = pending[..., at.stance] > 0.5, (pending[..., at.sure] > 0.5).all(axis=-1)
        good, settled = (pending[..., part][..., 0] > 0.5 for part in (at.good, at.settled))

        vgrf, cop, physical = self._front_end.motions.ground(motion)
        rows = self._front_end.motions.rows(motion)
        theta = state.theta[..., None, :]
        calibrated = theta[..., :K] * past + theta[..., K:] * weight
        by_foot = (rows @ calibrated[..., None, :, None])[..., 0]
        contact = np.concatenate([by_foot[..., 0] > self.setup.force_threshold, stance], axis=-1)
        moment, rows = by_foot.sum(axis=-2), rows.sum(axis=-3)

        fz = moment[..., 0]
        cop_error = np.abs(moment[..., 1:] - cop * fz[..., None])
        near = (cop_error <= self._gross_length * fz[..., None]).all(axis=-1)
        good = good & physical & near & (np.abs(fz - vgrf) <= config.gross_error * weight)

        vertical = rows[..., :1, :]
        rows = np.concatenate([vertical, rows[..., 1:, :] - cop[..., None] * vertical], axis=-2)
        numbers = np.concatenate([rows * past[..., None, :], rows * weight], axis=-1)
        numbers = np.concatenate([numbers.reshape(*fz.shape, 6 * K), vgrf[..., None]], axis=-1)

        filtered, since = [], []
        filter_state, latest, started = state.filter, state.latest, state.started
        before, since_change = state.contact, state.since_change
        for k in range(every):
            latest = np.where(good[..., k, None], numbers[..., k, :], latest)
            output = latest
            if self._filter is not None:
                steady = self._filter.init(latest)
                filter_state = np.where(started[..., None, None], filter_state, steady)
                output, filter_state = self._filter.apply(latest, filter_state)
            started = started | good[..., k]
            unchanged = (contact[..., k, :] == before).all(axis=-1) & sure[..., k]
            before, since_change = contact[..., k, :], (since_change + 1) * unchanged
            filtered.append(output[..., None, :])
            since.append(since_change[..., None])
        changing = np.concatenate(since, axis=-1) < self._transition
        notes = np.concatenate([(good & settled)[..., None], changing[..., None]], axis=-1)
        newest = np.concatenate([np.concatenate(filtered, axis=-2), notes], axis=-1)
        return state._replace(
            filter=filter_state,
            latest=latest,
            started=started,
            contact=before,
            since_change=since_change,
            samples=np.concatenate([state.samples[..., every:, :], newest], axis=-2),
        )

    def _solve(self, state: WindowState) -> WindowState:
        """Solve Eq. 14 on the window, with every bound that keeps a bad window from doing harm."""
        config, weights = self.config, self._weights
        K, last = self.setup.layout.channels, state.theta
        batch, at = last.shape[:-1], self._sample
        phi = state.samples[..., at.rows].reshape(*batch, self._length, 3, 2 * K)
        vgrf, use, changing = (state.samples[..., part][..., 0] for part in (at.vgrf, at.use, at.changing))

        fz = (phi[..., 0, :] @ last[..., None])[..., 0]
        use = np.where(fz > weights.threshold, use, 0.0)
        r = linearise(last, phi, vgrf, use, weights).residual
        square = (r * r).sum(axis=-1) / 3.0
        typical = typical_square(square, use)
        limit = config.outlier_threshold**2 * np.where(typical > 1.0, typical, 1.0)
        outlier = (changing > 0.5) & (square > limit[..., None])
        use = np.where(outlier, 0.0, use)
        enough = use.sum(axis=-1) >= config.minimum_share * self._length

        theta, solvable = gauss_newton(
            last,
            phi,
            vgrf,
            use,
            weights,
            spread=self._spread,
            bound=self._step_bound,
            identity=self._identity,
            iterations=config.iterations,
        )
        theta = last + shorten(theta - last, self._rate_bound)
        theta = np.clip(theta, self._lowest, self._highest)
        accept = enough & solvable & state.walking & np.isfinite(theta).all(axis=-1)
        status = np.where(enough, 0, int(Flag.NO_CONTACT))
        status = status | np.where(solvable | ~enough, 0, int(Flag.SINGULAR))
        return state._replace(
            theta=np.where(accept[..., None], theta, last), status=np.where(state.walking, status, 0)
        )


def _without_samples(state: WindowState) -> WindowState:
    """Return the state without samples, as what comes next does not belong to them."""
    return state._replace(
        pending=state.pending * 0.0, samples=state.samples * 0.0, started=state.started & False
    )


def window(setup: OnlineSetup, config: WindowConfig | None = None) -> OnlineMethod:
    """Return the CoP paper's sliding window (Eq. 14) as a pair of pure functions.

    Args:
        setup: The robot.
        config: Options; the paper's conditions by default.
    """
    method = SlidingWindow(setup, config or WindowConfig(), quasi_static=False)
    return OnlineMethod(method.init, method.update)


def quasi_static(setup: OnlineSetup, config: WindowConfig | None = None) -> OnlineMethod:
    """Return the quasi-static method (Han, Jiang and Chirikjian, IROS 2022) as a pair of pure functions.

    It is the sliding window against a robot that is thought to stand still: Fz_ref = M g, p_ref = (x, y) in
    place of Eqs. 9-11, as the CoP paper compares itself with it. The faster a robot walks, the more of its
    own acceleration flows into the cells.

    Args:
        setup: The robot.
        config: Options, the same as the sliding window's.
    """
    method = SlidingWindow(setup, config or WindowConfig(), quasi_static=True)
    return OnlineMethod(method.init, method.update)
