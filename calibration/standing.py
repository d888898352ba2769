r"""Starting values from quiet standing, and how far they are determined.

The ground force on a robot at rest is M g below its centre of mass (x, y). For the cells of both feet
(CoP paper, Eqs. 12, 13), at each sample k,

    sum_i (c_i S_ik + d_i) = M g,      sum_i (x_i, y_i) (c_i S_ik + d_i) = (x, y) M g,

which is linear in (c, d). Samples are used if the feet are in contact (Fz > 5 N by the starting map) and the
robot is still (specific force within a_th of g, angular velocity below w_th), after a warm-up time T_warm,
until there are enough of them.

The paper solves this by least squares and does not mention that it is singular. The samples of a still robot
are all the same, so that they determine three combinations of sixteen unknowns, and noise would determine the
others. Shifting the weight adds the scales. As long as the feet do not move, the offsets enter only by their
sum and two moments. This gives at most eleven combinations; the others need a foot in the air. Here the
solution stays as close to the starting map as the data allow. With F = a F0 + b, where F0 is the force by the
starting map,

    min  sum_k |r_k(a, b) - e|^2 / s^2  +  |a - 1|^2 / s_a^2  +  |b|^2 / s_b^2  +  |e|^2 / s_e^2

where e is the common error of all samples because the believed mass and centre of mass are wrong. Averaging
does not remove it. The minimum changes only the combinations that the samples determine, with their
covariance. Moments are taken about the centre of mass, which is Eq. 12 less (x, y) times its first row. With
s_e = 0 and s small compared with s_a and s_b it is the paper's solution of minimum change.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.calibration.arrays import Array
from surefoot.calibration.checks import (
    check_counts,
    check_floating,
    check_not_negative,
    check_positive,
    check_shape,
)
from surefoot.calibration.cop import FORCE_THRESHOLD, moment_rows
from surefoot.calibration.front_end.motion import FARTHEST, LARGEST_REFERENCE
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY, Reference
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats
from surefoot.checks import check_value

_ROWS = 3

PLAUSIBLE_WEIGHTS = 20.0
"""Force of one channel, in body weights, above which a reading counts as an error."""


class StandingState(NamedTuple):
    """Sums over the samples so far."""

    time: float  # time since the start in s
    samples: int  # samples that were used
    dropped: int  # samples after the warm-up with a value that is not finite or not plausible
    gated: int  # samples after the warm-up without contact or with motion
    information: Array  # sum of J' J over the whitened rows, shape (2 K + 3, 2 K + 3)
    gradient: Array  # sum of J' y, shape (2 K + 3,)
    energy: float  # sum of y' y


class StandingEstimate(NamedTuple):
    """Starting values."""

    parameters: Parameters  # the map (c, d) of the readings, shape (K,) each
    correction: Parameters  # the same as (a, b) of F = a F0 + b, shape (K,) each
    covariance: Array  # of (a_1, ..., a_K, b_1, ..., b_K), shape (2 K, 2 K)
    rank: int  # directions of (a, b) whose variance the samples at least halved
    residual_rms: float  # root mean square of the residual, in multiples of the assumed noise
    condition: float  # largest over smallest posterior standard deviation of a direction
    ready: bool  # whether there were enough samples over a long enough time


@dataclass(frozen=True, eq=False, kw_only=True)
class QuietStanding:
    """The standing start of one robot, as pure functions of :class:`StandingState`.

    ``state = init(raw)``, then ``state = update(state, raw, reference, dt)`` for every sample, then
    ``solve(state)`` as soon as ``ready(state)``. For a recording see
    :func:`surefoot.calibration.standing.standing_start`.
    """

    layout: FeetLayout
    """How the channels make up the feet's wrenches."""

    mass: float
    """Mass of the robot as the robot knows it, in kg."""

    start: Parameters
    """The starting map (c0, d0), such as the sensors' nominal one, shape (K,) each."""

    warm_up: float = 1.0
    """Time at the beginning that is not used, T_warm, in s."""

    duration: float = 2.0
    """Minimum time after the warm-up in s, longer if there are not enough samples."""

    minimum_samples: int = 80
    """Minimum number of samples."""

    threshold: float = FORCE_THRESHOLD
    """Total vertical force in N, by the starting map, above which the feet count as in contact."""

    acceleration_threshold: float = 0.5
    """Largest difference between the length of the specific force and g in m/s^2, a_th."""

    rate_threshold: float = 0.1
    """Largest angular velocity of the torso in rad/s, w_th."""

    scale_std: float = 0.1
    """Prior standard deviation of scales relative to the starting map, sigma_a."""

    offset_std: float = 1.5
    """Prior standard deviation of offsets from the starting map in N, sigma_b."""

    force_noise: float = 0.2
    """Noise of one sample's total force, cells and reference together, in N."""

    cop_noise: float = 1e-3
    """Noise of one sample's centre of pressure against the centre of mass in m."""

    gravity: float = GRAVITY
    """Acceleration of free fall in m/s^2."""

    mass_error: float = 0.005
    """Relative error of the believed mass, common to all samples."""

    com_error: float = 3e-3
    """Error of the believed centre of mass in m per axis, common to all samples."""

    def __post_init__(self) -> None:
        """Raise an error if a value is out of range."""
        positive = ("mass", "gravity", "acceleration_threshold", "rate_threshold", "scale_std", "offset_std")
        check_positive(self, *positive, "force_noise", "cop_noise")
        check_not_negative(self, "warm_up", "duration", "threshold", "mass_error", "com_error")
        check_counts(self, "minimum_samples")
        for field in ("scale", "offset"):
            value = getattr(self.start, field)
            self.layout.check_reading(value, f"start.{field}")
            if not np.isfinite(np.asarray(value)).all():
                raise ValueError(f"'start.{field}' holds values that are not finite: {value}.")

    def init(self, raw: Array) -> StandingState:
        """Return the state before the first sample. The values of ``raw``, shape (K,), are not used."""
        self.layout.check_reading(raw)
        unknowns = 2 * self.layout.channels + _ROWS
        return StandingState(0.0, 0, 0, 0, np.zeros((unknowns, unknowns)), np.zeros(unknowns), 0.0)

    def update(self, state: StandingState, raw: Array, reference: Reference, dt: float) -> StandingState:
        """Process one sample: readings, shape (K,), and the state estimate at the same time.

        Samples that are not finite, not in contact or not still are only counted. ValueError for a wrong
        shape. ``dt`` is the time to the next sample in s.
        """
        self._check(raw, reference)
        warm = state.time >= self.warm_up - 1e-9
        state = state._replace(time=state.time + dt)
        if not warm:
            return state
        if not self._finite(raw, reference):
            return state._replace(dropped=state.dropped + 1)
        rows, target, loaded = self._rows(raw, reference)
        if not (loaded and self._still(reference)):
            return state._replace(gated=state.gated + 1)
        return state._replace(
            samples=state.samples + 1,
            information=state.information + rows.T @ rows,
            gradient=state.gradient + rows.T @ target,
            energy=state.energy + float(target @ target),
        )

    def ready(self, state: StandingState) -> bool:
        """Return whether there were enough samples over a long enough time."""
        enough_time = state.time >= self.warm_up + self.duration - 1e-9
        return state.samples >= self.minimum_samples and enough_time

    def solve(self, state: StandingState) -> StandingEstimate:
        """Return the map closest to the starting map that explains the samples (CoP paper, Eq. 13).

        Without samples this is the starting map.
        """
        K, deviation = self.layout.channels, self._deviations()
        posterior = np.linalg.inv(state.information + np.eye(2 * K + _ROWS))
        posterior = 0.5 * (posterior + posterior.T)
        whitened = posterior @ state.gradient
        shift = whitened[: 2 * K] * deviation
        correction = Parameters(1.0 + shift[:K], shift[K:])
        of_map = posterior[: 2 * K, : 2 * K]
        variance = np.linalg.eigvalsh(of_map)
        residual = state.energy + whitened @ (state.information @ whitened - 2.0 * state.gradient)
        return StandingEstimate(
            parameters=correction.after(self.start),
            correction=correction,
            covariance=deviation[:, None] * of_map * deviation,
            rank=int((variance < 0.5).sum()),
            residual_rms=float(np.sqrt(max(residual, 0.0) / (_ROWS * max(state.samples, 1)))),
            condition=float(np.sqrt(variance[-1] / variance[0])),
            ready=self.ready(state),
        )

    def _deviations(self) -> Floats:
        """Return the prior standard deviations of (a, b), shape (2 K,)."""
        return np.repeat([self.scale_std, self.offset_std], self.layout.channels)

    def _check(self, raw: Array, reference: Reference) -> None:
        """Raise ValueError if a shape is not that of one sample, or a dtype is not floating."""
        feet = len(self.layout.feet)
        self.layout.check_reading(raw)
        for field, shape in (
            ("com", (3,)),
            ("position_sole", (feet, 3)),
            ("R_level_sole", (feet, 3, 3)),
            ("accelerometer", (3,)),
            ("gyroscope", (3,)),
        ):
            check_floating(getattr(reference, field), field)
            check_shape(getattr(reference, field), shape, field)

    def _finite(self, raw: Array, reference: Reference) -> bool:
        """Return whether all values of a sample are finite and plausible for a robot."""
        force = self.start.force(raw)
        beliefs = (reference.com, reference.position_sole, reference.R_level_sole)
        measured = (reference.accelerometer, reference.gyroscope)
        near = np.abs(reference.position_sole - reference.com) <= FARTHEST
        force_fits = np.abs(force) <= PLAUSIBLE_WEIGHTS * self.mass * self.gravity
        return bool(near.all() and force_fits.all()) and all(
            bool((np.abs(part) <= LARGEST_REFERENCE).all()) for part in (*beliefs, *measured)
        )

    def _still(self, reference: Reference) -> bool:
        """Return whether the robot is at rest according to its IMU."""
        specific, rate = np.linalg.norm(reference.accelerometer), np.linalg.norm(reference.gyroscope)
        return bool(abs(specific - self.gravity) < self.acceleration_threshold and rate < self.rate_threshold)

    def _rows(self, raw: Array, reference: Reference) -> tuple[Array, Array, bool]:
        """Return a sample as whitened rows, J (3, 2 K + 3) u = y (3,), and whether feet are in contact."""
        weight, force = self.mass * self.gravity, self.start.force(raw)
        about_com = reference.position_sole - np.append(reference.com[:2], 0.0)
        by_channel = moment_rows(self.layout, about_com, reference.R_level_sole).sum(axis=0)
        total = by_channel @ force
        noise = np.array([self.force_noise, weight * self.cop_noise, weight * self.cop_noise])
        shared = np.diag([weight * self.mass_error, *[weight * self.com_error] * 2])
        by_unknown = np.hstack([by_channel * force, by_channel]) * self._deviations()
        rows = np.hstack([by_unknown, shared]) / noise[:, None]
        return rows, (np.array([weight, 0.0, 0.0]) - total) / noise, bool(total[0] > self.threshold)


@dataclass(frozen=True, eq=False)
class StandingFit:
    """Starting values from a recording of quiet standing."""

    value: Parameters  # the map (c, d) of the readings
    correction: Parameters  # the same as (a, b) of F = a F0 + b
    covariance: Floats
    """Covariance of (a_1, ..., a_K, b_1, ..., b_K), shape (2 K, 2 K), for the assumed errors of the robot's
    mass and centre of mass."""
    result: FitResult  # whether all directions were determined, which quiet standing alone never achieves
    stats: FitStats  # statistics of the fit, with the residual in multiples of the assumed noise
    duration: float  # length of the part of the recording that was used in s


def _check_lengths(code: Floats, reference: Reference) -> None:
    """Raise ValueError unless readings and references have the same number of samples."""
    if code.ndim != 2:
        raise ValueError(f"'raw' must have shape (samples, channels), got {code.shape}.")
    lengths = {name: len(field) for name, field in reference._asdict().items() if len(field) != len(code)}
    if lengths:
        raise ValueError(f"'raw' holds {len(code)} samples, but fields of the reference hold {lengths}.")


def _too_few(standing: QuietStanding, state: Any, code: Floats) -> CalibrationRefused:
    """Return the refusal of a recording with too few usable samples."""
    after_warm_up = state.samples + state.dropped + state.gated
    return CalibrationRefused(
        f"Only {state.samples} of the {standing.minimum_samples} samples that are needed were usable: of "
        f"{after_warm_up} after {standing.warm_up:g} s of warm-up, {state.dropped} held values that are "
        f"not finite{_silent_channels(code, standing.layout)} and {state.gated} lacked contact or moved.",
        "Stand still for longer, or check the IMU, its thresholds and the cells.",
    )


def standing_start(standing: QuietStanding, raw: ArrayLike, reference: Reference, dt: float) -> StandingFit:
    """Fit a recording, using only as much of it as is needed.

    Args:
        standing: The robot, its starting map, and the thresholds.
        raw: Readings, shape (n, K).
        reference: The robot's state estimate, with n samples on the first axis of each field.
        dt: Time between samples in s.

    Returns:
        The starting values.

    Raises:
        ValueError: If a shape is not as above.
        CalibrationRefused: If too few samples were finite, in contact and still.
    """
    check_value("dt", dt, positive=True)
    code = np.asarray(raw, dtype=np.float64)
    _check_lengths(code, reference)
    log = Reference(*(np.asarray(field) for field in reference))
    state, end = standing.init(np.zeros(standing.layout.channels)), 0
    while end < len(code) and not standing.ready(state):
        state = standing.update(state, code[end], Reference(*(field[end] for field in log)), dt)
        end += 1
    if state.samples < standing.minimum_samples:
        raise _too_few(standing, state, code)
    estimate, unknowns = standing.solve(state), 2 * standing.layout.channels
    return StandingFit(
        value=estimate.parameters,
        correction=estimate.correction,
        covariance=estimate.covariance,
        result=FitResult.DETERMINED if estimate.rank == unknowns else FitResult.PARTLY_DETERMINED,
        stats=FitStats(
            samples=state.samples,
            dropped=state.dropped,
            gated=state.gated,
            residual_rms=estimate.residual_rms,
            rank=estimate.rank,
            unknowns=unknowns,
            condition=estimate.condition,
        ),
        duration=end * dt,
    )


def _silent_channels(raw: Floats, layout: FeetLayout) -> str:
    silent = [
        name
        for name, readings in zip(layout.channel_names, raw.T, strict=True)
        if not np.isfinite(readings).any()
    ]
    return f" (no reading at all from {', '.join(silent)})" if silent else ""
