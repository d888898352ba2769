"""Temperatures about one at which the offsets hold; private."""

from dataclasses import replace

import numpy as np

from surefoot.calibration.in_situ.dataset import InSituSet

__all__ = ["about_one_temperature"]

_LEAST = 0.3
"""Standard deviation in K that a temperature must have within sets to tell its effect."""


def about_one_temperature(
    sets: tuple[InSituSet, ...],
) -> tuple[tuple[InSituSet, ...], float | None, tuple[str, ...]]:
    """Take the mean off the temperatures, or leave them out where they tell nothing.

    Args:
        sets: With temperatures or without.

    Returns:
        The sets, the mean, None if the temperature is left out, and warnings.
    """
    given = [data.temperature for data in sets if data.temperature is not None]
    if not given:
        return sets, None, ()
    without = tuple(replace(data, temperature=None) for data in sets)
    if len(given) < len(sets):
        missing = ", ".join(f"'{data.name}'" for data in sets if data.temperature is None)
        return without, None, (f"{missing} has no temperature, so that of the others was left out.",)
    within = float(np.sqrt(np.mean([np.nanvar(one) for one in given])))
    if within < _LEAST:
        return (
            without,
            None,
            (
                f"The temperature varies by {within:.2g} K within sets, too little to tell its effect "
                f"({_LEAST} K): it was left out.",
            ),
        )
    mean = float(np.nanmean(np.concatenate(given)))
    centred = [replace(data, temperature=one - mean) for data, one in zip(sets, given, strict=True)]
    return tuple(centred), mean, ()
