"""What each ingredient of the moment filter is worth: each switched off in turn, on the same walks.

    python benchmarks/ablation.py --seeds 10

Walks of 34 s at three speeds at the bad start (gains off by 12 %, zeros by 1.5 N, drift of 2 % and 1 N per
square root of a minute), cells read when the host reads; errors from 14 s on against MuJoCo's truth, beside
the posterior Cramer-Rao bound. About 3 s of recording for each walk.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from surefoot.calibration import FeetLayout, FootLayout
from surefoot.experiments.arena.bound import bound_of
from surefoot.experiments.logs.format import Log
from surefoot.experiments.walks.record import Condition, record_walk
from surefoot.experiments.walks.replay import replay_logs
from surefoot.experiments.walks.score import score_forces
from surefoot.sensors import LoadCells

SPEEDS = (0.02, 0.04, 0.1)
SETTLE = 14.0
INSTANT = Condition("instant", "a bad start", LoadCells(rate=None), "nominal")


def weightless(log: Log) -> Log:
    """Forget the sole plates beyond the cells."""
    feet = (FootLayout.load_cells(foot.name, foot.position_cell_sole) for foot in log.layout.feet)
    return replace(log, layout=FeetLayout(tuple(feet)))


VARIANTS: dict[str, tuple[dict[str, Any], Callable[[Log], Log] | None]] = {
    "as it is": ({}, None),
    "no swing tare": ({"swing_noise": 1e3}, None),
    "centre of mass taken for right": ({"com_std": 0.0, "com_change": 0.0}, None),
    "mass taken for right": ({"mass_std": 0.0, "mass_change": 0.0}, None),
    "delay taken for right": ({"delay_std": 0.0}, None),
    "no drift": ({"scale_drift": 0.0, "offset_drift": 0.0}, None),
    "soles without mass": ({}, weightless),
    "channels read at one moment": ({"timing_noise": 0.0}, None),
    "force noise as small as the sample's": ({"force_noise": 0.006}, None),
    "averages over 8 samples": ({"average": 8}, None),
    "no averages": ({"average": 1}, None),
    "centre of mass known to 6 mm": ({"com_std": 0.006}, None),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=200)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    for speed in SPEEDS:
        logs = [record_walk(speed, seed, 34.0, [INSTANT])[INSTANT.name] for seed in seeds]
        bounds = [bound_of(log, log.time >= SETTLE, {}) for log in logs]
        print(f"\n{speed} m/s, {len(logs)} seeds: rmse of CoP (mm), vGRF (N), single cells (N)", flush=True)
        limit = [np.mean([bound[part] for bound in bounds]) for part in ("cop", "vgrf", "cell")]
        print(f"  {'bound':38s} {1e3 * limit[0]:6.2f} {limit[1]:6.3f} {limit[2]:6.3f}")
        for name, (options, change) in VARIANTS.items():
            told = logs if change is None else [change(log) for log in logs]
            found = np.array(
                [_score(log, done.force) for log, done in zip(logs, _replay(told, options), strict=True)]
            )
            mean = found.mean(axis=0)
            print(f"  {name:38s} {1e3 * mean[0]:6.2f} {mean[1]:6.3f} {mean[2]:6.3f}", flush=True)


def _replay(logs: list[Log], options: dict[str, Any]) -> list[Any]:
    return replay_logs(logs, "moment", **options)


def _score(log: Log, force: Any) -> tuple[float, float, float]:
    assert log.truth is not None
    score = score_forces(
        force,
        log.truth.force,
        layout=log.layout,
        position_sole=log.truth.position_sole,
        R_world_sole=log.truth.R_world_sole,
        time=log.time,
        settle=SETTLE,
    )
    return score.cop, score.vgrf, score.cell


if __name__ == "__main__":
    main()
