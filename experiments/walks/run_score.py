"""The score of one run of one method on one stream: a row of numbers.

Errors are root mean squares over the judged samples, as in :mod:`surefoot.experiments.walks.score`. Besides,

* ``scale``, ``offset``: error of the parameters, rms over channels and judged samples. ``scale`` is relative;
  ``offset`` is the force in N that is estimated of a channel without load.
* ``converged``: time in s from the beginning of the walk, from which on the CoP error of the last 2 s stays
  within twice its value over the last 10 s of the walk.
* ``spread``: standard deviation in m of that running error after the settling time.
* ``cop_foot``: CoP error of each foot in its own sole's frame, over both feet.
* ``end``: CoP error over the last 10 s; ``worse`` if that of the map that it started from is smaller.
  ``worse_foot``, ``worse_vgrf`` and ``worse_cell`` say the same of the feet's own CoP and of forces.
* ``nees``, ``nees_end``, ``nees_cop``, ``nis``: how errors agree with the uncertainty claimed, each over its
  degrees of freedom, so that 1 is right. NaN for a method that claims none.
* ``alarms``, ``hours``: how often a flag of a fault rose on a channel that had none, and in how much
  walking.
* ``found``, ``isolated``, ``named``, ``after``, ``after_foot``: with a fault, the time in s until any of
  those flags rose; whether the channels flagged up to 1 s later are the faulty ones and no other; whether the
  flag names the fault; and the CoP error from 1 s after the fault on, of both feet together and of each foot.
"""

from functools import reduce
from operator import or_
from typing import Any

import numpy as np
import pandas as pd

from surefoot.arrays import Floats
from surefoot.calibration import Flag, ground_reference
from surefoot.experiments.walks.play import Played, Stream
from surefoot.experiments.walks.replay import age_of, starting_map
from surefoot.experiments.walks.scenarios import TRUE_MAP
from surefoot.experiments.walks.score import (
    Errors,
    are_forces,
    cop_world,
    errors_of,
    rms,
    score_forces,
    vertical_forces,
)

_FLAGS = (Flag.SPIKE, Flag.STUCK, Flag.DEAD, Flag.FLIPPED, Flag.SWAPPED, Flag.LOST, Flag.SATURATED)
FAULT_FLAGS = reduce(or_, _FLAGS)  # flags that accuse a channel

_NAMED = {
    "dead": Flag.DEAD,
    "stuck": Flag.STUCK,
    "saturated": Flag.SATURATED,
    "spiking": Flag.SPIKE,
    "dropped": Flag.MISSING,
    "swapped": Flag.SWAPPED,
    "flipped": Flag.FLIPPED,
}
"""The flag that names each kind of fault."""

RUNNING = 2.0  # length in s of the piece that the running error is taken over
END = 10.0  # length in s of the end of a walk, which says what is reached; a third of a short walk
GRACE = 1.0  # time in s after a fault in which it may be found and isolated, and errors do not count


def score_run(stream: Stream, played: Played) -> dict[str, Any]:
    """Score a method's result on a stream: the numbers that the module describes; NaN for nothing to say."""
    log, judged = stream.log, stream.judged
    errors, before = run_errors(stream, played.force), run_errors(stream, stream.start)
    final = log.time[judged][-1]
    last = judged & (log.time > final - min(END, (final - stream.began) / 3.0))
    end, start = errors.rms(last), before.rms(last)
    running = running_rmse(log.time, errors.cop)
    row: dict[str, Any] = {
        "seed": stream.seed,
        "fell": stream.fell,
        "walked": float(log.time[-1] - stream.began),
        **errors.rms(judged),
        "finite": bool(np.isfinite(played.force).all()),
        "end": end["cop"],
        # A method that leaves the readings alone is not worse by a rounding error.
        **{
            f"worse{name.removeprefix('_cop')}": bool(end[name[1:]] > start[name[1:]] * (1.0 + 1e-6))
            for name in ("_cop", "_cop_foot", "_vgrf", "_cell")
        },
        "converged": _convergence(log.time, running, end["cop"], stream.began),
        "spread": float(np.nanstd(running[judged])) if np.isfinite(running[judged]).any() else np.nan,
    }
    row |= _parameter_errors(stream, played) | _consistency(stream, played)
    return row | _faults(stream, played, errors)


def running_rmse(time: Floats, error: Floats) -> Floats:
    """Return the rmse of the last 2 s at every sample, shape (N,), from times in s and sizes of errors.

    NaN is no error; it is returned before there were 2 s, and where no sample of them counts.
    """
    square = pd.Series(np.where(np.isfinite(error), error, np.nan) ** 2, pd.to_timedelta(time, unit="s"))
    mean = square.rolling(pd.Timedelta(RUNNING, unit="s"), min_periods=1).mean().to_numpy()
    return np.where(time >= time[0] + RUNNING, np.sqrt(np.maximum(mean, 0.0)), np.nan)


def run_errors(stream: Stream, force: Floats) -> Errors:
    """Return errors of forces in N, (N, K), at each sample of a stream."""
    layout, truth = stream.log.layout, stream.truth
    return errors_of(force, truth.force, layout, truth.position_sole, truth.R_world_sole, stream.cop)


def _convergence(time: Floats, running: Floats, end: float, began: float) -> float:
    """Find when the running error came to stay within twice its end."""
    outside = np.flatnonzero(~(running <= 2.0 * end) & np.isfinite(running) & (time >= began))
    if not np.isfinite(end):
        return float("nan")
    if len(outside) == 0:
        return 0.0
    return float(time[outside[-1] + 1] - began) if outside[-1] + 1 < len(time) else float("inf")


def _parameter_errors(stream: Stream, played: Played) -> dict[str, float]:
    if stream.faults:
        return {"scale": float("nan"), "offset": float("nan")}
    judged, start, truth = stream.judged, starting_map(stream.log), stream.truth
    ratio = truth.scale / start.scale
    true_offset = truth.offset - ratio * start.offset
    # A channel without load: F0 = -true_offset / ratio.
    unloaded = played.offset - played.scale * true_offset / ratio
    offset = unloaded[judged][:, are_forces(stream.log.layout)]
    return {"scale": rms((played.scale / ratio - 1.0)[judged]), "offset": rms(offset)}


def _consistency(stream: Stream, played: Played) -> dict[str, float]:
    looks, (nis, rows) = played.looks, played.nis
    counted = looks[looks[:, 0] >= stream.log.time[stream.judged][0]]
    return {
        "nees": _mean(counted[:, 1]),
        "nees_cop": _mean(counted[:, 2]),
        "nees_end": float(looks[-1, 1]) if len(looks) else float("nan"),
        "parameters": float(2 * stream.log.layout.channels),
        "nis": nis / rows if rows else float("nan"),
        "nis_rows": rows,
    }


def _faults(stream: Stream, played: Played, errors: Errors) -> dict[str, float]:
    time = stream.log.time
    accused = (played.flags & int(FAULT_FLAGS)) != 0
    start = min((fault.start for fault in stream.faults), default=float("inf"))
    before = (time >= stream.began) & (time < start)
    rising = accused[1:] & ~accused[:-1]
    names = ("alarms", "hours", "found", "isolated", "named", "after", "after_foot")
    row = dict.fromkeys(names, float("nan"))
    row["alarms"] = float(rising[before[1:]].sum())
    row["hours"] = float(before.sum() * stream.log.dt / 3600.0)
    if not stream.faults:
        return row
    kinds = {_NAMED[fault.kind] for fault in stream.faults}
    accused |= (played.flags & int(reduce(or_, kinds))) != 0
    guilty = {n for fault in stream.faults for n in (fault.channel, fault.other) if n is not None}
    raised = np.flatnonzero(accused.any(axis=1) & (time >= start))
    row["after"], row["after_foot"] = (rms(error[time >= start + GRACE]) for error in errors[:2])
    row["found"] = float(time[raised[0]] - start) if len(raised) else float("inf")
    if len(raised):
        window = (time >= start) & (time <= time[raised[0]] + GRACE)
        row["isolated"] = float(set(np.flatnonzero(accused[window].any(axis=0)).tolist()) == guilty)
        union = int(np.bitwise_or.reduce(played.flags[window], axis=None))
        row["named"] = float(all(union & int(kind) for kind in kinds))
    else:
        row["isolated"] = row["named"] = 0.0
    return row


def _mean(values: Floats) -> float:
    values = values[~np.isnan(values)]
    return float(values.mean()) if len(values) else float("nan")


OTHER_WAYS = ("baseline", "reference")  # no methods: weights before the walk, kept; what the motion asks for


def yardsticks_of(stream: Stream, method: str, force: Floats, settle: float) -> list[dict[str, Any]]:
    """Score forces in N, (N, K), against truth and baseline: rows with the errors of :class:`Score`."""
    log, truth = stream.log, stream.truth
    others = {"truth": truth.force}
    if method not in (TRUE_MAP, "baseline"):
        others["baseline"] = _baseline(stream)
    known: Any = {"layout": log.layout, "time": log.time, "settle": settle}
    known |= {"position_sole": truth.position_sole, "R_world_sole": truth.R_world_sole}
    return [
        _row(stream, method, against) | score_forces(force, other, **known)._asdict()
        for against, other in others.items()
    ]


def other_way(stream: Stream, way: str, settle: float) -> list[dict[str, Any]]:
    """Score a way to read the feet that is no method, one of :data:`OTHER_WAYS`, as :func:`yardsticks_of`."""
    if way == "baseline":
        return yardsticks_of(stream, way, _baseline(stream), settle)
    return [_row(stream, way, "truth") | _reference_score(stream, settle)]


def _baseline(stream: Stream) -> Floats:
    found: Floats = starting_map(stream.log, "calibrated").force(stream.log.raw)
    return found


def _row(stream: Stream, name: str, against: str) -> dict[str, Any]:
    about = stream.log.about
    walk = {"condition": str(about["condition"]), "speed": float(about["speed_m_s"])}
    return {**walk, "seed": stream.seed, "method": name, "against": against}


def _reference_score(stream: Stream, settle: float) -> dict[str, float]:
    """Score the calibrators' references, placed under the true soles of the moment that it describes."""
    log, truth = stream.log, stream.truth
    asked = ground_reference(log.reference, log.mass)
    moment = log.time - log.lag * log.dt - age_of(log)

    def then(values: Floats) -> Floats:
        return np.column_stack([np.interp(moment, log.time, column) for column in values.T])

    true_cop = then(cop_world(truth.force, log.layout, truth.position_sole, truth.R_world_sole))
    feet = vertical_forces(truth.force, log.layout, truth.R_world_sole)
    true_vgrf = then(feet.sum(axis=-1)[:, None])[:, 0]
    origin = then(truth.position_sole[..., :2].mean(axis=1))
    ahead = then(truth.R_world_sole[..., :2, 0].sum(axis=1))
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    x, y = asked.cop[:, 0], asked.cop[:, 1]
    placed = origin + np.column_stack([ahead[:, 0] * x - ahead[:, 1] * y, ahead[:, 1] * x + ahead[:, 0] * y])
    counted = (log.time >= settle) & np.isfinite(placed).all(axis=1) & np.isfinite(true_cop).all(axis=1)
    off = (placed - true_cop)[counted]
    return {
        "cop": float(np.sqrt(np.mean(np.sum(off**2, axis=1)))),
        "vgrf": float(np.sqrt(np.mean((asked.vgrf - true_vgrf)[counted] ** 2))),
        "cop_foot": float("nan"),
        "cell": float("nan"),
    }
