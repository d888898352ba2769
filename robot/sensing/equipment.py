"""The sensors of a type of robot: they are checked once and shared by all robots of that type."""

import re
from dataclasses import replace
from hashlib import sha256
from typing import Any, Final

from surefoot.envs import RobotDrawing
from surefoot.robot.sensing.condition import (
    Condition,
    Conditions,
    faults_of,
    severity_range,
)
from surefoot.robot.sensing.device import device_for_feet
from surefoot.robot.sensing.foot_equipment import FootEquipment
from surefoot.robot.sensing.instruments import Instruments, check_capacity, usual_cells
from surefoot.robot.streams import check_stream, device_streams
from surefoot.sensors import Encoders, Imu
from surefoot.sensors.presets import resolve
from surefoot.sensors.randomness import Stream
from surefoot.sensors.telemetry.computer import Telemetry, TelemetryLayout, timely_link
from surefoot.sensors.telemetry.native import telemetry_of

NAO_JOINT: Final = "LHipYawPitch"
"""Joint that identifies a NAO: its hips share one motor, and no other robot has a joint of this name."""

NAO_COMPUTER: Final = ("nao-imu", "nao-encoders", "nao-wlan")
"""IMU, encoders and link of a NAO that is controlled over a wireless network."""

ONBOARD_COMPUTER: Final = ("onboard-imu", "onboard-encoders", "onboard-500hz")
"""IMU, encoders and link of a robot with an onboard computer."""


class Equipment:
    """The sensors of a type of robot.

    Args:
        owner: Name of the wrapper, for messages.
        drawing: The robot.
        joint_names: Its J hinge joints.
        dt: Duration of a control step in s.
        given: The sensors that the user chose.
        seldom: Whether truth is read in only one of several substeps of a control step.

    Attributes:
        seldom: The same.
        instruments: The instruments under a robot's feet before anything is drawn.
        drawing: The robot.
        packet: Columns of a packet of its telemetry.
        fresh: Whether every reset draws fresh sensors.
        conditions: The distribution of a robot's condition.
        computer: Names of the presets of IMU, encoders and link; ``"custom"`` for others.

    Raises:
        TypeError: If faults are no sequence.
        ValueError: If a preset is unknown, a value is refused, or the feet have no place for the sensors.
    """

    def __init__(
        self,
        owner: str,
        drawing: RobotDrawing,
        joint_names: tuple[str, ...],
        dt: float,
        given: FootEquipment,
        seldom: bool = False,
    ) -> None:
        check_stream(owner, given.stream)
        self.seldom = seldom
        self.drawing, self._joint_names, self.packet = drawing, joint_names, TelemetryLayout(len(joint_names))
        config = usual_cells(drawing) if given.config is None else given.config
        feet = len(drawing.feet)
        devices = {"config": config, "ankles": given.ankles}.items()
        self._devices = [device_for_feet(part, feet, name) for name, part in devices if part is not None]
        self._dt = dt
        lowest, highest = severity_range(given.severity)
        # Of both ends, so that a severity that a device cannot have is refused here.
        self.instruments, *_ = [self.fit(Condition(end, ())) for end in dict.fromkeys((lowest, highest))]
        self._cells = self.instruments.layout.feet[0].channel_names
        self.conditions = Conditions(lowest, highest, *faults_of(given.faults, drawing.sides, self._cells))
        if self.conditions.usual != self.instruments.condition:
            self.instruments = self.fit(self.conditions.usual)
        check_capacity([part.config for part in self.instruments.parts], drawing)
        names = NAO_COMPUTER if NAO_JOINT in joint_names else ONBOARD_COMPUTER
        imu = names[0] if given.imu is None else given.imu
        encoders = names[1] if given.encoders is None else given.encoders
        link = names[2] if given.link is None else given.link
        self._configs = resolve(imu, Imu, "imu"), resolve(encoders, Encoders, "encoders"), timely_link(link)
        self._link_by_name = isinstance(link, str)
        self.computer = tuple(part if isinstance(part, str) else "custom" for part in (imu, encoders, link))
        self.fresh, self._stream = given.fresh, given.stream

    def with_severity(self, conditions: Conditions, severity: Any) -> Conditions:
        """Return conditions with another severity, a number or (lowest, highest).

        Raises:
            ValueError: If a device does not allow this severity.
        """
        lowest, highest = severity_range(severity)
        for end in {lowest, highest}:
            self.fit(Condition(end, ()))
        return conditions._replace(lowest=lowest, highest=highest)

    def with_faults(self, conditions: Conditions, faults: Any) -> Conditions:
        """Return conditions with other faults.

        Raises:
            ValueError: If a fault or a probability is refused.
        """
        given, chances = faults_of(faults, self.drawing.sides, self._cells)
        self.fit(Condition(conditions.usual.severity, given))
        return conditions._replace(faults=given, chances=chances)

    def fit(self, condition: Condition) -> Instruments:
        """Build the instruments under the feet of a robot in a given condition.

        Raises:
            ValueError: If a device does not allow the severity, or a fault names an unknown channel.
        """
        return Instruments(tuple(self._devices), self.drawing, self._dt, condition)

    def streams(self, seed: int | None) -> dict[str, Stream]:
        """Return the random streams of one robot's devices, which are not reproducible without a seed."""
        return device_streams(self._stream, seed)

    def telemetry(self, dt: float, substeps: int) -> Telemetry:
        """Build telemetry of control steps of ``dt`` s with so many substeps, the rows of truth.

        A link chosen by name sends at most one packet per row of truth.
        """
        imu, encoders, link = self._configs
        if self._link_by_name and link.rate is not None:
            link = replace(link, rate=min(link.rate, substeps / dt))
        return telemetry_of(len(self._joint_names), imu, encoders, link, dt, substeps)

    def notes(self) -> dict[str, str]:
        """Return a description of the robot and the sensors, which is saved with hardware."""
        drawing, places = self.drawing, self.drawing.position_cell_sole
        # Masses are left out because a battery or a payload changes them.
        skeleton = re.sub(r"<inertial[^>]*>", "", drawing.xml)
        mark = sha256(skeleton.encode() + (b"" if places is None else places.tobytes())).hexdigest()[:12]
        return {
            "robot": f"{drawing.torso} with {', '.join(self._joint_names)}, drawing {mark}",
            "sensors": " ".join(repr(part.config) for part in self.instruments.parts),
            "channels": " ".join(self.instruments.layout.channel_names),
            "faults": "; ".join(map(repr, (*self.conditions.faults, *self.conditions.chances))) or "none",
        }
