r"""How bad the sensors are: the posterior under several priors, weighed by evidence.

The filter runs on a wide prior, N(x0, P0). Its posterior N(x, P) holds the data's evidence: the information
I = P^-1 - P0^-1, and i = P^-1 (x - x0), of scales and offsets alone: the rest of the state has one prior, and
is integrated out. Under another prior D,

    V = (I + D^-1)^-1,    m = x0 + V i,    2 log evidence = i' V i + log det V - log det D

exactly so for sensors that stay as they are. The mixture of all of them is published. A mixture of
modes may be wider than P0 in some direction: there the data say nothing. Sensors are rated by how many
readings a unit of force gives, g, and a scale is a = 1/g: the prior of g, N(1, s^2), is over a as steep as
N(1, s^2 a^3), which is the prior of a scale, with a as it was published last. Drift u since the start has
one prior for all: the tares say how fast sensors drift, and zeros that stay say nothing of how far off they
started. It follows from scales and offsets as the filter has it, by G = P_ux P^-1.
"""

from itertools import product
from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.moment.columns import WIDE, Columns, Spread, first_mean
from surefoot.calibration.moment.modes import combine
from surefoot.calibration.moment.state import Publication

SEVERITIES = (0.04, 0.2, 1.0, 3.0)
"""How far off sensors may be, in stated standard deviations: calibrated, well kept, as stated, neglected."""

LIKELY = (0.04, 0.08, 0.78, 0.1)
"""How likely each of them is before anything was seen: a few directions that happen to agree are no proof of
good sensors, and a swing shows eight offsets at once."""

FIRST_RATE = float(np.sqrt(np.dot(LIKELY, np.square(SEVERITIES))))
"""How many times faster than stated sensors are thought to drift before any tare has shown it: the root mean
square over how bad they may be."""

NEAR = (0.5, 2.0)
"""Scales between which a scale's prior follows it: there each step from prior to posterior and back is
shorter than the one before (0.75 (a - 1) / a of it, where data and prior are as sure)."""

LEAST_SHARE = 1e-12  # least share of its variance that anything is known to: less is rounding


class Weighed(NamedTuple):
    """The posteriors of J modes under all severities; M unknowns, K channels."""

    evidence: Array  # logarithm of how much likelier the data are than under the wide prior, shape (J,)
    mean: Array  # scales, offsets and drift, shape (J, M)
    covariance: Array  # theirs, shape (J, M, M)
    undetermined: Array  # share of each scale's variance that the data have left, shape (J, K)

    def publish(self, chance: Array) -> Publication:
        """Combine all modes by how likely they are, shape (J,)."""
        mean, covariance = combine(chance, self.mean, self.covariance)
        return Publication(mean, covariance, np.clip(chance @ self.undetermined, 0.0, 1.0))


class Severity:
    """Weighs priors for one setup.

    Args:
        columns: The unknowns.
        spread: How sure they are at the start, as stated.
    """

    def __init__(self, columns: Columns, spread: Spread) -> None:
        self._columns, self._spread = columns, spread
        self._of = slice(0, columns.offset.stop)
        self._start = first_mean(columns)[self._of]
        pairs = list(product(range(len(SEVERITIES)), repeat=2))
        self._of_scale, self._of_offset = (
            np.array([SEVERITIES[pair[part]] for pair in pairs]) ** 2 for part in (0, 1)
        )
        self._likely = np.log([LIKELY[i] * LIKELY[j] for i, j in pairs])

    def prior(self, drifted: float, published: Array) -> Array:
        """Return the variances of scales and offsets under all severities, shape (S, 2K).

        Args:
            drifted: Variance that scales have drifted by.
            published: The scales that were published last, shape (K,).
        """
        spread, skew = self._spread, np.clip(published, *NEAR) ** 3
        parts = (
            np.outer(self._of_scale, (spread.scale + drifted) * skew),
            np.outer(self._of_offset, spread.offset),
        )
        return np.concatenate(parts, axis=1)

    def evidence(self, mean: Array, covariance: Array, drifted: float, published: Array) -> Array:
        """Return the evidence alone, as of :class:`Weighed`, shape (J,); arguments as of :meth:`weigh`."""
        return _total(self._compare(mean, covariance, drifted, published).evidence)

    def weigh(self, mean: Array, covariance: Array, drifted: float, published: Array) -> Weighed:
        """Return the posteriors under all severities together.

        Args:
            mean: The filter's unknowns, shape (J, N).
            covariance: Theirs, shape (J, N, N).
            drifted: As of :meth:`prior`.
            published: As of :meth:`prior`.
        """
        K, of, drift = self._spread.scale.size, self._of, self._columns.drift
        std, prior, precision, found, evidence = self._compare(mean, covariance, drifted, published)
        V = np.linalg.inv(precision)
        weight = np.exp(evidence - evidence.max(axis=1, keepdims=True))
        weight = weight / weight.sum(axis=1, keepdims=True)
        parts = [combine(*one) for one in zip(weight, found, V, strict=True)]
        mixed, within = (np.stack(part) for part in zip(*parts, strict=True))
        own = 0.5 * (within + within.swapaxes(1, 2)) * np.outer(std, std)
        first = self._start + std * mixed
        G = np.linalg.solve(covariance[:, of, of], covariance[:, of, drift]).swapaxes(1, 2)
        crossed, left = G @ own, covariance[:, drift, drift] - G @ covariance[:, of, drift]
        moved = np.einsum("jkm,jm->jk", G, first - mean[:, of])
        return Weighed(
            evidence=_total(evidence),
            mean=np.concatenate([first, mean[:, drift] + moved], axis=1),
            covariance=np.block(
                [[own, crossed.swapaxes(1, 2)], [crossed, left + crossed @ G.swapaxes(1, 2)]]
            ),
            undetermined=np.diagonal(within, axis1=1, axis2=2)[:, :K] / (weight @ prior[:, :K]),
        )

    def _compare(self, mean: Array, covariance: Array, drifted: float, published: Array) -> "_Compared":
        """Hold all severities against the data; arguments as of :meth:`weigh`."""
        of, spread = self._of, self._spread
        std = np.sqrt(np.concatenate([WIDE**2 * spread.scale + drifted, WIDE**2 * spread.offset]))
        # In standard deviations of the wide prior, which is 1 there.
        share, axes = np.linalg.eigh(covariance[:, of, of] / np.outer(std, std))
        share = np.clip(share, LEAST_SHARE, None)
        informed = share < 1.0
        information = np.where(informed, 1.0 / share - 1.0, 0.0)
        off = np.einsum("jmi,jm->ji", axes, (mean[:, of] - self._start) / std)
        pull = np.einsum("jmi,ji->jm", axes, np.where(informed, off / share, 0.0))
        precision = np.einsum("jmi,ji,jni->jmn", axes, information, axes)[:, None]
        prior = self.prior(drifted, published) / std**2
        at = np.arange(len(std))
        precision = np.repeat(precision, len(prior), axis=1)
        precision[..., at, at] += 1.0 / prior
        found = np.linalg.solve(precision, pull[:, None, :, None])[..., 0]
        evidence = 0.5 * (
            np.einsum("jsm,jm->js", found, pull) - np.linalg.slogdet(precision)[1] - np.log(prior).sum(axis=1)
        )
        # Under the wide prior itself, against which the others are weighed.
        known = 1.0 + information
        mine = 0.5 * np.where(informed, (off / share) ** 2 / known - np.log(known), 0.0).sum(axis=1)
        return _Compared(std, prior, precision, found, evidence + self._likely - mine[:, None])


class _Compared(NamedTuple):
    """All severities against the data of J modes, in standard deviations of the wide prior.

    S severities; M are the scales and offsets here.
    """

    std: Array  # these standard deviations, shape (M,)
    prior: Array  # variances of the severities' priors, shape (S, M)
    precision: Array  # of the posteriors, shape (J, S, M, M)
    found: Array  # their means, less the start, shape (J, S, M)
    evidence: Array  # logarithm of how much likelier each is than the wide prior, shape (J, S)


def _total(evidence: Array) -> Array:
    """Return the logarithmic evidence of all severities together, shapes (J, S) to (J,)."""
    most = evidence.max(axis=1)
    total: Array = most + np.log(np.exp(evidence - most[:, None]).sum(axis=1))
    return total
