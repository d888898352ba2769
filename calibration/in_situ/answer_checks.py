"""Answers that are none: unseen axes, turns that are not told, priors that readings contradict; private."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from surefoot.calibration.in_situ.covariance import weighted_inverse
from surefoot.calibration.in_situ.fit import InSituFit
from surefoot.calibration.in_situ.model import STATIC
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
    "doubts_of_limb",
    "with_doubt_of_scale",
]

Matrix = NDArray[np.float64]

_CORRUPT = 0.3
"""A row of the factory matrix is looked at if its share of unexplained wrench is above this ..."""

_CORRUPT_RATIO = 3.0
"""... and above this multiple of the other rows'."""

_ALONE = 0.95
"""Share of a row's misfit that one entry alone must explain to be to blame."""

_MISPRINT = 0.7
"""... and share of the row's largest entry by which it must change: sensors age by less."""

_ONE_TURN = float(np.cos(np.radians(5.0)))
"""Rotations closer than this are one."""

_GAIN = (0.5, 2.0)
"""Between these a factory matrix must lie by the weight that it shows: sensors age by less."""

_FACTORY_STD = 0.1
"""Deviation of a factory matrix's scale, as a share."""

_SIGMAS = 4.0
"""Deviations between what the readings say of the limb and what was said of it that are worth a warning."""


def check_rotation(found: Sequence[Solution]) -> None:
    """Refuse an accelerometer whose turn is not told, as by masses that all hang in one plane."""
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
    """Refuse a fit that does not know how strong anything is."""
    mass, deviation = fit.limb.mass, fit.limb_mass_std
    if not (mass > 0.0 and deviation <= options.scale_tolerance * mass):
        raise CalibrationRefused(
            f"The limb's mass comes out as {mass:.3g} kg with a standard deviation of {deviation:.2g} kg, so "
            "the scale of all forces is as unsure.",
            "Add larger masses or at places further apart, record for longer, or say what the limb weighs.",
        )


def check_axes(fit: InSituFit, problem: Problem, solution: Solution, options: InSituOptions) -> None:
    """Refuse a matrix of which some axis was never seen, however well the limb's mass is known."""
    T = transforms(problem, solution.limb, solution.rotation)[:, :6]
    load = np.zeros(6)
    for part, t in zip(problem.sets, T, strict=True):
        mean = solve_triangular(part.bb, part.bu)[0] @ t.T
        load += np.sum((part.uu @ t.T) ** 2, axis=0) + part.samples * mean**2
    load = np.sqrt(load)
    channels = fit.matrix.shape[1]
    for axis, name in enumerate(FORCE_TORQUE_NAMES):
        row = slice(axis * channels, (axis + 1) * channels)
        spread = fit.response.T @ fit.covariance[row, row] @ fit.response
        doubt = float(np.sqrt(np.sum(np.diag(spread) * load**2))) / max(float(load[axis]), 1e-300)
        if not doubt < options.axis_tolerance:
            raise CalibrationRefused(
                f"The axis {name} is known to {doubt:.0%} of its load only.",
                f"Hang masses where they load {name} differently, check that all {channels} channels are "
                "connected, each once, or give a factory matrix.",
            )


def check_factory(factory: Matrix, problem: Problem, solution: Solution) -> None:
    """Refuse a factory matrix of which the sign, the unit or one entry alone contradicts the readings."""
    T = transforms(problem, solution.limb, solution.rotation)[:, :6]
    measured = np.concatenate([part.response[:, : T.shape[2]] for part in problem.sets], axis=1)
    expected = np.concatenate(list(T), axis=1)
    shown = factory @ measured
    wrong = expected - shown
    size = np.linalg.norm(wrong, axis=1) / np.linalg.norm(expected, axis=1)
    row = int(np.argmax(size))
    if size[row] >= max(_CORRUPT, _CORRUPT_RATIO * float(np.median(np.delete(size, row)))):
        _check_entry(factory, measured, wrong[row], row)
    gain = float(np.sum(shown[:3] * expected[:3]) / np.sum(expected[:3] ** 2))
    if not _GAIN[0] < gain < _GAIN[1]:
        raise CalibrationRefused(
            f"By the factory matrix the readings show {gain:.3g} times the forces that hang there.",
            "Check the sign of gravity (down; an accelerometer reads up), the units of the matrix (N and N m "
            "per count) and of the masses (kg).",
        )


def _check_entry(factory: Matrix, measured: Matrix, wrong: NDArray[np.float64], row: int) -> None:
    """Refuse a row in which one entry alone explains what the row leaves."""
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


def doubts_of_limb(known: KnownLimb, fit: InSituFit, alone: tuple[float, float] | None) -> tuple[str, ...]:
    """Say so where the readings alone give the limb another weight.

    Args:
        known: What was said of the limb.
        fit: What came out.
        alone: The limb's mass and its deviation without what was said, in kg; None if readings do not tell.
    """
    mass, deviation = (fit.limb.mass, 0.0) if alone is None else alone
    off = abs(mass - known.mass) / float(np.hypot(deviation, known.mass_std))
    if off < _SIGMAS:
        return ()
    return (
        f"The readings give the limb {mass:.3f} kg, and {known.mass:.3f} kg were said, {off:.0f} deviations "
        "apart: the added masses, their places or the limb's weight are not as stated.",
    )


def with_doubt_of_scale(fit: InSituFit) -> InSituFit:
    """Say of a fit whose scale is the factory's that factories are off: real sensors were by 11 and 19 %."""
    covariance, channels = fit.covariance.copy(), fit.matrix.shape[1]
    scale = _FACTORY_STD * fit.matrix.ravel()
    covariance[: scale.size, : scale.size] += np.outer(scale, scale)
    weight = _FACTORY_STD * np.concatenate([[fit.limb.mass], fit.limb.mass_com])
    covariance[7 * channels :, 7 * channels :] += np.outer(weight, weight)
    return replace(
        fit,
        covariance=covariance,
        warnings=(
            *fit.warnings,
            "The scale of all forces is the factory matrix's; weigh the limb to know it.",
        ),
    )


_STRAINED = 3.0
"""Sets that differ by less than this multiple of what noise does agree with each other."""

_CULPRIT = 0.2
"""A set is to blame if the others fit together at less than this share of the cost of all ..."""

_SLIGHT = 0.15
"""Share of the tolerance up to which no set is looked at by itself."""

_WEIGHED = 0.3
"""... and see it off by more than this share of the tolerance."""

_NO_MASS = 0.02
"""A mass in kg so small that its place means nothing."""

_REACH = 0.1
"""Lever in m by which moments of masses that all hang at one place are judged."""

_BELIEVABLE = 3.0
"""What follows from a fit this far off, in shares of the largest mass, says only that something is wrong."""


def check_masses(problem: Problem, solution: Solution, noise: Matrix, options: InSituOptions) -> None:
    """Refuse added masses that the readings contradict; name the set without which the others agree."""
    freedom = solution.residual.size - solution.jacobian.shape[1]
    strained = freedom > 0 and np.sum(solution.residual**2) >= _STRAINED * freedom
    if not strained or not np.any(problem.added[:, 0] > 0.0):
        return
    seen = _seen_masses(problem, solution, noise)
    off = _disagreement(problem, seen)
    if np.max(off) <= _SLIGHT * options.mass_tolerance:
        return
    names = [part.name for part in problem.sets]
    cure = "Weigh what was added and measure where it hung, or leave the set out."
    blamed = {}
    for j in range(len(names)):
        others = _without(problem, solution, j)
        if others is not None and others.cost < _CULPRIT * solution.cost:
            by_others = _seen_masses(problem, others, noise)
            blamed[j] = _disagreement(problem, by_others)[j], by_others[j]
    if blamed:
        # Of several sets without which the others agree, the one that would need the smallest change.
        j = min(blamed, key=lambda j: blamed[j][0])
        amount, follows = blamed[j]
        if _WEIGHED * options.mass_tolerance < amount < _BELIEVABLE:
            raise CalibrationRefused(
                f"The added mass of '{names[j]}' contradicts the other sets: {_place(problem.added[j])} was "
                f"given, and {_place(follows)} follows from the others.",
                cure,
            )
    if np.max(off) > options.mass_tolerance:
        j = int(np.argmax(off))
        follows = f", and {_place(seen[j])} follows from all sets together" if off[j] < _BELIEVABLE else ""
        raise CalibrationRefused(
            "The added masses contradict each other or the readings, most of all that of "
            f"'{names[j]}': {_place(problem.added[j])} was given{follows}.",
            cure,
        )


def _seen_masses(problem: Problem, solution: Solution, noise: Matrix) -> Matrix:
    """What was added to each set by the readings: (m, m c) in kg and kg m, shape (J, 4)."""
    matrix = weighted_inverse(solution.response[:, :6], noise)
    beside = (solution.response @ transforms(problem, solution.limb, solution.rotation))[..., 3:]
    total = [
        hanging(matrix, part, solution.rotation, rest)
        for part, rest in zip(problem.sets, beside, strict=True)
    ]
    return np.asarray(np.array(total) - solution.limb[:STATIC])


def _disagreement(problem: Problem, seen: Matrix) -> NDArray[np.float64]:
    """How far each set's mass and first moment are off, as shares of the largest mass and its reach, (J,)."""
    added = problem.added[:, :STATIC]
    off = np.abs(seen - added)
    mass = np.max(added[:, 0])
    moments = added[:, 1:] - np.mean(added[added[:, 0] > 0.0, 1:], axis=0) * (added[:, :1] > 0.0)
    reach = max(float(np.max(np.linalg.norm(moments, axis=1))), _REACH * mass)
    return np.asarray(np.maximum(off[:, 0] / mass, np.max(off[:, 1:], axis=1) / reach))


def _place(parameters: NDArray[np.float64]) -> str:
    mass = parameters[0]
    if abs(mass) < _NO_MASS:
        return f"{mass:.3f} kg"
    x, y, z = parameters[1:STATIC] / mass
    return f"{mass:.3f} kg at ({x:.3f}, {y:.3f}, {z:.3f}) m"


def _without(problem: Problem, solution: Solution, left_out: int) -> Solution | None:
    """Fit the other sets, if they determine all."""
    sets = tuple(part for i, part in enumerate(problem.sets) if i != left_out)
    others = replace(problem, sets=sets, added=np.delete(problem.added, left_out, axis=0))
    if not sets or (problem.prior_response is None and data_rank(others, solution.limb).missing):
        return None
    return solve(others, [solution.outer])


_RELATIVE = 1e-7
"""A direction is unseen if its singular value, for columns of unit length, is this share of the largest."""

_TAKES_PART = 1e-3
"""An unknown takes part in the unseen directions if its share of their square is above this."""

_CURES = {
    "its inertia": "Swing the limb faster about all axes, or leave the angular velocities out.",
    "the temperature's coefficients": "Leave the temperature out, or let it change within a set.",
}
"""For what masses at other places would not help."""

_PLACES = (
    "Put the masses at places that do not lie on one line, and change how much is added; or give a factory "
    "matrix to lean on."
)


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
        """Say what is missing and what would bring it (in-situ paper, Lemma 2)."""
        masses = len(np.unique(np.round(problem.added[:, :STATIC], 9), axis=0))
        unknowns = self.found + self.missing
        if masses < 3:
            return CalibrationRefused(
                f"Different added masses: {masses}, and three are needed to tell a matrix (Lemma 2); "
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
        """Say what leans on the factory matrix."""
        return (
            f"The data determine {self.found} of {self.found + self.missing} unknowns; the rest of "
            f"{', '.join(self.open_unknowns)} leans on the factory matrix."
        )


def data_rank(problem: Problem, limb: NDArray[np.float64]) -> DataRank:
    """Find the rank of the fit's Jacobian at a limb, without the factory matrix."""
    outer = np.concatenate([limb[: problem.parameters], np.full(3 * problem.rotation, 0.1)])
    J = expand(replace(problem, prior_response=None), outer).jacobian
    _, singular, right = np.linalg.svd(of_unit_length(J)[0], full_matrices=True)
    found = int(np.sum(singular > _RELATIVE * singular[0]))
    share = np.sum(right[found:] ** 2, axis=0)
    part = share > _TAKES_PART
    channels = len(problem.whitening)
    matrix = part[: channels * problem.inputs].reshape(channels, problem.inputs)
    rest = part[channels * problem.inputs :]
    named = {
        "the matrix": bool(matrix[:, :6].any()),
        "the temperature's coefficients": bool(matrix[:, 6:].any()),
        "the limb's mass": bool(rest[0]),
        "its centre of mass": bool(rest[1:STATIC].any()),
        "its inertia": problem.moving and bool(rest[STATIC:10].any()),
        "the hysteresis": bool(rest[10 if problem.moving else STATIC : problem.parameters].any()),
        "the accelerometer's rotation": bool(rest[problem.parameters :].any()),
    }
    return DataRank(found, J.shape[1] - found, tuple(name for name, taking in named.items() if taking))
