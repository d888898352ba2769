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

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import ROUNDING, of_unit_length
from surefoot.calibration.in_situ.data import Matrix, Task, Vector
from surefoot.calibration.in_situ.model import AXES
from surefoot.calibration.in_situ.solver.problem import Maker, Problem
from surefoot.calibration.in_situ.solver.solve import Solution, expand, minima, solve

_SHARES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
"""Sizes of a maker's errors that are tried, as shares of full scale."""

_SHARE, _SPREAD = 0.02, 1.0
"""Median of such a size and the deviation of its logarithm: sheets state 1 to 2 % (ATI: 1.25 to 2 %), old
sensors in robots' legs were off by 5 to 20 %."""

_CROSS = (0.3, 1.0)
"""Cross-talk's error over a gain's, both as shares of full scale: sheets state 0.5 to 2 % beside 1 %."""

_ARMS = (0.007, 0.3)
"""Torque's full scale over that of force in m: from a fingertip's (ATI Nano17) to a large robot's arm."""

_UNLIKE = 3.0  # factor by which full scales of one kind may differ from their mean

_BEYOND = 0.3  # deviation of redundant channels' readings of a load from the maker's matrix, as a share
COMMON = 0.05
"""Deviation of an error that all gains have in common, which is not learnt and does not move the fit: new
sensors are off by 1 %, two real ones that had aged in robots by 11 and 19 %."""

_NEGLIGIBLE = 1e-3  # weight below which a member of the grid is left out

AGED = 0.1
"""Deviation of a factory matrix by which causes are judged, as a share of full scale: sensors in robots were
off by 5 to 20 %."""

KEPT = 1e-6  # deviation of a matrix that is kept: no reading moves it


def prior_of(task: Task, noise: Matrix, share: float = 1.0) -> Maker | None:
    """Return the factory matrix as a prior; None where there is none.

    ``noise`` is the covariance of a sample, (k, k), ``share`` that of full scale by which the matrix may be
    off if nothing is stated.
    """
    if task.factory is None:
        return None
    off = np.broadcast_to(np.asarray(task.options.factory_std or share, dtype=np.float64), AXES)[:, None]
    scale = _full_scale(task.factory, noise, task.options.full_scale)
    response = np.asarray(np.linalg.pinv(task.factory), dtype=np.float64)
    return Maker(response, off * scale[:, None] / scale, _BEYOND)


def _full_scale(matrix: Matrix, noise: Matrix, given: Sequence[float] | None) -> Vector:
    """Return the full scales of the axes up to a common factor, shape (6,).

    Where no sheet states them in N and N m, (6,), the noise, (k, k), tells: of one sensor's axes it is about
    the same share of each full scale, whatever the unit of the channels and their mixture.
    """
    if given is not None:
        return np.asarray(given, dtype=np.float64)
    scale = np.sqrt(np.einsum("ik,kl,il->i", matrix, noise, matrix))
    of_kind = np.sqrt(np.mean(scale.reshape(2, 3) ** 2, axis=1))
    axes = np.clip(scale.reshape(2, 3) / of_kind[:, None], 1.0 / _UNLIKE, _UNLIKE)
    arm = float(np.clip(of_kind[1] / of_kind[0], *_ARMS))
    return np.asarray((axes * np.array([[1.0], [arm]])).ravel())


class Leaning(NamedTuple):
    """The fit by one size of the maker's errors, and how likely that size is."""

    weight: float  # its probability
    share: float  # of full scale; 0 without a maker
    solution: Solution  # of the problem with this prior


def log_evidence(solution: Solution) -> float:
    """Compute the log evidence of a problem by Laplace's method, up to a constant of all members."""
    unit, size = of_unit_length(solution.jacobian)
    singular = np.linalg.svd(unit, compute_uv=False)
    seen = singular > ROUNDING * singular[0]
    value = -solution.cost - float(np.sum(np.log(singular[seen]))) - float(np.sum(np.log(size)))
    if solution.problem.maker is not None:
        value -= float(np.sum(np.log(solution.problem.maker.std)))
    return value


def log_prior(share: float) -> float:
    """Return the logarithm of the density of a size of the maker's errors, up to a constant."""
    return -0.5 * float((np.log(share / _SHARE) / _SPREAD) ** 2)


def lean(problem: Problem, starts: Sequence[Vector], stated: bool) -> list[Leaning]:
    """Return the fits by all likely sizes of the maker's errors, the likeliest first.

    A size that is ``stated`` is that of the problem's prior, and not learnt.
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
            scores.append(log_evidence(solution) + log_prior(share))
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
