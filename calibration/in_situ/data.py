"""Sets of readings for in-situ calibration: counts, gravity and motion, one set for each added mass.

Conventions of this part of the library:

* The wrench w is what the limb exerts on the robot through the sensor, at and in the sensor's frame, in N and
  N m. At rest it is the weight of what hangs beyond the sensor, w = M(m, c) g with M = [m I; m [c]x] (in-situ
  paper, Eqs. 3-5). What the ground pushes with, under a foot that stands, adds to it.
* ``gravity`` is g in the sensor's frame and points **down**: the negative of what an accelerometer at rest
  reads. While the limb moves it is g - a with the acceleration a of the sensor's origin.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["InSituSet"]


@dataclass(frozen=True, eq=False)
class InSituSet:
    """The readings of one F/T sensor while one added mass hung on the limb (in-situ paper, III-C).

    Arrays are converted to float64 and checked at construction.

    Attributes:
        raw: Counts of the k >= 6 channels, shape (n, k); NaN where no sample arrived.
        gravity: g (moving: g - a) in the sensor's frame in m/s^2, pointing down, shape (n, 3).
        added_mass: Mass of what was added to the limb in kg; in motion it counts as a cube of steel.
        added_com: Its centre of mass in the sensor's frame in m, shape (3,).
        angular_velocity: Of the limb in the sensor's frame in rad/s, shape (n, 3); None if it stood still.
        angular_acceleration: In the sensor's frame in rad/s^2, shape (n, 3); given with the velocity
            or not at all.
        temperature: Of the sensor in K or degrees Celsius, shape (n,); None if it was not measured.
        time: Of the samples in s, increasing, shape (n,); None for samples without an order in time.
        name: What messages call the set.

    Raises:
        ValueError: If shapes do not belong together, time does not increase, or the mass is negative or not
            finite.

    >>> InSituSet(np.zeros((2, 6)), np.tile([0.0, 0.0, -9.81], (2, 1)), added_mass=0.5, name="cube").channels
    6
    """

    raw: NDArray[np.float64]
    gravity: NDArray[np.float64]
    added_mass: float = 0.0
    added_com: Any = (0.0, 0.0, 0.0)
    angular_velocity: NDArray[np.float64] | None = None
    angular_acceleration: NDArray[np.float64] | None = None
    temperature: NDArray[np.float64] | None = None
    time: NDArray[np.float64] | None = None
    name: str = "set"

    def __post_init__(self) -> None:
        """Convert all arrays to float64, and raise ValueError if they do not belong together."""
        raw = np.asarray(self.raw, dtype=np.float64)
        if raw.ndim != 2 or raw.shape[1] < 6:
            raise ValueError(f"'{self.name}': 'raw' must have shape (n, k) with k >= 6, got {raw.shape}.")
        object.__setattr__(self, "raw", raw)
        rows = len(raw)
        self._convert("gravity", self.gravity, (rows, 3))
        for name in ("angular_velocity", "angular_acceleration"):
            self._convert(name, getattr(self, name), (rows, 3))
        if (self.angular_velocity is None) != (self.angular_acceleration is None):
            raise ValueError(f"'{self.name}': give angular velocity and acceleration together, or neither.")
        for name in ("temperature", "time"):
            self._convert(name, getattr(self, name), (rows,))
        if self.time is not None and rows and not np.all(np.diff(self.time) > 0.0):
            raise ValueError(f"'{self.name}': 'time' must be finite and increase from sample to sample.")
        self._convert("added_com", self.added_com, (3,))
        if not np.all(np.isfinite(self.added_com)):
            raise ValueError(f"'{self.name}': 'added_com' must be finite, got {self.added_com}.")
        if not np.isfinite(self.added_mass) or self.added_mass < 0.0:
            raise ValueError(
                f"'{self.name}': 'added_mass' must be at least 0 kg and finite, got {self.added_mass!r}."
            )
        object.__setattr__(self, "added_mass", float(self.added_mass))

    @property
    def channels(self) -> int:
        """Number of channels k."""
        return int(self.raw.shape[1])

    @property
    def moves(self) -> bool:
        """Whether the limb's motion was recorded: it need not be at rest then."""
        return self.angular_velocity is not None

    def _convert(self, name: str, value: ArrayLike | None, shape: tuple[int, ...]) -> None:
        if value is None:
            return
        array = np.asarray(value, dtype=np.float64)
        if array.shape != shape:
            raise ValueError(f"'{self.name}': '{name}' must have shape {shape}, got {array.shape}.")
        object.__setattr__(self, name, array)
