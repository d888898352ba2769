"""The posterior Cramér-Rao bound of a log, in the terms of the arena's scores."""

import numpy as np

from surefoot.calibration import OnlineSetup, Parameters, posterior_bound
from surefoot.experiments.arena_pieces import LogBound
from surefoot.experiments.log_format import Log
from surefoot.experiments.replay import starting_map
from surefoot.experiments.walkers import STAND_TIME

__all__ = ["bound_of"]

_FOOT_LENGTH = 0.17
"""Extent of a NAO's shoe in m, as layouts of ankle sensors do not tell it."""

_SETTLE = 10.0
"""Time in s of walking that scores leave out, and so does the bound."""


def bound_of(log: Log) -> LogBound:
    """Compute what no estimator can go below on a walk with truth, over the samples that are scored.

    The bound of a recording of something else than a walking NAO is NaN.

    Args:
        log: The log.
    """
    unknown = LogBound(float("nan"), float("nan"), float("nan"))
    if log.truth is None or not np.isfinite(log.raw).all():
        return unknown
    if not log.about.get("speed_m_s"):
        return unknown
    setup = OnlineSetup(
        layout=log.layout,
        mass=log.mass,
        initial=starting_map(log),
        dt=log.dt,
        lag=log.lag,
        foot_length=_FOOT_LENGTH,
    )
    bound = posterior_bound(setup, log.raw, log.reference, Parameters(log.truth.scale, log.truth.offset))
    counted = log.time >= STAND_TIME + _SETTLE
    if not counted.any():
        return unknown
    square = bound.cop[counted] ** 2
    return LogBound(
        cop=float(np.sqrt(np.nanmean(square.sum(axis=-1)))),
        vgrf=float(np.sqrt(np.mean(bound.vgrf[counted] ** 2))),
        cell=float(np.sqrt(np.mean(bound.force[counted] ** 2))),
    )
