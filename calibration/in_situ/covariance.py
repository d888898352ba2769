r"""The covariance of an in-situ calibration, and the share of it that its data determine.

With rows of variance one, :math:`z = J \theta + e`, the covariance is :math:`J^+ J^{+\prime}`. The rows are
free of drift, and weighted by the hysteresis and the bending of the limb that their residuals still have
(:mod:`~surefoot.calibration.in_situ.solver.colour`). It is raised or lowered as far as the sets disagree with
each other by more or less than that (Birge, 1932). Each other error is a column beside that root, in the
order of the answer: (C row by row, the last set's offset at its end, m, m c).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import ROUNDING, skew, triangle
from surefoot.calibration.in_situ import limits
from surefoot.calibration.in_situ.data import InSituSet, Matrix, Vector
from surefoot.calibration.in_situ.fit import FitColumns
from surefoot.calibration.in_situ.model import AXES, DIRECT, LEAST_LEVER, MASS, MOMENT, STATIC
from surefoot.calibration.in_situ.solver.compress import CompressedSet
from surefoot.calibration.in_situ.solver.solve import Solution
from surefoot.calibration.results import Finding

_BELIEVED = 4.0  # free rows that must speak of the noise along a signal to count for as much as its spectrum
_MOST_DOUBLINGS = 8
"""A swing is at least so many times half of the largest load of its kind: smaller loops are not followed."""

_OTHER_LAW = 0.25
"""Share of fitted loops by which another law may give more for twice the swing: without it, the squared error
of a leg with Dahl's or Bouc and Wen's friction is 2.2 times the covariance (benchmarks/in_situ.py raster)."""

UNIFORM = 12.0**-0.5  # deviation of what lies anywhere in a span, as a share of it
_KINDS = [slice(0, 3), slice(3, 6)]  # forces and torques


class OpenErrors(NamedTuple):
    """Errors that are no noise, each with a deviation of one; c of them."""

    rows: Matrix  # by how much each moves the rows of the sets, whitened, shape (rows, c)
    offset: Matrix  # by how much each moves the last offset beside that, in counts, shape (k, c)


def disagreement(solution: Solution, beside: OpenErrors | None = None) -> Vector:
    """Return by which factor each signal's rows deviate more than their noise says, shape (s,).

    At the frequency of the limb's motion no residual is left to show a spectrum. The noise along a signal
    shows in the difference between one common response and the sets' own maps, as far as their rows are free.
    Errors that are no noise may have a part in it.
    """
    left, _ = solution.basis
    free = 1.0 - np.sum(left**2, axis=1)[: solution.residual.size].reshape(solution.residual.shape)
    used = np.array([np.diag(part.unwhiten) > 0.0 for part in solution.problem.sets])
    residual = solution.residual
    if beside is not None:
        along, size, _ = np.linalg.svd(solution.project(beside.rows)[: residual.size], full_matrices=False)
        part = along.T @ residual.ravel() * (1.0 - (1.0 + size**2) ** -0.5)
        residual = residual - (along @ part).reshape(residual.shape)
    shown = np.where(used, np.sum(residual**2, axis=2), 0.0).sum(axis=0)
    rows = np.where(used, free.sum(axis=2), 0.0).sum(axis=0)
    return np.asarray(np.sqrt((_BELIEVED + shown) / (_BELIEVED + rows)))


def invert_response(response: Matrix, noise: Matrix) -> Matrix:
    """Return C of least variance, (A' S^-1 A)^-1 A' S^-1, shape (6, k): C A = 1."""
    root = np.linalg.inv(np.linalg.cholesky(noise))
    return np.asarray(np.linalg.pinv(root @ response, rcond=ROUNDING) @ root)


def answer_of(solution: Solution) -> Vector:
    """Return (C row by row, the last set's offset at its end, m, m c), shape (7 k + 4,)."""
    C = invert_response(solution.A, solution.problem.noise)
    offset = solution.problem.sets[-1].end.by(solution.predicted[-1])
    return np.concatenate([C.ravel(), offset, solution.limb[:STATIC]])


def answer_root(solution: Solution, beside: OpenErrors, root: Matrix) -> Matrix:
    """Return a root of the covariance of the answer, (7 k + 4, c), with errors ``beside`` that are no noise.

    ``root`` is of the covariance of the unknowns by noise and prior (:func:`unknowns_root`).
    """
    problem = solution.problem
    columns = FitColumns.of(len(solution.A))
    left, inverse = solution.basis
    rows = np.pad(beside.rows, ((0, len(left) - len(beside.rows)), (0, 0)))
    root = np.concatenate([root, inverse @ (left.T @ rows)], axis=1)
    root = output_derivatives(solution) @ root
    root[columns.offset, -rows.shape[1] :] += beside.offset
    own = np.zeros((len(root), len(solution.A)))
    own[columns.offset] = np.linalg.cholesky(problem.noise) * np.sqrt(problem.sets[-1].end.variance)
    return np.concatenate([root, own], axis=1)


def unknowns_root(solution: Solution, beside: OpenErrors | None = None) -> Matrix:
    """Return a root of the covariance of (W A row by row, phi, rotation) by noise and prior, shape (u, u)."""
    left, inverse = solution.basis
    of_sets = left[: solution.residual.size].reshape(*solution.residual.shape, -1)
    of_sets = disagreement(solution, beside)[:, None, None] * of_sets
    rows = np.concatenate([of_sets.reshape(-1, left.shape[1]), left[solution.residual.size :]])
    return np.asarray(inverse @ triangle(rows).T)


def share_deviations(solution: Solution) -> Vector:
    """Return the deviations of the shares of hysteresis of each axis, shape (6,)."""
    of_phi = unknowns_root(solution)[solution.response.size :]
    return np.asarray(np.linalg.norm(of_phi[solution.problem.loops], axis=1))


def law_doubts(solution: Solution, hidden: float) -> OpenErrors:
    """Return the error by a law of hysteresis that the fit does not contain: larger swings give by more.

    Without fitted hysteresis it is one error, by a share that may be hidden: all axes are of one metal. With
    it, the law is not known by which each axis gives more; what loops leave beside it is in the residual.
    """
    problem, A = solution.problem, solution.A
    loads = [part.source.signals @ T.T for part, T in zip(problem.sets, solution.loads, strict=True)]
    swing = np.array([np.ptp(one, axis=0) for one in loads])
    largest = np.max(swing, axis=0) + np.finfo(float).tiny
    doublings = np.log2(np.maximum(swing / largest, 0.5**_MOST_DOUBLINGS))
    shares = (
        _OTHER_LAW * np.diag(np.abs(solution.shares)) if problem.hysteresis else np.full((AXES, 1), hidden)
    )
    felt = np.einsum("ca,ja,jas,ae->jcse", A, doublings, solution.loads, shares)
    inputs = felt.shape[2]
    rows = np.einsum("jns,jcse,dc->jnde", problem.signals[..., :inputs], felt, problem.whitening)
    offset = np.einsum("cse,s->ce", felt[-1], problem.sets[-1].end.signals[:inputs])
    return OpenErrors(rows.reshape(-1, shares.shape[1]), offset)


def slope_doubts(solution: Solution, hidden: float) -> tuple[Matrix, Matrix]:
    """Return columns of C, (6 k, 6), and of o, (k, 6), as the slope of a sensor with hysteresis is unsure.

    An axis gives by its share of loops, fitted or hidden, more for twice the swing. The law by which a fitted
    share is taken further is not known either. All axes are of one metal: one whose load hardly changed has
    at least the share of the others. The offset is the reading without load, from where the load came to
    its mean in the last set. Loops wider than that set's swing stay anywhere, by loads that were borne in the
    others, and one stroke reads all of a loop on one side, where many there and back cancel.
    """
    A, sets = solution.A, solution.problem.sets
    C = invert_response(A, solution.problem.noise)
    loads = [part.source.signals @ T.T for part, T in zip(sets, solution.loads, strict=True)]
    shares = np.full(AXES, hidden)
    if solution.problem.hysteresis:
        shares = np.maximum(np.abs(solution.shares), np.sqrt(np.mean(solution.shares**2)))
    doublings = np.concatenate([_doublings([one[:, kind] for one in loads]) for kind in _KINDS])
    widths = np.array([np.ptp(one, axis=0) for one in loads])
    strokes = np.sum(np.abs(np.diff(loads[-1], axis=0)), axis=0)
    strokes = np.maximum(strokes / np.maximum(widths[-1], np.finfo(float).tiny), 1.0)
    stored = UNIFORM * np.hypot(widths[-1] / strokes, np.ptp(widths, axis=0))
    of_offset = A * (shares * np.hypot(loads[-1].mean(axis=0) * doublings, stored))
    changes = np.einsum("ca,ab->acb", A * (shares * doublings), np.eye(AXES))
    return (C @ changes @ C).reshape(AXES, -1).T, of_offset


def _doublings(loads: Sequence[Matrix]) -> Vector:
    """Return for how many doublings of the swing a slope is open, of loads of one kind, (n_j, a) a set.

    It is shown for the swing of the data. One slope is asked for at one size of forces, and one of torques,
    whichever way they point: the mean of the axes' swings, give or take a doubling. Further loads of the size
    of the largest take the slope of a swing as large.
    """
    swing = np.max([np.ptp(one, axis=0) for one in loads], axis=0) / 2.0
    reach = np.max([np.max(np.abs(one), axis=0) for one in loads], axis=0)
    swing = np.maximum(swing, 0.5**_MOST_DOUBLINGS * np.max(reach) + np.finfo(float).tiny)
    swing, reach = np.log2(swing), np.log2(np.maximum(reach, swing))
    return np.asarray(np.maximum(np.hypot(swing - np.mean(swing), 1.0), reach - swing))


def output_derivatives(solution: Solution) -> Matrix:
    """Return d(C, o, m, m c) by d(W A row by row, phi, rotation), shape (7 k + 4, u)."""
    problem, A = solution.problem, solution.A
    (channels, inputs), columns = solution.response.shape, FitColumns.of(len(A))
    of_phi = channels * inputs
    C = invert_response(A, problem.noise)
    steep = np.linalg.pinv(A.T @ np.linalg.solve(problem.noise, A), hermitian=True)
    beyond = np.linalg.solve(problem.noise, np.eye(channels) - A @ C)
    lever = problem.sets[-1].end.signals
    slopes = np.zeros((columns.limb.stop, of_phi + problem.outer))
    of_response = slopes[:, :of_phi].reshape(-1, channels, inputs)
    dC = np.einsum("ja,il->jlia", steep, beyond) - np.einsum("ji,al->jlia", C, C)
    of_response[columns.matrix, :, :AXES] = dC.reshape(-1, channels, AXES)
    of_response[columns.offset] = -np.multiply.outer(np.eye(channels), solution.transforms[-1] @ lever)
    # From A to W A.
    slopes[:, :of_phi] = np.einsum("qka,kl->qla", of_response, np.linalg.inv(problem.whitening)).reshape(
        -1, of_phi
    )
    signals = lever[: problem.basis.shape[2]].copy()
    signals[DIRECT] = solution.rotation @ signals[DIRECT]
    slopes[columns.offset, of_phi : of_phi + problem.parameters] = -A @ (problem.basis @ signals).T
    if problem.rotation:
        M = np.einsum("p,pws->ws", solution.limb + problem.added[-1], problem.basis[..., DIRECT])
        # [e]x g = -[g]x e of a turn by e.
        slopes[columns.offset, of_phi + problem.parameters :] = A @ M @ skew(signals[DIRECT])
    slopes[columns.limb, of_phi : of_phi + STATIC] = np.eye(STATIC)
    return slopes


_UNKNOWN = 1e3  # prior deviation of an unknown, as a multiple of its size


class DataShare(NamedTuple):
    """Share of a fit that the data determine."""

    share: Vector  # of the information on each entry of the fit's covariance, shape (7 k + 4,), from 0 to 1
    seen: int  # directions that the data alone know
    unseen: int  # directions that they do not


def data_share(solution: Solution) -> DataShare:
    """Split the information on a fit between data and prior."""
    problem = solution.problem
    channels, inputs = solution.response.shape
    linear = channels * inputs
    scale = _sizes(solution)
    data, prior = np.split(solution.jacobian * scale, [solution.residual.size])
    squares = data.T @ data
    # Unknowns of the answer: neither loops nor the limb's inertia, which are integrated out.
    asked = np.ones(len(squares), dtype=np.bool_)
    asked[linear + STATIC : linear + problem.parameters] = False
    own, across = squares[np.ix_(~asked, ~asked)], squares[np.ix_(~asked, asked)]
    rest = np.linalg.solve(own + np.eye(len(own)) / _UNKNOWN**2, across)
    weak = np.linalg.eigvalsh(squares[np.ix_(asked, asked)] - across.T @ rest) < 1.0 / limits.AXIS**2
    to_output = output_derivatives(solution) * scale
    alone = _variance(squares, to_output)
    known = _variance(squares + prior.T @ prior, to_output)
    by_noise = np.zeros(len(known))
    by_noise[FitColumns.of(channels).offset] = np.diag(problem.noise) * problem.sets[-1].end.variance
    share = np.clip((known + by_noise) / np.maximum(alone + by_noise, np.finfo(float).tiny), 0.0, 1.0)
    return DataShare(share, int(np.sum(~weak)), int(np.sum(weak)))


def _variance(squares: Matrix, outputs: Matrix) -> Vector:
    """Return the variances of outputs, shape (q, p), by the information on the unknowns, shape (p, p)."""
    values, vectors = np.linalg.eigh(squares)
    return np.asarray((outputs @ vectors) ** 2 @ (1.0 / (np.maximum(values, 0.0) + 1.0 / _UNKNOWN**2)))


def _sizes(solution: Solution) -> Vector:
    """Return the sizes of the unknowns (W A row by row, phi, rotation)."""
    problem = solution.problem
    white = problem.whitening @ solution.response
    columns = np.sqrt(np.mean(white**2, axis=0))
    mass = abs(float(solution.limb[MASS]))
    reach = max(float(np.linalg.norm(solution.limb[MOMENT])) / max(mass, np.finfo(float).tiny), LEAST_LEVER)
    limb = np.ones(problem.outer)
    limb[: problem.of_loads.start] = mass * reach**2
    limb[MASS], limb[MOMENT] = mass, mass * reach
    return np.concatenate([np.tile(columns, len(white)), limb])


def slow_turn(sets: Sequence[InSituSet], parts: Sequence[CompressedSet]) -> list[Finding]:
    """Return along which direction gravity turned no faster than offsets drift, and the cure.

    The spread that the weights against drift leave is held against the spread that there was.
    """
    seen, left, size = np.zeros((3, 3)), np.zeros((3, 3)), 0.0
    for data, part in zip(sets, parts, strict=True):
        gravity = data.gravity[part.source.used]
        centred = gravity - gravity.mean(axis=0)
        seen += centred.T @ centred
        size += float(np.sum(gravity**2))
        left += part.uu[:, DIRECT].T @ part.uu[:, DIRECT]
    values, vectors = np.linalg.eigh(seen)
    wide = values > limits.STILL**2 * size
    root = vectors[:, wide] / np.sqrt(values[wide])
    shares, turned = np.linalg.eigh(root.T @ left @ root)
    if not len(shares) or shares[0] > limits.SLOW**2:
        return []
    direction = root @ turned[:, 0]
    direction /= np.linalg.norm(direction)
    spread = float(np.sqrt(direction @ seen @ direction / size))
    x, y, z = direction
    rest = spread * float(np.sqrt(max(shares[0], 0.0)))
    reason = (
        f"Along ({x:.2f}, {y:.2f}, {z:.2f}) gravity turned no faster than the sensor's offset drifts: of a "
        f"spread of {spread:.2f} of its size such a drift leaves {rest:.3f}."
    )
    cure = "Go through these postures several times in a set, or come back to the first ones at its end."
    return [Finding("slow turning", reason, cure, rest, limits.SLOW * spread, refuses=False)]
