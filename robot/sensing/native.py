"""All sensors of one robot by the library: a step or an episode's start in one call, with the observation."""

from collections.abc import Iterable, Mapping, Sequence
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.native import Record, call_for_many
from surefoot.robot.sensing.instruments import CellsUnderFeet, Instruments, InstrumentsState
from surefoot.robot.sensing.raw_view import RawView
from surefoot.sensors.devices.native_device import NativeDevice
from surefoot.sensors.native import installed
from surefoot.sensors.randomness import Stream
from surefoot.sensors.telemetry.native import NativeTelemetry, NativeTelemetryState
from surefoot.sensors.transport.link import Packets
from surefoot.sensors.transport.wire import check_wire

_SEEN = itemgetter("raw", "counts", "state")

_NOTHING = np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, np.int32)
"""No numbers of a state that are measured."""

Seen = tuple[NDArray[np.float64], dict[str, Any] | None]
"""A reading in counts, shape (K,), and what is seen, in fresh arrays; without a view the next one overwrites
the reading, and nothing is put together."""


def _sizes(instruments: Instruments, truth: Any, dt: float) -> dict[str, Any]:
    """Return how many readings there are and where they are taken, by the names in ``sf_sense_records``."""
    first, *more = instruments.first_steps(dt)
    where = truth.sensor_columns()
    return {
        "channels": instruments.channels,
        "dt": dt,
        "first": first,
        "more": len(more),
        "rows": len(truth.time),
        "columns": truth.rows.shape[-1],
        "at_joints": where.joints,
        "at_inertial": where.inertial,
        "at_ankles": where.ankles,
        "at_cells": where.cells,
        "stride": where.stride,
        "soles": where.soles,
    }


def _reading_dtype(channels: int, observed: int) -> np.dtype[Any]:
    """Return the record of a reading and of what is seen of it."""
    numbers = ("raw", np.float64, channels), ("counts", np.float32, channels), ("state", np.float32, observed)
    return np.dtype([(name, kind, (count,)) for name, kind, count in numbers])


class NativeSensing:
    """The library for one robot, which holds the state of all that is under its feet.

    Args:
        truth: A control step, as long as all that it takes.
        instruments: The instruments under the feet.
        devices: The same as the library has it, and the faults, by their places in ``DEVICES``.
        telemetry: The telemetry, if anybody listens.
        dt: Duration of a control step in s.
        kept: Where the newest packet's values and the counts that are held lie.
        view: The view, if an observation is put together.

    Attributes:
        telemetry_state: The telemetry's state, which goes on in place.
        address: Where the library finds its records.
        raw_address: Where the last reading lies.
        shape: Of the rows of truth that it takes.
        rows_address: Where rows of packets lie.
    """

    telemetry_state: Any

    def __init__(
        self,
        truth: Any,
        instruments: Instruments,
        devices: Mapping[str, NativeDevice],
        telemetry: tuple[NativeTelemetry, NativeTelemetryState] | None,
        dt: float,
        kept: tuple[NDArray[np.float64], NDArray[np.float32]],
        view: RawView | None,
    ) -> None:
        library = installed()
        assert library is not None
        self._states = {name: device.empty() for name, device in devices.items()}
        self._telemetry: NativeTelemetry | None = None
        self.telemetry_state = None
        if telemetry is not None:
            self._telemetry, self.telemetry_state = telemetry
        self._view = view
        numbers = _sizes(instruments, truth, dt)
        if len(instruments.parts) > 1:
            self._order = instruments.order.astype(np.int32)
            numbers["order"] = self._order.ctypes.data
        for state in self._states.values():
            kind = state.owner.kind.name
            numbers |= {f"{kind}_config": state.owner.constants.ctypes.data, kind: state.address}
        observed, to, taken = _NOTHING if view is None else view.state_places()
        self._observed = observed if len(observed) else None
        self._seen = Record(_reading_dtype(instruments.channels, len(observed)))
        self._raw: NDArray[np.float64] = self._seen.now["raw"]
        self.shape = truth.rows.shape
        now, (low, high) = self._seen.now, (observed, observed) if view is None else view.bounds
        arrays = {
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
        first = instruments.parts[0]
        self._cells = first if isinstance(first, CellsUnderFeet) else None
        self._map: tuple[NDArray[np.float64], ...] = ()
        if "cells" in devices:
            arrays["map"], arrays["preload"] = self._map = self._cell_map(truth)
            arrays["load"] = np.zeros((len(truth.time), self._map[0].shape[1]))
            numbers["readings"] = len(self._map[0])
        if "ankles" in devices:
            arrays["wrench"] = np.zeros(6 * int(devices["ankles"].constants["sensors"]))
            numbers["averaged"] = any(getattr(part.config, "averaged", False) for part in instruments.parts)
        if self._telemetry is not None:
            numbers |= {
                "telemetry": self._telemetry.address,
                "telemetry_state": self.telemetry_state.address,
                "values": self._telemetry.layout.size,
            }
        numbers |= {"shares": len(to), "numbers": len(observed), "telemetry_stream": 0, "packets": 0}
        numbers |= {f"{state.owner.kind.name}_stream": 0 for state in self._states.values()}
        records = library.record_of(
            "sense_records", numbers | {name: array.ctypes.data for name, array in arrays.items()}
        )
        assert records is not None
        self._records, self._arrays = records, arrays
        self._sense, self.address = library.functions.surefoot_sense, records.ctypes.data
        self.raw_address = self._raw.ctypes.data
        self.rows_address = 0 if self._telemetry is None else self._telemetry.arrived_address

    def draw_from(self, streams: Mapping[str, Stream]) -> None:
        """Let chance come from other streams, by the names of devices."""
        self._streams = streams
        self._records["telemetry_stream"] = streams["telemetry"].address
        for name, state in self._states.items():
            self._records[f"{state.owner.kind.name}_stream"] = streams[name].address

    def take(self, instruments: InstrumentsState, faults: Any) -> None:
        """Go on with other hardware under the feet, as the Python has it."""
        for name, state in self._states.items():
            state.take(faults if name == "faults" else getattr(instruments, name))

    def python(self) -> tuple[InstrumentsState, Any]:
        """Return instruments and faults as the Python has them, as a copy."""
        states = {name: state.python() for name, state in self._states.items()}
        faults = states.pop("faults", ())
        return InstrumentsState(**states), faults

    def begin(self, truth: Any, at_rest: NDArray[np.float64], fresh: bool, observation: Any) -> Seen | None:
        """Start an episode; ``None``, with nothing done, for a truth that is not as long as others.

        Args:
            truth: In which it starts.
            at_rest: The IMU's input before it, shape (6,).
            fresh: Whether IMU and encoders are drawn.
            observation: The environment's observation.
        """
        if truth.rows.shape != self.shape:
            return None
        for part, now in zip(self._map, self._cell_map(truth), strict=True):
            part[...] = now
        if self._telemetry is not None:
            position, inertial = self._telemetry.inputs
            position[0], inertial[0] = truth.joint_position[-1], at_rest
        return self._read(truth, 0.0, 1 + fresh, observation)

    def _cell_map(self, truth: Any) -> tuple[NDArray[np.float64], ...]:
        """Return the cells' map of a truth, as a copy; nothing without cells."""
        found = None if self._cells is None else self._cells.cell_map(truth)
        return () if found is None else tuple(part.copy() for part in found)

    def step(self, truth: Any, time: float, observation: Any) -> Seen | None:
        """Read a control step; ``None``, with nothing done, for one that it does not take.

        Args:
            truth: The control step.
            time: The host's at its end in s.
            observation: The environment's observation.
        """
        return self._read(truth, time, 0, observation) if truth.rows.shape == self.shape else None

    def _read(self, truth: Any, time: float, begins: int, observation: Any) -> Seen | None:
        rows = np.ascontiguousarray(truth.rows, dtype=np.float64)
        if self._observed is not None:
            self._observed[...] = observation["state"]
        if self._sense(self.address, rows.ctypes.data, time, begins) < 0:
            return None
        if self._view is None:
            return self._raw, None
        raw, counts, state = _SEEN(self._seen.copy())
        return raw, self._view.compose(observation, counts, None if self._observed is None else state)

    def packet_rows(self) -> tuple[int, int] | None:
        """Return where the rows of the packets lie that have arrived, until the next step, and how many."""
        return None if self._telemetry is None else (self.rows_address, int(self._records["packets"]))

    def packets(self) -> Packets:
        """Return the packets that have arrived."""
        return () if self._telemetry is None else self._telemetry.packets(int(self._records["packets"]))


class ManySensing:
    """Control steps of many robots in one call of the library.

    Args:
        robots: The readers of each of them.

    Attributes:
        robots: The same.
        raw: Addresses of their readings, shape (N,).
        rows: Addresses of rows of packets, shape (N,).
        packets: How many packets have arrived of each, shape (N,).
    """

    def __init__(self, robots: Sequence[NativeSensing]) -> None:
        library = installed()
        assert library is not None
        self.robots, self._sense = list(robots), library.functions.surefoot_sense_many
        places = [(robot.address, robot.raw_address, robot.rows_address) for robot in robots]
        self._at, self.raw, self.rows = np.array(places, dtype=np.uintp).T.copy()
        self.packets = np.zeros(len(robots), dtype=np.int32)
        self.count_packets(range(len(robots)))
        self._shapes = {robot.shape for robot in robots}

    def __reduce__(self) -> Any:
        # Addresses are of no use elsewhere: a copy of the sensors makes its own.
        return type(None), ()

    def count_packets(self, which: Iterable[int]) -> None:
        """Note the packets of robots that were read one by one."""
        for i in which:
            _, self.packets[i] = self.robots[i].packet_rows() or (0, 0)

    def step(
        self, which: NDArray[np.intp], truth: NDArray[np.float64], time: NDArray[np.float64], threads: int
    ) -> NDArray[np.intp]:
        """Read a control step.

        Args:
            which: Numbers of the robots that are read.
            truth: Of all robots, shape (N, S, columns).
            time: The hosts' clocks at its end in s, of those that are read.
            threads: As of :func:`~surefoot.native.call_for_many`.

        Returns:
            Numbers of those that were read; the others' steps are left to the caller.
        """
        if self._shapes != {truth.shape[1:]}:
            return which[:0]
        if truth.dtype != np.float64 or not truth[0].flags.c_contiguous:
            truth = np.ascontiguousarray(truth, dtype=np.float64)
        packets = np.zeros(len(which), dtype=np.int32)
        rows = (truth.ctypes.data + which * truth.strides[0]).astype(np.uintp)
        call_for_many(self._sense, (self._at[which], rows, time, packets), threads)
        self.packets[which] = packets
        return which if (packets >= 0).all() else which[packets >= 0]


def native_sensing(
    truth: Any,
    instruments: Instruments,
    devices: Mapping[str, NativeDevice | None],
    telemetry: Any,
    telemetry_state: Any,
    dt: float,
    kept: tuple[NDArray[np.float64], NDArray[np.float32]],
    view: RawView | None,
) -> NativeSensing | None:
    """Make the library's reader of a robot; ``None`` where Python reads, as one of its parts does not fit.

    Args:
        truth: As of :class:`NativeSensing`, like all that is not described here.
        instruments: The instruments under the feet.
        devices: The same as the library has it; ``None`` for those that do not fit.
        telemetry: The telemetry; ``None`` where nobody listens.
        telemetry_state: Its state; ``None`` before an episode.
        dt: Duration of a control step in s.
        kept: The values that are kept.
        view: The view.
    """
    if any(device is None for device in devices.values()) or truth.rows.dtype != np.float64:
        return None
    if any(part.cell_map(truth) is None for part in instruments.parts if isinstance(part, CellsUnderFeet)):
        return None
    if view is not None and view.bounds[0].dtype != np.float32:
        return None
    if telemetry is not None:
        if type(telemetry) is not NativeTelemetry:
            return None
        if telemetry.inputs[0].shape != truth.joint_position.shape:
            return None
        state = telemetry.empty() if telemetry_state is None else telemetry_state
        if type(state) is not NativeTelemetryState:
            return None
        telemetry = telemetry, state
    for part in instruments.parts:
        check_wire(part.config, dt)
    found: Any = devices
    return NativeSensing(truth, instruments, found, telemetry, dt, kept, view)
