"""Honest models of foot sensors, IMUs and encoders: arrays in, arrays out, on a robot or a GPU."""

from surefoot.sensors.configuration import from_mapping
from surefoot.sensors.corruption import Corruption, chain
from surefoot.sensors.devices.encoders import Encoders, encoders
from surefoot.sensors.devices.force_torque import ForceTorque, ForceTorqueState, force_torque, true_matrix
from surefoot.sensors.devices.imu import Imu, ImuState, imu
from surefoot.sensors.devices.load_cell_config import LoadCells
from surefoot.sensors.devices.load_cells import (
    LoadCellState,
    load_cell_chain,
    load_cells,
    static_counts,
    true_map,
)
from surefoot.sensors.devices.strain_gauge_config import FTSENS_SN039, FTSENS_SN142, StrainGauges
from surefoot.sensors.devices.strain_gauges import (
    StrainGaugeState,
    read_sequence,
    shift_offset,
    strain_gauges,
    true_response,
)
from surefoot.sensors.faults.channels import Fault, FaultState, apply_faults, channel_faults
from surefoot.sensors.faults.words import CELLS, FEET, cell_names, parse_fault
from surefoot.sensors.presets import (
    ATI_MINI45,
    BAR_CELLS_ON_HX711,
    HX711_LOAD_CELLS,
    ICUB_FORCE_TORQUE,
    ICUB_FTSENS_FOOT,
    ICUB_FTSENS_LEG,
    NAO_FSR,
    PERFECT_FORCE_TORQUE,
    PERFECT_LOAD_CELLS,
    PERFECT_STRAIN_GAUGES,
    PRESETS,
    preset,
    resolve,
    sized,
)
from surefoot.sensors.severity import scaled
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE, drift, offset, scale, scale_drift
from surefoot.sensors.stages.clock import ClockState, sample_and_hold
from surefoot.sensors.stages.converter import noise_density, quantize, saturate, white_noise
from surefoot.sensors.stages.creep import CreepState, creep
from surefoot.sensors.stages.hysteresis import HysteresisState, hysteresis
from surefoot.sensors.stages.mechanics import Mechanics, MechanicsState, mechanics
from surefoot.sensors.stages.mounting import MountingState, mounting
from surefoot.sensors.stages.moving_average import MovingAverageState, moving_average
from surefoot.sensors.stages.nonlinearity import NonlinearityState, drawn_nonlinearity, nonlinearity
from surefoot.sensors.stages.overload import OverloadState, overload
from surefoot.sensors.stages.temperature import ThermalState, thermal_drift
from surefoot.sensors.transport.errors import (
    GapState,
    RepeatState,
    burst_gaps,
    spikes,
    stale_repeats,
    wrong_words,
)
from surefoot.sensors.transport.link import Link, Packet, latency, receive, send
from surefoot.sensors.transport.wire import Wire, WireState, check_wire, wire

__all__ = [
    "ATI_MINI45",
    "BAR_CELLS_ON_HX711",
    "CELLS",
    "FEET",
    "FTSENS_SN039",
    "FTSENS_SN142",
    "HX711_LOAD_CELLS",
    "ICUB_FORCE_TORQUE",
    "ICUB_FTSENS_FOOT",
    "ICUB_FTSENS_LEG",
    "NAO_FSR",
    "PERFECT_FORCE_TORQUE",
    "PERFECT_LOAD_CELLS",
    "PERFECT_STRAIN_GAUGES",
    "PER_SQRT_MINUTE",
    "PRESETS",
    "ClockState",
    "Corruption",
    "CreepState",
    "Encoders",
    "Fault",
    "FaultState",
    "ForceTorque",
    "ForceTorqueState",
    "GapState",
    "HysteresisState",
    "Imu",
    "ImuState",
    "Link",
    "LoadCellState",
    "LoadCells",
    "Mechanics",
    "MechanicsState",
    "MountingState",
    "MovingAverageState",
    "NonlinearityState",
    "OverloadState",
    "Packet",
    "RepeatState",
    "StrainGaugeState",
    "StrainGauges",
    "ThermalState",
    "Wire",
    "WireState",
    "apply_faults",
    "burst_gaps",
    "cell_names",
    "chain",
    "channel_faults",
    "check_wire",
    "creep",
    "drawn_nonlinearity",
    "drift",
    "encoders",
    "force_torque",
    "from_mapping",
    "hysteresis",
    "imu",
    "latency",
    "load_cell_chain",
    "load_cells",
    "mechanics",
    "mounting",
    "moving_average",
    "noise_density",
    "nonlinearity",
    "offset",
    "overload",
    "parse_fault",
    "preset",
    "quantize",
    "read_sequence",
    "receive",
    "resolve",
    "sample_and_hold",
    "saturate",
    "scale",
    "scale_drift",
    "scaled",
    "send",
    "shift_offset",
    "sized",
    "spikes",
    "stale_repeats",
    "static_counts",
    "strain_gauges",
    "thermal_drift",
    "true_map",
    "true_matrix",
    "true_response",
    "white_noise",
    "wire",
    "wrong_words",
]
