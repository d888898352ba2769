"""The demo's work in pieces that processes can do: every function takes plain values and files.

A piece depends on nothing but its arguments, so that the number of processes changes no figure and any single
piece can be repeated.
"""

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import FootCalibrator, Reference, ground_reference, sole_wrenches
from surefoot.experiments.logs.format import Log, read_log, write_log
from surefoot.experiments.walks.record import record_walk
from surefoot.experiments.walks.replay import replay_logs, starting_map
from surefoot.experiments.walks.score import cop_world, score_forces

__all__ = ["Outcome", "record_job", "replay_job", "sensitivity_job", "window_update_ms"]

SLICE = 2.0
"""Length in s of the pieces of a walk whose errors are drawn over time."""

WEIGHTS = {"w_F": "force_weight", "w_P": "cop_weight", "w_S": "smoothness_weight"}
"""The weights of Eq. 14, and the window's options that scale them."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of replaying the logs of one speed and condition.

    Attributes:
        condition: Name of the condition.
        speed: Walking speed in m/s.
        name: The way to read the feet.
        scores: One row a walk and yardstick.
        errors: One row a walk and piece of it.
        time: Times of the first walk in s, shape (N,).
        cop: Its centre of pressure in the world in m, shape (N, 2).
        vgrf: Vertical forces of its feet in N, shape (N, 2).
    """

    condition: str
    speed: float
    name: str
    scores: list[dict[str, Any]] = field(default_factory=list)
    errors: list[dict[str, Any]] = field(default_factory=list)
    time: NDArray[np.float64] | None = None
    cop: NDArray[np.float64] | None = None
    vgrf: NDArray[np.float64] | None = None


def record_job(speed: float, seed: int, duration: float, folder: Path) -> dict[str, Path]:
    """Record one walk under all conditions and save the logs.

    Returns:
        The files by the condition's name.
    """
    logs = record_walk(speed, seed, duration)
    return {
        name: write_log(log, folder / f"{name}_{speed:g}_seed{seed}.parquet") for name, log in logs.items()
    }


def replay_job(paths: list[Path], name: str, settle: float) -> list[Outcome]:
    """Replay walks of one speed through one way to read the feet, and score them.

    Args:
        paths: Logs of the walks, of any conditions.
        name: A method; ``"truth"``; ``"baseline"``, the bench calibration kept; ``"floor"``, the map that
            would undo the cells' errors at every moment; or ``"reference"``, what the motion asks.
        settle: Samples before this time in s do not count.

    Returns:
        One outcome a condition.
    """
    logs = [read_log(path) for path in paths]
    forces = [None] * len(logs) if name == "reference" else _read(logs, name)
    outcomes: dict[str, Outcome] = {}
    for log, force in zip(logs, forces, strict=True):
        condition, truth = str(log.about["condition"]), _truth(log)
        if condition not in outcomes:
            outcomes[condition] = _first(log, name, force)
        outcome, row = outcomes[condition], _row(log, name)
        if force is None:
            outcome.scores.append(row | _reference_score(log, settle))
        elif name != "truth":
            outcome.scores.append(row | _score(log, force, truth.force, settle))
            if name not in ("baseline", "floor"):
                outcome.scores.append(row | _against_baseline(log, force, settle))
            outcome.errors.extend(row | piece for piece in _errors_over_time(log, force))
    return list(outcomes.values())


def sensitivity_job(paths: list[Path], weight: str, factor: float, settle: float) -> list[dict[str, Any]]:
    """Replay walks through the window with one weight scaled.

    Returns:
        Two rows a walk: its errors against the truth and against the baseline.
    """
    logs = [read_log(path) for path in paths]
    rows = []
    scaled: dict[str, Any] = {WEIGHTS[weight]: factor}
    for log, replayed in zip(logs, replay_logs(logs, "window", **scaled), strict=True):
        row = {"weight": weight, "factor": factor, **_row(log, "window")}
        rows.append(row | _score(log, replayed.force, _truth(log).force, settle))
        rows.append(row | _against_baseline(log, replayed.force, settle))
    return rows


def window_update_ms(path: Path, samples: int = 1200) -> float:
    """Time the window on one robot: the median of the samples at which it solves, in ms.

    Args:
        path: A log.
        samples: Samples to time, after as many seconds as a standing start takes.
    """
    log = read_log(path)
    calibrator = FootCalibrator(
        log.layout, "window", mass=log.mass, initial=starting_map(log), dt=log.dt, lag=log.lag
    )
    seconds = []
    for k in range(min(len(log), samples + 400)):
        row = Reference(*(np.asarray(part)[k] for part in log.reference))
        began = time.perf_counter()
        calibrator.update(log.raw[k], row)
        seconds.append(time.perf_counter() - began)
    walked = np.array(seconds[400:])
    # It solves at every fourth sample: one of four phases is the slow one.
    phases = walked[: len(walked) // 4 * 4].reshape(-1, 4)
    return float(1e3 * np.median(phases, axis=0).max())


def _read(logs: list[Log], name: str) -> list[Any]:
    if name == "truth":
        return [_truth(log).force for log in logs]
    if name == "floor":
        return [_truth(log).scale * log.raw + _truth(log).offset for log in logs]
    if name == "baseline":
        return [starting_map(log, "bench").force(log.raw) for log in logs]
    return [replayed.force for replayed in replay_logs(logs, name)]


def _first(log: Log, name: str, force: NDArray[np.float64] | None) -> Outcome:
    """Begin an outcome with its first walk, which figures show."""
    condition, speed, truth = str(log.about["condition"]), float(log.about["speed_m_s"]), _truth(log)
    if force is None:
        return Outcome(condition, speed, name)
    return Outcome(
        condition,
        speed,
        name,
        time=log.time,
        cop=cop_world(force, log.layout, truth.position_sole, truth.R_world_sole),
        vgrf=_vgrf(log, force),
    )


def _vgrf(log: Log, force: NDArray[np.float64]) -> NDArray[np.float64]:
    wrench = sole_wrenches(force, log.layout)
    vertical: NDArray[np.float64] = np.sum(_truth(log).R_world_sole[..., 2, :] * wrench[..., :3], axis=-1)
    return vertical


def _row(log: Log, name: str) -> dict[str, Any]:
    return {
        "condition": str(log.about["condition"]),
        "speed": float(log.about["speed_m_s"]),
        "seed": log.seed,
        "method": name,
        "against": "truth",
    }


def _against_baseline(log: Log, force: NDArray[np.float64], settle: float) -> dict[str, Any]:
    baseline = starting_map(log, "bench").force(log.raw)
    return {"against": "baseline", **_score(log, force, baseline, settle)}


def _truth(log: Log) -> Any:
    if log.truth is None:
        raise ValueError("This log holds no truth to score against: its columns 'truth_...' are missing.")
    return log.truth


def _score(
    log: Log, force: NDArray[np.float64], other: NDArray[np.float64], settle: float
) -> dict[str, float]:
    truth = _truth(log)
    return score_forces(
        force,
        other,
        layout=log.layout,
        position_sole=truth.position_sole,
        R_world_sole=truth.R_world_sole,
        time=log.time,
        settle=settle,
    ).as_dict()


def _errors_over_time(log: Log, force: NDArray[np.float64]) -> list[dict[str, float]]:
    truth = _truth(log)
    poses = (log.layout, truth.position_sole, truth.R_world_sole)
    square = np.sum((cop_world(force, *poses) - cop_world(truth.force, *poses)) ** 2, axis=-1)
    rows = []
    for end in np.arange(SLICE, log.time[-1] + 1e-9, SLICE):
        piece = square[(log.time > end - SLICE) & (log.time <= end)]
        piece = piece[np.isfinite(piece)]
        if len(piece):
            rows.append({"time": float(end), "cop": float(np.sqrt(piece.mean()))})
    return rows


def _reference_score(log: Log, settle: float) -> dict[str, float]:
    """Score what the calibrators are told, placed under the true soles of the moment that it describes."""
    truth = _truth(log)
    asked = ground_reference(log.reference, log.mass)
    moment = log.time - log.lag * log.dt - float(log.about.get("sample_age_s", 0.0))
    true_vgrf = _vgrf(log, truth.force).sum(axis=-1)
    true_cop = cop_world(truth.force, log.layout, truth.position_sole, truth.R_world_sole)
    origin = truth.position_sole[..., :2].mean(axis=1)
    ahead = truth.R_world_sole[..., :2, 0].sum(axis=1)
    series = np.column_stack([true_cop, true_vgrf, origin, ahead])
    then = np.column_stack([np.interp(moment, log.time, column) for column in series.T])
    ahead = then[:, 5:7] / np.linalg.norm(then[:, 5:7], axis=1, keepdims=True)
    x, y = asked.cop[:, 0], asked.cop[:, 1]
    placed = then[:, 3:5] + np.column_stack(
        [ahead[:, 0] * x - ahead[:, 1] * y, ahead[:, 1] * x + ahead[:, 0] * y]
    )
    counted = (log.time >= settle) & np.isfinite(placed).all(axis=1) & np.isfinite(then).all(axis=1)
    off = (placed - then[:, :2])[counted]
    return {
        "cop": float(np.sqrt(np.mean(np.sum(off**2, axis=1)))),
        "vgrf": float(np.sqrt(np.mean((asked.vgrf - then[:, 2])[counted] ** 2))),
        "cell": float("nan"),
    }
