"""How large residuals are against what is expected: the noise of each kind of row, and how well all fits."""

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.moment.rows import Residuals

FIRST_NOISE = 16.0
"""By how many times variances are taken as larger than assumed before anything moved, and at a first swing: a
map that was fitted to noise in the first seconds is not forgotten soon."""

_LOUDEST = 100.0
"""By how many times variances are taken as larger than assumed at most."""

_LARGEST_SQUARE = 9.0
"""Largest squared normalised innovation that the noise follows: one beyond three deviations may be wrong."""

_NOISE_MEMORY = 0.1
"""How much of the noise's factor one update renews."""

FIRST_MISFIT = 4.0
"""The misfit before anything was seen: a start that all fits is believed after some seconds."""

_LARGEST_MISFIT = 25.0
"""Largest squared normalised innovation that the misfit counts."""

_MISFIT_MEMORY = 0.06
"""How much of the misfit one update renews: it is that of some seventeen blocks."""


def followed_noise(noise: Array, residuals: Residuals) -> Array:
    """Follow how large residuals are against what is expected; never take noise for less than assumed.

    Args:
        noise: By how many times variances of each kind of row are taken as larger, shape (kinds,).
        residuals: Of rows before they are learnt from, kind by kind in turn, those that are left out as well.
    """
    surplus = (residuals.squares(_LARGEST_SQUARE) - 1.0) * residuals.there
    of_kinds = surplus.reshape(-1, len(noise)).mean(axis=0)
    return np.clip(noise * (1.0 + _NOISE_MEMORY * of_kinds), 1.0, _LOUDEST)


def followed_misfit(misfit: float, residuals: Residuals) -> float:
    """Follow the mean square of residuals over what is expected of it, of all kinds together.

    Args:
        misfit: What it was.
        residuals: As of :func:`followed_noise`.
    """
    return misfit + _MISFIT_MEMORY * (residuals.mean_square(_LARGEST_MISFIT) - misfit)
