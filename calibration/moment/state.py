"""The state of the moment filter."""

from typing import NamedTuple

from surefoot.calibration.arrays import Array
from surefoot.calibration.front_end.readings import FrontState
from surefoot.calibration.moment.faults import ChannelState
from surefoot.calibration.moment.motion import Track


class Belief(NamedTuple):
    """The modes' posteriors, and how likely they are; J modes, N unknowns.

    Attributes:
        mean: Shape (J, N).
        covariance: Shape (J, N, N).
        chance: Shape (J,).
    """

    mean: Array
    covariance: Array
    chance: Array


class Publication(NamedTuple):
    """The published posterior of scales, offsets and drift, M unknowns.

    Attributes:
        mean: Shape (M,).
        covariance: Shape (M, M).
        undetermined: Share of each scale's variance that the data have left, shape (K,).
    """

    mean: Array
    covariance: Array
    undetermined: Array


class TareState(NamedTuple):
    """Results of the feet's last tares.

    Attributes:
        reading: Mean reading of each channel in W, shape (K,).
        moved: By how much readings have moved since while the robot stood still, in W, shape (K,).
        time: When it ended in s, -1 before the first, shape (F,).
        rate: By how many times sensors drift faster than stated.
        followed: From how many tares that was learnt.
    """

    reading: Array
    moved: Array
    time: Array
    rate: float
    followed: int


class StillState(NamedTuple):
    """Readings of late, which say whether the robot stands still.

    Attributes:
        reading: Mean of the last block in W, shape (K,).
        level: Mean over some seconds in W, shape (K,).
        time: When the last block ended in s, -1 before the first.
    """

    reading: Array
    level: Array
    time: float


class Kept(NamedTuple):
    """The state of some seconds ago, to go back to.

    Attributes:
        belief: The modes' posteriors, the last time but one.
        published: The posterior that was published then.
        tare: Results of tares until then.
        next_belief: The modes' posteriors the last time.
        next_published: The posterior that was published then.
        next_tare: Results of tares until then.
        age: Time in s since the last time.
    """

    belief: Belief
    published: Publication
    tare: TareState
    next_belief: Belief
    next_published: Publication
    next_tare: TareState
    age: float

    @classmethod
    def begin(cls, belief: Belief, published: Publication, tare: TareState) -> "Kept":
        """Keep one state, and no other."""
        return cls(belief, published, tare, belief, published, tare, 0.0)

    def keep(self, belief: Belief, published: Publication, tare: TareState) -> "Kept":
        """Keep another state, and forget the older one."""
        return Kept(self.next_belief, self.next_published, self.next_tare, belief, published, tare, 0.0)


class SuspectState(NamedTuple):
    """Evidence against the readings; H suspects.

    Attributes:
        score: S, shape (H,).
        before: Momentum measured at the last block's end, shape (C,).
        error: Wrench that the last block left unexplained in W and W m, shape (C,).
        noise: By how many times variances are larger than stated, shape (C,).
        known: The unknowns before the momentum, from before anything spoke against a channel, shape (M,).
        force: F0 of the samples of the last two blocks and more in W, shape (n, K).
    """

    score: Array
    before: Array
    error: Array
    noise: Array
    known: Array
    force: Array


class MomentState(NamedTuple):
    """All that the moment filter remembers.

    Attributes:
        front: State of the front end.
        track: The motion of late.
        faults: Faults of channels so far.
        pending: Samples that wait, shape (n, S), in the order of
            :mod:`~surefoot.calibration.moment.blocks`.
        before: The sample before them, shape (S,).
        waiting: How many wait; -1 before there is one before them.
        linked: Whether the momentum is known at the sample before them.
        point: o in m, of the last block, shape (3,).
        time: Time in s since the start.
        belief: The modes' posteriors.
        drifted: Variance that scales have drifted by since the start.
        tare: Results of tares.
        still: Readings of late.
        suspects: Evidence against the readings.
        shift: By how much zeros have leapt together in N, which is taken off the readings, shape (K,).
        published: The published posterior.
        covariance: Covariance of (a, b) by it, b in N, shape (2K, 2K).
        kept: The state of some seconds ago.
        status: Flags of the last block.
    """

    front: FrontState
    track: Track
    faults: ChannelState
    pending: Array
    before: Array
    waiting: int
    linked: int
    point: Array
    time: float
    belief: Belief
    drifted: float
    tare: TareState
    still: StillState
    suspects: SuspectState
    shift: Array
    published: Publication
    covariance: Array
    kept: Kept
    status: int
