"""The affine map of every channel, and the same map relative to where it started.

A channel reports ``raw``, and F = c raw + d (CoP paper, Eq. 2) with the scale c and the offset d. Counts of
a 24-bit converter are near 8 million with slopes of some 1e-5 N, so that c and d are badly matched as
unknowns: estimators work on

    F = a F0 + b,    F0 = c0 raw + d0,

where (c0, d0) is the starting map, a is near one and b near 0 N. The two forms are equal:
c = a c0 and d = a d0 + b.
"""

from typing import NamedTuple

from surefoot.calibration.arrays import Array


class Parameters(NamedTuple):
    """Scales and offsets of K channels; those of N samples have N first.

    Attributes:
        scale: Newtons per unit of the reading (a count), shape (K,).
        offset: Force that a reading of zero stands for in N, shape (K,).

    >>> import numpy as np
    >>> nominal = Parameters(scale=np.array([2e-5, -4e-5]), offset=np.array([-160.0, 330.0]))
    >>> nominal.force(np.array([8.1e6, 8.2e6]))
    array([2., 2.])
    """

    scale: Array
    offset: Array

    def force(self, raw: Array) -> Array:
        """Return forces in N, F = c raw + d (CoP paper, Eq. 2), of readings, (K,) or, of N, (N, K)."""
        return self.scale * raw + self.offset

    def relative_to(self, start: "Parameters") -> "Parameters":
        """Return this map as a correction (a, b) of another one's forces, F = a F0 + b, in N.

        ``scale`` is in calibrated newtons per starting newton; none of the other's scales may be zero.
        """
        ratio = self.scale / start.scale
        return Parameters(ratio, self.offset - ratio * start.offset)

    def after(self, start: "Parameters") -> "Parameters":
        """Return this correction applied to the forces of another map: the inverse of :meth:`relative_to`.

        That is (c, d) = (a c0, a d0 + b), which takes readings to corrected forces.

        >>> import numpy as np
        >>> start = Parameters(np.array([2e-5]), np.array([-160.0]))
        >>> correction = Parameters(np.array([1.1]), np.array([0.5]))
        >>> correction.after(start).force(np.array([8.1e6]))
        array([2.7])
        """
        return Parameters(self.scale * start.scale, self.scale * start.offset + self.offset)
