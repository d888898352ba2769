"""Load cells as the library has them; see :mod:`surefoot.sensors.devices.native_device`.

The Python of :mod:`surefoot.sensors.devices.load_cells` alone reads cells that average without a clock
(``settling`` above 1 and ``rate`` ``None``).
"""

from typing import Any

from surefoot.sensors.devices.load_cell_config import LoadCells
from surefoot.sensors.devices.load_cells import load_cells
from surefoot.sensors.devices.native_device import Kind, wire_constants
from surefoot.sensors.stages.hysteresis import halving_slacks
from surefoot.sensors.stages.mechanics import SMALLEST_LOOP


def _constants(config: LoadCells) -> tuple[Any, ...]:
    element = config.mechanics
    slacks, excess = halving_slacks(element.hysteresis, SMALLEST_LOOP)
    shares, times = element.creep_shares, element.creep_time_constants
    if not any(shares):
        shares = times = ()
    own = {
        "clocked": config.rate is not None,
        "shears": config.shear_std > 0.0,
        "plays": len(slacks),
        "creeps": len(shares),
        "highest_rate": config.rate[1] if config.rate else 0.0,
        "hysteresis_excess": excess,
        "slack": slacks,
        "creep_shares": shares,
        "creep_time_constants": times,
        "safe_load": element.safe_overload * config.capacity,
    }
    rated = config.counts_per_newton * config.capacity
    return own, wire_constants(config, rated, config.adc_bits, config.coding), config, element


CELLS = Kind("cells", load_cells, _constants, blocks=True)
