r"""An accelerometer's bias and scale from its readings at rest, using only the magnitude of gravity.

At rest an accelerometer reads the specific force f = -g_sensor, whose magnitude is known in every
orientation:

.. math:: | K (f - b) | = g

Its readings are on an ellipsoid about the bias b, a sphere of radius g for a perfect sensor. No frame of
reference is needed. A rotation applied after K does not change the magnitude, so that six of the nine entries
of K can be determined. K is chosen **upper triangular** with a positive diagonal. The z axis of the corrected
frame is then measured by the z channel alone, and its yz plane contains the y channel's axis. The rotation of
this frame relative to another sensor must be calibrated separately.

The initial value is algebraic, linear in the coefficients of the quadric. Then the distances of the readings
from the ellipsoid are minimised, to first order :math:`(|K (f - b)| - g) / |K^T u|` with the corrected
direction u. Their noise is that of the readings for any K. This does not hold for the error of the magnitude,
:math:`|K (f - b)| - g`: a smaller K makes it smaller. If orientations hardly separate a scale from a bias (a
hip that swings by 40 degrees), that alone would bias the result by many standard deviations. Huber's loss
limits the influence of samples that moved. Those beyond five deviations are left out, and the others are
fitted by least squares.

A bias matters most to F/T sensors: 0.08 g moved the offset of an ATI Gamma under 0.93 kg by 0.7 N.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.calibration.arrays import MAD_TO_STD, of_unit_length
from surefoot.calibration.imu.gravity_spread import MINIMUM_SPREAD, check_gravity_spread
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats
from surefoot.checks import check_value

AccelerometerModel = Literal["bias", "bias-scale", "full"]
"""``bias``: K is the identity; ``bias-scale``: it is diagonal; ``full``: it is upper triangular."""

_UNKNOWNS = {"bias": 3, "bias-scale": 6, "full": 9}
_ROWS, _COLUMNS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
"""Rows and columns of the unknowns in K: the diagonal, then K12, K13, K23."""

_BIAS = slice(0, 3)  # the unknowns of b, which are followed by those of K
_TINY = 1e-12  # lower bound of the length of a corrected reading, so that its direction is defined

_MOST_NOISE = 0.05
"""Spread of the readings about the ellipsoid, over gravity, above which the accelerometer was not at rest."""

_ROUNDS, _SETTLED = 10, 0.01
"""Maximum number of rounds of the robust fit, and the relative change of the spread below which it ends."""

_HUBER = 1.345
"""Huber's constant in standard deviations: 95 % efficient for normal noise (Huber, 1964)."""

_LEAST_SPREAD = 1e-4
"""Lower bound of the spread of the readings about the ellipsoid, over gravity, for data without noise."""

_OUTLIER = 5.0  # deviations above which a sample counts as moved
_CONVERGED = 1e-15  # relative change at which the last fit ends

_FLAT = 0.05  # smallest eigenvalue (at trace 3) of a valid initial ellipsoid
_UNIT = (0.5, 2.0)  # allowed range of the median magnitude of the readings, over gravity

_CURE = "Rest the accelerometer on further sides, such as all six of a cube and some between them."


@dataclass(frozen=True, eq=False)
class AccelerometerFit:
    """A calibrated accelerometer.

    Attributes:
        bias: b in the unit of the readings, shape (3,).
        matrix: K, upper triangular, in the unit of gravity per that of the readings, shape (3, 3).
        covariance: Covariance of (b, the diagonal of K, K12, K13, K23) as far as they are in the model, shape
            (3, 3), (6, 6) or (9, 9), from the scatter of the residuals.
        result: Always ``DETERMINED``, because other fits are refused.
        stats: Statistics of the fit. Gated samples moved, and the residual is in the unit of the readings.
        gravity: The magnitude of gravity that was used, in m/s^2 (1.0 for g).
    """

    bias: Floats
    matrix: Floats
    covariance: Floats
    result: FitResult
    stats: FitStats
    gravity: float

    def correct(self, specific_force: ArrayLike) -> Floats:
        """Return K (f - b) in the unit of gravity, which is -g in the sensor's frame at rest.

        Args:
            specific_force: Readings, shape (..., 3).

        Returns:
            Corrected readings, shape (..., 3).
        """
        return np.asarray((np.asarray(specific_force, dtype=np.float64) - self.bias) @ self.matrix.T)


def calibrate_accelerometer(
    specific_force: ArrayLike,
    *,
    gravity: float = 9.80665,
    model: AccelerometerModel = "bias",
    minimum_spread: float = MINIMUM_SPREAD,
    tolerance: float = 1e-3,
) -> AccelerometerFit:
    """Estimate an accelerometer's bias, scales and non-orthogonality from readings at rest.

    Args:
        specific_force: Readings at rest in many orientations, shape (n, 3), in about the unit of ``gravity``.
            Samples that are not finite are left out. So are samples that moved, if there are more than
            twice as many samples as unknowns.
        gravity: Magnitude of local gravity in m/s^2, or 1.0 for readings in g.
        model: ``"bias"`` (3 unknowns), ``"bias-scale"`` (6) or ``"full"`` (9). Each needs orientations that
            excite its unknowns. Errors that are not in the model bias the other unknowns.
        minimum_spread: Smallest allowed standard deviation of the readings along any direction, over the
            magnitude of gravity.
        tolerance: Share of the largest singular value, with columns scaled to unit length, at or below which
            a direction counts as not determined.

    Raises:
        ValueError: If the shape is wrong or the model does not exist.
        CalibrationRefused: If there are too few samples or orientations, the readings seem to be in another
            unit, or most of the samples moved.

    >>> sides = 9.80665 * np.vstack([np.eye(3), -np.eye(3)])
    >>> calibrate_accelerometer(sides + [0.3, 0.0, -0.1]).bias.round(6) + 0.0
    array([ 0.3,  0. , -0.1])
    """
    check_value("gravity", gravity, positive=True)
    if model not in _UNKNOWNS:
        raise ValueError(f"'model' must be one of {', '.join(map(repr, _UNKNOWNS))}, got {model!r}.")
    unknowns = _UNKNOWNS[model]
    force, dropped = _read_samples(specific_force, gravity, unknowns, minimum_spread)
    solved, kept = _fit_ellipsoid(force, unknowns)
    back, singular = _determine(_slopes(solved.x, kept), model, tolerance)
    bias, K = _unpack(solved.x)
    square = float(np.sum(solved.fun**2))
    free = len(kept) - unknowns
    # Convert from units of gravity to the caller's unit: b is multiplied by g, and K does not change.
    unit = np.where(np.arange(unknowns) < _BIAS.stop, gravity, 1.0)
    return AccelerometerFit(
        bias=gravity * bias,
        matrix=K,
        covariance=square / free * (back @ back.T) * np.outer(unit, unit),
        result=FitResult.DETERMINED,
        stats=FitStats(
            samples=len(kept),
            dropped=dropped,
            gated=len(force) - len(kept),
            residual_rms=gravity * float(np.sqrt(square / len(kept))),
            rank=unknowns,
            unknowns=unknowns,
            condition=float(singular[0] / singular[-1]),
        ),
        gravity=float(gravity),
    )


def _unpack(theta: Floats) -> tuple[Floats, Floats]:
    """Return b and K from the vector of unknowns."""
    K = np.eye(3)
    entries = theta[_BIAS.stop :]
    K[_ROWS[: len(entries)], _COLUMNS[: len(entries)]] = entries
    return theta[_BIAS], K


def _distances(theta: Floats, force: Floats) -> Floats:
    """Return the distances from the ellipsoid to first order, (|K (f - b)| - 1) / |K'u|, shape (n,)."""
    bias, K = _unpack(theta)
    corrected = (force - bias) @ K.T
    size = np.maximum(np.linalg.norm(corrected, axis=1), _TINY)
    return np.asarray((size - 1.0) / np.linalg.norm(corrected / size[:, None] @ K, axis=1))


def _slopes(theta: Floats, force: Floats) -> Floats:
    """Return the Jacobian of the distances with respect to the unknowns, shape (n, p)."""
    bias, K = _unpack(theta)
    d = force - bias
    corrected = d @ K.T
    a = np.maximum(np.linalg.norm(corrected, axis=1, keepdims=True), _TINY)
    u = corrected / a
    v = u @ K  # K'u, the gradient of a = |K d| with respect to the reading
    s = np.linalg.norm(v, axis=1, keepdims=True)
    q = v @ K.T
    entries = len(theta) - _BIAS.stop
    i, j = _ROWS[:entries], _COLUMNS[:entries]
    # For a change w of K d, a changes by u'w and s by (q'w - s^2 u'w) / (a s). K_ij also changes v directly.
    of_a = np.hstack([-v, u[:, i] * d[:, j]])
    of_q = np.hstack([-q @ K, q[:, i] * d[:, j]])
    of_v = np.hstack([np.zeros_like(d), u[:, i] * v[:, j]])
    of_s = ((of_q - s**2 * of_a) / a + of_v) / s
    return np.asarray(of_a / s - (a - 1.0) / s**2 * of_s)


def _spread_of(residual: Floats, unknowns: int) -> float:
    """Return a robust estimate of the standard deviation of the residuals."""
    lost = np.sqrt(len(residual) / (len(residual) - unknowns))
    return max(float(MAD_TO_STD * lost * np.median(np.abs(residual))), _LEAST_SPREAD)


def _fit_ellipsoid(force: Floats, unknowns: int) -> tuple[Any, Floats]:
    """Fit the samples that did not move. Return SciPy's result, and these samples."""
    start, scale = _robust_start(force, unknowns)
    # At least half of the samples are within one deviation, so that of more than 2 p samples enough remain
    # for p unknowns. With fewer samples, all of them are used.
    still = np.abs(_distances(start, force)) <= _OUTLIER * scale
    kept = force[still] if len(force) > 2 * unknowns else force
    plain: dict[str, Any] = {"jac": _slopes, "xtol": _CONVERGED, "ftol": _CONVERGED, "gtol": _CONVERGED}
    return scipy.optimize.least_squares(_distances, start, args=(kept,), **plain), kept


def _robust_start(force: Floats, unknowns: int) -> tuple[Floats, float]:
    """Fit with Huber's loss. Return the unknowns and the scale of residuals, or refuse a moving sensor."""
    start = _algebraic_start(force, unknowns)
    scale = _spread_of(_distances(start, force), unknowns)
    for _ in range(_ROUNDS):
        robust: dict[str, Any] = {"jac": _slopes, "loss": "huber", "f_scale": _HUBER * scale}
        start = scipy.optimize.least_squares(_distances, start, args=(force,), **robust).x
        last, scale = scale, _spread_of(_distances(start, force), unknowns)
        if abs(scale - last) <= _SETTLED * last:
            break
    if scale > _MOST_NOISE:
        raise CalibrationRefused(
            f"The readings leave the ellipsoid by {100.0 * scale:.2g} % of gravity, and "
            f"{100.0 * _MOST_NOISE:g} % are the most for an accelerometer at rest.",
            "Give samples at rest only, and check the unit or take a model with a scale.",
        )
    return start, scale


def _algebraic_start(force: Floats, unknowns: int) -> Floats:
    """Return initial unknowns from a linear fit of a quadric, or of a sphere if that is not an ellipsoid."""
    x, y, z = force.T
    square = np.sum(force**2, axis=1)
    # |f|^2 = 2 b'f + const: a sphere about b of any radius.
    sphere, *_ = np.linalg.lstsq(np.column_stack([2.0 * force, np.ones(len(force))]), square, rcond=None)
    theta = np.concatenate([sphere[_BIAS], np.eye(3)[_ROWS, _COLUMNS]])[:unknowns]
    if unknowns == 3:
        return theta
    # f'Qf - 2 q'f + const = 0 with trace Q = 3. The other terms describe the deviation from a sphere.
    terms = [x**2 - z**2, y**2 - z**2, 2.0 * x * y, 2.0 * x * z, 2.0 * y * z]
    if unknowns == 6:
        terms = terms[:2]
    basis = np.column_stack([*terms, 2.0 * force, np.ones(len(force))])
    solution, *_ = np.linalg.lstsq(basis, square, rcond=None)
    form = np.zeros(6)
    form[: len(terms)] = -solution[: len(terms)]
    u, v, xy, xz, yz, _ = form
    Q = np.array([[1.0 + u, xy, xz], [xy, 1.0 + v, yz], [xz, yz, 1.0 - u - v]])
    linear, constant = solution[len(terms) : len(terms) + 3], solution[-1]
    if np.linalg.eigvalsh(Q)[0] <= _FLAT:
        return theta
    centre = np.linalg.solve(Q, linear)
    # The mean of (f - centre)'Q (f - centre), which is positive by the normal equations.
    square_radius = constant + linear @ centre
    # Q / radius^2 = K'K; Cholesky gives the upper factor.
    K = np.linalg.cholesky(Q / square_radius).T
    return np.concatenate([centre, K[_ROWS, _COLUMNS]])[:unknowns]


def _determine(jacobian: Floats, model: str, tolerance: float) -> tuple[Floats, Floats]:
    """Return the map from unit residuals to the unknowns, and singular values. Refuse a deficient rank."""
    unit, length = of_unit_length(jacobian)
    _, singular, right = np.linalg.svd(unit, full_matrices=False)
    rank, unknowns = int(np.sum(singular > tolerance * singular[0])), _UNKNOWNS[model]
    if rank < unknowns:
        raise CalibrationRefused(
            f"The orientations determine {rank} of the {unknowns} unknowns of the model {model!r}.",
            _CURE if model == "bias" else f"{_CURE[:-1]}, or take a model with fewer unknowns.",
        )
    return (right.T / singular) / length[:, None], singular


def _read_samples(
    specific_force: ArrayLike, gravity: float, unknowns: int, minimum_spread: float
) -> tuple[Floats, int]:
    """Return finite samples in units of gravity, shape (n, 3), and the number of the other samples.

    ValueError for another shape. CalibrationRefused for too few samples, another unit and too few
    orientations.
    """
    every = np.asarray(specific_force, dtype=np.float64)
    if every.ndim != 2 or every.shape[1] != 3:
        raise ValueError(f"'specific_force' must have shape (n, 3), got {every.shape}.")
    force = every[np.isfinite(every).all(axis=1)] / gravity
    dropped = len(every) - len(force)
    if len(force) <= unknowns:
        without = f" ({dropped} samples without a finite value left out)" if dropped else ""
        raise CalibrationRefused(
            f"Only {len(force)} samples for {unknowns} unknowns{without}, and {unknowns + 1} are needed.",
            _CURE,
        )
    size = float(np.median(np.linalg.norm(force, axis=1)))
    if not _UNIT[0] <= size <= _UNIT[1]:
        raise CalibrationRefused(
            f"The readings are {gravity * size:.3g} in size where gravity is {gravity:g}: they seem to be in "
            "another unit.",
            "Give m/s^2, or gravity=1.0 for readings in g.",
        )
    check_gravity_spread(
        force - force.mean(axis=0), float(np.sqrt(len(force))), minimum_spread, "the bias across it", _CURE
    )
    return force, dropped
