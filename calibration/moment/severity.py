r"""How far sensors were off at the start, learnt from what the filter has seen.

Options state standard deviations of scales and offsets at the start. Robots begin with others: cells that
were calibrated with weights are twenty times better, neglected ones several times worse. A wide prior does
harm to a calibrated robot, as all that its reference gets wrong is then taken for an error of the sensors; a
narrow one does harm to the others.

So the filter begins with a wide prior N(x0, P0), and its posterior N(m, P) is given others afterwards. It
holds what the data alone say: the information P^-1 - P0^-1, and P^-1 (m - x0) about where the sensors are.
With D the diagonal prior of two severities, one of all scales and one of all offsets,

    V = (P^-1 - P0^-1 + D^-1)^-1,    m_D = x0 + V P^-1 (m - x0),
    2 log evidence = (m_D - x0)' V^-1 (m_D - x0) - log det(D V^-1),

exactly so for sensors that stay as they are. What is handed out is the mean of all m_D by their evidence,
with the covariance of that mixture; what is stated is taken for likelier beforehand, and so decides on a
robot that hardly moves. The filter itself goes on as it was: a severity that proves wrong later has cost
nothing.
"""

from itertools import product

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.moment.unknowns import Unknowns

SEVERITIES = (0.04, 0.2, 1.0, 5.0)
"""How far off sensors may be, in stated standard deviations: calibrated, well kept, as stated, neglected."""

LIKELY = (0.1, 0.1, 0.7, 0.1)
"""How likely each of them is before anything was seen."""

FIRST_WIDTH = 8.0
"""Stated standard deviations of the prior that the filter begins with."""

_LEAST = 8.0
"""Least share of its starting variance that anything is known to, in roundings of its numbers."""


class LearntSeverity:
    """Gives a posterior the prior that its own evidence asks for.

    Args:
        unknowns: The unknowns.
    """

    def __init__(self, unknowns: Unknowns) -> None:
        self.unknowns = unknowns
        widths = unknowns.scales, unknowns.channels
        severities = [np.repeat(pair, widths) for pair in product(SEVERITIES, repeat=2)]
        self._variance = np.stack(severities) ** 2
        self._likely = 2.0 * np.log([np.prod(pair) for pair in product(LIKELY, repeat=2)])
        self._stated = unknowns.std[unknowns.map] ** 2
        self._start = unknowns.start[unknowns.map]

    def stated(self, drift: Array) -> Array:
        """Return the variances that are stated of scales and offsets that have drifted since the start.

        Args:
            drift: Variances that they have drifted by, shape (M,).
        """
        return self._stated + drift

    def first(self, drift: Array) -> Array:
        """Return the variances that the filter begins with, for sensors that have drifted since; as above."""
        return FIRST_WIDTH**2 * self._stated + drift

    def reweighted(self, mean: Array, covariance: Array, drift: Array, misfit: float) -> tuple[Array, Array]:
        """Return scales and offsets under all severities together.

        Args:
            mean: The filter's unknowns, shape (N,).
            covariance: Theirs, shape (N, N).
            drift: Variances that scales and offsets have drifted by since the start, shape (M,).
            misfit: Mean square of residuals over what is expected of them: above 1, the data are worth that
                many times less.

        Returns:
            Scales and offsets, shape (M,), and their covariance, shape (M, M).
        """
        of_map = self.unknowns.map
        stated, prior = self.stated(drift), self.first(drift)
        # In standard deviations of the prior: P0 is 1, P has the shares along the axes.
        std = np.sqrt(prior)
        units = np.outer(std, std)
        share, axes = np.linalg.eigh(covariance[of_map, of_map] / units)
        share = np.clip(share, _LEAST * np.finfo(np.float64).eps, 1.0)
        worth = 1.0 / max(misfit, 1.0)
        seen = (axes * (worth * (1.0 / share - 1.0))) @ axes.T
        off = (mean[of_map] - self._start) / std
        pull = axes @ ((axes.T @ off) * (worth / share))

        # One prior D after the other, first in all that follows.
        D = self._variance * (stated / prior)
        precision = seen + np.eye(len(std)) / D[:, None, :]
        V = np.linalg.inv(precision)
        found = V @ pull
        _, size = np.linalg.slogdet(precision)
        evidence = found @ pull - size - np.log(D).sum(axis=1) + self._likely
        weight = np.exp(0.5 * (evidence - evidence.max()))
        weight = weight / weight.sum()
        mixed = weight @ found
        apart = found - mixed
        V = np.tensordot(weight, V, 1) + (weight * apart.T) @ apart
        return self._start + std * mixed, 0.5 * (V + V.T) * units
