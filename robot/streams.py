"""The random streams of one robot's devices and beliefs, and when a reset draws fresh ones."""

from typing import Any

import numpy as np

from surefoot.sensors.randomness import Stream

SENSOR_STREAM = 0x5F00  # number of the random stream that sensors draw from unless another is given

BELIEF_STREAM = 0x5F01
"""Number of the random stream that the errors of the robot's beliefs are drawn from."""

DEVICES = ("cells", "ankles", "faults", "telemetry", "condition")
"""Devices of a robot that draw, and how bad they are; each has a stream of its own within that one, by its
place here."""


def device_streams(stream: int, seed: int | None) -> dict[str, Stream]:
    """Return the random streams of one robot's devices; nobody knows them without a seed."""
    keys = ((stream, seed, number) if seed is not None else () for number in range(len(DEVICES)))
    return {device: Stream.of(*key) for device, key in zip(DEVICES, keys, strict=True)}


def wants_fresh(choice: str | None, seed: int | None, always: bool, drawn: bool) -> bool:
    """Return whether a reset draws fresh hardware.

    A seed names one course of events, so that it draws; without one hardware is kept, unless the reset's
    ``choice`` is ``"fresh"``, every reset ``always`` draws, or nothing was ``drawn`` yet.
    """
    if not drawn:
        return True
    return choice == "fresh" if choice else always or seed is not None


def check_stream(owner: str, stream: Any) -> None:
    """Raise ValueError, in the name of a wrapper, if its stream is no whole number from 0 on."""
    whole = isinstance(stream, (int, np.integer)) and not isinstance(stream, bool)
    if not whole or stream < 0:
        raise ValueError(f"{owner}: 'stream' must be a whole number from 0 on, got {stream!r}.")
