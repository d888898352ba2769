r"""The covariance of an in-situ calibration, and the share of it that its data determine.

With rows of variance one, :math:`z = J \theta + e`, the covariance is :math:`J^+ J^{+\prime}`. The rows are
free of drift, and weighted by the hysteresis and the bending of the limb that their residuals still have
(:mod:`~surefoot.calibration.in_situ.colour`). It is raised or lowered as far as the sets disagree with each
other by more or less than that (Birge, 1932). Each other error is a column beside that root, in the order of
the answer: (C row by row, the last set's offset at its end, m, m c).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import skew
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.fit import FitColumns
from surefoot.calibration.in_situ.linear import ROUNDING, orthonormal, triangle
from surefoot.calibration.in_situ.model import AXES, DIRECT, MASS, MOMENT, STATIC
from surefoot.calibration.in_situ.problem import Problem
from surefoot.calibration.in_situ.solve import Solution, loop_shares, transforms

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


_RAISES, _LOWERS = 4.0, 30.0
"""Free rows that must speak of the noise along a signal to count for as much as its spectrum: more of them
where they show less noise, since to be too sure is worse than to be too unsure. Loops in the fit take most of
the hysteresis at the motion's own frequency with them, and less of it elsewhere: the spectrum there is no
guide, and few rows suffice either way."""

_MOST_DOUBLINGS = 8
"""A swing is at least so many times half of the largest load of its kind: smaller loops are not followed."""

_KINDS = (slice(0, 3), slice(3, 6))
"""Forces and torques."""


class OpenErrors(NamedTuple):
    """Errors that are no noise, each with a deviation of one; c of them.

    Attributes:
        rows: By how much each moves the rows of the sets, whitened, shape (rows, c).
        offset: By how much each moves the last offset beside that, in counts, shape (k, c).
    """

    rows: Matrix
    offset: Matrix


def disagreement(problem: Problem, solution: Solution) -> Vector:
    """Return by how much larger each signal's rows deviate than their noise says, shape (s,).

    At the frequency of the limb's motion no residual is left to show a spectrum. The noise along a signal
    shows in the difference between one common response and the sets' own maps, as far as their rows are free.
    """
    left, _ = orthonormal(solution.jacobian)
    free = 1.0 - np.sum(left**2, axis=1)[: solution.residual.size].reshape(solution.residual.shape)
    used = np.array([np.diag(part.unwhiten) > 0.0 for part in problem.sets])
    shown = np.where(used, np.sum(solution.residual**2, axis=2), 0.0).sum(axis=0)
    rows = np.where(used, free.sum(axis=2), 0.0).sum(axis=0)
    believed = np.where((shown > rows) | problem.lags, _RAISES, _LOWERS)
    return np.asarray(np.sqrt((believed + shown) / (believed + rows)))


def invert_response(response: Matrix, noise: Matrix) -> Matrix:
    """Return C of least variance, (A' S^-1 A)^-1 A' S^-1, shape (6, k): C A = 1."""
    root = np.linalg.inv(np.linalg.cholesky(noise))
    return np.asarray(np.linalg.pinv(root @ response, rcond=ROUNDING) @ root)


def answer_of(problem: Problem, solution: Solution, noise: Matrix) -> Vector:
    """Return (C row by row, the last set's offset at its end, m, m c), shape (7 k + 4,)."""
    predicted = solution.response @ transforms(problem, solution)[-1]
    offset = problem.sets[-1].end.by(predicted)
    C = invert_response(solution.A, noise)
    return np.concatenate([C.ravel(), offset, solution.limb[:STATIC]])


def answer_root(
    problem: Problem, solution: Solution, noise: Matrix, beside: OpenErrors, root: Matrix
) -> Matrix:
    """Return a root of the covariance of the answer, shape (7 k + 4, c).

    Args:
        problem: The problem.
        solution: Its solution.
        noise: Covariance of a sample, shape (k, k).
        beside: Errors that are no noise.
        root: Of the covariance of the unknowns by noise and prior, as :func:`unknowns_root` returns it.
    """
    channels, inputs = solution.response.shape
    columns = FitColumns.of(channels)
    left, inverse = orthonormal(solution.jacobian)
    rows = np.pad(beside.rows, ((0, len(left) - len(beside.rows)), (0, 0)))
    root = np.concatenate([root, inverse @ (left.T @ rows)], axis=1)
    linear = channels * inputs
    # From W A to A, row by row.
    root[:linear] = np.kron(np.linalg.inv(problem.whitening), np.eye(inputs)) @ root[:linear]
    root = output_derivatives(problem, solution, noise) @ root
    root[columns.offset, -rows.shape[1] :] += beside.offset
    own = np.zeros((len(root), channels))
    own[columns.offset] = np.linalg.cholesky(noise) * np.sqrt(problem.sets[-1].end.variance)
    return np.concatenate([root, own], axis=1)


def unknowns_root(problem: Problem, solution: Solution) -> Matrix:
    """Return a root of the covariance of (W A row by row, phi, rotation), shape (u, u)."""
    left, inverse = orthonormal(solution.jacobian)
    of_sets = left[: solution.residual.size].reshape(*solution.residual.shape, -1)
    of_sets = disagreement(problem, solution)[:, None, None] * of_sets
    rows = np.concatenate([of_sets.reshape(-1, left.shape[1]), left[solution.residual.size :]])
    return np.asarray(inverse @ triangle(rows).T)


def slope_doubts(problem: Problem, solution: Solution, noise: Matrix) -> tuple[Matrix, Matrix]:
    """Return columns of C, (6 k, a), and of o, (k, a), for want of one slope of a sensor with hysteresis.

    An axis, or a channel, gives by its share of loops more for twice the swing, by that of creep in twice
    the time.
    """
    A = solution.A
    C = invert_response(A, noise)
    T = transforms(problem, solution)[:, :AXES]
    load = T[-1] @ problem.sets[-1].end.signals
    loads = [part.source.signals @ t.T for part, t in zip(problem.sets, T, strict=True)]
    if not problem.channel_lags:
        doublings = np.concatenate([_doublings([one[:, kind] for one in loads]) for kind in _KINDS])
        changes = np.einsum("ca,ab->acb", A, np.eye(AXES))
    else:
        doublings = _doublings([one @ A.T for one in loads])
        changes = np.einsum("ac,cb->acb", np.eye(len(A)), A)
    changes = (loop_shares(problem, solution) * doublings)[:, None, None] * changes
    return (C @ changes @ C).reshape(len(changes), -1).T, (changes @ load).T


def _doublings(loads: Sequence[Matrix]) -> Vector:
    """Return for how many doublings of the swing a slope is open, of loads of one kind, (n_j, a) a set.

    It is shown for the swing of the data. One slope is asked for at one size of forces, and one of torques,
    whichever way they point: the mean of the axes' swings, give or take a doubling. How the load came there
    from zero, where the offset is, and further loads of that size, take the slope of a swing as large.
    """
    swing = np.max([np.ptp(one, axis=0) for one in loads], axis=0) / 2.0
    reach = np.max([np.max(np.abs(one), axis=0) for one in loads], axis=0)
    smallest = np.maximum(swing, 0.5**_MOST_DOUBLINGS * np.max(reach))
    if not np.any(smallest > 0.0):
        return np.ones_like(swing)
    of_swing, of_reach = np.log2(smallest), np.log2(np.maximum(reach, smallest))
    return np.asarray(np.maximum(np.hypot(of_swing - np.mean(of_swing), 1.0), of_reach - of_swing))


def output_derivatives(problem: Problem, solution: Solution, noise: Matrix) -> Matrix:
    """Return d(C, o, m, m c) by d(A row by row, phi, rotation)."""
    A, channels = solution.A, len(solution.response)
    inputs, columns = problem.inputs, FitColumns.of(channels)
    of_phi = channels * inputs
    of_rotation = of_phi + problem.parameters
    C = invert_response(A, noise)
    steep = np.linalg.pinv(A.T @ np.linalg.solve(noise, A), hermitian=True)
    beyond = np.linalg.solve(noise, np.eye(channels) - A @ C)
    slopes = np.zeros((columns.limb.stop, of_phi + problem.outer))
    last = problem.sets[-1]
    lever = last.end.signals
    T = transforms(problem, solution)[-1]
    for i in range(channels):
        for a in range(inputs):
            column = i * inputs + a
            if a < AXES:
                dC = -np.outer(C[:, i], C[a]) + np.outer(steep[:, a], beyond[i])
                slopes[columns.matrix, column] = dC.ravel()
            slopes[columns.offset.start + i, column] = -(T @ lever)[a]
    signals = lever[: problem.basis.shape[2]].copy()
    signals[DIRECT] = solution.rotation @ signals[DIRECT]
    for p, of_parameter in enumerate(problem.basis):
        slopes[columns.offset, of_phi + p] = -A @ of_parameter @ signals
    if problem.rotation:
        M = np.einsum("p,pws->ws", solution.limb + problem.added[-1], problem.basis[..., DIRECT])
        for axis in range(3):
            turned = skew(np.eye(3)[axis]) @ signals[DIRECT]
            slopes[columns.offset, of_rotation + axis] = -A @ M @ turned
    slopes[columns.limb, of_phi : of_phi + STATIC] = np.eye(STATIC)
    return slopes


_UNKNOWN = 1e3
"""Prior deviation of an unknown, as a multiple of its size."""

_REACH = 0.1
"""Lever in m by which first moments are judged at least."""


@dataclass(frozen=True, eq=False)
class DataShare:
    """Share of a fit that the data determine.

    Attributes:
        share: Of the information on each entry of the fit's covariance, shape (7 k + 4,), from 0 to 1.
        seen: Directions that the data alone know.
        unseen: Directions that they do not.
    """

    share: Vector
    seen: int
    unseen: int

    def findings(self, columns: FitColumns) -> list[Finding]:
        """Warn if much leans on the prior."""
        known = {
            "the matrix": float(np.mean(self.share[columns.matrix])),
            "the limb's mass": float(self.share[columns.limb][MASS]),
            "its centre of mass": float(np.mean(self.share[columns.limb][MOMENT])),
        }
        least = min(known.values())
        if least > limits.KNOWN:
            return []
        listed = ", ".join(f"{share:.0%} of what is known of {name}" for name, share in known.items())
        reason = f"The readings alone give {listed}; the rest is what was known beforehand."
        return [Finding("share of the data", reason, value=least, limit=limits.KNOWN, refuses=False)]


def data_share(problem: Problem, solution: Solution, noise: Matrix) -> DataShare:
    """Split the information on a fit between data and prior.

    Args:
        problem: With its priors.
        solution: Its solution.
        noise: Covariance of a sample, shape (k, k).
    """
    channels, inputs = solution.response.shape
    linear = channels * inputs
    of_data = sum(len(part.uu) for part in problem.sets) * channels
    scale = _sizes(problem, solution)
    J = solution.jacobian * scale
    data, prior = J[:of_data], J[of_data:]
    squares = data.T @ data
    # Unknowns of the answer: neither loops nor the limb's inertia, which are integrated out.
    asked = np.ones(len(squares), dtype=np.bool_)
    asked[:linear].reshape(channels, inputs)[:, inputs - problem.channel_lags :] = False
    asked[linear + STATIC : linear + problem.parameters] = False
    own, across = squares[np.ix_(~asked, ~asked)], squares[np.ix_(~asked, asked)]
    rest = np.linalg.solve(own + np.eye(len(own)) / _UNKNOWN**2, across)
    weak = np.linalg.eigvalsh(squares[np.ix_(asked, asked)] - across.T @ rest) < 1.0 / limits.AXIS**2
    to_output = output_derivatives(problem, solution, noise) * scale
    to_output[:, :linear] = to_output[:, :linear] @ np.kron(np.linalg.inv(problem.whitening), np.eye(inputs))
    alone = _variance(squares, to_output)
    known = _variance(squares + prior.T @ prior, to_output)
    by_noise = np.zeros(len(known))
    by_noise[FitColumns.of(channels).offset] = np.diag(noise) * problem.sets[-1].end.variance
    share = np.clip((known + by_noise) / np.maximum(alone + by_noise, np.finfo(float).tiny), 0.0, 1.0)
    return DataShare(share, int(np.sum(~weak)), int(np.sum(weak)))


def _variance(squares: Matrix, outputs: Matrix) -> Vector:
    """Return the variances of outputs, shape (q, p), by the information on the unknowns, shape (p, p)."""
    values, vectors = np.linalg.eigh(squares)
    return np.asarray((outputs @ vectors) ** 2 @ (1.0 / (np.maximum(values, 0.0) + 1.0 / _UNKNOWN**2)))


def _sizes(problem: Problem, solution: Solution) -> Vector:
    """Return the sizes of the unknowns (W A row by row, phi, rotation)."""
    white = problem.whitening @ solution.response
    columns = np.sqrt(np.mean(white**2, axis=0))
    mass = abs(float(solution.limb[MASS]))
    reach = max(float(np.linalg.norm(solution.limb[MOMENT])) / max(mass, np.finfo(float).tiny), _REACH)
    limb = np.full(problem.outer, mass * reach**2)
    limb[MASS], limb[MOMENT] = mass, mass * reach
    limb[problem.of_loads] = 1.0
    limb[problem.parameters :] = 1.0
    return np.concatenate([np.tile(columns, len(white)), limb])


def slow_turn(sets: Sequence[InSituSet], parts: Sequence[CompressedSet]) -> Finding | None:
    """Return along which direction gravity turned no faster than offsets drift, and the cure; or None.

    The spread that the weights against drift leave is held against the spread that there was.
    """
    seen, left, size = np.zeros((3, 3)), np.zeros((3, 3)), 0.0
    for data, part in zip(sets, parts, strict=True):
        gravity = data.gravity[part.used]
        centred = gravity - gravity.mean(axis=0)
        seen += centred.T @ centred
        size += float(np.sum(gravity**2))
        left += part.uu[:, DIRECT].T @ part.uu[:, DIRECT]
    values, vectors = np.linalg.eigh(seen)
    wide = values > limits.STILL**2 * size
    root = vectors[:, wide] / np.sqrt(values[wide])
    shares, turned = np.linalg.eigh(root.T @ left @ root)
    if not len(shares) or shares[0] > limits.SLOW**2:
        return None
    direction = root @ turned[:, 0]
    direction /= np.linalg.norm(direction)
    spread = float(np.sqrt(direction @ seen @ direction / size))
    x, y, z = direction
    rest = spread * float(np.sqrt(max(shares[0], 0.0)))
    return Finding(
        "slow turning",
        f"Along ({x:.2f}, {y:.2f}, {z:.2f}) gravity turned no faster than the sensor's offset drifts: of a "
        f"spread of {spread:.2f} of its size such a drift leaves {rest:.3f}.",
        "Go through these postures several times in a set, or come back to the first ones at its end.",
        rest,
        limits.SLOW * spread,
        refuses=False,
    )
