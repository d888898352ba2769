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


def _constants(config: LoadCells) -> dict[str, Any]:
    element = config.mechanics
    slacks, excess = halving_slacks(element.hysteresis, SMALLEST_LOOP)
    shares, times = element.creep_shares, element.creep_time_constants
    if not any(shares):
        shares = times = ()
    return {
        "channels": config.channels,
        "clocked": config.rate is not None,
        "averaged": config.averaged,
        "settling": config.settling,
        "warms": config.warms,
        "shears": config.shear_std > 0.0,
        "plays": len(slacks),
        "creeps": len(shares),
        "highest_rate": config.rate[1] if config.rate else 0.0,
        "slope": config.slope,
        "zero_code": config.zero_code,
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
        **wire_constants(
            config.wire,
            config.counts_per_newton * config.capacity,
            config.code_range,
            config.adc_bits,
            config.channels,
            config.coding,
        ),
    }


CELLS = Kind("cells", load_cells, _constants, blocks=True)
