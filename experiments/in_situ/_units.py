"""Units of the columns of a table of in-situ samples; private to the log's reader."""

from dataclasses import dataclass

import numpy as np

from surefoot.calibration import GRAVITY

__all__ = ["UNITS", "Units"]

_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_ACCELERATION = {"m/s^2": 1.0, "g": GRAVITY, "mg": 1e-3 * GRAVITY}
_ANGULAR_VELOCITY = {"rad/s": 1.0, "deg/s": float(np.pi / 180.0)}
_TEMPERATURE = {"degC": 0.0, "K": -273.15}

UNITS = {
    "time": _TIME,
    "acceleration": _ACCELERATION,
    "angular_velocity": _ANGULAR_VELOCITY,
    "temperature": _TEMPERATURE,
}
"""What each unit that a configuration may name is worth in SI, by the fields of :class:`Units`."""


@dataclass(frozen=True)
class Units:
    """What one unit of a column is worth in SI."""

    time: str = "s"
    acceleration: str = "m/s^2"
    angular_velocity: str = "rad/s"
    temperature: str = "degC"

    @property
    def second(self) -> float:
        return _TIME[self.time]

    @property
    def metre_per_second_squared(self) -> float:
        return _ACCELERATION[self.acceleration]

    @property
    def radian_per_second(self) -> float:
        return _ANGULAR_VELOCITY[self.angular_velocity]

    @property
    def zero_celsius(self) -> float:
        return _TEMPERATURE[self.temperature]
