"""Test causes in the setup: wrong added masses or places, exchanged sets, wrong axes, or a rotated IMU."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.causes.evidence import Cause, Evidence
from surefoot.calibration.in_situ.data import Matrix, Vector
from surefoot.calibration.in_situ.model import (
    ENOUGH_MASSES,
    MASS,
    MOMENT,
    STATIC,
    inertial_parameters,
)
from surefoot.calibration.in_situ.solver.problem import Problem, starts
from surefoot.calibration.in_situ.solver.solve import Solution, deviance, minima, solve

_LIKELY = 2  # number of axis changes whose fit runs to convergence
_GLANCE = 8  # evaluations of the short fits that select them

_AS_GOOD = 0.1  # relative difference below which two costs count as equal

_WEIGH = "Weigh what was added and measure where it hung, or leave the set out."


def try_masses(evidence: Evidence) -> Iterator[Cause]:
    """Yield a growing scale, a wrong mass or place in one set, and a limb that changes between sets.

    Added masses are positive, below a maximum, and within reach. If the scale of a sensor grows from set to
    set, the limb and the added masses appear heavier by the same factor.
    """
    count, added = len(evidence.sets), evidence.problem.added
    if count > ENOUGH_MASSES:
        fit = evidence.change((np.arange(count)[:, None] * (evidence.solution.limb + added))[None])
        change = float(fit.changes[0])
        words = f"the sensor's scale changes by {100.0 * change:+.1f} % from set to set"
        cure = "Let the sensor warm up, and check the supply of its amplifier."
        if limits.LEAST_GAIN < 1.0 + (count - 1) * change < limits.LARGEST_GAIN:
            yield Cause(words, cure, fit, 1, 1)
    for j, data in enumerate(evidence.sets):
        given, at, name = data.added_mass, data.added_com, data.name
        if given > 0.0:
            of_mass = np.zeros((1, *added.shape))
            of_mass[0, j] = added[j]
            fit = evidence.change(of_mass)
            mass = given * (1.0 + float(fit.changes[0]))
            words = f"the added mass of '{name}' is {mass:.3f} kg, and {given:.3f} kg was given"
            if 0.0 < mass < limits.HEAVIEST:
                yield Cause(words, _WEIGH, fit, 1, count)
            of_place = np.zeros((3, *added.shape))
            of_place[range(3), j, range(MOMENT.start, MOMENT.stop)] = given
            fit = evidence.change(of_place)
            place = at + fit.changes
            words = f"the added mass of '{name}' hangs at {_place(place)} m, and {_place(at)} was given"
            if float(np.linalg.norm(place)) < limits.LONGEST_ARM:
                yield Cause(words, _WEIGH, fit, 3, count)
        if j:
            of_body = np.zeros((STATIC, *added.shape))
            of_body[range(STATIC), j:, range(STATIC)] = 1.0
            fit = evidence.change(of_body)
            mass, place = float(fit.changes[0]), fit.changes[1:] / (float(fit.changes[0]) or 1.0)
            side = "more" if mass > 0.0 else "less"
            more = f"{abs(mass):.3f} kg {side} than was given hangs at {_place(place)} m"
            words = f"from '{name}' on {more}: the limb is another, or a driver takes a payload off"
            bears = min(fit.limb[MASS], fit.limb[MASS] + mass) > 0.0 and mass < limits.HEAVIEST
            if bears and float(np.linalg.norm(place)) < limits.LONGEST_ARM:
                cure = "Leave the limb and the driver's payload as they are in all sets."
                yield Cause(words, cure, fit, 4, count)


def _place(place: Vector) -> str:
    return "({:.3f}, {:.3f}, {:.3f})".format(*place)


def try_exchange(evidence: Evidence) -> Iterator[Cause]:
    """Yield, for each pair of sets, an exchange of their added masses."""
    added = evidence.problem.added
    pairs = [(i, j) for i, j in combinations(range(len(added)), 2) if not np.allclose(added[i], added[j])]
    for i, j in pairs:
        order = np.arange(len(added))
        order[[i, j]] = j, i
        problem = replace(evidence.problem, added=added[order])
        best = minima(problem, [evidence.solution.outer, *starts(problem, None, None)])[0]
        words = f"what was added in '{evidence.sets[i].name}' and '{evidence.sets[j].name}' is exchanged"
        yield Cause(words, _WEIGH, best, 0, len(pairs))


def try_frame(evidence: Evidence) -> Iterator[Cause]:
    """Yield other axes of the places, and a rotated IMU if it fits clearly better.

    A permutation or a sign change of axes is likelier than a rotation by an arbitrary angle.
    """
    if not np.any(evidence.problem.added[:, MASS] > 0.0) or evidence.problem.rotation:
        return
    axes = list(try_axes(evidence))
    turn = _try_turn(evidence)
    best = min((cause.solution.cost for cause in axes), default=np.inf)
    yield from axes
    if best > (1.0 + _AS_GOOD) * turn.solution.cost:
        yield turn


def _turn_limb(outer: Vector, axes: Matrix) -> Vector:
    """Return the outer unknowns with the limb's first moment expressed in other axes."""
    turned = outer.copy()
    turned[MOMENT] = axes @ outer[MOMENT]
    return turned


def _try_turn(evidence: Evidence) -> Cause:
    """Return a rotation of the IMU relative to the sensor as a cause.

    If all masses are in one plane, a sensor and its mirror image fit equally well. The smallest rotation
    among the best fits is therefore returned.
    """
    outer, turns = evidence.solution.outer, Rotation.create_group("O")
    begin = [np.append(_turn_limb(outer, turn.as_matrix()), turn.as_rotvec()) for turn in turns]
    found = minima(replace(evidence.problem, rotation=True), begin)
    best = min(found, key=lambda one: Rotation.from_matrix(one.rotation).magnitude())
    angle = np.degrees(Rotation.from_matrix(best.rotation).magnitude())
    cure = (
        "Give its rotation (R_sensor_accelerometer), or let the fit find it: 'estimate_rotation', with the "
        "limb at rest."
    )
    return Cause(f"the IMU is turned by {angle:.0f} degrees against the sensor's frame", cure, best, 3, 1)


def try_axes(evidence: Evidence) -> Iterator[Cause]:
    """Yield axes of all places, or of the IMU, with other signs or in another order."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=2)):
        axes = np.eye(3)[list(order)] * np.array([1.0, *signs])[:, None]
        # Each matrix is tried with its negative, fewest changes first. The identity is left out.
        pair = sorted((axes, -axes), key=lambda one: (-np.trace(one), -np.sum(one)))
        pair = [one for one in pair if not np.array_equal(one, np.eye(3))]
        glances = (_change_axes(evidence, one) for one in pair)
        cost = min(solve(problem, [outer], _GLANCE).cost for problem, outer in glances)
        found.append((cost, pair))
    for _, pair in sorted(found, key=lambda one: one[0])[:_LIKELY]:
        words, best = _tell_signs(evidence, pair)
        cure = "Measure places in the sensor's frame, and give the IMU's rotation (R_sensor_accelerometer)."
        yield Cause(words, cure, best, 0, len(found))


def _change_axes(evidence: Evidence, axes: Matrix) -> tuple[Problem, Vector]:
    """Return the problem with all places in other axes, and the initial outer unknowns."""
    plain = evidence.problem
    added = [inertial_parameters(one.added_mass, axes @ one.added_com, plain.moving) for one in evidence.sets]
    problem = replace(plain, added=np.pad(added, ((0, 0), (0, plain.parameters - len(added[0])))))
    return problem, _turn_limb(evidence.solution.outer, axes)


def _tell_signs(evidence: Evidence, pair: Sequence[Matrix]) -> tuple[str, Solution]:
    """Fit axes and their negative, and describe the likelier ones.

    At rest, places only affect the torques m c x g, so negated places fit equally well with a negated
    response to torques. The manufacturer's matrix resolves this ambiguity, and so do the limb's place and its
    motion.

    Returns:
        The likelier axes in words, or both if they are equally likely, and the solution of the first.
    """
    fits = []
    for axes in pair:
        problem, outer = _change_axes(evidence, axes)
        fits.append(minima(problem, [outer, *starts(problem, None, None)])[0])
    odds = [-0.5 * deviance(one) for one in fits]
    alike = len(pair) > 1 and abs(odds[0] - odds[1]) < limits.CLEARER
    if evidence.response is not None and alike:
        off = [evidence.problem.whitening @ (one.A - evidence.response) for one in fits]
        odds = [-float(np.sum(one**2)) for one in off]
    likelier = int(np.argmax(odds))
    words = "axes of all places or of the IMU are others, or the IMU is turned: x, y, z as given are "
    if evidence.response is None and alike:
        more = f"; {_name_axes(pair[1])} fit as well, with all torques negated"
        return words + _name_axes(pair[0]) + more, fits[0]
    return words + _name_axes(pair[likelier]), fits[likelier]


def _name_axes(axes: Matrix) -> str:
    return ", ".join(("-" if np.sum(row) < 0.0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in axes)
