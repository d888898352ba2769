"""Places from which the search for a limb begins: by its matrix, by the paper, by multiples of a mass."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surefoot.calibration.in_situ.compress import CompressedSet
from surefoot.calibration.in_situ.model import (
    AXES,
    DIRECT,
    ENOUGH_MASSES,
    MASS,
    STATIC,
    transform_basis,
)
from surefoot.calibration.in_situ.solve import Problem, of_unit_length

__all__ = ["hanging", "starts"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


_ROUNDING = 1e-10
"""Singular values at or below this share of the largest are rounding in the paper's method."""


_MULTIPLES, _TURNED_MULTIPLES = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0), (1.0, 10.0)
"""Masses to try, in units of the largest added mass; the second where each is tried with many turns."""


def starts(problem: Problem, factory: Matrix | None, known: Vector | None) -> list[Vector]:
    """Return outer unknowns to start from, shape (p,), or (p + 3,) where the rotation is unknown.

    A factory matrix, shape (6, k), and what is known of the limb, shape (p,), give starts of their own.
    """
    found = [known] if known is not None else []
    if factory is not None and not problem.rotation:
        found.append(_by_matrix(problem, factory, np.eye(3)))
    largest = float(np.max(problem.added[:, MASS]))
    if largest > 0.0:
        # Few and noisy samples shrink the paper's mass, but not its first moment, and a search that begins at
        # such a mass can end in a wrong place.
        enough = len(problem.sets) >= ENOUGH_MASSES
        first = _by_paper(problem) if enough else _padded(problem, [largest, 0.0, 0.0, 0.0])
        found.append(first)
        multiples = _TURNED_MULTIPLES if problem.rotation else _MULTIPLES
        found += [np.concatenate([[multiple * largest], first[MASS + 1 :]]) for multiple in multiples]
    found = [start for start in found if np.all(np.isfinite(start))]
    found = found or [_padded(problem, [1.0, 0.0, 0.0, 0.0])]
    if not problem.rotation:
        return found
    # The identity and the turns by right angles: the true one is near one of them.
    turns = [turn.as_rotvec() for turn in Rotation.create_group("O")]
    turned = [np.concatenate([start, turn]) for start in found for turn in turns]
    if factory is not None:
        matrices = [Rotation.from_rotvec(turn).as_matrix() for turn in turns]
        by_matrix = [_by_matrix(problem, factory, matrix) for matrix in matrices]
        turned = [np.concatenate(pair) for pair in zip(by_matrix, turns, strict=True)] + turned
    return turned


def hanging(matrix: Matrix, part: CompressedSet, rotation: Matrix, beside: Matrix | None = None) -> Vector:
    """Return (m, m c) of all that hangs on the sensor in a set, shape (4,), by a known matrix C.

    ``beside`` is the response to the signals beside gravity, shape (k, s - 3), if it is known.
    """
    response: Matrix = part.response[:, DIRECT]
    turned = part.turned
    if beside is not None:
        turned = part.uu[:, DIRECT]
        left = part.ur - part.uu[:, DIRECT.stop :] @ beside.T
        response = np.asarray(np.linalg.lstsq(turned, left, rcond=None)[0].T)
    # By as much as gravity turned: the response to where it did not is noise.
    measured = matrix @ response @ turned.T
    basis = transform_basis(moving=False) @ rotation @ turned.T
    return np.asarray(np.linalg.lstsq(basis.reshape(STATIC, -1).T, measured.ravel(), rcond=None)[0])


def _by_matrix(problem: Problem, matrix: Matrix, rotation: Matrix) -> Vector:
    seen = [hanging(matrix, part, rotation) for part in problem.sets]
    return _padded(problem, np.mean(np.array(seen) - problem.added[:, :STATIC], axis=0))


def _by_paper(problem: Problem) -> Vector:
    """In-situ paper, Eqs. 18-24, on compressed rows, in which the noise is averaged: C r - T_b u = T_a u."""
    basis = problem.basis
    count = basis.shape[2]
    readings = [problem.whitening @ part.ur.T for part in problem.sets]
    left = np.linalg.svd(np.concatenate(readings, axis=1))[0][:, :AXES]
    rows, right = [], []
    for part, reading, added in zip(problem.sets, readings, problem.added, strict=True):
        moved = basis @ part.uu[:, :count].T
        matrix = np.kron(np.eye(AXES), (left.T @ reading).T)
        rows.append(np.hstack([matrix, -moved.reshape(len(basis), -1).T]))
        right.append(np.einsum("p,pws->ws", added, moved).ravel())
    unit, size = of_unit_length(np.concatenate(rows))
    solution = np.linalg.lstsq(unit, np.concatenate(right), rcond=_ROUNDING)[0] / size
    return np.asarray(solution[-len(basis) :])


def _padded(problem: Problem, static: Sequence[float] | Vector) -> Vector:
    return np.concatenate([np.asarray(static), np.zeros(problem.parameters - STATIC)])
