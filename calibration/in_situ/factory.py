r"""Fits that lean on a factory matrix, as far as it agrees with the readings.

Where the data determine all, their own response tells how far the factory's may be off, and only what they
know less surely than that leans on it (:func:`likely_shares`). Where they do not, each axis counts as known
to a share that cross-validation chooses (:func:`choose_shares`). One limb without added masses moves the
readings in three directions only, and any matrix that is right on these fits. Among them the factory's is
the one to stay close to, but not along directions in which nothing but noise is seen. So each axis a has its
row from

.. math:: \min_{C_a} \; \sum_i (C_a (r_i - o) - w_{a,i})^2 + \lambda_a n |C_a - C_a^{factory}|^2,

where w follows from gravity and the limb's inertial parameters, and :math:`\lambda_a` from what predicts
stretches of time that it has not seen (regularisation as by Andrade Chavez et al., 2016, here with a weight
an axis; :func:`leaning_matrix`).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.compress import CompressedSet, triangle
from surefoot.calibration.in_situ.covariance import noise_level, unknowns_root, with_disagreement
from surefoot.calibration.in_situ.model import AXES
from surefoot.calibration.in_situ.solve import Problem, Solution, solve, transforms

__all__ = ["choose_shares", "leaning_matrix", "likely_shares"]

Matrix = NDArray[np.float64]

_SHARES = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003)
"""How far an axis may be from the factory's, as shares of its response, from free to fixed."""

_STEPS = (10.0, 1.0, 0.1)
"""Factors on the common share that are then tried for each axis."""

_FINE_SHARES = np.geomspace(1.0, 0.003, 25)
"""Shares of which the likeliest is looked for, the largest first."""

_WEIGHTS = 10.0 ** np.arange(-6.0, 3.0)
"""Weights of a row to choose from, in units of the readings' mean square."""

_FOLDS = 5
"""Stretches of time into which a set is cut."""


def likely_shares(problem: Problem, alone: Solution, factory_response: Matrix) -> NDArray[np.float64]:
    """Return how far each axis may be from the factory matrix, shape (6,), by a fit without it.

    An entry's difference from the factory's has the variance of that fit and of the share, which is one for
    all: an axis that agrees while others have aged does so by chance. It is the largest whose likelihood is
    within a standard deviation of the best. An axis that the data know better than by that share is left to
    them, infinity: it is not to be drawn to an old matrix.

    Args:
        problem: Without the factory matrix.
        alone: Its solution.
        factory_response: A of the factory, shape (k, 6).
    """
    W, channels = problem.whitening, len(alone.response)
    size = np.sqrt(np.mean((W @ factory_response) ** 2, axis=0))
    off = W @ (alone.A - factory_response) / size
    root = unknowns_root(with_disagreement(problem, alone), alone)[: channels * problem.inputs]
    unsure = np.sum(root**2, axis=1).reshape(channels, problem.inputs)[:, :AXES] / size**2
    variance = _FINE_SHARES[:, None, None] ** 2 + unsure
    likelihood = -0.5 * np.sum(np.log(variance) + off**2 / variance, axis=(1, 2))
    share = float(_FINE_SHARES[np.argmax(likelihood >= likelihood.max() - 0.5)])
    return np.where(share**2 < np.mean(unsure, axis=0), share, np.inf)


def choose_shares(problem: Problem, start: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far each axis may be from the factory matrix by cross-validation, shape (6,).

    Each fold is a stretch of time of all sets: without a whole set the others would lean more than all do
    together. One share for all axes is found first, then each axis's in turn.

    Args:
        problem: With the factory matrix's response.
        start: Outer unknowns.
    """
    folds = _folds(problem)
    scores: dict[tuple[float, ...], float] = {}

    def score(shares: tuple[float, ...]) -> float:
        if shares not in scores:
            scores[shares] = sum(_held_out(fold, shares, start) for fold in folds)
        return scores[shares]

    best = min(((share,) * AXES for share in _SHARES), key=score)
    for axis in range(AXES):
        tried = [(*best[:axis], best[axis] * step, *best[axis + 1 :]) for step in _STEPS]
        best = min(tried, key=score)
    return np.array(best)


def _folds(problem: Problem) -> list[tuple[Problem, Problem]]:
    """Return pairs of what is fitted and what is predicted."""
    pieces = [_stretches(part) for part in problem.sets]
    folds = []
    for fold in range(_FOLDS):
        rest = tuple(_stacked([part for i, part in enumerate(of) if i != fold]) for of in pieces)
        folds.append((replace(problem, sets=rest), replace(problem, sets=tuple(of[fold] for of in pieces))))
    return folds


def _stretches(part: CompressedSet) -> list[CompressedSet]:
    """Return a set in stretches of time, about the offset of the whole."""
    columns = np.concatenate([part.score @ part.uu, part.score @ part.ur + part.residual], axis=1)
    return [_triangle(part, piece) for piece in np.array_split(columns, _FOLDS)]


def _stacked(parts: list[CompressedSet]) -> CompressedSet:
    """Return stretches of a set as one."""
    rows = [
        np.block([[part.uu, part.ur], [np.zeros((len(part.rr), len(part.uu))), part.rr]]) for part in parts
    ]
    return _triangle(parts[0], np.concatenate(rows))


def _triangle(part: CompressedSet, columns: Matrix) -> CompressedSet:
    R, first = triangle(columns), len(part.uu)
    return replace(part, uu=R[:first, :first], ur=R[:first, first:], rr=R[first:, first:])


def _held_out(fold: tuple[Problem, Problem], shares: tuple[float, ...], start: NDArray[np.float64]) -> float:
    """Return the sum of squares of the whitened readings that the fit of the others leaves."""
    fitted, held_out = fold
    solution = solve(replace(fitted, prior_shares=np.array(shares)), [start])
    left = 0.0
    for part, transform in zip(held_out.sets, transforms(held_out, solution), strict=True):
        row = (part.uu @ transform.T @ solution.response.T - part.ur) @ held_out.whitening.T
        left += float(np.sum(row**2))
    return left


def leaning_matrix(problem: Problem, solution: Solution, factory: Matrix) -> tuple[Matrix, Matrix]:
    """Return C, shape (6, k), and the covariance of each of its rows, shape (6, k, k).

    The limb and the rotation are the solution's; ``factory`` is the factory matrix, shape (6, k).
    """
    T = transforms(problem, solution)
    rows = [_rows(part, one, solution.direct) for part, one in zip(problem.sets, T, strict=True)]
    level = np.mean(np.concatenate([readings for readings, _ in rows]) ** 2)
    eye = np.eye(factory.shape[1])
    error = np.zeros((_FOLDS, len(_WEIGHTS), AXES))
    for fold in range(_FOLDS):
        fitted, held_out = [], []
        for readings, wrenches in rows:
            out = np.arange(len(readings)) * _FOLDS // len(readings) == fold
            # The offset is not known of a stretch that was not seen.
            X, Y = readings - readings[~out].mean(axis=0), wrenches - wrenches[~out].mean(axis=0)
            fitted.append((X[~out], Y[~out]))
            held_out.append((X[out], Y[out]))
        X, Y = (np.concatenate(part) for part in zip(*held_out, strict=True))
        square, product = _normal_equations(fitted, factory)
        for i, weight in enumerate(_WEIGHTS):
            matrix = factory + np.linalg.solve(square + weight * level * eye, product).T
            error[fold, i] = np.sum((X @ matrix.T - Y) ** 2, axis=0)
    best = _WEIGHTS[_cautious(error)] * level
    square, product = _normal_equations(rows, factory)
    heavier = [square + weight * eye for weight in best]
    matrix = factory + np.stack([np.linalg.solve(S, product)[:, axis] for axis, S in enumerate(heavier)])
    samples = sum(len(readings) for readings, _ in rows)
    # With weight lambda the factory's row counts as known to s^2 / (n lambda), s^2 being what is left.
    left = np.min(np.sum(error, axis=0), axis=0) / samples * noise_level(problem.sets)
    return matrix, left[:, None, None] / samples * np.linalg.inv(heavier)


def _cautious(error: NDArray[np.float64]) -> NDArray[np.int_]:
    """Return the heaviest weight within a standard error of the best (Breiman et al., 1984), shape (6,).

    ``error`` holds squares of what is left of the folds, shape (folds, weights, 6).
    """
    mean = error.mean(axis=0)
    best = np.argmin(mean, axis=0)
    axes = np.arange(error.shape[2])
    deviation = error[:, best, axes].std(axis=0, ddof=1) / np.sqrt(len(error))
    allowed = mean <= mean[best, axes] + deviation
    return np.asarray(len(mean) - 1 - np.argmax(allowed[::-1], axis=0))


def _rows(part: CompressedSet, transform: Matrix, direct: Matrix) -> tuple[Matrix, Matrix]:
    """Return readings and wrenches about their offset, (m, k) and (m, 6)."""
    signals = part.score @ part.uu
    other = signals @ transform[AXES:].T @ direct.T
    return part.score @ part.ur + part.residual - other, signals @ transform[:AXES].T


def _normal_equations(rows: list[tuple[Matrix, Matrix]], factory: Matrix) -> tuple[Matrix, Matrix]:
    """Return the readings' mean square, (k, k), and that by what the factory matrix leaves, (k, 6)."""
    X, Y = (np.concatenate(part) for part in zip(*rows, strict=True))
    return X.T @ X / len(X), X.T @ (Y - X @ factory.T) / len(X)
