"""How much a calibrator was given to learn from, so that one that learns nothing can say why."""

import warnings

PATIENCE = 10.0
"""Time in s after which a calibrator should have learnt something."""


class Chances:
    """Counts samples that a calibrator can learn from, and warns once if it has learnt nothing of them."""

    def __init__(self) -> None:
        self._samples = self._upright = self._standing = self._run = self._longest = 0
        self._warned = False

    def add(self, upright: bool, standing: bool) -> None:
        """Count one sample.

        Args:
            upright: Whether it has a reference.
            standing: Whether a foot surely stood.
        """
        self._samples += 1
        self._upright += upright
        if not (upright and standing):
            self._run = 0
            return
        self._standing += 1
        self._run += 1
        if self._run > self._longest:
            self._longest = self._run

    def judge(self, learnt: bool, dt: float) -> bool:
        """Warn, once and not before :data:`PATIENCE`, if nothing was learnt; return whether that was done.

        Args:
            learnt: Whether anything was.
            dt: Time between samples in s.
        """
        if self._warned or (not learnt and self._samples * dt < PATIENCE):
            return False
        self._warned = True
        if learnt:
            return False
        upright, standing = (round(100 * part / self._samples) for part in (self._upright, self._standing))
        warnings.warn(
            f"SelfCalibration has learnt nothing in {self._samples * dt:.0f} s, and readings stay at the "
            f"starting map: the robot was upright in {upright} % of the samples and had a foot surely on the "
            f"ground in {standing} %, for {self._longest * dt:.1f} s at most. It learns while a robot "
            "stands or walks.",
            stacklevel=4,
        )
        return True
