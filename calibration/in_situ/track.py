r"""A calibrated sensor whose offset is followed while its limb hangs in the air.

Offsets drift with heat and use. Whenever nothing but its own weight hangs on the sensor, a reading is

.. math:: r = A\,(w + h) + o(t) + e, \qquad w = T(\varphi)\, u,

with an offset o that walks at random and errors h that change as the load turns: hysteresis, and the errors
of the calibration's matrix and limb. A Kalman filter estimates both. While the limb stands still h and the
offset cannot be told apart, however many samples repeat the same; once gravity has turned by ``lag_angle``, h
has another value. So the offset is the mean over turns of the limb, as far back as its drift allows. The part
of the hysteresis that never fades cannot be told from the offset in the air: it stays in the offset's
covariance. Nor is a scale learnt: a hanging limb turns too little to tell one from hysteresis.

With ``in_air=False``, or where a reading is off beyond all chance, something else than the limb's weight
acts: nothing is learnt, and the variance of the drift grows. An offset that has leapt far looks alike:
:meth:`InSituTracker.doubt` allows for that.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.arrays import Array
from surefoot.calibration.checks import check_tail
from surefoot.calibration.estimate import Flag
from surefoot.calibration.in_situ.covariance import UNIFORM
from surefoot.calibration.in_situ.data import InSituTrackerConfig, Matrix
from surefoot.calibration.in_situ.fit import ErrorColumns, InSituFit, check_calibrated, error_covariance
from surefoot.calibration.in_situ.model import (
    AXES,
    DIRECT,
    PAIRS,
    STATIC,
    inertial_parameters,
    transform_basis,
)
from surefoot.calibration.reference import GRAVITY

_STEP = 0.1
"""Share of ``lag_angle`` by which gravity must have turned to count as turning: a noisy IMU does not."""

_MEMORY = 60.0
"""Time in s over which gravity's mean is taken, beyond which an offset drifts by more than its mean errs."""

_LONGEST_PAUSE = 3600.0  # time in s beyond which a pause adds no more drift

_LIGHTEST, _HEAVIEST = 1.0, 100.0  # size of g - a in m/s^2 below and above which it is not that of a limb
_NOISE_FLOOR = 1e-6
"""Noise counts as at least this share of a channel's reading of the limb's weight: a simulation may have
none."""

_FASTEST = 1e3  # angular velocity in rad/s that no limb reaches; its square, an acceleration in rad/s^2


class InSituEstimate(NamedTuple):
    """Estimate from one reading; any leading batch dimensions ``...``; k channels. Always finite.

    Attributes:
        wrench: Wrench of the limb on the robot, at and in the sensor's frame in N and N m, shape (..., 6).
        wrench_std: Its standard deviation by the tracker's unknowns, shape (..., 6).
        offset: o in counts, shape (..., k).
        offset_std: Its standard deviation, shape (..., k).
        covariance: Of the offset, shape (..., k, k).
        nis: Normalised innovation squared of this sample, shape (...), NaN where nothing was learnt.
        learnt: Whether the sample was learnt from (bool), shape (...).
        flags: Bits of :class:`~surefoot.calibration.estimate.Flag`, shape (..., k): MISSING, OUT_OF_RANGE
            and SATURATED of a channel; REFERENCE (gravity or motion is not finite or not physical), GAP (no
            time has passed, or no number) and REJECTED (a touch) of all.
    """

    wrench: Array
    wrench_std: Array
    offset: Array
    offset_std: Array
    covariance: Array
    nis: Array
    learnt: Array
    flags: Array


class InSituState(NamedTuple):
    """State of a tracker; any leading batch dimensions ``...``; k channels, N = k + 6 unknowns."""

    mean: Array  # (offset's change in counts, h in N and N m), shape (..., N)
    covariance: Array  # its covariance, shape (..., N, N)
    raw: Array  # the last counts that arrived, shape (..., k)
    anchor: Array  # g from which on it has not turned, in m/s^2, shape (..., 3)
    middle: Array  # mean of g over the last while, shape (..., 3)


class InSituTracker:
    """A tracker of one sensor, or of a batch, with a state; :meth:`init` and :meth:`step` have none.

    Args:
        fit: The calibration to begin from.
        options: Fields of :class:`InSituTrackerConfig`.

    Attributes:
        state: A value to save (:func:`~surefoot.calibration.state.save_state`) and to set later; None before
            the first sample.

    Raises:
        ValueError: If the fit was refused, or an option has a value without meaning.
    """

    def __init__(self, fit: InSituFit, **options: Any) -> None:
        check_calibrated(fit, "The tracker")
        self.config = config = InSituTrackerConfig(**options)
        self.state: Any = None
        self.channels = channels = len(fit.offset)
        self._lag = lag = slice(channels, channels + AXES)
        self._size = size = lag.stop
        limb = fit.limb.parameters
        added_com = np.asarray(config.added_com, dtype=np.float64)
        limb = limb + inertial_parameters(config.added_mass, added_com, len(limb) > STATIC)
        bases = [transform_basis(moving) for moving in (False, True)[: 1 + (len(limb) > STATIC)]]
        maps = [np.einsum("p,pws->ws", limb[: len(basis)], basis) for basis in bases]
        self._transforms = {T.shape[1]: T for T in maps}  # T of w = T u, by the number of signals
        weight = maps[0] * GRAVITY
        floor = _NOISE_FLOOR * np.linalg.norm(fit.response @ weight, axis=1)
        self._white = np.linalg.inv(np.linalg.cholesky(fit.noise + np.diag(floor**2)))  # W Sigma W' = 1
        errors, to = error_covariance(fit), ErrorColumns.of(channels)
        self._errors = errors[to.response.start :, to.response.start :]  # of (D, limb), (40, 40)
        self._offset, self._matrix, self._response = fit.offset, fit.matrix, fit.response
        self._turning = self._errors_of_turning(fit, weight)
        covariance = np.zeros((size, size))
        covariance[:channels, :channels] = errors[to.offset, to.offset]
        covariance[lag, lag] = self._turning
        covariance += self._jump(config.since_fit_force, config.since_fit_torque)
        self._covariance = covariance  # before the first sample, (N, N)
        self._drift = self._jump(config.drift_force, config.drift_torque)  # growth in a second, (N, N)
        self._kept = 0.0 if fit.offset_doubt is None else fit.offset_doubt
        self._whitened = self._white @ fit.response  # W A, (k, 6)
        self._unwhiten = fit.matrix @ np.linalg.inv(self._white)  # C W^-1, (6, k)
        # Wrench below which an innovation is the sensor's, (6,).
        self._touch = config.touch * np.repeat([weight[:3].max(), np.linalg.norm(weight[3:], 2)], 3)

    def update(
        self,
        raw: ArrayLike,
        gravity: ArrayLike,
        dt: float,
        angular_velocity: ArrayLike | None = None,
        angular_acceleration: ArrayLike | None = None,
        in_air: bool | Array = True,
    ) -> InSituEstimate:
        """Return the estimate after one more sample.

        Args:
            raw: Counts, shape (..., k); NaN where none arrived.
            gravity: g, moving g - a, in the sensor's frame in m/s^2, pointing down, shape (..., 3).
            dt: Time since the last sample in s.
            angular_velocity: Of the limb in the sensor's frame in rad/s, shape (..., 3); None at rest, or
                where motion is slow enough to be left out.
            angular_acceleration: In rad/s^2, shape (..., 3); given with the velocity or not at all.
            in_air: Whether nothing touches the limb, one for all or shape (...).

        Returns:
            The wrench, and the estimate of the sensor.

        Raises:
            ValueError: If a shape does not fit, or motion is given for a limb without inertia.
        """
        raw = _array(raw)
        state = self.init(raw) if self.state is None else self.state
        self.state, estimate = self.step(
            state,
            raw,
            _array(gravity),
            dt,
            angular_velocity=None if angular_velocity is None else _array(angular_velocity),
            angular_acceleration=None if angular_acceleration is None else _array(angular_acceleration),
            in_air=in_air,
        )
        return estimate

    def doubt(self, force: float, torque: float) -> None:
        """Allow for a leap of the offset, after an overload or a power-up.

        Args:
            force: Standard deviation of the leap along each axis in N.
            torque: The same for torques in N m.

        Raises:
            RuntimeError: If no sample came yet: ``since_fit_force`` and ``since_fit_torque`` are for that.
        """
        if self.state is None:
            raise RuntimeError("There is nothing to doubt before the first update().")
        self.state = self.state._replace(covariance=self.state.covariance + self._jump(force, torque))

    def reset(self) -> None:
        """Go back to the calibration."""
        self.state = None

    def _jump(self, force: float, torque: float) -> NDArray[np.float64]:
        """Return the covariance of all unknowns by a leap of the offset, shape (N, N)."""
        more = np.zeros((self._size, self._size))
        more[: self.channels, : self.channels] = _offset_covariance(self._response, force, torque)
        return more

    def init(self, raw: Array) -> InSituState:
        """Return the state before any sample."""
        check_tail(raw, (self.channels,), "raw")
        batch = raw.shape[:-1]
        return InSituState(
            mean=np.zeros((*batch, self._size)),
            covariance=np.zeros((*batch, 1, 1)) + self._covariance,
            raw=np.zeros((*batch, 1)) + self._offset,
            anchor=np.zeros((*batch, DIRECT.stop)),
            middle=np.zeros((*batch, DIRECT.stop)),
        )

    def step(
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
        """Return the state after a sample, and the estimate; see :meth:`update`."""
        white, inertia = self._white, len(self._transforms) > 1
        u = _signals_of(raw, gravity, angular_velocity, angular_acceleration, state.raw, inertia)
        flags, ready, physical, passed = _flags_of(raw, u, dt, self.config.code_range)
        u = np.where(physical[..., None], u, 0.0)
        state = state._replace(raw=np.where(np.isfinite(raw), raw, state.raw))
        aloft = np.broadcast_to(np.asarray(in_air, dtype=np.bool), ready.shape)
        state = self._predict(
            state, u[..., DIRECT], physical, aloft, min(dt, _LONGEST_PAUSE) if passed else 0.0
        )

        expected = (self._whitened @ self._transforms[u.shape[-1]] @ u[..., None])[..., 0]
        innovation = (white @ (state.raw - self._offset)[..., None])[..., 0] - expected
        H = np.concatenate([white, self._whitened], axis=1)
        innovation = innovation - (H @ state.mean[..., None])[..., 0]
        PH = state.covariance @ H.T
        V = H @ PH + np.eye(self.channels)
        distance = (innovation * np.linalg.solve(V, innovation[..., None])[..., 0]).sum(axis=-1)
        felt = np.abs((self._unwhiten @ innovation[..., None])[..., 0]) > self._touch
        touched = (distance > self.config.reject**2) & felt.any(axis=-1)
        learnt = ready & aloft & ~touched & np.isfinite(distance)
        noise = np.maximum(distance / self.config.reject**2, 1.0)
        gain = np.where(learnt[..., None, None], np.linalg.solve(noise[..., None, None] * V, PH.mT).mT, 0.0)
        # Joseph's form, which stays positive.
        keep = np.eye(self._size) - gain @ H
        rest = noise[..., None, None] * V - H @ PH
        state = state._replace(
            mean=state.mean + (gain @ np.where(learnt[..., None], innovation, 0.0)[..., None])[..., 0],
            covariance=keep @ state.covariance @ keep.mT + gain @ rest @ gain.mT,
        )
        marks = int(Flag.REJECTED) * (ready & aloft & touched)
        estimate = self._estimate(state, flags | np.asarray(marks, dtype=np.int64)[..., None])
        return state, estimate._replace(nis=np.where(learnt, distance, np.nan), learnt=learnt)

    def _predict(
        self, state: InSituState, gravity: Array, physical: Array, aloft: Array, dt: float
    ) -> InSituState:
        """Predict the state after ``dt``: the offset drifts, and h fades as gravity turns.

        A load other than the limb's own resets h at once.
        """
        lag = self._lag
        angle = np.sqrt(((gravity - state.anchor) ** 2).sum(axis=-1)) / GRAVITY
        turned = physical & (angle > _STEP * self.config.lag_angle)
        kept = np.where(turned, np.exp(-angle / self.config.lag_angle), 1.0)
        kept = np.where(aloft, kept, 0.0)
        f = np.ones((*kept.shape, self._size))
        f[..., lag] = kept[..., None]
        covariance = f[..., :, None] * (state.covariance + dt * self._drift) * f[..., None, :]
        covariance[..., lag, lag] += (1.0 - kept**2)[..., None, None] * self._turning
        anchor = np.where(turned[..., None], gravity, state.anchor)
        started = (state.middle != 0.0).any(axis=-1)
        share = (physical & aloft) * np.where(started, 1.0 - np.exp(-dt / _MEMORY), 1.0)
        middle = state.middle + share[..., None] * (gravity - state.middle)
        return InSituState(f * state.mean, covariance, state.raw, anchor, middle)

    def _estimate(self, state: InSituState, flags: Array) -> InSituEstimate:
        """Return the map undone: w = C (r - o) - h."""
        offset = self._offset + state.mean[..., : self.channels]
        J = np.concatenate([self._matrix, np.eye(AXES)], axis=1)
        variance = ((J @ state.covariance) * J).sum(axis=-1)
        # Errors of matrix and limb at the mean load, which the offset takes in.
        rows = self._slopes(state.middle)
        kept = self._kept + rows @ self._errors @ rows.mT
        covariance = state.covariance[..., : self.channels, : self.channels] + kept
        return InSituEstimate(
            wrench=(self._matrix @ (state.raw - offset)[..., None])[..., 0] - state.mean[..., self._lag],
            wrench_std=np.sqrt(np.maximum(variance, 0.0)),
            offset=offset,
            offset_std=np.sqrt(np.linalg.diagonal(covariance)),
            covariance=covariance,
            nis=np.full(offset.shape[:-1], np.nan),
            learnt=np.zeros(offset.shape[:-1], dtype=np.bool),
            flags=flags,
        )

    def _slopes(self, gravity: Array) -> Array:
        """Return slopes of readings by (D row by row, m, m c), shape (..., k, 40), of g, shape (..., 3)."""
        w = (self._transforms[3] @ gravity[..., None])[..., 0]
        relative = self._response[:, :, None] * w[..., None, None, :]
        limb = np.moveaxis(transform_basis(False), 0, 1) @ gravity[..., None, :, None]
        parts = (relative.reshape(*w.shape[:-1], self.channels, -1), self._response @ limb[..., 0])
        return np.concatenate(parts, axis=-1)

    def _errors_of_turning(self, fit: InSituFit, weight: Matrix) -> Matrix:
        """Return the covariance of h, shape (6, 6), over all directions of gravity.

        Anywhere in the loop, and the weight's error by the fit's covariance of matrix and limb.
        """
        rows = np.linalg.pinv(self._white @ fit.response) @ self._white @ self._slopes(GRAVITY * np.eye(3))
        covariance, lag = np.mean(rows @ self._errors @ rows.mT, axis=0), self.config.lag
        share = fit.hysteresis.share if lag is None and fit.hysteresis is not None else lag
        width = np.linalg.norm(weight, axis=1) * (0.0 if share is None else share)
        return np.asarray(covariance + np.diag((UNIFORM * width) ** 2))


def _array(values: ArrayLike) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)


def _offset_covariance(response: Matrix, force: float, torque: float) -> Matrix:
    """Return the covariance in counts^2 of an offset that shows as a force and a torque, shape (k, k)."""
    image = response * np.repeat([force, torque], 3)
    inside = image @ image.T
    # Readings of redundant channels beyond any wrench move as much as the rest, on average.
    beyond = np.linalg.svd(response, full_matrices=True)[0][:, AXES:]
    return np.asarray(inside + beyond @ beyond.T * np.trace(inside) / AXES)


def _signals_of(
    raw: Array, gravity: Array, velocity: Array | None, acceleration: Array | None, like: Array, inertia: bool
) -> Array:
    """Return u, gravity and in motion the terms of rotation, shape (..., 3) or (..., 12).

    ValueError if a shape is not that of the first reading, or a limb without inertia moves.
    """
    *batch, channels = like.shape
    given = {"raw": (raw, channels), "gravity": (gravity, 3)}
    if (velocity is None) != (acceleration is None):
        raise ValueError("Give 'angular_velocity' and 'angular_acceleration' together, or neither.")
    if velocity is not None and acceleration is not None:
        given |= {"angular_velocity": (velocity, 3), "angular_acceleration": (acceleration, 3)}
    for name, (value, last) in given.items():
        check_tail(value, (last,), name)
        if value.shape != (*batch, last):
            raise ValueError(
                f"'{name}' must have shape {(*batch, last)} like the first reading, got {value.shape}."
            )
    if velocity is None or acceleration is None:
        return gravity
    if not inertia:
        raise ValueError(
            "This calibration does not know the limb's inertia: calibrate with the motion, or leave the "
            "angular velocity out."
        )
    products = np.stack([velocity[..., i] * velocity[..., j] for i, j in PAIRS], axis=-1)
    return np.concatenate([gravity, acceleration, products], axis=-1)


def _flags_of(
    raw: Array, signals: Array, dt: float, code_range: tuple[float, float] | None
) -> tuple[Array, Array, Array, bool]:
    """Return flags of the channels, which readings are whole, which signals physical, and if time passed."""
    low, high = code_range or (-np.inf, np.inf)
    missing, endless = np.isnan(raw), np.isinf(raw)
    saturated = ((raw <= low) | (raw >= high)) & ~endless
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
    return flags, physical & ~(missing | endless | saturated).any(axis=-1), physical, passed
