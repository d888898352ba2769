r"""What may act on the readings of sets that contradict each other, each cause as it changes the problem.

A cause adds signals: a step, a touch, a limb that bends. With each
the fit is made again, on compressed sets; :mod:`~surefoot.calibration.in_situ.hypotheses` compares them.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.beside import beside_channels
from surefoot.calibration.in_situ.check import BENT_CURE
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.model import AXES, PAIRS, signals
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.calibration.in_situ.solve import Problem, Solution, solve, transforms
from surefoot.calibration.reference import GRAVITY

__all__ = ["ON_READINGS", "Cause", "Evidence"]

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

_THINNED = 2000
"""Samples of a set in which causes are looked for."""

_EDGES = 40
"""Stretches of a set at whose ends a step or a touch is looked for first."""

_FINER = 4
"""By how much the search becomes finer; it ends at single samples."""

_SHORTEST = 3
"""Rows that a touch must last."""

_TOUCHING = "Leave that time out, or record the set again with nothing near the limb."


@dataclass(frozen=True, eq=False)
class Evidence:
    """What causes are judged by.

    Attributes:
        sets: The sets.
        problem: Of the fit, without hysteresis.
        solution: Its solution.
        options: Of the fit.
    """

    sets: tuple[InSituSet, ...]
    problem: Problem
    solution: Solution
    options: InSituOptions

    def beside(self, columns: Sequence[Matrix]) -> Problem:
        """Return the problem with signals that act on the readings, shape (n_j, q) a set."""
        plain = self.problem
        rows = [part.at_rows(one) for part, one in zip(plain.sets, columns, strict=True)]
        return beside_channels(plain, rows, self.options)

    def alone(self, j: int, column: Vector) -> Problem:
        """Return the problem with a signal of one set, shape (n_j,)."""
        return self.beside(
            [column[:, None] if i == j else np.zeros((len(data.raw), 1)) for i, data in enumerate(self.sets)]
        )

    def when(self, j: int, sample: int) -> str:
        """Return a moment of a set in words."""
        time = self.sets[j].time
        return f"sample {sample}" if time is None else f"{time[sample]:.1f} s"


class Cause(NamedTuple):
    """A cause that was tried.

    Attributes:
        words: What it is.
        cure: What to do about it.
        problem: Of the fit with it.
        solution: Of the fit with it.
        free: Number of unknowns that it adds.
        choices: Number of alternatives of which it is the best.
    """

    words: str
    cure: str
    problem: Problem
    solution: Solution
    free: int
    choices: int


# What happened within a set: signals that act on its readings.


def _gains(evidence: Evidence, j: int, columns: Matrix) -> Vector:
    """Return by how much each of the columns, shape (n, K), explains what a set's fit leaves, shape (K,)."""
    data, part = evidence.sets[j], evidence.problem.sets[j]
    rows = np.flatnonzero(part.used)
    rows = rows[:: max(len(rows) // _THINNED, 1)]
    u = signals(data, evidence.problem.moving)[rows]
    span = np.linspace(-1.0, 1.0, len(rows))
    left, singular, _ = np.linalg.svd(
        np.column_stack([np.ones(len(rows)), span, u / np.maximum(np.ptp(u, axis=0), 1e-300)]),
        full_matrices=False,
    )
    basis = left[:, singular > 1e-9 * singular[0]]
    z = columns[rows] - basis @ (basis.T @ columns[rows])
    raw = data.raw[rows]
    residual = raw - basis @ (basis.T @ raw)
    white = np.linalg.cholesky(np.linalg.pinv(residual.T @ residual / len(rows), hermitian=True))
    size = np.sum(z**2, axis=0)
    seen = size > 1e-9 * np.maximum(np.sum(columns[rows] ** 2, axis=0), 1e-300)
    gain = np.sum((z.T @ residual @ white) ** 2, axis=1) / np.where(seen, size, 1.0)
    return np.where(seen, gain, 0.0)


def _steps_and_touches(evidence: Evidence) -> Iterator[Cause]:
    """Yield the likeliest leap of a zero, and the likeliest time in which something touched the limb."""
    channels = len(evidence.problem.whitening)
    for touch in (False, True):
        found = []
        for j, data in enumerate(evidence.sets):
            n = len(data.raw)
            edges = np.unique(np.linspace(0, n, _EDGES + 1).astype(int))
            spans = _spans(edges, n, touch)
            first, last, gain = _best_span(evidence, j, spans)
            for width in (n // _EDGES, n // _EDGES // _FINER, _FINER):
                near = [_near(first, width, n), _near(last, width, n) if touch else np.array([n])]
                fine = [(a, b) for a in near[0] for b in near[1] if b - a >= _SHORTEST]
                first, last, gain = _best_span(evidence, j, [*fine, (first, last)])
            found.append((gain, j, first, last, len(spans)))
        gain, j, first, last, choices = max(found)
        column = np.zeros(len(evidence.sets[j].raw))
        column[first:last] = 1.0
        name, begin = evidence.sets[j].name, evidence.when(j, first)
        words = (
            f"something touched the limb in '{name}' from {begin} to {evidence.when(j, last - 1)}"
            if touch
            else f"the zero of '{name}' leaps at {begin}"
        )
        cure = _TOUCHING if touch else "Cut the set there into two, or record it again."
        problem = evidence.alone(j, column)
        yield Cause(
            words,
            cure,
            problem,
            solve(problem, [evidence.solution.outer]),
            channels + 1 + touch,
            choices * len(evidence.sets),
        )


def _spans(edges: NDArray[np.int_], n: int, touch: bool) -> list[tuple[int, int]]:
    if touch:
        return [(int(a), int(b)) for a, b in combinations(edges[1:-1], 2)]
    return [(int(a), n) for a in edges[1:-1]]


def _near(edge: int, width: int, n: int) -> NDArray[np.int_]:
    return np.unique(np.clip(edge + np.linspace(-width, width, 2 * _FINER + 1).astype(int), 1, n - 1))


def _best_span(evidence: Evidence, j: int, spans: list[tuple[int, int]]) -> tuple[int, int, float]:
    """Return the likeliest of the spans of samples (first, last) and what it explains."""
    place = np.arange(len(evidence.sets[j].raw))[:, None]
    first, last = np.array(spans).T
    gains = _gains(evidence, j, ((place >= first) & (place < last)).astype(np.float64))
    best = int(np.argmax(gains))
    return int(first[best]), int(last[best]), float(gains[best])


# What holds for all sets.


def _bending(evidence: Evidence) -> Iterator[Cause]:
    """Yield a limb that gives way with gravity's squares, and a sensor with squares and cubes of loads."""
    columns = []
    for data in evidence.sets:
        g = np.nan_to_num(data.gravity) / GRAVITY
        # The sixth square follows from the length of gravity.
        columns.append(np.stack([g[:, i] * g[:, j] for i, j in PAIRS if (i, j) != (2, 2)], axis=1))
    yield _bent(evidence, columns)
    # A limb that bends does so by gravity, a sensor by its load, which grows with what was added.
    T = transforms(evidence.problem, evidence.solution)[:, :AXES]
    loads = [np.nan_to_num(signals(data, evidence.problem.moving)) for data in evidence.sets]
    loads = [u @ t[:, : u.shape[1]].T for u, t in zip(loads, T, strict=True)]
    largest = np.max([np.max(np.abs(load), axis=0) for load in loads], axis=0)
    shares = [load / np.where(largest > 0.0, largest, 1.0) for load in loads]
    yield _bent(evidence, [np.concatenate([x**2, x**3], axis=1) for x in shares])


def _bent(evidence: Evidence, columns: Sequence[Matrix]) -> Cause:
    problem = evidence.beside(columns)
    return Cause(
        "the limb bends as it turns, or the sensor is not linear",
        BENT_CURE,
        problem,
        solve(problem, [evidence.solution.outer]),
        columns[0].shape[1] * len(problem.whitening),
        1,
    )


ON_READINGS: tuple[Callable[[Evidence], Iterator[Cause]], ...] = (_steps_and_touches, _bending)
"""What may act on the readings, each as it changes the problem."""
