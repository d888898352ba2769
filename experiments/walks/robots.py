"""Robots that others made: the worth of calibration on each, standing, moving and falling.

Errors are root mean squares over a run from the first second on, its falls included: of the centre of
pressure of each foot in its sole's frame, where the foot truly bears a tenth of the robot's weight, and of
the vertical force of both feet. Where an estimate has no centre of pressure the last one is held.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY
from surefoot.envs import InstrumentedEnv, load_robot_spec
from surefoot.envs.exercise.held import HeldRobot
from surefoot.experiments.study.figures import look_of
from surefoot.experiments.study.page import (
    Report,
    Section,
    Words,
    failure_section,
    publish,
    repeat_section,
    save_frames,
)
from surefoot.experiments.study.runner import runner
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.study.store import Case, Store
from surefoot.experiments.study.tables import (
    Cell,
    Claim,
    Frame,
    Table,
    at_most,
    claim_table,
    decimal,
    plural,
    table_of,
    with_interval,
)
from surefoot.experiments.walks.score import hold_last, rms
from surefoot.wrappers import FootSensors, SelfCalibration

METHODS = ("none", "tare", "window", "moment")
SENSORS: Mapping[str, Any] = MappingProxyType({"load cells": None, "ankle sensors": "icub-force-torque"})
BEGIN = 1.0  # s from which on errors count
BEARS = 0.1  # share of the weight from which on a foot's centre of pressure counts
_STREAM = 0x20B07  # of actions


@dataclass(frozen=True)
class Motion:
    """A robot and its motion: random actions of up to an amplitude, in the units of its actions."""

    robot: str  # of Gymnasium, or of the package of robots
    name: str
    amplitude: float = 0.0

    @property
    def packaged(self) -> bool:
        """Whether it needs the package of robots."""
        return not self.robot.endswith("-v5")

    def env(self) -> gym.Env[Any, Any]:
        """Make it, with soles under feet without area."""
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
"""Robots that are not ours; servos hold those of the package, of which three can exercise."""


def run_robot(motion: Motion, sensors: str, seed: int, duration: float) -> dict[str, list[dict[str, Any]]]:
    """Run for a duration in s: ``scores`` has a row a method: ``cop`` in m, ``vgrf`` in N, ``falls``.

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
    """Return the robot of HumanoidStandup-v5, which lies, with a keyframe in which its soles are measured."""
    bare: Any = env.unwrapped
    spec = mujoco.MjSpec.from_file(bare.fullpath)
    pose = bare.model.qpos0.copy()
    pose[2:7] = 1.2, np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0
    spec.add_key(name="standing", qpos=pose)
    return spec


_say = Words("walks", "robots")
_KEYS = ["robot", "name"]


def compare_robots(
    out: Path, seeds: int = 5, jobs: int = 2, duration: float = 20.0, motions: Sequence[Motion] = MOTIONS
) -> Report:
    """Run so many seeds of each motion and kind of sensors for a duration in s, and write the page.

    Without the package of robots it has the others, and says so.
    """
    without = ""
    try:
        load_robot_spec("g1")
    except ModuleNotFoundError as error:
        motions, without = [motion for motion in motions if not motion.packaged], str(error)
    cases = [
        Case(f"{m.robot}, {m.name}, {on}, seed {seed}", run_robot, (m, on, seed, duration))
        for m, on, seed in product(motions, SENSORS, range(seeds))
    ]
    seconds: dict[str, float] = {}
    store = Store(out / "results")
    with store.open_for(), runner(jobs, seconds) as run:
        run.run("robots", cases, store)
    scores, failures = store.rows("scores", cases), store.failures(cases)
    tables: tuple[Table, ...] = ()
    if len(scores):
        claims = claim_table(claims_of(scores), note=_say("claim"))
        tables = (*(robot_table(scores, sensors) for sensors in SENSORS), claims)
    left_out = (f"Robots of the package are left out: {without}",) if without else ()
    amount = f"{plural(seeds, 'seed')} of each, runs of {duration:g} s."
    command = f"surefoot compare robots --seeds {seeds} --out {out}"
    sections = (
        Section("robots", "Robots, motions and sensors", findings=left_out, tables=tables),
        *failure_section(failures),
        repeat_section(_say("repeat"), (command,), seconds),
    )
    save_frames(out / "tables", {"scores": scores}, (".csv",))
    title = "Calibrators on robots that others made"
    return publish(out, title, (_say("introduction"), amount, *left_out), sections)


def claims_of(scores: Frame) -> list[Claim]:
    """Return for each method the claim that its errors exceed those of raw readings nowhere."""
    runs, claims = scores.set_index([*_KEYS, "sensors", "seed", "method"]), []
    for column, what in (("cop", "CoP"), ("vgrf", "vGRF")):
        errors = runs[column].unstack()
        for method in METHODS[1:]:
            off = (errors[method] - errors["none"]).groupby(level=[0, 1, 2])
            found = [mean_interval(part) for _, part in off]
            worse = sum(one.apart and one.mean > 0.0 for one in found)
            said = f"{worse} of {len(found)} ({sum(one.mean > 0.0 for one in found)} in the mean)"
            name = f"{look_of(method).label}: {what} worse than raw by more than the interval"
            claims.append(at_most(name, worse, 0.0, said))
    return claims


def robot_table(scores: Frame, sensors: str) -> Table:
    """Return the table of one kind of sensors, named after it, a row a robot and motion."""

    def error(column: str, method: str, factor: float) -> Cell:
        return lambda runs: with_interval(runs[runs["method"] == method][column], factor)

    columns: dict[str, Cell] = {
        "robot": lambda runs: str(runs["robot"].iloc[0]),
        "motion": lambda runs: str(runs["name"].iloc[0]),
        "falls a run": lambda runs: decimal(runs["falls"].mean(), ".0f"),
        **{f"CoP (mm): {look_of(method).label}": error("cop", method, 1e3) for method in METHODS},
        **{f"vGRF (N): {look_of(m).label}": error("vgrf", m, 1.0) for m in ("none", "moment")},
    }
    parts = [part for _, part in scores[scores["sensors"] == sensors].groupby(_KEYS, sort=False)]
    return table_of(sensors.replace(" ", "_"), f"Feet with {sensors}", columns, parts)
