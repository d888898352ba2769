"""Small pushes against the torso."""

from collections.abc import Sequence
from math import cos, pi, sin
from typing import Any

import numpy as np

from surefoot.envs.options import checked_range, positive

PUSH_TIME = 0.1
"""How long a push lasts in s."""


class Pushes:
    """Horizontal pushes of constant force at the torso's centre of mass, at random times.

    Args:
        model: The robot.
        impulse: Smallest and largest impulse in N s.
        interval: Mean time from one push to the next in s; the intervals are exponentially distributed.
        dt: Control step in s.

    Attributes:
        quiet_time: How long after a reset none comes, in s.
    """

    quiet_time = 0.0

    def __init__(self, model: Any, impulse: Sequence[float], interval: float, dt: float) -> None:
        self._impulse = checked_range("push_impulse", impulse)
        self._interval = positive("push_interval", interval) / dt
        self._length = round(PUSH_TIME / dt)
        self._dt = dt
        self._body = int(model.body("torso").id)
        self._next = 0.0
        self._left = 0

    def reset(self, rng: np.random.Generator) -> None:
        """Draw when the first push comes."""
        self._left = 0
        self._next = self.quiet_time / self._dt + rng.exponential(self._interval)

    def apply(self, data: Any, rng: np.random.Generator) -> None:
        """Push, or not, during the control step that follows."""
        if self._impulse[1] == 0.0:
            return
        self._next -= 1.0
        if self._left > 0:
            self._left -= 1
            if self._left == 0:
                data.xfrc_applied[self._body, :3] = 0.0
        if self._next <= 0.0:
            force = rng.uniform(*self._impulse) / (self._length * self._dt)
            angle = rng.uniform(-pi, pi)
            data.xfrc_applied[self._body, :3] = (force * cos(angle), force * sin(angle), 0.0)
            self._left = self._length
            self._next = rng.exponential(self._interval)
