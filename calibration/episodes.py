"""Episode starts: which state a calibrator drops, and which it keeps.

A state of an online method has two kinds of numbers in it:

* **The calibration** of the sensors, and which channels are broken (:data:`LEARNT`). It survives the end
  of an episode, as it does on a robot that is carried back to its start.
* **The state of the stream**: the last readings, samples that wait, filters, the count of a swing. After
  an episode start none of it belongs to the next samples. In particular the forces that wait for their
  reference (``lag`` samples of them) become *unread*, so that nothing is learnt until the first reference
  of the new episode meets a force of the new episode.

When blocks are full goes on (``step``), so that an episode's first block may be a part of one.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, TypeVar

from surefoot.calibration.baselines import TareState
from surefoot.calibration.front_end.readings import FrontState
from surefoot.calibration.moment.faults import ChannelState
from surefoot.calibration.moment.motion import Track
from surefoot.calibration.moment.state import Belief, Kept, MomentState, Publication, StillState, SuspectState
from surefoot.calibration.moment.state import TareState as FootTares
from surefoot.calibration.standing import StandingState
from surefoot.calibration.window.stream import WindowState

__all__ = ["LEARNT", "begin_episode"]

Tree = TypeVar("Tree", bound=tuple[Any, ...])


LEARNT: Mapping[type, tuple[str, ...]] = MappingProxyType(
    {
        FrontState: (),
        TareState: ("offset",),
        WindowState: ("step", "theta", "standing", "walking", "all_walking"),
        StandingState: StandingState._fields,
        MomentState: (*("time", "belief", "drifted", "tare", "shift", "published", "covariance", "kept"),),
        SuspectState: ("noise", "known"),
        Track: (),
        StillState: (),
        **{kind: kind._fields for kind in (Belief, Publication, FootTares, Kept)},
        ChannelState: (
            *("moments", "lost", "kind", "wiring", "spare", "spare_std", "agreed", "altered"),
            *("shown", "expected", "missed", "offered", "alive"),
        ),
    }
)
"""Fields that outlive an episode, by the class of the state; its others belong to the stream. The class
of a user's own method names them itself, in an attribute ``LEARNT``."""


def begin_episode(fresh: Tree, state: Tree) -> Tree:
    """Return a ``fresh`` state with the calibration so far; TypeError if it is not one of :data:`LEARNT`."""
    kind, own = type(state), dict[str, Any]()
    learnt = LEARNT.get(kind, getattr(kind, "LEARNT", None))
    if learnt is None:
        raise TypeError(
            f"What a {kind.__name__} has learnt is not known; states of "
            f"{[known.__name__ for known in LEARNT]} can begin an episode, and those whose class names such "
            "fields in an attribute LEARNT."
        )
    for name, old in state._asdict().items():  # type: ignore[attr-defined]
        if name in learnt:
            own[name] = old
        elif isinstance(old, tuple):
            own[name] = begin_episode(getattr(fresh, name), old)
    started: Tree = fresh._replace(**own)  # type: ignore[attr-defined]
    return started
