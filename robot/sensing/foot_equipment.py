"""The sensors that a user puts on a robot with feet: the options of all wrappers of sensors, as one value."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, TypedDict, Unpack

from surefoot.checks import check_flag
from surefoot.robot.sensing.condition import Faults, Severity, severity_range
from surefoot.robot.sensing.device import FootDevice
from surefoot.robot.streams import SENSOR_STREAM
from surefoot.sensors import Encoders, Imu, Link


class FootOptions(TypedDict, total=False):
    """Fields of :class:`FootEquipment` after the first, as keywords of wrappers."""

    ankles: str | Mapping[str, Any] | FootDevice | None
    imu: str | Mapping[str, Any] | Imu | None
    encoders: str | Mapping[str, Any] | Encoders | None
    link: str | Mapping[str, Any] | Link | None
    severity: Severity
    faults: Faults
    fresh: bool
    stream: int


@dataclass(frozen=True)
class FootEquipment:
    """The sensors of a robot with feet: which they are, how bad they are and when they are drawn.

    A device is the name of a preset, a configuration, or a mapping of a configuration's fields.

    Raises:
        TypeError: If ``severity`` is neither a number nor a pair of them, or ``fresh`` no boolean.
        ValueError: If ``severity`` is negative or not finite. Wrappers check the rest against their robot.

    >>> FootEquipment("icub-force-torque", severity=(0.0, 2.0)).severity
    (0.0, 2.0)
    """

    config: str | Mapping[str, Any] | FootDevice | None = None
    """What is under the feet: load cells, four a foot or one under a foot that touches at a point, or
    six-axis sensors. ``None`` for the cells of ``"hx711-load-cells"``, or larger ones of their kind for a
    robot that is too heavy for these (:func:`~surefoot.sensors.sized`). Change it to match your hardware."""

    ankles: str | Mapping[str, Any] | FootDevice | None = None
    """Six-axis sensors besides load cells; ``None`` for none. Change it if your robot has both."""

    imu: str | Mapping[str, Any] | Imu | None = None
    """The IMU. ``None`` for ``"nao-imu"`` on a robot that has a NAO's joint ``"LHipYawPitch"``, and
    ``"onboard-imu"`` on others. Change it if yours is much better or worse than a phone's."""

    encoders: str | Mapping[str, Any] | Encoders | None = None
    """The joint encoders. ``None`` for ``"nao-encoders"`` or ``"onboard-encoders"``."""

    link: str | Mapping[str, Any] | Link | None = None
    """The link over which encoders and IMU reach the host. ``None`` for ``"nao-wlan"``, 100 packets/s 20 ms
    late, or ``"onboard-500hz"``, 2 ms late. Change it if your policy runs elsewhere than on the robot."""

    severity: Severity = 1.0
    """Factor of all errors of the feet's sensors, see :func:`~surefoot.sensors.scaled`; or (lowest, highest),
    of which fresh sensors draw one. Change it to train for sensors that differ from robot to robot."""

    faults: Faults = ()
    """What breaks when, on the clock of the power-up: words such as ``"at t=12 s cell left/2 dies"``
    (:func:`~surefoot.sensors.parse_fault`), :class:`~surefoot.sensors.Fault` or mappings of its fields. Or
    probabilities of faults of a channel in an episode, drawn at each reset:
    ``{"dies": 0.02, "within 20 s drops 30 %": 0.05}`` (:mod:`surefoot.sensors.faults.chances`). Change it to
    train for broken channels."""

    fresh: bool = False
    """Whether every reset draws fresh sensors. Change it to train on a fleet instead of on one robot."""

    stream: int = SENSOR_STREAM
    """Number of the random stream. Change it for independent sensors on the same episode."""

    def __post_init__(self) -> None:
        """Raise an error if a value has no meaning."""
        severity_range(self.severity)
        check_flag("fresh", self.fresh)

    @property
    def options(self) -> dict[str, Any]:
        """All fields by name, as keywords of a wrapper."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def equip(
    config: str | Mapping[str, Any] | FootDevice | FootEquipment | None, **options: Unpack[FootOptions]
) -> FootEquipment:
    """Make equipment of a wrapper's arguments: a value, keywords, or both.

    Raises:
        TypeError: If there is no such option.
        ValueError: If an option is given twice.

    >>> equip(FootEquipment(severity=0.5), fresh=True) == FootEquipment(severity=0.5, fresh=True)
    True
    """
    usual = FootEquipment().options
    if unknown := sorted(set(options) - set(usual)):
        raise TypeError(f"Sensors of feet have no option {unknown[0]!r}; they have {list(usual)}.")
    if not isinstance(config, FootEquipment):
        return FootEquipment(config, **options)
    if twice := sorted(name for name in options if getattr(config, name) is not usual[name]):
        raise ValueError(
            f"{twice[0]!r} is given twice, in FootEquipment(...) and as a keyword; leave one out."
        )
    return replace(config, **options)
