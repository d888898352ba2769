"""Decide whether a calibrator is certain enough, with hysteresis."""

import math

import numpy as np
from numpy.typing import ArrayLike

from surefoot.checks import check_value

ENOUGH = 1.0e-3  # standard deviation of the centre of pressure in m at which a robot is certain; chosen
AGAIN = 1.5  # factor by which it may rise before the robot should calibrate again; chosen


class Certainty:
    """Monitor the standard deviation of the centre of pressure, averaged over ``memory`` s.

    A robot becomes certain at ``enough`` m and stays certain up to ``again``, by default 1.5 times that,
    which avoids switching back and forth. ``std`` is the average in m, infinite before the first value.
    ValueError if a number is not positive, or ``again`` is less than ``enough``.

    >>> certainty = Certainty(enough=1e-3, again=1.5e-3, memory=0.1, dt=0.1)
    >>> [certainty.update((std, 0.0)) for std in (2e-3, 0.5e-3, 1.4e-3, 3e-3)]
    [False, False, False, False]
    >>> [certainty.update((std, 0.0)) for std in (0.1e-3, 0.1e-3, 0.1e-3, 1.4e-3, 4e-3)]
    [False, True, True, True, False]
    """

    def __init__(
        self, enough: float = ENOUGH, again: float | None = None, memory: float = 1.0, dt: float = 1.0 / 80.0
    ) -> None:
        again = AGAIN * enough if again is None else again
        for name, value in {"enough": enough, "again": again, "memory": memory, "dt": dt}.items():
            check_value(name, value, positive=True)
        if again < enough:
            raise ValueError(f"'again' must be at least 'enough', {enough}, got {again}.")
        self.enough, self.again = float(enough), float(again)
        self._new = 1.0 - math.exp(-dt / memory)
        self.forget()

    def forget(self) -> None:
        """Forget all values."""
        self.std, self.certain = math.inf, False

    def update(self, cop_std: ArrayLike) -> bool:
        """Add standard deviations along x and y in m, shape (2,), and return whether the robot is certain."""
        variance = float(np.sum(np.square(np.asarray(cop_std, dtype=np.float64))))
        if math.isfinite(variance):
            before = variance if math.isinf(self.std) else self.std**2
            self.std = math.sqrt(before + self._new * (variance - before))
            self.certain = self.std <= (self.again if self.certain else self.enough)
        return self.certain
