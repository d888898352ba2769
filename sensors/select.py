"""Partial resets: some robots of a batch take another state, all others keep theirs bit for bit.

A state is a tree of tuples with arrays at its leaves, and a leaf's batch axis need not be its first: the
errors of load cells have the shape (2, N, K), the yield of a spring element (J, N, K), packets under way
(D, N, C). One shape does not show which axis it is, as N may be 2 as well; it is the one that grows when
``init`` is called for one robot more.
"""

from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from surefoot.sensors.arrays import cast_like, namespace
from surefoot.sensors.corruption import Array, Corruption

State = TypeVar("State")

Axes = Any
"""A tree of the form of a state: the batch axis of each leaf, ``None`` for one that robots share."""


@lru_cache(maxsize=128)
def batch_axes(corruption: Corruption[Any], channels: int) -> Axes:
    """Return the batch axis of each leaf of a corruption's states.

    Args:
        corruption: The sensor; its states are those of batches of robots, of readings with shape (N, K).
        channels: Number K of its channels.

    Returns:
        A tree of the form of its states.

    >>> from surefoot.sensors import LoadCells, load_cells
    >>> axes = batch_axes(load_cells(LoadCells()), 8)
    >>> axes.held, axes.error, axes.thermal
    (0, 1, None)
    """
    rng = np.random.default_rng(0)
    return _compare(corruption.init((2, channels), rng), corruption.init((3, channels), rng))


def select(mask: Array, fresh: State, state: State, axes: Axes) -> State:
    """Return a state in which some robots have a fresh one.

    Leaves that robots share, such as the empty ones of parts that an instrument lacks, stay.

    Args:
        mask: Robots that take it (bool), shape (N,), of the states' library and device.
        fresh: The state to take, for N robots as well.
        state: The state that the others keep.
        axes: From :func:`batch_axes`.

    Returns:
        A new state; neither argument is changed.

    Raises:
        ValueError: If the mask or the fresh state is not of as many robots as the state.

    >>> from surefoot.sensors import LoadCells, load_cells
    >>> cells, rng = load_cells(LoadCells()), np.random.default_rng(0)
    >>> old, new = (cells.init((3, 8), rng) for _ in range(2))
    >>> mixed = select(np.array([False, True, False]), new, old, batch_axes(cells, 8))
    >>> (mixed.error == new.error).all(axis=(0, 2))
    array([False,  True, False])
    """
    if isinstance(state, tuple):
        parts = [select(mask, *trees) for trees in zip(fresh, state, axes, strict=True)]  # type: ignore[call-overload]
        rebuilt: State = _like(state, parts)
        return rebuilt
    if axes is None:
        return state
    old: Any = state
    if old.shape != fresh.shape or tuple(mask.shape) != (old.shape[axes],):  # type: ignore[attr-defined]
        raise ValueError(
            f"'mask' must have shape ({old.shape[axes]},) and 'fresh' the shape {tuple(old.shape)} of the "
            f"state, got {tuple(mask.shape)} and {tuple(fresh.shape)}; "  # type: ignore[attr-defined]
            "make both for the same robots."
        )
    chosen: State = namespace(old).where(
        mask[(..., *[None] * (old.ndim - 1 - axes))], cast_like(fresh, old), old
    )
    return chosen


def _compare(two: Any, three: Any) -> Axes:
    """Return the axis along which one leaf is longer than the other."""
    if isinstance(two, tuple):
        return _like(two, [_compare(*pair) for pair in zip(two, three, strict=True)])
    shapes = zip(np.shape(two), np.shape(three), strict=True)
    return next((axis for axis, (short, long) in enumerate(shapes) if short != long), None)


def _like(tree: Any, parts: list[Any]) -> Any:
    """Return parts as a tuple of the same class."""
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
