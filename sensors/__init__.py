"""Honest models of foot sensors, IMUs and encoders: NumPy arrays in, NumPy arrays out.

The top level has configurations, presets, builders of devices, faults, and the simplest stages. All other
stages are in :mod:`surefoot.sensors.stages` and :mod:`surefoot.sensors.transport`, states beside the
functions that make them. The work of the robot's own computer on encoders and IMU is in
:mod:`surefoot.sensors.telemetry`.
"""

from surefoot.sensors.corruption import Corruption, chain
from surefoot.sensors.devices.encoders import Encoders, encoders
from surefoot.sensors.devices.force_torque import ForceTorque, force_torque
from surefoot.sensors.devices.imu import Imu, imu
from surefoot.sensors.devices.load_cell_config import LoadCells
from surefoot.sensors.devices.load_cells import load_cells
from surefoot.sensors.devices.strain_gauge_config import StrainGauges
from surefoot.sensors.devices.strain_gauges import strain_gauges
from surefoot.sensors.faults.channels import Fault, apply_faults, channel_faults
from surefoot.sensors.faults.words import parse_fault
from surefoot.sensors.presets import PRESETS, preset, register_preset, sized
from surefoot.sensors.severity import scaled
from surefoot.sensors.stages.affine import drift, offset, scale, scale_drift
from surefoot.sensors.stages.converter import quantize, saturate, white_noise
from surefoot.sensors.stages.mechanics import Mechanics
from surefoot.sensors.transport.link import Link
from surefoot.sensors.transport.wire import Wire

__all__ = [
    "PRESETS",
    "Corruption",
    "Encoders",
    "Fault",
    "ForceTorque",
    "Imu",
    "Link",
    "LoadCells",
    "Mechanics",
    "StrainGauges",
    "Wire",
    "apply_faults",
    "chain",
    "channel_faults",
    "drift",
    "encoders",
    "force_torque",
    "imu",
    "load_cells",
    "offset",
    "parse_fault",
    "preset",
    "quantize",
    "register_preset",
    "saturate",
    "scale",
    "scale_drift",
    "scaled",
    "sized",
    "strain_gauges",
    "white_noise",
]
