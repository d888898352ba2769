"""The CoP paper's way to score, and the truth's: one row a walk, way to read the feet and yardstick.

The yardstick ``"baseline"`` is the calibration from known weights, applied to the same readings.
"""

from typing import Any

import numpy as np

from surefoot.calibration import ground_reference
from surefoot.experiments.arrays import Floats
from surefoot.experiments.walks.options import TRUE_MAP
from surefoot.experiments.walks.replay import age_of, starting_map
from surefoot.experiments.walks.score import cop_world, score_forces, vertical_forces
from surefoot.experiments.walks.streams import Stream

OTHER_WAYS = ("baseline", "reference")  # no methods: weights before the walk, kept; what the motion asks for
TRACE = (8.0, 2.0)  # kept for figures, in s before the end: the last steps before the robot stops


def yardsticks_of(stream: Stream, method: str, force: Floats, settle: float) -> list[dict[str, Any]]:
    """Score forces in N, (N, K), against truth and baseline: rows with the errors of :class:`Score`."""
    others = {"truth": stream.truth.force}
    if method not in (TRUE_MAP, "baseline"):
        others["baseline"] = _baseline(stream)
    return [
        _row(stream, method, against) | _score(stream, force, other, settle)
        for against, other in others.items()
    ]


def other_way(stream: Stream, way: str, settle: float) -> list[dict[str, Any]]:
    """Score a way to read the feet that is no method, one of :data:`OTHER_WAYS`, as :func:`yardsticks_of`."""
    if way == "baseline":
        return yardsticks_of(stream, way, _baseline(stream), settle)
    return [_row(stream, way, "truth") | _reference_score(stream, settle)]


def trace_of(stream: Stream, method: str, force: Floats) -> list[dict[str, Any]]:
    """Return the end of a walk as a method saw it: rows of time (s), CoP in the world (m), vGRF (N)."""
    log, truth = stream.log, stream.truth
    end = log.time[-1]
    shown = (log.time >= max(end - TRACE[0], 0.0)) & (log.time <= end - TRACE[1])
    ways = {method: force} | ({"truth": truth.force} if method == TRUE_MAP else {})
    return [
        {
            **_walk(stream),
            "method": name,
            "time": log.time[shown],
            "cop": cop_world(one, log.layout, truth.position_sole, truth.R_world_sole)[shown],
            "vgrf": vertical_forces(one, log.layout, truth.R_world_sole)[shown],
        }
        for name, one in ways.items()
    ]


def _baseline(stream: Stream) -> Floats:
    found: Floats = starting_map(stream.log, "calibrated").force(stream.log.raw)
    return found


def _walk(stream: Stream) -> dict[str, Any]:
    about = stream.log.about
    return {"condition": str(about["condition"]), "speed": float(about["speed_m_s"])}


def _row(stream: Stream, name: str, against: str) -> dict[str, Any]:
    return {**_walk(stream), "seed": stream.seed, "method": name, "against": against}


def _score(stream: Stream, force: Floats, other: Floats, settle: float) -> dict[str, float]:
    log, truth = stream.log, stream.truth
    poses = {"position_sole": truth.position_sole, "R_world_sole": truth.R_world_sole}
    score = score_forces(force, other, layout=log.layout, **poses, time=log.time, settle=settle)
    return score._asdict()


def _reference_score(stream: Stream, settle: float) -> dict[str, float]:
    """Score what calibrators are given, placed under the true soles of the moment that it describes."""
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
        "cell": float("nan"),
    }
