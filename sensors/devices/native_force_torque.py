"""Six-axis sensors as the library has them; see :mod:`surefoot.sensors.devices.native_device`.

The Python of :mod:`surefoot.sensors.devices.force_torque` alone reads more than eight sensors, and that of
:mod:`surefoot.sensors.devices.strain_gauges` sensors of more than twelve gauges.
"""

from typing import Any

import numpy as np

from surefoot.sensors.devices.force_torque import (
    AXES,
    ForceTorque,
    force_torque,
    full_scale_ratio,
    per_axis,
)
from surefoot.sensors.devices.native_device import Kind, wire_constants
from surefoot.sensors.devices.strain_gauge_config import StrainGauges
from surefoot.sensors.devices.strain_gauges import SMALLEST_LOOP, gauge_map, lag, strain_gauges
from surefoot.sensors.stages.hysteresis import halving_slacks


def _of_sensors(config: ForceTorque) -> dict[str, Any]:
    rated = config.full_scale * config.slope
    return {
        "sensors": config.sensors,
        "slope": config.slope,
        "noise": np.tile(per_axis(config.noise_force, config.noise_torque), config.sensors),
        "full_scale_ratio": full_scale_ratio(config),
        "scale_walk": config.scale_drift,
        "offset_walk": per_axis(config.offset_drift_force, config.offset_drift_torque),
        **wire_constants(config.wire, rated, config.code_range, config.word_bits, config.channels),
    }


def _of_gauges(config: StrainGauges) -> dict[str, Any]:
    most, true_at = lag(config)
    slacks, excess = halving_slacks(config.hysteresis, SMALLEST_LOOP, true_at)
    low, high = config.code_range
    return {
        "channels": config.channels,
        "bends": config.bends,
        "plays": len(slacks),
        "of_load": config.hysteresis_of == "load",
        "creeps": len(config.creep_shares),
        "walks": config.walks,
        "noisy": config.noisy,
        "converts": config.adc_bits > 0,
        "full_scale": config.full_scale,
        "creep_share": config.creep_shares,
        "creep_time": config.creep_time_constants,
        "hysteresis": config.hysteresis,
        "hysteresis_excess": excess,
        "hysteresis_most": most,
        "slack": slacks,
        "walk_map": gauge_map(config, config.offset_drift_force, config.offset_drift_torque).T,
        "noise_map": gauge_map(config, config.noise_force, config.noise_torque).T,
        "temperature_ramp": config.temperature_ramp,
        "temperature_rise": config.temperature_rise,
        "lowest": low,
        "highest": high,
    }


FORCE_TORQUE = Kind("force_torque", force_torque, _of_sensors)
STRAIN_GAUGES = Kind("strain_gauges", strain_gauges, _of_gauges, loads=AXES)
