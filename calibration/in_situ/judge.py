"""Checks between sets and of the answer: rank of the data, contradictions, absurd values."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from surefoot.calibration.arrays import of_unit_length
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.covariance import invert_response
from surefoot.calibration.in_situ.data import Matrix, Task, Vector
from surefoot.calibration.in_situ.fit import InSituFit
from surefoot.calibration.in_situ.model import (
    AXES,
    DIRECT,
    ENOUGH_MASSES,
    INERTIA,
    LEAST_LEVER,
    MASS,
    MOMENT,
    STATIC,
    different_masses,
)
from surefoot.calibration.in_situ.solver.problem import Problem, weigh_hanging
from surefoot.calibration.in_situ.solver.solve import Solution, expand
from surefoot.calibration.layout import FORCE_TORQUE_NAMES
from surefoot.calibration.results import CalibrationRefused, Finding

_UNSEEN = 1e-7
"""A direction is unseen if its singular value, for columns of unit length, is this share of the largest."""

_TAKES_PART = 1e-3
"""An unknown takes part in the unseen directions if its share of their square is above this."""

_SOME_TURN = 0.1
"""Rotation vector in rad, along each axis, at which the rank is judged: at zero it may be lower by chance."""

_CURES = {
    "its inertia": "Swing the limb faster about all axes, or leave the angular velocities out.",
    "the temperature's coefficients": "Leave the temperature out, or let it change within a set.",
}
"""For unknowns that masses at other places would not show."""

_PLACES = (
    "Put the masses at places that do not lie on one line, and change how much is added; or give a factory "
    "matrix to lean on."
)

_ONE_TURN = float(np.cos(np.radians(5.0)))  # cosine of the angle below which two rotations are one


DOUBTS = ("scale", "axis", "centre of mass", "gains")
"""Names of checks of the answer, which sets that contradict each other fail, and sets that are too few."""

_CHANCE = 0.01  # probability at which noise alone may strain a fit: masses must be off besides


@dataclass(frozen=True)
class DataRank:
    """Unknowns that the data and the limb's known values determine without a factory matrix."""

    found: int  # number of directions that they determine
    missing: int  # number that they leave open
    open_unknowns: tuple[str, ...]  # unknowns that take part in those, in words

    def refusal(self, problem: Problem) -> CalibrationRefused:
        """Say which unknowns are open and how to see them (in-situ paper, Lemma 2)."""
        masses = different_masses(problem.added[:, :STATIC])
        unknowns = self.found + self.missing
        if masses < ENOUGH_MASSES:
            return CalibrationRefused(
                f"Different added masses: {masses}, and three are needed to determine a matrix (Lemma 2); "
                f"{self.found} of {unknowns} unknowns follow from {len(problem.sets)} set(s).",
                "Add sets with other masses at other places, or give a factory matrix to lean on.",
            )
        cures = [cure for name, cure in _CURES.items() if name in self.open_unknowns]
        return CalibrationRefused(
            f"The {masses} different added masses determine {self.found} of {unknowns} unknowns; what stays "
            f"open: {', '.join(self.open_unknowns)}.",
            (cures or [_PLACES])[0],
        )

    def warning(self, owner: str) -> str:
        """Say which unknowns lean on the factory's or the driver's matrix."""
        return (
            f"The data determine {self.found} of {self.found + self.missing} unknowns; the rest of "
            f"{', '.join(self.open_unknowns)} leans on the {owner} matrix."
        )


def data_rank(problem: Problem, limb: Vector) -> DataRank:
    """Return the rank of the fit's Jacobian at a limb, without the factory matrix."""
    outer = np.concatenate([limb[: problem.parameters], np.full(3 * problem.rotation, _SOME_TURN)])
    J = expand(replace(problem, maker=None), outer).jacobian
    _, singular, right = np.linalg.svd(of_unit_length(J)[0], full_matrices=True)
    found = int(np.sum(singular > _UNSEEN * singular[0]))
    part = np.sum(right[found:] ** 2, axis=0) > _TAKES_PART
    channels = len(problem.whitening)
    response = part[: channels * problem.inputs].reshape(channels, problem.inputs)
    limb_part = part[channels * problem.inputs :]
    named = {
        "the matrix": response[:, :AXES],
        "the temperature's coefficients": response[:, AXES:],
        "the limb's mass": limb_part[MASS],
        "its centre of mass": limb_part[MOMENT],
        "its inertia": limb_part[INERTIA] if problem.moving else part[:0],
        "the hysteresis": limb_part[problem.loops],
        "the accelerometer's rotation": limb_part[problem.parameters :],
    }
    return DataRank(found, J.shape[1] - found, tuple(name for name, taking in named.items() if taking.any()))


def check_rotation(found: Sequence[Solution]) -> list[Finding]:
    """Return a finding if two rotations fit equally well, as for masses that hang in one plane."""
    best = found[0].rotation
    for other in found[1:]:
        cosine = (np.trace(best.T @ other.rotation) - 1.0) / 2.0
        if cosine < _ONE_TURN:
            angle = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
            reason = (
                f"Two rotations of the accelerometer, {angle:.0f} degrees apart, fit the readings equally "
                "well: added masses in one plane do not tell a sensor from its mirror image."
            )
            cure = "Hang a mass off the plane of the others, or give a factory matrix."
            return [Finding("rotation", reason, cure, angle)]
    return []


def check_scale(fit: InSituFit, heaviest: float, owner: str) -> list[Finding]:
    """Return a finding if the limb's mass, and with it the scale of all forces, is unknown.

    ``heaviest`` is the largest added mass in kg. The matrix of an ``owner``, if any, has a scale of its own.
    """
    mass, deviation = fit.limb.mass, fit.limb_mass_std
    if mass > 0.0 and deviation <= limits.SCALE * mass:
        return []
    share = deviation / abs(mass)
    if mass > 0.0 and owner:
        reason = f"The scale of all forces is the {owner}; weigh the limb to know it."
        return [Finding("scale", reason, value=share, limit=limits.SCALE, refuses=False)]
    reason = (
        f"The limb's mass comes out as {mass:.3g} kg with a standard deviation of {deviation:.2g} kg, so "
        "the scale of all forces is as unsure."
    )
    cure = "Add larger masses or at places further apart, record for longer, or give the limb's mass."
    if abs(mass) + deviation < limits.SCALE * heaviest:
        reason += (
            " The likeliest cause: the driver takes the limb's weight off already (a payload, gravity "
            "compensation)."
        )
        cure = "Log the sensor's own readings, with no payload set in the driver."
        return [Finding("scale", reason, cure, share, limits.SCALE)]
    return [Finding("scale", reason, cure, share, limits.SCALE, contradicts=True)]


def check_answer(fit: InSituFit, task: Task) -> Iterator[Finding]:
    """Check the answer against limbs and sensors that exist, however small the residual."""
    arm = float(np.linalg.norm(fit.limb.com))
    if not arm < limits.LONGEST_ARM:
        reason = f"The limb's centre of mass comes out {arm:.2g} m away from the sensor."
        cure = (
            "Check the units of torques and places (N mm, mm), the signs of the axes and the order of the "
            "channels."
        )
        yield Finding("centre of mass", reason, cure, arm, limits.LONGEST_ARM, contradicts=True)
    if task.factory is None:
        return
    gain = np.diag(task.factory @ fit.response)
    if not limits.LEAST_GAIN < np.min(gain) <= np.max(gain) < limits.LARGEST_GAIN:
        shown = ", ".join(f"{value:.2f}" for value in gain)
        reason = f"By the readings the sensor's axes give {shown} times what the {task.owner} matrix says."
        cure = "Check that it is this sensor's, its units, the signs of the axes and the limb's mass."
        off = float(np.max(np.abs(np.log(np.abs(gain)))))
        yield Finding("gains", reason, cure, off, contradicts=True)


def check_axes(fit: InSituFit, solution: Solution) -> Iterator[Finding]:
    """Yield which axes were never seen, however well the limb's mass is known."""
    square = np.zeros(AXES)
    for part, T in zip(solution.problem.sets, solution.loads, strict=True):
        square += np.sum((part.uu @ T.T) ** 2, axis=0) + part.samples * (T @ part.mean) ** 2
    for axis, name in enumerate(FORCE_TORQUE_NAMES):
        row = fit.columns.row(axis)
        spread = fit.response.T @ fit.covariance[row, row] @ fit.response
        doubt = float(np.sqrt(np.diag(spread) @ square / max(square[axis], np.finfo(float).tiny)))
        if not doubt < limits.AXIS:
            reason = f"The axis {name} is known to {doubt:.0%} of its load only."
            cure = (
                f"Hang masses where they load {name} differently, check that all {fit.matrix.shape[1]} "
                "channels are connected, each once, or give a factory matrix."
            )
            yield Finding("axis", reason, cure, doubt, limits.AXIS, contradicts=True)


def check_masses(solution: Solution) -> list[Finding]:
    """Check the added masses against the readings' response to gravity.

    Rates and loops bear hardly any weight, and take in whatever law of hysteresis the fit has not.
    """
    problem, by_gravity = solution.problem, solution.residual[:, DIRECT]
    used = solution.basis[0][: solution.residual.size].reshape(*solution.residual.shape, -1)[:, DIRECT]
    freedom = by_gravity.size - float(np.sum(used**2))
    left = float(np.sum(by_gravity**2))
    if freedom <= 0.5 or left <= float(chdtri(freedom, _CHANCE)) or not np.any(problem.added[:, MASS] > 0.0):
        return []
    off = float(np.max(_disagreement(problem, _measure_masses(solution))))
    reason = "The added masses contradict each other or the readings."
    if left < limits.STRAINED * freedom or off <= limits.MASS:
        reason = (
            f"The sets disagree {left / freedom:.1f} times as much as noise explains, and added masses "
            f"or places by up to {off:.1%} of the largest."
        )
    cure = "Weigh what was added and measure where it hung, or leave the set out."
    refuses = left >= limits.STRAINED * freedom and off > limits.MASS
    contradiction = Finding(
        "added masses",
        reason,
        cure,
        off,
        limits.MASS if refuses else limits.MASS_SEEN,
        refuses,
        contradicts=True,
    )
    return [contradiction] if refuses or off > limits.MASS_SEEN or left >= limits.STRAINED * freedom else []


def _measure_masses(solution: Solution) -> Matrix:
    """Measure the added (m, m c) of each set by the readings, in kg and kg m, shape (J, 4)."""
    matrix = invert_response(solution.A, solution.problem.noise)
    beside = solution.predicted[..., DIRECT.stop :]
    total = [
        weigh_hanging(matrix, part, solution.rotation, rest)
        for part, rest in zip(solution.problem.sets, beside, strict=True)
    ]
    return np.asarray(np.array(total) - solution.limb[:STATIC])


def _disagreement(problem: Problem, seen: Matrix) -> Vector:
    """Return how far each set's (m, m c) is off, as shares of the largest mass and its lever, shape (J,)."""
    added = problem.added[:, :STATIC]
    off = np.abs(seen - added)
    mass = added[:, MASS]
    heaviest = np.max(mass)
    moments = added[:, MOMENT] - np.mean(added[mass > 0.0, MOMENT], axis=0) * (mass > 0.0)[:, None]
    reach = max(float(np.max(np.linalg.norm(moments, axis=1))), LEAST_LEVER * heaviest)
    return np.asarray(np.maximum(off[:, MASS] / heaviest, np.max(off[:, MOMENT], axis=1) / reach))


def check_limb(
    task: Task, by_data: tuple[float, float] | None, by_maker: tuple[float, float] | None
) -> list[Finding]:
    """Return whether the readings give the limb another mass than was given.

    By the readings alone and with the factory matrix: mass and deviation in kg; None where not determined.
    """
    found, known = by_data or by_maker, task.limb
    if found is None or known is None:
        return []
    mass, deviation = found
    off = abs(mass - known.mass) / float(np.hypot(deviation, known.mass_std))
    if off < limits.LIMB_SIGMAS:
        return []
    blamed, limit = "the added masses, their places or the limb's mass are", limits.MASS
    if by_data is None:
        blamed, limit = f"the limb's mass or the scale of the {task.owner} matrix is", limits.FACTORY_APART
    reason = (
        f"By the readings the limb weighs {mass:.3f} kg, and {known.mass:.3f} kg were given, {off:.0f} "
        f"deviations apart: {blamed} not as given."
    )
    units = f"; check the units of the {task.owner} matrix" if task.owner else ""
    cure = f"Weigh all that hangs beyond the sensor, and nothing else{units}."
    apart = abs(float(np.log(mass / known.mass))) if mass > 0.0 else np.inf
    return [Finding("limb", reason, cure, apart, limit, refuses=apart > limit)]
