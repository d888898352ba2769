"""The methods to compare with: a swing tare, and no calibration at all.

**Tare.** A foot that is surely in the air reads its own offset. RoboCup teams tare a NAO's foot sensors as it
walks: B-Human's ``SolePressureStateProvider`` takes the lowest reading of each sensor over some changes of
the support foot for its offset. The lowest of many readings is right for a force-sensing resistor, which
cannot read less than nothing; a load cell's noise has two sides, so that here it is the *mean* over the
swing, and only where a robot is sure of the swing and the readings agree:

    b_i = -a_i mean(F0_i)    so that    mean(F_i) = 0.

Scales stay as they are. The weight of the sole itself is in the offset; its inertia (some 50 g, up and down
within a swing) averages out.

**None.** The starting map as it is, behind the same checks as every method, and readings as they were read:
they are not carried on to now.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.checks import check_count, check_not_negative, check_positive
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.calibration.front_end.ages import as_read
from surefoot.calibration.front_end.readings import FrontEnd, FrontState
from surefoot.calibration.reference import Reference
from surefoot.calibration.setup import OnlineMethod, OnlineSetup


@dataclass(frozen=True, kw_only=True)
class TareConfig:
    """Options of the swing tare."""

    settle: float = 0.05
    """Time that a foot must have been in the air before its readings count, in s."""

    minimum_samples: int = 10
    """Readings of one swing that an offset is taken from at least."""

    spread: float = 0.01
    """Standard deviation within a swing, in body weights, above which a foot is not thought to hang
    freely."""

    offset_range: float = 0.2
    """Largest offset against the starting map, in body weights, that a channel and that all channels of a
    foot together can have; a greater one means that the foot was not in the air after all."""

    def __post_init__(self) -> None:
        """Raise an error if a value has no meaning."""
        check_positive(self, "spread", "offset_range")
        check_not_negative(self, "settle")
        check_count(self, "minimum_samples")


class TareState(NamedTuple):
    """What the tare remembers; any leading batch dimensions ``...``.

    Attributes:
        front: What the way of a sample remembers.
        airborne: Samples that each channel's foot has been in the air for, shape (..., K).
        count: Readings of this swing that were used, shape (..., K).
        mean: Their mean in N, shape (..., K).
        scatter: Sum of their squared deviations in N^2, shape (..., K).
        offset: b in N, shape (..., K).
    """

    front: FrontState
    airborne: Array
    count: Array
    mean: Array
    scatter: Array
    offset: Array


def tare(setup: OnlineSetup, config: TareConfig | None = None) -> OnlineMethod:
    """Return the swing tare as a pair of pure functions.

    Args:
        setup: The robot.
        config: Options.
    """
    options = config or TareConfig()
    front_end = FrontEnd(setup, imu=False)
    settle = round(options.settle / setup.dt)
    foot = setup.layout.foot_of_channel
    spread, limit = options.spread * setup.weight, options.offset_range * setup.weight
    by_foot = np.eye(len(setup.layout.feet))[:, foot]

    def init(raw: Array) -> TareState:
        front = front_end.init(raw)
        counter = np.zeros(raw.shape, dtype=np.int64)
        zero = np.zeros_like(front.raw)
        return TareState(front, counter, counter, zero, zero, zero)

    def update(state: TareState, raw: Array, reference: Reference, dt: float) -> tuple[TareState, Estimate]:
        front, sample = front_end.observe(state.front, raw, reference, dt)
        in_air = sample.swing @ by_foot > 0.5
        # Across a gap the foot may have stood: what was counted before is not of this swing.
        airborne = np.where(in_air, (state.airborne * 0 if sample.gap else state.airborne) + 1, 0)
        fresh = airborne == 1
        used = (airborne > settle) & sample.read

        # Welford's running mean and scatter of this swing.
        before = np.where(fresh, 0, state.count)
        count = before + used
        number = np.maximum(count, 1)
        deviation = np.where(used, sample.past - state.mean, 0.0)
        deviation = np.where(before == 0, np.where(used, sample.past, 0.0), deviation)
        mean = np.where(before == 0, 0.0, state.mean) + deviation / number
        off = np.where(used, sample.past - mean, 0.0)
        scatter = np.where(before == 0, 0.0, state.scatter) + deviation * off

        enough = used & (count >= options.minimum_samples)
        still = scatter <= number * spread**2
        small = np.abs(mean) <= limit
        # Where one channel carries load, or all together do, the foot did not swing.
        feet_of = by_foot.mT
        doubt = (enough & ~(still & small)) @ feet_of
        carries = np.abs(np.where(enough, mean, 0.0) @ feet_of) > limit
        hangs = (doubt < 0.5) & ~carries
        foot_hangs = hangs @ by_foot > 0.5
        offset = np.where(enough & foot_hangs, -mean, state.offset)
        rejected = np.where(enough & ~foot_hangs, int(Flag.REJECTED), 0)

        estimate = front_end.estimate(sample, np.ones_like(offset), offset)
        estimate = estimate._replace(flags=estimate.flags | rejected)
        return TareState(front, airborne, count, mean, scatter, offset), estimate

    return OnlineMethod(init, update)


def uncorrected(setup: OnlineSetup) -> OnlineMethod:
    """Return the method that leaves the starting map as it is, and readings as they were read.

    Args:
        setup: The robot.
    """
    front_end = FrontEnd(as_read(setup), imu=False)

    def update(state: FrontState, raw: Array, reference: Reference, dt: float) -> tuple[FrontState, Estimate]:
        state, sample = front_end.observe(state, raw, reference, dt)
        return state, front_end.estimate(sample, np.ones_like(sample.force), np.zeros_like(sample.force))

    return OnlineMethod(front_end.init, update)
