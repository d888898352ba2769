"""Magnetic joint encoders: a constant offset, some noise, and 12 bits a turn."""

from dataclasses import dataclass
from math import tau
from typing import Any

from surefoot.sensors.configuration import Bits, Error, check_fields
from surefoot.sensors.corruption import Corruption, chain, device
from surefoot.sensors.stages.affine import drift
from surefoot.sensors.stages.converter import quantize, white_noise


@dataclass(frozen=True)
class Encoders:
    """Joint encoders; the defaults are a NAO's after a careful calibration of its joints."""

    bits: Bits = 12
    """Bits a turn; 0 does not round."""

    bias_std: Error = 1.0e-3
    """Standard deviation of the joint's offset in rad, constant from power-up."""

    noise_std: Error = 3.0e-4
    """Noise of one reading in rad."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value is impossible."""
        check_fields(self)

    @property
    def resolution(self) -> float:
        """Smallest step in rad; 0 does not round."""
        return tau / 2.0**self.bits if self.bits else 0.0


@device
def encoders(config: Encoders) -> Corruption[Any]:
    """Build joint encoders; readings are angles in rad, shape (J,)."""
    return chain(drift(config.bias_std), white_noise(config.noise_std), quantize(config.resolution))
