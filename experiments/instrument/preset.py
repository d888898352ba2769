"""A preset of the sensors of a log: the noise, drift, resolution and clock that :mod:`check` measures.

Noise and drift come from the Allan deviation of channels at rest (:mod:`noise`). Fields that the log does not
determine are not written, so that they keep the defaults of :class:`~surefoot.sensors.LoadCells` or
:class:`~surefoot.sensors.ForceTorque`.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import linregress

from surefoot.arrays import Floats
from surefoot.calibration.results import CalibrationRefused
from surefoot.experiments.force_torque.log import InSituLog
from surefoot.experiments.instrument.channels import ChannelFacts
from surefoot.experiments.instrument.noise import ROUNDING
from surefoot.experiments.instrument.recording import Recording
from surefoot.experiments.logs.format import Log
from surefoot.files import write_text
from surefoot.sensors import ForceTorque, LoadCells
from surefoot.sensors.devices.force_torque import AXES

FINEST = 2.0**24  # steps in the range of readings above which they must have been filtered or scaled
FOLLOWS = 0.5  # minimum correlation of a loaded cell with its load (the usual noise of 1 % gives nearly 1)
UNFILTERED_BITS = 24  # bits of the converters of load cells
Device = LoadCells | ForceTorque


def write_preset(path: Path, recording: Recording, facts: list[ChannelFacts]) -> Path:
    """Write the preset of a log as TOML, which takes the place of a preset's name.

    Raises:
        CalibrationRefused: If no channel rests, or no scale in newtons is known.
    """
    device, measured = find_preset(recording, facts)
    values = {name: asdict(device)[name] for name in measured}
    head = (
        f"# Measured by 'surefoot check {recording.file} --preset {path.name}'. Fields that are not listed "
        "were not measured,\n# and keep their defaults."
    )
    lines = [head, f"[{type(device).__name__}]", *(f"{key} = {_toml(one)}" for key, one in values.items())]
    write_text(path, "\n".join(lines) + "\n")
    return path


def find_preset(recording: Recording, facts: list[ChannelFacts]) -> tuple[Device, tuple[str, ...]]:
    """Return the device of a log and the names of its fields that were measured."""
    if not any(np.isfinite(one.noise.white) for one in facts):
        raise CalibrationRefused(
            f"{recording.file}: no channel rests, so noise and drift cannot be measured.",
            "Record half a minute of rest without a load, and give the times of rows.",
        )
    matrix = _matrix(recording)
    if matrix is not None:
        return _force_torque(facts, matrix, drifts=bool(recording.unloaded.any()))
    return _load_cells(recording, facts)


def _load_cells(recording: Recording, facts: list[ChannelFacts]) -> tuple[Device, tuple[str, ...]]:
    scale = _scale(recording)
    size = float(np.mean(np.abs(scale)))  # N per unit of the table
    unit, bits, binary = _converter(recording, facts, size)
    newtons = unit * size  # N per count
    highest = (recording.raw - np.nanmedian(recording.raw, axis=0)) * scale
    if recording.load is not None:
        highest = recording.load
    rates = [1.0 / one.noise.interval for one in facts if one.noise.interval > 0.0]
    # A bench does not have as many cells as a robot, so its number of channels is not part of the preset.
    channels = len(facts) if isinstance(recording.read, Log) else LoadCells().channels
    signs = tuple(int(one) for one in np.sign(scale))
    if channels % len(signs) or len(set(signs)) == 1:
        signs = (1 if sum(signs) >= 0 else -1,)
    values: dict[str, Any] = {
        "channels": channels,
        "capacity": max(LoadCells().capacity, float(np.nanmax(np.abs(highest)))),
        "polarity": signs,
        "adc_bits": bits,
        "coding": "offset-binary" if binary else "two's complement",
        "rate": (min(rates), max(rates)),
    }
    # Counts per newton are proportional to the rated output, and noise in counts to the noise of the input.
    device = LoadCells(**values)
    if bits:
        ratio = 1.0 / newtons / device.counts_per_newton
        values["rated_output"] = ratio * device.rated_output
        device = replace(device, rated_output=values["rated_output"])
    white = _rms([max(one.noise.white**2 - _rounding(one, bits), 0.0) ** 0.5 for one in facts])
    values["input_noise"] = white / unit * device.input_noise / device.noise_counts
    if recording.unloaded.any():
        values["offset_drift"] = size * _rms([one.noise.walk for one in facts])
    return LoadCells(**values), tuple(values)


def _force_torque(
    facts: list[ChannelFacts], matrix: Floats, *, drifts: bool
) -> tuple[Device, tuple[str, ...]]:
    """Return the sensor whose axes have the noise, drift and resolution of its channels."""
    measured: Mapping[str, list[float]] = {
        "resolution": [one.step if np.isfinite(one.step) else 0.0 for one in facts],
        "noise": [max(one.noise.white**2 - _rounding(one, 1), 0.0) ** 0.5 for one in facts],
        "offset_drift": [one.noise.walk if drifts else np.nan for one in facts],
    }
    values: dict[str, Any] = {"sensors": len(facts) // AXES}
    for name, channels in measured.items():
        # Independent errors of channels add up in the axes of the wrench.
        axes = np.sqrt(matrix**2 @ np.nan_to_num(np.array(channels)) ** 2).reshape(-1, 2, AXES // 2)
        if np.isfinite(channels).any():
            values[f"{name}_force"], values[f"{name}_torque"] = (_rms(axes[:, i]) for i in (0, 1))
    return ForceTorque(**values), tuple(values)


def _matrix(recording: Recording) -> Floats | None:
    """Return the map from channels to wrenches of six-axis sensors, shape (K, K); None for load cells."""
    read = recording.read
    if isinstance(read, InSituLog):
        if read.config.factory.matrix is None:
            raise CalibrationRefused(
                f"{recording.file}: no matrix turns the channels into newtons.",
                "Give the maker's matrix as 'factory' in the TOML file of the log.",
            )
        return np.array(read.config.factory.matrix, dtype=np.float64)
    six = isinstance(read, Log) and all(
        foot.position_cell_sole is None and foot.wrench_map.shape[1] == AXES for foot in read.layout.feet
    )
    return np.diag(recording.scale) if six and recording.scale is not None else None


def _scale(recording: Recording) -> Floats:
    """Return the scale of each channel in N per unit, from known loads or else from the description."""
    load = recording.load
    if load is not None and np.ptp(load) > 0.0:
        found = []
        for name, raw, on in zip(recording.names, recording.raw.T, load.T, strict=True):
            present = np.isfinite(raw)
            line = linregress(on[present], raw[present])
            if abs(line.rvalue) < FOLLOWS:
                raise CalibrationRefused(
                    f"{recording.file}: column '{name}' does not follow its load.",
                    "Check its wiring and that the load rests on it, or leave the column out.",
                )
            found.append(1.0 / line.slope)
        return np.array(found)
    if recording.scale is None:
        raise CalibrationRefused(
            f"{recording.file}: the size of a count in newtons is not known.",
            "Give the load of each row as load_kg or load_N, or a walk with its description.",
        )
    return recording.scale


def _converter(recording: Recording, facts: list[ChannelFacts], size: float) -> tuple[float, int, bool]:
    """Return the size of a count in the table's unit, the bits, and whether zero is in the middle of codes.

    Readings with 0 bits do not come directly from a converter. Their unit is a newton.
    """
    steps = [one.step for one in facts if np.isfinite(one.step)]
    unit = float(np.median(steps)) if steps else 1.0
    if unit * FINEST <= max(one.high - one.low for one in facts if np.isfinite(one.high)):
        return 1.0 / size, 0, False
    counts = recording.raw / unit
    highest = float(np.nanmax(np.abs(counts)))
    bits = max(int(np.ceil(np.log2(highest + 1.0))) + 1, 8)
    binary = bool(np.nanmedian(counts) > 2.0 ** (UNFILTERED_BITS - 2))
    return unit, UNFILTERED_BITS if highest > 2.0**15 else bits, binary


def _rounding(one: ChannelFacts, bits: int) -> float:
    """Return the variance of the rounding, which the emulated converter adds itself."""
    return ROUNDING * one.step**2 if bits and np.isfinite(one.step) else 0.0


def _rms(values: Any) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def _toml(value: Any) -> str:
    """Return a value as TOML, numbers to six digits."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(float(f"{value:.6g}") if isinstance(value, float) else value)
