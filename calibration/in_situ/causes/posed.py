"""Sets of a log as a least-squares problem, which mistakes that are undone change, and its fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from surefoot.calibration.arrays import orthonormal
from surefoot.calibration.diagnosis import Experience, Fitted
from surefoot.calibration.in_situ.data import InSituSet, Matrix, Vector
from surefoot.calibration.in_situ.model import AXES, signals
from surefoot.calibration.in_situ.solver.compress import change_signals
from surefoot.calibration.in_situ.solver.problem import Problem
from surefoot.calibration.in_situ.solver.solve import Solution, beside_channels, deviance, minima, solve

EXPERIENCE = Experience(
    unknown=0.2, mimicked=0.2, size=0.003, spread=0.6, kinds=20.0, readings=100.0, good=0.0025, best=0.0005
)
"""Residuals of sound sets are 0.1 to 0.9 % of the spread, mostly hysteresis.

Measured by tests/spoilt/_spoilt_in_situ.py. Loops of two laws of hysteresis differ by a few numbers per axis,
and so do loops of one law at different swings: they count as 100 readings.
"""


@dataclass(frozen=True, eq=False)
class Posed:
    """Sets as a problem, with the outer unknowns from which its search starts."""

    sets: tuple[InSituSet, ...]
    problem: Problem
    starts: tuple[Vector, ...]
    """One for a problem that differs little from the one they solve; several to find the best minimum."""
    response: Matrix | None = None  # the manufacturer's matrix, in counts per N and N m, shape (k, 6)

    @property
    def timed(self) -> bool:
        """Whether all sets have times. Without times the order of the samples is unknown."""
        return all(one.time is not None for one in self.sets)

    @property
    def rows(self) -> int:
        """Number of rows of all sets."""
        return sum(part.rows for part in self.problem.sets)

    def at_rows(self, columns: Sequence[Matrix]) -> list[Matrix]:
        """Average the columns of each set, shape (n_j, q), over the rows of the compressed set."""
        return [part.at_rows(one) for part, one in zip(self.problem.sets, columns, strict=True)]

    def beside(self, rows: Sequence[Matrix]) -> "Posed":
        """Add signals, sampled at the rows of the compressed sets, to the readings."""
        return replace(self, problem=beside_channels(self.problem, rows))

    def read_as(self, sets: Sequence[InSituSet]) -> "Posed":
        """Replace gravity and motion by those of other sets, sample by sample."""
        problem = self.problem
        rows = self.at_rows([np.nan_to_num(signals(one, problem.moving)) for one in sets])
        beside = [part.source.signals[:, problem.motion.stop :] for part in problem.sets]
        parts = change_signals(problem.sets, [np.hstack(pair) for pair in zip(rows, beside, strict=True)])
        return replace(self, problem=replace(problem, sets=parts))

    def free(self, changes: NDArray[np.float64]) -> "Posed":
        """Add q unknowns that change the added parameters, shape (q, J, p)."""
        starts = tuple(np.pad(one, (0, len(changes))) for one in self.starts)
        return replace(self, problem=replace(self.problem, changes=changes), starts=starts)

    def when(self, j: int, sample: int) -> str:
        """Return the time of a sample in words, or its number if the set has no times."""
        time = self.sets[j].time
        return f"sample {sample}" if time is None else f"{time[sample]:.1f} s"


def fit_posed(posed: Posed) -> Fitted:
    """Fit a problem.

    If all masses are in one plane, a sensor and its mirror image fit equally well: of such rotations the
    smallest is returned.
    """
    if len(posed.starts) == 1:
        solution = solve(posed.problem, posed.starts)
    else:
        found = minima(posed.problem, posed.starts)
        solution = min(found, key=lambda one: Rotation.from_matrix(one.rotation).magnitude())
    return Fitted(-0.5 * deviance(solution), _measure_left(solution, posed.timed), solution)


def _measure_left(solution: Solution, timed: bool) -> float:
    """Return the residual of a solution without white noise, as a share of the spread of forces and torques.

    A slope within a set is attributed to offset drift. Without times, noise cannot be separated from other
    residuals within a set, so only disagreement between sets counts.
    """
    to_wrench = np.linalg.pinv(solution.A).T
    left, spread, samples = np.zeros(AXES), np.zeros(AXES), 0.0
    for part, B in zip(solution.problem.sets, solution.predicted, strict=True):
        weight, u, read = np.split(part.source.columns, [1, 1 + part.source.inputs], axis=1)
        ramp = np.linspace(-1.0, 1.0, part.rows)[:, None] * weight if timed else weight[:, :0]
        basis, _ = orthonormal(np.hstack([weight, ramp]))
        rest = (read - u @ B.T) @ to_wrench
        rest = rest - basis @ (basis.T @ rest)
        left += np.sum(rest**2, axis=0)
        if timed:
            left -= np.sum(np.diff(rest, axis=0) ** 2, axis=0) / 2.0
        else:
            left -= np.sum((part.residual @ to_wrench) ** 2, axis=0)
        level = (read - weight @ (weight.T @ read) / np.sum(weight**2)) @ to_wrench
        spread = np.maximum(spread, np.sum(level**2, axis=0) / np.sum(weight**2))
        samples += float(np.sum(weight**2))
    tiny = float(np.finfo(float).tiny)
    share = np.sum(left.reshape(2, 3), axis=1) / np.maximum(np.sum(spread.reshape(2, 3), axis=1), tiny)
    return float(np.sqrt(np.mean(np.maximum(share, 0.0)) / samples))
