r"""The covariance of an in-situ calibration, and of its noise.

With rows of variance one, :math:`z = J \theta + e`, the covariance is :math:`J^+ J^{+\prime}`. The rows are
free of drift, and weighted by what is left in them of hysteresis and of a limb that is not quite rigid
(:mod:`~surefoot.calibration.in_situ.colour`). It is raised or lowered as far as the sets disagree with each
other by more or less than that (Birge, 1932). A sensor with hysteresis has no one slope; what that leaves
open of its matrix comes on top.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import skew
from surefoot.calibration.in_situ.compress import CompressedSet, triangle
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.findings import Finding
from surefoot.calibration.in_situ.fit import FitColumns
from surefoot.calibration.in_situ.model import AXES, DIRECT, MASS, MOMENT, STATIC
from surefoot.calibration.in_situ.solve import (
    ROUNDING,
    Problem,
    Solution,
    loop_shares,
    of_unit_length,
    transforms,
)

__all__ = [
    "DataShare",
    "OpenErrors",
    "data_share",
    "fit_covariance",
    "output_derivatives",
    "pooled_noise",
    "slope_doubt",
    "slow_turn",
    "unknowns_root",
    "weighted_inverse",
    "whitening",
]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


_RAISES, _LOWERS = 4.0, 30.0
"""Free rows that must speak of the noise along a signal to count for as much as its spectrum: more of them
where they show less noise, since to be too sure is worse than to be too unsure. Loops in the fit take most of
the hysteresis at the motion's own frequency with them, and less of it elsewhere: the spectrum there is no
guide, and few rows suffice either way."""

_FEW = 10.0
"""Free samples a channel up to which their covariance is drawn to a diagonal one in earnest."""

_MOST_DOUBLINGS = 8
"""A swing is at least so many times half of the largest load of its kind: smaller loops are not followed."""

_KINDS = (slice(0, 3), slice(3, 6))
"""Forces and torques."""

_NOISE_FLOOR = 1e-10
"""Noise counts as at least this share of a channel's spread: a simulation may have none."""


class OpenErrors(NamedTuple):
    """Errors that are no noise, each with a deviation of one; c of them.

    Attributes:
        rows: By how much each moves the rows of the sets, whitened, shape (rows, c).
        offset: By how much each moves the last offset beside that, in counts, shape (k, c).
    """

    rows: Matrix
    offset: Matrix


def pooled_noise(sets: Sequence[CompressedSet]) -> Matrix:
    """Return the covariance of a sample's noise, shape (k, k); few samples bring it near to diagonal."""
    scatter = np.sum([part.rr.T @ part.rr for part in sets], axis=0)
    freedom = max(sum(part.freedom for part in sets), 1)
    S = scatter / freedom
    # It fades faster than the error of S: what is diagonal depends on how the channels mix.
    share = len(S) / (freedom + len(S)) * _FEW / (freedom / len(S) + _FEW)
    spread = np.sum([part.ur.T @ part.ur for part in sets], axis=0) / sum(part.samples for part in sets)
    diagonal = np.diag(np.diag(S))
    return np.asarray((1.0 - share) * S + share * diagonal + _NOISE_FLOOR**2 * np.diag(np.diag(spread)))


def whitening(sets: Sequence[CompressedSet]) -> Matrix:
    """Return W of the pooled noise, shape (k, k): W Sigma W' = 1."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(pooled_noise(sets))))


def disagreement(problem: Problem, solution: Solution) -> Vector:
    """Return by how much larger each signal's rows deviate than their noise says, shape (s,).

    At the frequency of the limb's motion no residual is left to show a spectrum: what noise there is along a
    signal shows in what one response leaves of the sets' own maps, as far as their rows are free.
    """
    left, _ = orthonormal(solution.jacobian)
    free = 1.0 - np.sum(left**2, axis=1)[: solution.residual.size].reshape(solution.residual.shape)
    used = np.array([np.diag(part.unwhiten) > 0.0 for part in problem.sets])
    shown = np.where(used, np.sum(solution.residual**2, axis=2), 0.0).sum(axis=0)
    rows = np.where(used, free.sum(axis=2), 0.0).sum(axis=0)
    loops = problem.hysteresis or problem.channel_lags > 0
    believed = np.where((shown > rows) | loops, _RAISES, _LOWERS)
    return np.asarray(np.sqrt((believed + shown) / (believed + rows)))


def orthonormal(columns: Matrix) -> tuple[Matrix, Matrix]:
    """Return an orthonormal basis of columns, shape (n, p), and X^+ by that basis, shape (p, p)."""
    unit, size = of_unit_length(columns)
    left, singular, right = np.linalg.svd(unit, full_matrices=False)
    seen = singular > ROUNDING * singular[0]
    left, singular, right = left[:, seen], singular[seen], right[seen]
    return left, right.T / singular / size[:, None]


def weighted_inverse(response: Matrix, noise: Matrix) -> Matrix:
    """Return C of least variance, (A' S^-1 A)^-1 A' S^-1, shape (6, k): C A = 1."""
    root = np.linalg.inv(np.linalg.cholesky(noise))
    return np.asarray(np.linalg.pinv(root @ response, rcond=ROUNDING) @ root)


def fit_covariance(
    problem: Problem, solution: Solution, noise: Matrix, beside: OpenErrors, root: Matrix
) -> Matrix:
    """Return the covariance of (C row by row, the last set's offset at its end, m, m c), (7 k + 4, 7 k + 4).

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
    covariance = root @ root.T
    last = problem.sets[-1]
    covariance[columns.offset, columns.offset] += noise * last.end.variance
    if problem.hysteresis or problem.channel_lags:
        of_matrix, of_offset = slope_doubt(problem, solution, noise)
        covariance[columns.matrix, columns.matrix] += of_matrix
        covariance[columns.offset, columns.offset] += of_offset
    return np.asarray(covariance)


def unknowns_root(problem: Problem, solution: Solution) -> Matrix:
    """Return a root of the covariance of (W A row by row, phi, rotation), shape (u, u)."""
    left, inverse = orthonormal(solution.jacobian)
    of_sets = left[: solution.residual.size].reshape(*solution.residual.shape, -1)
    of_sets = disagreement(problem, solution)[:, None, None] * of_sets
    rows = np.concatenate([of_sets.reshape(-1, left.shape[1]), left[solution.residual.size :]])
    return np.asarray(inverse @ triangle(rows).T)


def slope_doubt(problem: Problem, solution: Solution, noise: Matrix) -> tuple[Matrix, Matrix]:
    """Return covariances of C and o for want of one slope: an axis gives by s more for twice the swing."""
    A = solution.A
    C = weighted_inverse(A, noise)
    channels = len(A)
    last = problem.sets[-1]
    T = transforms(problem, solution)[:, :AXES]
    load = T[-1] @ last.end.signals
    loads = [part.source.signals @ t.T for part, t in zip(problem.sets, T, strict=True)]
    shares = loop_shares(problem, solution)
    if problem.hysteresis:
        doubts = shares * np.concatenate([_doublings([one[:, kind] for one in loads]) for kind in _KINDS])
        changes = [doubt * np.outer(A[:, a], np.eye(AXES)[a]) for a, doubt in enumerate(doubts)]
    else:
        doubts = shares * _doublings([one @ A.T for one in loads])
        changes = [doubt * np.outer(np.eye(channels)[c], A[c]) for c, doubt in enumerate(doubts)]
    of_matrix, of_offset = np.zeros((C.size, C.size)), np.zeros((channels, channels))
    for dA in changes:
        dC = (C @ dA @ C).ravel()
        of_matrix += np.outer(dC, dC)
        of_offset += np.outer(dA @ load, dA @ load)
    return of_matrix, of_offset


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
    C = weighted_inverse(A, noise)
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


_MOST = 0.9
"""Share of the information that the data give from which on the rest is not worth a word."""

_SLOW, _TURNED = 0.15, 0.02
"""A turn is slow if drift leaves less than the first share of its spread; one below the second share of
gravity's size is none."""

_UNKNOWN = 1e3
"""What nobody knows counts as known to so many times its size."""

_REACH = 0.1
"""Lever in m by which first moments are judged at least."""


@dataclass(frozen=True, eq=False)
class DataShare:
    """What the data know of a fit.

    Attributes:
        share: Of the information on each entry of the fit's covariance, shape (7 k + 4,), from 0 to 1.
        seen: Directions that the data alone know.
        unseen: Directions that they do not.
        left_open: What takes part in those, in words.
    """

    share: Vector
    seen: int
    unseen: int
    left_open: tuple[str, ...]

    def findings(self, columns: FitColumns) -> list[Finding]:
        """Return what leans on what was known beforehand, if much does."""
        known = {
            "the matrix": float(np.mean(self.share[columns.matrix])),
            "the limb's mass": float(self.share[columns.limb][MASS]),
            "its centre of mass": float(np.mean(self.share[columns.limb][MOMENT])),
        }
        if min(known.values()) > _MOST:
            return []
        listed = ", ".join(f"{share:.0%} of what is known of {name}" for name, share in known.items())
        reason = f"The readings alone give {listed}; the rest is what was known beforehand."
        return [Finding("share of the data", reason, value=min(known.values()), limit=_MOST, refuses=False)]


def data_share(problem: Problem, solution: Solution, noise: Matrix, tolerance: float) -> DataShare:
    """Return what the data know of a fit at its solution.

    Args:
        problem: With what was known beforehand.
        solution: Its solution.
        noise: Covariance of a sample, shape (k, k).
        tolerance: Deviation as a share of its size up to which a direction is seen.
    """
    channels, inputs = solution.response.shape
    of_data = sum(len(part.uu) for part in problem.sets) * channels
    scale = _sizes(problem, solution)
    J = solution.jacobian * scale
    data, prior = J[:of_data], J[of_data:]
    squares = data.T @ data
    asked = _find_answered(problem, channels, inputs, len(squares))
    values, vectors = np.linalg.eigh(_marginal(squares, asked))
    weak = values < (1.0 / tolerance) ** 2
    taking = np.zeros(len(squares), dtype=np.bool_)
    taking[asked] = np.sum(vectors[:, weak] ** 2, axis=1) > 0.5 / max(int(np.sum(weak)), 1) ** 2
    to_output = output_derivatives(problem, solution, noise) * scale
    to_output[:, : channels * inputs] = to_output[:, : channels * inputs] @ np.kron(
        np.linalg.inv(problem.whitening), np.eye(inputs)
    )
    alone = _variance(squares, to_output)
    known = _variance(squares + prior.T @ prior, to_output)
    last = problem.sets[-1]
    own = np.zeros(len(known))
    own[FitColumns.of(channels).offset] = np.diag(noise) * last.end.variance
    share = np.clip((known + own) / np.maximum(alone + own, np.finfo(float).tiny), 0.0, 1.0)
    return DataShare(share, int(np.sum(~weak)), int(np.sum(weak)), _names(taking, channels, inputs))


def _variance(squares: Matrix, outputs: Matrix) -> Vector:
    """Return the variances of outputs, shape (q, p), by the information on the unknowns, shape (p, p)."""
    values, vectors = np.linalg.eigh(squares)
    return np.asarray((outputs @ vectors) ** 2 @ (1.0 / (np.maximum(values, 0.0) + 1.0 / _UNKNOWN**2)))


def _find_answered(problem: Problem, channels: int, inputs: int, count: int) -> NDArray[np.bool_]:
    """Return which unknowns an answer holds: neither loops nor the limb's inertia, shape (count,)."""
    asked = np.ones(count, dtype=np.bool_)
    response, limb = np.split(asked, [channels * inputs])
    response.reshape(channels, inputs)[:, inputs - problem.channel_lags :] = False
    limb[STATIC : problem.parameters] = False
    return asked


def _marginal(squares: Matrix, asked: NDArray[np.bool_]) -> Matrix:
    """Return the information on some unknowns with the others integrated out, shape (q, q)."""
    own = squares[np.ix_(~asked, ~asked)]
    across = squares[np.ix_(~asked, asked)]
    rest = np.linalg.solve(own + np.eye(len(own)) / _UNKNOWN**2, across)
    return np.asarray(squares[np.ix_(asked, asked)] - across.T @ rest)


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
    wide = values > (_TURNED**2) * size
    root = vectors[:, wide] / np.sqrt(values[wide])
    shares, turned = np.linalg.eigh(root.T @ left @ root)
    if not len(shares) or shares[0] > _SLOW**2:
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
        _SLOW * spread,
        refuses=False,
    )


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


def _names(taking: NDArray[np.bool_], channels: int, inputs: int) -> tuple[str, ...]:
    response = taking[: channels * inputs].reshape(channels, inputs)
    limb = taking[channels * inputs :]
    named = {
        "the matrix": response[:, :AXES],
        "the limb's mass": limb[MASS],
        "its centre of mass": limb[MOMENT],
    }
    return tuple(name for name, parts in named.items() if parts.any())
