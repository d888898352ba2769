"""The state of the moment filter."""

from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.comparison import SURE
from surefoot.calibration.front_end.readings import FrontState
from surefoot.calibration.moment.faults import ChannelState
from surefoot.calibration.moment.motion import Track


class Belief(NamedTuple):
    """The modes' posteriors, and how likely they are; J modes, N unknowns."""

    mean: Array  # shape (J, N)
    covariance: Array  # shape (J, N, N)
    chance: Array  # shape (J,)
    com_shift: Array = np.zeros(2)
    """Error in m of the centre of mass that tilted soles have made possible, shape (2,)."""


class Publication(NamedTuple):
    """The published posterior of scales, offsets and drift, M unknowns."""

    mean: Array  # shape (M,)
    covariance: Array  # shape (M, M)
    undetermined: Array  # share of each scale's variance that the data have left, shape (K,)


class TareState(NamedTuple):
    """Results of the feet's last tares."""

    reading: Array  # mean reading of each channel in W, shape (K,)
    moved: Array  # by how much readings have moved since while the robot stood still, in W, shape (K,)
    time: Array  # when it ended in s, -1 before the first, shape (F,)
    sure: Array  # probability that the foot was unloaded then, shape (F,)
    offered: Array  # mean reading in W of each channel in the last block taken for a load, shape (K,)
    offer: Array  # probability that it was the zero, shape (F,)
    rough: Array  # roughness of the readings of an unloaded foot, 1 as stated, shape (F,)
    rate: float  # by how many times sensors drift faster than stated
    followed: int  # from how many tares that was learnt


class StillState(NamedTuple):
    """Readings of late, which say whether the robot stands still."""

    reading: Array  # mean of the last block in W, shape (K,)
    level: Array  # mean over some seconds in W, shape (K,)
    time: float  # when the last block ended in s, -1 before the first


class TiltState(NamedTuple):
    """Mean tilt of the loaded soles against the believed vertical."""

    shift: Array  # the tilt times the height of the centre of mass in m, in axes that head as feet do, (2,)
    time: float  # time in s that it is a mean of, the first one as of level soles, at most the memory


class Kept(NamedTuple):
    """The state of some seconds ago, to go back to."""

    belief: Belief  # the modes' posteriors, the last time but one
    published: Publication  # the posterior that was published then
    tare: TareState  # results of tares until then
    next_belief: Belief  # the modes' posteriors the last time
    next_published: Publication  # the posterior that was published then
    next_tare: TareState  # results of tares until then
    age: float  # time in s since the last time

    @classmethod
    def begin(cls, belief: Belief, published: Publication, tare: TareState) -> "Kept":
        """Keep one state, and no other."""
        return cls(belief, published, tare, belief, published, tare, 0.0)

    def keep(self, belief: Belief, published: Publication, tare: TareState) -> "Kept":
        """Keep another state, and forget the older one."""
        return Kept(self.next_belief, self.next_published, self.next_tare, belief, published, tare, 0.0)


class SuspectState(NamedTuple):
    """Evidence against the readings; H suspects."""

    score: Array  # S, shape (H,)
    before: Array  # momentum measured at the last block's end, shape (C,)
    error: Array  # wrench that the last block left unexplained in W and W m, shape (C,)
    noise: Array  # by how many times variances are larger than stated, shape (C,)
    known: Array  # the unknowns before the momentum, from before anything spoke against a channel, shape (M,)
    force: Array  # F0 of the samples of the last two blocks and more in W, shape (n, K)


class VersusStartState(NamedTuple):
    """Residuals of both maps; C components."""

    time: float  # of the blocks so far in s, at most the memory of the comparison
    learnt_mean: Array  # mean residual of the learnt map, shape (C,)
    learnt_square: Array  # mean square of it, shape (C,)
    start_mean: Array  # mean residual of the starting map, shape (C,)
    start_square: Array  # mean square of it, shape (C,)
    precision: Array  # mean inverse variance of the noise of a block, shape (C,)
    evidence: float  # for the starting map, as a logarithm

    @classmethod
    def begin(cls, components: int) -> "VersusStartState":
        """Return the state before any block."""
        zero = np.zeros(components)
        return cls(0.0, zero, zero, zero, zero, zero, 0.0)

    @property
    def is_worse(self) -> bool:
        """Whether the learnt map is surely worse than the start."""
        return self.evidence > SURE


class MomentState(NamedTuple):
    """All that the moment filter remembers."""

    front: FrontState  # state of the front end
    track: Track  # the motion of late
    faults: ChannelState  # faults of channels so far
    pending: Array
    """Samples that wait, shape (n, S), in the order of :mod:`~surefoot.calibration.moment.blocks`."""
    before: Array  # the sample before them, shape (S,)
    waiting: int  # how many wait; -1 before there is one before them
    linked: int  # whether the momentum is known at the sample before them
    point: Array  # o in m, of the last block, shape (3,)
    time: float  # time in s since the start
    belief: Belief  # the modes' posteriors
    drifted: float  # variance that scales have drifted by since the start
    tare: TareState  # results of tares
    still: StillState  # readings of late
    suspects: SuspectState  # evidence against the readings
    versus_start: VersusStartState  # residuals of the learnt and of the starting map
    tilt: TiltState  # tilt of the soles
    shift: Array  # by how much zeros have leapt together in N, which is taken off the readings, shape (K,)
    published: Publication  # the published posterior
    covariance: Array  # covariance of (a, b) by it, b in N, shape (2K, 2K)
    kept: Kept  # the state of some seconds ago
    status: int  # flags of the last block
