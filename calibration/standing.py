r"""Starting values from quiet standing: how much of its load cells a robot at rest shows.

A robot at rest presses with M g below its centre of mass (x, y), so that over the cells of both feet
(CoP paper, Eqs. 12, 13), per sample k,

    sum_i (c_i S_ik + d_i) = M g,      sum_i (x_i, y_i) (c_i S_ik + d_i) = (x, y) M g,

which is linear in (c, d). Used are samples in contact (Fz > 5 N by the starting map) and still (the
specific force within a_th of g, the angular velocity below w_th), after a time of warming up T_warm,
for as long as it takes to have enough.

The paper solves this by least squares and does not mention that it is singular. A still robot shows one
sample over and over, so that three combinations of sixteen unknowns follow, and the noise of the readings
would invent the others. Shifting the weight about adds the scales. The offsets enter only by their sum and
two moments for as long as the feet stay: eleven combinations at most, never sixteen; the others take a foot
in the air. Here the solution stays as near the starting map as the data allow. With F = a F0 + b and F0 the
force by the starting map,

    min  sum_k |r_k(a, b) - e|^2 / s^2  +  |a - 1|^2 / s_a^2  +  |b|^2 / s_b^2  +  |e|^2 / s_e^2

where e is the error that all samples share because the believed mass and centre of mass are wrong, which
averaging does not remove. The minimum changes only the parts that the samples determine, and its covariance
says how well they do. Moments are taken about the centre of mass, which is Eq. 12 less (x, y) times its first
row. With s_e = 0 and s small against s_a and s_b it is the paper's solution of least change.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.calibration.arrays import Array
from surefoot.calibration.checks import (
    check_count,
    check_floating,
    check_not_negative,
    check_positive,
    check_shape,
    check_value,
)
from surefoot.calibration.cop import FORCE_THRESHOLD, moment_rows
from surefoot.calibration.front_end.motion import FARTHEST, LARGEST_REFERENCE
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY, Reference
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats

_ROWS = 3

PLAUSIBLE_WEIGHTS = 20.0
"""Force of one channel, in body weights, beyond which a reading is taken for an error."""


class StandingState(NamedTuple):
    """The samples so far."""

    time: float  # time since the start in s
    samples: int  # samples that were used
    dropped: int  # samples after warming up with a value that is not finite or absurd
    gated: int  # samples after warming up without contact or with motion
    information: Array  # sum of J' J over the whitened rows, shape (2 K + 3, 2 K + 3)
    gradient: Array  # sum of J' y, shape (2 K + 3,)
    energy: float  # sum of y' y


class StandingEstimate(NamedTuple):
    """Starting values."""

    parameters: Parameters  # the map (c, d) of the readings, shape (K,) each
    correction: Parameters  # the same as (a, b) of F = a F0 + b, shape (K,) each
    covariance: Array  # of (a_1, ..., a_K, b_1, ..., b_K), shape (2 K, 2 K)
    rank: int  # directions of (a, b) whose variance the samples at least halved
    residual_rms: float  # root mean square of the residual, in multiples of the noise that was assumed
    condition: float  # ratio of the most to the least constrained direction's standard deviation
    ready: bool  # whether enough samples came over enough time


@dataclass(frozen=True, eq=False, kw_only=True)
class QuietStanding:
    """The standing start of one robot: pure functions over :class:`StandingState`.

    ``state = init(raw)``, then ``state = update(state, raw, reference, dt)`` for every sample, then
    ``solve(state)`` as soon as ``ready(state)``. For a recording see
    :func:`surefoot.calibration.standing.standing_start`.
    """

    layout: FeetLayout
    """How the channels make up the feet's wrenches."""

    mass: float
    """The robot's mass as it believes it, in kg."""

    start: Parameters
    """The map (c0, d0) to start from, such as the sensors' nominal one, shape (K,) each."""

    warm_up: float = 1.0
    """Time at the beginning that is left out, T_warm, in s."""

    duration: float = 2.0
    """Time after warming up that is to be seen, in s; more if the samples do not suffice."""

    minimum_samples: int = 80
    """Samples that are needed."""

    threshold: float = FORCE_THRESHOLD
    """Total vertical force in N, by the starting map, that a sample must exceed to count as contact."""

    acceleration_threshold: float = 0.5
    """How far the length of the specific force may be from g in m/s^2, a_th."""

    rate_threshold: float = 0.1
    """How fast the torso may turn in rad/s, w_th."""

    scale_std: float = 0.1
    """How far scales are thought to be from the start, as a share of them, sigma_a."""

    offset_std: float = 1.5
    """How far offsets are thought to be from the start in N, sigma_b."""

    force_noise: float = 0.2
    """Noise of one sample's total force, cells and reference together, in N."""

    cop_noise: float = 1e-3
    """Noise of one sample's centre of pressure against the centre of mass in m."""

    gravity: float = GRAVITY
    """Acceleration of free fall in m/s^2."""

    mass_error: float = 0.005
    """Error of the believed mass as a share of it; all samples have it in common."""

    com_error: float = 3e-3
    """Error of the believed centre of mass in m, per axis; all samples have it in common."""

    def __post_init__(self) -> None:
        """Raise an error if a value has no meaning."""
        positive = ("mass", "gravity", "acceleration_threshold", "rate_threshold", "scale_std", "offset_std")
        check_positive(self, *positive, "force_noise", "cop_noise")
        check_not_negative(self, "warm_up", "duration", "threshold", "mass_error", "com_error")
        check_count(self, "minimum_samples")
        for field in ("scale", "offset"):
            value = getattr(self.start, field)
            self.layout.check_reading(value, f"start.{field}")
            if not np.isfinite(np.asarray(value)).all():
                raise ValueError(f"'start.{field}' holds values that are not finite: {value}.")

    def init(self, raw: Array) -> StandingState:
        """Return the state before any sample, of a reading, (K,), whose values do not matter."""
        self.layout.check_reading(raw)
        unknowns = 2 * self.layout.channels + _ROWS
        return StandingState(0.0, 0, 0, 0, np.zeros((unknowns, unknowns)), np.zeros(unknowns), 0.0)

    def update(self, state: StandingState, raw: Array, reference: Reference, dt: float) -> StandingState:
        """Take in one sample: readings, (K,), and beliefs at the same time, ``dt`` s before the next one.

        One that is not finite, in contact and still is only counted; another shape is refused with a
        ValueError.
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
        """Return whether enough samples came over enough time."""
        enough_time = state.time >= self.warm_up + self.duration - 1e-9
        return state.samples >= self.minimum_samples and enough_time

    def solve(self, state: StandingState) -> StandingEstimate:
        """Return the map nearest to the starting one that explains the samples (CoP paper, Eq. 13).

        Without samples it is the starting map.
        """
        K, deviation = self.layout.channels, self._deviations()
        posterior = np.linalg.inv(state.information + np.eye(2 * K + _ROWS))
        posterior = 0.5 * (posterior + posterior.T)
        whitened = posterior @ state.gradient
        shift = whitened[: 2 * K] * deviation
        correction = Parameters(1.0 + shift[:K], shift[K:])
        kept = posterior[: 2 * K, : 2 * K]
        variance = np.linalg.eigvalsh(kept)
        left = state.energy + whitened @ (state.information @ whitened - 2.0 * state.gradient)
        return StandingEstimate(
            parameters=correction.after(self.start),
            correction=correction,
            covariance=deviation[:, None] * kept * deviation,
            rank=int((variance < 0.5).sum()),
            residual_rms=float(np.sqrt(max(left, 0.0) / (_ROWS * max(state.samples, 1)))),
            condition=float(np.sqrt(variance[-1] / variance[0])),
            ready=self.ready(state),
        )

    def _deviations(self) -> Floats:
        """Return the units of (a, b), shape (2 K,): one is as far from the start as assumed."""
        return np.repeat([self.scale_std, self.offset_std], self.layout.channels)

    def _check(self, raw: Array, reference: Reference) -> None:
        """Raise ValueError if a shape is not that of one sample, or a dtype not floating."""
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
        """Return whether all of a sample is finite, and of a size that a robot can have."""
        force = self.start.force(raw)
        beliefs = (reference.com, reference.position_sole, reference.R_level_sole)
        measured = (reference.accelerometer, reference.gyroscope)
        near = np.abs(reference.position_sole - reference.com) <= FARTHEST
        force_fits = np.abs(force) <= PLAUSIBLE_WEIGHTS * self.mass * self.gravity
        return bool(near.all() and force_fits.all()) and all(
            bool((np.abs(part) <= LARGEST_REFERENCE).all()) for part in (*beliefs, *measured)
        )

    def _still(self, reference: Reference) -> bool:
        """Return whether the robot is at rest by its IMU."""
        specific, rate = np.linalg.norm(reference.accelerometer), np.linalg.norm(reference.gyroscope)
        return bool(abs(specific - self.gravity) < self.acceleration_threshold and rate < self.rate_threshold)

    def _rows(self, raw: Array, reference: Reference) -> tuple[Array, Array, bool]:
        """Return a sample as whitened rows, J (3, 2 K + 3) u = y (3,), and whether it is in contact."""
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
    """Of (a_1, ..., a_K, b_1, ..., b_K), shape (2 K, 2 K), given that the errors of the robot's mass and
    centre of mass are as small as assumed."""
    result: FitResult  # whether all directions were determined; quiet standing alone never does that
    stats: FitStats  # of the fit; the residual is in multiples of the noise that was assumed
    duration: float  # how much of the recording was needed, in s


def _check_lengths(code: Floats, reference: Reference) -> None:
    """Raise ValueError if readings and references are not of as many samples."""
    if code.ndim != 2:
        raise ValueError(f"'raw' must have shape (samples, channels), got {code.shape}.")
    lengths = {name: len(field) for name, field in reference._asdict().items() if len(field) != len(code)}
    if lengths:
        raise ValueError(f"'raw' holds {len(code)} samples, but fields of the reference hold {lengths}.")


def _too_few(standing: QuietStanding, state: Any, code: Floats) -> CalibrationRefused:
    """Return the refusal of a recording with too few usable samples."""
    warm = state.samples + state.dropped + state.gated
    return CalibrationRefused(
        f"Only {state.samples} of the {standing.minimum_samples} samples that are needed were usable: of "
        f"{warm} after {standing.warm_up:g} s of warming up, {state.dropped} held values that are "
        f"not finite{_silent_channels(code, standing.layout)} and {state.gated} lacked contact or moved.",
        "Stand still for longer, or check the IMU, its thresholds and the cells.",
    )


def standing_start(standing: QuietStanding, raw: ArrayLike, reference: Reference, dt: float) -> StandingFit:
    """Fit a recording, using no more of it than is needed.

    Args:
        standing: The robot, its starting map, and the thresholds.
        raw: Readings, shape (n, K).
        reference: The robot's beliefs, each field with n samples on its first axis.
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
