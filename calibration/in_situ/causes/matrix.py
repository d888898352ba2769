"""Ways to read a factory matrix that the readings contradict, ranked like all causes."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.calibration.arrays import skew
from surefoot.calibration.diagnosis import CLEARER, Experience, Fitted, Mistake, investigate
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.data import Matrix, Task, Vector
from surefoot.calibration.in_situ.judge import check_masses
from surefoot.calibration.in_situ.model import AXES, DIRECT, LEAST_LEVER, MASS, MOMENT, STATIC
from surefoot.calibration.in_situ.solver.maker import log_evidence, log_prior, prior_of
from surefoot.calibration.in_situ.solver.problem import Problem, starts, weigh_limb
from surefoot.calibration.in_situ.solver.solve import Solution, minima, solve
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.results import Finding

_ABSURD = -1e9  # log evidence of a matrix by which the limb has a negative mass
_TRIED = 4  # ways of each kind, those that miss least, that are fitted

_COARSE = (0.2, 0.05, 0.01, 0.002)
"""Sizes of a maker's errors by which matrices are compared, as shares of full scale."""

EXPERIENCE = Experience(unknown=0.1, mimicked=0.1, size=0.03, spread=1.2)
"""Matrices miss 1 to 10 % of the load on sensors that have aged; one read rightly misses no more."""

_SMALL_TURN = np.radians(0.5)  # rotation in rad below which no mounting is blamed: it moves loads by 1 %
_IN_PLANE = (
    1e-3  # share of the second direction below which gravity stayed in a plane, which has no mirror image
)

_POUND = 0.45359237  # in kg

_CURE = "correct that, or compare the matrix with the maker's sheet, its signs and exponents first"


def check_factory(task: Task, problem: Problem, determined: bool) -> list[Finding]:
    """Return whether a factory matrix contradicts the readings, and how it is to be read.

    The problem has no prior by the matrix. Without it, sets that contradict each other say nothing of it.
    """
    if task.factory is None:
        return []
    response = np.asarray(np.linalg.pinv(task.factory))
    # Masses in one plane leave a rotation and its mirror image: the matrix knows which.
    by_data = min(
        minima(problem, starts(problem, None, None)),
        key=lambda one: float(np.sum((problem.whitening @ (one.A - response)) ** 2)),
    )
    with_maker = replace(problem, maker=prior_of(task, problem.noise))
    found = _read_otherwise(task, with_maker, by_data, determined)
    if any(one.refuses for one in found) and determined:
        doubted = check_masses(by_data)
        found = doubted + found if any(one.refuses for one in doubted) else found
    return found


class _Comparison(NamedTuple):
    """Forces, and torques over the largest lever, that a matrix shows, against what hangs there."""

    solution: Solution  # without the matrix
    expected: Matrix | None  # loads by that, shape (6, 3 J), if it is determined or the limb known
    measured: Matrix  # readings, while gravity turned, shape (k, 3 J)
    weight: Matrix  # of forces and torques, shape (6, 1)

    @classmethod
    def of(cls, solution: Solution, known: bool) -> "_Comparison":
        """Compare by a solution without the matrix, or by the limb that each matrix shows itself."""
        problem = solution.problem
        measured = [part.response[:, DIRECT] @ part.turned.T for part in problem.sets]
        mass = problem.added[:, MASS]
        levers = np.linalg.norm(problem.added[mass > 0.0, MOMENT], axis=1) / mass[mass > 0.0]
        lever = max(float(np.max(levers, initial=0.0)), LEAST_LEVER)
        weight = np.repeat([1.0, 1.0 / lever], 3)[:, None]
        return cls(solution, _loads(solution) if known else None, np.concatenate(measured, axis=1), weight)

    def loads(self, matrix: Matrix) -> Matrix | None:
        """Return the loads that a matrix is held against; None if it shows a limb of negative mass."""
        return _hangs(matrix, self.solution) if self.expected is None else self.expected

    def miss(self, matrix: Matrix) -> float:
        """Return how much a matrix misses, as a share of the loads."""
        loads = self.loads(matrix)
        if loads is None:
            return np.inf
        off = self.weight * (loads - matrix @ self.measured)
        return float(np.linalg.norm(off) / np.linalg.norm(self.weight * loads))

    def ways(self, factory: Matrix) -> Iterator["_Way"]:
        """Yield other ways to read a matrix that misses much, or that a rotation improves clearly."""
        now, loads = self.miss(factory), self.loads(factory)
        gravity = np.concatenate([part.turned.T for part in self.solution.problem.sets], axis=1)
        known = None if self.expected is None else self.weight * self.expected
        if turn := _find_turn(self.weight * (factory @ self.measured), known, gravity):
            turned = _turn_frame(factory, turn)
            if now >= limits.FACTORY_MISSES or self.miss(turned[1]) < limits.READ_BETTER * now:
                yield _Way("rotation", 3, _tell_rotation(turn), [turned])
        if now >= limits.FACTORY_MISSES:
            yield _Way("reading", 0, _CURE, list(_other_readings(factory)))
            if loads is not None:
                yield _Way("entry", 1, _CURE, list(_other_entries(factory, self.measured, loads)))
                yield _Way("point", 3, _CURE, list(_other_point(factory, self.measured, loads)))


class _Way(NamedTuple):
    """Alternatives of one kind to read a matrix."""

    kind: str
    free: int  # unknowns of each
    cure: str
    others: list[tuple[str, Matrix]]  # in words, and the matrix as it then is


def _read_otherwise(task: Task, problem: Problem, solution: Solution, determined: bool) -> list[Finding]:
    """Compare a factory matrix with the readings, and with other ways to read it where it misses much.

    The problem has the prior by the matrix, the solution has not.
    """
    assert task.factory is not None
    factory, known = task.factory, determined or (task.limb is not None and task.limb.com is not None)
    compared, start = _Comparison.of(solution, known), solution.outer.copy()
    if not known:
        start[: problem.parameters] = problem.limb
    now, mistakes = compared.miss(factory), list[Mistake]()
    for kind, free, cure, others in compared.ways(factory):
        scored = sorted(
            ((compared.miss(matrix), words, matrix) for words, matrix in others), key=itemgetter(0)
        )
        for left, words, matrix in scored[:_TRIED]:
            if left < min(limits.READ_BETTER * now, 1.0):
                undo = partial(_read, matrix=matrix)
                mistakes.append(Mistake(kind, words.format(owner=task.owner), cure, undo, free, len(others)))
    if not mistakes:
        return []

    def fit(matrix: Matrix) -> Fitted:
        return Fitted(_evidence_of(matrix, problem, solution.rotation, start), compared.miss(matrix))

    found = investigate(factory, mistakes, fit, EXPERIENCE, sum(part.rows for part in problem.sets))
    if max(one.evidence for one in found.causes) < CLEARER:
        return []
    at_odds = f"misses {now:.0%} of what hangs there" if now < 1.0 else "contradicts what hangs there"
    finding = Finding("factory matrix", f"The {task.owner} matrix {at_odds}.", "", now, limits.MOVED)
    return [replace(found.explain(finding), refuses=now > limits.MOVED)]


def _read(_: Matrix, matrix: Matrix) -> Matrix:
    return matrix


def _find_turn(measured: Matrix, expected: Matrix | None, gravity: Matrix) -> Rotation | None:
    """Return the rotation that takes measured wrenches, shape (6, n), closest to loads (Kabsch, 1976).

    Loads are the expected ones, shape (6, n), or along gravity, shape (3, n), if no limb is known. None where
    a mirror image would be closer, or the rotation is small.
    """
    pairs = zip(np.split(measured, 2), np.split(expected, 2), strict=True) if expected is not None else ()
    square = sum((load @ read.T for read, load in pairs), np.zeros((3, 3)))
    if expected is None:
        square = gravity @ measured[:3].T
    left, size, right = np.linalg.svd(square)
    mirrors = np.linalg.det(left @ right) < 0.0
    if mirrors and size[2] > _IN_PLANE * size[1]:
        return None
    turn = Rotation.from_matrix(left @ np.diag([1.0, 1.0, -1.0 if mirrors else 1.0]) @ right)
    return turn if turn.magnitude() > _SMALL_TURN else None


def _turn_frame(factory: Matrix, turn: Rotation) -> tuple[str, Matrix]:
    """Return a turned frame in words, and the matrix as it then is."""
    about = ", ".join(f"{value:.2f}" for value in turn.as_rotvec() / turn.magnitude())
    degrees = np.degrees(turn.magnitude())
    words = (
        f"the {{owner}} frame is turned by {degrees:.3g} degrees about [{about}] against the frame of gravity"
    )
    return words, np.kron(np.eye(2), turn.as_matrix()) @ factory


def _tell_rotation(turn: Rotation) -> str:
    """Return advice that contains the rotation of gravity to the sensor's axes."""
    rows = ", ".join(f"[{', '.join(f'{value:.4f}' for value in row)}]" for row in turn.inv().as_matrix())
    return (
        f"give gravity in the sensor's axes: R_sensor_accelerometer = [{rows}], or estimate_rotation to fit "
        "it. Places of masses must be in the sensor's axes as well"
    )


def _evidence_of(matrix: Matrix, problem: Problem, rotation: Matrix, start: Vector) -> float:
    """Return the evidence of another maker's matrix, shape (6, k), over sizes of its errors, as a logarithm.

    The search starts from outer unknowns, shape (p,), with the limb that the matrix shows.
    """
    assert problem.maker is not None
    outer = start.copy()
    outer[:STATIC] = weigh_limb(matrix, problem, rotation)
    ratio = problem.maker.std / problem.maker.std[0, 0]
    response = np.asarray(np.linalg.pinv(matrix), dtype=np.float64)
    scores = []
    for share in _COARSE:
        one = replace(problem, maker=problem.maker._replace(response=response, std=share * ratio))
        fitted = solve(one, [outer])
        sound = fitted.limb[MASS] > 0.0
        outer = fitted.outer if sound else outer
        scores.append(log_evidence(fitted) + log_prior(share) if sound else -np.inf)
    return max(float(np.logaddexp.reduce(scores)), _ABSURD)


def _hangs(matrix: Matrix, solution: Solution) -> Matrix | None:
    """Return the loads of all sets with the limb that a matrix shows; None if its mass is negative."""
    outer = solution.outer.copy()
    outer[:STATIC] = weigh_limb(matrix, solution.problem, solution.rotation)
    return None if outer[MASS] <= 0.0 else _loads(replace(solution, outer=outer))


def _loads(solution: Solution) -> Matrix:
    """Return the loads of all sets side by side, by as much as gravity turned in each, shape (6, 3 J)."""
    turned = (part.turned.T for part in solution.problem.sets)
    return np.concatenate([T[:, DIRECT] @ g for T, g in zip(solution.loads, turned, strict=True)], axis=1)


_OF_ROWS = {
    "the sign of gravity or of the {owner} matrix is turned": (-1.0, -1.0),
    "all places of the masses, or the {owner} torques, are negated": (1.0, -1.0),
    "the {owner} forces are negated": (-1.0, 1.0),
    "masses are in grams": (1e3, 1e3),
    "masses are in lb, and kg are expected": (1.0 / _POUND, 1.0 / _POUND),
    "masses in kg were taken for lb and converted": (_POUND, _POUND),
    "places are in mm, and m are expected": (1.0, 1e3),
    "places are in cm, and m are expected": (1.0, 1e2),
    "units of the {owner} torques are N mm": (1.0, 1e-3),
    "units of the {owner} torques are N cm": (1.0, 1e-2),
    "units of the {owner} matrix are kgf": (GRAVITY, GRAVITY),
}
"""Possible errors of a matrix or of units, by the factors of its forces and of its torques."""


def _other_point(factory: Matrix, measured: Matrix, expected: Matrix) -> Iterator[tuple[str, Matrix]]:
    """Yield the point that torques of a matrix are about, if it is not the sensor's origin."""
    shown = factory @ measured
    arms = -skew(shown[:3].T).reshape(-1, 3)
    point = np.linalg.lstsq(arms, (expected[3:] - shown[3:]).T.ravel(), rcond=None)[0]
    moved = np.eye(AXES)
    moved[3:, :3] = skew(np.asarray(point, dtype=np.float64))
    where = ", ".join(f"{value:.3f}" for value in -point)
    yield f"the {{owner}} torques are about the point ({where}) m, not the sensor's origin", moved @ factory


def _other_readings(factory: Matrix) -> Iterator[tuple[str, Matrix]]:
    """Yield possible errors of a whole matrix or of units, and the matrix as it then is."""
    for words, factors in _OF_ROWS.items():
        yield words, np.repeat(factors, 3)[:, None] * factory
    for axis, name in enumerate("xyz"):
        mirror = np.where(np.isin(np.arange(AXES), (axis, axis + 3)), -1.0, 1.0)[:, None]
        yield (
            f"axis {name} of the sensor has the other sign, force and torque: a left-handed frame",
            mirror * factory,
        )
    yield "rows of the {owner} matrix are torques first", np.roll(factory, 3, axis=0)
    rows, channels = factory.shape
    if rows == channels:
        inverse = np.asarray(np.linalg.inv(factory), dtype=np.float64)
        yield "the {owner} matrix is transposed", factory.T
        yield "the {owner} matrix is inverted: counts per N", inverse
        yield "the {owner} matrix is inverted and transposed", inverse.T
    for a in range(channels):
        sign = np.where(np.arange(channels) == a, -1.0, 1.0)
        yield f"channel {a} has the other sign than in the {{owner}} matrix", factory * sign
        for b in range(a):
            order = np.arange(channels)
            order[[a, b]] = b, a
            yield f"channels {b} and {a} are exchanged against the {{owner}} matrix", factory[:, order]


def _other_entries(factory: Matrix, measured: Matrix, expected: Matrix) -> Iterator[tuple[str, Matrix]]:
    """Yield the matrix with another value in each entry that could be misprinted, and that, in words."""
    wrong = expected - factory @ measured
    steps = wrong @ measured.T / np.maximum(np.sum(measured**2, axis=1), np.finfo(float).tiny)
    largest = np.max(np.abs(factory), axis=1, keepdims=True)
    for row, column in np.argwhere(np.abs(steps) >= limits.MISPRINT * largest):
        matrix = factory.copy()
        matrix[row, column] += steps[row, column]
        words = (
            f"entry [{row}, {column}] of the {{owner}} matrix, {factory[row, column]:.4g}, is "
            f"{matrix[row, column]:.4g}"
        )
        yield words, matrix
