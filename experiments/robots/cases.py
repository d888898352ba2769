"""One robot on one kind of feet, for one seed: what each method makes of the same readings.

Errors are root mean squares over a run from the first second on, its falls included: of the centre of
pressure of each foot in its sole's frame, where the foot truly bears a tenth of the robot's weight, and of
the vertical force of both feet. Where an estimate has no centre of pressure the last one is held.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np

from surefoot.calibration import GRAVITY, Estimate, FootCalibrator, Reference
from surefoot.calibration.native import ReferenceRecord
from surefoot.envs import InstrumentedEnv, RobotDrawing
from surefoot.envs.exercise.held import HeldRobot
from surefoot.experiments.arrays import Floats
from surefoot.experiments.walks.score import held, rms
from surefoot.robot.sensing.instruments import layout_options
from surefoot.wrappers import FootSensors, SelfCalibration

METHODS = ("none", "tare", "window", "moment")
SENSORS: Mapping[str, Any] = MappingProxyType({"load cells": None, "ankle sensors": "icub-force-torque"})
BEGIN = 1.0  # s from which on errors count
BEARS = 0.1  # share of the weight from which on a foot's centre of pressure counts
_STREAM = 0x20B07  # of actions


@dataclass(frozen=True)
class Motion:
    """A robot and what it does: random actions of up to an amplitude, in the units of its actions."""

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
            env = gym.make(self.robot)
            return InstrumentedEnv(env, soles=True, spec=_standing(env) if "Standup" in self.robot else None)
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


class _Together:
    """All methods in the place of a wrapper's calibrator, whose references and falls depend on no method."""

    def __init__(self, one: FootCalibrator, drawing: RobotDrawing) -> None:
        self.setup = one.setup
        of_setup = "mass", "initial", "dt", "lag", "age"
        given: dict[str, Any] = {name: getattr(one.setup, name) for name in of_setup}
        layout = one.setup.layout
        self.methods = [
            FootCalibrator(layout, name, **{**given, **layout_options(layout, drawing)}) for name in METHODS
        ]

    def native(self) -> None:
        """Nothing, as no filter of the library's alone makes the estimates."""

    def is_in(self, state: Any) -> bool:
        """No: no state of the library's alone is what it goes on with."""
        return False

    def update(self, raw: Floats, reference: Reference | ReferenceRecord) -> Estimate:
        self.estimates = [method.update(raw, reference) for method in self.methods]
        return self.estimates[0]

    def retract(self) -> None:
        for method in self.methods:
            method.retract()


def run_robot(motion: Motion, sensors: str, seed: int, duration: float) -> dict[str, list[dict[str, Any]]]:
    """Run for a duration in s: ``scores`` has a row a method: ``cop`` in m, ``vgrf`` in N, ``falls``."""
    env = FootSensors(motion.env(), SENSORS[sensors])
    calibrated: Any = SelfCalibration(env, "none")
    calibrated.reset(seed=seed)
    together = calibrated.robot.calibrator = _Together(calibrated.calibrator, env.source.drawing)
    together.update(env.raw, calibrated.reference)
    setup = together.setup
    rng = np.random.default_rng([_STREAM, seed])
    cop: list[list[Floats]] = []
    vgrf: list[list[Floats]] = []
    falls, ended = 0, False
    for _ in range(round(duration / setup.dt)):
        truth = env.source.truth
        cop.append([truth.cop_sole[-1], *(one.cop_foot for one in together.estimates)])
        vgrf.append([truth.vgrf(), *(one.vgrf for one in together.estimates)])
        if ended:
            calibrated.reset()
            ended = False
            continue
        action = motion.amplitude * rng.uniform(-1.0, 1.0, env.action_space.shape)
        _, _, fell, truncated, _ = calibrated.step(action.astype(np.float32))
        ended = fell or truncated
        falls += bool(fell)
    time = setup.dt * np.arange(len(cop))
    loads, places = np.array(vgrf)[time >= BEGIN], held(np.reshape(cop, (len(cop), -1)))[time >= BEGIN]
    places = places.reshape((*loads.shape, 2))
    borne = loads[:, 0] > BEARS * setup.mass * GRAVITY
    off = np.linalg.norm(places[:, 1:] - places[:, :1], axis=-1)
    total = (loads[:, 1:] - loads[:, :1]).sum(axis=-1)
    about = {**asdict(motion), "sensors": sensors, "seed": seed, "falls": falls}
    errors = zip(METHODS, off.swapaxes(0, 1), total.T, strict=True)
    return {"scores": [{**about, "method": m, "cop": rms(o[borne]), "vgrf": rms(t)} for m, o, t in errors]}


def _standing(env: gym.Env[Any, Any]) -> mujoco.MjSpec:
    """Return the robot of HumanoidStandup-v5, which lies, with a keyframe in which its soles are measured."""
    bare: Any = env.unwrapped
    spec = mujoco.MjSpec.from_file(bare.fullpath)
    pose = bare.model.qpos0.copy()
    pose[2:7] = 1.2, np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0
    spec.add_key(name="standing", qpos=pose)
    return spec
