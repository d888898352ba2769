"""The posterior Cramér-Rao bound of a log, in the terms of the arena's scores."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import OnlineSetup, Parameters, posterior_bound
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.experiments.logs.format import Log
from surefoot.experiments.walks.replay import starting_map


def bound_of(log: Log, judged: NDArray[np.bool_], options: Mapping[str, Any]) -> dict[str, float]:
    """Return bounds on errors of CoP (m), vGRF and cells (N) over judged samples; NaN for no NAO's walk."""
    walks = log.truth is not None and bool(log.about.get("speed_m_s"))
    if not walks or not judged.any() or not np.isfinite(log.raw).all():
        return dict.fromkeys(("cop", "vgrf", "cell"), float("nan"))
    assert log.truth is not None
    model = {field.name for field in fields(MomentFilterConfig)}
    setup = OnlineSetup(
        layout=log.layout,
        mass=log.mass,
        initial=starting_map(log),
        dt=log.dt,
        lag=log.lag,
        **{name: value for name, value in options.items() if name not in model},
    )
    config = MomentFilterConfig(**{name: value for name, value in options.items() if name in model})
    truth = Parameters(log.truth.scale, log.truth.offset)
    bound = posterior_bound(setup, log.raw, log.reference, truth, config)
    return {
        "cop": float(np.sqrt(np.nanmean((bound.cop[judged] ** 2).sum(axis=-1)))),
        "vgrf": float(np.sqrt(np.mean(bound.vgrf[judged] ** 2))),
        "cell": float(np.sqrt(np.mean(bound.force[judged] ** 2))),
    }
