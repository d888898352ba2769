"""Plan the motion by which a robot calibrates its feet, of those that it can do, and play it once as a whole.

Each motion is played in simulation with perfect sensors. It is refused if the robot falls, if a motor of the
legs comes too near its limit of torque, or if the centre of pressure of a foot that bears weight comes too
near the edge of its sole. Joint limits are kept by the inverse kinematics.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from surefoot.arrays import stack_rows
from surefoot.calibration import FeetLayout, Parameters
from surefoot.calibration.excitation.plan import FootExcitation, FootMotion, MovingRobot, plan_foot_excitation
from surefoot.envs.exercise.env import ExerciseEnv
from surefoot.envs.exercise.moves import list_motions
from surefoot.envs.instrumentation.truth import FeetTruth
from surefoot.envs.prelude import Player, Prelude
from surefoot.experiments.study.progress import each, working
from surefoot.experiments.study.tables import Table, decimal
from surefoot.robot.beliefs.errors import NO_ERRORS
from surefoot.wrappers.foot_sensors import FootSensors
from surefoot.wrappers.self_calibration import SelfCalibration

SETTLING = 0.3  # time in s after a reset in which the robot sinks into the ground, and nothing is checked
ROUNDING = 1e-6  # by what a torque at its limit may exceed it in the simulator's arithmetic, relative
BEARS = 0.1  # share of the weight that a foot bears if the place of its centre of pressure is to count


@dataclass(frozen=True)
class Limits:
    """The limits of a motion."""

    torque: float = 0.95  # largest torque of a leg's motor, as a share of its limit
    margin: float = 0.12
    """Least distance of a foot's CoP from its edge, as a share of half its length or width, for 0.1 s."""


@dataclass(frozen=True)
class Played:
    """How a motion went."""

    motion: FootMotion  # what its channels read and what the robot believed
    fell: bool
    torque: float  # largest of a leg's motor, as a share of its limit
    margin: float  # as in :class:`Limits`

    def refusal(self, limits: Limits) -> str:
        """Return why a motion must not be done; nothing if it may."""
        if self.fell:
            return "it falls"
        if self.torque > limits.torque + ROUNDING:
            return f"a motor needs {self.torque:.0%} of its torque"
        if self.margin < limits.margin:
            near = max(self.margin, 0.0)
            return f"a centre of pressure comes as close to an edge as {near:.0%} of half a sole"
        return ""


class Rehearsal:
    """A robot in simulation, as in :class:`~surefoot.envs.ExerciseEnv`, that plays motions."""

    def __init__(self, robot: str | Path | Any) -> None:
        self.env = ExerciseEnv(robot, duration=None, joint_noise=0.0, velocity_noise=0.0)
        sensors = FootSensors(self.env, "perfect", imu="perfect", encoders="perfect", link="perfect")
        self._sensed = sensors
        self._calibrated = SelfCalibration(sensors, "none", errors=NO_ERRORS)
        self.layout: FeetLayout = self._calibrated.layout
        model, robot = self.env.model, self.env.motion.robot
        joints = np.unique(np.concatenate(robot.legs))
        self._dofs = model.jnt_dofadr[joints]
        self._most_of_joints = _limits(model.jnt_actfrclimited[joints], model.jnt_actfrcrange[joints])
        motors = self._motors = robot.leg_motors
        self._most_of_motors = _limits(model.actuator_forcelimited[motors], model.actuator_forcerange[motors])

    def play(self, prelude: Prelude) -> Played:
        """Play motions from standing."""
        env, calibrated = self.env, self._calibrated
        env.prelude = Player(prelude, prelude.motors, env.dt)
        calibrated.reset(seed=0)
        still = np.zeros(self._motors.size, dtype=np.float32)
        nominal: Parameters = self._sensed.instruments.nominal
        force, beliefs, margins = [], [], []
        torque, fell = 0.0, False
        while env.prelude.playing and not fell:
            _, _, fell, _, _ = calibrated.step(still)
            force.append(nominal.force(self._sensed.raw))
            beliefs.append(calibrated.reference)
            if len(force) * env.dt > SETTLING:
                torque = max(torque, self._torque())
                margins.append(self._margin(env.truth))
        margin = np.array(margins)
        # A tenth of a second on the edge, as a foot lands, tips nobody.
        lasting = max(round(0.1 / env.dt), 1)
        held = np.lib.stride_tricks.sliding_window_view(margin, min(lasting, len(margin))).max(axis=1)
        return Played(FootMotion(np.array(force), stack_rows(beliefs)), bool(fell), torque, float(held.min()))

    def _torque(self) -> float:
        motors = np.abs(self.env.data.actuator_force[self._motors]) / self._most_of_motors
        joints = np.abs(self.env.data.qfrc_actuator[self._dofs]) / self._most_of_joints
        return float(max(motors.max(), joints.max()))

    def _margin(self, truth: FeetTruth) -> float:
        load, cop = truth.vgrf(), truth.cop_sole[-1]
        loaded = load > BEARS * load.sum()
        sole = self.env.motion.robot
        off = np.abs(cop - sole.centre) / sole.half
        # A light robot's foot may bear its share and still have no centre of pressure.
        judged = loaded & np.isfinite(cop).all(axis=1)
        return float(1.0 - np.max(off[judged], initial=0.0)) if loaded.any() else 0.0


def _limits(limited: Any, ranges: Any) -> Any:
    """Return the largest allowed size of each effort, infinite where there is no limit."""
    return np.where(limited.astype(bool), np.abs(ranges).max(axis=1), np.inf)


def rehearse(
    rehearsal: Rehearsal, names: Sequence[str] | None = None, limits: Limits | None = None
) -> tuple[MovingRobot, dict[str, str]]:
    """Return a robot with its possible motions, by default the farthest of each kind, and why not others."""
    limits = Limits() if limits is None else limits
    motions: dict[str, FootMotion] = {}
    refused: dict[str, str] = {}
    offered = list_motions() if names is None else [[name] for name in names]
    for alternatives in each("rehearsing motions", offered):
        for name in alternatives:
            try:
                played = rehearsal.play(rehearsal.env.motion.prelude([name], rehearsal.env.dt))
            except ValueError as error:
                refused[name] = str(error)
                continue
            reason = played.refusal(limits)
            if not reason:
                motions[name] = played.motion
                break
            refused[name] = reason
    calibrator = rehearsal._calibrated.calibrator
    setup = calibrator.setup
    return MovingRobot(mass=setup.mass, motions=motions, dt=setup.dt, lag=setup.lag), refused


class PlannedMotion(NamedTuple):
    """A motion, and its gain: tables of its parts, of single motions, and of those refused."""

    plan: FootExcitation
    prelude: Prelude
    tables: list[Table]


def plan_motion(
    robot: str | Path,
    budget: float = 40.0,
    *,
    goal: str = "cop",
    enough: float = 0.0,
    limits: Limits | None = None,
    **options: Any,
) -> PlannedMotion:
    """Plan a motion of at most a budget in s, which ends early at a standard deviation that is enough.

    Robots are those of :class:`~surefoot.envs.ExerciseEnv`, goals those of
    :func:`~surefoot.calibration.plan_foot_excitation`, options the moment filter's. Raises ValueError if
    something is refused, nothing fits, or motions that went well alone do not together.
    """
    limits = Limits() if limits is None else limits
    stage = Rehearsal(robot)
    able, refused = rehearse(stage, limits=limits)
    if not able.motions:
        raise ValueError(f"The robot can do none of the motions within {limits}: {refused}.")
    with working("choosing motions") as then:
        plan = plan_foot_excitation(stage.layout, able, budget, goal=goal, enough=enough, **options)
        then("playing them together")
        prelude = stage.env.motion.prelude(plan.motions, stage.env.dt)
        played = stage.play(prelude)
    if reason := played.refusal(limits):
        raise ValueError(
            f"Played together, the motions do not keep to the limits: {reason}. Ask for more margin."
        )
    best = sorted(plan.rates.items(), key=lambda item: -item[1])
    rates = tuple((name, decimal(rate, ".3f")) for name, rate in best)
    reasons = tuple(refused.items()) or (("none", ""),)
    tables = [
        _segments(plan, prelude),
        Table("rates", "What each motion would bring first", ("motion", "nats per second"), rates),
        Table("refused", "What the robot must not do", ("motion", "because"), reasons),
    ]
    return PlannedMotion(plan, prelude, tables)


def _segments(plan: FootExcitation, prelude: Prelude) -> Table:
    factor, unit = (1e3, "mm") if plan.goal == "cop" else (1.0, "N")
    start = np.concatenate([[0.0], plan.time[:-1]])
    before = np.concatenate([[plan.before], plan.std[:-1]])
    rows = []
    for name, a, b, s, e in zip(plan.motions, start, plan.time, before, plan.std, strict=True):
        rate = decimal(np.log(s / e) / (b - a), ".3f")
        bounds = (decimal(factor * one, ".2f") for one in (s, e))
        rows.append((name, decimal(a, ".1f"), decimal(b, ".1f"), *bounds, rate))
    what = "centre of pressure" if plan.goal == "cop" else "worst channel"
    columns = ("motion", "from (s)", "to (s)", f"before ({unit})", f"after ({unit})", "nats per second")
    title = f"{prelude.duration:.1f} s of motion: bound of the {what}'s standard deviation"
    return Table("plan", title, columns, tuple(rows))
