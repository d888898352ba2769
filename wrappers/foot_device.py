"""What can be under a foot, as a user gives it; needs no simulator."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from surefoot.names import plain_name
from surefoot.sensors import PRESETS, Corruption, ForceTorque, LoadCells, force_torque, load_cells, preset
from surefoot.sensors.configuration import current_names, from_mapping
from surefoot.sensors.presets import resolve

FootDevice = LoadCells | ForceTorque
"""What can be under a foot."""

JITTER_BOUND = 6.0
"""Standard deviations of a wire's or a link's jitter that no word is late by."""


def foot_device(config: str | Mapping[str, Any] | FootDevice) -> FootDevice:
    """Make a configuration of a preset's name, a mapping or a configuration, of either kind.

    A mapping is of load cells, or of six-axis sensors if only those have all of its keys.

    Raises:
        ValueError: If the name or a key of the mapping is unknown, or a value is refused.
        TypeError: If it is none of the three.
    """
    if isinstance(config, ForceTorque):
        return config
    if isinstance(config, str) and plain_name(config) not in PRESETS[LoadCells]:
        if plain_name(config) in PRESETS[ForceTorque]:
            return preset(config, ForceTorque)
        names = {kind.__name__: sorted(PRESETS[kind]) for kind in (LoadCells, ForceTorque)}
        raise ValueError(f"There is no foot sensor preset '{config}'; there are {names}.")
    if isinstance(config, Mapping):
        config = current_names(config)
        if not set(config) <= _keys(LoadCells) and set(config) <= _keys(ForceTorque):
            return from_mapping(ForceTorque, config)
    return resolve(config, LoadCells)


def foot_corruption(config: FootDevice) -> Corruption[Any]:
    """Make what turns true loads into the readings of either kind."""
    return load_cells(config) if isinstance(config, LoadCells) else force_torque(config)


def _keys(kind: type[FootDevice]) -> set[str]:
    return {field.name for field in fields(kind)}
