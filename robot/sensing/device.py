"""Instruments under a foot, as a user gives them; needs no simulator."""

from collections.abc import Mapping
from dataclasses import fields, replace
from math import ceil
from typing import Any

from surefoot.names import plain_name
from surefoot.sensors import PRESETS, ForceTorque, LoadCells, preset
from surefoot.sensors.configuration import from_mapping
from surefoot.sensors.presets import PRESET_FILE, read_preset, refuse_config, resolve
from surefoot.sensors.transport.link import JITTER_BOUND

FootDevice = LoadCells | ForceTorque  # what can be under a foot


def foot_device(config: str | Mapping[str, Any] | FootDevice, name: str = "config") -> FootDevice:
    """Make a configuration of a preset's name or file, a mapping or a configuration, of either kind.

    A mapping is of load cells, or of six-axis sensors if only those have all of its keys. Messages call the
    argument by its name.

    Raises:
        ValueError: If the name or a key of the mapping is unknown, or a value is refused.
        TypeError: If it is none of the three.
    """
    if isinstance(config, FootDevice):
        return config
    if not isinstance(config, str | Mapping):
        raise refuse_config(config, name, "LoadCells or ForceTorque")
    if isinstance(config, str) and config.endswith(PRESET_FILE):
        device = read_preset(config)
        if not isinstance(device, FootDevice):
            raise ValueError(f"{config}: is a preset of {type(device).__name__}, not of sensors of feet.")
        return device
    if isinstance(config, str) and plain_name(config) not in PRESETS[LoadCells]:
        if plain_name(config) in PRESETS[ForceTorque]:
            return preset(config, ForceTorque)
        names = {kind.__name__: sorted(PRESETS[kind]) for kind in (LoadCells, ForceTorque)}
        raise ValueError(f"There is no foot sensor preset '{config}'; there are {names}.")
    if (
        isinstance(config, Mapping)
        and not set(config) <= _keys(LoadCells)
        and set(config) <= _keys(ForceTorque)
    ):
        return from_mapping(ForceTorque, config)
    return resolve(config, LoadCells)


def device_for_feet(config: str | Mapping[str, Any] | FootDevice, feet: int, name: str) -> FootDevice:
    """Make a configuration as :func:`foot_device` does; presets have a six-axis sensor a foot."""
    device = foot_device(config, name)
    return (
        replace(device, sensors=feet)
        if isinstance(config, str) and isinstance(device, ForceTorque)
        else device
    )


def first_steps(configs: tuple[FootDevice, ...], dt: float) -> list[float]:
    """Return after how long to read robots that start an episode, again and again, in s.

    Every chip delivers at least once, and readings in filters or on their way run through; control steps are
    ``dt`` s long.
    """
    slowest = max(
        1.0 / c.rate[0] if isinstance(c, LoadCells) and c.rate is not None else 0.0 for c in configs
    )
    memory = max(map(_memory, configs))
    return [max(dt, slowest)] + [dt] * (1 + ceil(memory / dt) if memory else 0)


def _memory(config: FootDevice) -> float:
    """Return for how long readings may still be of an earlier load, in s."""
    wire = config.wire
    latest: float = wire.delay + JITTER_BOUND * wire.jitter
    if isinstance(config, LoadCells) and config.rate is not None and config.settling > 1:
        latest += config.settling / config.rate[0]
    return latest


def _keys(kind: type[FootDevice]) -> set[str]:
    return {field.name for field in fields(kind)}
