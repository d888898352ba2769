r"""Starting values from quiet standing: what a robot at rest shows of its load cells, and what not.

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
averaging does not remove. The minimum changes only what the samples determine, and its covariance says how
well they do. Moments are taken about the centre of mass, which is Eq. 12 less (x, y) times its first
row. With s_e = 0 and s small against s_a and s_b it is the paper's solution of least change.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array
from surefoot.calibration.checks import check_count, check_not_negative, check_positive, check_tail
from surefoot.calibration.cop import FORCE_THRESHOLD, moment_rows
from surefoot.calibration.front_end.motion import LARGEST_REFERENCE
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY, Reference

__all__ = ["QuietStanding", "StandingEstimate", "StandingState"]

_ROWS = 3

PLAUSIBLE_WEIGHTS = 20.0
"""Force of one channel, in body weights, beyond which a reading is taken for an error."""


class StandingState(NamedTuple):
    """What has been seen so far; any batch dimensions ``...``.

    Attributes:
        time: Time since the start in s, shape (...).
        samples: Samples that were used, shape (...).
        dropped: Samples after warming up with a value that is not finite or absurd, shape (...).
        gated: Samples after warming up without contact or with motion, shape (...).
        information: Sum of J' J over the whitened rows, shape (..., 2 K + 3, 2 K + 3).
        gradient: Sum of J' y, shape (..., 2 K + 3).
        energy: Sum of y' y, shape (...).
    """

    time: Array
    samples: Array
    dropped: Array
    gated: Array
    information: Array
    gradient: Array
    energy: Array


class StandingEstimate(NamedTuple):
    """Starting values; any batch dimensions ``...``.

    Attributes:
        parameters: The map (c, d) of the readings, shape (..., K) each.
        correction: The same as (a, b) of F = a F0 + b, shape (..., K) each.
        covariance: Of (a_1, ..., a_K, b_1, ..., b_K), shape (..., 2 K, 2 K).
        rank: Directions of (a, b) whose variance the samples at least halved, shape (...).
        residual_rms: Of what is left, in multiples of the noise that was assumed, shape (...).
        condition: Ratio of the most to the least constrained direction's standard deviation, shape (...).
        ready: Whether enough samples came over enough time, shape (...).
    """

    parameters: Parameters
    correction: Parameters
    covariance: Array
    rank: Array
    residual_rms: Array
    condition: Array
    ready: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class QuietStanding:
    """The standing start of one robot: pure functions over :class:`StandingState`.

    ``state = init(raw)``, then ``state = update(state, raw, reference, dt)`` for every sample, then
    ``solve(state)`` as soon as ``ready(state)``. For a recording see
    :func:`surefoot.calibration.weights.standing_start.standing_start`.
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

    mass_error: float = 0.005
    """Error of the believed mass as a share of it; all samples have it in common."""

    com_error: float = 3e-3
    """Error of the believed centre of mass in m, per axis; all samples have it in common."""

    def __post_init__(self) -> None:
        """Raise an error if a value has no meaning."""
        positive = ("mass", "acceleration_threshold", "rate_threshold", "scale_std", "offset_std")
        check_positive(self, *positive, "force_noise", "cop_noise")
        check_not_negative(self, "warm_up", "duration", "threshold", "mass_error", "com_error")
        check_count(self, "minimum_samples")
        for field in ("scale", "offset"):
            value = getattr(self.start, field)
            self.layout.check_raw(value, f"start.{field}")
            if not np.isfinite(np.asarray(value)).all():
                raise ValueError(f"'start.{field}' holds values that are not finite: {value}.")

    def init(self, raw: Array) -> StandingState:
        """Return the state before any sample.

        Args:
            raw: Readings of the shape to come, (..., K); their values do not matter.
        """
        self.layout.check_raw(raw)
        batch, unknowns = raw.shape[:-1], 2 * self.layout.channels + _ROWS

        def zeros(*tail: int, dtype: Any = np.float64) -> Array:
            return np.zeros((*batch, *tail), dtype=dtype)

        return StandingState(
            time=zeros(),
            samples=zeros(dtype=np.int64),
            dropped=zeros(dtype=np.int64),
            gated=zeros(dtype=np.int64),
            information=zeros(unknowns, unknowns),
            gradient=zeros(unknowns),
            energy=zeros(),
        )

    def update(self, state: StandingState, raw: Array, reference: Reference, dt: float) -> StandingState:
        """Take in one sample; one that is not finite, in contact and still is only counted.

        Args:
            state: What has been seen so far.
            raw: Readings, shape (..., K).
            reference: The robot's beliefs at the same time.
            dt: Time to the next sample in s.

        Returns:
            The new state.
        """
        rows, target, finite, quiet = self.rows(raw, reference)
        warm = state.time >= self.warm_up - 1e-9
        used = warm & finite & quiet
        rows_used = rows * used[..., None, None]
        return StandingState(
            time=state.time + dt,
            samples=state.samples + used,
            dropped=state.dropped + (warm & ~finite),
            gated=state.gated + (warm & finite & ~quiet),
            information=state.information + rows_used.mT @ rows,
            gradient=state.gradient + (rows_used * target[..., None]).sum(axis=-2),
            energy=state.energy + used * (target**2).sum(axis=-1),
        )

    def ready(self, state: StandingState) -> Array:
        """Return whether enough samples came over enough time (bool), shape (...)."""
        enough_time = state.time >= self.warm_up + self.duration - 1e-9
        return (state.samples >= self.minimum_samples) & enough_time

    def solve(self, state: StandingState) -> StandingEstimate:
        """Return the map nearest to the starting one that explains the samples (CoP paper, Eq. 13).

        Without samples it is the starting map.
        """
        channels, deviation = self.layout.channels, self._deviations()
        posterior = np.linalg.inv(state.information + np.eye(state.gradient.shape[-1]))
        posterior = 0.5 * (posterior + posterior.mT)
        whitened = (posterior @ state.gradient[..., None])[..., 0]
        shift = whitened[..., : 2 * channels] * deviation
        correction = Parameters(1 + shift[..., :channels], shift[..., channels:])
        kept = posterior[..., : 2 * channels, : 2 * channels]
        variance = np.linalg.eigvalsh(kept)
        explained = (state.information @ whitened[..., None])[..., 0] - 2 * state.gradient
        left = state.energy + (whitened * explained).sum(axis=-1)
        rows = _ROWS * np.maximum(state.samples, 1)
        return StandingEstimate(
            parameters=correction.after(self.start),
            correction=correction,
            covariance=deviation[:, None] * kept * deviation,
            rank=(variance < 0.5).sum(axis=-1),
            residual_rms=np.sqrt(np.maximum(left, 0.0) / rows),
            condition=np.sqrt(variance[..., -1] / variance[..., 0]),
            ready=self.ready(state),
        )

    def _deviations(self) -> NDArray[np.float64]:
        """Return the units of (a, b), shape (2 K,): one is as far from the start as assumed."""
        return np.repeat([self.scale_std, self.offset_std], self.layout.channels)

    def rows(self, raw: Array, reference: Reference) -> tuple[Array, Array, Array, Array]:
        """Return samples as whitened rows J u = y, and which are finite, and which in contact and still.

        Returns:
            J (..., 3, 2 K + 3), y (..., 3), finite (...), quiet (...); zeros where not finite.
        """
        self.layout.check_raw(raw)
        feet = len(self.layout.feet)
        for field, tail in (
            ("com", (3,)),
            ("position_sole", (feet, 3)),
            ("R_level_sole", (feet, 3, 3)),
            ("accelerometer", (3,)),
            ("gyroscope", (3,)),
        ):
            check_tail(getattr(reference, field), tail, field)

        def clean(values: Array, axes: int, limit: float = LARGEST_REFERENCE) -> tuple[Array, Array]:
            finite = (np.abs(values) <= limit).all(axis=tuple(range(-axes, 0)))
            return np.where(finite[(..., *[None] * axes)], values, 0.0), finite

        force, finite = clean(self.start.force(raw), 1, PLAUSIBLE_WEIGHTS * self.mass * GRAVITY)
        com, com_finite = clean(reference.com, 1)
        sole, sole_finite = clean(reference.position_sole, 2)
        R, R_finite = clean(reference.R_level_sole, 3)
        acceleration, acceleration_finite = clean(reference.accelerometer, 1)
        rate, rate_finite = clean(reference.gyroscope, 1)
        finite = finite & com_finite & sole_finite & R_finite & acceleration_finite & rate_finite

        about_com = np.concatenate([sole[..., :2] - com[..., None, :2], sole[..., 2:]], axis=-1)
        by_channel = moment_rows(self.layout, about_com, R).sum(axis=-3)
        total = (by_channel @ force[..., None])[..., 0]
        weight = self.mass * GRAVITY
        noise = np.array([self.force_noise, weight * self.cop_noise, weight * self.cop_noise])
        shared = np.diag([weight * self.mass_error, *[weight * self.com_error] * 2])
        by_unknown = np.concatenate([by_channel * force[..., None, :], by_channel], axis=-1)
        by_unknown = by_unknown * self._deviations()
        shared = np.broadcast_to(shared, (*by_unknown.shape[:-1], _ROWS))
        rows = np.concatenate([by_unknown, shared], axis=-1) / noise[:, None]
        target = (np.array([weight, 0.0, 0.0]) - total) / noise

        def length(vector: Array) -> Array:
            return np.sqrt((vector**2).sum(axis=-1))

        still = (np.abs(length(acceleration) - GRAVITY) < self.acceleration_threshold) & (
            length(rate) < self.rate_threshold
        )
        return rows, target, finite, (total[..., 0] > self.threshold) & still
