"""How the in-situ tracker runs over a stream; private.

Its theory and options are in :mod:`surefoot.calibration.in_situ.tracker`, its rows in
:mod:`surefoot.calibration.in_situ.model`.
"""

from typing import Any, NamedTuple

import numpy as np
from array_api_compat import device as device_of

from surefoot.calibration._arrays import check_tail, constant_like
from surefoot.calibration._constants import Constants, namespace_of
from surefoot.calibration.estimate import Flag
from surefoot.calibration.in_situ.fit import InSituFit, error_covariance, refuse_refused
from surefoot.calibration.in_situ.model import (
    AXES,
    GAINS,
    PAIRS,
    STATIC,
    LinearSensor,
    inertial_parameters,
    offset_covariance,
    sensitivity,
)
from surefoot.calibration.in_situ.options import InSituTrackerConfig
from surefoot.calibration.moment.kalman import kalman_step
from surefoot.calibration.reference import GRAVITY

__all__ = ["InSituEstimate", "InSituState", "InSituStream"]

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""

_STEP = 0.1
"""Share of ``lag_angle`` by which gravity must have turned to count as turning: a noisy IMU does not."""

_LONGEST_PAUSE = 3600.0
"""Time in s beyond which a pause adds no more drift."""


class InSituEstimate(NamedTuple):
    """One reading by what is known now; any leading batch dimensions ``...``; k channels. Always finite.

    Attributes:
        wrench: What the limb exerts on the robot, at and in the sensor's frame in N and N m, shape (..., 6).
        wrench_std: Its standard deviation by the calibration, without the sample's noise, shape (..., 6).
        offset: o in counts, shape (..., k).
        offset_std: Its standard deviation, shape (..., k).
        gain: 1 + D, shape (..., 6, 6): the response is now A (1 + D).
        gain_std: Standard deviation of its entries, also of those not estimated, shape (..., 6, 6).
        covariance: Of (offset, D row by row), shape (..., k + 36, k + 36).
        nis: Normalised innovation squared of this sample, shape (...), NaN where nothing was learnt.
        nis_rows: Its degrees of freedom, shape (...).
        learnt: Whether the sample was learnt from (bool), shape (...).
        flags: Bits of :class:`~surefoot.calibration.estimate.Flag`, shape (..., k): MISSING, OUT_OF_RANGE
            and SATURATED of a channel; REFERENCE (gravity or motion is not finite or not physical), GAP (no
            time has passed, or no number), REJECTED (a touch) and SINGULAR of all.
    """

    wrench: Array
    wrench_std: Array
    offset: Array
    offset_std: Array
    gain: Array
    gain_std: Array
    covariance: Array
    nis: Array
    nis_rows: Array
    learnt: Array
    flags: Array


class InSituState(NamedTuple):
    """What the tracker remembers; any leading batch dimensions ``...``; k channels, N = k + 46 unknowns.

    Attributes:
        mean: (offset's change in counts, D row by row, the limb's errors, h in N and N m), shape (..., N).
        covariance: Its covariance, shape (..., N, N).
        raw: The last counts that arrived, shape (..., k).
        anchor: g from which on it has not turned, in m/s^2, shape (..., 3).
    """

    mean: Array
    covariance: Array
    raw: Array
    anchor: Array


class InSituStream:
    """The tracker for one calibration: ``init`` and ``update`` are pure functions that share constants."""

    def __init__(self, fit: InSituFit, config: InSituTrackerConfig) -> None:
        refuse_refused(fit, "The tracker")
        self.config = config
        self.channels = channels = len(fit.offset)
        parameters = np.concatenate([[fit.limb.mass], fit.limb.mass_com])
        added_com = np.asarray(config.added_com, dtype=np.float64)
        if fit.limb.inertia is not None:
            parameters = np.concatenate([parameters, [fit.limb.inertia[i, j] for i, j in PAIRS]])
        parameters = parameters + inertial_parameters(config.added_mass, added_com, len(parameters) > STATIC)
        self.sensor = sensor = LinearSensor(fit.response, fit.noise, parameters)
        weight = np.einsum("p,pws->ws", parameters[:STATIC], sensitivity(False)) * GRAVITY
        share = np.zeros(AXES) if fit.hysteresis is None else fit.hysteresis
        share = share if config.lag is None else np.full(AXES, config.lag)
        lag = 0.5 * share * np.linalg.norm(weight, axis=1)
        self._walks = channels + GAINS
        self._size = size = self._walks + STATIC + AXES
        covariance = np.zeros((size, size))
        covariance[:-AXES, :-AXES] = error_covariance(fit)
        covariance[:channels, :channels] += self._jump(config.since_fit_force, config.since_fit_torque)
        covariance[-AXES:, -AXES:] = np.diag(lag**2)
        walk = np.zeros((size, size))
        walk[:channels, :channels] = self._jump(config.walk_force, config.walk_torque)
        gains = slice(channels, self._walks)
        walk[gains, gains] = np.diag(np.eye(AXES).ravel() * config.walk_gain**2)
        learnt = np.zeros(size)
        learnt[:channels] = 1.0
        learnt[-AXES:] = 1.0
        if config.learn != "offset":
            learnt[gains] = 1.0 if config.learn == "matrix" else np.eye(AXES).ravel()
        self._constants = Constants(
            covariance,
            walk,
            learnt,
            np.eye(size),
            np.diag(lag**2),
            fit.offset,
            sensor.whitening,
            sensor.whitening @ fit.response,
            fit.matrix,
            np.eye(AXES),
            fit.matrix @ np.linalg.inv(sensor.whitening),
            config.touch * np.repeat([weight[:3].max(), np.linalg.norm(weight[3:], 2)], 3),
        )

    def _jump(self, force: float, torque: float) -> np.ndarray[Any, np.dtype[np.float64]]:
        return offset_covariance(self.sensor.response, force, torque)

    def init(self, raw: Array) -> InSituState:
        """Begin from the calibration; see :class:`~surefoot.calibration.in_situ.tracker.InSituMethod`."""
        check_tail(raw, (self.channels,), "raw")
        xp, batch = namespace_of(raw), tuple(raw.shape[:-1])
        covariance, _, _, _, _, offset, *_ = self._constants.like(raw)

        def zeros(*tail: int) -> Array:
            return xp.zeros((*batch, *tail), dtype=raw.dtype, device=device_of(raw))

        return InSituState(zeros(self._size), zeros(1, 1) + covariance, zeros(1) + offset, zeros(3))

    def doubt(self, state: InSituState, force: float, torque: float) -> InSituState:
        """Widen what is known of the offset by a leap of that deviation in N and N m."""
        more = np.zeros((self._size, self._size))
        more[: self.channels, : self.channels] = self._jump(force, torque)
        return state._replace(covariance=state.covariance + constant_like(more, state.mean))

    def update(
        self,
        state: InSituState,
        raw: Array,
        gravity: Array,
        dt: float,
        *,
        angular_velocity: Array | None = None,
        angular_acceleration: Array | None = None,
        in_air: bool | Array = True,
    ) -> tuple[InSituState, InSituEstimate]:
        """Take in one sample; see :class:`~surefoot.calibration.in_situ.tracker.InSituTracker`."""
        xp = namespace_of(raw)
        signals = signals_of(
            raw, gravity, angular_velocity, angular_acceleration, like=state.raw, inertia=self.sensor.inertia
        )
        flags, ready, physical, passed = flags_of(raw, signals, dt, self.config.code_range)
        signals = xp.where(physical[..., None], signals, 0.0)
        state = state._replace(raw=xp.where(xp.isfinite(raw), raw, state.raw))
        aloft = xp.asarray(in_air, dtype=xp.bool, device=device_of(raw)) & xp.ones_like(ready)
        pause = min(dt, _LONGEST_PAUSE) if passed else 0.0
        state = self._predict(state, signals[..., :3], physical, aloft, pause)
        _, _, learnt, identity, _, offset, whitening, whitened, *_ = self._constants.like(raw)

        sensor = self.sensor
        expected = (whitened @ sensor.wrench(signals)[..., None])[..., 0]
        y = (whitening @ (state.raw - offset)[..., None])[..., 0] - expected
        batch = tuple(y.shape[:-1])
        H = xp.concat(
            [
                xp.broadcast_to(whitening, (*batch, *whitening.shape)),
                sensor.rows(signals),
                xp.broadcast_to(whitened, (*batch, *whitened.shape)),
            ],
            axis=-1,
        )
        e = y - (H @ state.mean[..., None])[..., 0]
        V = H @ state.covariance @ H.mT + identity[: self.channels, : self.channels]
        distance = xp.sum(e * xp.linalg.solve(V, e[..., None])[..., 0], axis=-1)
        touched = ~(distance <= self.config.reject**2) & self._felt(e)
        use = ready & aloft
        learns = use & ~touched
        step = kalman_step(
            state.mean,
            state.covariance,
            xp.where(learns[..., None, None], H, 0.0),
            xp.where(learns[..., None], y, 0.0),
            xp.ones_like(y),
            learnt,
            identity,
            self.config.gate,
        )
        finite = xp.all(xp.isfinite(step.mean), axis=-1)
        finite = finite & xp.all(xp.isfinite(step.covariance), axis=(-2, -1))
        taken = learns & finite
        state = state._replace(
            mean=xp.where(taken[..., None], step.mean, state.mean),
            covariance=xp.where(taken[..., None, None], step.covariance, state.covariance),
        )
        marks = int(Flag.REJECTED) * (use & touched) + int(Flag.SINGULAR) * (learns & ~finite)
        estimate = self._estimate(state, flags | xp.asarray(marks, dtype=xp.int64)[..., None])
        nis = xp.where(taken, step.nis, xp.nan)
        return state, estimate._replace(nis=nis, nis_rows=step.rows, learnt=taken)

    def _felt(self, e: Array) -> Array:
        """Tell whether innovations are those of a force or a torque that counts beside the limb's own."""
        xp = namespace_of(e)
        *_, unwhiten, floor = self._constants.like(e)
        shares = xp.abs((unwhiten @ e[..., None])[..., 0]) / floor
        return ~xp.all(shares <= 1.0, axis=-1)

    def _predict(
        self, state: InSituState, gravity: Array, physical: Array, aloft: Array, dt: float
    ) -> InSituState:
        """Let the offset and the gains walk, and hysteresis forget by the way that gravity has turned.

        Another load than the limb's own makes it forget at once.
        """
        xp = namespace_of(gravity)
        _, walk, _, _, lag, *_ = self._constants.like(gravity)
        covariance = state.covariance + dt * walk
        angle = xp.sqrt(xp.sum((gravity - state.anchor) ** 2, axis=-1)) / GRAVITY
        turned = physical & (angle > _STEP * self.config.lag_angle)
        kept = xp.where(turned, xp.exp(-angle / self.config.lag_angle), xp.ones_like(angle))
        kept = xp.where(aloft, kept, xp.zeros_like(kept))
        f = xp.concat(
            [
                xp.ones((*kept.shape, self._size - AXES), dtype=kept.dtype, device=device_of(kept)),
                xp.broadcast_to(kept[..., None], (*kept.shape, AXES)),
            ],
            axis=-1,
        )
        covariance = f[..., :, None] * covariance * f[..., None, :]
        fresh = (1.0 - kept**2)[..., None, None] * lag
        corner = covariance[..., -AXES:, -AXES:] + fresh
        below = xp.concat([covariance[..., -AXES:, :-AXES], corner], axis=-1)
        return state._replace(
            mean=f * state.mean,
            covariance=xp.concat([covariance[..., :-AXES, :], below], axis=-2),
            anchor=xp.where(turned[..., None], gravity, state.anchor),
        )

    def _estimate(self, state: InSituState, flags: Array) -> InSituEstimate:
        """Undo the map: w = (1 + D)^-1 (C (r - o) - h)."""
        xp, k, known = namespace_of(state.mean), self.channels, self._walks
        *_, offset, _, _, matrix, eye, _, _ = self._constants.like(state.mean)
        D = xp.reshape(state.mean[..., k:known], (*state.mean.shape[:-1], AXES, AXES))
        gain = eye + D
        zero = offset + state.mean[..., :k]
        load = (matrix @ (state.raw - zero)[..., None])[..., 0] - state.mean[..., -AXES:]
        wrench = xp.linalg.solve(gain, load[..., None])[..., 0]
        # d w = -(1 + D)^-1 (C d o + dD w + d h)
        batch = tuple(wrench.shape[:-1])
        spread = eye[:, :, None] * wrench[..., None, None, :]
        columns = [
            xp.broadcast_to(matrix, (*batch, AXES, k)),
            xp.reshape(spread, (*batch, AXES, GAINS)),
            xp.broadcast_to(eye, (*batch, AXES, AXES)),
        ]
        J = xp.linalg.solve(gain, xp.concat(columns, axis=-1))
        P = state.covariance
        P = xp.concat([P[..., :known], P[..., -AXES:]], axis=-1)
        P = xp.concat([P[..., :known, :], P[..., -AXES:, :]], axis=-2)
        variance = xp.sum((J @ P) * J, axis=-1)
        covariance = P[..., :known, :known]
        std = xp.sqrt(xp.linalg.diagonal(covariance))
        nothing = 0.0 * state.mean[..., 0]
        return InSituEstimate(
            wrench=wrench,
            wrench_std=xp.sqrt(xp.where(variance > 0.0, variance, 0.0)),
            offset=zero,
            offset_std=std[..., :k],
            gain=gain,
            gain_std=xp.reshape(std[..., k:], D.shape),
            covariance=covariance,
            nis=nothing + xp.nan,
            nis_rows=nothing,
            learnt=nothing > 0.0,
            flags=flags,
        )


_LIGHTEST, _HEAVIEST = 1.0, 100.0
"""Size of g - a in m/s^2 below and above which it is not that of a limb."""

_FASTEST = 1e3
"""Angular velocity in rad/s that no limb reaches; its square, an acceleration in rad/s^2."""


def signals_of(
    raw: Array,
    gravity: Array,
    angular_velocity: Array | None,
    angular_acceleration: Array | None,
    *,
    like: Array,
    inertia: bool,
) -> Array:
    """Check the sample, and build u: gravity, and in motion what its turning adds.

    Args:
        raw: Counts, shape (..., k).
        gravity: g - a in m/s^2, shape (..., 3).
        angular_velocity: In rad/s, shape (..., 3), or None.
        angular_acceleration: In rad/s^2, shape (..., 3), or None.
        like: The counts before, which tell shape and dtype.
        inertia: Whether the limb's inertia is known.

    Returns:
        u, shape (..., 3) without and (..., 12) with turning.

    Raises:
        ValueError: If a shape or dtype does not fit, or motion is given for a limb without inertia.
    """
    xp = namespace_of(raw)
    *batch, channels = like.shape
    given = {"raw": (raw, channels), "gravity": (gravity, 3)}
    if (angular_velocity is None) != (angular_acceleration is None):
        raise ValueError("Give 'angular_velocity' and 'angular_acceleration' together, or neither.")
    if angular_velocity is not None and angular_acceleration is not None:
        given["angular_velocity"] = (angular_velocity, 3)
        given["angular_acceleration"] = (angular_acceleration, 3)
    for name, (value, last) in given.items():
        check_tail(value, (last,), name)
        if tuple(value.shape) != (*batch, last) or value.dtype != like.dtype:
            raise ValueError(
                f"'{name}' must have shape {(*batch, last)} and dtype {like.dtype} like the first "
                f"reading, got {tuple(value.shape)} and {value.dtype}."
            )
    if angular_velocity is None or angular_acceleration is None:
        return gravity
    if not inertia:
        raise ValueError(
            "This calibration does not know the limb's inertia: calibrate with the motion, or leave the "
            "angular velocity out."
        )
    products = xp.stack([angular_velocity[..., i] * angular_velocity[..., j] for i, j in PAIRS], axis=-1)
    return xp.concat([gravity, angular_acceleration, products], axis=-1)


def flags_of(
    raw: Array, signals: Array, dt: float, code_range: tuple[float, float] | None
) -> tuple[Array, Array, Array, bool]:
    """Tell what is wrong with a sample.

    Args:
        raw: Counts, shape (..., k).
        signals: u, shape (..., 3) or (..., 12).
        dt: Time since the last sample in s.
        code_range: Lowest and highest count of the converter, or None.

    Returns:
        Flags of the channels, shape (..., k); which readings are whole, and which signals physical, shape
        (...); whether time has passed.
    """
    xp = namespace_of(raw)
    missing = xp.isnan(raw)
    endless = xp.isinf(raw)
    saturated = xp.zeros_like(missing)
    if code_range is not None:
        saturated = ((raw <= code_range[0]) | (raw >= code_range[1])) & ~endless
    g = xp.sqrt(xp.sum(signals[..., :3] ** 2, axis=-1))
    turning = xp.all(xp.abs(signals[..., 3:]) < _FASTEST**2, axis=-1)
    physical = (g >= _LIGHTEST) & (g <= _HEAVIEST) & turning
    passed = bool(0.0 < dt < float("inf"))
    flags = (
        int(Flag.MISSING) * missing
        + int(Flag.OUT_OF_RANGE) * endless
        + int(Flag.SATURATED) * saturated
        + int(Flag.REFERENCE) * (~physical)[..., None]
    )
    flags = xp.asarray(flags, dtype=xp.int64) + (0 if passed else int(Flag.GAP))
    ready = physical & ~xp.any(missing | endless | saturated, axis=-1)
    return flags, ready, physical, passed
