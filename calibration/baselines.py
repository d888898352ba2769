"""Baselines for comparison: a swing tare, and no calibration at all.

**Tare.** A foot in the air reads its offset. RoboCup teams tare a NAO's foot sensors as it walks. B-Human's
``SolePressureStateProvider`` takes the lowest reading of each sensor over several changes of the support foot
as its offset. The minimum suits a force-sensing resistor, which cannot read less than zero. A load cell's
noise is symmetric. The offset here is therefore the *mean* over a swing, and it is only used if the foot is
known to be in the air and its readings agree:

    b_i = -a_i mean(F0_i)    so that    mean(F_i) = 0.

Scales do not change. The weight of the sole is part of the offset. The inertia of the sole (about 50 g, which
moves up and down within a swing) averages out.

**None.** The starting map, behind the same checks as every method. Readings are not extrapolated to the
current time.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.checks import check_counts, check_not_negative, check_positive
from surefoot.calibration.estimate import Estimate, Flag
from surefoot.calibration.front_end.readings import FrontEnd, FrontState
from surefoot.calibration.reference import Reference
from surefoot.calibration.setup import OnlineMethod, OnlineSetup


@dataclass(frozen=True, kw_only=True)
class SwingTare:
    """Options of the swing tare."""

    settle: float = 0.05
    """Time that a foot must have been in the air before its readings count, in s."""

    minimum_samples: int = 10
    """Smallest number of readings of one swing from which an offset is taken."""

    spread: float = 0.01
    """Standard deviation within a swing, in body weights, above which a foot counts as touching something."""

    offset_range: float = 0.2
    """Largest change of an offset from the starting map, in body weights, of a channel and of all channels of
    a foot together. A larger change means that the foot was not in the air."""

    def __post_init__(self) -> None:
        """Raise an error if a value is out of range."""
        check_positive(self, "spread", "offset_range")
        check_not_negative(self, "settle")
        check_counts(self, "minimum_samples")


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
        # The foot may have touched the ground during a gap, so that earlier samples belong to another swing.
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
            ready = np.flatnonzero(enough[foot]) + foot.start
            # If one channel carries load, or all of them together do, the foot was on the ground.
            if plausible[ready].all() and abs(mean[ready].sum()) <= limit:
                offset[ready] = -mean[ready]
            else:
                rejected[ready] = int(Flag.REJECTED)

        estimate = front_end.estimate(sample, np.ones_like(offset), offset)
        estimate = estimate._replace(flags=estimate.flags | rejected)
        return TareState(front, airborne, count, mean, scatter, offset), estimate

    limits = front_end.limits | {"offset": (-limit, limit)}
    return OnlineMethod(init, update, limits=limits)


def leave_start(setup: OnlineSetup) -> OnlineMethod:
    """Return the method that never changes the starting map and does not extrapolate readings."""
    front_end = FrontEnd(setup, imu=False, extrapolates=False)

    def update(state: FrontState, raw: Array, reference: Reference, dt: float) -> tuple[FrontState, Estimate]:
        state, sample = front_end.observe(state, raw, reference, dt)
        return state, front_end.estimate(sample, np.ones_like(sample.force), np.zeros_like(sample.force))

    return OnlineMethod(front_end.init, update, limits=front_end.limits)
