r"""The maker's matrix as a prior: :math:`A = A_0 (1 + D)` with errors D of known or learnt size.

A sheet states errors as shares of full scale, and so does the prior: an axis i that reads a load on axis j
wrongly does so by :math:`D_{ij} \sim N(0, (s\, c_{ij}\, f_i / f_j)^2)`, where f are the full scales and c is
one on the diagonal. In these units counts, newtons and any mixture of them have one answer. What the readings
do not show of D stays zero, and the matrix the maker's.

How far off a maker's matrix is, s, and by how much less its cross-talk than its gains, is either stated
(``factory_std``) or averaged over a grid, each member with its evidence,

.. math:: \log p(r | s) = -\tfrac12 |\text{all rows}|^2 - \tfrac12 \log |J^\top J| + \tfrac12 \log |R^\top R|,

by Laplace's approximation, J being the Jacobian of all rows and R that of the prior's.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.model import AXES, MASS
from surefoot.calibration.in_situ.solve import (
    ROUNDING,
    Maker,
    Problem,
    Solution,
    expand,
    minima,
    of_unit_length,
    solve,
)

__all__ = ["COMMON", "KEPT", "Leaning", "full_scale", "lean", "maker_prior", "marginal_evidence", "mean_of"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

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
"""Deviation of what redundant channels read of a load beside what the maker's matrix says, as a share."""

COMMON = 0.05
"""Deviation of what all gains may have in common beside that, which neither is learnt nor moves the fit: new
sensors are off by 1 %, two real ones that had aged in robots by 11 and 19 %."""

_NEGLIGIBLE = 1e-3
"""Weight below which a member of the grid is left out."""

KEPT = 1e-6
"""Deviation of a matrix that is kept: no reading moves it."""


def full_scale(matrix: Matrix, noise: Matrix, given: Sequence[float] | None) -> Vector:
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


def maker_prior(matrix: Matrix, share: float | Sequence[float], scale: Vector) -> Maker:
    """Return the prior by a maker's matrix, shape (6, k), that is off by a share of full scale, (6,)."""
    off = np.broadcast_to(np.asarray(share, dtype=np.float64), AXES)[:, None]
    response = np.asarray(np.linalg.pinv(matrix), dtype=np.float64)
    return Maker(response, off * scale[:, None] / scale, _BEYOND)


class Leaning(NamedTuple):
    """The fit by one size of the maker's errors, and how likely that size is.

    Attributes:
        weight: Its probability.
        share: Of full scale; 0 without a maker.
        problem: The problem with this prior.
        solution: Its solution.
    """

    weight: float
    share: float
    problem: Problem
    solution: Solution


def evidence(problem: Problem, solution: Solution) -> float:
    """Return the logarithm of the evidence of a problem by Laplace, up to what all members share."""
    unit, size = of_unit_length(solution.jacobian)
    singular = np.linalg.svd(unit, compute_uv=False)
    seen = singular > ROUNDING * singular[0]
    value = -solution.cost - float(np.sum(np.log(singular[seen]))) - float(np.sum(np.log(size)))
    if problem.maker is not None:
        value -= float(np.sum(np.log(problem.maker.std)))
    return value


def marginal_evidence(problem: Problem, matrix: Matrix, start: Vector) -> float:
    """Return the logarithm of the evidence of another maker's matrix, shape (6, k), over sizes of its errors.

    Args:
        problem: With the prior by the matrix that was given.
        matrix: In its place, with errors of the same full scales.
        start: Outer unknowns to start from.
    """
    assert problem.maker is not None
    ratio = problem.maker.std / problem.maker.std[0, 0]
    response = np.asarray(np.linalg.pinv(matrix), dtype=np.float64)
    scores = []
    for share in _COARSE:
        one = replace(problem, maker=problem.maker._replace(response=response, std=share * ratio))
        solution = solve(one, [start])
        if solution.limb[MASS] > 0.0:
            start = solution.outer
        value = evidence(one, solution) - 0.5 * (np.log(share / _SHARE) / _SPREAD) ** 2
        scores.append(value if solution.limb[MASS] > 0.0 else -np.inf)
    return float(np.logaddexp.reduce(scores))


def lean(problem: Problem, starts: Sequence[Vector], stated: bool) -> list[Leaning]:
    """Return the fits by all likely sizes of the maker's errors, the likeliest first.

    Args:
        problem: With a maker's prior, or without.
        starts: Outer unknowns to start from.
        stated: Whether the size of the errors is that of the problem's prior, rather than to be learnt.
    """
    found = minima(problem, starts)
    if problem.maker is None or stated:
        return [Leaning(1.0, 0.0, problem, one) for one in found[:1]]
    members, scores, start = [], [], found[0].outer
    gain = np.diag(problem.maker.std)[0]
    ratio = problem.maker.std / gain
    for cross in _CROSS:
        talk = np.where(np.eye(AXES, dtype=bool), 1.0, cross)
        last = start
        for share in _SHARES[::-1]:
            one = replace(problem, maker=problem.maker._replace(std=share * talk * ratio))
            solution = solve(one, [last])
            last = solution.outer
            members.append(Leaning(0.0, share, one, solution))
            scores.append(evidence(one, solution) - 0.5 * (np.log(share / _SHARE) / _SPREAD) ** 2)
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
    return expand(members[0].problem, np.asarray(outer), np.asarray(response))
