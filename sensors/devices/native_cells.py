"""Load cells of one robot by the library: the same states, the same counts, the same random numbers.

The Python of :mod:`surefoot.sensors.devices.load_cells` is the specification. It alone reads cells that
average without a clock (``settling`` above 1 and ``rate`` ``None``), more cells than the room for them,
batches, single precision, and what draws from a generator of NumPy's or torch's.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.native import Library, leaves_of, rebuilt
from surefoot.sensors.devices.load_cell_config import LoadCells
from surefoot.sensors.devices.load_cells import LoadCellState, load_cells
from surefoot.sensors.native import installed
from surefoot.sensors.randomness import Stream
from surefoot.sensors.stages.hysteresis import halving_slacks
from surefoot.sensors.stages.mechanics import SMALLEST_LOOP
from surefoot.sensors.transport.wire import ALONE, check_wire

Floats = NDArray[np.float64]


class NativeCellState:
    """A state of load cells as the library holds it; it goes on in place.

    Args:
        record: All numbers, shape ().
        cells: Whose state it is.
    """

    def __init__(self, record: NDArray[Any], cells: "NativeCells") -> None:
        self.record, self.address, self._cells = record, record.ctypes.data, cells

    def python(self) -> LoadCellState:
        """Return the state as the Python has it, which shares nothing with it."""
        return self._cells.unpack(self)

    def __reduce__(self) -> tuple[Any, ...]:
        # Another machine may have no library.
        return _itself, (self.python(),)


def _itself(state: LoadCellState) -> LoadCellState:
    return state


class NativeCells:
    """The load cells of one robot.

    Args:
        library: The library.
        config: The cells.
        record: Their constants.
    """

    def __init__(self, library: Library, config: LoadCells, record: NDArray[Any]) -> None:
        self._config, self._record, self._channels = config, record, config.channels
        self._template = load_cells(config).init((config.channels,), np.random.default_rng(0))
        leaves = {"_".join(path): leaf.shape for path, leaf in leaves_of(self._template)}
        dtype = library.record("cells", leaves)
        assert dtype is not None
        self._dtype, self._step = dtype, library.functions.surefoot_cells_step
        self._counts = np.empty(config.channels)
        self._block = np.empty((0, config.channels))
        self._addresses: tuple[int, ...] = ()
        self._checked: float | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        # Where there is no library, nothing comes of it.
        return native_cells_here, (self._config,)

    def pack(self, state: LoadCellState) -> NativeCellState:
        """Return a Python state as the library's."""
        record = np.zeros((), self._dtype)
        for path, leaf in leaves_of(state):
            record["_".join(path)] = leaf
        return NativeCellState(record, self)

    def unpack(self, state: NativeCellState) -> LoadCellState:
        """Return a state of the library's as the Python's, which shares nothing with it."""
        unpacked: LoadCellState = rebuilt(self._template, lambda path, _: state.record["_".join(path)].copy())
        return unpacked

    def takes(self, block: Any, rng: Any) -> bool:
        """Return whether the library can read a block, shape (S, K), with what chance comes from."""
        return (
            type(rng) is Stream
            and not rng.record.ndim
            and block.dtype == np.float64
            and block.ndim == 2
            and block.shape[1] == self._channels
            and len(block) > 0
        )

    def step(self, state: NativeCellState, block: Floats, stream: Stream, dt: float) -> Floats:
        """Read a block that :meth:`takes` has looked at; the state and the stream go on in place.

        Raises:
            ValueError: If the wire cannot hold what is under way, see
                :func:`~surefoot.sensors.transport.wire.check_wire`.
        """
        if dt != self._checked:
            check_wire(self._config, dt)
            self._checked = dt
        substeps = len(block)
        if substeps != len(self._block):
            self._block = np.empty((substeps, self._channels))
            self._addresses = tuple(part.ctypes.data for part in (self._record, self._block, self._counts))
        self._block[...] = block
        config, load, counts = self._addresses
        self._step(config, state.address, stream.address, load, substeps, dt, counts)
        return self._counts.copy()


def native_cells(library: Library | None, config: LoadCells) -> NativeCells | None:
    """Return the load cells of one robot by a library; ``None`` for those that it is not made for."""
    if library is None or library.real != np.float64:
        return None
    record = library.filled("cells_config", _values(config))
    if record is None or not library.functions.surefoot_cells_fits(record.ctypes.data):
        return None
    return NativeCells(library, config, record)


def native_cells_here(config: LoadCells) -> NativeCells | None:
    """Return the load cells of one robot by the library that is installed here; ``None`` without one."""
    return native_cells(installed(), config)


def _values(config: LoadCells) -> dict[str, Any]:
    """Return the constants by their names in ``sf_cells_config``."""
    element, wire = config.mechanics, config.wire
    slacks, excess = halving_slacks(element.hysteresis, SMALLEST_LOOP)
    shares, times = element.creep_shares, element.creep_time_constants
    if not any(shares):
        shares = times = ()
    low, high = config.code_range
    return {
        "channels": config.channels,
        "clocked": config.rate is not None,
        "settling": config.settling,
        "converts": config.adc_bits > 0,
        "warms": config.warms,
        "plays": len(slacks),
        "creeps": len(shares),
        "bits": config.adc_bits,
        "offset_binary": config.coding == "offset-binary",
        "late": wire.late,
        "under_way": wire.under_way,
        "highest_rate": config.rate[1] if config.rate else 0.0,
        "slope": config.slope,
        "zero_code": config.zero_code,
        "lowest": low,
        "highest": high,
        "noise": config.noise_counts,
        "scale_walk": config.scale_drift,
        "offset_walk": config.offset_drift,
        "temperature_ramp": config.temperature_ramp,
        "temperature_rise": config.temperature_rise,
        "capacity": config.capacity,
        "nonlinearity": element.nonlinearity,
        "hysteresis": element.hysteresis,
        "hysteresis_excess": excess,
        "slack": slacks,
        "creep_share": shares,
        "creep_time": times,
        "impact_threshold": element.impact_threshold,
        "warp_std": element.mounting_warp_std,
        "common_std": element.mounting_common_std,
        "overload_share": element.overload_share,
        "safe_load": element.safe_overload * config.capacity,
        "spike_rate": wire.spike_rate,
        "spike_size": wire.spike_size * abs(config.counts_per_newton * config.capacity),
        "wrong_words": wire.wrong_words,
        "stale_repeats": wire.stale_repeats,
        "packet_loss": wire.packet_loss,
        "packet_loss_length": ALONE,
        "gap_share": wire.gap_share,
        "gap_length": wire.gap_length,
        "delay": wire.delay,
        "jitter": wire.jitter,
    }
