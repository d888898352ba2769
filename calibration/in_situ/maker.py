r"""The maker's matrix as a prior: :math:`A = A_0 (1 + D)` with errors D of known or learnt size.

A sheet states errors as shares of full scale, and so does the prior: an axis i that reads a load on axis j
wrongly does so by :math:`D_{ij} \sim N(0, (s\, c_{ij}\, f_i / f_j)^2)`, where f are the full scales and c is
one on the diagonal. In these units counts, newtons and any mixture of them have one answer. Entries of D that
the readings do not show stay zero, and the matrix there the maker's.

How far off a maker's matrix is, s, and by how much less its cross-talk than its gains, is either stated
(``factory_std``) or averaged over a grid, each member with its evidence,

.. math:: \log p(r | s) = -\tfrac12 |\text{all rows}|^2 - \tfrac12 \log |J^\top J| + \tfrac12 \log |R^\top R|,

by Laplace's approximation, J being the Jacobian of all rows and R that of the prior's.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.calibration.arrays import ROUNDING, of_unit_length, skew
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.data import Matrix, Task, Vector
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.model import AXES, DIRECT, MASS, MOMENT, STATIC
from surefoot.calibration.in_situ.problem import Maker, Problem, weigh_hanging
from surefoot.calibration.in_situ.solve import Solution, expand, minima, solve
from surefoot.calibration.reference import GRAVITY

_SHARES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
"""Sizes of a maker's errors that are tried, as shares of full scale."""

_COARSE = (0.2, 0.05, 0.01)
"""The same where matrices are compared."""

_SHARE, _SPREAD = 0.02, 1.0
"""Median of such a size and the deviation of its logarithm: sheets state 1 to 2 % (ATI: 1.25 to 2 %), old
sensors in robots' legs were off by 5 to 20 %."""

_CROSS = (0.3, 1.0)
"""Cross-talk's error over a gain's, both as shares of full scale: sheets state 0.5 to 2 % beside 1 %."""

_ARMS = (0.007, 0.3)
"""Torque's full scale over that of force in m: from a fingertip's (ATI Nano17) to a large robot's arm."""

_UNLIKE = 3.0
"""Factor by which full scales of one kind may differ from their mean."""

_BEYOND = 0.3
"""Deviation of redundant channels' readings of a load from the maker's matrix, as a share."""

COMMON = 0.05
"""Deviation of an error that all gains have in common, which is not learnt and does not move the fit: new
sensors are off by 1 %, two real ones that had aged in robots by 11 and 19 %."""

_NEGLIGIBLE = 1e-3
"""Weight below which a member of the grid is left out."""

KEPT = 1e-6
"""Deviation of a matrix that is kept: no reading moves it."""


def prior_of(task: Task, noise: Matrix, share: float = 1.0) -> Maker | None:
    """Return the factory matrix as a prior; None where there is none.

    Args:
        task: With the factory matrix, and how far it may be off where that is stated.
        noise: Covariance of a sample, shape (k, k).
        share: Of full scale by which the matrix may be off if nothing is stated.
    """
    if task.factory is None:
        return None
    off = np.broadcast_to(np.asarray(task.options.factory_std or share, dtype=np.float64), AXES)[:, None]
    scale = _full_scale(task.factory, noise, task.options.full_scale)
    response = np.asarray(np.linalg.pinv(task.factory), dtype=np.float64)
    return Maker(response, off * scale[:, None] / scale, _BEYOND)


def _full_scale(matrix: Matrix, noise: Matrix, given: Sequence[float] | None) -> Vector:
    """Return the full scales of the axes up to a common factor, shape (6,).

    Where no sheet states them, the noise tells: of one sensor's axes it is about the same share of each full
    scale, whatever the unit of the channels and their mixture.

    Args:
        matrix: C of the maker in N and N m per count, or per newton, shape (6, k).
        noise: Covariance of a sample, shape (k, k).
        given: By the sheet in N and N m, shape (6,), or None.
    """
    if given is not None:
        return np.asarray(given, dtype=np.float64)
    scale = np.sqrt(np.einsum("ik,kl,il->i", matrix, noise, matrix))
    of_kind = np.sqrt(np.mean(scale.reshape(2, 3) ** 2, axis=1))
    axes = np.clip(scale.reshape(2, 3) / of_kind[:, None], 1.0 / _UNLIKE, _UNLIKE)
    arm = float(np.clip(of_kind[1] / of_kind[0], *_ARMS))
    return np.asarray((axes * np.array([[1.0], [arm]])).ravel())


class Leaning(NamedTuple):
    """The fit by one size of the maker's errors, and how likely that size is.

    Attributes:
        weight: Its probability.
        share: Of full scale; 0 without a maker.
        solution: Of the problem with this prior.
    """

    weight: float
    share: float
    solution: Solution


def _log_evidence(solution: Solution) -> float:
    """Compute the log evidence of a problem by Laplace's method, up to a constant of all members."""
    unit, size = of_unit_length(solution.jacobian)
    singular = np.linalg.svd(unit, compute_uv=False)
    seen = singular > ROUNDING * singular[0]
    value = -solution.cost - float(np.sum(np.log(singular[seen]))) - float(np.sum(np.log(size)))
    if solution.problem.maker is not None:
        value -= float(np.sum(np.log(solution.problem.maker.std)))
    return value


def _log_prior(share: float) -> float:
    """Return the logarithm of the density of a size of the maker's errors, up to a constant."""
    return -0.5 * float((np.log(share / _SHARE) / _SPREAD) ** 2)


def lean(problem: Problem, starts: Sequence[Vector], stated: bool) -> list[Leaning]:
    """Return the fits by all likely sizes of the maker's errors, the likeliest first.

    Args:
        problem: With a maker's prior, or without.
        starts: Outer unknowns to start from.
        stated: Whether the size of the errors is that of the problem's prior, rather than to be learnt.
    """
    start = minima(problem, starts)[0]
    if problem.maker is None or stated:
        return [Leaning(1.0, 0.0, start)]
    members, scores = [], []
    ratio = problem.maker.std / problem.maker.std[0, 0]
    for cross in _CROSS:
        talk = np.where(np.eye(AXES, dtype=bool), 1.0, cross)
        solution = start
        for share in _SHARES[::-1]:
            one = replace(problem, maker=problem.maker._replace(std=share * talk * ratio))
            solution = solve(one, [solution.outer])
            members.append(Leaning(0.0, share, solution))
            scores.append(_log_evidence(solution) + _log_prior(share))
    weight = np.exp(np.array(scores) - np.max(scores))
    weight /= np.sum(weight)
    kept = [one._replace(weight=float(w)) for one, w in zip(members, weight, strict=True) if w > _NEGLIGIBLE]
    return sorted(kept, key=lambda one: -one.weight)


def mean_of(members: Sequence[Leaning]) -> Solution:
    """Return the mean of the members' solutions, at the likeliest one's prior."""
    weight = np.array([one.weight for one in members])
    weight = weight / np.sum(weight)
    outer = sum(w * one.solution.outer for w, one in zip(weight, members, strict=True))
    response = sum(w * one.solution.response for w, one in zip(weight, members, strict=True))
    return expand(members[0].solution.problem, np.asarray(outer), np.asarray(response))


_REACH = 0.1
"""Lever in m by which moments of masses that all hang at one place are judged."""

_NO_LOAD = 1e-300
"""Stands for a load of zero in a quotient."""

_TRIED = 4
"""Ways to read a matrix, and entries, that are compared by their evidence."""

_OCCAM = float(np.log(36.0)) + 5.0
"""Nats that an entry's free value, and the choice of it, cost."""

_LOADED = 0.1
"""Share of the largest load, torques over the lever, from which on an axis shows that scale."""

_POUND = 0.45359237
"""In kg."""


def check_factory(factory: Matrix, problem: Problem, solution: Solution, determined: bool) -> list[Finding]:
    """Return whether a factory matrix contradicts the readings, and how it is to be read.

    Forces and torques (over the largest lever) that it shows of all sets, while gravity turned, are compared
    with the loads: by a solution without the matrix if the limb is determined or known, else by
    the limb that it shows itself. Where it misses much, other ways to read it are compared by the evidence of
    the readings, each with errors of all likely sizes. A scale that is nearer to another unit of the masses
    than to the expected one is a warning.

    Args:
        factory: As it was given, shape (6, k).
        problem: With the prior by it.
        solution: Without it, if the readings determine one.
        determined: Whether they do.
    """
    limb_known = determined or len(problem.limb_root) == STATIC
    expected = _loads(solution) if limb_known else _hangs(factory, solution)
    measured = np.concatenate([part.response[:, DIRECT] @ part.turned.T for part in problem.sets], axis=1)
    masses = problem.added[:, MASS]
    levers = np.linalg.norm(problem.added[masses > 0.0, MOMENT], axis=1) / masses[masses > 0.0]
    lever = max(float(np.max(levers, initial=0.0)), _REACH)
    weight = np.repeat([1.0, 1.0 / lever], 3)[:, None]

    def miss(matrix: Matrix) -> float:
        hangs = expected if limb_known else _hangs(matrix, solution)
        if hangs is None:
            return np.inf
        return float(np.linalg.norm(weight * (hangs - matrix @ measured)) / np.linalg.norm(weight * hangs))

    now = miss(factory)
    if now < limits.FACTORY_MISSES:
        return []
    start = solution.outer.copy()
    if not limb_known:
        start[: problem.parameters] = problem.limb
    tried = []
    for cost, ways in (
        (0.0, _other_readings(factory)),
        (_OCCAM, [] if expected is None else _other_entries(factory, measured, expected)),
        (_OCCAM, [] if expected is None else _other_point(factory, measured, expected)),
    ):
        scored = sorted(((miss(one), words, one) for words, one in ways), key=lambda way: way[0])
        for left, words, one in scored[:_TRIED]:
            if left < min(limits.READ_BETTER * now, 1.0):
                tried.append((_evidence_of(one, problem, solution.rotation, start) - cost, left, words))
    found = []
    base = _evidence_of(factory, problem, solution.rotation, start)
    best, left, words = max(tried, default=(-np.inf, now, ""))
    if best - base > limits.CLEARER:
        at_odds = f"misses {now:.0%} of what hangs there" if now < 1.0 else "contradicts what hangs there"
        reason = f"The factory matrix {at_odds}. Likeliest: {words}, which leaves {left:.0%}."
        cure = "Correct that, or compare the matrix with the maker's sheet, its signs and exponents first."
        found.append(Finding("factory matrix", reason, cure, best - base, limits.CLEARER))
    return found if expected is None else found + _check_units(factory @ measured, expected, weight)


def _check_units(shown: Matrix, expected: Matrix, weight: Matrix) -> list[Finding]:
    """Return whether loads that a matrix shows, shape (6, n), are those that hang there in another unit."""
    scale, common = _scale(shown, expected, weight)
    off = abs(float(np.log(max(scale, _NO_LOAD))))
    units = {words: force for words, (force, torque) in _OF_ROWS.items() if force == torque > 0.0}
    near = {words: abs(float(np.log(max(scale, _NO_LOAD) * factor))) for words, factor in units.items()}
    unit = min(near, key=near.__getitem__)
    nearer = common and near[unit] < off
    shows = f"By the factory matrix the readings show {scale:.3g} times the loads that hang there."
    if nearer:
        shows += f" Likeliest: {unit}, which leaves {scale * units[unit]:.3g} times."
    check = (
        "Check that it is this sensor's, the order of its channels, its units (N and N m per count) and "
        "those of the masses (kg)."
    )
    clearly = nearer and near[unit] < limits.OTHER_UNIT * off
    if clearly or off > limits.FACTORY_SCALE:
        return [Finding("factory scale", shows, check, scale, contradicts=not clearly)]
    return [Finding("factory scale", shows, check, scale, refuses=False)] if nearer else []


def _evidence_of(matrix: Matrix, problem: Problem, rotation: Matrix, start: Vector) -> float:
    """Return the evidence of another maker's matrix, shape (6, k), over sizes of its errors, as a logarithm.

    The search starts from outer unknowns, shape (p,), with the limb that the matrix shows.
    """
    assert problem.maker is not None
    outer = start.copy()
    outer[:STATIC] = _limb_by(matrix, problem, rotation)
    ratio = problem.maker.std / problem.maker.std[0, 0]
    response = np.asarray(np.linalg.pinv(matrix), dtype=np.float64)
    scores = []
    for share in _COARSE:
        one = replace(problem, maker=problem.maker._replace(response=response, std=share * ratio))
        fitted = solve(one, [outer])
        sound = fitted.limb[MASS] > 0.0
        outer = fitted.outer if sound else outer
        scores.append(_log_evidence(fitted) + _log_prior(share) if sound else -np.inf)
    return float(np.logaddexp.reduce(scores))


def _limb_by(matrix: Matrix, problem: Problem, rotation: Matrix) -> Vector:
    """Return (m, m c) of the limb that a matrix shows, shape (4,)."""
    seen = np.array([weigh_hanging(matrix, part, rotation) for part in problem.sets])
    return np.asarray(np.mean(seen - problem.added[:, :STATIC], axis=0))


def _scale(shown: Matrix, expected: Matrix, weight: Matrix) -> tuple[float, bool]:
    """Return the factor between loads that a matrix shows and those that hang there, and if axes share it.

    Axes age each by itself, and units change all alike: it is the geometric mean of the axes that are loaded
    (shape (6, n) each), or that of the forces where these axes differ by more than age.
    """
    load = np.sqrt(np.sum((weight * expected) ** 2, axis=1))
    loaded = load > _LOADED * np.max(load)
    of_axis = np.sum(shown * expected, axis=1)[loaded] / np.sum(expected**2, axis=1)[loaded]
    if np.min(of_axis) > np.max(of_axis) / limits.AXES_APART:
        return float(np.exp(np.mean(np.log(of_axis)))), True
    return float(np.sum(shown[:3] * expected[:3]) / np.sum(expected[:3] ** 2)), False


def _hangs(matrix: Matrix, solution: Solution) -> Matrix | None:
    """Return the loads of all sets with the limb that a matrix shows; None if its mass is negative."""
    outer = solution.outer.copy()
    outer[:STATIC] = _limb_by(matrix, solution.problem, solution.rotation)
    return None if outer[MASS] <= 0.0 else _loads(replace(solution, outer=outer))


def _loads(solution: Solution) -> Matrix:
    """Return the loads of all sets side by side, by as much as gravity turned in each, shape (6, 3 J)."""
    turned = (part.turned.T for part in solution.problem.sets)
    return np.concatenate([T[:, DIRECT] @ g for T, g in zip(solution.loads, turned, strict=True)], axis=1)


_OF_ROWS = {
    "the sign of gravity or of the factory matrix is turned": (-1.0, -1.0),
    "all places of the masses, or the factory's torques, are negated": (1.0, -1.0),
    "the factory's forces are negated": (-1.0, 1.0),
    "masses are in grams": (1e3, 1e3),
    "masses are in lb, and kg are expected": (1.0 / _POUND, 1.0 / _POUND),
    "masses in kg were taken for lb and converted": (_POUND, _POUND),
    "places are in mm, and m are expected": (1.0, 1e3),
    "places are in cm, and m are expected": (1.0, 1e2),
    "units of the factory's torques are N mm": (1.0, 1e-3),
    "units of the factory's torques are N cm": (1.0, 1e-2),
    "units of the factory matrix are kgf": (GRAVITY, GRAVITY),
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
    yield f"the factory's torques are about the point ({where}) m, not the sensor's origin", moved @ factory


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
    for turn in Rotation.create_group("O"):
        if turn.magnitude() > 0.0:
            about = np.round(turn.as_rotvec() / turn.magnitude(), 2).tolist()
            degrees = np.degrees(turn.magnitude())
            words = (
                f"the factory's frame is turned by {degrees:.0f} degrees about {about} against the sensor's"
            )
            yield words, np.kron(np.eye(2), turn.as_matrix()) @ factory
    yield "rows of the factory matrix are torques first", np.roll(factory, 3, axis=0)
    rows, channels = factory.shape
    if rows == channels:
        inverse = np.asarray(np.linalg.inv(factory), dtype=np.float64)
        yield "the factory matrix is transposed", factory.T
        yield "the factory matrix is inverted: counts per N", inverse
        yield "the factory matrix is inverted and transposed", inverse.T
    for a in range(channels):
        sign = np.where(np.arange(channels) == a, -1.0, 1.0)
        yield f"channel {a} has the other sign than in the factory matrix", factory * sign
        for b in range(a):
            order = np.arange(channels)
            order[[a, b]] = b, a
            yield f"channels {b} and {a} are exchanged against the factory matrix", factory[:, order]


def _other_entries(factory: Matrix, measured: Matrix, expected: Matrix) -> Iterator[tuple[str, Matrix]]:
    """Yield the matrix with another value in each entry that could be misprinted, and that, in words."""
    wrong = expected - factory @ measured
    steps = wrong @ measured.T / np.maximum(np.sum(measured**2, axis=1), _NO_LOAD)
    largest = np.max(np.abs(factory), axis=1, keepdims=True)
    for row, column in np.argwhere(np.abs(steps) >= limits.MISPRINT * largest):
        matrix = factory.copy()
        matrix[row, column] += steps[row, column]
        words = (
            f"entry [{row}, {column}] of the factory matrix, {factory[row, column]:.4g}, is "
            f"{matrix[row, column]:.4g}"
        )
        yield words, matrix
