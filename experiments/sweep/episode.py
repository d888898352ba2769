"""One cell of a sweep: one seeded episode, complete in itself, and what came of it."""

import json
import platform
import time
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from typing import Any

import gymnasium as gym
import numpy as np

import surefoot
from surefoot.controllers import zero_action
from surefoot.envs.nao.env import CONTROL_STEP
from surefoot.experiments.policy.controllers import Controller, controller_hash, load_controller
from surefoot.experiments.study.sources import source_hash
from surefoot.experiments.walks.closed_loop import Moment, rms
from surefoot.experiments.walks.walkers import TruthTap
from surefoot.sensors import LoadCells, scaled
from surefoot.sensors.presets import resolve
from surefoot.wrappers.foot_sensors import FootSensors
from surefoot.wrappers.self_calibration import SelfCalibration

__all__ = [
    "OUTCOME",
    "VERSIONS",
    "Cell",
    "Step",
    "cell_steps",
    "check_cell",
    "failed_row",
    "run_cell",
    "versions",
]

OUTCOME = ("return", "steps", "time", "fell", "cop_error", "cop_tracking", "digest")
"""What a repetition must bring out again to the last digit."""

VERSIONS = ("surefoot", "python", "numpy", "mujoco", "gymnasium", "code")
"""With what a row was made."""

_LONGEST_ERROR = 4000
"""Characters of a failed cell's traceback that are kept, its end."""


@dataclass(frozen=True)
class Cell:
    """Everything that makes an episode.

    Attributes:
        number: Its place in the sweep.
        controller: Name of the controller (:mod:`surefoot.experiments.policy.controllers`).
        controller_hash: Of the file behind it, or nothing.
        feed: One of :data:`surefoot.experiments.sweep.scenarios.SWEEP_FEEDS`.
        scenario: Name of the scenario.
        environment: Id of its environment.
        options: Options of the environment.
        cells: Name of the load cells' preset.
        sensors: Further options of :class:`~surefoot.wrappers.FootSensors`.
        calibration: Options of :class:`~surefoot.wrappers.SelfCalibration`, ``method`` among them.
        severity: Factor of all errors of the load cells (:func:`surefoot.sensors.scaled`).
        seed: Of the episode and of its sensors.
        duration: Longest duration in s.
        settle: The controller is asked from this time in s on; before, the action is zero.
    """

    number: int
    controller: str
    controller_hash: str
    feed: str
    scenario: str
    environment: str
    options: Mapping[str, Any]
    cells: str
    sensors: Mapping[str, Any]
    calibration: Mapping[str, Any]
    severity: float
    seed: int
    duration: float
    settle: float

    def to_json(self) -> str:
        """Write it as one line of JSON."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> "Cell":
        """Read what :meth:`to_json` wrote."""
        return cls(**json.loads(text))


@dataclass(frozen=True)
class Step:
    """An episode after one control step.

    Attributes:
        moment: What the robot felt and what was true.
        action: What the controller answered to the observation before.
        reward: What was paid for it.
    """

    moment: Moment
    action: Any
    reward: float


def cell_steps(cell: Cell, *, render_mode: str | None = None, **drawing: Any) -> Iterator[Step]:
    """Run an episode, a control step at a time, until its end or the fall.

    Args:
        cell: Which one.
        render_mode: As in :class:`~surefoot.envs.NaoEnv`.
        **drawing: Further options of the environment that change nothing but pictures.

    Yields:
        What happened.

    Raises:
        ValueError: If the controller's file is another one than the cell names, or something in the cell is
            refused.
    """
    shown = {} if render_mode is None else {"render_mode": render_mode, **drawing}
    env, tap, controller = _made(cell, shown)
    bare: Any = env.unwrapped
    try:
        observation, _ = env.reset(seed=cell.seed)
        waiting, steps, done = round(cell.settle / CONTROL_STEP), 0, False
        while not done:
            action = np.asarray((zero_action if steps < waiting else controller)(observation))
            observation, reward, terminated, truncated, _ = env.step(action)
            steps += 1
            done = terminated or truncated
            yield Step(
                Moment(steps * CONTROL_STEP, bare, observation, tap.seen, terminated), action, float(reward)
            )
    finally:
        env.close()


def check_cell(cell: Cell) -> None:
    """Make everything that a cell needs, and run nothing.

    Raises:
        ValueError: If any of it is refused, naming scenario and controller.
    """
    try:
        env, _, _ = _made(cell, {})
    except Exception as error:
        raise ValueError(
            f"Scenario '{cell.scenario}' with controller '{cell.controller}' cannot be run: {error}"
        ) from error
    env.close()


def run_cell(cell: Cell) -> dict[str, Any]:
    """Run an episode and say how it went; whatever goes wrong in it is part of the answer.

    Returns:
        A row of the results: what the cell is, ``return`` (the sum of rewards), ``steps``, ``time`` on its
        feet in s, ``fell`` (otherwise the time is censored), ``cop_error`` (rms distance between the centre
        of pressure fed back and the true one, in m) and ``cop_tracking`` (between the true one and its plan,
        in m), both from ``settle`` on, ``digest`` (a hash of all actions, rewards and centres of pressure),
        ``wall_time`` in s, ``error`` (empty, or what was raised) and versions.
    """
    began = time.perf_counter()
    try:
        outcome = _outcome(cell)
    except Exception:
        return failed_row(cell, traceback.format_exc(), time.perf_counter() - began)
    return _row(cell, outcome, "", time.perf_counter() - began)


def failed_row(cell: Cell, error: str, wall_time: float = float("nan")) -> dict[str, Any]:
    """Make the row of a cell that could not be run through."""
    nothing: dict[str, Any] = dict.fromkeys(OUTCOME, float("nan"))
    nothing |= {"steps": 0, "fell": False, "digest": ""}
    return _row(cell, nothing, error.strip()[-_LONGEST_ERROR:], wall_time)


@cache
def versions() -> dict[str, str]:
    """Say with what this process computes; ``code`` is a hash of surefoot's own sources."""
    packages = {name: version(name) for name in ("numpy", "mujoco", "gymnasium")}
    code = source_hash(__name__)
    found = {"surefoot": surefoot.__version__, "python": platform.python_version(), **packages, "code": code}
    return {name: found[name] for name in VERSIONS}


def _made(cell: Cell, shown: Mapping[str, Any]) -> tuple[gym.Env[Any, Any], TruthTap, Controller]:
    """Make an environment on its feet, the tap that sees its truth, and the controller."""
    if controller_hash(cell.controller) != cell.controller_hash:
        raise ValueError(
            f"The file behind the controller '{cell.controller}' is another one than the sweep began with."
        )
    limit = round(cell.duration / CONTROL_STEP)
    options = {**cell.options, **shown}
    tap = TruthTap(gym.make(cell.environment, max_episode_steps=limit, disable_env_checker=True, **options))
    env: gym.Env[Any, Any] = tap
    if cell.feed != "true":
        cells = scaled(resolve(cell.cells, LoadCells), cell.severity)
        env = SelfCalibration(FootSensors(tap, cells, **cell.sensors), **cell.calibration)
    return env, tap, load_controller(cell.controller, env)


def _outcome(cell: Cell) -> dict[str, Any]:
    total, steps, fell, now = 0.0, 0, False, 0.0
    errors, tracking = [], []
    digest = sha256()
    for step in cell_steps(cell):
        moment = step.moment
        total += step.reward
        steps, now, fell = steps + 1, moment.time, moment.fell
        if now > cell.settle:
            errors.append(moment.cop_error)
            tracking.append(moment.tracking)
        digest.update(step.action.astype(np.float32).tobytes() + np.float64(step.reward).tobytes())
        digest.update(moment.observation["cop"].tobytes() + moment.true_observation["cop"].tobytes())
    return {
        "return": total,
        "steps": steps,
        "time": now,
        "fell": bool(fell),
        "cop_error": rms(errors),
        "cop_tracking": rms(tracking),
        "digest": digest.hexdigest()[:32],
    }


def _row(cell: Cell, outcome: Mapping[str, Any], error: str, wall_time: float) -> dict[str, Any]:
    return {
        "cell": cell.number,
        "controller": cell.controller,
        "feed": cell.feed,
        "scenario": cell.scenario,
        "severity": cell.severity,
        "seed": cell.seed,
        **outcome,
        "error": error,
        "wall_time": wall_time,
        **versions(),
        "spec": cell.to_json(),
    }
