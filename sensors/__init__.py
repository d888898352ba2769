"""Honest models of foot sensors, IMUs and encoders: arrays in, arrays out, on a robot or a GPU."""

from surefoot.sensors.clock import ClockState, sample_and_hold
from surefoot.sensors.configuration import from_mapping
from surefoot.sensors.corruption import Corruption, chain
from surefoot.sensors.drift import PER_SQRT_MINUTE, drift, gain_drift
from surefoot.sensors.encoders import Encoders, encoders
from surefoot.sensors.faults import Fault, FaultState, apply_faults, channel_faults
from surefoot.sensors.force_torque import ForceTorque, ForceTorqueState, force_torque, true_matrix
from surefoot.sensors.gain import gain, offset
from surefoot.sensors.imu import Imu, ImuState, imu
from surefoot.sensors.link import Link, Packet, latency, receive, send
from surefoot.sensors.load_cell_config import LoadCells
from surefoot.sensors.load_cells import (
    LoadCellState,
    load_cell_chain,
    load_cells,
    static_counts,
    true_map,
)
from surefoot.sensors.noise import noise_density, white_noise
from surefoot.sensors.presets import (
    HX711_LOAD_CELLS,
    ICUB_FORCE_TORQUE,
    PERFECT_FORCE_TORQUE,
    PERFECT_LOAD_CELLS,
    PRESETS,
    preset,
    resolve,
)
from surefoot.sensors.quantize import quantize, saturate
from surefoot.sensors.temperature import ThermalState, thermal_drift

__all__ = [
    "HX711_LOAD_CELLS",
    "ICUB_FORCE_TORQUE",
    "PERFECT_FORCE_TORQUE",
    "PERFECT_LOAD_CELLS",
    "PER_SQRT_MINUTE",
    "PRESETS",
    "ClockState",
    "Corruption",
    "Encoders",
    "Fault",
    "FaultState",
    "ForceTorque",
    "ForceTorqueState",
    "Imu",
    "ImuState",
    "Link",
    "LoadCellState",
    "LoadCells",
    "Packet",
    "ThermalState",
    "apply_faults",
    "chain",
    "channel_faults",
    "drift",
    "encoders",
    "force_torque",
    "from_mapping",
    "gain",
    "gain_drift",
    "imu",
    "latency",
    "load_cell_chain",
    "load_cells",
    "noise_density",
    "offset",
    "preset",
    "quantize",
    "receive",
    "resolve",
    "sample_and_hold",
    "saturate",
    "send",
    "static_counts",
    "thermal_drift",
    "true_map",
    "true_matrix",
    "white_noise",
]
