"""Rare events: change the few readings that something happens to, at a cost that goes with the few.

Where events come with the probability p to each reading on its own, the number of readings that are spared
between two of them is geometric, :math:`P(n) = p (1 - p)^n`, so that one draw an event finds them, instead of
one a reading. Only a batch that draws from one generator is searched like that: for one robot it is not worth
it, and a robot with a stream of its own must draw the same whatever happens to others.
"""

from collections.abc import Callable
from math import log1p
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.sensors.corruption import Array, Rng
from surefoot.sensors.randomness import Stream, uniform

FEW = 64
"""Readings up to which all are looked at: a robot's, not a batch's."""

RARE = 0.1
"""Probability up to which events are searched for."""

Hits = NDArray[np.bool_]

Change = Callable[..., Array]
"""Takes some readings, whatever their shape, and as many values of each table; returns them changed."""


def change_at_random(
    reading: Array, probability: float, change: Change, rng: Rng, *tables: ArrayLike
) -> Array:
    """Change each reading with a probability, each on its own.

    Args:
        reading: Shape (..., K); it is not changed.
        probability: From 0 to 1.
        change: What happens to a reading.
        rng: Where chance comes from.
        *tables: Values that go with the channels, numbers or shapes (K,), for ``change``.
    """
    if probability > RARE or not _searched(reading, rng):
        hit = uniform(rng, 0.0, 1.0, reading.shape) < probability
        return change_where(reading, hit, change, rng, *tables)
    if probability == 0.0:
        return reading + 0.0
    return _change_at(reading, _found(rng, probability, reading.size), change, tables)


def change_where(reading: Array, hit: Hits, change: Change, rng: Rng, *tables: ArrayLike) -> Array:
    """Change the readings that were hit; arguments as for :func:`change_at_random`."""
    if not _searched(reading, rng):
        return np.where(hit, change(reading, *tables), reading)
    return _change_at(reading, np.flatnonzero(hit), change, tables)


def change_rows(reading: Array, hit: Hits, change: Callable[[Array], Array], rng: Rng) -> Array:
    """Change whole groups of channels.

    Args:
        reading: Shape (..., G C), G groups of C channels; it is not changed.
        hit: Which groups, shape (..., G).
        change: What happens to groups; takes some, shape (..., C), and returns them changed.
        rng: Where it draws from.
    """
    size = reading.shape[-1] // hit.shape[-1]
    if not _searched(hit, rng):
        groups = reading.reshape((*hit.shape, size))
        return np.where(hit[..., None], change(groups), groups).reshape(reading.shape)
    changed, where = (reading + 0.0).reshape((-1, size)), np.flatnonzero(hit)
    if len(where):
        changed[where] = change(changed[where])
    return changed.reshape(reading.shape)


def replace_where(reading: Array, other: Array, hit: Hits, rare: bool) -> Array:
    """Replace the readings that were hit by others, except where those are NaN.

    Args:
        reading: Shape (..., K); it is not changed.
        other: What takes their place, of the same shape.
        hit: Which, shape (..., K), or (..., 1) for all channels alike.
        rare: Whether few are.
    """
    if not rare or reading.size <= FEW:
        return np.where(hit & ~np.isnan(other), other, reading)
    rows, where = (-1, reading.shape[-1] // hit.shape[-1]), np.flatnonzero(hit)
    replaced, new = (reading + 0.0).reshape(rows), other.reshape(rows)[where]
    replaced[where] = np.where(np.isnan(new), replaced[where], new)
    return replaced.reshape(reading.shape)


def _searched(reading: NDArray[Any], rng: Rng) -> bool:
    # What a robot draws from a stream of its own must not depend on what happens to the others.
    return reading.size > FEW and not isinstance(rng, Stream)


def _change_at(
    reading: Array, where: NDArray[np.intp], change: Change, tables: tuple[ArrayLike, ...]
) -> Array:
    changed = (reading + 0.0).ravel()
    if len(where):
        channels = where % reading.shape[-1]
        values = (np.broadcast_to(table, reading.shape[-1:])[channels] for table in tables)
        changed[where] = change(changed[where], *values)
    return changed.reshape(reading.shape)


def _found(rng: Rng, probability: float, total: int) -> NDArray[np.intp]:
    """Return where events are among ``total`` readings, in order."""
    expected = probability * total
    shape = (int(expected + 6.0 * expected**0.5) + 8,)
    at = _sum_of_gaps(uniform(rng, 0.0, 1.0, shape), probability)
    while at[-1] < total:
        more = _sum_of_gaps(uniform(rng, 0.0, 1.0, shape), probability)
        at = np.concatenate([at, at[-1] + 1.0 + more])
    return at[: np.searchsorted(at, total)].astype(np.intp)


def _sum_of_gaps(drawn: Array, probability: float) -> Array:
    gaps = np.floor(np.log1p(-drawn) / log1p(-probability))
    return np.cumsum(gaps + 1.0) - 1.0
