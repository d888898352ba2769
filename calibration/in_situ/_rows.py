r"""Rows of a matrix that lean on the factory's where the data leave them open; private.

One limb without added masses moves the readings in three directions only, and any matrix that is right on
these fits. Among them the factory's is the one to stay close to, but not along directions in which nothing
but noise is seen. So each axis a has its row from

.. math:: \min_{C_a} \; \sum_i (C_a (r_i - o) - w_{a,i})^2 + \lambda_a n |C_a - C_a^{factory}|^2,

where w follows from gravity and the limb's inertial parameters, and :math:`\lambda_a` from what predicts
stretches of time that it has not seen (regularisation as by Andrade Chavez et al., 2016, here with a weight
an axis).
"""

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ._compress import CompressedSet
from surefoot.calibration.in_situ._covariance import persistence
from surefoot.calibration.in_situ._factory import FOLDS
from surefoot.calibration.in_situ._solve import Problem, Solution, transforms

__all__ = ["leaning_matrix"]

Matrix = NDArray[np.float64]

_WEIGHTS = 10.0 ** np.arange(-6.0, 3.0)
"""To choose from, in units of the readings' mean square."""


def leaning_matrix(problem: Problem, solution: Solution, factory: Matrix) -> tuple[Matrix, Matrix]:
    """Compute C, shape (6, k), and the covariance of each of its rows, shape (6, k, k).

    Args:
        problem: The sets.
        solution: Whose limb and rotation are taken.
        factory: The factory matrix, shape (6, k).
    """
    rows = [
        _rows(part, transform, solution.response[:, 6:])
        for part, transform in zip(
            problem.sets, transforms(problem, solution.limb, solution.rotation), strict=True
        )
    ]
    level = np.mean(np.concatenate([readings for readings, _ in rows]) ** 2)
    eye = np.eye(factory.shape[1])
    error = np.zeros((FOLDS, len(_WEIGHTS), 6))
    for fold in range(FOLDS):
        fitted, held_out = [], []
        for readings, wrenches in rows:
            out = np.arange(len(readings)) * FOLDS // len(readings) == fold
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
    left = np.min(np.sum(error, axis=0), axis=0) / samples * persistence(problem.sets, problem.whitening)
    return matrix, left[:, None, None] / samples * np.linalg.inv(heavier)


def _cautious(error: NDArray[np.float64]) -> NDArray[np.int_]:
    """Choose the heaviest weight within a standard error of the best (Breiman et al., 1984), shape (6,).

    Args:
        error: Squares of what is left of the folds, shape (folds, weights, 6).
    """
    mean = error.mean(axis=0)
    best = np.argmin(mean, axis=0)
    axes = np.arange(error.shape[2])
    deviation = error[:, best, axes].std(axis=0, ddof=1) / np.sqrt(len(error))
    allowed = mean <= mean[best, axes] + deviation
    return np.asarray(len(mean) - 1 - np.argmax(allowed[::-1], axis=0))


def _rows(part: CompressedSet, transform: Matrix, temperature: Matrix) -> tuple[Matrix, Matrix]:
    """Readings and wrenches about their offset, (m, k) and (m, 6)."""
    signals = part.score @ part.uu
    heat = signals @ transform[6:].T @ temperature.T
    return part.score @ part.ur + part.residual - heat, signals @ transform[:6].T


def _normal_equations(rows: list[tuple[Matrix, Matrix]], factory: Matrix) -> tuple[Matrix, Matrix]:
    """Mean square of the readings, (k, k), and of the readings by what the factory matrix leaves, (k, 6)."""
    X, Y = (np.concatenate(part) for part in zip(*rows, strict=True))
    return X.T @ X / len(X), X.T @ (Y - X @ factory.T) / len(X)
