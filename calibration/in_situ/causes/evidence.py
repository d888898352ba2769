"""The data and the fit that possible causes are compared with, and the record of a tested cause."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.data import InSituSet, Matrix
from surefoot.calibration.in_situ.model import signals
from surefoot.calibration.in_situ.solver.compress import change_signals
from surefoot.calibration.in_situ.solver.problem import Problem
from surefoot.calibration.in_situ.solver.solve import Solution, beside_channels, solve


@dataclass(frozen=True, eq=False)
class Evidence:
    """The data, and the fit without any cause, that possible causes are compared with."""

    sets: tuple[InSituSet, ...]
    solution: Solution
    """Solution of the problem without any cause. It includes hysteresis if the sets contain it, because
    hysteresis resembles a short delay."""
    response: Matrix | None = None  # the manufacturer's matrix, in counts per N and N m, shape (k, 6)

    @property
    def timed(self) -> bool:
        """Whether all sets have times. Without times the order of the samples is unknown."""
        return all(one.time is not None for one in self.sets)

    @property
    def problem(self) -> Problem:
        """The problem without any cause."""
        return self.solution.problem

    def at_rows(self, columns: Sequence[Matrix]) -> list[Matrix]:
        """Average the columns of each set, shape (n_j, q), over the rows of the compressed set."""
        return [part.at_rows(one) for part, one in zip(self.problem.sets, columns, strict=True)]

    def beside(self, words: str, cure: str, rows: Sequence[Matrix], free: int, choices: int) -> "Cause":
        """Fit a cause that adds signals, sampled at the rows of the compressed sets, to the readings."""
        problem = beside_channels(self.problem, rows)
        return Cause(words, cure, solve(problem, [self.solution.outer]), free, choices)

    def read_as(self, words: str, cure: str, sets: Sequence[InSituSet], free: int, choices: int) -> "Cause":
        """Fit a cause that replaces gravity and motion by those of other sets, sample by sample."""
        problem = self.problem
        rows = self.at_rows([np.nan_to_num(signals(one, problem.moving)) for one in sets])
        beside = [part.source.signals[:, problem.motion.stop :] for part in problem.sets]
        parts = change_signals(problem.sets, [np.hstack(pair) for pair in zip(rows, beside, strict=True)])
        return Cause(words, cure, solve(replace(problem, sets=parts), [self.solution.outer]), free, choices)

    def change(self, changes: NDArray[np.float64]) -> Solution:
        """Fit the problem with q additional unknowns that change the added parameters, shape (q, J, p)."""
        outer = np.pad(self.solution.outer, (0, len(changes)))
        return solve(replace(self.problem, changes=changes), [outer])

    def when(self, j: int, sample: int) -> str:
        """Return the time of a sample in words, or its number if the set has no times."""
        time = self.sets[j].time
        return f"sample {sample}" if time is None else f"{time[sample]:.1f} s"


class Cause(NamedTuple):
    """A possible cause and its fit."""

    words: str  # description of the cause, for a message
    cure: str  # advice for the user
    solution: Solution  # of the problem with this cause
    free: int  # number of additional unknowns
    choices: int  # number of equally likely alternatives of this kind
