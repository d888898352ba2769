"""Added masses that the readings contradict; private."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ._covariance import weighted_inverse
from surefoot.calibration.in_situ._model import STATIC
from surefoot.calibration.in_situ._rank import data_rank
from surefoot.calibration.in_situ._solve import Problem, Solution, solve, transforms
from surefoot.calibration.in_situ._start import hanging
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.calibration.results import CalibrationRefused

__all__ = ["check_masses"]

Matrix = NDArray[np.float64]

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
