"""How sure the moment filter is of its estimates.

With F_i = a_i F0_i + b_i and S the covariance of (a, b), the variance of a force is that of its row (F0_i,
1), and the centre of pressure p = n / Fz has, to first order, the covariance J S J' with J_i = (p_i - p) / Fz
times the same row.
"""

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.front_end.readings import Sample
from surefoot.calibration.moment.state import MomentState
from surefoot.calibration.moment.unknowns import Unknowns


class Uncertainty:
    """Covariances in the units of an estimate.

    Args:
        unknowns: The unknowns.
    """

    def __init__(self, unknowns: Unknowns) -> None:
        self.unknowns = unknowns
        self._own_scales = np.eye(unknowns.channels, unknowns.map.stop)
        self._identity = np.eye(unknowns.channels)

    def of_parameters(self, mean: Array, covariance: Array) -> Array:
        """Return the covariance of (a, b) of each channel, shape (2K, 2K), for that of the unknowns.

        Args:
            mean: The unknowns, shape (N,).
            covariance: That of scales and offsets, shape (P + K, P + K).
        """
        # b is the force at a reading of no force by the starting map.
        rows = np.vstack([self._own_scales, self.to_force(mean, np.zeros(self.unknowns.channels))])
        return rows @ covariance @ rows.T

    def of_channels(self, learnt: Array) -> Array:
        """Return what single forces need: variances of a, twice those of a with b, of b, shape (3, K).

        Args:
            learnt: Covariance of (a, b), shape (2K, 2K).
        """
        K, own = self.unknowns.channels, np.diagonal(learnt)
        return np.stack([own[:K], 2.0 * np.diagonal(learnt[:K, K:]), own[K:]])

    def of_estimate(self, estimate: Estimate, sample: Sample, state: MomentState) -> dict[str, Array]:
        """Return how sure an estimate is, by the names of its fields.

        Args:
            estimate: The estimate.
            sample: The sample that it is of.
            state: What the filter knows.
        """
        unknowns, F0, rows = self.unknowns, sample.force, sample.rows.sum(axis=0)
        covariance = state.learnt
        if unknowns.diagonal and not state.faults.altered:
            scale, cross, offset = state.spread
            variance = (F0 * scale + cross) * F0 + offset
            row = np.hstack([rows * F0, rows])
        else:
            if unknowns.diagonal:
                to_force = np.hstack([self._identity * F0, self._identity])
            else:
                to_force, covariance = self.to_force(state.given, F0), state.given_covariance
            if state.faults.altered:
                to_force = state.faults.spare @ to_force
            variance = variances(to_force, covariance) + state.faults.spare_std**2
            row = rows @ to_force
        load = estimate.vgrf.sum() if estimate.cop_valid else 1.0
        turned = to_cop(row, estimate.cop, load)
        return {
            "covariance": state.learnt,
            "force_std": np.sqrt(np.maximum(variance, 0.0)),
            "cop_covariance": turned @ covariance @ turned.T,
            "matrix": None if unknowns.diagonal else unknowns.matrix(state.given),
        }

    def to_force(self, mean: Array, force: Array) -> Array:
        """Return what scales and offsets do to the forces, shape (K, P + K).

        Args:
            mean: The unknowns, shape (N,).
            force: Forces by the starting map in N, shape (K,).
        """
        scales = self.unknowns.by_scale(self._identity, self.unknowns.tared(mean, force))
        return np.hstack([scales, self.unknowns.by_offset(self._identity, mean)])


def variances(row: Array, covariance: Array) -> Array:
    """Return variances along rows, shapes (m, n) and (n, n) to (m,)."""
    return ((row @ covariance) * row).sum(axis=1)


def to_cop(row: Array, cop: Array, load: float) -> Array:
    """Return rows that take what moments are known by to the centre of pressure, to first order.

    Args:
        row: Rows of (Fz, Fz px, Fz py), shape (3, n).
        cop: Centre of pressure in m, shape (2,).
        load: Fz in N.

    Returns:
        Shape (2, n).
    """
    return (row[1:] - cop[:, None] * row[:1]) / load
