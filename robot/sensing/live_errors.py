"""Errors of the feet's sensors that are changed while the sensors run."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration import Parameters
from surefoot.robot.sensing.instruments import Instruments
from surefoot.sensors import Corruption, channel_faults, parse_fault


@dataclass
class _Broken:
    """A channel that is broken: in words, its effect on readings, and the state of that."""

    words: str
    fault: Corruption[Any]
    state: Any


class LiveErrors:
    """Errors that take the place of those of the hardware, and are changed between two readings.

    A reading c is undone by the hardware's true map, F = s c + o, and read again by a device with the errors
    of now: c' = zero + slope ((1 + e) F + b). Both e and b are the hardware's error, a drift and what the
    temperature does, times ``severity``, and each channel's own error on top. Noise, clocks and wires stay
    those of the hardware.

    Args:
        instruments: What is under the feet; its hardware must not drift by itself.
        walks: Densities of the drift of scale and offset in 1/sqrt(s) and N/sqrt(s), at a ``drift`` of 1.
        tempcos: Standard deviations of their change by a kelvin in 1/K and N/K, each channel its own.
        feet: Names of the feet, for words.
        dt: Time between readings in s.
        rng: Where the drift comes from.

    Attributes:
        severity: Factor of the errors of the hardware and of the drift.
        drift: Factor of the speed at which errors drift on.
        temperature: How much warmer the cells are than at power-up in K.
        scale: Each channel's own relative error of the scale, shape (K,).
        offset: Each channel's own error of the offset in N, shape (K,).
        parameters: The map that undoes all of it, as of the last reading: truth.
    """

    def __init__(
        self,
        instruments: Instruments,
        walks: tuple[float, float],
        tempcos: tuple[float, float],
        feet: tuple[str, ...],
        dt: float,
        rng: np.random.Generator,
    ) -> None:
        self._instruments, self._feet, self._dt, self._rng = instruments, feet, dt, rng
        self._spread = np.array(walks)[:, None] * dt**0.5
        self._walk = np.zeros((2, instruments.channels))
        # Spawned, so that the drift of a seed is the same for whoever asks for other coefficients.
        drawn = rng.spawn(1)[0].standard_normal(self._walk.shape)
        self._tempco = np.array(tempcos)[:, None] * drawn
        self._broken: list[_Broken] = []
        self.temperature = 0.0
        self.severity = self.drift = 1.0
        self.scale, self.offset = np.zeros((2, instruments.channels))
        self.parameters: Parameters = instruments.nominal

    @property
    def faults(self) -> tuple[str, ...]:
        """The faults, in words, in the order in which they came."""
        return tuple(broken.words for broken in self._broken)

    def read(self, raw: Floats, hardware: Parameters) -> Floats:
        """Return the host's readings in place of the hardware's, in counts, shape (K,).

        NaN stands where none arrived. The second map undoes the hardware's errors.
        """
        device = self._instruments
        drawn = self._rng.standard_normal(self._walk.shape)
        self._walk += self.drift * self._spread * drawn
        gain = 1.0 / (device.slope * hardware.scale)
        bias = -gain * (hardware.offset + device.zero_code * hardware.scale)
        moved = self._walk + self.temperature * self._tempco
        scale = 1.0 + self.severity * (gain - 1.0 + moved[0]) + self.scale
        offset = self.severity * (bias + moved[1]) + self.offset
        force = hardware.scale * raw + hardware.offset
        counts = np.clip(device.zero_code + device.slope * (scale * force + offset), *device.code_range)
        if np.isfinite(device.code_range).all():
            counts = np.rint(counts)
        undo = 1.0 / (device.slope * scale)
        self.parameters = Parameters(undo, -device.zero_code * undo - offset / scale)
        for broken in self._broken:
            counts, broken.state = broken.fault.apply(counts, broken.state, self._rng, self._dt)
        return np.asarray(counts)

    def break_channel(self, words: str) -> None:
        """Break a channel from the next reading but one on: ``"left/2 dies"``, as after ``at t=0 s cell``.

        Raises:
            ValueError: If nothing of that kind can happen, or there is no such cell.
        """
        layout = self._instruments.layout
        found = parse_fault(f"at t=0 s cell {words}", self._feet, layout.feet[0].channel_names)
        # The first reading is still right: a channel that sticks holds it.
        fault = channel_faults([replace(found, start=1.5 * self._dt)], self._instruments)
        state = fault.init((self._instruments.channels,), self._rng)
        self._broken.append(_Broken(words, fault, state))

    def repair(self) -> None:
        """Make all channels whole again."""
        self._broken.clear()
