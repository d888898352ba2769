"""Count the samples that a calibrator can learn from, and warn if it has learnt nothing."""

import warnings

import numpy as np

PATIENCE = 10.0  # time in s after which a calibrator should have learnt something


class Chances:
    """Counters of samples, and one warning if nothing was learnt from them.

    Attributes:
        counts: Shape (6,): the number of coming samples from which nothing will be learnt, then the numbers
            of samples so far, of samples of an upright robot, of those in which a foot also stood with
            certainty, and the length of the present and of the longest uninterrupted series of these. The
            library updates this array as well.
    """

    def __init__(self) -> None:
        self.counts = np.zeros(6, np.int64)
        self._warned = False

    def wait(self, samples: int) -> None:
        """Learn nothing from the next samples."""
        self.counts[0] = samples

    @property
    def samples(self) -> int:
        """Number of samples until now."""
        return int(self.counts[1])

    def next(self) -> bool:
        """Begin the next sample, before :meth:`add`, and return whether nothing is learnt from it."""
        waits = bool(self.counts[0] > 0)
        self.counts[0] -= waits
        return waits

    def add(self, upright: bool, standing: bool) -> None:
        """Count one sample: whether the robot was upright, and whether a foot stood with certainty."""
        waiting, samples, uprights, stood, run, longest = self.counts.tolist()
        run = run + 1 if upright and standing else 0
        self.counts[:] = waiting, samples + 1, uprights + upright, stood + (run > 0), run, max(run, longest)

    def judge(self, learnt: bool, dt: float, needs_swing: bool = False) -> bool:
        """Warn once, after :data:`PATIENCE`, if nothing was learnt. Return whether a warning was issued.

        Samples are ``dt`` s apart. A method that ``needs_swing`` only learns from feet in the air.
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
