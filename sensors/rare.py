"""Rare events: change the few readings that something happens to, at a cost that goes with the few.

Where events come with the probability p to each reading on its own, the number of readings that are spared
between two of them is geometric, :math:`P(n) = p (1 - p)^n`, so that one draw an event finds them, instead of
one a reading. Only a batch on the host that draws from one generator is searched like that: for one robot it
is not worth it, on another device looking at values means waiting, and a robot with a stream of its own must
draw the same whatever happens to others.
"""

from collections.abc import Callable
from math import log1p

import numpy as np
from numpy.typing import NDArray

from surefoot.sensors.arrays import namespace, on_host
from surefoot.sensors.corruption import Array, Rng
from surefoot.sensors.randomness import Stream, uniform

FEW = 64
"""Readings up to which all are looked at: a robot's, not a batch's."""

RARE = 0.1
"""Probability up to which events are searched for."""

Change = Callable[..., Array]
"""Takes some readings, whatever their shape, and as many values of each table; returns them changed."""


def change_at_random(reading: Array, probability: float, change: Change, rng: Rng, *tables: Array) -> Array:
    """Change each reading with a probability, each on its own.

    Args:
        reading: Shape (..., K); it is not changed.
        probability: From 0 to 1.
        change: What happens to a reading.
        rng: Where chance comes from.
        *tables: Values that go with the channels, numbers or shapes (K,), for ``change``.
    """
    if probability > RARE or not _searched(reading, rng):
        hit = uniform(rng, 0.0, 1.0, tuple(reading.shape), reading.dtype) < probability
        return change_where(reading, hit, change, rng, *tables)
    if probability == 0.0:
        return reading + 0.0
    return _change_at(reading, _found(rng, probability, _count(reading)), change, tables)


def change_where(reading: Array, hit: Array, change: Change, rng: Rng, *tables: Array) -> Array:
    """Change the readings that were hit; arguments as for :func:`change_at_random`."""
    xp = namespace(reading)
    if not _searched(reading, rng):
        return xp.where(hit, change(reading, *tables), reading)
    return _change_at(reading, xp.nonzero(xp.reshape(hit, (-1,)))[0], change, tables)


def change_rows(reading: Array, hit: Array, change: Callable[[Array], Array], rng: Rng) -> Array:
    """Change whole groups of channels.

    Args:
        reading: Shape (..., G C), G groups of C channels; it is not changed.
        hit: Which groups, shape (..., G).
        change: What happens to groups; takes some, shape (..., C), and returns them changed.
        rng: Where it draws from.
    """
    xp, size = namespace(reading), reading.shape[-1] // hit.shape[-1]
    if not _searched(hit, rng):
        groups = xp.reshape(reading, (*hit.shape, size))
        return xp.reshape(xp.where(hit[..., None], change(groups), groups), reading.shape)
    changed = xp.reshape(reading + 0.0, (-1, size))
    where = xp.nonzero(xp.reshape(hit, (-1,)))[0]
    if where.shape[0]:
        changed[where] = change(changed[where])
    return xp.reshape(changed, reading.shape)


def replace_where(reading: Array, other: Array, hit: Array, rare: bool) -> Array:
    """Replace the readings that were hit by others, except where those are NaN.

    Args:
        reading: Shape (..., K); it is not changed.
        other: What takes their place, of the same shape.
        hit: Which, shape (..., K), or (..., 1) for all channels alike.
        rare: Whether few are.
    """
    xp = namespace(reading)
    if not (rare and _searched(reading, None)):
        return xp.where(hit & ~xp.isnan(other), other, reading)
    rows = (-1, reading.shape[-1] // hit.shape[-1])
    where = xp.nonzero(xp.reshape(hit, (-1,)))[0]
    replaced = xp.reshape(reading + 0.0, rows)
    new = xp.reshape(other, rows)[where]
    replaced[where] = xp.where(xp.isnan(new), replaced[where], new)
    return xp.reshape(replaced, reading.shape)


def _searched(reading: Array, rng: Rng) -> bool:
    # What a robot draws from a stream of its own must not depend on what happens to the others.
    return on_host(reading) and _count(reading) > FEW and not isinstance(rng, Stream)


def _count(reading: Array) -> int:
    count = 1
    for length in reading.shape:
        count *= length
    return count


def _change_at(reading: Array, where: Array, change: Change, tables: tuple[Array, ...]) -> Array:
    xp = namespace(reading)
    changed = xp.reshape(reading + 0.0, (-1,))
    if where.shape[0]:
        channels = where % reading.shape[-1]
        values = (xp.broadcast_to(table, reading.shape[-1:])[channels] for table in tables)
        changed[where] = change(changed[where], *values)
    return xp.reshape(changed, reading.shape)


def _found(rng: Rng, probability: float, total: int) -> Array:
    """Return where events are among ``total`` readings, in order."""
    expected = probability * total
    shape = (int(expected + 6.0 * expected**0.5) + 8,)
    drawn = uniform(rng, 0.0, 1.0, shape)
    at = _sum_of_gaps(drawn, probability)
    while at[-1] < total:
        more = _sum_of_gaps(uniform(rng, 0.0, 1.0, shape), probability)
        at = np.concatenate([at, at[-1] + 1.0 + more])
    found = at[: np.searchsorted(at, total)].astype(np.int64)
    return namespace(drawn).asarray(found)


def _sum_of_gaps(drawn: Array, probability: float) -> NDArray[np.float64]:
    # A few numbers on the host: NumPy is the fastest with them, also for a torch generator.
    gaps = np.floor(np.log1p(-np.asarray(drawn, dtype=np.float64)) / log1p(-probability))
    return np.cumsum(gaps + 1.0) - 1.0
