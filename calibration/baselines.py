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
class SwingTare:
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
    """The state of the tare."""

    front: FrontState  # the state of the front end
    airborne: Array  # samples that each channel's foot has been in the air for, shape (K,)
    count: Array  # readings of this swing that were used, shape (K,)
    mean: Array  # their mean in N, shape (K,)
    scatter: Array  # sum of their squared deviations in N^2, shape (K,)
    offset: Array  # b in N, shape (K,)


def tare(setup: OnlineSetup, config: SwingTare | None = None) -> OnlineMethod:
    """Return the swing tare as pure functions."""
    options = config or SwingTare()
    channels, foot_of, feet = setup.layout.channels, setup.layout.foot_of_channel, setup.layout.slices
    front_end = FrontEnd(setup, imu=False)
    settle = round(options.settle / setup.dt)
    spread, limit = options.spread * setup.weight, options.offset_range * setup.weight

    def init(raw: Array) -> TareState:
        counter, zero = np.zeros(channels, dtype=np.int64), np.zeros(channels)
        return TareState(front_end.init(raw), counter, counter, zero, zero, zero)

    def update(state: TareState, raw: Array, reference: Reference, dt: float) -> tuple[TareState, Estimate]:
        front, sample = front_end.observe(state.front, raw, reference, dt)
        # Across a gap the foot may have stood: what was counted before is not of this swing.
        airborne = np.where(sample.swing[foot_of], (1 - sample.gap) * state.airborne + 1, 0)
        used = (airborne > settle) & sample.read

        # Welford's running mean and scatter of this swing.
        before = np.where(airborne == 1, 0, state.count)
        mean, scatter = (np.where(before == 0, 0.0, part) for part in (state.mean, state.scatter))
        count = before + used
        number = np.maximum(count, 1)
        deviation = np.where(used, sample.past - mean, 0.0)
        mean = mean + deviation / number
        scatter = scatter + deviation * np.where(used, sample.past - mean, 0.0)

        enough = used & (count >= options.minimum_samples)
        plausible = (scatter <= number * spread**2) & (np.abs(mean) <= limit)
        offset, rejected = state.offset.copy(), np.zeros(channels, dtype=np.int64)
        for foot in feet:
            seen = np.flatnonzero(enough[foot]) + foot.start
            # Where one channel carries load, or all together do, the foot did not swing.
            if plausible[seen].all() and abs(mean[seen].sum()) <= limit:
                offset[seen] = -mean[seen]
            else:
                rejected[seen] = int(Flag.REJECTED)

        estimate = front_end.estimate(sample, np.ones_like(offset), offset)
        estimate = estimate._replace(flags=estimate.flags | rejected)
        return TareState(front, airborne, count, mean, scatter, offset), estimate

    limits = front_end.limits | {"offset": (-limit, limit)}
    return OnlineMethod(init, update, limits=limits)


def leave_start(setup: OnlineSetup) -> OnlineMethod:
    """Return the method that leaves the starting map as it is, and readings as they were read."""
    front_end = FrontEnd(as_read(setup), imu=False)

    def update(state: FrontState, raw: Array, reference: Reference, dt: float) -> tuple[FrontState, Estimate]:
        state, sample = front_end.observe(state, raw, reference, dt)
        return state, front_end.estimate(sample, np.ones_like(sample.force), np.zeros_like(sample.force))

    return OnlineMethod(front_end.init, update, limits=front_end.limits)
