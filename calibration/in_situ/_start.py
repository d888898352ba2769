"""Where the search for the limb's inertial parameters begins; private."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surefoot.calibration.in_situ._compress import CompressedSet
from surefoot.calibration.in_situ._model import STATIC, sensitivity
from surefoot.calibration.in_situ._solve import Problem, of_unit_length

__all__ = ["hanging", "starts"]

Matrix = NDArray[np.float64]

_MULTIPLES = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
"""Masses to try, in units of the largest added mass."""

_TURNED_MULTIPLES = (1.0, 10.0)
"""The same where each is tried with all turns by right angles."""


def starts(
    problem: Problem, factory: Matrix | None, known: NDArray[np.float64] | None
) -> list[NDArray[np.float64]]:
    """List outer unknowns to start from, shape (p,), or (p + 3,) where the rotation is unknown.

    Args:
        problem: The problem.
        factory: The factory matrix, shape (6, k), or None.
        known: What is known of the limb, shape (p,), or None.
    """
    found = [known] if known is not None else []
    if factory is not None and not problem.rotation:
        found.append(_by_matrix(problem, factory, np.eye(3)))
    largest = float(np.max(problem.added[:, 0]))
    if largest > 0.0:
        # Few and noisy samples shrink the paper's mass, but not its first moment, and a search that begins at
        # such a mass can end in a wrong place.
        first = _by_paper(problem) if len(problem.sets) >= 3 else _padded(problem, [largest, 0.0, 0.0, 0.0])
        found.append(first)
        multiples = _TURNED_MULTIPLES if problem.rotation else _MULTIPLES
        found += [np.concatenate([[multiple * largest], first[1:]]) for multiple in multiples]
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


def hanging(
    matrix: Matrix, part: CompressedSet, rotation: Matrix, beside: Matrix | None = None
) -> NDArray[np.float64]:
    """Weigh all that hangs on the sensor in a set by a known matrix: (m, m c), shape (4,).

    Args:
        matrix: C, shape (6, k).
        part: The set.
        rotation: R_sensor_accelerometer.
        beside: Response to the signals beside gravity, shape (k, s - 3), if it is known.
    """
    response: Matrix = part.response[:, :3]
    if beside is not None:
        left = part.ur - part.uu[:, 3:] @ beside.T
        response = np.asarray(np.linalg.lstsq(part.uu[:, :3], left, rcond=None)[0].T)
    measured = matrix @ response @ rotation.T
    D = sensitivity(moving=False)
    return np.asarray(np.linalg.lstsq(D.reshape(STATIC, -1).T, measured.ravel(), rcond=None)[0])


def _by_matrix(problem: Problem, matrix: Matrix, rotation: Matrix) -> NDArray[np.float64]:
    seen = [hanging(matrix, part, rotation) for part in problem.sets]
    return _padded(problem, np.mean(np.array(seen) - problem.added[:, :STATIC], axis=0))


def _by_paper(problem: Problem) -> NDArray[np.float64]:
    """In-situ paper, Eqs. 18-24, on compressed rows, in which the noise is averaged: C r - T_b u = T_a u."""
    D = problem.basis
    count = D.shape[2]
    readings = [problem.whitening @ part.ur.T for part in problem.sets]
    left = np.linalg.svd(np.concatenate(readings, axis=1))[0][:, :6]
    rows, right = [], []
    for part, reading, added in zip(problem.sets, readings, problem.added, strict=True):
        moved = D @ part.uu[:, :count].T
        matrix = np.kron(np.eye(6), (left.T @ reading).T)
        rows.append(np.hstack([matrix, -moved.reshape(len(D), -1).T]))
        right.append(np.einsum("p,pws->ws", added, moved).ravel())
    unit, size = of_unit_length(np.concatenate(rows))
    solution = np.linalg.lstsq(unit, np.concatenate(right), rcond=1e-10)[0] / size
    return np.asarray(solution[-len(D) :])


def _padded(problem: Problem, static: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([np.asarray(static), np.zeros(problem.parameters - STATIC)])
