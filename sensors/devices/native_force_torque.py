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


def _of_sensors(config: ForceTorque) -> tuple[Any, ...]:
    own = {
        "noise": np.tile(per_axis(config.noise_force, config.noise_torque), config.sensors),
        "full_scale_ratio": full_scale_ratio(config),
        "offset_walk": per_axis(config.offset_drift_force, config.offset_drift_torque),
    }
    return own, wire_constants(config, config.full_scale * config.slope, config.word_bits), config


def _of_gauges(config: StrainGauges) -> tuple[Any, ...]:
    most, true_at = lag(config)
    slacks, excess = halving_slacks(config.hysteresis, SMALLEST_LOOP, true_at)
    low, high = config.code_range
    own = {
        "plays": len(slacks),
        "of_load": config.hysteresis_of == "load",
        "creeps": len(config.creep_shares),
        "converts": config.adc_bits > 0,
        "hysteresis_excess": excess,
        "hysteresis_most": most,
        "slack": slacks,
        "walk_map": gauge_map(config, config.offset_drift_force, config.offset_drift_torque).T,
        "noise_map": gauge_map(config, config.noise_force, config.noise_torque).T,
        "lowest": low,
        "highest": high,
    }
    return own, config


FORCE_TORQUE = Kind("force_torque", force_torque, _of_sensors)
STRAIN_GAUGES = Kind("strain_gauges", strain_gauges, _of_gauges, loads=AXES)
