"""The offset of a six-axis F/T sensor from turning its limb (in-situ paper, III-A and III-B).

At rest the raw readings are r = C^-1 M g + o (Eq. 7): M is 6 by 3, so that they all lie in a
three-dimensional affine space, whatever the limb's mass (Lemma 1), and on an ellipsoid in it with the offset
in its centre. In an orthonormal basis U1 of that space the readings are an affine function of gravity,

    U1' (r_i - r_mean) = K g_i + lambda,                                                    (13)

and its value for no gravity is the offset, o = r_mean + U1 lambda (11). The unknowns K and lambda are
found by least squares. The paper stacks 3 N rows of 12 columns with the Kronecker product (14-17); the three
rows of a sample share their regressors and the readings' mean is zero, so that lambda = -K g_mean and K is a
regression of 3 unknowns on the centred samples. The triangular factor of [g, r] holds all that is needed of
them, whatever their number.

The paper does not say: gravity must turn in all three dimensions, or the offset is unknown along one;
K takes up any rotation and any scale between the accelerometer and the sensor, so that neither matters, but a
**bias of the accelerometer** goes straight into the offset as K b. Noise of gravity shrinks K.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.imu.gravity_spread import MINIMUM_SPREAD, check_gravity_spread
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats

_MOST = 0.05
"""Share of their spread by which readings may leave the three-space where it holds."""

_EXACT = 1e-9
"""Readings that leave the three-space by less than this share of their spread leave it by rounding alone."""


@dataclass(frozen=True, eq=False)
class OffsetFit:
    """The offset of a sensor and the space that its readings lie in.

    Attributes:
        offset: o in counts, shape (k,).
        basis: U1, orthonormal, in the order of falling spread, shape (k, 3).
        mean: r_mean in counts, shape (k,).
        response: K in counts per m/s^2: the semi-axes of the ellipsoid are its singular values times g, shape
            (3, 3).
        affine_residual: Residual outside the three-space of Lemma 1 as a share of the readings' spread (root
            of the ratio of the squares), between 0 and 1.
        affine_to_noise: The same as a multiple of the noise, per direction and sample; NaN without noise.
        covariance: Of the offset in counts^2, shape (k, k), from the scatter of the residuals; NaN for four
            samples, which leave none. It takes the noise for white: the errors of filtered samples are
            alike, and the true variance is larger by about the length of the filter.
        result: Always determined: an offset that is not is refused.
        stats: Of Eq. 13, with 12 unknowns; the residual is in counts over its 3 components.
    """

    offset: NDArray[np.float64]
    basis: NDArray[np.float64]
    mean: NDArray[np.float64]
    response: NDArray[np.float64]
    affine_residual: float
    affine_to_noise: float
    covariance: NDArray[np.float64]
    result: FitResult
    stats: FitStats

    @property
    def affine(self) -> bool:
        """Whether Lemma 1 holds: the readings leave the three-space by at most three times the noise.

        If not, the sensor has hysteresis, the limb bends, its zero or a temperature drifts or something
        touches. Readings that leave it by more than 5 % of their spread do not show that it holds, whatever
        they leave within it.
        """
        if self.affine_residual <= _EXACT:
            return True
        return self.affine_residual <= _MOST and bool(self.affine_to_noise <= 3.0)

    def coordinates(self, raw: ArrayLike) -> NDArray[np.float64]:
        """Return readings in the three-space, U1' (r - r_mean) (in-situ paper, Eq. 13, left; Fig. 5).

        Args:
            raw: Counts, shape (..., k).

        Returns:
            Coordinates in counts, shape (..., 3); the offset's are ``coordinates(offset)``.
        """
        return np.asarray((np.asarray(raw, dtype=np.float64) - self.mean) @ self.basis)


def estimate_offset(
    raw: ArrayLike,
    gravity: ArrayLike,
    *,
    noise: ArrayLike | None = None,
    minimum_spread: float = MINIMUM_SPREAD,
) -> OffsetFit:
    """Return a sensor's offset from readings at rest in many orientations (in-situ paper, Eqs. 9-17).

    Args:
        raw: Counts, shape (n, k) with k >= 3. Samples that are not finite are left out.
        gravity: In the sensor's frame, or in any frame that is fixed to it, in m/s^2, shape (n, 3).
        noise: Standard deviation of a reading in counts, one number or shape (k,), that Lemma 1's residual is
            compared with; by default the steps of Eq. 13's residual from one sample to the next, so
            that a drift is not taken for noise, which is right for channels of equal noise.
        minimum_spread: Standard deviation of gravity along its least seen direction, over gravity's size,
            that is asked for. It must lie above the noise of ``gravity``.

    Returns:
        The offset.

    Raises:
        ValueError: If the shapes do not belong together.
        CalibrationRefused: If gravity was not seen in enough directions, or the readings did not react to it.

    >>> gravity = 9.81 * np.vstack([np.eye(3), -np.eye(3)])
    >>> response = np.arange(18.0).reshape(3, 6) ** 2
    >>> estimate_offset(gravity @ response + 250.0, gravity).offset.round(6)
    array([250., 250., 250., 250., 250., 250.])
    """
    every_raw, every_gravity = _check_offset_arrays(raw, gravity)
    channels = every_raw.shape[1]
    finite = np.isfinite(np.hstack([every_raw, every_gravity])).all(axis=1)
    r, g = every_raw[finite], every_gravity[finite]
    n, dropped = len(r), len(every_raw) - len(r)
    if n == 0:
        raise CalibrationRefused(
            f"None of the {dropped} samples was finite.", "Check the names and the units of the columns."
        )
    r_mean, g_mean = r.mean(axis=0), g.mean(axis=0)  # (9)
    factor = np.asarray(np.linalg.qr(np.column_stack([g - g_mean, r - r_mean]), mode="r"))
    g_factor, r_factor = factor[:, :3], factor[:, 3:]
    check_gravity_spread(
        g_factor,
        float(np.linalg.norm(g)),
        minimum_spread,
        "the offset across it",
        "Turn the limb about two axes: tilt it sideways as well as back and forth.",
    )
    _, singular, right = np.linalg.svd(r_factor, full_matrices=False)  # (10)
    if singular[2] <= _EXACT * singular[0]:
        raise CalibrationRefused(
            "The readings span fewer than the three dimensions of gravity (Lemma 1), so that the sensor did "
            "not react to all of it.",
            "Check that the channels are alive and that the columns are those of this sensor.",
        )
    basis = right[:3].T
    # The centred form of (14-17): the mean of U1' (r - r_mean) is zero.
    K = np.linalg.solve(g_factor[:3], r_factor[:3] @ basis).T
    offset = r_mean - basis @ (K @ g_mean)  # (11) with lambda = -K g_mean

    residual = r_factor - g_factor @ K.T @ basis.T
    free = n - 4
    within = float(np.sum((residual @ basis) ** 2))
    left = (r - r_mean) @ basis - (g - g_mean) @ K.T
    # Residuals of drift, bending and loops within the three-space change little from sample to sample.
    jumps = float(np.sum(np.diff(left, axis=0) ** 2)) / 2.0 * n / max(n - 1, 1)
    outside = float(np.sum(singular[3:] ** 2))
    scatter = residual.T @ residual / free if free else np.full((channels, channels), np.nan)
    leverage = 1.0 / n + float(np.sum(np.linalg.solve(g_factor[:3].T, g_mean) ** 2))
    conditions = np.linalg.svd(g_factor, compute_uv=False)
    return OffsetFit(
        offset=offset,
        basis=basis,
        mean=r_mean,
        response=K,
        affine_residual=float(np.sqrt(outside / np.sum(singular**2))),
        affine_to_noise=_to_noise(outside, within, min(within, jumps), free, basis, noise),
        # The tilt of U1 errs by as much as K does in the other directions, to first order.
        covariance=leverage * scatter,
        result=FitResult.DETERMINED,
        stats=FitStats(
            samples=n,
            dropped=dropped,
            gated=0,
            residual_rms=float(np.sqrt(within / (3 * n))),
            rank=12,
            unknowns=12,
            condition=float(conditions[0] / conditions[2]),
        ),
    )


def _to_noise(
    outside: float,
    within: float,
    jumps: float,
    free: int,
    basis: NDArray[np.float64],
    noise: ArrayLike | None,
) -> float:
    """Compare the residual beside the three-space with the noise, per direction (Lemma 1)."""
    channels = len(basis)
    if free == 0 or channels == 3:
        return np.nan
    left = outside / (free * (channels - 3))
    if noise is None:
        expected = jumps / (3 * free)
        # A drift may be one of the three directions itself.
        left = max(left, within / (3 * free))
    else:
        deviation = np.asarray(noise, dtype=np.float64)
        if deviation.shape not in ((), (channels,)):
            raise ValueError(f"'noise' must be a number or have shape ({channels},), got {deviation.shape}.")
        variance = np.broadcast_to(deviation**2, (channels,))
        expected = float((np.sum(variance) - np.sum(variance @ basis**2)) / (channels - 3))
    return float(np.sqrt(left / expected)) if expected > 0.0 else np.nan


def _check_offset_arrays(
    raw: ArrayLike, gravity: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r, g = np.asarray(raw, dtype=np.float64), np.asarray(gravity, dtype=np.float64)
    if r.ndim != 2 or r.shape[1] < 3:
        raise ValueError(f"'raw' must have shape (n, k) with k >= 3, got {r.shape}.")
    if g.shape != (len(r), 3):
        raise ValueError(f"'gravity' must have shape ({len(r)}, 3) like 'raw', got {g.shape}.")
    return r, g
