"""The in-situ tracker over a stream: its state, its step and its estimate.

Its theory is in :mod:`surefoot.calibration.in_situ.tracker`, its rows in
:mod:`surefoot.calibration.in_situ.model`.
"""

from typing import Any, NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.checks import check_tail
from surefoot.calibration.estimate import Flag
from surefoot.calibration.in_situ.fit import ErrorColumns, InSituFit, check_calibrated, error_covariance
from surefoot.calibration.in_situ.model import (
    AXES,
    DIRECT,
    PAIRS,
    RELATIVE_ERRORS,
    STATIC,
    LinearSensor,
    inertial_parameters,
    offset_covariance,
    transform_basis,
)
from surefoot.calibration.in_situ.options import InSituTrackerConfig
from surefoot.calibration.moment.kalman import kalman_step
from surefoot.calibration.reference import GRAVITY

__all__ = ["InSituEstimate", "InSituState", "InSituStream"]


_STEP = 0.1
"""Share of ``lag_angle`` by which gravity must have turned to count as turning: a noisy IMU does not."""

_LONGEST_PAUSE = 3600.0
"""Time in s beyond which a pause adds no more drift."""

_LIGHTEST, _HEAVIEST = 1.0, 100.0
"""Size of g - a in m/s^2 below and above which it is not that of a limb."""

_FASTEST = 1e3
"""Angular velocity in rad/s that no limb reaches; its square, an acceleration in rad/s^2."""


class InSituEstimate(NamedTuple):
    """A reading by what is known now; any leading batch dimensions ``...``; k channels. Always finite.

    Attributes:
        wrench: What the limb exerts on the robot, at and in the sensor's frame in N and N m, shape (..., 6).
        wrench_std: Its standard deviation by the calibration, without the sample's noise, shape (..., 6).
        offset: o in counts, shape (..., k).
        offset_std: Its standard deviation, shape (..., k).
        scale: 1 + D, shape (..., 6, 6): the response is now A (1 + D).
        scale_std: Standard deviation of its entries, also of those not estimated, shape (..., 6, 6).
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
    scale: Array
    scale_std: Array
    covariance: Array
    nis: Array
    nis_rows: Array
    learnt: Array
    flags: Array


class InSituState(NamedTuple):
    """State of a tracker; any leading batch dimensions ``...``; k channels, N = k + 46 unknowns.

    Attributes:
        mean: (offset's change in counts, D row by row, the limb's errors, h in N and N m), shape (..., N), in
            the order of :class:`~surefoot.calibration.in_situ.fit.ErrorColumns`.
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
        check_calibrated(fit, "The tracker")
        self.config = config
        self.channels = channels = len(fit.offset)
        self._at = at = ErrorColumns.of(channels)
        limb = fit.limb.parameters
        added_com = np.asarray(config.added_com, dtype=np.float64)
        limb = limb + inertial_parameters(config.added_mass, added_com, len(limb) > STATIC)
        self.sensor = sensor = LinearSensor(fit.response, fit.noise, limb)
        weight = np.einsum("p,pws->ws", limb[:STATIC], transform_basis(False)) * GRAVITY
        share = np.zeros(AXES) if fit.hysteresis is None else fit.hysteresis
        share = share if config.lag is None else np.full(AXES, config.lag)
        lag = 0.5 * share * np.linalg.norm(weight, axis=1)
        self._size = size = at.lag.stop
        covariance = np.zeros((size, size))
        covariance[: at.limb.stop, : at.limb.stop] = error_covariance(fit)
        covariance[at.offset, at.offset] += self._jump(config.since_fit_force, config.since_fit_torque)
        covariance[at.lag, at.lag] = np.diag(lag**2)
        drift = np.zeros((size, size))
        drift[at.offset, at.offset] = self._jump(config.drift_force, config.drift_torque)
        diagonal = np.eye(AXES).ravel()
        drift[at.response, at.response] = np.diag(diagonal * config.drift_scale**2)
        learnt = np.zeros(size)
        learnt[at.offset] = learnt[at.lag] = 1.0
        learnt[at.response] = {"offset": 0.0, "axes": diagonal, "matrix": 1.0}[config.learn]
        self._covariance = covariance  # before the first sample, (N, N)
        self._drift = drift  # growth of the covariance in a second, (N, N)
        self._learnt = learnt  # one for unknowns that are estimated, zero for those that are considered, (N,)
        self._identity = np.eye(size)
        self._lag = np.diag(lag**2)  # covariance of h, (6, 6)
        self._offset = fit.offset  # o in counts, (k,)
        self._whitened = sensor.whitening @ fit.response  # W A, (k, 6)
        self._matrix = fit.matrix  # C, (6, k)
        self._unwhiten = fit.matrix @ np.linalg.inv(sensor.whitening)  # C W^-1, (6, k)
        # Wrench below which an innovation is the sensor's, (6,).
        self._touch = config.touch * np.repeat([weight[:3].max(), np.linalg.norm(weight[3:], 2)], 3)

    def _jump(self, force: float, torque: float) -> np.ndarray[Any, np.dtype[np.float64]]:
        return offset_covariance(self.sensor.response, force, torque)

    def init(self, raw: Array) -> InSituState:
        """Return the state before any sample; see :class:`~surefoot.calibration.in_situ.InSituTracker`."""
        check_tail(raw, (self.channels,), "raw")
        batch = raw.shape[:-1]

        def zeros(*tail: int) -> Array:
            return np.zeros((*batch, *tail))

        return InSituState(
            mean=zeros(self._size),
            covariance=zeros(1, 1) + self._covariance,
            raw=zeros(1) + self._offset,
            anchor=zeros(DIRECT.stop),
        )

    def doubt(self, state: InSituState, force: float, torque: float) -> InSituState:
        """Return a state that allows a leap of the offset, of that deviation in N and N m."""
        more = np.zeros((self._size, self._size))
        more[self._at.offset, self._at.offset] = self._jump(force, torque)
        return state._replace(covariance=state.covariance + more)

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
        """Return the state after a sample, and the estimate.

        See :class:`~surefoot.calibration.in_situ.InSituTracker`.
        """
        sensor = self.sensor
        signals = _signals_of(
            raw, gravity, angular_velocity, angular_acceleration, like=state.raw, inertia=sensor.inertia
        )
        flags, ready, physical, passed = _flags_of(raw, signals, dt, self.config.code_range)
        signals = np.where(physical[..., None], signals, 0.0)
        state = state._replace(raw=np.where(np.isfinite(raw), raw, state.raw))
        aloft = np.broadcast_to(np.asarray(in_air, dtype=np.bool), ready.shape)
        pause = min(dt, _LONGEST_PAUSE) if passed else 0.0
        state = self._predict(state, signals[..., DIRECT], physical, aloft, pause)

        expected = (self._whitened @ sensor.wrench(signals)[..., None])[..., 0]
        y = (sensor.whitening @ (state.raw - self._offset)[..., None])[..., 0] - expected
        batch = y.shape[:-1]
        H = np.concatenate(
            [
                np.broadcast_to(sensor.whitening, (*batch, *sensor.whitening.shape)),
                sensor.rows(signals),
                np.broadcast_to(self._whitened, (*batch, *self._whitened.shape)),
            ],
            axis=-1,
        )
        innovation = y - (H @ state.mean[..., None])[..., 0]
        V = H @ state.covariance @ H.mT + self._identity[: self.channels, : self.channels]
        distance = (innovation * np.linalg.solve(V, innovation[..., None])[..., 0]).sum(axis=-1)
        touched = ~(distance <= self.config.reject**2) & self._felt(innovation)
        use = ready & aloft
        learns = use & ~touched
        mean, covariance = state.mean.copy(), state.covariance.copy()
        taken, rows, nis = np.zeros(batch, dtype=np.bool), np.zeros(batch), np.full(batch, np.nan)
        for sensor_of in np.ndindex(batch):
            if not learns[sensor_of]:
                continue
            step = kalman_step(
                mean[sensor_of],
                covariance[sensor_of],
                H[sensor_of],
                y[sensor_of],
                np.ones(self.channels),
                self._learnt,
                self.config.gate,
            )
            rows[sensor_of] = step.rows
            if np.isfinite(step.mean).all() and np.isfinite(step.covariance).all():
                mean[sensor_of], covariance[sensor_of] = step.mean, step.covariance
                taken[sensor_of], nis[sensor_of] = True, step.nis
        state = state._replace(mean=mean, covariance=covariance)
        marks = int(Flag.REJECTED) * (use & touched) + int(Flag.SINGULAR) * (learns & ~taken)
        estimate = self._estimate(state, flags | np.asarray(marks, dtype=np.int64)[..., None])
        return state, estimate._replace(nis=nis, nis_rows=rows, learnt=taken)

    def _felt(self, innovation: Array) -> Array:
        """Return whether innovations are those of a force or a torque that counts beside the limb's own."""
        shares = np.abs((self._unwhiten @ innovation[..., None])[..., 0]) / self._touch
        return ~(shares <= 1.0).all(axis=-1)

    def _predict(
        self, state: InSituState, gravity: Array, physical: Array, aloft: Array, dt: float
    ) -> InSituState:
        """Return the state a while later: offset and scale drift, hysteresis forgets as gravity turns.

        Another load than the limb's own makes it forget at once.
        """
        lag = self._at.lag
        covariance = state.covariance + dt * self._drift
        angle = np.sqrt(((gravity - state.anchor) ** 2).sum(axis=-1)) / GRAVITY
        turned = physical & (angle > _STEP * self.config.lag_angle)
        kept = np.where(turned, np.exp(-angle / self.config.lag_angle), 1.0)
        kept = np.where(aloft, kept, 0.0)
        f = np.ones((*kept.shape, lag.stop))
        f[..., lag] = kept[..., None]
        covariance = f[..., :, None] * covariance * f[..., None, :]
        fresh = (1.0 - kept**2)[..., None, None] * self._lag
        corner = covariance[..., lag, lag] + fresh
        below = np.concatenate([covariance[..., lag, : lag.start], corner], axis=-1)
        return state._replace(
            mean=f * state.mean,
            covariance=np.concatenate([covariance[..., : lag.start, :], below], axis=-2),
            anchor=np.where(turned[..., None], gravity, state.anchor),
        )

    def _estimate(self, state: InSituState, flags: Array) -> InSituEstimate:
        """Return the map undone: w = (1 + D)^-1 (C (r - o) - h)."""
        at = self._at
        D = state.mean[..., at.response].reshape(*state.mean.shape[:-1], AXES, AXES)
        axes = np.eye(AXES)
        scale = axes + D
        offset = self._offset + state.mean[..., at.offset]
        load = (self._matrix @ (state.raw - offset)[..., None])[..., 0] - state.mean[..., at.lag]
        wrench = np.linalg.solve(scale, load[..., None])[..., 0]
        # d w = -(1 + D)^-1 (C d o + dD w + d h)
        batch = wrench.shape[:-1]
        spread = axes[:, :, None] * wrench[..., None, None, :]
        columns = [
            np.broadcast_to(self._matrix, (*batch, *self._matrix.shape)),
            spread.reshape(*batch, AXES, RELATIVE_ERRORS),
            np.broadcast_to(axes, (*batch, AXES, AXES)),
        ]
        J = np.linalg.solve(scale, np.concatenate(columns, axis=-1))
        # Offset, D and h: all but the limb, which does not enter the map.
        sensor = at.response.stop
        P = state.covariance
        P = np.concatenate([P[..., :sensor], P[..., at.lag]], axis=-1)
        P = np.concatenate([P[..., :sensor, :], P[..., at.lag, :]], axis=-2)
        variance = ((J @ P) * J).sum(axis=-1)
        covariance = P[..., :sensor, :sensor]
        std = np.sqrt(np.linalg.diagonal(covariance))
        nothing = 0.0 * state.mean[..., 0]
        return InSituEstimate(
            wrench=wrench,
            wrench_std=np.sqrt(np.where(variance > 0.0, variance, 0.0)),
            offset=offset,
            offset_std=std[..., at.offset],
            scale=scale,
            scale_std=std[..., at.response].reshape(D.shape),
            covariance=covariance,
            nis=nothing + np.nan,
            nis_rows=nothing,
            learnt=nothing > 0.0,
            flags=flags,
        )


def _signals_of(
    raw: Array,
    gravity: Array,
    angular_velocity: Array | None,
    angular_acceleration: Array | None,
    *,
    like: Array,
    inertia: bool,
) -> Array:
    """Return u, gravity and in motion what turning adds, shape (..., 3) or (..., 12).

    Raises:
        ValueError: If a shape is not that of the first reading, or motion is given for a limb
            without inertia.
    """
    *batch, channels = like.shape
    given = {"raw": (raw, channels), "gravity": (gravity, 3)}
    if (angular_velocity is None) != (angular_acceleration is None):
        raise ValueError("Give 'angular_velocity' and 'angular_acceleration' together, or neither.")
    if angular_velocity is not None:
        given |= {
            "angular_velocity": (angular_velocity, 3),
            "angular_acceleration": (angular_acceleration, 3),
        }
    for name, (value, last) in given.items():
        check_tail(value, (last,), name)
        if value.shape != (*batch, last):
            raise ValueError(
                f"'{name}' must have shape {(*batch, last)} like the first reading, got {value.shape}."
            )
    if angular_velocity is None or angular_acceleration is None:
        return gravity
    if not inertia:
        raise ValueError(
            "This calibration does not know the limb's inertia: calibrate with the motion, or leave the "
            "angular velocity out."
        )
    products = np.stack([angular_velocity[..., i] * angular_velocity[..., j] for i, j in PAIRS], axis=-1)
    return np.concatenate([gravity, angular_acceleration, products], axis=-1)


def _flags_of(
    raw: Array, signals: Array, dt: float, code_range: tuple[float, float] | None
) -> tuple[Array, Array, Array, bool]:
    """Return flags of the channels, which readings are whole, which signals physical, and if time passed."""
    missing = np.isnan(raw)
    endless = np.isinf(raw)
    saturated = np.zeros_like(missing)
    if code_range is not None:
        saturated = ((raw <= code_range[0]) | (raw >= code_range[1])) & ~endless
    g = np.sqrt((signals[..., DIRECT] ** 2).sum(axis=-1))
    turning = (np.abs(signals[..., DIRECT.stop :]) < _FASTEST**2).all(axis=-1)
    physical = (g >= _LIGHTEST) & (g <= _HEAVIEST) & turning
    passed = bool(0.0 < dt < float("inf"))
    flags = (
        int(Flag.MISSING) * missing
        + int(Flag.OUT_OF_RANGE) * endless
        + int(Flag.SATURATED) * saturated
        + int(Flag.REFERENCE) * (~physical)[..., None]
    )
    flags = np.asarray(flags, dtype=np.int64) + (0 if passed else int(Flag.GAP))
    ready = physical & ~(missing | endless | saturated).any(axis=-1)
    return flags, ready, physical, passed
