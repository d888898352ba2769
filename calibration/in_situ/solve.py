r"""The measurement-space fit: least squares on noisy readings, not on noisy regressors.

In-situ paper, Eqs. 18-25, regress gravity on the noisy readings, :math:`C r = M g`, and so shrink C. Here the
noise is where it is,

.. math:: r = A (M_b + M_a^j) g + o_j + e, \qquad A = C^{-1},

bilinear in the response A and the limb's inertial parameters :math:`\varphi_b`. Given :math:`\varphi_b` (and
a rotation of the accelerometer, if that is unknown) A is a linear least-squares solution, also with the
maker's matrix as a prior, so only the few outer unknowns are searched (variable projection:
Golub and Pereyra, 1973; Jacobian of Kaufman, 1975).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from surefoot.calibration.arrays import skew
from surefoot.calibration.in_situ.compress import CompressedSet, add_signals
from surefoot.calibration.in_situ.data import InSituOptions
from surefoot.calibration.in_situ.linear import orthonormal
from surefoot.calibration.in_situ.model import AXES, DIRECT, MASS
from surefoot.calibration.in_situ.problem import Problem, whiten_channels

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


_SEARCHES, _TURNED_SEARCHES = 3, 36
"""Starts from which to search; the second where the rotation is unknown."""

_AS_GOOD = 10.0
"""Minima that cost this much more than the lowest are none."""

_CONVERGED, _EVALUATIONS = 1e-8, 60
"""Relative change of cost, unknowns and slope at which a search ends, and its evaluations at most."""

_LEAST_MASS, _SMALL_ANGLE = 1e-3, 1e-4
"""Mass in kg by which unknowns are scaled at least, and angle in rad below which a short series is exact."""


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution of a :class:`Problem`.

    Attributes:
        response: A, and beside it the coefficients of signals that act on the readings directly, (k, inputs).
        limb: phi_b, shape (p,).
        rotation: R_sensor_accelerometer, shape (3, 3).
        jacobian: Of all rows by (W A row by row, phi_b, rotation vector in the sensor's frame).
        residual: Of the rows of the sets, of variance one, shape (J, s, k).
        cost: Half the sum of all squared rows.
        outer: The outer unknowns: phi_b and, where it is unknown, the rotation vector.
    """

    response: Matrix
    limb: Vector
    rotation: Matrix
    jacobian: Matrix
    residual: NDArray[np.float64]
    cost: float
    outer: Vector

    @property
    def A(self) -> Matrix:  # noqa: N802 - as in the equations
        """The response to wrenches, in counts per N and N m, shape (k, 6)."""
        return self.response[:, :AXES]

    @property
    def direct(self) -> Matrix:
        """Coefficients of signals that act on the readings directly, shape (k, inputs - 6)."""
        return self.response[:, AXES:]


class _Outer(NamedTuple):
    """The outer unknowns in their parts."""

    limb: Vector
    vector: Vector
    rotation: Matrix

    @classmethod
    def of(cls, problem: Problem, x: Vector) -> "_Outer":
        limb, vector = x[: problem.parameters], x[problem.parameters :]
        return cls(limb, vector, Rotation.from_rotvec(vector).as_matrix() if problem.rotation else np.eye(3))


def transforms(problem: Problem, solution: Solution | _Outer) -> NDArray[np.float64]:
    """Return T of each set with its added mass, by the rotation, shape (J, inputs, s)."""
    T = np.einsum("jp,pws->jws", solution.limb + problem.added, problem.basis)
    if problem.rotation:
        T[..., DIRECT] = T[..., DIRECT] @ solution.rotation
    direct = problem.inputs - AXES
    if not direct:
        return np.asarray(T)
    whole = np.zeros((len(T), problem.inputs, T.shape[2] + direct))
    whole[:, :AXES, :-direct] = T
    whole[:, AXES:, -direct:] = np.eye(direct)
    return whole


def loop_shares(problem: Problem, solution: Solution) -> Vector:
    """Return the shares of each axis, shape (6,), or of each channel, shape (k,), of a fit with loops.

    Those of creep are for an octave of time, as those of loops are for a doubling of the swing.
    """
    if problem.channel_lags:
        return np.diag(solution.response[:, -problem.channel_lags :])
    return solution.limb[problem.loops]


def solve(problem: Problem, starts: Sequence[Vector], evaluations: int = _EVALUATIONS) -> Solution:
    """Return the best of the minima next to starts, shape (p,), or (p + 3,) with the rotation vector.

    A few evaluations come near enough to compare minima.
    """
    found = [_search(problem, start, evaluations) for start in starts]
    return expand(problem, min(found, key=_rank_of)[1])


def minima(problem: Problem, starts: Sequence[Vector]) -> list[Solution]:
    """Find the minima next to promising starts that fit as well as the best, which comes first."""
    costs = [float(np.sum(_Residual(problem)(start) ** 2)) for start in starts]
    promising = np.argsort(costs)[: _TURNED_SEARCHES if problem.rotation else _SEARCHES]
    found = sorted((_search(problem, starts[i]) for i in promising), key=_rank_of)
    lowest = found[0][0]
    return [expand(problem, outer) for cost, outer in found if cost <= lowest + _AS_GOOD]


def _rank_of(found: tuple[float, Vector]) -> tuple[bool, float]:
    """Turned round, a response fits a limb of negative mass as well as the true one fits the limb."""
    cost, outer = found
    return bool(outer[MASS] <= 0.0), cost


def _search(problem: Problem, start: Vector, evaluations: int = _EVALUATIONS) -> tuple[float, Vector]:
    """Return the cost and the outer unknowns at the minimum next to a start."""
    from scipy.optimize import least_squares  # Late: it takes longer to import than all the rest.

    mass = max(abs(float(start[MASS])), _LEAST_MASS)
    scale = np.concatenate([np.full(problem.parameters, mass), np.ones(3 * problem.rotation)])
    residual = _Residual(problem)
    found = least_squares(
        lambda x: residual(x * scale),
        start / scale,
        jac=lambda x: residual.jacobian(x * scale) * scale,
        method="lm",
        max_nfev=evaluations,
        **dict.fromkeys(("xtol", "ftol", "gtol"), _CONVERGED),
    )
    return float(found.cost), found.x * scale


class _Linear(NamedTuple):
    """The inner problem at outer unknowns: X (W A)' = Y in the sets' rows, and the maker's rows of W A."""

    outer: _Outer
    X: Matrix
    response: Matrix
    """(W A)' of least squares."""
    left: Matrix
    """An orthonormal basis of the columns: of X, or with a maker of all rows."""
    coupled: bool
    """Whether the maker's rows couple the channels."""

    @classmethod
    def at(cls, problem: Problem, x: Vector) -> "_Linear":
        outer = _Outer.of(problem, x)
        X = (problem.signals @ transforms(problem, outer).swapaxes(1, 2)).reshape(-1, problem.inputs)
        channels = problem.readings.shape[1]
        if problem.maker is None:
            left, back = orthonormal(X)
            return cls(outer, X, back @ (left.T @ problem.readings), left, False)
        prior, right = problem.prior
        every = np.zeros((len(X) * channels + len(prior), channels * problem.inputs))
        of_sets = every[: len(X) * channels].reshape(len(X), channels, channels, problem.inputs)
        of_sets[:, np.arange(channels), np.arange(channels)] = X[:, None]
        every[len(X) * channels :] = prior
        left, back = orthonormal(every)
        found = back @ (left.T @ np.concatenate([problem.readings.ravel(), right]))
        return cls(outer, X, found.reshape(channels, problem.inputs).T, left, True)

    def free(self, of_sets: NDArray[np.float64], of_prior: int) -> NDArray[np.float64]:
        """Remove the response's part from rows of sets, shape (..., n, k), and from zeros of the prior."""
        *batch, n, k = of_sets.shape
        if not self.coupled:
            return np.asarray((of_sets - self.left @ (self.left.T @ of_sets)).reshape(*batch, n * k))
        rows = np.concatenate([of_sets.reshape(*batch, n * k), np.zeros((*batch, of_prior))], axis=-1)
        return np.asarray(rows - (rows @ self.left) @ self.left.T)


class _Residual:
    """Rows less the part that the best response explains, and their slopes, by the outer unknowns."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._last: tuple[bytes, _Linear] | None = None

    def _at(self, x: Vector) -> _Linear:
        """Return the inner problem; a search asks for the residual and then for its slopes at one place."""
        key = x.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, _Linear.at(self._problem, x)
        return self._last[1]

    def __call__(self, x: Vector) -> Vector:
        inner, problem = self._at(x), self._problem
        prior, right = problem.prior
        known = prior @ inner.response.T.ravel() - right
        limb = problem.limb_root @ (inner.outer.limb - problem.limb)
        return np.concatenate([(inner.X @ inner.response - problem.readings).ravel(), known, limb])

    def jacobian(self, x: Vector) -> Matrix:
        """Return Kaufman's Jacobian: the part of dX A' that the response cannot explain."""
        inner, problem = self._at(x), self._problem
        axes = _jacobian_of_rotation(inner.outer.vector) if problem.rotation else np.eye(3)
        moved = _design_derivatives(problem, inner.outer, axes) @ inner.response
        free = inner.free(moved, len(problem.prior[1])).T
        known = np.zeros((len(problem.limb_root), problem.outer))
        known[:, : problem.parameters] = problem.limb_root
        return np.concatenate([free, known])


def _design_derivatives(problem: Problem, outer: _Outer, axes: Matrix) -> NDArray[np.float64]:
    """Return dX by each inertial parameter and by turning further about each column of axes, one a row."""
    signals = problem.signals
    (J, n, _), s = signals.shape, problem.basis.shape[2]
    dX = np.zeros((problem.outer, J * n, problem.inputs))
    of_sets = dX.reshape(problem.outer, J, n, problem.inputs)[..., :AXES]
    basis = problem.basis
    if problem.rotation:
        basis = basis.copy()
        basis[..., DIRECT] = basis[..., DIRECT] @ outer.rotation
        gravity = np.einsum("jp,pws->jws", outer.limb + problem.added, problem.basis[..., DIRECT])
        steps = np.stack([gravity @ (skew(axis) @ outer.rotation) for axis in axes.T])
        of_sets[problem.parameters :] = signals[..., DIRECT] @ steps.swapaxes(-1, -2)
    of_sets[: problem.parameters] = signals[..., :s] @ basis[:, None].swapaxes(-1, -2)
    return dX


def _jacobian_of_rotation(vector: Vector) -> Matrix:
    """Return the left Jacobian J: d exp([v + dv]x) = [J dv]x exp([v]x), shape (3, 3)."""
    angle = float(np.linalg.norm(vector))
    K = skew(vector)
    if angle < _SMALL_ANGLE:
        return np.asarray(np.eye(3) + K / 2.0 + K @ K / 6.0)
    return np.asarray(
        np.eye(3) + (1.0 - np.cos(angle)) / angle**2 * K + (angle - np.sin(angle)) / angle**3 * K @ K
    )


def expand(problem: Problem, x: Vector, response: Matrix | None = None) -> Solution:
    """Return all that follows from outer unknowns (phi_b, rotation vector), and from A if it is given."""
    outer, X, white, *_ = _Linear.at(problem, x)
    if response is not None:
        white = response.T @ problem.whitening.T
    rows, channels = X @ white - problem.readings, problem.readings.shape[1]
    linear = np.einsum("ra,ij->rija", X, np.eye(channels)).reshape(rows.size, -1)
    bilinear = (_design_derivatives(problem, outer, np.eye(3)) @ white).reshape(problem.outer, -1).T
    prior, right = problem.prior
    known = np.zeros((len(prior) + len(problem.limb_root), linear.shape[1] + problem.outer))
    known[: len(prior), : linear.shape[1]] = prior
    known[len(prior) :, linear.shape[1] : linear.shape[1] + problem.parameters] = problem.limb_root
    off = np.concatenate([prior @ white.T.ravel() - right, problem.limb_root @ (outer.limb - problem.limb)])
    return Solution(
        response=np.asarray(np.linalg.solve(problem.whitening, white.T)),
        limb=outer.limb,
        rotation=outer.rotation,
        jacobian=np.concatenate([np.column_stack([linear, bilinear]), known]),
        residual=rows.reshape(len(problem.sets), -1, channels),
        cost=0.5 * float(np.sum(rows**2) + off @ off),
        outer=x,
    )


def project(solution: Solution, slopes: Matrix) -> Matrix:
    """Project slopes of the rows of the sets off the unknowns of a solution, shape (rows, q)."""
    basis, _ = orthonormal(solution.jacobian)
    slopes = np.pad(slopes, ((0, len(basis) - len(slopes)), (0, 0)))
    return np.asarray(slopes - basis @ (basis.T @ slopes))


Fitted = tuple[Problem, Solution]


def follow(
    make: Callable[[Problem, Solution], Problem], problem: Problem, solution: Solution, rounds: int
) -> Fitted:
    """Fit a few times with signals that follow from the loads of the fit before."""
    for _ in range(rounds):
        rotation, limb = solution.outer[problem.parameters :], solution.limb
        problem = make(problem, solution)
        limb = np.pad(limb, (0, problem.parameters - len(limb)))
        solution = solve(problem, [np.concatenate([limb, rotation])])
    return problem, solution


def beside_loads(
    plain: Problem,
    columns: Sequence[Matrix],
    std: float,
    options: InSituOptions,
    slopes: Matrix | None = None,
) -> Problem:
    """Add signals of the loads to a problem, each with one parameter: an axis's share of it.

    Args:
        plain: The problem without.
        columns: Signals of the axes at the rows of each set, shape (m, 6), or behind q of ``slopes``.
        std: Expected size of the parameters.
        options: Of the fit.
        slopes: Slopes of the wrench of each of the first signals by the parameters, shape (q, 6, p).
    """
    p, _, s = plain.basis.shape
    extra = () if slopes is None else slopes
    basis = np.zeros((p + AXES, AXES, s + len(extra) + AXES))
    basis[:p, :, :s] = plain.basis
    basis[p:, :, -AXES:] = np.eye(AXES)[:, :, None] * np.eye(AXES)[:, None, :]
    for place, slope in enumerate(extra, s):
        basis[:p, :, place] = slope.T
    parts = add_signals(plain.sets, columns, options, first=s)
    return replace(
        plain,
        sets=parts,
        added=np.pad(plain.added, ((0, 0), (0, AXES))),
        whitening=whiten_channels(parts),
        basis=basis,
        limb=np.pad(plain.limb, (0, AXES)),
        limb_root=block_diag(plain.limb_root, np.eye(AXES) / std),
    )


def beside_channels(plain: Problem, columns: Sequence[Matrix], options: InSituOptions) -> Problem:
    """Return the problem with signals that act on the readings directly, at the rows of each set, (m, q)."""
    parts = add_signals(plain.sets, columns, options)
    return replace(
        plain,
        sets=parts,
        channel_lags=plain.channel_lags + columns[0].shape[1],
        whitening=whiten_channels(parts),
    )


def criterion(problem: Problem, solution: Solution) -> float:
    """Return minus twice the log-likelihood, with Schwarz's penalty for free parameters (1978)."""
    left = whiten_residuals(problem, solution)
    rows = sum(part.rows for part in problem.sets)
    return deviance(problem.sets, left) + float(solution.jacobian.shape[1] * np.log(rows))


def deviance(parts: Sequence[CompressedSet], left: Sequence[Matrix]) -> float:
    """Return minus twice the log-likelihood of sets' rows at the channels' likeliest covariance.

    In the modes of their cosine transform rows are independent, with the power of the sets' colour, and
    channels have one covariance S in all of them: -2 log L = n (k (1 + log 2 pi) + log |S|) + k log |colour|.

    Args:
        parts: The sets, with n rows of k channels in all.
        left: Whitened residuals of a fit, as :func:`whiten_residuals` returns them.
    """
    rows, channels = sum(map(len, left)), left[0].shape[1]
    scatter = sum(one.T @ one for one in left)
    size = np.sqrt(np.maximum(np.diag(scatter), np.finfo(float).tiny))
    _, logdet = np.linalg.slogdet(scatter / np.outer(size, size))
    logdet += 2.0 * np.sum(np.log(size)) - channels * np.log(rows)
    of_colour = channels * sum(part.log_colour for part in parts)
    value = float(rows * (channels * (1.0 + np.log(2.0 * np.pi)) + logdet) + of_colour)
    return value if np.isfinite(value) else np.inf


def whiten_residuals(problem: Problem, solution: Solution) -> list[Matrix]:
    """Whiten the residuals of each set's rows by their colour, in the order of time, shape (m, k)."""
    found = []
    between = problem.unwhiten(solution.residual)
    for part, one in zip(problem.sets, between, strict=True):
        root = np.sqrt(part.colour.power_after(part.rows, part.spacing))[:, None]
        modes = dct(part.residual - part.score @ one, norm="ortho", axis=0) / root
        found.append(np.asarray(idct(modes, norm="ortho", axis=0)))
    return found
