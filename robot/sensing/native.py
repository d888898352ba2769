"""All sensors of one robot in C: one call per step or start of an episode, with the observation."""

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.envs.instrumentation.robot import SensedColumns
from surefoot.native import SENSORS, PointerRecord, Record, call_for_many
from surefoot.robot.sensing.instruments import CellsUnderFeet, HardwareState, Instruments
from surefoot.robot.sensing.python import PythonSensing, Seen
from surefoot.sensors.devices.native_device import NativeDevice
from surefoot.sensors.randomness import Stream
from surefoot.sensors.telemetry.native import NativeTelemetry
from surefoot.sensors.transport.link import Packets
from surefoot.sensors.transport.wire import check_wire

_SEEN = itemgetter("raw", "counts", "state")

_NOTHING = np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, np.int32)
"""Places in the observation for a view without measured numbers."""

Maps = tuple[Floats, ...]  # factors and forces to add of cells; nothing without cells


class Places(NamedTuple):
    """Where the library finds the loads of a robot in rows of truth."""

    shape: tuple[int, ...]  # of the rows of truth, (S, columns)
    columns: SensedColumns  # columns of the sensors
    map: Maps  # as returned by :meth:`~surefoot.robot.sensing.instruments.CellsUnderFeet.cell_map`


def places_in(truth: Any, instruments: Instruments) -> Places | None:
    """Return where the library finds the loads of instruments, or ``None`` if it cannot read them."""
    maps = _maps(truth, instruments)
    if maps is None or truth.rows.dtype != np.float64:
        return None
    return Places(truth.rows.shape, truth.columns.sensed, maps)


def _maps(truth: Any, instruments: Instruments) -> Maps | None:
    """Return a copy of the cells' map for a truth, or ``None`` if the library cannot use one."""
    first = instruments.parts[0]
    found = first.cell_map(truth) if isinstance(first, CellsUnderFeet) else ()
    return None if found is None else tuple(part.copy() for part in found)


class NativeSensing:
    """The library's sensors of one robot, with the state of all instruments under its feet.

    It continues from a Python object, which must not be used afterwards.

    Attributes:
        telemetry_state: The telemetry's state, which is updated in place.
        places: Where the loads are in rows of truth.
        records: Addresses of its records and arrays for the library.
        address: Address of ``records``.
        raw_address: Address of the last reading.
        rows_address: Address of the rows of packets.
    """

    def __init__(
        self, python: PythonSensing, devices: Mapping[str, NativeDevice], telemetry: NativeTelemetry | None
    ) -> None:
        library = SENSORS.installed()
        assert library is not None
        self._spec, self._view = python, python.view
        self.places: Places = python.places
        self._devices, self._states = devices, {name: one.empty() for name, one in devices.items()}
        self._telemetry = telemetry
        self.telemetry_state: Any = python.telemetry_state
        if telemetry is not None:
            telemetry.expect(self.places.shape[0])
            self.telemetry_state = self.telemetry_state or telemetry.empty()
        observed, to, taken = _NOTHING if self._view is None else self._view.state_places()
        self._observed = observed if len(observed) else None
        channels, shown = (python.instruments.channels,), (len(observed),)
        self._seen = Record(
            np.dtype([("raw", "f8", channels), ("counts", "f4", channels), ("state", "f4", shown)])
        )
        self._raw: Floats = self._seen.now["raw"]
        measured = {"from": taken, "to": to, "shares": len(to), "numbers": len(observed)}
        parts = self._parts_of(python) | self._arrays_of(python, observed) | measured
        self.records = PointerRecord(library, "sense_records", parts)
        self._sense, self.address = library.functions.surefoot_sense, self.records.address
        self.raw_address = self._raw.ctypes.data
        self.rows_address = 0 if telemetry is None else telemetry.arrived_address
        self.take(python.hardware())
        if python.streams:
            self.draw_from(python.streams)
        python.telemetry_state, python.arrived = None, ()
        del python.state

    def _parts_of(self, python: PythonSensing) -> dict[str, Any]:
        """Return sizes, columns, and the records of devices and telemetry, by their names in C."""
        instruments, telemetry = python.instruments, self._telemetry
        first, *more = instruments.first_steps(python.dt)
        where, (rows, columns) = self.places.columns, self.places.shape
        numbers: dict[str, Any] = {
            "channels": instruments.channels,
            "dt": python.dt,
            "first": first,
            "more": len(more),
            "rows": rows,
            "columns": columns,
            **{f"at_{name}": getattr(where, name) for name in ("joints", "inertial", "ankles", "cells")},
            "stride": where.stride,
            "soles": where.soles,
        }
        for name, device in self._devices.items():
            kind = device.kind.name
            numbers |= {f"{kind}_config": device.constants, kind: self._states[name]}
        if "cells" in self._states:
            numbers["readings"] = len(self.places.map[0])
        if "ankles" in self._states:
            numbers["averaged"] = any(getattr(part.config, "averaged", False) for part in instruments.parts)
        if telemetry is not None:
            numbers |= {
                "telemetry": telemetry,
                "telemetry_state": self.telemetry_state,
                "values": telemetry.layout.size,
                "packets": telemetry.put_packets(python.arrived),
            }
        return numbers

    def _arrays_of(self, python: PythonSensing, observed: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        """Return the arrays that the library reads and fills, by their names in C."""
        now, view, instruments = self._seen.now, self._view, python.instruments
        (newest, held), (low, high) = python.kept, (observed, observed) if view is None else view.bounds
        arrays = {"newest": newest, "held": held, "observed": observed, "low": low, "high": high}
        arrays |= {"raw": now["raw"], "shown": now["state"], "counts": now["counts"]}
        if len(instruments.parts) > 1:
            arrays["order"] = instruments.order.astype(np.int32)
        if "cells" in self._states:
            arrays["map"], arrays["preload"] = self.places.map
            arrays["load"] = np.zeros((self.places.shape[0], self.places.map[0].shape[1]))
        if "ankles" in self._states:
            arrays["wrench"] = np.zeros(6 * int(self._devices["ankles"].constants["sensors"]))
        return arrays

    def __reduce__(self) -> Any:
        return native_sensing, (self.python(),)

    def draw_from(self, streams: Mapping[str, Stream]) -> None:
        """Use other random streams."""
        self._spec.streams = streams
        self.records["telemetry_stream"] = streams["telemetry"]
        for name, device in self._devices.items():
            self.records[f"{device.kind.name}_stream"] = streams[name]

    def keep_in(self, newest: Floats, held: NDArray[np.float32]) -> None:
        """Use other arrays for the newest packet's values and the held counts."""
        self._spec.kept = newest, held
        self.records["newest"], self.records["held"] = newest, held

    def take(self, hardware: HardwareState) -> None:
        """Replace the hardware."""
        for name, state in self._states.items():
            state.put(getattr(hardware, name))
        if self._telemetry is not None and hardware.telemetry is not None:
            self._telemetry.put(self.telemetry_state, hardware.telemetry)

    def hardware(self) -> HardwareState:
        """Return the present hardware, as a copy."""
        states = {name: state.python() for name, state in self._states.items()}
        if self._telemetry is not None:
            states["telemetry"] = self._telemetry.hardware(self.telemetry_state)
        return HardwareState(**states)

    def python(self) -> PythonSensing:
        """Return a Python object that continues from the present state."""
        found = copy(self._spec)
        found.take(self.hardware())
        if self._telemetry is not None:
            found.telemetry_state, found.arrived = self.telemetry_state, self.packets()
        return found

    def begin(self, truth: Any, at_rest: Floats, fresh: bool, observation: Any) -> Seen:
        """Start an episode with a truth that has the same layout."""
        maps = _maps(truth, self._spec.instruments)
        assert maps is not None
        for part, now in zip(self.places.map, maps, strict=True):
            part[...] = now
        self._expect(truth.rows.shape)
        if self._telemetry is not None:
            position, inertial = self._telemetry.inputs
            position[0], inertial[0] = truth.joint_position[-1], at_rest
        return self._read(truth, 0.0, 1 + fresh, observation)

    def step(self, truth: Any, time: float, observation: Any) -> Seen:
        """Read a control step."""
        return self._read(truth, time, 0, observation)

    def _expect(self, shape: tuple[int, ...]) -> None:
        """Expect another number of substeps per control step."""
        if shape == self.places.shape:
            return
        self.places, self.records["rows"] = self.places._replace(shape=shape), shape[0]
        if "cells" in self._states:
            self.records["load"] = np.zeros((shape[0], self.places.map[0].shape[1]))
        if self._telemetry is not None:
            self._telemetry.expect(shape[0])

    def _read(self, truth: Any, time: float, begins: int, observation: Any) -> Seen:
        rows = np.ascontiguousarray(truth.rows, dtype=np.float64)
        self._expect(rows.shape)
        if self._observed is not None:
            self._observed[...] = observation["state"]
        self._sense(self.address, rows.ctypes.data, time, begins)
        if self._view is None:
            return self._raw, {}
        raw, counts, state = _SEEN(self._seen.copy())
        return raw, self._view.compose(observation, counts, None if self._observed is None else state)

    def ages(self) -> Floats | None:
        """Return the age of each reading in s, shape (K,); ``None`` if it is not known."""
        cells = self._states.get("cells")
        return self._spec.instruments.reading_ages(None if cells is None else cells.now)

    def packet_rows(self) -> tuple[int, int] | None:
        """Return the address and the number of the rows of packets, valid until the next step."""
        return None if self._telemetry is None else (self.rows_address, int(self.records.now["packets"]))

    def packets(self) -> Packets:
        """Return the packets that have arrived."""
        return () if self._telemetry is None else self._telemetry.packets(int(self.records.now["packets"]))


SensingBackend = PythonSensing | NativeSensing
"""A reader of all sensors of one robot, which holds their state."""


class ManySensing:
    """Read the sensors of many robots in one call of the library.

    Attributes:
        robots: The reader of each robot.
        raw: Addresses of their readings, shape (N,).
        rows: Addresses of the rows of packets, shape (N,).
        packets: Number of packets that have arrived for each, shape (N,).
    """

    def __init__(self, robots: Sequence[NativeSensing]) -> None:
        library = SENSORS.installed()
        assert library is not None
        self.robots, self._sense = list(robots), library.functions.surefoot_sense_many
        places = [(robot.address, robot.raw_address, robot.rows_address) for robot in robots]
        self._at, self.raw, self.rows = np.array(places, dtype=np.uintp).T.copy()
        self.packets = np.zeros(len(robots), dtype=np.int32)
        self.count_packets(range(len(robots)))

    def __reduce__(self) -> Any:
        # Addresses are valid in this process only: a copy of the sensors makes its own.
        return type(None), ()

    def count_packets(self, which: Iterable[int]) -> None:
        """Update the packets of robots that were read one by one, and the numbers of substeps."""
        for i in which:
            _, self.packets[i] = self.robots[i].packet_rows() or (0, 0)
        self._shapes = {robot.places.shape for robot in self.robots}

    def step(self, which: NDArray[np.intp], truth: Floats, time: Floats, threads: int) -> bool:
        """Read a control step if its number of substeps is unchanged; return whether it was read.

        ``truth`` holds all robots, shape (N, S, columns), ``time`` the hosts' clocks at its end in s of the
        robots that are read.
        """
        if self._shapes != {truth.shape[1:]}:
            return False
        if truth.dtype != np.float64 or not truth[0].flags.c_contiguous:
            truth = np.ascontiguousarray(truth, dtype=np.float64)
        packets = np.zeros(len(which), dtype=np.int32)
        rows = (truth.ctypes.data + which * truth.strides[0]).astype(np.uintp)
        call_for_many(self._sense, (self._at[which], rows, time, packets), threads)
        self.packets[which] = packets
        return True


def native_sensing(python: PythonSensing) -> SensingBackend:
    """Return a reader in C that continues from a Python one, or the latter if the library cannot read it."""
    instruments, telemetry, view, places = python.instruments, python.telemetry, python.view, python.places
    devices = {name: device for name, device in instruments.native.items() if device is not None}
    if places is None or len(devices) < len(instruments.native):
        return python
    if view is not None and view.bounds[0].dtype != np.float32:
        return python
    if telemetry is not None and not isinstance(telemetry, NativeTelemetry):
        return python
    for part in instruments.parts:
        check_wire(part.config, python.dt)
    return NativeSensing(python, devices, telemetry)
