"""What a robot's sensors are, as long as the power is on."""

from typing import Any, NamedTuple

from surefoot.wrappers.instruments import InstrumentsState


class HardwareState(NamedTuple):
    """What stays as it is while the power is on, whatever happens to the robot.

    Attributes:
        instruments: What is under the feet.
        faults: What is broken about it, or ``()``.
        telemetry: IMU and encoders (:class:`~surefoot.wrappers.telemetry.Hardware`), or ``None`` where nobody
            listens.
    """

    instruments: InstrumentsState
    faults: Any
    telemetry: Any
