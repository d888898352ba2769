r"""An offset that drifts while a set is taken; private.

A drift is a sum of the slowest cosines over the set's time T,
:math:`o(t) = \sum_{k \le d} a_k \cos(\pi k t / T)`, with free coefficients: the likeliest shapes of a random
walk. Faster ones would be taken for the limb's turning.
"""

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ.dataset import InSituSet

__all__ = ["offset_basis"]

Matrix = NDArray[np.float64]

_SHORTEST = 8.0
"""Half periods in s that a set must hold for each cosine."""


def offset_basis(
    data: InSituSet, index: NDArray[np.float64], drift: int
) -> tuple[Matrix, NDArray[np.float64], NDArray[np.float64]]:
    """Compute b, shape (m, d), and its values at the middle and the end of the set, (d,) each.

    Args:
        data: The set.
        index: Places in the set at which to compute it, shape (m,).
        drift: Number of cosines; a set without times or a short one has fewer.
    """
    share = np.zeros(len(index))
    modes = 0
    if data.time is not None and len(data.time) > 1:
        duration = data.time[-1] - data.time[0]
        modes = min(drift, int(duration / _SHORTEST))
        share = (np.interp(index, np.arange(len(data.time)), data.time) - data.time[0]) / duration
    places = np.concatenate([share, [0.5, 1.0]])
    basis = np.cos(np.pi * places[:, None] * np.arange(modes + 1))
    return basis[:-2], basis[-2], basis[-1]
