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

from surefoot.calibration.arrays import Array, Constants, namespace_of
from surefoot.calibration.moment.unknowns import Unknowns

SEVERITIES = (0.04, 0.2, 1.0, 5.0)
"""How far off sensors may be, in stated standard deviations: calibrated, well kept, as stated, neglected."""

LIKELY = (0.1, 0.1, 0.7, 0.1)
"""How likely each of them is before anything was seen."""

FIRST_WIDTH = 2.0
"""Stated standard deviations of the prior that the filter begins with."""

_LEAST = 8.0
"""Least share of its starting variance that anything is known to, in roundings of the library's numbers."""


class LearntSeverity:
    """Gives a posterior the prior that its own evidence asks for.

    Args:
        unknowns: The unknowns.
    """

    def __init__(self, unknowns: Unknowns) -> None:
        self.unknowns = unknowns
        widths = unknowns.scales, unknowns.channels
        severities = [np.repeat(pair, widths) for pair in product(SEVERITIES, repeat=2)]
        self._constants = Constants(
            variance=np.stack(severities) ** 2,
            likely=2.0 * np.log([np.prod(pair) for pair in product(LIKELY, repeat=2)]),
            stated=unknowns.std[unknowns.map] ** 2,
            identity=np.eye(unknowns.map.stop),
            start=unknowns.start[unknowns.map],
        )

    def stated(self, drift: Array) -> Array:
        """Return the variances that are stated of scales and offsets that have drifted since the start.

        Args:
            drift: Variances that they have drifted by, shape (..., M).
        """
        return self._constants.like(drift).stated + drift

    def first(self, drift: Array) -> Array:
        """Return the variances that the filter begins with, for sensors that have drifted since; as above."""
        return FIRST_WIDTH**2 * self._constants.like(drift).stated + drift

    def reweighted(self, mean: Array, covariance: Array, drift: Array, misfit: Array) -> tuple[Array, Array]:
        """Return scales and offsets under all severities together.

        Args:
            mean: The filter's unknowns, shape (..., N).
            covariance: Theirs, shape (..., N, N).
            drift: Variances that scales and offsets have drifted by since the start, shape (..., M).
            misfit: Mean square of residuals over what is expected of them, shape (...): above 1, the data are
                worth that many times less.

        Returns:
            Scales and offsets, shape (..., M), and their covariance, shape (..., M, M).
        """
        xp, own, of_map = namespace_of(mean), self._constants.like(mean), self.unknowns.map
        stated, prior = self.stated(drift), self.first(drift)
        std = xp.sqrt(prior)
        units = std[..., :, None] * std[..., None, :]
        share, axes = xp.linalg.eigh(covariance[..., of_map, of_map] / units)
        share = xp.clip(share, _LEAST * float(xp.finfo(mean.dtype).eps), 1.0)
        worth = 1.0 / xp.clip(misfit, 1.0, None)[..., None]
        seen = (axes * (worth * (1.0 / share - 1.0))[..., None, :]) @ axes.mT
        off = (mean[..., of_map] - own.start) / std
        pull = (axes @ ((axes.mT @ off[..., None]) * (worth / share)[..., None]))[..., None, :, :]

        severity = own.variance * (stated / prior)[..., None, :]
        precision = seen[..., None, :, :] + own.identity / severity[..., None, :]
        V = xp.linalg.inv(precision)
        found = V @ pull
        _, size = xp.linalg.slogdet(precision)
        evidence = xp.sum((found * pull)[..., 0], axis=-1) - size - xp.sum(xp.log(severity), axis=-1)
        evidence = evidence + own.likely
        weight = xp.exp(0.5 * (evidence - xp.max(evidence, axis=-1, keepdims=True)))
        weight = (weight / xp.sum(weight, axis=-1, keepdims=True))[..., None, None]
        mixed = xp.sum(weight * found, axis=-3)
        apart = found - mixed[..., None, :, :]
        V = xp.sum(weight * (V + apart @ apart.mT), axis=-3)
        return own.start + std * mixed[..., 0], 0.5 * (V + V.mT) * units
