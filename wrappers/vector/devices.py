"""What robots of a vector environment are equipped with."""

from typing import Any, NamedTuple

from surefoot.sensors import Encoders, Imu, Link, scaled
from surefoot.sensors.presets import resolve
from surefoot.wrappers.foot_device import FootDevice, foot_device
from surefoot.wrappers.source import check_stream
from surefoot.wrappers.telemetry import timely_link


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
    chosen = timely_link(link)
    if severity != 1.0:
        device = scaled(device, severity)
    return Devices(device, resolve(imu, Imu), resolve(encoders, Encoders), chosen)
