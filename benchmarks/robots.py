"""Calibration methods on robots made by others: standing, moving, falling.

    python benchmarks/robots.py --seeds 3 --jobs 2
    python benchmarks/robots.py --quick
    python docs/study_tables.py out/results

Robots stand, exercise, shake and fall on emulated feet: load cells of the robot's size whose scales are off
by 12 %, or six-axis sensors in the ankles. All methods get the same readings and the same state estimates of
the robot. Errors are root mean squares over a run without its first second, including falls: of the centre of
pressure of each foot in its sole's frame, while the foot carries a tenth of the robot's weight, and of the
vertical force of both feet. Where the centre of pressure of an estimate is undefined, the last one is held.
Most robots need ``pip install surefoot[robots]``. Without it, only the robots of Gymnasium are run.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import bench
import gymnasium as gym
import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY
from surefoot.envs import InstrumentedEnv, load_robot_spec
from surefoot.envs.exercise.held import HeldRobot
from surefoot.experiments.study.figures import look_of
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.tables import Cell, Frame, Table, Verdict, decimal, table_of, with_interval
from surefoot.experiments.walks.score import hold_last, rms
from surefoot.wrappers import FootSensors, SelfCalibration

METHODS = ("none", "tare", "window", "moment")
SENSORS: Mapping[str, Any] = {"load cells": None, "ankle sensors": "icub-force-torque"}
BEGIN = 1.0  # s at the start of a run without a score
BEARS = 0.1  # minimum load of a foot, as a share of the weight, for its centre of pressure to count
_STREAM = 0x20B07  # of actions


@dataclass(frozen=True)
class Motion:
    """A robot and its motion: random actions up to an amplitude, in the units of its actions."""

    robot: str  # an id of Gymnasium, or a name in the package of robots
    name: str
    amplitude: float = 0.0

    @property
    def packaged(self) -> bool:
        """Whether it needs the package of robots."""
        return not self.robot.endswith("-v5")

    def env(self) -> gym.Env[Any, Any]:
        """Make the environment, with soles added to point feet."""
        if not self.packaged:
            seen = {"include_cfrc_ext_in_observation": False} if "Humanoid" in self.robot else {}
            env = gym.make(self.robot, **seen)
            return InstrumentedEnv(env, soles=True, spec=_stand_up(env) if "Standup" in self.robot else None)
        if self.name == "exercise":
            return gym.make("surefoot/Exercise-v0", robot=self.robot, duration=None)
        bare = HeldRobot(self.robot)
        return InstrumentedEnv(bare, spec=bare.description)


_ACTIONS = {"standing": 0.0, "small actions": 0.02, "exercise": 0.0, "falling": 0.3}
MOTIONS = (
    *(
        Motion(robot, name, amplitude)
        for robot in ("g1", "h1", "t1", "op3", "apollo", "berkeley")
        for name, amplitude in _ACTIONS.items()
        if name != "exercise" or robot in ("g1", "t1", "op3")
    ),
    Motion("Humanoid-v5", "falling"),
    Motion("Humanoid-v5", "falling, small actions", 0.12),
    Motion("Walker2d-v5", "falling"),
    Motion("Walker2d-v5", "falling, small actions", 0.3),
    Motion("HumanoidStandup-v5", "lying, small actions", 0.12),
)
"""Servos hold the posture of the robots of the package. Three of these robots also exercise."""


def score(motion: Motion, sensors: str, seed: int, duration: float) -> bench.Rows:
    """Run for a duration in s: a row per method with ``cop`` in m, ``vgrf`` in N and ``falls``.

    The robot does the same whatever its feet are calibrated by: each method has a run of its own.
    """
    about = {**asdict(motion), "sensors": sensors, "seed": seed}
    return {"scores": [{**about, "method": m, **_run(motion, sensors, seed, duration, m)} for m in METHODS]}


def _run(motion: Motion, sensors: str, seed: int, duration: float, method: str) -> dict[str, Any]:
    env = FootSensors(motion.env(), SENSORS[sensors])
    calibrated = SelfCalibration(env, method)
    _, info = calibrated.reset(seed=seed)
    setup, rng = calibrated.calibrator.setup, np.random.default_rng([_STREAM, seed])
    cop: list[tuple[Floats, Floats]] = []
    vgrf: list[tuple[Floats, Floats]] = []
    falls, ended = 0, False
    for _ in range(round(duration / setup.dt)):
        # Readings are means over a step, and so is this truth.
        truth, estimate = info["surefoot"]["truth"], calibrated.estimate
        cop.append((np.array(truth["cop_foot"]), np.array(estimate.cop_foot)))
        vgrf.append((np.array(truth["vgrf"]), np.array(estimate.vgrf)))
        if ended:
            _, info = calibrated.reset()
            ended = False
            continue
        action = motion.amplitude * rng.uniform(-1.0, 1.0, env.action_space.shape)
        _, _, fell, truncated, info = calibrated.step(action.astype(np.float32))
        ended = fell or truncated
        falls += bool(fell)
    counted = setup.dt * np.arange(len(cop)) >= BEGIN
    true, own = np.array(vgrf)[counted].swapaxes(0, 1)
    places = hold_last(np.reshape(cop, (len(cop), -1)))[counted].reshape(-1, 2, *true.shape[1:], 2)
    off = np.linalg.norm(places[:, 1] - places[:, 0], axis=-1)[true > BEARS * setup.mass * GRAVITY]
    return {"falls": falls, "cop": rms(off), "vgrf": rms((own - true).sum(axis=-1))}


def _stand_up(env: gym.Env[Any, Any]) -> mujoco.MjSpec:
    """Return the robot of HumanoidStandup-v5, which lies, with an upright keyframe to measure its soles."""
    bare: Any = env.unwrapped
    spec = mujoco.MjSpec.from_file(bare.fullpath)
    pose = bare.model.qpos0.copy()
    pose[2:7] = 1.2, np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0
    spec.add_key(name="standing", qpos=pose)
    return spec


def harm_table(scores: Frame) -> Table:
    """Return in how many cases the errors of each method exceed those of raw readings."""
    runs, rows = scores.set_index(["robot", "name", "sensors", "seed", "method"]), []
    for column, what in (("cop", "CoP"), ("vgrf", "vGRF")):
        errors = runs[column].unstack()
        for method in METHODS[1:]:
            off = (errors[method] - errors["none"]).groupby(level=[0, 1, 2])
            found = [mean_interval(part) for _, part in off]
            worse = sum(one.apart and one.mean > 0.0 for one in found)
            said = f"{worse} of {len(found)} ({sum(one.mean > 0.0 for one in found)} in the mean)"
            name = f"{look_of(method).label}: {what} worse than raw by more than the interval"
            rows.append((name, "≤ 0", said, Verdict.of(worse == 0)))
    note = (
        "Differences from raw readings are taken seed by seed. One counts if its mean is above zero by more "
        "than the half width of its 95 % interval."
    )
    return Table("targets", "Harm", ("what", "target", "measured", "reached"), tuple(rows), note)


def robot_table(scores: Frame, sensors: str) -> Table:
    """Return the table of errors with one kind of sensors."""

    def error(column: str, method: str, factor: float) -> Cell:
        return lambda runs: with_interval(runs[runs["method"] == method][column], factor)

    columns: dict[str, Cell] = {
        "robot": lambda runs: str(runs["robot"].iloc[0]),
        "motion": lambda runs: str(runs["name"].iloc[0]),
        "falls a run": lambda runs: decimal(runs["falls"].mean(), ".0f"),
        **{f"CoP (mm): {look_of(method).label}": error("cop", method, 1e3) for method in METHODS},
        **{f"vGRF (N): {look_of(m).label}": error("vgrf", m, 1.0) for m in ("none", "moment")},
    }
    own = scores[scores["sensors"] == sensors]
    parts = [part for _, part in own.groupby(["robot", "name"], sort=False)]
    return table_of(sensors.replace(" ", "_"), f"Feet with {sensors}", columns, parts)


def runnable(motions: Sequence[Motion]) -> list[Motion]:
    """Return the motions whose robots are installed."""
    try:
        load_robot_spec("g1")
    except ModuleNotFoundError as error:
        print(f"The robots of the package are left out: {error}")
        return [motion for motion in motions if not motion.packaged]
    return list(motions)


def main() -> None:
    """Run the robots, and write the tables."""
    given = bench.options(__doc__, "robots", 5).parse_args()
    seeds, duration = (min(given.seeds, 2), 3.0) if given.quick else (given.seeds, 20.0)
    arguments = [
        (motion, sensors, seed, duration)
        for motion in runnable(MOTIONS)
        for sensors in SENSORS
        for seed in range(seeds)
    ]
    scores = bench.run(given.out, "robots", score, arguments, jobs=given.jobs)["scores"]
    tables = [*(robot_table(scores, sensors) for sensors in SENSORS), harm_table(scores)]
    text = f"{seeds} seeds of each robot, motion and kind of sensors, runs of {duration:g} s."
    bench.publish(given.out, "Calibrators on robots made by others", text, tables)


if __name__ == "__main__":
    bench.start(__file__)
