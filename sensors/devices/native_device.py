"""Devices of one robot by the library: the same states, the same counts, the same random numbers.

The Python is the specification. It alone reads devices that are larger than the library's room, and those
that draw from a generator of NumPy's.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.native import SENSORS, Library, StateRecord, state_dtype
from surefoot.sensors.corruption import Corruption
from surefoot.sensors.randomness import Stream
from surefoot.sensors.transport.errors import CODINGS
from surefoot.sensors.transport.wire import ALONE, Wire, check_wire


class Kind(NamedTuple):
    """A kind of device that the library has."""

    name: str  # its records are ``sf_<name>_config`` and ``sf_<name>``
    build: Callable[[Any], Corruption[Any]]  # makes the Python of a configuration
    constants: Callable[[Any], tuple[Any, ...]]
    """Lists the sources of the first record of a configuration, as :meth:`~surefoot.native.Library.constants`
    takes them."""
    blocks: bool = False  # whether it reads blocks of substeps rather than an instant
    loads: int | None = None
    """How many loads it reads; ``None`` for as many as its configuration says, or as it has channels."""

    def count_loads(self, config: Any) -> int:
        """Return how many loads a device of a configuration reads."""
        return int(self.loads or getattr(config, "loads", config.channels))


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
        dtype = state_dtype(library, kind.name, self._template)
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

    def empty(self) -> StateRecord:
        """Return room for a state, before any was drawn."""
        return StateRecord(self.layout, self._template)

    def pack(self, state: Any) -> StateRecord:
        """Return a Python state as the library's."""
        native = self.empty()
        native.put(state)
        return native

    def step(self, state: StateRecord, load: Floats, stream: Stream, dt: float) -> Floats:
        """Read loads of an instant, (L,), or of a block of S substeps, (S, L), ``dt`` s after those before.

        The state and the stream of one robot go on in place. ValueError says that the wire cannot hold the
        readings under way, see :func:`~surefoot.sensors.transport.wire.check_wire`.
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
    """Return the device of one robot by a library; None for one that it is not made for, or ValueError."""
    if library is None:
        return None
    python = kind.build(config)
    record = library.constants(f"{kind.name}_config", *kind.constants(config))
    fits = getattr(library.functions, f"surefoot_{kind.name}_fits")
    if record is None or not fits(record.ctypes.data):
        return None
    return NativeDevice(library, kind, config, record, python)


def native_here(kind: Kind, config: Any) -> NativeDevice | None:
    """Return the device of one robot by the library that is installed here; ``None`` without one."""
    return native_device(SENSORS.installed(), kind, config)


def wire_constants(config: Any, rated: Any, bits: int, coding: str = CODINGS[1]) -> dict[str, Any]:
    """Return the constants of an instrument's wire that are not its own; arguments as of ``wire``."""
    low, high = (np.broadcast_to(end, config.channels) for end in config.code_range)
    return {
        "wire_bits": bits,
        "wire_offset_binary": coding == CODINGS[0],
        "wire_lowest": low,
        "wire_highest": high,
        "wire_spike_size": np.broadcast_to(config.wire.spike_size * np.abs(rated), config.channels),
        "wire_packet_loss_length": ALONE,
    }
