"""The worth of a calibration motion: planned against other motions, and played before walks and exercises.

    python benchmarks/calibration_motion.py plan     # bounds of motions of 40 s, NAO
    python benchmarks/calibration_motion.py walk     # the motion, then 12 s of walking (NAO) or of exercise
    python docs/study_tables.py out/results

The start is the bad one of walks: scales 12 % off, offsets 1.5 N for a NAO (3 N per 100 N of weight for
others), drift of 2 % and 1 N (2 N per 100 N) per square root of a minute; the robot's usual errors about
itself. Errors of the centre of pressure count from the first step, or the first exercise, on; the readings'
own error by the data sheet is given beside. NEES is that of all scales and offsets when the motion is over.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from rich.console import Console

from surefoot.arrays import Floats, stack_rows
from surefoot.calibration import GRAVITY, FootMotion, MovingRobot, Parameters, plan_foot_excitation
from surefoot.envs import ExerciseEnv, NaoWalkEnv, Prelude
from surefoot.experiments.motion import Limits, Rehearsal, plan_motion, rehearse
from surefoot.experiments.study.page import save_tables
from surefoot.experiments.study.progress import each
from surefoot.experiments.study.tables import Table, decimal
from surefoot.experiments.walks.score import cop_world, rms
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.robot.beliefs.errors import NO_ERRORS
from surefoot.sensors import LoadCells, sized
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers import CalibrateFirst, FootSensors, SelfCalibration

RANDOM = 20  # random orders of motions that a plan is held against
STAND = 1.0  # how long a NAO stands between its motion and its first step in s
AFTER = 12.0  # how long errors count in s


class Run(NamedTuple):
    """One episode: a fall, errors of the CoP in m, its claimed deviation, NEES, time of the motion in s."""

    fell: bool
    cop: float
    raw: float
    claimed: float
    nees: float
    motion: float


def run(robot: str, seed: int, prelude: Prelude | None, before: float, enough: float) -> Run:
    """Play a motion, or the robot's usual motion for ``before`` s, and score the time after."""
    if robot == "nao":
        stand = STAND if prelude is not None else STAND_TIME
        length = before + stand + AFTER
        options: dict[str, Any] = {"stand_time": stand, "push_impulse": (0.0, 0.0), "prelude": prelude}
        env: Any = NaoWalkEnv(speed=0.04, duration=length + 2 * STAND_TIME, **options)
        cells, begins = LoadCells(rate=None), before + stand
    else:
        env = ExerciseEnv(robot, duration=None, prelude=prelude)
        weight = float(env.model.body_subtreemass[0]) * GRAVITY
        cells = replace(sized(HX711_LOAD_CELLS, weight), initial_offset_std=0.03 * weight, rate=None)
        begins = before
    sensors = FootSensors(env, cells)
    calibration = SelfCalibration(sensors)
    top: Any = calibration if prelude is None else CalibrateFirst(calibration, enough=enough)
    _, info = top.reset(seed=seed)
    nees = np.nan if prelude is None else nees_of(calibration, sensors)
    still = np.zeros(top.action_space.shape, dtype=np.float32)
    rows: list[tuple[Any, ...]] = []
    fell = False
    for tick in range(round((begins + AFTER) / env.dt)):
        _, _, fell, _, _ = top.step(still)
        if fell:
            break
        if tick * env.dt >= begins:
            truth, estimate = env.truth, calibration.estimate
            raw = sensors.instruments.nominal.force(sensors.raw)
            poses = truth.position_sole[-1].copy(), truth.R_world_sole[-1].copy()
            spread = np.trace(np.asarray(estimate.cop_covariance))
            rows.append((np.array(estimate.force), raw, truth.force_cell[-1].copy(), *poses, spread))
    if prelude is None and rows:
        nees = nees_of(calibration, sensors)
    layout, motion = calibration.layout, float(info["surefoot"].get("prelude_time", 0.0))
    if not rows:
        return Run(True, np.nan, np.nan, np.nan, nees, motion)
    force, raw, true, position, R, spread = (np.array(part) for part in zip(*rows, strict=True))
    place = cop_world(true, layout, position, R)
    off = [np.linalg.norm(cop_world(one, layout, position, R) - place, axis=1) for one in (force, raw)]
    cop, uncalibrated = (rms(one) for one in off)
    return Run(fell, cop, uncalibrated, float(np.sqrt(np.nanmean(spread))), nees, motion)


def nees_of(calibration: SelfCalibration, sensors: FootSensors) -> float:
    """Return the squared error of scales and offsets by the claimed covariance, a parameter."""
    estimate, start = calibration.estimate, calibration.calibrator.setup.initial
    found = Parameters(np.asarray(estimate.scale), np.asarray(estimate.offset)).relative_to(start)
    true = Parameters(*sensors.true_parameters()).relative_to(start)
    error = np.concatenate([found.scale - true.scale, found.offset - true.offset])
    return float(error @ np.linalg.solve(np.asarray(estimate.covariance), error) / error.size)


def error_table(robots: Sequence[str], seeds: range, budget: float, enough: float, limits: Limits) -> Table:
    """Return errors after the motion, a row a robot, and of the NAO without it."""
    cases: list[tuple[str, str, Prelude | None, float]] = []
    for robot in robots:
        cases.append((robot.upper(), robot, plan_motion(robot, budget, limits=limits).prelude, 0.0))
        if robot == "nao":
            name = "NAO, 34 s of walking in place of the motion"
            cases.append((name, robot, None, 34.0 - STAND_TIME))
    rows = []
    for name, robot, prelude, before in cases:
        runs = pd.DataFrame([run(robot, seed, prelude, before, enough) for seed in each(name, seeds)])
        raw, cop, claimed = (1e3 * runs[part] for part in ("raw", "cop", "claimed"))
        figures = (cop.mean(), cop.max(), claimed.mean(), runs["nees"].mean())
        cells = (decimal(raw.mean(), ".1f"), *(decimal(one, ".2f") for one in figures))
        rows.append((name, decimal(len(runs), "d"), *cells, decimal(runs["fell"].sum(), "d")))
    columns = ("robot", "seeds", "CoP by the data sheet (mm)", "after the motion (mm)", "worst (mm)",
               "claimed (mm)", "NEES", "falls")  # fmt: skip
    return Table("errors", f"After a motion of {budget:g} s", columns, tuple(rows))


def record_walk(duration: float, **options: Any) -> FootMotion:
    """Walk with perfect sensors."""
    env = NaoWalkEnv(duration=duration + 4.0, push_impulse=(0.0, 0.0), **options)
    sensors = FootSensors(env, "perfect", imu="perfect", encoders="perfect", link="perfect")
    calibration = SelfCalibration(sensors, "none", errors=NO_ERRORS)
    calibration.reset(seed=0)
    force, beliefs = [], []
    for tick in range(round((duration + 1.0) / env.dt)):
        calibration.step(np.zeros(11, dtype=np.float32))
        if tick * env.dt >= 1.0:
            force.append(sensors.instruments.nominal.force(sensors.raw))
            beliefs.append(calibration.reference)
    return FootMotion(np.array(force), stack_rows(beliefs))


def cop_std(covariance: Floats, layout: Any, walk: FootMotion) -> float:
    """Standard deviation of a walk's centre of pressure by a covariance of (a, b), in m."""
    force, reference = walk.force, walk.reference
    cells = np.concatenate(
        [
            reference.position_sole[:, i, None]
            + foot.position_cell_sole @ np.swapaxes(reference.R_level_sole[:, i], 1, 2)
            for i, foot in enumerate(layout.feet)
        ],
        axis=1,
    )[..., :2]
    load = force.sum(axis=1)
    cop = (cells * force[..., None]).sum(axis=1) / load[:, None]
    arm = (cells - cop[:, None]) / load[:, None, None]
    rows = np.concatenate([arm * force[..., None], arm], axis=1)[np.isfinite(cop).all(axis=1)]
    return float(np.sqrt(np.einsum("nkx,kl,nlx->n", rows, covariance, rows).mean()))


def bound_table(budget: float) -> Table:
    """Compare bounds of the NAO's motions after the same time, for the CoP of a walk at 0.04 m/s."""
    stage = Rehearsal("nao")
    able, _ = rehearse(stage)
    layout, judge = stage.layout, record_walk(12.0, speed=0.04)
    length = {name: able.dt * len(motion.force) for name, motion in able.motions.items()}

    def bound(order: list[str] | None = None, robot: MovingRobot = able) -> float:
        plan = plan_foot_excitation(layout, robot, budget, motions=order)
        return cop_std(plan.covariance, layout, judge)

    before = plan_foot_excitation(layout, able, budget).covariance_before
    found = {"nothing": cop_std(before, layout, judge), "the plan": bound()}
    for name in ("lift @ 1.4", "sway forward 1.4 @ 0.5", "sway left 1.4 @ 0.5", "squat @ 1"):
        found[f"{name} alone"] = bound([name] * int(budget / length[name]))
    sways = ["sway forward 1.4 @ 0.5", "sway left 1.4 @ 0.5"]
    mixed = ["lift @ 1.4"] * 2 + sways * int((budget - 10.1) / 10.6)
    found["lifts for a quarter, then slow sways"] = bound(mixed)
    rng = np.random.default_rng(0)
    bounds = sorted(bound(draw_order(length, budget, rng)) for _ in range(RANDOM))
    found |= {f"{RANDOM} random orders, the best": bounds[0]}
    found |= {f"{RANDOM} random orders, the median": bounds[RANDOM // 2]}
    for name, options in {
        "walking at 0.04 m/s": {"speed": 0.04},
        "turning on the spot at 0.2 rad/s": {"speed": 0.0, "turn_rate": 0.2},
    }.items():
        motions = {name: record_walk(budget, **options)}
        found[name] = bound([name], MovingRobot(mass=able.mass, motions=motions, dt=1.0 / 80.0, lag=4))
    rows = tuple((name, decimal(1e3 * one, ".2f")) for name, one in found.items())
    return Table("bounds", f"Motions of {budget:g} s", ("motion", "bound (mm)"), rows)


def draw_order(length: Mapping[str, float], budget: float, rng: np.random.Generator) -> list[str]:
    """Draw motions of some lengths in s until no more fit."""
    order: list[str] = []
    while (taken := sum(length[name] for name in order)) < budget - 3.0:
        fit = [name for name in length if taken + length[name] <= budget]
        order.append(fit[rng.integers(len(fit))])
    return order


def main() -> None:
    """Print the table of a study, and save it for the page."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("study", choices=["plan", "walk"])
    parser.add_argument("--robots", nargs="+", default=["nao", "op3", "g1", "t1"])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--budget", type=float, default=37.0, help="s; a NAO takes 3 s more to and fro")
    parser.add_argument("--enough", type=float, default=0.0, help="m at which the motion stops; 0 plays all")
    parser.add_argument("--torque", type=float, default=Limits.torque, help="largest share of a limit")
    given = parser.parse_args()
    if given.study == "plan":
        table = bound_table(given.budget)
    else:
        seeds = range(given.first, given.first + given.seeds)
        table = error_table(given.robots, seeds, given.budget, given.enough, Limits(torque=given.torque))
    Console(width=160).print(table.to_rich())
    save_tables(Path(f"out/results/calibration-motion-{given.study}/tables"), (table,))


if __name__ == "__main__":
    main()
