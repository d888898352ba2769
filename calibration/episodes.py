"""Episode starts of some robots of a batch: what they drop, what they keep, and how none of them learns.

States of online methods have their batch dimensions in front, and two kinds of numbers in them:

* **What was learnt** about the sensors, and which channels are broken (:data:`LEARNT`). It survives the end
  of an episode, as it does on a robot that is carried back to its start.
* **What belongs to the stream**: the last readings, samples that wait, filters, the count of a swing. After
  an episode start none of it belongs to what comes next. In particular the forces that wait for their
  reference (``lag`` samples of them) become *unread*, so that nothing is learnt until the first reference
  of the new episode meets a force of the new episode.

A few whole numbers are shared by the batch (:data:`COUNTERS`): when blocks are full, and whether anything
at all is to be done for standing starts and broken channels. They go on in such a way that a robot with a
fresh state is served as it would be alone, but that its first block is as short as the others' has become.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, TypeVar

from surefoot.calibration.arrays import Array, namespace_of
from surefoot.calibration.baselines import TareState
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.front_end.readings import FrontState
from surefoot.calibration.moment.faults import ChannelState
from surefoot.calibration.moment.state import MomentState
from surefoot.calibration.reference import Reference
from surefoot.calibration.setup import OnlineMethod
from surefoot.calibration.standing import StandingState
from surefoot.calibration.window.stream import WindowState

__all__ = ["COUNTERS", "LEARNT", "begin_episode", "select", "update_frozen"]


Tree = TypeVar("Tree", bound=tuple[Any, ...])


LEARNT: Mapping[type, tuple[str, ...]] = MappingProxyType(
    {
        FrontState: (),
        TareState: ("offset",),
        WindowState: ("theta", "standing", "walking"),
        StandingState: StandingState._fields,
        MomentState: (
            *("mean", "covariance", "drift", "given", "given_covariance", "learnt", "spread"),
            *("kept_mean", "kept_covariance", "noise", "misfit", "unproven"),
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
            "fields in an attribute LEARNT; others can only be selected."
        )
    return found


COUNTERS: Mapping[str, Callable[[int, int], int]] = MappingProxyType(
    {
        # Blocks fill up for all at once.
        "step": lambda fresh, kept: kept,
        # Whether all standing starts are over: a fresh robot has its own before it.
        "all_walking": min,
        # Whether any channel is out: those of the others may be.
        "altered": max,
    }
)
"""``merge(fresh, kept)`` of the whole numbers that robots share, by their names: what they are once some
robots have taken a fresh state."""

_FROZEN: Mapping[str, int] = MappingProxyType({"step": 0, "all_walking": 1})
"""What stands in for them where nothing is to be learnt: after 0 comes 1, at which no block is full."""


def select(mask: Array, fresh: Tree, state: Tree) -> Tree:
    """Return a state in which some robots are fresh, or take any other state or estimate.

    Args:
        mask: Robots that take it (bool), shape (...) of the batch, of the states' library and device.
        fresh: The state to take, for the same batch: ``init(raw)`` forgets.
        state: The state that the others keep bit for bit.

    Returns:
        A new state; neither argument is changed.

    Raises:
        ValueError: If the mask or the fresh state is not of the same robots as the state.
    """
    merged: Tree = _merge(mask, fresh, state, keep_learnt=False)
    return merged


def begin_episode(mask: Array, fresh: Tree, state: Tree) -> Tree:
    """Return a state in which some robots begin an episode with what they have learnt.

    Args:
        mask: Robots that begin one (bool), shape (...) of the batch.
        fresh: ``init(raw)`` for the same batch.
        state: The state; the others keep theirs bit for bit.

    Returns:
        A new state; neither argument is changed.

    Raises:
        ValueError: As of :func:`select`.
        TypeError: If the state is not one of :data:`LEARNT`.
    """
    merged: Tree = _merge(mask, fresh, state, keep_learnt=True)
    return merged


def update_frozen(
    method: OnlineMethod, state: Any, raw: Array, reference: Reference, dt: float
) -> tuple[Any, Estimate]:
    """Return ``method.update`` of one sample, without learning from it.

    What was learnt is applied and stays bit for bit, its covariance too: it does not grow by the drift that
    nobody follows. Single readings are checked and held as ever. Before learning goes on, let all robots
    :func:`begin_episode`, as windows were not filled meanwhile.

    Raises:
        ValueError: If the method learns at every sample, ``every=1``, and so cannot be kept from it.
    """
    shared = {name: getattr(state, name) for name in _FROZEN if hasattr(state, name)}
    stopped = {name: _FROZEN[name] for name in shared}
    if isinstance(state, TareState):
        # A foot that has not been in the air until now shows no offset.
        stopped["airborne"] = state.airborne * 0 - 1
    kept = {name: getattr(state, name) for name in _learnt(state)}
    after, estimate = method.update(state._replace(**stopped), raw, reference, dt)
    if any(getattr(after, name) is not kept[name] for name in ("mean", "theta") if name in kept):
        raise ValueError(
            "A method that learns at every sample cannot be frozen; build it with 'every' of 2 or more."
        )
    return after._replace(**kept, **shared), estimate


def _merge(mask: Array, fresh: Any, state: Any, *, keep_learnt: bool) -> Any:
    """Merge two trees of the same form, field by field."""
    kept = _learnt(state) if keep_learnt else ()
    merged = {}
    for name in state._fields:
        new, old = getattr(fresh, name), getattr(state, name)
        if name in kept or old is None:
            merged[name] = old
        elif isinstance(old, tuple):
            merged[name] = _merge(mask, new, old, keep_learnt=keep_learnt)
        elif isinstance(old, int):
            merged[name] = old if keep_learnt else COUNTERS[name](new, old)
        else:
            merged[name] = _where(name, mask, new, old)
    return type(state)(**merged)


def _where(name: str, mask: Array, new: Array, old: Array) -> Array:
    """Take a leaf of one or the other, robot by robot."""
    if tuple(new.shape) != tuple(old.shape) or tuple(old.shape[: mask.ndim]) != tuple(mask.shape):
        raise ValueError(
            f"'{name}' has shape {tuple(old.shape)}, that of the fresh state {tuple(new.shape)}, and 'mask' "
            f"{tuple(mask.shape)}: all three must be of the same batch of robots."
        )
    return namespace_of(old).where(mask[(..., *[None] * (old.ndim - mask.ndim))], new, old)
