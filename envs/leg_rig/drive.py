"""How the hip of the in-situ rig follows commanded speeds: gently, and never beyond its range."""

import numpy as np

from surefoot.arrays import Floats


class HipDrive:
    """Targets of position servos that follow speeds with limited acceleration in rad/s^2.

    A speed changes evenly over a step of ``step`` s, by at most ``acceleration`` times that, and only so that
    the target can still come to rest within its range, ``low`` to ``high`` in rad, (J,); a step has
    ``substeps`` targets. ``target`` and its ``speed`` are those of now in rad and rad/s, (J,).
    """

    def __init__(self, low: Floats, high: Floats, *, acceleration: float, step: float, substeps: int) -> None:
        self.target, self.speed = 0.5 * (low + high), np.zeros(len(low))
        self._low, self._high = low, high
        self._change, self._step = acceleration * step, step
        self._fraction = np.arange(1, substeps + 1)[:, None] / substeps

    def rest(self, target: Floats) -> None:
        """Stand still at ``target``."""
        self.target, self.speed = target.copy(), np.zeros(len(target))

    def follow(self, wanted: Floats) -> Floats:
        """Approach wanted speeds in rad/s, (J,), for a step by targets in rad, (substeps, J)."""
        last = self.speed
        self.speed = self._next_speed(wanted)
        f = self._fraction
        moved = self._step * (f * last + 0.5 * f**2 * (self.speed - last))
        targets = np.clip(self.target + moved, self._low, self._high)
        self.target = targets[-1]
        return targets

    def ahead(self, time: float) -> Floats:
        """Where the target will be in ``time`` s, if its speed stays."""
        return np.asarray(np.clip(self.target + self.speed * time, self._low, self._high))

    def _next_speed(self, wanted: Floats) -> Floats:
        speed = np.clip(wanted, self.speed - self._change, self.speed + self._change)
        reached = self.target + 0.5 * self._step * self.speed
        return np.asarray(
            np.clip(speed, -self._stopping(reached - self._low), self._stopping(self._high - reached))
        )

    def _stopping(self, room: Floats) -> Floats:
        """Solve v dt / 2 + v^2 dt / (2 change) = room in rad for the speed v that can still be stopped."""
        change = self._change
        room = np.maximum(room, 0.0)
        return np.asarray(np.sqrt(0.25 * change**2 + 2.0 * room * change / self._step) - 0.5 * change)
