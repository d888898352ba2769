r"""Compare a learnt map with the starting map, by rows that neither was learnt from.

A row is the difference between what the robot's motion requires and what the feet measure: a force, or a
torque. Each map leaves a residual in it. Of n independent rows with Gaussian errors of unknown size, the
logarithm of the likelihood of the starting map over that of the learnt map is, maximised over both sizes,

.. math:: \Lambda = \frac{n}{2} \sum_c \log \frac{q_c}{q^0_c},

where q are mean squares of the residuals of component c. It has no unit, and needs no threshold in
millimetres: the evidence grows with the number of rows.

* Rows are compared before the map has learnt from them (prequential, Dawid 1984), or come from a part of a
  log that was left out.
* Errors of the robot's own model affect both maps. The constant part of a residual counts only as far as it
  exceeds ``slack``, the effect of errors in the believed mass and centre of mass.
* The noise of the rows, ``floor``, is added to both mean squares.
"""

from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array

SURE = 6.9
"""Evidence above which the learnt map counts as worse: a likelihood ratio of a thousand."""

INDEPENDENT = 1.0
"""Time in s between rows that count as independent: errors of a gait repeat within a step."""


class Residuals(NamedTuple):
    """Means over the rows of one map, for C components."""

    mean: Array  # of the residuals, shape (C,)
    square: Array  # of their squares, shape (C,)

    @classmethod
    def of(cls, rows: Array) -> "Residuals":
        """Return the means over rows, shape (N, C)."""
        return cls(rows.mean(axis=0), np.square(rows).mean(axis=0))

    def include(self, row: Array, share: Array | float) -> "Residuals":
        """Return the means with one more row, shape (C,), of weight ``share``, shape (C,) or ()."""
        return Residuals(self.mean + share * (row - self.mean), self.square + share * (row**2 - self.square))

    def excess(self, slack: Array, floor: Array) -> Array:
        """Return mean squares less the part that errors of the robot's model can explain, shape (C,)."""
        beyond = np.maximum(np.abs(self.mean) - slack, 0.0)
        varying = np.maximum(self.square - self.mean**2, 0.0)
        total: Array = varying + beyond**2 + floor
        return total


def evidence_for_start(learnt: Residuals, start: Residuals, slack: Array, floor: Array, rows: float) -> float:
    """Return the log-likelihood ratio of rows between the starting map and the learnt map.

    Above :data:`SURE` the learnt map is worse than the start.

    Args:
        learnt: Residuals of the learnt map.
        start: Residuals of the starting map in the same rows.
        slack: Constant residual that an error of the robot's own model may explain, shape (C,).
        floor: Variance of the noise of a row, positive, shape (C,).
        rows: Number of independent rows in the means.
    """
    ratio = learnt.excess(slack, floor) / start.excess(slack, floor)
    return float(0.5 * rows * np.log(ratio).sum())
