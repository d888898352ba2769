"""The random streams of one robot's devices and state estimate, and the rule when a reset draws new ones."""

from typing import Any

import numpy as np

from surefoot.sensors.randomness import Stream

SENSOR_STREAM = 0x5F00  # default number of the random stream of sensors

BELIEF_STREAM = 0x5F01
"""Default number of the random stream for errors of the robot's own model."""

DEVICES = ("cells", "ankles", "faults", "telemetry", "condition")
"""Devices of a robot that draw random numbers, and their conditions. The index of each selects its stream."""


def device_streams(stream: int, seed: int | None) -> dict[str, Stream]:
    """Return the random streams of one robot's devices, from entropy of the system without a seed."""
    keys = ((stream, seed, number) if seed is not None else () for number in range(len(DEVICES)))
    return {device: Stream.of(*key) for device, key in zip(DEVICES, keys, strict=True)}


def wants_fresh(choice: str | None, seed: int | None, always: bool, drawn: bool) -> bool:
    """Return whether a reset draws fresh hardware.

    A reset with a seed draws, because the seed determines the whole episode. Without a seed the hardware is
    kept, unless the ``choice`` of the reset is ``"fresh"``, every reset ``always`` draws, or nothing was
    ``drawn`` yet.
    """
    if not drawn:
        return True
    return choice == "fresh" if choice else always or seed is not None


def check_stream(owner: str, stream: Any) -> None:
    """Raise ValueError, in the name of a wrapper, if its stream is no whole number from 0 on."""
    whole = isinstance(stream, (int, np.integer)) and not isinstance(stream, bool)
    if not whole or stream < 0:
        raise ValueError(f"{owner}: 'stream' must be a whole number from 0 on, got {stream!r}.")
