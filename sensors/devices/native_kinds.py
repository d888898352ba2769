"""The kinds of devices that the library has; see :mod:`surefoot.sensors.devices.native_device`.

The Python alone reads cells that average without a clock (``settling`` above 1 and ``rate`` ``None``), more
than eight six-axis sensors, sensors of more than twelve gauges, and more than sixteen faults.
"""

from typing import Any, NamedTuple

import numpy as np

from surefoot.sensors.corruption import Corruption
from surefoot.sensors.devices.force_torque import (
    AXES,
    ForceTorque,
    force_torque,
    full_scale_ratio,
    per_axis,
)
from surefoot.sensors.devices.load_cell_config import LoadCells
from surefoot.sensors.devices.load_cells import load_cells
from surefoot.sensors.devices.native_device import Kind, wire_constants
from surefoot.sensors.devices.strain_gauge_config import StrainGauges
from surefoot.sensors.devices.strain_gauges import SMALLEST_LOOP as GAUGES_LOOP
from surefoot.sensors.devices.strain_gauges import gauge_map, strain_gauges
from surefoot.sensors.faults.channels import (
    KINDS,
    Converter,
    Fault,
    FaultState,
    channel_faults,
    channels_of,
)
from surefoot.sensors.stages.hysteresis import halving_slacks
from surefoot.sensors.stages.mechanics import SMALLEST_LOOP as CELLS_LOOP


def _of_cells(config: LoadCells) -> tuple[Any, ...]:
    element = config.mechanics
    slacks, excess = halving_slacks(element.hysteresis, CELLS_LOOP)
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


def _of_sensors(config: ForceTorque) -> tuple[Any, ...]:
    own = {
        "noise": np.tile(per_axis(config.noise_force, config.noise_torque), config.sensors),
        "full_scale_ratio": full_scale_ratio(config),
        "offset_walk": per_axis(config.offset_drift_force, config.offset_drift_torque),
    }
    return own, wire_constants(config, config.full_scale * config.slope, config.word_bits), config


def _of_gauges(config: StrainGauges) -> tuple[Any, ...]:
    slacks, excess = halving_slacks(config.hysteresis, GAUGES_LOOP, config.hysteresis_true)
    low, high = config.code_range
    own = {
        "plays": len(slacks),
        "creeps": len(config.creep_shares),
        "converts": config.adc_bits > 0,
        "hysteresis_excess": excess,
        "slack": slacks,
        "walk_map": gauge_map(config, config.offset_drift_force, config.offset_drift_torque).T,
        "noise_map": gauge_map(config, config.noise_force, config.noise_torque).T,
        "lowest": low,
        "highest": high,
    }
    return own, config


class Broken(NamedTuple):
    """An instrument with faults, which takes counts for loads."""

    faults: tuple[Fault, ...]  # the faults, in the order in which they act
    converter: Converter  # the instrument

    @property
    def channels(self) -> int:
        """Number of the instrument's channels."""
        return len(self.converter.slope)


def _build(broken: Broken) -> Corruption[FaultState]:
    return channel_faults(*broken)


def _of_faults(broken: Broken) -> tuple[Any, ...]:
    every, faults = channels_of(broken.converter), broken.faults
    own = [every[fault.channel] for fault in faults]
    ends = [
        channel.limits_at(fault.level) if fault.kind == "saturated" else (channel.low, channel.high)
        for fault, channel in zip(faults, own, strict=True)
    ]
    of_faults = {
        name: [getattr(fault, name) for fault in faults]
        for name in ("channel", "start", "rate", "probability", "burst")
    }
    return {
        **of_faults,
        "count": len(faults),
        "kind": [KINDS.index(fault.kind) for fault in faults],
        "other": [fault.other or 0 for fault in faults],
        "rounds": [channel.rounds for channel in own],
        "stop": [np.inf if fault.stop is None else fault.stop for fault in faults],
        "unloaded": [channel.unloaded for channel in own],
        "lowest": [low for low, _ in ends],
        "highest": [high for _, high in ends],
        "size": [abs(channel.slope) * fault.size for fault, channel in zip(faults, own, strict=True)],
    }, broken


CELLS = Kind("cells", load_cells, _of_cells, blocks=True)
FORCE_TORQUE = Kind("force_torque", force_torque, _of_sensors)
STRAIN_GAUGES = Kind("strain_gauges", strain_gauges, _of_gauges, loads=AXES)
FAULTS = Kind("faults", _build, _of_faults)
