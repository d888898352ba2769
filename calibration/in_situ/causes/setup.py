"""Mistakes in the setup: wrong added masses or places, exchanged sets, wrong axes, or a rotated IMU."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import combinations, permutations, product
from operator import methodcaller

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.calibration.diagnosis import CLEARER, Mistake
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.causes.posed import Posed, fit_posed
from surefoot.calibration.in_situ.data import InSituSet, Matrix, Vector
from surefoot.calibration.in_situ.model import ENOUGH_MASSES, MASS, MOMENT, STATIC, inertial_parameters
from surefoot.calibration.in_situ.solver.problem import starts
from surefoot.calibration.in_situ.solver.solve import Solution, solve

_LIKELY = 2  # number of axis changes whose fit runs to convergence
_GLANCE = 8  # evaluations of the short fits that select them


@cache
def _turns() -> list[Rotation]:
    """Return the rotations by multiples of 90 degrees that are tried for the IMU, the smallest first."""
    return sorted(Rotation.create_group("O"), key=Rotation.magnitude)


_WEIGH = "weigh what was added and measure where it hung, or leave the set out"
_FRAME = "measure places in the sensor's frame, and give the IMU's rotation (R_sensor_accelerometer)"


def masses(posed: Posed, plain: Solution) -> Iterator[Mistake]:
    """Yield a growing scale, a wrong mass or place in one set, and a limb that changes between sets.

    Added masses are positive, below a maximum, and within reach. If the scale of a sensor grows from set to
    set, the limb and the added masses appear heavier by the same factor.
    """
    count, added = len(posed.sets), posed.problem.added
    if count > ENOUGH_MASSES:
        grows = (np.arange(count)[:, None] * (plain.limb + added))[None]
        cure = "let the sensor warm up, and check the supply of its amplifier"
        yield Mistake("scale", partial(_tell_scale, count), cure, methodcaller("free", grows), 1)
    for j, data in enumerate(posed.sets):
        if data.added_mass > 0.0:
            of_mass = np.zeros((1, *added.shape))
            of_mass[0, j] = added[j]
            yield _one_in(count, "mass", partial(_tell_mass, data), _WEIGH, of_mass)
            of_place = np.zeros((3, *added.shape))
            of_place[range(3), j, range(MOMENT.start, MOMENT.stop)] = data.added_mass
            yield _one_in(count, "place", partial(_tell_place, data), _WEIGH, of_place)
        if j:
            of_body = np.zeros((STATIC, *added.shape))
            of_body[range(STATIC), j:, range(STATIC)] = 1.0
            cure = "leave the limb and the driver's payload as they are in all sets"
            yield _one_in(count, "limb", partial(_tell_limb, data), cure, of_body)


def _one_in(count: int, kind: str, tell: Callable[[Solution], str], cure: str, changes: Matrix) -> Mistake:
    return Mistake(kind, tell, cure, methodcaller("free", changes), len(changes), count)


def _tell_scale(count: int, fit: Solution) -> str:
    change = float(fit.changes[0])
    if not limits.LEAST_GAIN < 1.0 + (count - 1) * change < limits.LARGEST_GAIN:
        return ""
    return f"the sensor's scale changes by {100.0 * change:+.1f} % from set to set"


def _tell_mass(data: InSituSet, fit: Solution) -> str:
    mass = data.added_mass * (1.0 + float(fit.changes[0]))
    if not 0.0 < mass < limits.HEAVIEST:
        return ""
    return f"the added mass of '{data.name}' is {mass:.3f} kg, and {data.added_mass:.3f} kg was given"


def _tell_place(data: InSituSet, fit: Solution) -> str:
    place = data.added_com + fit.changes
    if not float(np.linalg.norm(place)) < limits.LONGEST_ARM:
        return ""
    given = _place(data.added_com)
    return f"the added mass of '{data.name}' hangs at {_place(place)} m, and {given} was given"


def _tell_limb(data: InSituSet, fit: Solution) -> str:
    mass, place = float(fit.changes[0]), fit.changes[1:] / (float(fit.changes[0]) or 1.0)
    bears = min(fit.limb[MASS], fit.limb[MASS] + mass) > 0.0 and mass < limits.HEAVIEST
    if not bears or not float(np.linalg.norm(place)) < limits.LONGEST_ARM:
        return ""
    more = f"{abs(mass):.3f} kg {'more' if mass > 0.0 else 'less'} than was given hangs at {_place(place)} m"
    return f"from '{data.name}' on {more}: the limb is another, or a driver takes a payload off"


def _place(place: Vector) -> str:
    return "({:.3f}, {:.3f}, {:.3f})".format(*place)


def exchange(posed: Posed, plain: Solution) -> Iterator[Mistake]:
    """Yield, for each pair of sets, an exchange of their added masses."""
    added = posed.problem.added
    pairs = [(i, j) for i, j in combinations(range(len(added)), 2) if not np.allclose(added[i], added[j])]
    for i, j in pairs:
        order = np.arange(len(added))
        order[[i, j]] = j, i
        words = f"what was added in '{posed.sets[i].name}' and '{posed.sets[j].name}' is exchanged"
        undo = partial(_hang, added=added[order], start=plain.outer)
        yield Mistake("exchange", words, _WEIGH, undo, choices=len(pairs))


def _hang(posed: Posed, added: Matrix, start: Vector) -> Posed:
    """Return the problem with other added masses; its search starts anywhere."""
    problem = replace(posed.problem, added=added)
    return replace(posed, problem=problem, starts=(start, *starts(problem, None, None)))


def frames(posed: Posed, plain: Solution) -> Iterator[Mistake]:
    """Yield other axes of the places, and a rotated IMU.

    At rest, places only affect the torques m c x g, so negated places fit as well with a negated response to
    torques. The manufacturer's matrix resolves this ambiguity; without it both are tried.
    """
    if not np.any(posed.problem.added[:, MASS] > 0.0) or posed.problem.rotation:
        return
    glances = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=2)):
        axes = np.eye(3)[list(order)] * np.array([1.0, *signs])[:, None]
        # Each matrix is tried with its negative, fewest changes first. The identity is left out.
        pair = sorted((axes, -axes), key=lambda one: (-np.trace(one), -np.sum(one)))
        pair = [one for one in pair if not np.array_equal(one, np.eye(3))]
        changed = [_change_axes(posed, one, plain.outer) for one in pair]
        cost = min(solve(one.problem, one.starts[:1], _GLANCE).cost for one in changed)
        glances.append((cost, pair))
    for _, pair in sorted(glances, key=lambda one: one[0])[:_LIKELY]:
        for axes in _likelier(posed, pair, plain):
            words = (
                "axes of all places or of the IMU are others, or the IMU is turned: x, y, z as given are "
                f"{_name_axes(axes)}"
            )
            undo = partial(_change_axes, axes=axes, start=plain.outer)
            yield Mistake("axes", words, _FRAME, undo, choices=len(glances))
    cure = (
        "give its rotation (R_sensor_accelerometer), or let the fit find it: 'estimate_rotation', with the "
        "limb at rest"
    )
    # A rotation that is not small is an exchange of axes and a tilt.
    for turns in (_turns()[:1], _turns()[1:]):
        undo = partial(_turn, turns=turns, start=plain.outer)
        yield Mistake("rotation", _tell_turn, cure, undo, 3, len(turns))


def _likelier(posed: Posed, pair: Sequence[Matrix], plain: Solution) -> Sequence[Matrix]:
    """Return that of two axes that fit alike which is closer to the manufacturer's matrix, if it is known."""
    if posed.response is None or len(pair) == 1:
        return pair
    fits = [fit_posed(_change_axes(posed, axes, plain.outer)) for axes in pair]
    if abs(fits[0].evidence - fits[1].evidence) >= CLEARER:
        return pair
    off = [np.linalg.norm(posed.problem.whitening @ (fit.solution.A - posed.response)) for fit in fits]
    return [pair[int(np.argmin(off))]]


def _change_axes(posed: Posed, axes: Matrix, start: Vector) -> Posed:
    """Return the problem with all places in other axes."""
    plain = posed.problem
    added = [inertial_parameters(one.added_mass, axes @ one.added_com, plain.moving) for one in posed.sets]
    padded = np.pad(added, ((0, 0), (0, plain.parameters - len(added[0]))))
    return _hang(posed, padded, _turn_limb(start, axes))


def _turn_limb(outer: Vector, axes: Matrix) -> Vector:
    """Return the outer unknowns with the limb's first moment expressed in other axes."""
    turned = outer.copy()
    turned[MOMENT] = axes @ outer[MOMENT]
    return turned


def _turn(posed: Posed, turns: Sequence[Rotation], start: Vector) -> Posed:
    """Return the problem with a rotation of the IMU relative to the sensor, next to one of some turns."""
    begin = tuple(np.append(_turn_limb(start, one.as_matrix()), one.as_rotvec()) for one in turns)
    return replace(posed, problem=replace(posed.problem, rotation=True), starts=begin)


def _tell_turn(fit: Solution) -> str:
    angle = np.degrees(Rotation.from_matrix(fit.rotation).magnitude())
    return f"the IMU is turned by {angle:.0f} degrees against the sensor's frame"


def _name_axes(axes: Matrix) -> str:
    return ", ".join(("-" if np.sum(row) < 0.0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in axes)
