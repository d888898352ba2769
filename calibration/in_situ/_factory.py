"""How far to trust a factory matrix, by what predicts readings that the fit did not see; private."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ._compress import CompressedSet, triangle
from surefoot.calibration.in_situ._solve import Problem, solve, transforms

__all__ = ["FOLDS", "choose_shares", "information", "stacked", "stretches"]

Matrix = NDArray[np.float64]

_SHARES = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003)
"""How far an axis may be from the factory's, as shares of its response, from free to fixed."""

_STEPS = (0.1, 10.0)
"""By what each axis's share is then tried to differ from the common one."""

FOLDS = 5
"""Stretches of time into which a set is cut."""


def information(response: Matrix, whitening: Matrix, shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """One over the variance of an entry of each column of W A, shape (6,)."""
    size = np.sqrt(np.mean((whitening @ response) ** 2, axis=0))
    return np.asarray(1.0 / (shares * size) ** 2)


def choose_shares(problem: Problem, start: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cross-validate how far each axis may be from the factory matrix, shape (6,).

    Each fold is a stretch of time of all sets: without a whole set the others would lean more than all do
    together. One share for all axes is found first, then each axis's in turn.

    Args:
        problem: With the factory matrix.
        start: Outer unknowns to start from.
    """
    folds = _folds(problem)
    scores: dict[tuple[float, ...], float] = {}

    def score(shares: tuple[float, ...]) -> float:
        if shares not in scores:
            scores[shares] = sum(_held_out(fold, shares, start) for fold in folds)
        return scores[shares]

    common: list[tuple[float, ...]] = [(share,) * 6 for share in _SHARES]
    best = min(common, key=score)
    for axis in range(6):
        tried = [(*best[:axis], best[axis] * step, *best[axis + 1 :]) for step in _STEPS]
        best = min([best, *tried], key=score)
    return np.array(best)


def _folds(problem: Problem) -> list[tuple[Problem, Problem]]:
    """Pairs of (what is fitted, what is predicted)."""
    pieces = [stretches(part) for part in problem.sets]
    folds = []
    for fold in range(FOLDS):
        rest = tuple(stacked([part for i, part in enumerate(of) if i != fold]) for of in pieces)
        folds.append((replace(problem, sets=rest), replace(problem, sets=tuple(of[fold] for of in pieces))))
    return folds


def stretches(part: CompressedSet) -> list[CompressedSet]:
    """The set in stretches of time, about the offset of the whole."""
    columns = np.concatenate([part.score @ part.uu, part.score @ part.ur + part.residual], axis=1)
    return [_triangle(part, piece) for piece in np.array_split(columns, FOLDS)]


def stacked(parts: list[CompressedSet]) -> CompressedSet:
    """Put stretches of a set together."""
    rows = [
        np.block([[part.uu, part.ur], [np.zeros((len(part.rr), len(part.uu))), part.rr]]) for part in parts
    ]
    return _triangle(parts[0], np.concatenate(rows))


def _triangle(part: CompressedSet, columns: Matrix) -> CompressedSet:
    R, first = triangle(columns), len(part.uu)
    return replace(part, uu=R[:first, :first], ur=R[:first, first:], rr=R[first:, first:])


def _held_out(fold: tuple[Problem, Problem], shares: tuple[float, ...], start: NDArray[np.float64]) -> float:
    """Sum of squares of the whitened readings that the fit of the others leaves."""
    fitted, held_out = fold
    assert fitted.prior_response is not None
    weight = information(fitted.prior_response, fitted.whitening, np.array(shares))
    solution = solve(replace(fitted, prior_information=weight), [start])
    left = 0.0
    T = transforms(held_out, solution.limb, solution.rotation)
    for part, transform in zip(held_out.sets, T, strict=True):
        row = (part.uu @ transform.T @ solution.response.T - part.ur) @ held_out.whitening.T
        left += float(np.sum(row**2))
    return left
