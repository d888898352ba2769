"""All of one sample of one robot by the library, in one call: beliefs, filter and what an agent is shown."""

from collections.abc import Callable
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Reference
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.native import Library, NativeFilter, NativeState
from surefoot.envs.observation import COP_BOUND
from surefoot.wrappers.beliefs import reference_info
from surefoot.wrappers.foot_view import FootView
from surefoot.wrappers.native_beliefs import NativeBeliefs

_OF_ESTIMATE = ("flags", "vgrf", "scale", "offset")
"""What ``info`` holds of an estimate."""

_NOTHING = (None, 0)
"""No packets."""


class NativeSample:
    """The library for one robot; its beliefs, its filter and what is held stay those of the objects.

    Args:
        beliefs: The robot's.
        native: Its filter.
        state: The filter's state.
        view: What is shown.
        dt: Time between samples in s.

    Attributes:
        sampled: Whether it has taken in any sample.
    """

    def __init__(
        self, beliefs: NativeBeliefs, native: NativeFilter, state: NativeState, view: FootView, dt: float
    ) -> None:
        library = beliefs.library
        self._of = beliefs, state, beliefs.model.revision
        self._filter, self._raw, self.sampled = native, native.raw, False
        config = view_record(library, view)
        told, names = _told(library, beliefs, native, view)
        self._dtype, self._memory = told, np.zeros(library.places["told"][""][2], np.uint8)
        # What comes after the last number is room that this robot has no use for.
        self._part = self._memory[: told.itemsize]
        self._shown = view.parts, _getter(names["shown"])
        self._told = _getter(names["estimate"])
        self._believed = beliefs.believed.dtype.names or (), _getter(names["belief"])
        records = library.filled(
            "sample_records",
            {
                **beliefs.addresses(),
                **native.addresses,
                "state": state.address,
                "view": config.ctypes.data,
                "held": view.held.ctypes.data,
                "told": self._memory.ctypes.data,
                "dt": dt,
            },
        )
        assert records is not None
        self._kept = config, view.held, records
        self._sample, self._at = library.functions.surefoot_sample, records.ctypes.data

    def __reduce__(self) -> Any:
        # Addresses are of no use elsewhere: a copy of the wrapper makes its own.
        return type(None), ()

    def goes_on(self, beliefs: Any, state: NativeState) -> bool:
        """Return whether it is for these beliefs, and a filter with this state."""
        own, filters, revision = self._of
        return beliefs is own and state is filters and own.model.revision == revision

    def feed(
        self,
        raw: NDArray[np.float64],
        times: tuple[float, float],
        command: Any,
        hold: bool,
        arrived: tuple[int, int] | None = None,
    ) -> None:
        """Take in one sample.

        Args:
            raw: Counts, shape (K,).
            times: What the sample is about and now, in s on the host's clock.
            command: What the robot commands itself, if anything.
            hold: Whether nothing is learnt of it.
            arrived: Where rows of packets lie that have arrived before it, and how many.
        """
        beliefs, state, _ = self._of
        self._raw[...] = raw
        how = beliefs.plan(command) + 2 * hold
        found = self._sample(self._at, *(arrived or _NOTHING), *times, how)
        beliefs.tell(found)
        self.sampled = True
        if found & 9:
            state.changed()

    def told(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return what an agent is shown of the last sample, and what ``info`` holds of the estimate.

        All arrays are fresh.
        """
        beliefs = self._of[0]
        shown, told = self._read(np.ndarray((), self._dtype, self._part.copy()))
        told["reference"] = {"known": True, **told["reference"]} if beliefs.known else beliefs.info()
        return shown, told

    def told_by(self, robots: "list[NativeSample]") -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the same of robots of this one's kind, with the robots in front of each array."""
        memory = np.array([robot._part for robot in robots])
        shown, told = self._read(np.ndarray(len(robots), self._dtype, memory))
        if all(robot._of[0].known for robot in robots):
            told["reference"] = {"known": np.ones(len(robots), bool), **told["reference"]}
        else:
            told["reference"] = reference_info(Reference(**told["reference"]))
        return shown, told

    def _read(self, one: NDArray[Any]) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        flags, vgrf, scale, offset, *certain = self._told(one)
        return dict(zip(self._shown[0], self._shown[1](one), strict=True)), {
            "parameters": {"scale": scale, "offset": offset},
            "covariance": certain[0] if certain else None,
            "flags": flags,
            "vgrf": vgrf,
            "reference": dict(zip(self._believed[0], self._believed[1](one), strict=True)),
        }

    def estimate(self) -> Estimate:
        """Return the last estimate."""
        return self._filter.read(self._of[1])


def view_record(library: Library, view: FootView) -> NDArray[Any]:
    """Return the bounds of what is shown, as the library wants them."""
    config = library.filled(
        "view",
        {
            "force_bound": view.force_bound,
            "cop_bound": COP_BOUND,
            "weight": view.weight,
            "flawed": view.flawed,
        },
    )
    assert config is not None
    return config


def shown_dtype(library: Library, view: FootView) -> np.dtype[Any]:
    """Return the dtype of what the library can show."""
    dtype = library.record("shown", {name: space.shape or () for name, space in view.every.items()})
    assert dtype is not None
    return dtype


def _getter(names: tuple[str, ...]) -> Callable[[Any], tuple[NDArray[Any], ...]]:
    """Return what looks up some fields of a record, as views, faster than one after the other."""
    if len(names) > 1:
        return itemgetter(*names)
    return lambda record: tuple(record[name] for name in names)


def _told(
    library: Library, beliefs: NativeBeliefs, native: NativeFilter, view: FootView
) -> tuple[np.dtype[Any], dict[str, tuple[str, ...]]]:
    """Return the dtype of what a sample tells, up to the last number, and its names by records."""
    places, unknowns = library.places["told"], 2 * len(native.raw)
    taken = {
        "shown": (shown_dtype(library, view), view.parts),
        "estimate": (native.estimate.now.dtype, _OF_ESTIMATE),
        "belief": (beliefs.believed.dtype, beliefs.believed.dtype.names or ()),
    }
    # Names alone would not do: an estimate's are shown as well.
    names = {record: tuple(f"{record}.{name}" for name in own) for record, (_, own) in taken.items()}
    fields = [
        (f"{record}.{name}", dtype[name], places[record][1] + dtype.fields[name][1])
        for record, (dtype, own) in taken.items()
        for name in own
        if dtype.fields is not None
    ]
    if native.certain:
        covariance = np.dtype((library.real, (unknowns, unknowns)))
        fields.append(("covariance", covariance, places["covariance"][1]))
        names["estimate"] += ("covariance",)
    keys, formats, offsets = zip(*fields, strict=True)
    end = max(offset + dtype.itemsize for _, dtype, offset in fields)
    told = np.dtype(
        {"names": list(keys), "formats": list(formats), "offsets": list(offsets), "itemsize": end}
    )
    return told, names
