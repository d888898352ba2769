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
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from surefoot.calibration.arrays import of_unit_length, orthonormal, skew
from surefoot.calibration.in_situ.data import Matrix, Vector
from surefoot.calibration.in_situ.model import (
    AXES,
    MASS,
    SPREAD_ROUNDING,
    signal_rotation,
    signal_rotation_slope,
)
from surefoot.calibration.in_situ.solver.colour import Spectrum, likeliest_colour
from surefoot.calibration.in_situ.solver.compress import SetRows, add_signals, motion_of
from surefoot.calibration.in_situ.solver.problem import Problem

_SEARCHES, _TURNED_SEARCHES = 3, 36  # starts from which to search; the second where the rotation is unknown
_AS_GOOD = 10.0  # minima that cost this much more than the lowest are none

CONVERGED, _EVALUATIONS = 1e-8, 60
"""Relative change of cost, unknowns and slope at which a search ends, and its evaluations at most."""

_LEAST_MASS, _SMALL_ANGLE = 1e-3, 1e-4
"""Mass in kg by which unknowns are scaled at least, and angle in rad below which a short series is exact."""


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution of a :class:`Problem`."""

    problem: Problem  # the problem
    outer: Vector  # the outer unknowns: phi_b, the rotation vector where it is unknown, and changes
    response: Matrix
    """A, and beside it the coefficients of signals that act on the readings directly, (k, inputs)."""
    rotation: Matrix  # R_sensor_accelerometer, shape (3, 3)
    jacobian: Matrix  # of all rows by (W A row by row, phi_b, rotation vector in the sensor's frame, changes)
    residual: NDArray[np.float64]  # of the rows of the sets, of variance one, shape (J, s, k)
    cost: float  # half the sum of all squared rows

    @property
    def limb(self) -> Vector:
        """phi_b, shape (p,)."""
        return self.outer[: self.problem.parameters]

    @property
    def prior_square(self) -> float:
        """Sum of the squared rows of the priors."""
        return 2.0 * self.cost - float(np.sum(self.residual**2))

    @property
    def changes(self) -> Vector:
        """Sizes of the changes of the added parameters, shape (q,)."""
        return self.outer[self.problem.outer - len(self.problem.changes) :]

    @property
    def A(self) -> Matrix:  # noqa: N802 - as in the equations
        """The response to wrenches, in counts per N and N m, shape (k, 6)."""
        return self.response[:, :AXES]

    @property
    def direct(self) -> Matrix:
        """Coefficients of signals that act on the readings directly, shape (k, inputs - 6)."""
        return self.response[:, AXES:]

    @cached_property
    def transforms(self) -> NDArray[np.float64]:
        """T of each set with its added mass, shape (J, inputs, s)."""
        return _Outer.of(self.problem, self.outer).transforms

    @property
    def loads(self) -> NDArray[np.float64]:
        """T of each set that gives the wrench by all signals, shape (J, 6, s)."""
        return self.transforms[:, :AXES]

    @property
    def predicted(self) -> NDArray[np.float64]:
        """Response of each set to its signals, A T, shape (J, k, s)."""
        return np.asarray(self.response @ self.transforms)

    @property
    def shares(self) -> Vector:
        """Shares of hysteresis of each axis, shape (6,)."""
        return self.limb[self.problem.loops]

    @cached_property
    def basis(self) -> tuple[Matrix, Matrix]:
        """An orthonormal basis of the Jacobian's columns, and the Jacobian's inverse by it."""
        return orthonormal(self.jacobian)

    def project(self, slopes: Matrix) -> Matrix:
        """Project slopes of the rows of the sets off the unknowns, shape (rows, q)."""
        left, _ = self.basis
        slopes = np.pad(slopes, ((0, len(left) - len(slopes)), (0, 0)))
        return np.asarray(slopes - left @ (left.T @ slopes))


class _Outer(NamedTuple):
    """The outer unknowns in their parts."""

    problem: Problem
    limb: Vector
    vector: Vector
    rotation: Matrix
    added: Matrix  # parameters of the added masses, changed, shape (J, p)

    @classmethod
    def of(cls, problem: Problem, x: Vector) -> "_Outer":
        limb, vector, change = np.split(x, [problem.parameters, problem.parameters + 3 * problem.rotation])
        rotation = Rotation.from_rotvec(vector).as_matrix() if problem.rotation else np.eye(3)
        added = problem.added + np.tensordot(change, problem.changes, 1) if len(change) else problem.added
        return cls(problem, limb, vector, rotation, added)

    def turn(self, T: NDArray[np.float64]) -> NDArray[np.float64]:
        """Let transforms, shape (..., 6, s), take gravity and motion as the accelerometer reads them."""
        if not self.problem.rotation:
            return T
        motion = self.problem.motion
        S = signal_rotation(self.rotation, self.problem.moving)
        return np.concatenate([T[..., motion] @ S, T[..., motion.stop :]], axis=-1)

    @property
    def transforms(self) -> NDArray[np.float64]:
        """T of each set with its added mass, shape (J, inputs, s)."""
        T = self.turn(np.einsum("jp,pws->jws", self.limb + self.added, self.problem.basis))
        direct = self.problem.inputs - AXES
        if not direct:
            return np.asarray(T)
        whole = np.zeros((len(T), self.problem.inputs, T.shape[2] + direct))
        whole[:, :AXES, :-direct] = T
        whole[:, AXES:, -direct:] = np.eye(direct)
        return whole

    def derivatives(self, axes: Matrix) -> NDArray[np.float64]:
        """Return dX, shape (outer, J n, inputs): by phi, by turning about columns of axes, and by changes."""
        problem, signals = self.problem, self.problem.signals
        J, n, _ = signals.shape
        dT = [np.repeat(self.turn(problem.basis)[:, None], J, axis=1)]
        if problem.rotation:
            M = np.einsum("jp,pws->jws", self.limb + self.added, problem.basis[..., problem.motion])
            S = signal_rotation(self.rotation, problem.moving)
            steps = np.zeros((3, *M.shape[:2], problem.basis.shape[2]))
            steps[..., problem.motion] = [
                M @ signal_rotation_slope(axis, problem.moving) @ S for axis in axes.T
            ]
            dT.append(steps)
        if len(problem.changes):
            dT.append(self.turn(np.einsum("qjp,pws->qjws", problem.changes, problem.basis)))
        dX = np.zeros((problem.outer, J, n, problem.inputs))
        dX[..., :AXES] = signals[..., : problem.basis.shape[2]] @ np.concatenate(dT).swapaxes(-1, -2)
        return dX.reshape(problem.outer, J * n, problem.inputs)


def solve(problem: Problem, starts: Sequence[Vector], evaluations: int = _EVALUATIONS) -> Solution:
    """Return the best of the minima next to starts, shape (p,), or (p + 3,) with the rotation vector.

    A few evaluations come near enough to compare minima.
    """
    found = [_search(problem, start, evaluations) for start in starts]
    return expand(problem, min(found, key=_rank_of)[1])


def minima(problem: Problem, starts: Sequence[Vector]) -> list[Solution]:
    """Find the minima next to promising starts that fit as well as the best, which comes first."""
    costs = [float(np.sum(_residual(_Linear.at(problem, start)) ** 2)) for start in starts]
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
    scale = np.ones(problem.outer)
    scale[: problem.parameters] = max(abs(float(start[MASS])), _LEAST_MASS)
    # A search asks for the residual and then for its slopes at one place.
    inner = lru_cache(1)(lambda key: _Linear.at(problem, np.frombuffer(key) * scale))
    found = scipy.optimize.least_squares(
        lambda x: _residual(inner(x.tobytes())),
        start / scale,
        jac=lambda x: _slopes(inner(x.tobytes())) * scale,
        method="lm",
        max_nfev=evaluations,
        **dict.fromkeys(("xtol", "ftol", "gtol"), CONVERGED),
    )
    return float(found.cost), found.x * scale


class _Linear(NamedTuple):
    """The inner problem at outer unknowns: X (W A)' = Y in the sets' rows, and the maker's rows of W A."""

    outer: _Outer
    X: Matrix
    response: Matrix  # (W A)' of least squares
    left: Matrix  # an orthonormal basis of the columns: of X, or with a maker of all rows
    coupled: bool  # whether the maker's rows couple the channels

    @classmethod
    def at(cls, problem: Problem, x: Vector) -> "_Linear":
        outer = _Outer.of(problem, x)
        X = (problem.signals @ outer.transforms.swapaxes(1, 2)).reshape(-1, problem.inputs)
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


def _residual(inner: _Linear) -> Vector:
    """Return rows less the part that a response explains: of the sets, the maker's, and the limb's."""
    problem, (prior, right) = inner.outer.problem, inner.outer.problem.prior
    known = prior @ inner.response.T.ravel() - right
    limb = problem.limb_root @ (inner.outer.limb - problem.limb)
    return np.concatenate([(inner.X @ inner.response - problem.readings).ravel(), known, limb])


def _slopes(inner: _Linear) -> Matrix:
    """Return Kaufman's Jacobian by the outer unknowns: the part of dX A' that the response cannot explain."""
    problem = inner.outer.problem
    axes = _jacobian_of_rotation(inner.outer.vector) if problem.rotation else np.eye(3)
    moved = inner.outer.derivatives(axes) @ inner.response
    known = np.zeros((len(problem.limb_root), problem.outer))
    known[:, : problem.parameters] = problem.limb_root
    return np.concatenate([inner.free(moved, len(problem.prior[1])).T, known])


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
    inner = _Linear.at(problem, x)
    if response is not None:
        inner = inner._replace(response=response.T @ problem.whitening.T)
    outer, white, residual = inner.outer, inner.response, _residual(inner)
    channels = problem.readings.shape[1]
    linear = np.einsum("ra,ij->rija", inner.X, np.eye(channels)).reshape(problem.readings.size, -1)
    bilinear = (outer.derivatives(np.eye(3)) @ white).reshape(problem.outer, -1).T
    prior, _ = problem.prior
    known = np.zeros((len(prior) + len(problem.limb_root), linear.shape[1] + problem.outer))
    known[: len(prior), : linear.shape[1]] = prior
    known[len(prior) :, linear.shape[1] : linear.shape[1] + problem.parameters] = problem.limb_root
    return Solution(
        problem=problem,
        outer=x,
        response=np.asarray(np.linalg.solve(problem.whitening, white.T)),
        rotation=outer.rotation,
        jacobian=np.concatenate([np.column_stack([linear, bilinear]), known]),
        residual=residual[: problem.readings.size].reshape(len(problem.sets), -1, channels),
        cost=0.5 * float(residual @ residual),
    )


_Make = Callable[[Solution], Problem]  # makes a problem with signals that follow from the loads of a fit


def follow(make: _Make, solution: Solution, rounds: int) -> Solution:
    """Fit a few times with signals that follow from the loads of the fit before."""
    for _ in range(rounds):
        rotation, limb = solution.outer[solution.problem.parameters :], solution.limb
        problem = make(solution)
        limb = np.pad(limb, (0, problem.parameters - len(limb)))
        solution = solve(problem, [np.concatenate([limb, rotation])])
    return solution


def beside_loads(plain: Problem, columns: Sequence[Matrix], std: float) -> Problem:
    """Add signals of the loads to a problem, each with one parameter of expected size: an axis's share of it.

    Signals are of the axes at the rows of each set, (m, 6).
    """
    p, _, s = plain.basis.shape
    basis = np.zeros((p + AXES, AXES, s + AXES))
    basis[:p, :, :s] = plain.basis
    basis[p:, :, s:] = np.eye(AXES)[:, :, None] * np.eye(AXES)[:, None, :]
    return replace(
        plain,
        sets=add_signals(plain.sets, columns, s),
        added=np.pad(plain.added, ((0, 0), (0, AXES))),
        basis=basis,
        limb=np.pad(plain.limb, (0, AXES)),
        limb_root=block_diag(plain.limb_root, np.eye(AXES) / std),
    )


def beside_channels(plain: Problem, columns: Sequence[Matrix]) -> Problem:
    """Return the problem with signals that act on the readings directly, at the rows of each set, (m, q)."""
    direct = plain.direct + columns[0].shape[1]
    return replace(plain, sets=add_signals(plain.sets, columns), direct=direct)


def criterion(solution: Solution) -> float:
    """Return minus twice the log-likelihood, with Schwarz's penalty for free parameters (1978)."""
    rows = sum(part.rows for part in solution.problem.sets)
    return deviance(solution) + float(solution.jacobian.shape[1] * np.log(rows))


def deviance(solution: Solution) -> float:
    """Return minus twice the log-likelihood of rows, with the likeliest colour of all that a fit leaves.

    The priors that the fit has, such as a maker's, count as well: they hold back what needs a sensor that is
    far off. Noise counts as at least the error of a search: without noise anything would fit to some
    rounding.
    """
    spectra, rows = [], [part.source for part in solution.problem.sets]
    channels = _separate_channels(rows)
    for one, B in zip(rows, solution.predicted, strict=True):
        weight, u, readings = np.split(one.columns, [1, 1 + one.inputs], axis=1)
        left, constant = (readings - u @ B.T) @ channels, weight / np.linalg.norm(weight)
        spectra.append(Spectrum.of(left - constant @ (constant.T @ left), constant, one.spacing))
    value = likeliest_colour(spectra, motion_of(rows), rows[0].walks, CONVERGED**2)[1]
    if not np.isfinite(value):
        # Few rows show no colour.
        modes = np.concatenate([one.modes for one in spectra])
        scatter = modes.T @ modes + len(modes) * CONVERGED**2 * np.eye(modes.shape[1])
        value = len(modes) * float(np.linalg.slogdet(scatter)[1])
    value += solution.prior_square
    return value if np.isfinite(value) else np.inf


def _separate_channels(rows: Sequence[SetRows]) -> Matrix:
    """Return mixtures of channels of which none follows from the others, shape (k, q).

    Readings have variance one in each channel before they are mixed.
    """
    centred = []
    for one in rows:
        readings, constant = one.columns[:, 1 + one.inputs :], one.columns[:, :1]
        constant = constant / np.linalg.norm(constant)
        centred.append(readings - constant @ (constant.T @ readings))
    unit, size = of_unit_length(np.concatenate(centred))
    _, singular, mixtures = np.linalg.svd(unit, full_matrices=False)
    std = size / np.sqrt(sum(float(np.sum(one.weight**2)) for one in rows))
    return np.asarray(mixtures[singular > SPREAD_ROUNDING * singular[0]].T / std[:, None])
