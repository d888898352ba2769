"""A control step of one robot's feet and telemetry by the library, in one call, and what is seen of it."""

from collections.abc import Callable
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.native import Record
from surefoot.sensors.devices.native_device import NativeState
from surefoot.sensors.native import installed
from surefoot.sensors.randomness import Stream
from surefoot.sensors.transport.link import Packets
from surefoot.wrappers.instruments import CellsUnderFeet, Instruments, InstrumentsState, SensorsInAnkles
from surefoot.wrappers.native_telemetry import NativeTelemetry, NativeTelemetryState
from surefoot.wrappers.raw_view import RawView

_SEEN = itemgetter("raw", "counts", "state")

_NOTHING = np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, np.int32)
"""No numbers of a state that are measured."""


class NativeSensing:
    """The library for one robot; states, streams and what is held stay those of the objects.

    Args:
        truth: A control step, as long as all that it takes.
        part: What is under the feet.
        feet: Its state.
        telemetry: The telemetry.
        state: Its state.
        streams: Where chance comes from, by device.
        kept: Where the newest packet's values and the counts that are held lie.
        view: What is seen, if anything is put together.
    """

    def __init__(
        self,
        truth: Any,
        part: CellsUnderFeet | SensorsInAnkles,
        feet: NativeState,
        telemetry: NativeTelemetry,
        state: NativeTelemetryState,
        streams: dict[str, Any],
        kept: tuple[NDArray[np.float64], NDArray[np.float32]],
        view: RawView | None,
    ) -> None:
        library = installed()
        assert library is not None
        self._of = feet, state, streams
        self._telemetry, self._view, self._count = telemetry, view, 0
        load, (self._position, self._inertial) = np.zeros_like(part.load(truth)), telemetry.inputs
        # What cells feel may be told by other readings, faster here than there.
        mapped = part.name == "cells" and hasattr(truth, "cell_map")
        self._felt_in: Callable[[Any], NDArray[np.float64]] = attrgetter("plate") if mapped else part.load
        self._felt = np.zeros_like(truth.plate) if mapped else load
        observed, to, taken = _NOTHING if view is None else view.measured()
        channels, numbers = load.shape[-1], len(observed)
        self._observed = observed if numbers else None
        self._seen = Record(
            np.dtype(
                [
                    ("raw", np.float64, (channels,)),
                    ("counts", np.float32, (channels,)),
                    ("state", np.float32, (numbers,)),
                ]
            )
        )
        self._raw: NDArray[np.float64] = self._seen.now["raw"]
        now, (low, high) = self._seen.now, (observed, observed) if view is None else view.bounds
        arrays = {
            "felt": self._felt,
            "load": load,
            "newest": kept[0],
            "raw": now["raw"],
            "observed": observed,
            "low": low,
            "high": high,
            "shown": now["state"],
            "held": kept[1],
            "counts": now["counts"],
            "from": taken,
            "to": to,
        }
        if mapped:
            factors, preload = truth.cell_map()
            arrays |= {"map": factors.copy(), "preload": preload.copy()}
        kind = feet.owner.kind.name
        records = library.filled(
            "sense_records",
            {
                **{name: array.ctypes.data for name, array in arrays.items()},
                f"{kind}_config": feet.owner.constants.ctypes.data,
                kind: feet.address,
                "feet_stream": streams[part.name].address,
                "telemetry": telemetry.address,
                "telemetry_state": state.address,
                "telemetry_stream": streams["telemetry"].address,
                "rows": load.size // channels,
                "readings": self._felt.shape[-1],
                "shares": len(to),
                "numbers": numbers,
                "channels": channels,
                "values": telemetry.layout.size,
                "dt": telemetry.dt,
            },
        )
        assert records is not None
        self._kept = records, arrays
        self._sense, self._at = library.functions.surefoot_sense, records.ctypes.data

    def __reduce__(self) -> Any:
        # Addresses are of no use elsewhere: a copy of the wrapper makes its own.
        return type(None), ()

    def goes_on(self, instruments: InstrumentsState, state: Any, streams: dict[str, Any]) -> bool:
        """Return whether it is for these states and streams, and there is room for the next packets."""
        own, telemetry, chance = self._of
        if state is not telemetry or streams is not chance or state.coming < 0:
            return False
        return instruments.cells is own or instruments.ankles is own

    def step(
        self, truth: Any, time: float, observation: Any
    ) -> tuple[NDArray[np.float64], dict[str, Any] | None] | None:
        """Read a control step; ``None``, with nothing done, for one that is not as long as others.

        Args:
            truth: The control step.
            time: The host's at its end in s.
            observation: What the environment shows.

        Returns:
            The reading in counts, shape (K,), and what is seen, in fresh arrays; without a view the reading
            is overwritten by the next one, and nothing is put together.
        """
        felt, position = self._felt_in(truth), truth.joint_position
        if felt.shape != self._felt.shape or position.shape != self._position.shape:
            return None
        self._felt[...], self._position[...] = felt, position
        self._inertial[...] = truth.inertial
        if self._observed is not None:
            self._observed[...] = observation["state"]
        told = self._sense(self._at, time)
        self._of[1].coming, self._count = (told >> 16) - 1, told & 0xFFFF
        if self._view is None:
            return self._raw, None
        raw, counts, state = _SEEN(self._seen.copy())
        return raw, self._view.seen(observation, counts, None if self._observed is None else state)

    def arrived(self) -> tuple[int, int]:
        """Return where the rows of the packets lie that have arrived, until the next step, and how many."""
        return self._telemetry.arrived_address, self._count

    def packets(self) -> Packets:
        """Return the packets that have arrived."""
        return self._telemetry.packets(self._count)


def native_sensing(
    truth: Any,
    instruments: Instruments,
    state: InstrumentsState,
    telemetry: Any,
    telemetry_state: Any,
    streams: dict[str, Any],
    kept: tuple[NDArray[np.float64], NDArray[np.float32]],
    view: RawView | None,
) -> NativeSensing | None:
    """Return what reads a robot by the library in one call; ``None`` where its parts read on their own."""
    part = instruments.parts[0]
    feet = getattr(state, part.name)
    if (
        type(telemetry) is not NativeTelemetry
        or type(telemetry_state) is not NativeTelemetryState
        or type(feet) is not NativeState
        or len(instruments.parts) != 1
        or telemetry_state.coming < 0
        or not all(type(streams[device]) is Stream for device in (part.name, "telemetry"))
        or any(array.dtype != np.float64 for array in (part.load(truth), truth.joint_position))
        or (view is not None and view.bounds[0].dtype != np.float32)
    ):
        return None
    return NativeSensing(truth, part, feet, telemetry, telemetry_state, streams, kept, view)
