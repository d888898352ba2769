"""The gait cycle of each foot, from heel contact to heel contact: means and standard deviations over cycles.

Cycles begin and end by the true contacts, so that all ways to read the feet are averaged over the same ones.
The duty factor and the cycle's time are those of a method's own forces: a foot whose zero is off by more than
the threshold of contact never swings.
"""

from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY
from surefoot.calibration.cop import FORCE_THRESHOLD, cop_of_wrench, sole_wrenches
from surefoot.experiments.walks.play import Stream
from surefoot.experiments.walks.score import rms, vertical_forces

_CYCLE = np.linspace(0.0, 1.0, 101)  # places in a cycle that are compared
_SHORTEST = 0.1  # s of contact or swing that is one: a knock at landing is none
_FEWEST = 0.5  # share of the cycles in which a foot must have a CoP at a place, to have a spread there


def find_contacts(vgrf: Floats, time: Floats) -> Floats:
    """Return when a foot is set down in s, of its vertical force in N at times in s, (N,)."""
    samples = 2 * round(0.5 * _SHORTEST / float(np.median(np.diff(time)))) + 1
    loaded = median_filter((vgrf > FORCE_THRESHOLD).astype(np.int8), samples, mode="nearest")
    found: Floats = time[1:][np.diff(loaded) > 0]
    return found


def cycle_rows(stream: Stream, force: Floats) -> list[dict[str, Any]]:
    """Return a row a foot of what forces in N, (N, K), say of its cycles; none of a foot with less than two.

    ``cycles`` is their number; ``peak`` the largest vertical force in body weights, ``duty`` the share of the
    cycle with contact and ``period`` the cycle's time in s, means and (``_std``) standard deviations over
    cycles; ``repeat`` the standard deviation of the CoP in m, rms over the stance.
    """
    log, truth, walks = stream.log, stream.truth, stream.judged
    load, true_load = (vertical_forces(f, log.layout, truth.R_world_sole) for f in (force, truth.force))
    cop, rows = cop_of_wrench(sole_wrenches(force, log.layout)), []
    for i, foot in enumerate(log.layout.feet):
        starts = find_contacts(true_load[walks, i], log.time[walks])
        if len(starts) < 3:
            continue
        at = starts[:-1, None] + _CYCLE * np.diff(starts)[:, None]
        own, true, *place = (
            np.interp(at, log.time, one) for one in (load[:, i], true_load[:, i], *cop[:, i].T)
        )
        seen = np.ma.masked_invalid(np.where(true > FORCE_THRESHOLD, place, np.nan))
        spread = seen.std(axis=1, ddof=1).filled(np.nan)
        spread[seen.count(axis=1) < _FEWEST * len(at)] = np.nan
        period = np.diff(find_contacts(load[walks, i], log.time[walks]))
        each = {
            "peak": own.max(axis=1) / (log.mass * GRAVITY),
            "duty": (own[:, :-1] > FORCE_THRESHOLD).mean(axis=1),
            "period": period if len(period) > 1 else np.full(2, np.nan),
        }
        rows.append(
            {
                "foot": foot.name,
                "cycles": len(at),
                **{name: float(values.mean()) for name, values in each.items()},
                **{f"{name}_std": float(values.std(ddof=1)) for name, values in each.items()},
                # Of both axes together.
                "repeat": rms(np.linalg.norm(spread, axis=0)),
            }
        )
    return rows
