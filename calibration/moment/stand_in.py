r"""How the cells of a foot stand in for each other.

A rigid plate on k cells shares three numbers, (Fz, Mx, My), among k forces, so that each force is nearly a
linear function of the others. Springs of equal stiffness give a first guess of it; the robot's own calibrated
forces, as their second moments C = E[F F'], show how its plate really shares. With both in one C, what is
expected of cell i by the others is the conditional mean of a normal distribution,

.. math:: \hat F_i = C_{io} C_{oo}^{-1} F_o, \qquad \sigma_i^2 = C_{ii} - C_{io} C_{oo}^{-1} C_{oi}.
"""

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array
from surefoot.calibration.setup import OnlineSetup

_STIFFNESS_ERROR = 0.03  # standard deviation in body weights of a force about that of equal springs

_FLOOR = 1e-5
"""Variance in body weights squared that is never gone below: the inverse is one in C's float32 too."""

_TYPICAL_ARM = 0.25
"""Typical distance of a centre of pressure from the middle of a foot, in extents of its cells."""


class StandIn:
    """Learns how cells share loads, and reconstructs those that are lost.

    Args:
        setup: The robot.
        memory: How many blocks are remembered.

    Attributes:
        cells: Channels that are cells under one plate (bool), shape (K,): others cannot be reconstructed.
        renewal: Share of the moments that one block decides.
        prior: Second moments at first in body weights squared, shape (K, K).
        together: Whether two channels are cells of one plate (0 or 1), shape (K, K).
    """

    def __init__(self, setup: OnlineSetup, memory: float) -> None:
        layout, weight = setup.layout, setup.weight
        K = layout.channels
        self.renewal = 1.0 / memory
        self.cells: NDArray[np.bool_] = np.zeros(K, dtype=bool)
        prior, together = np.eye(K), np.eye(K)
        for foot, where in zip(layout.feet, layout.slices, strict=True):
            for sensor in foot.sensors:
                if sensor.six_axis:
                    continue
                index = np.arange(where.start, where.stop)[sensor.channels]
                load = sensor.wrench_map[2:5]
                if np.linalg.matrix_rank(load) < 3:
                    continue
                share = load.T @ np.linalg.inv(load @ load.T)
                arm = _TYPICAL_ARM * np.ptp(load[1:], axis=1)
                spread = np.diag([1.0, *arm]) ** 2 / 4.0
                ridge = _STIFFNESS_ERROR**2 * np.eye(len(index))
                prior[np.ix_(index, index)] = share @ spread @ share.T + ridge
                together[np.ix_(index, index)] = 1.0
                self.cells[index] = True
        self.prior, self.together = prior, together
        self._weight = weight

    def count_lost(self, lost: Array) -> Array:
        """Count the lost channels of each channel's plate, shape (K,); ``lost`` is 0 or 1, shape (K,)."""
        count: Array = self.together @ lost
        return count

    def init(self) -> Array:
        """Begin with equal springs: second moments in body weights squared, shape (K, K)."""
        return self.prior.copy()

    def learn(self, moments: Array, force: Array) -> Array:
        """Take in forces that are trusted.

        Args:
            moments: Second moments of forces, shape (K, K).
            force: Calibrated forces of one block in N, shape (n, K).
        """
        scaled = force / self._weight
        seen = scaled.T @ scaled / len(scaled) * self.together
        return moments + self.renewal * (seen - moments)

    def others(self, moments: Array, lost: Array) -> tuple[Array, Array]:
        """Return how each channel follows from those that are not lost.

        Args:
            moments: Second moments of forces, shape (K, K).
            lost: Channels that are out (0 or 1), shape (K,).

        Returns:
            Coefficients without a channel's own, shape (K, K), and standard deviations in N, shape (K,).
        """
        identity, there = np.eye(len(lost)), 1.0 - lost
        moments = moments + _FLOOR * identity
        # Lost channels are cut off from the others, so that the inverse is that of those that are there.
        precision = np.linalg.inv(moments * np.outer(there, there) + np.diag(lost))
        own = np.diagonal(precision)
        by_others = (identity - precision / own[:, None]) * there
        # For a lost channel: C_io C_oo^-1, with all of those that are there.
        of_lost = (moments * there) @ precision * there * lost[:, None]
        variance = np.diagonal(moments) - (of_lost * moments).sum(axis=1)
        variance = np.where(lost > 0.5, variance, 1.0 / own)
        spread = np.sqrt(np.maximum(variance, 0.0)) * self._weight
        return by_others * there[:, None] + of_lost, spread
