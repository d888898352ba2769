"""The map that a calibrator starts from, as a user gives it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Parameters


def starting_map(initial: Any, channels: int) -> str | Parameters:
    """Read the map to start from.

    Args:
        initial: ``"nominal"``, ``"bench"``, or one scale and one offset a channel, as
            :class:`~surefoot.calibration.Parameters` or a mapping.
        channels: Number of channels.

    Raises:
        ValueError: If it is none of these.
    """
    if isinstance(initial, str) and initial in ("nominal", "bench"):
        return initial
    if isinstance(initial, Parameters):
        initial = initial._asdict()
    if not isinstance(initial, Mapping):
        raise ValueError(
            "'initial' must be 'nominal', 'bench' or Parameters (scale, offset), also as a mapping, "
            f"got {initial!r}."
        )
    if set(initial) != set(Parameters._fields):
        raise ValueError(
            f"'initial' as a mapping must have exactly the keys {list(Parameters._fields)}, "
            f"got {list(initial)}."
        )
    return Parameters(*(_channels(name, initial[name], channels) for name in Parameters._fields))


def _channels(name: str, given: Any, channels: int) -> NDArray[np.float64]:
    """Read one finite number a channel."""
    try:
        # A copy: what the caller does to its array later must not change where an episode starts.
        part = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        part = np.empty(0)
    if part.shape != (channels,) or not np.isfinite(part).all():
        raise ValueError(
            f"'initial.{name}' must hold one finite number for each of the {channels} channels, "
            f"got {given!r}."
        )
    return part
