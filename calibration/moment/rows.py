"""Blocks of samples, the linear rows that are written of them, and what rows leave unexplained.

Rows are in body weights and in body weights times foot lengths; columns are the unknowns of
:class:`~surefoot.calibration.moment.unknowns.Unknowns`. Three modules write them:
:mod:`~surefoot.calibration.moment.newton_euler` for the whole robot,
:mod:`~surefoot.calibration.moment.tare` for feet in the air and
:mod:`~surefoot.calibration.moment.parity` for several instruments in one foot.
"""

from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array

_CLIP = 30.0
"""Largest squared normalised residual that counts: one row that is far off must not decide alone."""


class Block(NamedTuple):
    """n samples in a row, oldest first; F feet.

    The first and the last ``settle`` samples are only looked at, those between are learnt from.

    Attributes:
        force: Forces by the starting map in N, shape (n, K).
        motion: Flat references, shape (n, R).
        swing: Feet surely in the air (0 or 1), shape (n, F).
        use: Samples that may be learnt from (0 or 1), shape (n,).
        stand: Samples at which a foot surely stands (0 or 1), shape (n,): only then does a motion ask for a
            force of the ground.
    """

    force: Array
    motion: Array
    swing: Array
    use: Array
    stand: Array


class Rows(NamedTuple):
    """m linear equations H x = y + e; a row of zeros with y = 0 holds nothing.

    Attributes:
        H: Shape (m, N).
        y: Shape (m,).
        variance: Of e, positive, shape (m,).
    """

    H: Array
    y: Array
    variance: Array

    def keep(self, share: Array) -> "Rows":
        """Return the rows that are kept (1), shape (m,); others (0) hold nothing."""
        return Rows(self.H * share[:, None], self.y * share, self.variance)

    def none(self) -> "Rows":
        """Return as many rows that hold nothing."""
        return Rows(np.zeros_like(self.H), np.zeros_like(self.y), self.variance)

    def beside(self, other: "Rows") -> "Rows":
        """Return these rows with those of another kind behind them."""
        return Rows(*(np.concatenate(both) for both in zip(self, other, strict=True)))


class Residuals(NamedTuple):
    """What m rows leave unexplained.

    Attributes:
        residual: y - H x, shape (m,).
        variance: What it may be: the diagonal of H S H' + R, shape (m,).
        there: Rows that hold anything (0 or 1), shape (m,).
        mean: The mean squared normalised residual, each clipped.
    """

    residual: Array
    variance: Array
    there: Array
    mean: float

    @classmethod
    def of(cls, rows: Rows, mean: Array, covariance: Array) -> "Residuals":
        """Return those of rows for unknowns with a covariance, shapes (N,) and (N, N)."""
        residual = rows.y - rows.H @ mean
        variance = ((rows.H @ covariance) * rows.H).sum(axis=1) + rows.variance
        there = (rows.H != 0.0).any(axis=1).astype(np.float64)
        found = cls(residual, variance, there, 0.0)
        return found._replace(mean=found.mean_square(_CLIP))

    def squares(self, largest: float) -> Array:
        """Return the squared normalised residuals, each at most so large, shape (m,)."""
        return np.minimum(self.residual * self.residual / self.variance, largest)

    def mean_square(self, largest: float) -> float:
        """Return the mean of :meth:`squares` over the rows that hold anything."""
        return float(self.squares(largest) @ self.there / max(self.there.sum(), 1.0))

    def mean_with(self, change: Array) -> Array:
        """Return the mean for residuals that hypotheses change, shape (m, H) to (H,)."""
        residual = self.residual[:, None] + change
        square = np.minimum(residual * residual / self.variance[:, None], _CLIP)
        return self.there @ square / max(self.there.sum(), 1.0)
