"""Faults of channels as the library has them; see :mod:`surefoot.sensors.devices.native_device`.

The Python of :mod:`surefoot.sensors.faults.channels` alone has more than sixteen of them.
"""

from typing import Any, NamedTuple

import numpy as np

from surefoot.sensors.corruption import Corruption
from surefoot.sensors.devices.native_device import Kind
from surefoot.sensors.faults.channels import (
    KINDS,
    Converter,
    Fault,
    FaultState,
    channel_faults,
    channels_of,
)


class Broken(NamedTuple):
    """An instrument with faults, which takes counts for loads.

    Attributes:
        faults: The faults, in the order in which they act.
        converter: The instrument.
    """

    faults: tuple[Fault, ...]
    converter: Converter

    @property
    def channels(self) -> int:
        """Number of the instrument's channels."""
        return len(self.converter.slope)


def _build(broken: Broken) -> Corruption[FaultState]:
    return channel_faults(*broken)


def _constants(broken: Broken) -> tuple[Any, ...]:
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


FAULTS = Kind("faults", _build, _constants)
