"""What robots of a vector environment are equipped with, and what they are seeded with."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from surefoot.sensors import Encoders, Imu, Link, resolve, scaled
from surefoot.sensors.configuration import require
from surefoot.wrappers.instruments import FootDevice, foot_device
from surefoot.wrappers.source import check_stream
from surefoot.wrappers.telemetry import LONGEST_DELAY

Seeds = int | Sequence[int | None] | None
"""What a vector environment is seeded with."""


class Devices(NamedTuple):
    """What each robot is equipped with.

    Attributes:
        feet: What is under the feet.
        imu: The IMU.
        encoders: The joint encoders.
        link: The link to the host.
    """

    feet: FootDevice
    imu: Imu
    encoders: Encoders
    link: Link


def choose_devices(
    owner: str, feet: Any, imu: Any, encoders: Any, link: Any, severity: float, stream: int
) -> Devices:
    """Make configurations of preset names, mappings or configurations.

    Raises:
        ValueError: If a name is unknown or a value is refused.
    """
    check_stream(owner, stream)
    device = foot_device(feet)
    chosen = resolve(link, Link)
    require(
        chosen.delay <= LONGEST_DELAY,
        chosen,
        "delay",
        f"be at most {LONGEST_DELAY} s, which is as late as telemetry is of use here",
    )
    if severity != 1.0:
        device = scaled(device, severity)
    return Devices(device, resolve(imu, Imu), resolve(encoders, Encoders), chosen)


def seed_numbers(seed: Seeds) -> list[int]:
    """List the numbers of what a vector environment is seeded with; none without a seed."""
    if seed is None:
        return []
    if isinstance(seed, Sequence):
        return [int(number) for number in seed if number is not None]
    return [int(seed)]
