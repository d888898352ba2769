"""The state of the moment filter."""

from typing import NamedTuple

from surefoot.calibration.arrays import Array
from surefoot.calibration.front_end.readings import FrontState
from surefoot.calibration.moment.faults import ChannelState


class BlockColumns(NamedTuple):
    """The places of the parts of a sample that waits until its block is full."""

    force: slice
    motion: slice
    read: slice
    swing: slice
    stand: slice
    sound: slice


class MomentState(NamedTuple):
    """What the moment filter remembers; F feet.

    Attributes:
        front: What the way of a sample remembers.
        step: Samples seen.
        pending: The samples of the block under way behind the last ``2 settle`` of the one before, and room
            for those to come: F0, the flat reference, which channels were read, which feet surely swing,
            whether any surely stands, whether the reference is sound, shape (every + 2 settle, P); see
            :class:`BlockColumns`.
        mean: The unknowns, shape (N,).
        covariance: Their covariance, shape (N, N).
        drift: Variances that scales and offsets have drifted by since the start, shape (P + K,).
        given: The unknowns as they are handed out, by a prior that is learnt as well, shape (N,).
        given_covariance: Covariance of their scales and offsets, shape (P + K, P + K).
        learnt: Covariance of (a, b) of each channel, shape (2K, 2K).
        spread: Of that what single forces need, shape (3, K).
        kept_mean: The unknowns of two moments of the last seconds, to go back to, shape (2, N).
        kept_covariance: Their covariances, of which the lower halves are kept, shape (2, N (N + 1) / 2).
        noise: By how many times rows' variances are taken as larger than assumed, shape (kinds,).
        misfit: Mean square of residuals before learning over what is expected of them.
        rate: By how many times variances of sensors grow faster than stated.
        swing_zero: Mean reading of each channel in its last swing, in units of offsets, shape (K,).
        swing_ago: Blocks since that swing, -1 before the first, shape (F,).
        swing_sum: Readings of the swing under way, added up, shape (K,).
        swing_samples: Their number, shape (F,).
        unproven: Blocks in use that must pass before what is learnt is handed out.
        due: What is to be handed out of the last block: 0 nothing, 1 its uncertainty alone, 2 all.
        quiet: Blocks in which the readings have not changed.
        anchor: The readings from which on they have not, shape (K,).
        status: Flags of the last update.
        faults: What is known of faults.
    """

    front: FrontState
    step: int
    pending: Array
    mean: Array
    covariance: Array
    drift: Array
    given: Array
    given_covariance: Array
    learnt: Array
    spread: Array
    kept_mean: Array
    kept_covariance: Array
    noise: Array
    misfit: float
    rate: float
    swing_zero: Array
    swing_ago: Array
    swing_sum: Array
    swing_samples: Array
    unproven: float
    due: float
    quiet: float
    anchor: Array
    status: int
    faults: ChannelState
