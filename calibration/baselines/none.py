"""No calibration at all: the starting map, behind the same checks as every method."""

from typing import Any

from surefoot.calibration._constants import namespace_of
from surefoot.calibration._setup import OnlineMethod, OnlineSetup
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.front_end.readings import FrontEnd, FrontState
from surefoot.calibration.reference import Reference

Array = Any
"""An array of NumPy, torch or any library of the array API standard."""


def uncorrected(setup: OnlineSetup) -> OnlineMethod:
    """Build the method that leaves the starting map as it is.

    Args:
        setup: What the method must be told about the robot.
    """
    front_end = FrontEnd(setup)

    def update(state: FrontState, raw: Array, reference: Reference, dt: float) -> tuple[FrontState, Estimate]:
        state, sample = front_end.observe(state, raw, reference, dt)
        xp = namespace_of(raw)
        return state, front_end.estimate(sample, xp.ones_like(sample.force), xp.zeros_like(sample.force))

    return OnlineMethod(front_end.init, update)
