r"""An accelerometer's bias and scale from its readings at rest, by the size of gravity alone.

At rest an accelerometer reads the specific force f = -g_sensor, whose size is known in every orientation:

.. math:: | K (f - b) | = g

so that its readings lie on an ellipsoid about the bias b, a sphere of radius g for a perfect one. No frame of
reference is needed. A rotation before K does not change the size: of the nine entries of K six can be known,
and K is taken **upper triangular** with a positive diagonal. The corrected vector then stands in a frame
whose z axis is measured by the z channel alone and whose yz plane holds the y channel's axis. Any rotation of
that frame against another sensor is for those who hold the two together.

The start is algebraic, linear in the coefficients of the quadric; then the distances of the readings from the
ellipsoid are minimised, to first order :math:`(|K (f - b)| - g) / |K^T u|` with the corrected direction u.
They have the noise of the readings whatever K is. The error of the size, :math:`|K (f - b)| - g`, has not: a
smaller K makes it smaller, and where orientations hardly separate a scale from a bias (a hip that swings by
40 degrees) that alone would pull the bias away by many deviations. Huber's loss bounds the pull of samples
that moved, those beyond five deviations are left out, and the rest is fitted by plain least squares.

A bias matters most to F/T sensors: 0.08 g of it moved the offset of an ATI Gamma under 0.93 kg by 0.7 N.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.calibration.arrays import MAD_TO_STD, of_unit_length
from surefoot.calibration.checks import check_value
from surefoot.calibration.imu.gravity_spread import MINIMUM_SPREAD, check_gravity_spread
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats

AccelerometerModel = Literal["bias", "bias-scale", "full"]
"""``bias``: K is the identity; ``bias-scale``: it is diagonal; ``full``: it is upper triangular."""

_UNKNOWNS = {"bias": 3, "bias-scale": 6, "full": 9}
_ROWS, _COLUMNS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
"""Where the unknowns of K stand: the diagonal, then K12, K13, K23."""

_BIAS = slice(0, 3)  # where b stands; the entries of K follow
_TINY = 1e-12  # size of a corrected reading at least, so that it has a direction

_MOST_NOISE = 0.05
"""Spread of the readings about the ellipsoid, over gravity, above which the accelerometer was not at rest."""

_ROUNDS, _SETTLED = 10, 0.01
"""Rounds of the robust fit at most, and the relative change of the spread below which it ends."""

_HUBER = 1.345
"""Deviations beyond which samples pull no harder: 95 % efficient for normal noise (Huber, 1964)."""

_LEAST_SPREAD = 1e-4
"""Spread of the readings about the ellipsoid, over gravity, at least: data without noise have none."""

_OUTLIER = 5.0  # deviations beyond which a sample counts as moved
_CONVERGED = 1e-15  # relative change at which the last fit ends

_FLAT = 0.05  # least eigenvalue of a quadric of trace 3 at or below which it is no ellipsoid to start from
_UNIT = (0.5, 2.0)  # between these the median size of the readings must lie, over gravity

_CURE = "Rest the accelerometer on further sides, such as all six of a cube and some between them."


@dataclass(frozen=True, eq=False)
class AccelerometerFit:
    """A calibrated accelerometer.

    Attributes:
        bias: b in the unit of the readings, shape (3,).
        matrix: K, upper triangular, in the unit of gravity per that of the readings, shape (3, 3).
        covariance: Of (b, the diagonal of K, K12, K13, K23) as far as the model has them, shape (3, 3), (6,
            6) or (9, 9), from the scatter of the residuals.
        result: Always determined: a fit that is not is refused.
        stats: Of the fit; gated samples moved, and the residual is in the unit of the readings.
        gravity: The size of gravity that was taken, in m/s^2 (1.0 for g).
    """

    bias: Floats
    matrix: Floats
    covariance: Floats
    result: FitResult
    stats: FitStats
    gravity: float

    def correct(self, specific_force: ArrayLike) -> Floats:
        """Return K (f - b) in the unit of gravity; at rest, g in the sensor's frame is its negative.

        Args:
            specific_force: Readings, shape (..., 3).

        Returns:
            Shape (..., 3).
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
    """Return an accelerometer's bias, scale and skewness by readings at rest.

    Args:
        specific_force: Readings at rest in many orientations, shape (n, 3), in about the unit of ``gravity``.
            Samples that are not finite are left out, and so are those that moved, if there are more than
            twice as many samples as unknowns.
        gravity: Size of gravity at the place in m/s^2, or 1.0 for readings in g.
        model: ``"bias"`` (3 unknowns), ``"bias-scale"`` (6) or ``"full"`` (9). Each needs orientations that
            show its unknowns; an error that is really there and not in the model goes into the others.
        minimum_spread: Standard deviation of the readings along their least seen direction, over gravity's
            size, that is asked for.
        tolerance: Singular values at or below this share of the largest, with columns scaled to one length,
            count as not determined.

    Raises:
        ValueError: If the shape is wrong or the model unknown.
        CalibrationRefused: If there are too few samples or orientations, the unit seems to be another one, or
            most of the samples moved.

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
    # From readings in units of gravity to the caller's: b by g, while K keeps its size.
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
    """Return the unknowns as b and K."""
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
    """Return the slopes of the distances by the unknowns, shape (n, p)."""
    bias, K = _unpack(theta)
    d = force - bias
    corrected = d @ K.T
    a = np.maximum(np.linalg.norm(corrected, axis=1, keepdims=True), _TINY)
    u = corrected / a
    v = u @ K  # K'u, the slope of a = |K d| by the reading
    s = np.linalg.norm(v, axis=1, keepdims=True)
    q = v @ K.T
    entries = len(theta) - _BIAS.stop
    i, j = _ROWS[:entries], _COLUMNS[:entries]
    # For a change w of K d, a changes by u'w and s by (q'w - s^2 u'w) / (a s); K_ij turns v itself as well.
    of_a = np.hstack([-v, u[:, i] * d[:, j]])
    of_q = np.hstack([-q @ K, q[:, i] * d[:, j]])
    of_v = np.hstack([np.zeros_like(d), u[:, i] * v[:, j]])
    of_s = ((of_q - s**2 * of_a) / a + of_v) / s
    return np.asarray(of_a / s - (a - 1.0) / s**2 * of_s)


def _spread_of(residual: Floats, unknowns: int) -> float:
    """Return the standard deviation of the residuals, which outliers do not move."""
    lost = np.sqrt(len(residual) / (len(residual) - unknowns))
    return max(float(MAD_TO_STD * lost * np.median(np.abs(residual))), _LEAST_SPREAD)


def _fit_ellipsoid(force: Floats, unknowns: int) -> tuple[Any, Floats]:
    """Fit samples that did not move; return SciPy's result, and these samples."""
    start, scale = _robust_start(force, unknowns)
    # Half of the samples lie within one deviation: of more than 2 p, enough are left for p unknowns. Of
    # fewer, none counts as moved.
    still = np.abs(_distances(start, force)) <= _OUTLIER * scale
    kept = force[still] if len(force) > 2 * unknowns else force
    plain: dict[str, Any] = {"jac": _slopes, "xtol": _CONVERGED, "ftol": _CONVERGED, "gtol": _CONVERGED}
    return scipy.optimize.least_squares(_distances, start, args=(kept,), **plain), kept


def _robust_start(force: Floats, unknowns: int) -> tuple[Floats, float]:
    """Fit with Huber's loss; return unknowns and the scale of residuals, or refuse a moving sensor."""
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
    """Return unknowns by a linear fit of a quadric, or of a sphere if that is no ellipsoid."""
    x, y, z = force.T
    square = np.sum(force**2, axis=1)
    # |f|^2 = 2 b'f + const: a sphere about b of any radius.
    sphere, *_ = np.linalg.lstsq(np.column_stack([2.0 * force, np.ones(len(force))]), square, rcond=None)
    theta = np.concatenate([sphere[_BIAS], np.eye(3)[_ROWS, _COLUMNS]])[:unknowns]
    if unknowns == 3:
        return theta
    # f'Qf - 2 q'f + const = 0 with trace Q = 3; its terms beside |f|^2 are spread by what is no sphere.
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
    # The mean of (f - centre)'Q (f - centre), by the normal equations: positive.
    square_radius = constant + linear @ centre
    # Q / radius^2 = K'K; Cholesky gives the upper factor.
    K = np.linalg.cholesky(Q / square_radius).T
    return np.concatenate([centre, K[_ROWS, _COLUMNS]])[:unknowns]


def _determine(jacobian: Floats, model: str, tolerance: float) -> tuple[Floats, Floats]:
    """Return the map from unit residuals to the unknowns, and singular values; refuse too low a rank."""
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
    """Return finite samples in units of gravity, shape (n, 3), and the number of others.

    Another shape is a ValueError. Too few, another unit and too few orientations are refused.
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
