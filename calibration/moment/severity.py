r"""How bad the sensors are: the posterior under several priors, weighed by evidence.

The filter runs on a wide prior, N(x0, P0). A narrower one, N(x0, D), is that and a measurement of scales and
offsets which finds the start, x0, with a variance E of its own, D^-1 = P0^-1 + E^-1. So a posterior of the
filter, N(x, P), becomes that under the other prior by one more update, and evidence is the likelihood of what
this measurement finds, by the one that it had at first:

    K = P (P + E)^-1,    m = x - K (x - x0),    V = P - K P,    evidence = N(x0; x, P + E) / N(x0; x0, P0 + E)

exactly so for sensors that stay as they are. No prior is wider than the filter's own. The mixture of all of
them is published. Drift u since the start has one prior for all: the tares say how fast sensors drift, and
zeros that stay say nothing of how far off they started. It follows from scales and offsets as the filter has
it.
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

LEAST_NARROWER = 1e-9
"""By what share of the wide prior's inverse variance that of another prior is larger at least: scales of
neglected sensors that have drifted for hours would have a prior wider than the filter's."""

LEAST_PUBLISHED = 1e-3
"""Chance from which on a mode is published: on 61 recordings those below it change standard deviations by
less than 0.01 % in most and by 0.4 % at most, of robots that are held."""


class Weighed(NamedTuple):
    """The posteriors of J modes under all severities; M unknowns, K channels."""

    evidence: Array  # logarithm of how much likelier the data are than under the wide prior, shape (J,)
    mean: Array  # scales, offsets and drift, shape (J, M)
    covariance: Array  # theirs, shape (J, M, M)
    undetermined: Array  # share of each scale's variance that the data have left, shape (J, K)

    def publish(self, chance: Array) -> Publication:
        """Combine all modes by how likely they are, shape (J,)."""
        chance = np.where(chance < LEAST_PUBLISHED, 0.0, chance)
        chance = chance / chance.sum()
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

    def prior(self, drifted: float) -> Array:
        """Return the variances of scales and offsets under all severities, shape (S, 2K).

        Args:
            drifted: Variance that scales have drifted by.
        """
        scale, offset = self._spread.scale + drifted, self._spread.offset
        parts = np.outer(self._of_scale, scale), np.outer(self._of_offset, offset)
        return np.minimum(np.hstack(parts), self._wide(drifted) / (1.0 + LEAST_NARROWER))

    def _wide(self, drifted: float) -> Array:
        """Return the variances of scales and offsets under the filter's own prior, shape (2K,)."""
        spread = self._spread
        return np.concatenate([WIDE**2 * spread.scale + drifted, WIDE**2 * spread.offset])

    def evidence(self, mean: Array, covariance: Array, drifted: float) -> Array:
        """Return the evidence alone, as of :class:`Weighed`, shape (J,); arguments as of :meth:`weigh`."""
        return _total(self._compare(mean, covariance, drifted).evidence)

    def weigh(self, mean: Array, covariance: Array, drifted: float) -> Weighed:
        """Return the posteriors under all severities together.

        Args:
            mean: The filter's unknowns, shape (J, N).
            covariance: Theirs, shape (J, N, N).
            drifted: As of :meth:`prior`.
        """
        of, known = self._of, self._columns.map
        std, prior, pull, inverse, evidence = self._compare(mean, covariance, drifted)
        weight = np.exp(evidence - evidence.max(axis=1, keepdims=True))
        weight = weight / weight.sum(axis=1, keepdims=True)
        parts = [combine(*one) for one in zip(weight, pull, -inverse, strict=True)]
        mixed, less = (np.stack(part) for part in zip(*parts, strict=True))
        # In standard deviations of the wide prior.
        shared = covariance[:, known, of] / std
        found = covariance[:, known, known] + shared @ less @ shared.swapaxes(1, 2)
        K = len(self._spread.scale)
        return Weighed(
            evidence=_total(evidence),
            mean=mean[:, known] - np.einsum("jmi,ji->jm", shared, mixed),
            covariance=found,
            undetermined=np.diagonal(found, axis1=1, axis2=2)[:, :K] / (weight @ prior)[:, :K],
        )

    def _compare(self, mean: Array, covariance: Array, drifted: float) -> "_Compared":
        """Hold all severities against the data; arguments as of :meth:`weigh`."""
        of, prior, wide = self._of, self.prior(drifted), self._wide(drifted)
        std, own = np.sqrt(wide), 1.0 / (wide / prior - 1.0)
        expected = (covariance[:, of, of] / np.outer(std, std))[:, None] + own[:, None] * np.eye(len(std))
        off = (mean[:, of] - self._start) / std
        inverse = np.linalg.inv(expected)
        pull = np.einsum("jsmi,ji->jsm", inverse, off)
        size = np.linalg.slogdet(expected)[1] - np.log1p(own).sum(axis=1)
        evidence = self._likely - 0.5 * (np.einsum("jsm,jm->js", pull, off) + size)
        return _Compared(std, prior, pull, inverse, evidence)


class _Compared(NamedTuple):
    """All severities against the data of J modes.

    S severities; M are the scales and offsets here.
    """

    std: Array  # standard deviations of the wide prior, shape (M,)
    prior: Array  # variances of the severities' priors, shape (S, M)
    pull: Array  # (P + E)^-1 (x - x0), in these standard deviations, shape (J, S, M)
    inverse: Array  # (P + E)^-1, likewise, shape (J, S, M, M)
    evidence: Array  # logarithm of how much likelier each is than the wide prior, shape (J, S)


def _total(evidence: Array) -> Array:
    """Return the logarithmic evidence of all severities together, shapes (J, S) to (J,)."""
    most = evidence.max(axis=1)
    total: Array = most + np.log(np.exp(evidence - most[:, None]).sum(axis=1))
    return total
