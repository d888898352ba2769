"""Checks of a fit's answer: what the data determine, and what contradicts them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.covariance import weighted_inverse
from surefoot.calibration.in_situ.fit import InSituFit
from surefoot.calibration.in_situ.model import (
    AXES,
    DIRECT,
    ENOUGH_MASSES,
    INERTIA,
    MASS,
    MOMENT,
    STATIC,
    different_masses,
)
from surefoot.calibration.in_situ.options import InSituOptions, KnownLimb
from surefoot.calibration.in_situ.solve import (
    Problem,
    Solution,
    expand,
    hanging,
    of_unit_length,
    solve,
    transforms,
)
from surefoot.calibration.layout import FORCE_TORQUE_NAMES
from surefoot.calibration.results import CalibrationRefused

__all__ = [
    "DataRank",
    "check_axes",
    "check_factory",
    "check_masses",
    "check_rotation",
    "check_scale",
    "data_rank",
    "limb_warnings",
    "with_factory_scale",
]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

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

_NO_LOAD = 1e-300
"""What stands for a load of zero in a quotient."""

_ONE_TURN = float(np.cos(np.radians(5.0)))
"""Cosine of the angle below which two rotations are one."""

_CORRUPT, _CORRUPT_RATIO = 0.3, 3.0
"""A row of the factory matrix is looked at if its share of unexplained wrench is above the first, and above
the second times the other rows'."""

_ALONE, _MISPRINT = 0.95, 0.7
"""One of its entries is to blame if it explains the first share of what the row leaves, and if it must change
by the second share of the row's largest entry: sensors age by less."""

_FACTORY_SCALE = (0.5, 2.0)
"""The weight that a factory matrix shows over the true one must lie between these: sensors age by less."""

_FACTORY_STD = 0.1
"""Deviation of a factory matrix's scale, as a share: real sensors were off by 11 and 19 %."""

_LET = 2.0
"""Deviations of the limb's mass by the data alone up to which they let a factory matrix draw it away."""

_SIGMAS = 4.0
"""Deviations between the limb by the readings and as it was given that are worth a warning."""

_STRAINED = 3.0
"""Sets whose squares are below this multiple of what noise explains agree with each other."""

_SLIGHT = 0.15
"""Share of the tolerance up to which no set is looked at by itself."""

_CULPRIT, _WEIGHED = 0.2, 0.3
"""A set is to blame if the others fit together at less than the first share of the cost of all, and see it
off by more than the second share of the tolerance."""

_BELIEVABLE = 3.0
"""What follows from a fit this far off, in shares of the largest mass, shows only that something is wrong."""

_NO_MASS = 0.02
"""A mass in kg so small that its place means nothing."""

_REACH = 0.1
"""Lever in m by which moments of masses that all hang at one place are judged."""


@dataclass(frozen=True)
class DataRank:
    """What the data, and what is known of the limb, determine without a factory matrix.

    Attributes:
        found: Number of directions that they determine.
        missing: Number that they leave open.
        open_unknowns: What takes part in those, in words.
    """

    found: int
    missing: int
    open_unknowns: tuple[str, ...]

    def refusal(self, problem: Problem) -> CalibrationRefused:
        """Return what is missing and what would bring it (in-situ paper, Lemma 2)."""
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

    def warning(self) -> str:
        """Return what leans on the factory matrix."""
        return (
            f"The data determine {self.found} of {self.found + self.missing} unknowns; the rest of "
            f"{', '.join(self.open_unknowns)} leans on the factory matrix."
        )


def data_rank(problem: Problem, limb: Vector) -> DataRank:
    """Return the rank of the fit's Jacobian at a limb, without the factory matrix."""
    outer = np.concatenate([limb[: problem.parameters], np.full(3 * problem.rotation, _SOME_TURN)])
    J = expand(replace(problem, prior_response=None), outer).jacobian
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


def check_rotation(found: Sequence[Solution]) -> None:
    """Raise CalibrationRefused if two rotations fit equally well, as for masses that hang in one plane."""
    best = found[0].rotation
    for other in found[1:]:
        cosine = (np.trace(best.T @ other.rotation) - 1.0) / 2.0
        if cosine < _ONE_TURN:
            raise CalibrationRefused(
                "Two rotations of the accelerometer, "
                f"{np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))):.0f} degrees apart, fit the readings "
                "equally well: added masses in one plane do not tell a sensor from its mirror image.",
                "Hang a mass off the plane of the others, or give a factory matrix.",
            )


def check_scale(fit: InSituFit, options: InSituOptions) -> None:
    """Raise CalibrationRefused if the limb's mass, and with it the scale of all forces, is unknown."""
    mass, deviation = fit.limb.mass, fit.limb_mass_std
    if not (mass > 0.0 and deviation <= options.scale_tolerance * mass):
        raise CalibrationRefused(
            f"The limb's mass comes out as {mass:.3g} kg with a standard deviation of {deviation:.2g} kg, so "
            "the scale of all forces is as unsure.",
            "Add larger masses or at places further apart, record for longer, or give the limb's mass.",
        )


def check_axes(fit: InSituFit, problem: Problem, solution: Solution, options: InSituOptions) -> None:
    """Raise CalibrationRefused if some axis was never seen, however well the limb's mass is known."""
    T = transforms(problem, solution)[:, :AXES]
    load = np.zeros(AXES)
    for part, t in zip(problem.sets, T, strict=True):
        mean = t @ part.mean
        load += np.sum((part.uu @ t.T) ** 2, axis=0) + part.samples * mean**2
    load = np.sqrt(load)
    channels = fit.matrix.shape[1]
    for axis, name in enumerate(FORCE_TORQUE_NAMES):
        row = fit.columns.row(axis)
        spread = fit.response.T @ fit.covariance[row, row] @ fit.response
        doubt = float(np.sqrt(np.sum(np.diag(spread) * load**2))) / max(float(load[axis]), _NO_LOAD)
        if not doubt < options.axis_tolerance:
            raise CalibrationRefused(
                f"The axis {name} is known to {doubt:.0%} of its load only.",
                f"Hang masses where they load {name} differently, check that all {channels} channels are "
                "connected, each once, or give a factory matrix.",
            )


def check_factory(factory: Matrix, problem: Problem, solution: Solution) -> None:
    """Raise CalibrationRefused if a factory matrix's sign, unit or one entry contradicts the readings."""
    T = transforms(problem, solution)[:, :AXES]
    measured = np.concatenate([part.response[:, : T.shape[2]] for part in problem.sets], axis=1)
    expected = np.concatenate(list(T), axis=1)
    shown = factory @ measured
    wrong = expected - shown
    size = np.linalg.norm(wrong, axis=1) / np.linalg.norm(expected, axis=1)
    row = int(np.argmax(size))
    if size[row] >= max(_CORRUPT, _CORRUPT_RATIO * float(np.median(np.delete(size, row)))):
        _check_entries(factory, measured, wrong[row], row)
    scale = float(np.sum(shown[:3] * expected[:3]) / np.sum(expected[:3] ** 2))
    if not _FACTORY_SCALE[0] < scale < _FACTORY_SCALE[1]:
        raise CalibrationRefused(
            f"By the factory matrix the readings show {scale:.3g} times the forces that hang there.",
            "Check the sign of gravity (down; an accelerometer reads up), the units of the matrix (N and N m "
            "per count) and of the masses (kg).",
        )


def _check_entries(factory: Matrix, measured: Matrix, wrong: Vector, row: int) -> None:
    """Raise CalibrationRefused if one entry of a row alone explains what the row leaves."""
    share = (measured @ wrong) ** 2 / (np.sum(measured**2, axis=1) * np.sum(wrong**2))
    column = int(np.argmax(share))
    step = float(measured[column] @ wrong / np.sum(measured[column] ** 2))
    if share[column] < _ALONE or abs(step) < _MISPRINT * np.max(np.abs(factory[row])):
        return
    raise CalibrationRefused(
        f"Entry [{row}, {column}] of the factory matrix, {factory[row, column]:.4g}, contradicts the "
        f"readings: with {factory[row, column] + step:.4g} in its place row {row} leaves "
        f"{1.0 - share[column]:.1%} of what it leaves now, and the other rows fit as they are.",
        "Compare the matrix with the maker's sheet, its signs and exponents first.",
    )


def check_masses(problem: Problem, solution: Solution, noise: Matrix, options: InSituOptions) -> None:
    """Raise CalibrationRefused if the readings contradict added masses; name the set if it is one."""
    freedom = solution.residual.size - solution.jacobian.shape[1]
    strained = freedom > 0 and np.sum(solution.residual**2) >= _STRAINED * freedom
    if not strained or not np.any(problem.added[:, MASS] > 0.0):
        return
    seen = _seen_masses(problem, solution, noise)
    off = _disagreement(problem, seen)
    if np.max(off) <= _SLIGHT * options.mass_tolerance:
        return
    cure = "Weigh what was added and measure where it hung, or leave the set out."
    # Of several sets without which the others agree, the one that would need the smallest change.
    amount, j, follows = min(
        _suspects(problem, solution, noise), key=lambda one: one[0], default=(0.0, 0, seen[0])
    )
    if _WEIGHED * options.mass_tolerance < amount < _BELIEVABLE:
        raise CalibrationRefused(
            f"The added mass of '{problem.sets[j].name}' contradicts the other sets: "
            f"{_place(problem.added[j])} was given, and {_place(follows)} follows from the others.",
            cure,
        )
    if np.max(off) > options.mass_tolerance:
        j = int(np.argmax(off))
        by_all = f", and {_place(seen[j])} follows from all sets together" if off[j] < _BELIEVABLE else ""
        raise CalibrationRefused(
            "The added masses contradict each other or the readings, most of all that of "
            f"'{problem.sets[j].name}': {_place(problem.added[j])} was given{by_all}.",
            cure,
        )


def _suspects(problem: Problem, solution: Solution, noise: Matrix) -> list[tuple[float, int, Vector]]:
    """Return sets without which the others agree: how far off they are, which, and (m, m c) by the others."""
    suspects = []
    for j in range(len(problem.sets)):
        others = _without(problem, solution, j)
        if others is not None and others.cost < _CULPRIT * solution.cost:
            by_others = _seen_masses(problem, others, noise)
            suspects.append((float(_disagreement(problem, by_others)[j]), j, by_others[j]))
    return suspects


def _without(problem: Problem, solution: Solution, left_out: int) -> Solution | None:
    """Return the fit of the other sets, if they determine all."""
    sets = tuple(part for i, part in enumerate(problem.sets) if i != left_out)
    others = replace(problem, sets=sets, added=np.delete(problem.added, left_out, axis=0))
    if not sets or (problem.prior_response is None and data_rank(others, solution.limb).missing):
        return None
    return solve(others, [solution.outer])


def _seen_masses(problem: Problem, solution: Solution, noise: Matrix) -> Matrix:
    """Return (m, m c) that was added to each set by the readings, in kg and kg m, shape (J, 4)."""
    matrix = weighted_inverse(solution.A, noise)
    beside = (solution.response @ transforms(problem, solution))[..., DIRECT.stop :]
    total = [
        hanging(matrix, part, solution.rotation, rest)
        for part, rest in zip(problem.sets, beside, strict=True)
    ]
    return np.asarray(np.array(total) - solution.limb[:STATIC])


def _disagreement(problem: Problem, seen: Matrix) -> Vector:
    """Return how far each set's (m, m c) is off, as shares of the largest mass and its lever, shape (J,)."""
    added = problem.added[:, :STATIC]
    off = np.abs(seen - added)
    mass = added[:, MASS]
    heaviest = np.max(mass)
    moments = added[:, MOMENT] - np.mean(added[mass > 0.0, MOMENT], axis=0) * (mass > 0.0)[:, None]
    reach = max(float(np.max(np.linalg.norm(moments, axis=1))), _REACH * heaviest)
    return np.asarray(np.maximum(off[:, MASS] / heaviest, np.max(off[:, MOMENT], axis=1) / reach))


def _place(parameters: Vector) -> str:
    mass = parameters[MASS]
    if abs(mass) < _NO_MASS:
        return f"{mass:.3f} kg"
    x, y, z = parameters[MOMENT] / mass
    return f"{mass:.3f} kg at ({x:.3f}, {y:.3f}, {z:.3f}) m"


def limb_warnings(known: KnownLimb, fit: InSituFit, alone: tuple[float, float] | None) -> tuple[str, ...]:
    """Return a warning if the readings alone give the limb another mass than was given.

    ``alone`` is the limb's mass and its deviation in kg by the readings; None if they do not determine it.
    """
    mass, deviation = (fit.limb.mass, 0.0) if alone is None else alone
    off = abs(mass - known.mass) / float(np.hypot(deviation, known.mass_std))
    if off < _SIGMAS:
        return ()
    return (
        f"By the readings the limb weighs {mass:.3f} kg, and {known.mass:.3f} kg were given, {off:.0f} "
        "deviations apart: the added masses, their places or the limb's mass are not as given.",
    )


def with_factory_scale(fit: InSituFit, of_data: float = 0.0) -> InSituFit:
    """Return a fit whose scale is the factory's with a covariance that doubts it, and a warning.

    ``of_data`` is the share of the information on the scale that the data give. What is off in the factory
    matrix by a common factor goes into the fit by the rest, but no further than the data let it.
    """
    covariance, columns = fit.covariance.copy(), fit.columns
    doubt = _FACTORY_STD * (1.0 - of_data)
    if of_data > 0.0:
        doubt = min(doubt, _LET * fit.limb_mass_std / (fit.limb.mass * float(np.sqrt(of_data))))
    scale = doubt * fit.matrix.ravel()
    covariance[columns.matrix, columns.matrix] += np.outer(scale, scale)
    weight = doubt * fit.limb.parameters[:STATIC]
    covariance[columns.limb, columns.limb] += np.outer(weight, weight)
    if of_data > 0.0:
        return replace(fit, covariance=covariance)
    warning = "The scale of all forces is the factory matrix's; weigh the limb to know it."
    return replace(fit, covariance=covariance, warnings=(*fit.warnings, warning))
