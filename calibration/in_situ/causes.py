r"""What may act on the readings of sets that contradict each other, each cause as it changes the problem.

A cause adds signals: a step, a touch, a channel that ends early, a limb that bends or moves fast. With each
the fit is made again, on compressed sets; :mod:`~surefoot.calibration.in_situ.hypotheses` compares them.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.beside import beside_channels
from surefoot.calibration.in_situ.check import BENT_CURE, TOO_FAST
from surefoot.calibration.in_situ.data import InSituSet
from surefoot.calibration.in_situ.gravity import turning
from surefoot.calibration.in_situ.model import AXES, DIRECT, PAIRS, signals
from surefoot.calibration.in_situ.options import InSituOptions
from surefoot.calibration.in_situ.solve import Problem, Solution, solve, transforms
from surefoot.calibration.reference import GRAVITY

__all__ = ["ON_READINGS", "Cause", "Evidence", "speed"]

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

_QUANTILES = (0.5, 0.65, 0.8, 0.9, 0.96)
"""Shares of the samples below the thresholds that are tried."""

_TOUCHING = "Leave that time out, or record the set again with nothing near the limb."
SLOWLY = "Give the gyroscope's readings as well, or move slowly."


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


def _ends(evidence: Evidence) -> Iterator[Cause]:
    """Yield the channel of a set that likeliest ends early."""
    best, column, words = 0.0, None, ""
    for j, data in enumerate(evidence.sets):
        predicted = _predicted(evidence, j)
        for channel in range(data.channels):
            for sign, side in ((1.0, "above"), (-1.0, "below")):
                one = sign * predicted[:, channel]
                tops = np.quantile(one, _QUANTILES)
                hinges = np.maximum(one[:, None] - tops, 0.0)
                gains = _gains(evidence, j, hinges)
                k = int(np.argmax(gains))
                if gains[k] > best:
                    best, column, of_set = float(gains[k]), hinges[:, k], j
                    words = f"channel {channel} of '{data.name}' is clipped {side} {sign * tops[k]:.4g}"
    if column is None:
        return
    problem = evidence.alone(of_set, column)
    choices = 2 * len(_QUANTILES) * len(evidence.problem.whitening) * len(evidence.sets)
    yield Cause(
        words,
        "Take the load off, set the hardware's offset again, or lower the gain.",
        problem,
        solve(problem, [evidence.solution.outer]),
        len(evidence.problem.whitening),
        choices,
    )


def _predicted(evidence: Evidence, j: int) -> Matrix:
    """Return readings of a set by its own linear fit, without its offset, shape (n, k)."""
    u = signals(evidence.sets[j], evidence.problem.moving)
    response = evidence.problem.sets[j].response[:, : u.shape[1]]
    return np.asarray(np.nan_to_num(u @ response.T))


def _postures(evidence: Evidence) -> Iterator[Cause]:
    """Yield the likeliest end of the limb's range at which it touches something, in one set and in all."""
    gains = []
    for j, data in enumerate(evidence.sets):
        hinges, names = _hinges(data)
        gains.append(_gains(evidence, j, hinges))
    table, channels = np.array(gains), len(evidence.problem.whitening)
    j, k = divmod(int(np.argmax(table)), table.shape[1])
    one = evidence.alone(j, _hinges(evidence.sets[j])[0][:, k])
    everywhere = int(np.argmax(table.sum(axis=0)))
    both = evidence.beside([_hinges(data)[0][:, [everywhere]] for data in evidence.sets])
    for problem, name, where in ((one, f" in '{evidence.sets[j].name}'", k), (both, "", everywhere)):
        yield Cause(
            f"the limb touches something{name} where gravity has much of {names[where]}",
            _TOUCHING,
            problem,
            solve(problem, [evidence.solution.outer]),
            channels,
            table.size if name else table.shape[1],
        )


def _hinges(data: InSituSet) -> tuple[Matrix, list[str]]:
    """Return how far gravity is beyond thresholds along each axis, shape (n, K), and the axes' names."""
    columns, names = [], []
    for axis in range(3):
        for sign, name in ((1.0, "+"), (-1.0, "-")):
            along = sign * np.nan_to_num(data.gravity[:, axis])
            for top in np.quantile(along, _QUANTILES):
                columns.append(np.maximum(along - top, 0.0))
                names.append(f"{name}{'xyz'[axis]}")
    return np.stack(columns, axis=1), names


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


def speed(evidence: Evidence) -> Iterator[Cause]:
    """Yield a limb that moved too fast: what it turned by, as gravity shows it, acts on the readings."""
    moving = [turning(data) for data in evidence.sets]
    if evidence.problem.moving or not all(data.moves for data in moving):
        return
    columns = [signals(data, moving=True)[:, DIRECT.stop :] for data in moving]
    problem = evidence.beside(columns)
    yield Cause(
        TOO_FAST,
        SLOWLY,
        problem,
        solve(problem, [evidence.solution.outer]),
        columns[0].shape[1] * len(problem.whitening),
        1,
    )


ON_READINGS: tuple[Callable[[Evidence], Iterator[Cause]], ...] = (
    _steps_and_touches,
    _ends,
    _postures,
    _bending,
)
"""What may act on the readings, each as it changes the problem."""
