r"""Creep: under a constant load a spring element and its glue go on yielding.

The reading follows the history of the load by a few exponentials with shares :math:`s_j` and time constants
:math:`\tau_j`,

.. math:: y = x + \sum_j s_j z_j, \qquad \tau_j \dot z_j = x - z_j,

so that a step of the load to :math:`x_0` reads :math:`x_0 (1 + \sum_j s_j (1 - e^{-t / \tau_j}))`. The
discretisation is exact for a load that is constant between readings, however long that is.
"""

from collections.abc import Sequence
from math import expm1, isfinite
from typing import Any, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.sensors.configuration import require
from surefoot.sensors.corruption import Corruption, Rng


class CreepState(NamedTuple):
    """How far a spring element has yielded."""

    yielded: Floats
    """The loads that each exponential has followed so far, in the unit of the readings, shape (J, K)."""


def check_creep(config: Any) -> None:
    """Make tuples of ``creep_shares`` and as many positive ``creep_time_constants`` in s, or ValueError."""
    for name in ("creep_shares", "creep_time_constants"):
        try:
            object.__setattr__(config, name, tuple(float(value) for value in getattr(config, name)))
        except (TypeError, ValueError):
            require(False, config, name, "be a sequence of numbers")
    shares, times = config.creep_shares, config.creep_time_constants
    require(all(isfinite(share) for share in shares), config, "creep_shares", "be finite")
    require(
        len(times) == len(shares) and all(0.0 < time < float("inf") for time in times),
        config,
        "creep_time_constants",
        f"hold a positive time for each of the {len(shares)} creep_shares",
    )


def creep(shares: Sequence[float], time_constants: Sequence[float]) -> Corruption[CreepState]:
    """Add creep: readings go on changing under a constant load.

    The load is taken to have been constant since the reading before; one that is not finite leaves no trace.
    Each exponential adds a share of the load in the end, a negative one creeps back, with a time constant in
    s; without any, nothing changes. ValueError says that there are not as many of both, a share is not finite
    or a time constant not positive.
    """
    if len(shares) != len(time_constants):
        raise ValueError(
            f"Give as many 'shares' as 'time_constants', got {len(shares)} and {len(time_constants)}."
        )
    if not all(isfinite(share) for share in shares):
        raise ValueError(f"'shares' must be finite, got {shares}.")
    if not all(0.0 < constant < float("inf") for constant in time_constants):
        raise ValueError(f"'time_constants' must be finite and positive, got {time_constants}.")
    shares, time_constants = tuple(shares), tuple(time_constants)
    count = len(shares)

    def init(shape: tuple[int, ...], rng: Rng) -> CreepState:
        return CreepState(np.zeros((count, *shape)))

    def apply(reading: Floats, state: CreepState, rng: Rng, dt: float) -> tuple[Floats, CreepState]:
        if not count:
            return reading + 0.0, state
        yielded, read = [], reading
        felt = np.isfinite(reading)
        for share, constant, part in zip(shares, time_constants, state.yielded, strict=True):
            followed = part - expm1(-dt / constant) * (reading - part)
            yielded.append(np.where(felt, followed, part))
            read = read + share * yielded[-1]
        return read, CreepState(np.stack(yielded))

    return Corruption(init, apply)
