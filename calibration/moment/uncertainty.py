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
from surefoot.calibration.setup import OnlineSetup


class Uncertainty:
    """Covariances in the units of an estimate.

    Args:
        setup: The robot.
        unknowns: The unknowns.
    """

    def __init__(self, setup: OnlineSetup, unknowns: Unknowns) -> None:
        K = setup.layout.channels
        self.unknowns = unknowns
        self._own_scales = np.eye(K, unknowns.map.stop)
        self._identity = np.eye(K)

    def of_parameters(self, mean: Array, covariance: Array) -> Array:
        """Return the covariance of (a, b) of each channel, shape (..., 2K, 2K), for that of the unknowns.

        Args:
            mean: The unknowns, shape (..., N).
            covariance: That of scales and offsets, shape (..., P + K, P + K).
        """
        unknowns = self.unknowns
        # b is the force at a reading of no force by the starting map.
        offsets = self.to_force(mean, np.zeros_like(mean[..., unknowns.offset]))
        rows = np.concatenate([self._own_scales + 0.0 * offsets[..., :1], offsets], axis=-2)
        return rows @ covariance @ rows.mT

    def of_channels(self, learnt: Array) -> Array:
        """Return what single forces need: variances of a, twice those of a with b, of b, shape (..., 3, K).

        Args:
            learnt: Covariance of (a, b), shape (..., 2K, 2K).
        """
        K = self.unknowns.channels
        own = np.linalg.diagonal(learnt)
        return np.stack([own[..., :K], 2.0 * np.linalg.diagonal(learnt[..., :K, K:]), own[..., K:]], axis=-2)

    def of_estimate(self, estimate: Estimate, sample: Sample, state: MomentState) -> dict[str, Array]:
        """Return how sure an estimate is, by the names of its fields.

        Args:
            estimate: The estimate.
            sample: The sample that it is of.
            state: What the filter knows.
        """
        unknowns, F0 = self.unknowns, sample.force
        rows, load = sample.rows[..., 0, :, :], estimate.vgrf[..., 0]
        if sample.rows.shape[-3] == 2:
            rows, load = rows + sample.rows[..., 1, :, :], load + estimate.vgrf[..., 1]
        covariance = state.learnt
        if unknowns.diagonal and not state.faults.altered:
            scale, cross, offset = state.spread[..., 0, :], state.spread[..., 1, :], state.spread[..., 2, :]
            variance = (F0 * scale + cross) * F0 + offset
            row = np.concatenate([rows * F0[..., None, :], rows], axis=-1)
        else:
            to_force = self._to_force_by_map(F0) if unknowns.diagonal else self.to_force(state.given, F0)
            if state.faults.altered:
                to_force = state.faults.spare @ to_force
            if not unknowns.diagonal:
                covariance = state.given_covariance
            variance = variances(to_force, covariance) + state.faults.spare_std**2
            row = rows @ to_force
        if not estimate.cop_valid.all():
            load = np.where(estimate.cop_valid, load, 1.0)
        turned = to_cop(row, estimate.cop, load)
        return {
            "covariance": state.learnt,
            "force_std": np.sqrt(np.where(variance > 0.0, variance, 0.0)),
            "cop_covariance": turned @ covariance @ turned.mT,
            "matrix": None if unknowns.diagonal else unknowns.matrix(state.given),
        }

    def to_force(self, mean: Array, force: Array) -> Array:
        """Return what scales and offsets do to the forces, shape (..., K, P + K).

        Args:
            mean: The unknowns, shape (..., N).
            force: Forces by the starting map in N, shape (..., K).
        """
        unknowns = self.unknowns
        scales = unknowns.by_scale(self._identity, unknowns.tared(mean, force))
        offsets = unknowns.by_offset(self._identity, mean)
        return np.concatenate([scales, offsets + 0.0 * scales[..., :1]], axis=-1)

    def _to_force_by_map(self, force: Array) -> Array:
        """Return what (a, b) of each channel do to the forces, shape (..., K, 2K)."""
        scales = self._identity * force[..., None, :]
        return np.concatenate([scales, self._identity + 0.0 * scales], axis=-1)


def variances(row: Array, covariance: Array) -> Array:
    """Return variances along rows, shapes (..., m, n) and (..., n, n) to (..., m)."""
    return ((row @ covariance) * row).sum(axis=-1)


def to_cop(row: Array, cop: Array, load: Array) -> Array:
    """Return rows that take what moments are known by to the centre of pressure, to first order.

    Args:
        row: Rows of (Fz, Fz px, Fz py), shape (..., 3, n).
        cop: Centre of pressure in m, shape (..., 2).
        load: Fz in N, shape (...).

    Returns:
        Shape (..., 2, n).
    """
    return (row[..., 1:, :] - cop[..., None] * row[..., :1, :]) / load[..., None, None]
