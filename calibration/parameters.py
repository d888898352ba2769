"""The affine map of every channel, and the same map relative to the starting map.

A channel reports ``raw``, and F = c raw + d (CoP paper, Eq. 2) with the scale c and the offset d. Counts of
a 24-bit converter are about 8 million with slopes of about 1e-5 N, so that c and d are badly conditioned as
unknowns. Estimators use

    F = a F0 + b,    F0 = c0 raw + d0,

where (c0, d0) is the starting map, a is close to one and b close to 0 N. The two forms are equivalent:
c = a c0 and d = a d0 + b.
"""

from typing import NamedTuple

from surefoot.calibration.arrays import Array


class Parameters(NamedTuple):
    """Scales and offsets of K channels, or of N samples with shape (N, K).

    Attributes:
        scale: Newtons per unit of the reading (a count), shape (K,).
        offset: Force at a reading of zero in N, shape (K,).

    >>> import numpy as np
    >>> nominal = Parameters(scale=np.array([2e-5, -4e-5]), offset=np.array([-160.0, 330.0]))
    >>> nominal.force(np.array([8.1e6, 8.2e6]))
    array([2., 2.])
    """

    scale: Array
    offset: Array

    def force(self, raw: Array) -> Array:
        """Return forces in N, F = c raw + d (CoP paper, Eq. 2), of readings, shape (K,) or (N, K)."""
        return self.scale * raw + self.offset

    def relative_to(self, start: "Parameters") -> "Parameters":
        """Return this map as a correction (a, b) of the forces of a starting map, F = a F0 + b, in N.

        ``scale`` is in calibrated newtons per starting newton. Scales of the starting map must not be zero.
        """
        ratio = self.scale / start.scale
        return Parameters(ratio, self.offset - ratio * start.offset)

    def after(self, start: "Parameters") -> "Parameters":
        """Return the map (c, d) = (a c0, a d0 + b) of readings to corrected forces.

        It is the inverse of :meth:`relative_to`.

        >>> import numpy as np
        >>> start = Parameters(np.array([2e-5]), np.array([-160.0]))
        >>> correction = Parameters(np.array([1.1]), np.array([0.5]))
        >>> correction.after(start).force(np.array([8.1e6]))
        array([2.7])
        """
        return Parameters(self.scale * start.scale, self.scale * start.offset + self.offset)
