"""Devices of one robot by the library: the same states, the same counts, the same random numbers.

The Python is the specification. It alone reads devices that are larger than the library's room, and those
that draw from a generator of NumPy's.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.native import SENSORS, Library, leaves_of, rebuilt
from surefoot.sensors.corruption import Corruption
from surefoot.sensors.randomness import Stream
from surefoot.sensors.transport.errors import CODINGS
from surefoot.sensors.transport.wire import ALONE, Wire, check_wire

Floats = NDArray[np.float64]


class Kind(NamedTuple):
    """A kind of device that the library has.

    Attributes:
        name: Its records are ``sf_<name>_config`` and ``sf_<name>``.
        build: Makes the Python of a configuration.
        constants: Returns the values of the first record of a configuration, by its names there.
        blocks: Whether it reads blocks of substeps rather than an instant.
        loads: How many loads it reads; ``None`` for as many as its configuration says, or as it has channels.
    """

    name: str
    build: Callable[[Any], Corruption[Any]]
    constants: Callable[[Any], dict[str, Any]]
    blocks: bool = False
    loads: int | None = None

    def count_loads(self, config: Any) -> int:
        """Return how many loads a device of a configuration reads."""
        return int(self.loads or getattr(config, "loads", config.channels))


class NativeState:
    """A device's state as the library holds it; it goes on in place.

    Args:
        record: All numbers, shape ().
        owner: Whose state it is.

    Attributes:
        owner: The same.
    """

    def __init__(self, record: NDArray[Any], owner: "NativeDevice") -> None:
        self.record, self.address, self.owner = record, record.ctypes.data, owner

    def take(self, state: Any) -> None:
        """Go on from a state as the Python has it."""
        for path, leaf in leaves_of(state):
            self.record["_".join(path)] = leaf

    def python(self) -> Any:
        """Return the state as the Python has it, which shares nothing with it."""
        return self.owner.unpack(self)


class NativeDevice:
    """A device of one robot.

    Args:
        library: The library.
        kind: Its kind.
        config: The instrument.
        constants: Its constants, as the library has them.
        python: The same device in Python.

    Attributes:
        kind: Its kind.
        constants: Its constants.
        python: The same device in Python.
        layout: Of its states' records.
    """

    def __init__(
        self, library: Library, kind: Kind, config: Any, constants: NDArray[Any], python: Corruption[Any]
    ) -> None:
        self.kind, self._config, self.constants, self.python = kind, config, constants, python
        self._felt = kind.count_loads(config)
        self._template = python.init((config.channels,), np.random.default_rng(0))
        leaves = {"_".join(path): leaf.shape for path, leaf in leaves_of(self._template)}
        dtype = library.record(kind.name, leaves)
        assert dtype is not None
        self.layout = dtype
        self._step: Any = getattr(library.functions, f"surefoot_{kind.name}_step", None)
        self._counts = np.empty(config.channels)
        self._load = np.empty((0, self._felt))
        self._addresses: tuple[int, ...] = ()
        self._wire: Wire | None = getattr(config, "wire", None)
        self._checked: float | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        # Where there is no library, nothing comes of it.
        return native_here, (self.kind, self._config)

    def empty(self) -> NativeState:
        """Return room for a state, before any was drawn."""
        return NativeState(np.zeros((), self.layout), self)

    def pack(self, state: Any) -> NativeState:
        """Return a Python state as the library's."""
        native = self.empty()
        native.take(state)
        return native

    def unpack(self, state: NativeState) -> Any:
        """Return a state of the library's as the Python's, which shares nothing with it."""
        return rebuilt(self._template, lambda path, _: state.record["_".join(path)].copy())

    def step(self, state: NativeState, load: Floats, stream: Stream, dt: float) -> Floats:
        """Read loads; the state and the stream go on in place.

        Args:
            state: Of this device.
            load: Of an instant, shape (L,), or of a block of S substeps, shape (S, L), as the Python has it.
            stream: Where chance comes from, that of one robot.
            dt: Time since the reading before in s.

        Raises:
            ValueError: If the wire cannot hold the readings under way, see
                :func:`~surefoot.sensors.transport.wire.check_wire`.
        """
        if dt != self._checked:
            if self._wire is not None:
                check_wire(self._wire, dt)
            self._checked = dt
        rows = len(load) if self.kind.blocks else 1
        if rows != len(self._load):
            self._load = np.empty((rows, self._felt))
            self._addresses = tuple(part.ctypes.data for part in (self.constants, self._load, self._counts))
        self._load[...] = load
        config, loads, counts = self._addresses
        self._step(config, state.address, stream.address, loads, rows, dt, counts)
        return self._counts.copy()


def native_device(library: Library | None, kind: Kind, config: Any) -> NativeDevice | None:
    """Return the device of one robot by a library; ``None`` for one that it is not made for.

    Raises:
        ValueError: If there can be no such device at all.
    """
    if library is None:
        return None
    python = kind.build(config)
    record = library.record_of(f"{kind.name}_config", kind.constants(config))
    fits = getattr(library.functions, f"surefoot_{kind.name}_fits")
    if record is None or not fits(record.ctypes.data):
        return None
    return NativeDevice(library, kind, config, record, python)


def native_here(kind: Kind, config: Any) -> NativeDevice | None:
    """Return the device of one robot by the library that is installed here; ``None`` without one."""
    return native_device(SENSORS.installed(), kind, config)


def wire_constants(
    wire: Wire, rated: Any, code_range: tuple[Any, Any], bits: int, channels: int, coding: str = CODINGS[1]
) -> dict[str, Any]:
    """Return the constants of a wire in a device's record; arguments as of the Python's ``wire``."""
    low, high = (np.broadcast_to(end, channels) for end in code_range)
    return {
        "wire_bits": bits,
        "wire_offset_binary": coding == CODINGS[0],
        "wire_late": wire.late,
        "wire_under_way": wire.under_way,
        "wire_lowest": low,
        "wire_highest": high,
        "wire_spike_size": np.broadcast_to(wire.spike_size * np.abs(rated), channels),
        "wire_spike_rate": wire.spike_rate,
        "wire_wrong_words": wire.wrong_words,
        "wire_stale_repeats": wire.stale_repeats,
        "wire_packet_loss": wire.packet_loss,
        "wire_packet_loss_length": ALONE,
        "wire_gap_share": wire.gap_share,
        "wire_gap_length": wire.gap_length,
        "wire_delay": wire.delay,
        "wire_jitter": wire.jitter,
    }
