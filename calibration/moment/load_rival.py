"""A load that the robot was given: what faults of channels are held against; private.

It is another mass and another centre of mass, constant from then on: both are fitted to what the rows leave
unexplained since all began to seem wrong.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration._constants import Constants, namespace_of
from surefoot.calibration.moment.rows import Misfit

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""

_LOOSE = 3.0
"""How many times the standard deviation of a change a load may make."""

_LIGHTER = 0.02
"""Share of its mass that a robot may seem to lack under a load: what it never carried it cannot put down."""


class LoadRival:
    """Fits loads.

    Args:
        change: Standard deviations of what a load changes, (centre of mass in foot lengths (2), mass), shape
            (3,).
    """

    def __init__(self, change: NDArray[np.float64]) -> None:
        largest = _LOOSE * change
        self._constants = Constants(np.diag(1.0 / np.maximum(largest, 1e-3) ** 2), largest)

    def fit(self, sums: Array, misfit: Misfit, loads: Array, mass: Array) -> tuple[Array, Array, Array]:
        """Fit a load to all blocks since something seemed wrong.

        Args:
            sums: Normal equations of the blocks before, shape (..., 3, 4).
            misfit: What the m rows of this block leave unexplained.
            loads: Columns of what a load changes, shape (..., m, 3).
            mass: Believed mass over the estimated one, less 1, shape (...).

        Returns:
            The normal equations with this block, what the load does to its residuals, shape (..., m), and
            whether there can be such a load (bool), shape (...).
        """
        xp = namespace_of(loads)
        loose, largest = self._constants.like(loads)
        both = xp.concat([loads, misfit.residual[..., None]], axis=-1)
        sums = sums + (loads * (misfit.there / misfit.variance)[..., None]).mT @ both
        fit = xp.linalg.solve(sums[..., :3] + loose, sums[..., 3:])
        plausible = xp.all(xp.abs(fit[..., 0]) <= largest, axis=-1) & (mass + fit[..., 2, 0] < _LIGHTER)
        return sums, -(loads @ fit)[..., 0], plausible
