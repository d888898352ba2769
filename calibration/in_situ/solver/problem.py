"""The least-squares problem of compressed sets, its priors, and where to search from.

Rows of all sets have noise of variance one, so that priors have their weight among them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surefoot.calibration.arrays import ROUNDING, of_unit_length
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.data import KnownLimb, Matrix, Task, Vector
from surefoot.calibration.in_situ.model import (
    AXES,
    DIRECT,
    ENOUGH_MASSES,
    MASS,
    MOMENT,
    MOVING,
    STATIC,
    inertial_parameters,
    stack_equations,
    transform_basis,
)
from surefoot.calibration.in_situ.solver.compress import CompressedSet


class Maker(NamedTuple):
    """Prior of the response: A = A_0 (1 + D), and the error of redundant channels beside it."""

    response: Matrix  # A_0 in counts per N and N m, shape (k, 6)
    std: Matrix  # deviations of the entries of D, shape (6, 6)
    beyond: float  # deviation of the part outside the space of A_0, as a share of its columns

    def errors(self, whitening: Matrix, inputs: int) -> Matrix:
        """Return D + 1 row by row by (W A row by row), shape (36, k inputs)."""
        inverse = np.linalg.pinv(self.response) @ np.linalg.inv(whitening)
        R = np.einsum("ic,jn->ijcn", inverse, np.eye(AXES, inputs))
        return np.asarray(R.reshape(AXES**2, -1))

    def rows(self, whitening: Matrix, inputs: int) -> tuple[Matrix, Vector]:
        """Return rows by (W A row by row), shape (m, k inputs), of deviation one, and their right side."""
        beside = np.linalg.svd(self.response)[0][:, AXES:].T @ np.linalg.inv(whitening)
        share = 1.0 / (self.beyond * np.linalg.norm(self.response, axis=0))
        more = np.einsum("bc,jn->bjcn", beside, share[:, None] * np.eye(AXES, inputs))
        rows = self.errors(whitening, inputs) / self.std.reshape(-1, 1)
        rows = np.concatenate([rows, more.reshape(-1, rows.shape[1])])
        right = np.zeros(len(rows))
        right[: AXES**2] = np.eye(AXES).ravel() / self.std.ravel()
        return rows, right


@dataclass(frozen=True, eq=False)
class Problem:
    """A least-squares problem in readings whitened by the noise, z = W r."""

    sets: tuple[CompressedSet, ...]  # J of them, compressed
    added: Matrix  # inertial parameters of the added masses, shape (J, p)
    basis: Matrix  # T_p, shape (p, 6, s) for s signals: w = sum_p phi_p T_p u
    moving: bool  # whether the signals are those of a moving limb
    temperature: bool  # whether the temperature is a signal that acts on the readings directly
    direct: int  # number of further signals that act on the readings directly, those of a cause
    rotation: bool  # whether the accelerometer's rotation is unknown
    maker: Maker | None  # prior of the response, or None
    limb: Vector  # expected inertial parameters, shape (p,); zero where nothing is known
    limb_root: Matrix  # rows that weigh phi - limb, shape (q, p)
    excess: Vector | None = None
    """Variances of readings that the maker's matrix and its limb leave, shape (k,); None without one."""
    gains: int = 0
    """Number of parameters behind the limb's that are gains of the axes with the temperature: 6 or 0."""
    changes: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 1, 1)))
    """Directions in which the added parameters may change, each with an unknown, shape (q, J, p)."""

    @cached_property
    def noise(self) -> Matrix:
        """Covariance of a sample's noise in counts^2, shape (k, k).

        It is shrunk towards its diagonal when there are few samples, and the diagonal towards what the
        maker's matrix leaves: a few poses may leave no residual, which does not mean that there is no noise.
        """
        scatter = np.sum([part.rr.T @ part.rr for part in self.sets], axis=0)
        freedom = sum(part.freedom for part in self.sets)
        spread = np.sum([part.ur.T @ part.ur for part in self.sets], axis=0)
        floor = _NOISE_FLOOR**2 * np.diag(spread) / sum(part.samples for part in self.sets)
        variance, k = np.diag(scatter) / max(freedom, 1), len(scatter)
        # It fades faster than the error of S: the diagonal depends on how the channels mix.
        share = k / (freedom + k) * _FEW / (freedom / k + _FEW)
        whole = np.sqrt(np.maximum(variance, np.finfo(float).tiny))
        correlation = (1.0 - share) * scatter / max(freedom, 1) / np.outer(whole, whole)
        correlation[np.diag_indices(k)] = 1.0
        if self.excess is not None:
            ratio = np.log(np.maximum(variance, floor) / np.maximum(self.excess, floor))
            level = np.exp(k * freedom / (k * freedom + _OF_MAKER) * np.mean(ratio))
            of_maker = _OF_MAKER / (freedom + _OF_MAKER)
            variance = (1.0 - of_maker) * variance + of_maker * level * self.excess
        root = np.sqrt(variance)
        return np.asarray(np.outer(root, root) * correlation + np.diag(floor))

    @cached_property
    def whitening(self) -> Matrix:
        """W, shape (k, k), of rows with noise of variance one: W Sigma W' = 1."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.noise)))

    @property
    def parameters(self) -> int:
        """Number p of inertial parameters."""
        return len(self.limb)

    @property
    def of_loads(self) -> slice:
        """Places of the parameters by which loads lag, behind the limb's; or empty."""
        return slice(MOVING if self.moving else STATIC, self.parameters)

    @property
    def motion(self) -> slice:
        """Places of the signals of gravity and motion."""
        return slice(0, len(transform_basis(self.moving)[0, 0]))

    @property
    def of_lags(self) -> slice:
        """Places of the loops of hysteresis in the signals; or empty."""
        behind = self.basis.shape[2]
        return slice(behind - AXES * self.hysteresis, behind)

    @property
    def loops(self) -> slice:
        """Places of the shares of the axes' hysteresis in the parameters; or empty."""
        return slice(self.of_loads.start + self.gains, self.parameters)

    @property
    def hysteresis(self) -> bool:
        """Whether hysteresis is part of the problem."""
        return bool(self.parameters > self.loops.start)

    @property
    def inputs(self) -> int:
        """Columns of the response: six, and one more for each signal that acts on the readings directly."""
        return AXES + self.temperature + self.direct

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
        """Rows of the maker's prior by (W A row by row), shape (m, k inputs), and their right side."""
        if self.maker is None:
            return np.zeros((0, len(self.whitening) * self.inputs)), np.zeros(0)
        return self.maker.rows(self.whitening, self.inputs)

    def unwhiten(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take the residual of the sets' rows, shape (J, n, k), back to counts and to the sets' own rows."""
        root = np.stack([part.unwhiten for part in self.sets])
        return np.asarray(root @ residual @ np.linalg.inv(self.whitening).T)

    @property
    def outer(self) -> int:
        """Number of outer unknowns: parameters, the rotation vector where it is unknown, and changes."""
        return self.parameters + 3 * self.rotation + len(self.changes)


_FEW = 10.0  # free samples a channel up to which their covariance is drawn to a diagonal one in earnest
_OF_MAKER = 6.0  # degrees of freedom that the noise by the maker's matrix counts as
_LEAST_MASS = 1e-3  # mass of a limb in kg that is taken at least
_NOISE_FLOOR = 1e-10  # noise counts as at least this share of a channel's spread: a simulation may have none


def problem_of(task: Task, parts: tuple[CompressedSet, ...], temperature: bool) -> Problem:
    """Return the least-squares problem of compressed sets, without a maker's prior."""
    limb, root = _limb_rows(task.limb, task.moving)
    problem = Problem(
        sets=parts,
        added=np.array(
            [inertial_parameters(one.added_mass, one.added_com, task.moving) for one in task.sets]
        ),
        basis=transform_basis(task.moving),
        moving=task.moving,
        temperature=temperature,
        direct=0,
        rotation=task.options.estimate_rotation,
        maker=None,
        limb=limb,
        limb_root=root,
    )
    if task.factory is None or task.mode == "free" or problem.rotation:
        return problem
    shown = weigh_limb(task.factory, problem, np.eye(3))
    if task.limb is None or task.limb.com is None:
        # Directions of the centre of mass that no torque shows stay within reach of a limb.
        reach = np.zeros((3, problem.parameters))
        longest = limits.LONGEST_ARM * max(abs(float(shown[MASS])), _LEAST_MASS)
        reach[:, MOMENT] = np.eye(3) / max(longest, float(np.linalg.norm(shown[MOMENT])))
        problem = replace(problem, limb_root=np.concatenate([root, reach]))
    return problem if task.moving else replace(problem, excess=_excess(problem, task.factory, shown))


def _excess(problem: Problem, factory: Matrix, limb: Vector) -> Vector:
    """Return the variances in counts^2, shape (k,), of what a maker's matrix and its limb leave."""
    response = np.linalg.pinv(factory)
    square, rows = np.zeros(factory.shape[1]), 0
    for part, added in zip(problem.sets, problem.added, strict=True):
        T = np.einsum("p,pws->ws", limb + added[:STATIC], transform_basis(moving=False))
        left = part.ur - part.uu[:, DIRECT] @ (response @ T).T
        square += np.sum(left**2, axis=0) + np.sum(part.rr**2, axis=0)
        rows += part.freedom + len(left)
    return np.asarray(square / max(rows - STATIC / AXES, 1.0))


def _limb_rows(known: KnownLimb | None, moving: bool) -> tuple[Vector, Matrix]:
    """Make the limb's expected inertial parameters, (p,), and rows that weigh them, (q, p)."""
    count = len(transform_basis(moving))
    if known is None:
        return np.zeros(count), np.zeros((0, count))
    com = np.zeros(3) if known.com is None else known.com
    expected = inertial_parameters(known.mass, com, moving)
    rows = np.zeros((1 if known.com is None else STATIC, count))
    rows[MASS, MASS] = 1.0 / known.mass_std
    if known.com is not None:
        # The first moment is com m: a mass that is off does not move the centre.
        rows[MOMENT, MOMENT] = np.eye(3) / (known.mass * known.com_std)
        rows[MOMENT, MASS] = -com / (known.mass * known.com_std)
    return expected, rows


_MULTIPLES, _TURNED_MULTIPLES = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0), (1.0, 10.0)
"""Masses to try, in units of the largest added mass; the second where each is tried with many turns."""


def starts(problem: Problem, factory: Matrix | None, known: Vector | None) -> list[Vector]:
    """Return outer unknowns to start from, shape (p,), or (p + 3,) where the rotation is unknown.

    A factory matrix, shape (6, k), and a known limb, shape (p,), give starts of their own.
    """
    found = [known] if known is not None else []
    if factory is not None and not problem.rotation:
        shown = weigh_limb(factory, problem, np.eye(3))
        # Where a matrix in other units shows a limb, no rank can be told.
        if np.linalg.norm(shown[MOMENT]) < limits.FARTHEST * abs(shown[MASS]):
            found.append(_pad(problem, shown))
    largest = float(np.max(problem.added[:, MASS]))
    if largest > 0.0:
        # Few and noisy samples shrink the paper's mass, but not its first moment, and a search that begins at
        # such a mass can end in a wrong place.
        enough = len(problem.sets) >= ENOUGH_MASSES
        first = _by_paper(problem) if enough else _pad(problem, [largest, 0.0, 0.0, 0.0])
        found.append(first)
        multiples = _TURNED_MULTIPLES if problem.rotation else _MULTIPLES
        found += [np.concatenate([[multiple * largest], first[MASS + 1 :]]) for multiple in multiples]
    found = [start for start in found if np.all(np.isfinite(start))]
    found = found or [_pad(problem, [1.0, 0.0, 0.0, 0.0])]
    if not problem.rotation:
        return found
    # The identity and the turns by right angles: the true one is near one of them.
    turns = [turn.as_rotvec() for turn in Rotation.create_group("O")]
    turned = [np.concatenate([start, turn]) for start in found for turn in turns]
    if factory is not None:
        matrices = [Rotation.from_rotvec(turn).as_matrix() for turn in turns]
        by_matrix = [_pad(problem, weigh_limb(factory, problem, matrix)) for matrix in matrices]
        turned = [np.concatenate(pair) for pair in zip(by_matrix, turns, strict=True)] + turned
    return turned


def weigh_hanging(
    matrix: Matrix, part: CompressedSet, rotation: Matrix, beside: Matrix | None = None
) -> Vector:
    """Return (m, m c) of all that hangs on the sensor in a set, shape (4,), by a known matrix C.

    ``beside`` is the response to the signals beside gravity, shape (k, s - 3), if it is known.
    """
    response: Matrix = part.response[:, DIRECT]
    turned = part.turned
    if beside is not None:
        turned = part.uu[:, DIRECT]
        left = part.ur - part.uu[:, DIRECT.stop :] @ beside.T
        response = np.asarray(np.linalg.lstsq(turned, left, rcond=None)[0].T)
    # By as much as gravity turned: the response to where it did not is noise.
    measured = matrix @ response @ turned.T
    basis = transform_basis(moving=False) @ rotation @ turned.T
    return np.asarray(np.linalg.lstsq(basis.reshape(STATIC, -1).T, measured.ravel(), rcond=None)[0])


def weigh_limb(matrix: Matrix, problem: Problem, rotation: Matrix) -> Vector:
    """Return (m, m c) of the limb that a matrix shows in the mean of all sets, shape (4,)."""
    seen = [weigh_hanging(matrix, part, rotation) for part in problem.sets]
    return np.asarray(np.mean(np.array(seen) - problem.added[:, :STATIC], axis=0))


def _by_paper(problem: Problem) -> Vector:
    """In-situ paper, Eqs. 18-24, on compressed rows, in which the noise is averaged: C r - T_b u = T_a u."""
    readings = [problem.whitening @ part.ur.T for part in problem.sets]
    left = np.linalg.svd(np.concatenate(readings, axis=1))[0][:, :AXES]
    loads = slice(0, problem.basis.shape[2])
    parts = [(part.uu[:, loads], one.T @ left) for part, one in zip(problem.sets, readings, strict=True)]
    rows, right = stack_equations(problem.basis, parts, problem.added)
    unit, size = of_unit_length(rows)
    solution = np.linalg.lstsq(unit, right, rcond=ROUNDING)[0] / size
    return np.asarray(solution[-problem.parameters :])


def _pad(problem: Problem, static: Sequence[float] | Vector) -> Vector:
    return np.concatenate([np.asarray(static), np.zeros(problem.parameters - STATIC)])
