r"""The measurement-space fit: least squares on noisy readings, not on noisy regressors.

In-situ paper, Eqs. 18-25, regress gravity on the noisy readings, :math:`C r = M g`, and so shrink C. Here the
noise is where it is,

.. math:: r = A (M_b + M_a^j) g + o_j + e, \qquad A = C^{-1},

bilinear in the response A and the limb's inertial parameters :math:`\varphi_b`. Given :math:`\varphi_b` (and
a rotation of the accelerometer, if that is unknown) A is a linear least-squares solution, also with what the
maker's matrix says of it (:class:`Maker`), so only the few outer unknowns are searched (variable projection:
Golub and Pereyra, 1973; Jacobian of Kaufman, 1975). Rows of all sets have noise of variance one, so that what
is known beforehand has its weight among them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surefoot.calibration.arrays import skew
from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.model import (
    AXES,
    DIRECT,
    MASS,
    MOVING,
    STATIC,
    transform_basis,
)

__all__ = [
    "ROUNDING",
    "Maker",
    "Problem",
    "Solution",
    "expand",
    "loop_shares",
    "minima",
    "of_unit_length",
    "solve",
    "transforms",
]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


ROUNDING = 1e-13
"""Singular values at or below this share of the largest are rounding."""

_SEARCHES, _TURNED_SEARCHES = 3, 36
"""Starts from which to search; the second where the rotation is unknown."""

_AS_GOOD = 10.0
"""Minima that cost this much more than the lowest are none."""

_CONVERGED, _EVALUATIONS = 1e-14, 60
"""Relative change of cost, unknowns and slope at which a search ends, and its evaluations at most."""

_LEAST_MASS, _SMALL_ANGLE = 1e-3, 1e-4
"""Mass in kg by which unknowns are scaled at least, and angle in rad below which a short series is exact."""


class Maker(NamedTuple):
    """What is known of the response beforehand: A = A_0 (1 + D), and what redundant channels read beside it.

    Attributes:
        response: A_0 in counts per N and N m, shape (k, 6).
        std: Deviations of the entries of D, shape (6, 6).
        beyond: Deviation of what lies beside the space of A_0, as a share of its columns.
    """

    response: Matrix
    std: Matrix
    beyond: float

    def errors(self, whitening: Matrix, inputs: int) -> Matrix:
        """Return D + 1 row by row by (W A row by row), shape (36, k inputs)."""
        inverse = np.linalg.pinv(self.response) @ np.linalg.inv(whitening)
        R = np.zeros((AXES, AXES, len(whitening), inputs))
        for j in range(AXES):
            R[:, j, :, j] = inverse
        return R.reshape(AXES**2, -1)

    def rows(self, whitening: Matrix, inputs: int) -> tuple[Matrix, Vector]:
        """Return rows by (W A row by row), shape (m, k inputs), of deviation one, and their right side."""
        channels = len(whitening)
        beside = np.linalg.svd(self.response)[0][:, AXES:].T @ np.linalg.inv(whitening)
        more = np.zeros((len(beside), AXES, channels, inputs))
        for j in range(AXES):
            more[:, j, :, j] = beside / (self.beyond * np.linalg.norm(self.response[:, j]))
        rows = self.errors(whitening, inputs) / self.std.reshape(-1, 1)
        rows = np.concatenate([rows, more.reshape(len(beside) * AXES, channels * inputs)])
        right = np.zeros(len(rows))
        right[: AXES**2] = np.eye(AXES).ravel() / self.std.ravel()
        return rows, right


@dataclass(frozen=True, eq=False)
class Problem:
    """A least-squares problem in readings whitened by the noise, z = W r.

    Attributes:
        sets: J of them, compressed.
        added: Inertial parameters of what was added, shape (J, p).
        whitening: W, shape (k, k): W Sigma W' = 1.
        basis: T_p, shape (p, 6, s) for s signals: w = sum_p phi_p T_p u.
        moving: Whether the signals are those of a moving limb.
        temperature: Whether the temperature is a signal that acts on the readings directly.
        channel_lags: Number of such signals behind it, the lags of channels.
        rotation: Whether the accelerometer's rotation is unknown.
        maker: What is known of the response beforehand, or None.
        limb: Expected inertial parameters, shape (p,); zero where nothing is known.
        limb_root: Rows that weigh phi - limb, shape (q, p).
        gains: Number of parameters behind the limb's that are gains of the axes with the temperature: 6 or 0.
    """

    sets: tuple[CompressedSet, ...]
    added: Matrix
    whitening: Matrix
    basis: Matrix
    moving: bool
    temperature: bool
    channel_lags: int
    rotation: bool
    maker: Maker | None
    limb: Vector
    limb_root: Matrix
    gains: int = 0

    @property
    def parameters(self) -> int:
        """Number p of inertial parameters."""
        return len(self.limb)

    @property
    def of_loads(self) -> slice:
        """Places of what makes a load act on itself in the parameters, behind the limb's; or empty."""
        return slice(MOVING if self.moving else STATIC, self.parameters)

    @property
    def motion(self) -> slice:
        """Places of the signals of gravity and motion."""
        return slice(0, len(transform_basis(self.moving)[0, 0]))

    @property
    def of_lags(self) -> slice:
        """Places of the loops of hysteresis in the signals; or empty."""
        behind = self.basis.shape[2] if self.hysteresis else self.signals.shape[2]
        return slice(behind - (AXES if self.hysteresis else self.channel_lags), behind)

    @property
    def loops(self) -> slice:
        """Places of the shares of the axes' hysteresis in the parameters; or empty."""
        return slice(self.of_loads.start + self.gains, self.parameters)

    @property
    def hysteresis(self) -> bool:
        """Whether the axes' hysteresis is part of the problem."""
        return bool(self.parameters > self.of_loads.start + self.gains)

    @property
    def inputs(self) -> int:
        """Columns of the response: six, and one more for each signal that acts on the readings directly."""
        return AXES + self.temperature + self.channel_lags

    @cached_property
    def signals(self) -> NDArray[np.float64]:
        """The sets' compressed signals in rows of variance one, shape (J, n, s)."""
        return np.stack([part.whiten @ part.uu for part in self.sets])

    @cached_property
    def readings(self) -> Matrix:
        """The sets' rows of readings, of variance one, shape (J n, k)."""
        return np.asarray(np.concatenate([part.whiten @ part.ur for part in self.sets]) @ self.whitening.T)

    @cached_property
    def prior(self) -> tuple[Matrix, Vector]:
        """Rows by (W A row by row) of what the maker says, shape (m, k inputs), and their right side."""
        if self.maker is None:
            return np.zeros((0, len(self.whitening) * self.inputs)), np.zeros(0)
        return self.maker.rows(self.whitening, self.inputs)

    def unwhitened(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the residual of the sets' rows, shape (J, n, k), in counts and by the sets' own rows."""
        root = np.stack([part.unwhiten for part in self.sets])
        return np.asarray(root @ residual @ np.linalg.inv(self.whitening).T)

    @property
    def outer(self) -> int:
        """Number of outer unknowns: the parameters and, where it is unknown, the rotation vector."""
        return self.parameters + 3 * self.rotation


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution of a :class:`Problem`.

    Attributes:
        response: A, and the coefficients of what acts on the readings directly beside it, (k, inputs).
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
        """Coefficients of what acts on the readings directly, shape (k, inputs - 6)."""
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


def of_unit_length(columns: Matrix) -> tuple[Matrix, Vector]:
    """Return columns over their lengths, and the lengths; one for a column of zeros."""
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    return columns / size, size


def loop_shares(problem: Problem, solution: Solution) -> Vector:
    """Return the shares of each axis, shape (6,), or of each channel, shape (k,), of a fit with loops."""
    if problem.channel_lags:
        return np.diag(solution.response[:, -problem.channel_lags :])
    return solution.limb[problem.loops]


def solve(problem: Problem, starts: Sequence[Vector]) -> Solution:
    """Return the best of the minima next to starts, shape (p,), or (p + 3,) with the rotation vector."""
    found = [_search(problem, start) for start in starts]
    return expand(problem, min(found, key=_rank_of)[1])


def minima(problem: Problem, starts: Sequence[Vector]) -> list[Solution]:
    """Return what fits as well as the best of the minima next to promising starts; the best comes first."""
    costs = [float(np.sum(_Residual(problem)(start) ** 2)) for start in starts]
    promising = np.argsort(costs)[: _TURNED_SEARCHES if problem.rotation else _SEARCHES]
    found = sorted((_search(problem, starts[i]) for i in promising), key=_rank_of)
    lowest = found[0][0]
    return [expand(problem, outer) for cost, outer in found if cost <= lowest + _AS_GOOD]


def _rank_of(found: tuple[float, Vector]) -> tuple[bool, float]:
    """Turned round, a response fits a limb of negative mass as well as the true one fits the limb."""
    cost, outer = found
    return bool(outer[MASS] <= 0.0), cost


def _search(problem: Problem, start: Vector) -> tuple[float, Vector]:
    """Return the cost and the outer unknowns at the minimum next to a start."""
    from scipy.optimize import least_squares  # Late: it takes longer to import than all the rest.

    mass = max(abs(float(start[MASS])), _LEAST_MASS)
    scale = np.concatenate([np.full(problem.parameters, mass), np.ones(3 * problem.rotation)])
    residual = _Residual(problem)
    found = least_squares(
        lambda x: residual(x * scale),
        start / scale,
        jac=lambda x: residual.jacobian(x * scale) * scale,
        max_nfev=_EVALUATIONS,
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
            left, back = _orthonormal(X)
            return cls(outer, X, back @ (left.T @ problem.readings), left, False)
        prior, right = problem.prior
        every = np.zeros((len(X) * channels + len(prior), channels * problem.inputs))
        of_sets = every[: len(X) * channels].reshape(len(X), channels, channels, problem.inputs)
        of_sets[:, np.arange(channels), np.arange(channels)] = X[:, None]
        every[len(X) * channels :] = prior
        left, back = _orthonormal(every)
        found = back @ (left.T @ np.concatenate([problem.readings.ravel(), right]))
        return cls(outer, X, found.reshape(channels, problem.inputs).T, left, True)

    def free(self, of_sets: NDArray[np.float64], of_prior: int) -> NDArray[np.float64]:
        """Return rows of sets, shape (..., n, k), and zeros of the prior, less what the response explains."""
        *batch, n, k = of_sets.shape
        if not self.coupled:
            return np.asarray((of_sets - self.left @ (self.left.T @ of_sets)).reshape(*batch, n * k))
        rows = np.concatenate([of_sets.reshape(*batch, n * k), np.zeros((*batch, of_prior))], axis=-1)
        return np.asarray(rows - (rows @ self.left) @ self.left.T)


def _orthonormal(columns: Matrix) -> tuple[Matrix, Matrix]:
    """Return an orthonormal basis of columns, and their pseudo-inverse by that basis."""
    unit, size = of_unit_length(columns)
    left, singular, right = np.linalg.svd(unit, full_matrices=False)
    kept = singular > ROUNDING * singular[0]
    return left[:, kept], right[kept].T / singular[kept] / size[:, None]


class _Residual:
    """The rows by the outer unknowns, less what the best response explains, and their slopes."""

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
        """Return Kaufman's: what of dX A' the response could not undo."""
        inner, problem = self._at(x), self._problem
        axes = _left_jacobian(inner.outer.vector) if problem.rotation else np.eye(3)
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


def _left_jacobian(vector: Vector) -> Matrix:
    """Return J: d exp([v + dv]x) = [J dv]x exp([v]x), shape (3, 3)."""
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
