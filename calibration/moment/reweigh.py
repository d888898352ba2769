"""Carry what the moment filter has learnt over to a robot of another mass, such as one with another battery.

The map of the channels does not depend on the mass, and neither do their faults. Forces in the state are in
body weights, so that offsets, drift and tares are scaled. The errors of the centre of mass, the mass and the
clock, the momentum and the outside wrench are those of the robot as it was: they begin again.
"""

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.moment.columns import Columns
from surefoot.calibration.moment.state import Belief, MomentState


def reweigh(state: MomentState, fresh: MomentState, share: float, columns: Columns) -> MomentState:
    """Return a state whose publication still has to be made of its belief.

    Args:
        state: What was learnt.
        fresh: The state of the robot as it is now, before any sample.
        share: The former weight as a share of the present one.
        columns: The unknowns.
    """
    size = np.ones(columns.talk.stop)
    size[columns.offset] = size[columns.drift] = share
    return fresh._replace(
        belief=_scale(state.belief, fresh.belief, size),
        faults=state.faults,
        shift=state.shift,
        time=state.time,
        drifted=state.drifted,
        tare=state.tare._replace(
            reading=share * state.tare.reading,
            moved=share * state.tare.moved,
            offered=share * state.tare.offered,
        ),
    )


def _scale(belief: Belief, fresh: Belief, size: Array) -> Belief:
    """Return a belief whose first unknowns are those learnt, scaled; the others are fresh."""
    known = slice(0, len(size))
    mean, covariance = fresh.mean.copy(), fresh.covariance.copy()
    mean[:, known] = belief.mean[:, known] * size
    covariance[:, known, known] = belief.covariance[:, known, known] * np.outer(size, size)
    return fresh._replace(mean=mean, covariance=covariance)
