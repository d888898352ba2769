"""The worth of a calibration motion: planned against other motions, and played before walks and exercises.

    python benchmarks/calibration_motion.py plan                  # bounds of motions of 40 s, NAO
    python benchmarks/calibration_motion.py walk --seeds 20       # NAO: the motion, then 12 s of walking
    python benchmarks/calibration_motion.py robots --seeds 5      # the motion, then 12 s of exercise

The start is the bad one of walks: scales 12 % off, offsets 1.5 N for a NAO (3 N per 100 N of weight for
others), drift of 2 % and 1 N (2 N per 100 N) per square root of a minute; the robot's usual errors about
itself. Errors of the centre of pressure count from the first step, or the first exercise, on; the readings'
own error by the data sheet is given beside. NEES is that of all scales and offsets when the motion is over.
"""

import argparse
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY, FootMotion, MovingRobot, Parameters, plan_foot_excitation
from surefoot.envs import ExerciseEnv, NaoWalkEnv, Prelude
from surefoot.experiments.arrays import stack_rows
from surefoot.experiments.motion import Limits, Rehearsal, plan_motion, rehearse
from surefoot.experiments.walks.score import cop_world, rms
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.robot.beliefs.errors import NO_ERRORS
from surefoot.sensors import LoadCells, sized
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers import CalibrateFirst, FootSensors, SelfCalibration

Floats = NDArray[np.float64]

RANDOM = 20
"""Random orders of motions that a plan is held against."""

STAND = 1.0
"""How long a NAO stands between its motion and its first step in s."""

AFTER = 12.0
"""How long errors count in s."""


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
    return Run(fell, *(rms(one) for one in off), float(np.sqrt(np.nanmean(spread))), nees, motion)


def nees_of(calibration: SelfCalibration, sensors: FootSensors) -> float:
    """Return the squared error of scales and offsets by the claimed covariance, a parameter."""
    estimate, start = calibration.estimate, calibration.calibrator.setup.initial
    found = Parameters(np.asarray(estimate.scale), np.asarray(estimate.offset)).relative_to(start)
    true = Parameters(*sensors.true_parameters()).relative_to(start)
    error = np.concatenate([found.scale - true.scale, found.offset - true.offset])
    return float(error @ np.linalg.solve(np.asarray(estimate.covariance), error) / error.size)


def study_runs(robot: str, seeds: range, budget: float, enough: float, limits: Limits) -> None:
    """Print a line a seed, with the motion and, for the NAO, without."""
    planned = plan_motion(robot, budget, limits=limits)
    print(planned.tables[0].title, "-", ", ".join(planned.plan.motions), flush=True)
    cases: list[tuple[str, Prelude | None, float]] = [("motion", planned.prelude, 0.0)]
    if robot == "nao":
        cases.append(("34 s of walking", None, 34.0 - STAND_TIME))
    for name, prelude, before in cases:
        runs = []
        for seed in seeds:
            one = run(robot, seed, prelude, before, enough)
            runs.append(one)
            cop, claimed, raw = (1e3 * value for value in (one.cop, one.claimed, one.raw))
            print(
                f"{robot:4s} {name:16s} seed {seed:4d}  CoP {cop:5.2f} mm (claimed {claimed:4.2f}, raw "
                f"{raw:5.2f})  NEES {one.nees:5.2f}  motion {one.motion:4.1f} s{'  FELL' * one.fell}",
                flush=True,
            )
        cop = 1e3 * np.array([one.cop for one in runs])
        print(
            f"{robot:4s} {name:16s} CoP mean {np.nanmean(cop):.2f}, median {np.nanmedian(cop):.2f}, worst "
            f"{np.nanmax(cop):.2f} mm; NEES mean {np.nanmean([one.nees for one in runs]):.2f}; "
            f"{sum(one.fell for one in runs)} falls of {len(runs)}\n",
            flush=True,
        )


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


def study_plan(budget: float) -> None:
    """Compare bounds of the NAO's motions after the same time, for the CoP of a walk at 0.04 m/s."""
    stage = Rehearsal("nao")
    able, _ = rehearse(stage)
    layout, judge = stage.layout, record_walk(12.0, speed=0.04)
    names = list(able.motions)

    def tell(name: str, covariance: Floats, time: float) -> None:
        print(f"{name:44s} {time:5.1f} s   {1e3 * cop_std(covariance, layout, judge):6.2f} mm", flush=True)

    def of(name: str, order: list[str]) -> None:
        plan = plan_foot_excitation(layout, able, budget, motions=order)
        tell(name, plan.covariance, float(plan.time[-1]))

    plan = plan_foot_excitation(layout, able, budget)
    tell("nothing", plan.covariance_before, 0.0)
    tell("the plan", plan.covariance, float(plan.time[-1]))
    length = {name: able.dt * len(motion.force) for name, motion in able.motions.items()}
    for name in ("step @ 1.4", "sway forward 1.4 @ 0.5", "sway left 1.4 @ 0.5", "squat @ 1"):
        of(f"{name} alone", [name] * int(budget / length[name]))
    sways = ["sway forward 1.4 @ 0.5", "sway left 1.4 @ 0.5"]
    of("steps for a quarter, then slow sways", ["step @ 1.4"] * 2 + sways * int((budget - 10.1) / 10.6))
    rng = np.random.default_rng(0)
    found = []
    for _ in range(RANDOM):
        order: list[str] = []
        while sum(length[name] for name in order) < budget - 3.0:
            fit = [name for name in names if sum(length[one] for one in [*order, name]) <= budget]
            order.append(fit[rng.integers(len(fit))])
        found.append(plan_foot_excitation(layout, able, budget, motions=order).covariance)
    found.sort(key=lambda covariance: cop_std(covariance, layout, judge))
    tell(f"{RANDOM} random orders, the best", found[0], budget)
    tell(f"{RANDOM} random orders, the median", found[RANDOM // 2], budget)
    for name, options in {
        "walking at 0.04 m/s": {"speed": 0.04},
        "turning on the spot at 0.2 rad/s": {"speed": 0.0, "turn_rate": 0.2},
    }.items():
        motion = record_walk(budget, **options)
        other = MovingRobot(mass=able.mass, motions={name: motion}, dt=1.0 / 80.0, lag=4)
        plan = plan_foot_excitation(layout, other, budget, motions=[name])
        tell(name, plan.covariance, budget)


def main() -> None:
    """Run the chosen parts."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("study", choices=["plan", "walk", "robots"])
    parser.add_argument("--robots", nargs="+", default=["g1", "t1", "op3"])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--budget", type=float, default=37.0, help="s; a NAO takes 3 s more to and fro")
    parser.add_argument("--enough", type=float, default=0.0, help="m at which the motion stops; 0 plays all")
    parser.add_argument("--torque", type=float, default=Limits.torque, help="largest share of a limit")
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.seeds)
    if given.study == "plan":
        study_plan(given.budget)
    for robot in {"plan": [], "walk": ["nao"], "robots": given.robots}[given.study]:
        study_runs(robot, seeds, given.budget, given.enough, Limits(torque=given.torque))


if __name__ == "__main__":
    main()
