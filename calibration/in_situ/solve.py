r"""The measurement-space fit: least squares on noisy readings, not on noisy regressors; private.

In-situ paper, Eqs. 18-25, regress gravity on the noisy readings, :math:`C r = M g`, and so shrink C. Here the
noise is where it is,

.. math:: r = A (M_b + M_a^j) g + o_j + e, \qquad A = C^{-1},

bilinear in the response A and the limb's inertial parameters :math:`\varphi_b`. Given :math:`\varphi_b` (and
a rotation of the accelerometer, if that is unknown) A is a linear least-squares solution, so only the few
outer unknowns are searched (variable projection: Golub and Pereyra, 1973; Jacobian of Kaufman, 1975).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from surefoot.calibration._vectors import skew
from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.model import STATIC, sensitivity

__all__ = [
    "Problem",
    "Solution",
    "expand",
    "hanging",
    "loop_shares",
    "minima",
    "of_unit_length",
    "solve",
    "starts",
    "transforms",
]

Matrix = NDArray[np.float64]

_SEARCHES = 3
"""Starts from which to search."""

_TURNED_SEARCHES = 36
"""The same where the rotation is unknown."""

_AS_GOOD = 10.0
"""Minima that cost this much more than the lowest are none."""


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be solved, in readings whitened by the noise, z = W r.

    Attributes:
        sets: J of them, compressed.
        added: Inertial parameters of what was added, shape (J, p).
        whitening: W, shape (k, k): W Sigma W' = 1.
        basis: D, shape (p, 6, s) for s signals: w = sum_p phi_p D_p u.
        moving: Whether the signals are those of a moving limb.
        temperature: Whether the temperature is a signal that acts on the readings directly.
        channel_lags: Number of such signals behind it, the lags of channels.
        rotation: Whether the accelerometer's rotation is unknown.
        prior_response: A of the factory in counts per N and N m, shape (k, 6), or None.
        prior_information: One over the variance of an entry of each column of W A by the factory, shape (6,).
        limb: Expected inertial parameters, shape (p,); zero where nothing is known.
        limb_root: Rows that weigh phi - limb, shape (q, p).
    """

    sets: tuple[CompressedSet, ...]
    added: Matrix
    whitening: Matrix
    basis: Matrix
    moving: bool
    temperature: bool
    channel_lags: int
    rotation: bool
    prior_response: Matrix | None
    prior_information: NDArray[np.float64]
    limb: NDArray[np.float64]
    limb_root: Matrix

    @property
    def parameters(self) -> int:
        """Number p of inertial parameters."""
        return len(self.limb)

    @property
    def hysteresis(self) -> bool:
        """Whether the last six parameters are the shares of the axes' hysteresis."""
        return self.parameters > (10 if self.moving else 4)

    @property
    def inputs(self) -> int:
        """Columns of the response: six, and one more for each signal that acts on the readings directly."""
        return 6 + self.temperature + self.channel_lags

    @property
    def outer(self) -> int:
        """Number of outer unknowns."""
        return self.parameters + 3 * self.rotation


@dataclass(frozen=True, eq=False)
class Solution:
    """What came out.

    Attributes:
        response: A, and the coefficients of what acts on the readings directly beside it, (k, inputs).
        limb: phi_b, shape (p,).
        rotation: R_sensor_accelerometer, shape (3, 3).
        jacobian: Of all rows by (W A row by row, phi_b, rotation vector in the sensor's frame).
        residual: Of the rows of the sets, shape (J, s, k), whitened.
        cost: Half the sum of all squared rows.
        outer: The outer unknowns: phi_b and, where it is unknown, the rotation vector.
    """

    response: Matrix
    limb: NDArray[np.float64]
    rotation: Matrix
    jacobian: Matrix
    residual: NDArray[np.float64]
    cost: float
    outer: NDArray[np.float64]


def transforms(problem: Problem, limb: NDArray[np.float64], rotation: Matrix) -> NDArray[np.float64]:
    """T of each set with its added mass, by the rotation, shape (J, inputs, s)."""
    T = np.einsum("jp,pws->jws", limb + problem.added, problem.basis)
    if problem.rotation:
        T[..., :3] = T[..., :3] @ rotation
    if problem.inputs > 6:
        T = np.stack([block_diag(part, np.eye(problem.inputs - 6)) for part in T])
    return np.asarray(T)


def of_unit_length(columns: Matrix) -> tuple[Matrix, NDArray[np.float64]]:
    """Divide columns by their lengths, which come along; a column of zeros by one."""
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    return columns / size, size


def loop_shares(problem: Problem, solution: Solution) -> NDArray[np.float64]:
    """Shares of each axis, shape (6,), or of each channel, shape (k,), of a fit with loops."""
    if problem.channel_lags:
        return np.diag(solution.response[:, -problem.channel_lags :])
    return solution.limb[-6:]


def solve(problem: Problem, starts: Sequence[NDArray[np.float64]]) -> Solution:
    """Search the outer unknowns from each start and keep the best.

    Args:
        problem: The problem.
        starts: Outer unknowns to start from, shape (p,) or (p + 3,) with the rotation vector.
    """
    found = [_search(problem, start) for start in starts]
    return expand(problem, min(found, key=_rank_of)[1])


def minima(problem: Problem, starts: Sequence[NDArray[np.float64]]) -> list[Solution]:
    """Search from the most promising starts, and list what fits as well as the best, which comes first."""
    costs = [float(np.sum(_outer_residual(problem, start) ** 2)) for start in starts]
    promising = np.argsort(costs)[: _TURNED_SEARCHES if problem.rotation else _SEARCHES]
    found = sorted((_search(problem, starts[i]) for i in promising), key=_rank_of)
    lowest = found[0][0]
    return [expand(problem, outer) for cost, outer in found if cost <= lowest + _AS_GOOD]


def _rank_of(found: tuple[float, NDArray[np.float64]]) -> tuple[bool, float]:
    """Turned round, a response fits a limb of negative mass as well as the true one fits the limb."""
    cost, outer = found
    return bool(outer[0] <= 0.0), cost


def _search(problem: Problem, start: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Cost and outer unknowns at the minimum next to a start."""
    mass = max(abs(float(start[0])), 1e-3)
    scale = np.concatenate([np.full(problem.parameters, mass), np.ones(3 * problem.rotation)])
    found = least_squares(
        lambda x: _outer_residual(problem, x * scale),
        start / scale,
        jac=lambda x: _outer_jacobian(problem, x * scale) * scale,
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
        max_nfev=60,
    )
    return float(found.cost), found.x * scale


def _split(problem: Problem, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], Matrix]:
    limb = x[: problem.parameters]
    turn = np.eye(3) if not problem.rotation else Rotation.from_rotvec(x[-3:]).as_matrix()
    return limb, turn


def _design(problem: Problem, x: NDArray[np.float64]) -> tuple[Matrix, Matrix]:
    """X and Y of X (W A)' = Y: rows of all sets, then those of the factory matrix."""
    limb, turn = _split(problem, x)
    T = transforms(problem, limb, turn)
    X = np.concatenate([part.uu @ t.T for part, t in zip(problem.sets, T, strict=True)])
    Y = np.concatenate([part.ur for part in problem.sets]) @ problem.whitening.T
    if problem.prior_response is not None:
        root = np.sqrt(problem.prior_information)
        X = np.concatenate([X, np.eye(6, problem.inputs) * root[:, None]])
        Y = np.concatenate([Y, root[:, None] * (problem.whitening @ problem.prior_response).T])
    return X, Y


def _inner(X: Matrix, Y: Matrix) -> tuple[Matrix, Matrix]:
    """(W A)' of least squares, and an orthonormal basis of the columns of X."""
    unit, size = of_unit_length(X)
    left, singular, right = np.linalg.svd(unit, full_matrices=False)
    kept = singular > 1e-13 * singular[0]
    left = left[:, kept]
    return (right[kept].T / singular[kept]) @ (left.T @ Y) / size[:, None], left


def _outer_residual(problem: Problem, x: NDArray[np.float64]) -> NDArray[np.float64]:
    X, Y = _design(problem, x)
    _, left = _inner(X, Y)
    limb = problem.limb_root @ (x[: problem.parameters] - problem.limb)
    return np.concatenate([(left @ (left.T @ Y) - Y).ravel(), limb])


def _outer_jacobian(problem: Problem, x: NDArray[np.float64]) -> Matrix:
    """Kaufman's: what of dX A' the response could not undo."""
    X, Y = _design(problem, x)
    response, left = _inner(X, Y)
    limb, turn = _split(problem, x)
    axes = _left_jacobian(x[-3:]) if problem.rotation else np.eye(3)
    columns = []
    for dX in _design_derivatives(problem, limb, turn, axes, len(X)):
        moved = dX @ response
        columns.append((moved - left @ (left.T @ moved)).ravel())
    known = np.pad(problem.limb_root, ((0, 0), (0, problem.outer - problem.parameters)))
    return np.concatenate([np.stack(columns, axis=1), known])


def _design_derivatives(
    problem: Problem, limb: NDArray[np.float64], turn: Matrix, axes: Matrix, rows: int
) -> list[Matrix]:
    """List dX by each inertial parameter and by turning further about each column of axes."""
    D = problem.basis.copy()
    D[..., :3] = D[..., :3] @ turn
    steps = [np.broadcast_to(d, (len(problem.sets), *d.shape)) for d in D]
    if problem.rotation:
        gravity = np.einsum("jp,pws->jws", limb + problem.added, problem.basis[..., :3])
        steps += [gravity @ (skew(axis) @ turn) for axis in axes.T]
    derivatives = []
    for step in steps:
        dX, first = np.zeros((rows, problem.inputs)), 0
        for part, d in zip(problem.sets, step, strict=True):
            dX[first : first + len(part.uu), :6] = part.uu[:, : d.shape[1]] @ d.T
            first += len(part.uu)
        derivatives.append(dX)
    return derivatives


def _left_jacobian(vector: NDArray[np.float64]) -> Matrix:
    """Compute J: d exp([v + dv]x) = [J dv]x exp([v]x), shape (3, 3)."""
    angle = float(np.linalg.norm(vector))
    K = skew(vector)
    if angle < 1e-4:
        return np.asarray(np.eye(3) + K / 2.0 + K @ K / 6.0)
    return np.asarray(
        np.eye(3) + (1.0 - np.cos(angle)) / angle**2 * K + (angle - np.sin(angle)) / angle**3 * K @ K
    )


def expand(problem: Problem, x: NDArray[np.float64]) -> Solution:
    """Work everything out at given outer unknowns (phi_b, rotation vector)."""
    limb, turn = _split(problem, x)
    X, Y = _design(problem, x)
    white, _ = _inner(X, Y)
    rows, channels = X @ white - Y, Y.shape[1]
    linear = np.einsum("ra,ij->rija", X, np.eye(channels)).reshape(rows.size, -1)
    bilinear = [(dX @ white).ravel() for dX in _design_derivatives(problem, limb, turn, np.eye(3), len(X))]
    known = np.zeros((len(problem.limb_root), linear.shape[1] + problem.outer))
    known[:, linear.shape[1] : linear.shape[1] + problem.parameters] = problem.limb_root
    limb_rows = problem.limb_root @ (limb - problem.limb)
    of_sets = sum(len(part.uu) for part in problem.sets)
    return Solution(
        response=np.asarray(np.linalg.solve(problem.whitening, white.T)),
        limb=limb,
        rotation=turn,
        jacobian=np.concatenate([np.column_stack([linear, *bilinear]), known]),
        residual=rows[:of_sets].reshape(len(problem.sets), -1, channels),
        cost=0.5 * float(np.sum(rows**2) + limb_rows @ limb_rows),
        outer=x,
    )


_MULTIPLES = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
"""Masses to try, in units of the largest added mass."""

_TURNED_MULTIPLES = (1.0, 10.0)
"""The same where each is tried with all turns by right angles."""


def starts(
    problem: Problem, factory: Matrix | None, known: NDArray[np.float64] | None
) -> list[NDArray[np.float64]]:
    """List outer unknowns to start from, shape (p,), or (p + 3,) where the rotation is unknown.

    Args:
        problem: The problem.
        factory: The factory matrix, shape (6, k), or None.
        known: What is known of the limb, shape (p,), or None.
    """
    found = [known] if known is not None else []
    if factory is not None and not problem.rotation:
        found.append(_by_matrix(problem, factory, np.eye(3)))
    largest = float(np.max(problem.added[:, 0]))
    if largest > 0.0:
        # Few and noisy samples shrink the paper's mass, but not its first moment, and a search that begins at
        # such a mass can end in a wrong place.
        first = _by_paper(problem) if len(problem.sets) >= 3 else _padded(problem, [largest, 0.0, 0.0, 0.0])
        found.append(first)
        multiples = _TURNED_MULTIPLES if problem.rotation else _MULTIPLES
        found += [np.concatenate([[multiple * largest], first[1:]]) for multiple in multiples]
    found = [start for start in found if np.all(np.isfinite(start))]
    found = found or [_padded(problem, [1.0, 0.0, 0.0, 0.0])]
    if not problem.rotation:
        return found
    # The identity and the turns by right angles: the true one is near one of them.
    turns = [turn.as_rotvec() for turn in Rotation.create_group("O")]
    turned = [np.concatenate([start, turn]) for start in found for turn in turns]
    if factory is not None:
        matrices = [Rotation.from_rotvec(turn).as_matrix() for turn in turns]
        by_matrix = [_by_matrix(problem, factory, matrix) for matrix in matrices]
        turned = [np.concatenate(pair) for pair in zip(by_matrix, turns, strict=True)] + turned
    return turned


def hanging(
    matrix: Matrix, part: CompressedSet, rotation: Matrix, beside: Matrix | None = None
) -> NDArray[np.float64]:
    """Weigh all that hangs on the sensor in a set by a known matrix: (m, m c), shape (4,).

    Args:
        matrix: C, shape (6, k).
        part: The set.
        rotation: R_sensor_accelerometer.
        beside: Response to the signals beside gravity, shape (k, s - 3), if it is known.
    """
    response: Matrix = part.response[:, :3]
    if beside is not None:
        left = part.ur - part.uu[:, 3:] @ beside.T
        response = np.asarray(np.linalg.lstsq(part.uu[:, :3], left, rcond=None)[0].T)
    measured = matrix @ response @ rotation.T
    D = sensitivity(moving=False)
    return np.asarray(np.linalg.lstsq(D.reshape(STATIC, -1).T, measured.ravel(), rcond=None)[0])


def _by_matrix(problem: Problem, matrix: Matrix, rotation: Matrix) -> NDArray[np.float64]:
    seen = [hanging(matrix, part, rotation) for part in problem.sets]
    return _padded(problem, np.mean(np.array(seen) - problem.added[:, :STATIC], axis=0))


def _by_paper(problem: Problem) -> NDArray[np.float64]:
    """In-situ paper, Eqs. 18-24, on compressed rows, in which the noise is averaged: C r - T_b u = T_a u."""
    D = problem.basis
    count = D.shape[2]
    readings = [problem.whitening @ part.ur.T for part in problem.sets]
    left = np.linalg.svd(np.concatenate(readings, axis=1))[0][:, :6]
    rows, right = [], []
    for part, reading, added in zip(problem.sets, readings, problem.added, strict=True):
        moved = D @ part.uu[:, :count].T
        matrix = np.kron(np.eye(6), (left.T @ reading).T)
        rows.append(np.hstack([matrix, -moved.reshape(len(D), -1).T]))
        right.append(np.einsum("p,pws->ws", added, moved).ravel())
    unit, size = of_unit_length(np.concatenate(rows))
    solution = np.linalg.lstsq(unit, np.concatenate(right), rcond=1e-10)[0] / size
    return np.asarray(solution[-len(D) :])


def _padded(problem: Problem, static: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([np.asarray(static), np.zeros(problem.parameters - STATIC)])
