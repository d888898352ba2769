"""Episode starts of some robots of a batch: what they drop, and what they keep.

States of online methods have their batch dimensions in front, and two kinds of numbers in them:

* **What was learnt** about the sensors, and which channels are broken (:data:`LEARNT`). It survives the end
  of an episode, as it does on a robot that is carried back to its start.
* **What belongs to the stream**: the last readings, samples that wait, filters, the count of a swing. After
  an episode start none of it belongs to what comes next. In particular the forces that wait for their
  reference (``lag`` samples of them) become *unread*, so that nothing is learnt until the first reference
  of the new episode meets a force of the new episode.

A few whole numbers are shared by the batch: when blocks are full, and whether anything at all is to be done
for standing starts and broken channels. They go on, so that an episode's first block may be a part of one.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.baselines import TareState
from surefoot.calibration.front_end.readings import FrontState
from surefoot.calibration.moment.faults import ChannelState
from surefoot.calibration.moment.state import MomentState
from surefoot.calibration.standing import StandingState
from surefoot.calibration.window.stream import WindowState

__all__ = ["LEARNT", "begin_episode"]

Tree = TypeVar("Tree", bound=tuple[Any, ...])


LEARNT: Mapping[type, tuple[str, ...]] = MappingProxyType(
    {
        FrontState: (),
        TareState: ("offset",),
        WindowState: ("theta", "standing", "walking"),
        StandingState: StandingState._fields,
        MomentState: (
            *("mean", "covariance", "drift", "given", "given_covariance", "learnt", "spread"),
            *("kept_mean", "kept_covariance", "noise", "misfit", "rate", "unproven"),
        ),
        ChannelState: ("trust", "moments", "lost", "kind", "wiring", "spare", "spare_std", "agreed"),
    }
)
"""Fields that outlive an episode, by the class of the state; its other arrays belong to the stream. The class
of a user's own method names them itself, in an attribute ``LEARNT``."""


def _learnt(state: Any) -> tuple[str, ...]:
    kind = type(state)
    found: tuple[str, ...] | None = LEARNT.get(kind, getattr(kind, "LEARNT", None))
    if found is None:
        raise TypeError(
            f"What a {kind.__name__} has learnt is not known; states of "
            f"{[known.__name__ for known in LEARNT]} can begin an episode, and those whose class names such "
            "fields in an attribute LEARNT."
        )
    return found


def begin_episode(mask: Array, fresh: Tree, state: Tree) -> Tree:
    """Return a state in which some robots begin an episode with what they have learnt.

    Args:
        mask: Robots that begin one (bool), shape (...) of the batch.
        fresh: ``init(raw)`` for the same batch.
        state: The state; the others keep theirs bit for bit.

    Returns:
        A new state; neither argument is changed.

    Raises:
        ValueError: If the mask or the fresh state is not of the same robots as the state.
        TypeError: If the state is not one of :data:`LEARNT`.
    """
    own: Any = state
    kept, merged = _learnt(state), {}
    for name in own._fields:
        new, old = getattr(fresh, name), getattr(state, name)
        if name in kept or isinstance(old, int | None):
            merged[name] = old
        elif isinstance(old, tuple):
            merged[name] = begin_episode(mask, new, old)
        else:
            merged[name] = _where(name, mask, new, old)
    begun: Tree = own._replace(**merged)
    return begun


def _where(name: str, mask: Array, new: Array, old: Array) -> Array:
    """Take a leaf of one or the other, robot by robot."""
    if new.shape != old.shape or old.shape[: mask.ndim] != mask.shape:
        raise ValueError(
            f"'{name}' has shape {old.shape}, that of the fresh state {new.shape}, and 'mask' "
            f"{mask.shape}: all three must be of the same batch of robots."
        )
    return np.where(mask[(..., *[None] * (old.ndim - mask.ndim))], new, old)
