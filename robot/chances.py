"""How much a calibrator was given to learn from, so that one that learns nothing can say why."""

import warnings

import numpy as np

PATIENCE = 10.0  # time in s after which a calibrator should have learnt something


class Chances:
    """Counts samples that a calibrator can learn from, and warns once if it has learnt nothing of them.

    Attributes:
        counts: How many samples nothing will be learnt of; and of those until now all, those of an upright
            robot, those in which a foot surely stood as well, the last of these without a gap, and the most
            without one, shape (6,). The library counts on in it.
    """

    def __init__(self) -> None:
        self.counts = np.zeros(6, np.int64)
        self._warned = False

    def wait(self, samples: int) -> None:
        """Learn nothing of the next samples."""
        self.counts[0] = samples

    @property
    def samples(self) -> int:
        """Number of samples until now."""
        return int(self.counts[1])

    def next(self) -> bool:
        """Go on to the next sample, before :meth:`add`; return whether nothing is learnt of it."""
        waits = bool(self.counts[0] > 0)
        self.counts[0] -= waits
        return waits

    def add(self, upright: bool, standing: bool) -> None:
        """Count one sample: whether it has a reference, and whether a foot surely stood."""
        waiting, samples, before, stood, run, longest = self.counts.tolist()
        run = run + 1 if upright and standing else 0
        self.counts[:] = waiting, samples + 1, before + upright, stood + (run > 0), run, max(run, longest)

    def judge(self, learnt: bool, dt: float, needs_swing: bool = False) -> bool:
        """Warn, once and not before :data:`PATIENCE`, if nothing was learnt; return whether that was done.

        Samples are ``dt`` s apart. A method that ``needs_swing`` learns from feet in the air alone.
        """
        _, samples, upright, standing, _, longest = self.counts.tolist()
        if self._warned or (not learnt and samples * dt < PATIENCE):
            return False
        self._warned = True
        if learnt:
            return False
        upright, standing = (round(100 * part / samples) for part in (upright, standing))
        if needs_swing and standing >= 50:
            warnings.warn(
                f"SelfCalibration has learnt nothing in {samples * dt:.0f} s, and readings stay at the "
                "starting map: 'tare' learns the offsets of a foot while it is in the air, and the robot "
                "only stood. Lift each foot once, or use 'moment', which learns while the robot stands.",
                stacklevel=4,
            )
            return True
        warnings.warn(
            f"SelfCalibration has learnt nothing in {samples * dt:.0f} s, and readings stay at the "
            f"starting map: the robot was sure of its motion (upright, no blows) in {upright} % of the "
            f"samples, and of a foot on the ground as well in {standing} %, {longest * dt:.1f} s at most. "
            "It learns while a robot stands or walks; one that falls within a second, as before training, "
            "gives nothing to learn: train it on true feet first.",
            stacklevel=4,
        )
        return True
