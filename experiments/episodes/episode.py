"""One seeded episode, complete in itself, and one row about how it went."""

import json
import platform
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

import surefoot
from surefoot.arrays import Floats
from surefoot.experiments.policy.controllers import Controller, check_fits, controller_hash, load_controller
from surefoot.experiments.study.sources import source_hash
from surefoot.experiments.walks.score import rms
from surefoot.experiments.walks.walkers import TruthTap, put_on_feet
from surefoot.files import parse_json

OUTCOME = ("return", "steps", "time", "fell", "cop_error", "tracking", "digest")
"""What a repetition must bring out again to the last digit."""

VERSIONS = ("surefoot", "python", "numpy", "mujoco", "gymnasium", "code")  # with what a row was made

TABLE = "episodes"  # name of the table of a study's store that holds the rows

_WHAT = ("controller", "controller_hash", "trained", "feed", "scenario", "severity", "seed")
"""What of an episode has a column of its own."""

_DIGEST_DIGITS = 32


@dataclass(frozen=True)
class Episode:
    """Everything that makes an episode."""

    number: int  # its place in the study
    controller: str
    controller_hash: str  # of the file behind it, or nothing
    trained: str  # on what, or nothing
    feed: str
    scenario: str
    environment: str  # id
    options: Mapping[str, Any]  # of the environment
    cells: str  # name of a preset
    sensors: Mapping[str, Any] | None  # of FootSensors; ``None`` for no sensors at all
    calibration: Mapping[str, Any] | None  # of SelfCalibration; ``None`` for the true CoP
    severity: float  # factor of all errors of the cells; 0 on true feet
    seed: int
    duration: float | None  # longest, in s; ``None`` for the environment's own
    settle: float | None  # the controller is asked from this time in s on; ``None`` as above
    of_task: bool  # scores count after the quiet stand, and another task's policy is refused

    def to_json(self) -> str:
        """Return it as one line of JSON."""
        return json.dumps(asdict(self), sort_keys=True, default=dict)

    @classmethod
    def from_json(cls, text: str) -> "Episode":
        """Return the episode that :meth:`to_json` wrote; ValueError if an earlier version did."""
        try:
            return cls(**parse_json(text, "This episode"))
        except TypeError as error:
            raise ValueError(f"This episode was written by another version of surefoot ({error}).") from error


class EpisodeStep(NamedTuple):
    """An episode after one control step."""

    time: float  # since the reset in s
    bare: Any  # the environment beneath all wrappers
    observation: dict[str, Any]
    true_observation: dict[str, Any]  # without sensors in between
    fell: bool  # the episode ends then
    action: Any  # answered to the observation before
    reward: float
    asked: bool  # the controller was, and not the quiet stand's zero action

    @property
    def cop_error(self) -> float:
        """Distance between the fed and the true centre of pressure in m; NaN where there is none."""
        if not self.true_observation["cop_valid"][0]:
            return float("nan")
        fed, true = self.observation["cop"].astype(np.float64), self.true_observation["cop"]
        return float(np.linalg.norm(fed - true))

    @property
    def tracking(self) -> float:
        """Distance between the true centre of pressure and the planned one in m, both in level frames."""
        if not self.true_observation["cop_valid"][0]:
            return float("nan")
        planned = self.true_observation["state"][self.bare.state_layout["cop_reference"]]
        return float(np.linalg.norm(self.true_observation["cop"].astype(np.float64) - planned))

    @property
    def true_cop_world(self) -> Floats:
        """The true centre of pressure in the world in m, shape (2,); NaN where there is none."""
        cop: Floats = self.bare.truth.cop_world()
        return cop

    @property
    def fed_cop_world(self) -> Floats:
        """The fed centre of pressure, placed under the true soles, in the world in m, shape (2,)."""
        sole = self.bare.truth.position_sole[-1, :, :2].mean(axis=0)
        ahead = self.bare.truth.R_world_sole[-1, :, :2, 0].sum(axis=0)
        x, y = ahead / np.linalg.norm(ahead)
        placed: Floats = sole + np.array([[x, -y], [y, x]]) @ self.observation["cop"]
        return placed


def episode_steps(
    episode: Episode, controller: Controller | None = None, **drawing: Any
) -> Iterator[EpisodeStep]:
    """Run an episode to its end or the fall, perhaps with another controller than the named one.

    Drawing options change nothing but pictures. A quiet stand comes before control. Raises ValueError if the
    controller's file is another one than the episode names, or something is refused.
    """
    env, tap, controller = _make(episode, controller, drawing)
    bare: Any = env.unwrapped
    settle = bare.stand_time if episode.settle is None else episode.settle
    waiting, steps, done = round(settle / bare.dt), 0, False
    still = np.zeros(env.action_space.shape or (), dtype=np.float32)
    try:
        observation, _ = env.reset(seed=episode.seed)
        while not done:
            if steps == waiting and hasattr(controller, "reset"):
                controller.reset()
            asked = steps >= waiting
            action = np.asarray(controller(observation) if asked else still)
            observation, reward, fell, truncated, _ = env.step(action)
            steps += 1
            done = fell or truncated
            yield EpisodeStep(
                steps * bare.dt, bare, observation, tap.seen, fell, action, float(reward), asked
            )
    finally:
        env.close()


def check_episode(episode: Episode) -> None:
    """Make everything that an episode needs; raise ValueError with scenario and controller if refused."""
    try:
        env, _, _ = _make(episode, None, {})
    except Exception as error:
        raise ValueError(
            f"Scenario '{episode.scenario}' with controller '{episode.controller}' cannot be run: {error}"
        ) from error
    env.close()


def episode_row(episode: Episode, controller: Controller | None = None) -> dict[str, Any]:
    """Run an episode, perhaps with another controller than the named one, and return one row about it.

    The episode's keys, ``return`` (the sum of rewards), ``steps``, ``time`` on its feet in s, ``fell``
    (otherwise the time is censored), ``cop_error`` (rms distance between the centre of pressure fed back and
    the true one, in m) and ``tracking`` (between the true one and its plan, in m), both while the controller
    is asked, ``digest`` (a hash of all actions, rewards and centres of pressure), ``wall_time`` in s,
    ``error`` (empty) and versions.
    """
    began = time.perf_counter()
    total, counted, errors, digest = 0.0, 0, [(float("nan"),) * 2], sha256()
    for step in episode_steps(episode, controller):
        if step.asked or not episode.of_task:
            total += step.reward
            counted += 1
        if step.asked:
            errors.append((step.cop_error, step.tracking))
        digest.update(step.action.astype(np.float32).tobytes() + np.float64(step.reward).tobytes())
        digest.update(step.observation["cop"].tobytes() + step.true_observation["cop"].tobytes())
    cop_error, tracking = map(rms, zip(*errors, strict=True))
    outcome = {
        "return": total,
        "steps": counted,
        "time": counted * step.bare.dt,
        "fell": bool(step.fell),
        "cop_error": cop_error,
        "tracking": tracking,
        "digest": digest.hexdigest()[:_DIGEST_DIGITS],
    }
    return _row(episode, outcome, "", time.perf_counter() - began)


def run_case(episode: Episode) -> dict[str, list[dict[str, Any]]]:
    """Return the row of an episode as a case of a study."""
    return {TABLE: [episode_row(episode)]}


def row_of_failure(episode: Episode, error: str) -> dict[str, Any]:
    """Return the row of an episode that could not be run through."""
    nothing: dict[str, Any] = dict.fromkeys(OUTCOME, float("nan"))
    return _row(episode, nothing | {"steps": 0, "fell": False, "digest": ""}, error, float("nan"))


@cache
def versions() -> dict[str, str]:
    """Return the versions of this process; ``code`` is a hash of surefoot's own sources."""
    packages = {name: version(name) for name in ("numpy", "mujoco", "gymnasium")}
    code = source_hash()
    found = {"surefoot": surefoot.__version__, "python": platform.python_version(), **packages, "code": code}
    return {name: found[name] for name in VERSIONS}


def _make(
    episode: Episode, controller: Controller | None, drawing: Mapping[str, Any]
) -> tuple[gym.Env[Any, Any], TruthTap, Controller]:
    """Return an environment on its feet, the tap that sees its truth, and the controller."""
    name = episode.controller
    if controller is None and controller_hash(name, episode.environment) != episode.controller_hash:
        raise ValueError(
            f"The file behind the controller '{name}' is another one than the study began with; put the old "
            "one back, or begin in another folder."
        )
    options: dict[str, Any] = {"disable_env_checker": True, **episode.options, **drawing}
    if episode.duration is not None:
        options["max_episode_steps"] = -1
    bare: gym.Env[Any, Any] = gym.make(episode.environment, **options)
    if episode.duration is not None:
        dt = bare.unwrapped.dt  # type: ignore[attr-defined]
        bare = gym.wrappers.TimeLimit(bare, round(episode.duration / dt))
    env, tap = put_on_feet(bare, episode.calibration, episode.cells, episode.sensors)
    if controller is None:
        return env, tap, load_controller(name, env, same_task=episode.of_task)
    check_fits(controller, env)
    return env, tap, controller


def _row(episode: Episode, outcome: Mapping[str, Any], error: str, wall_time: float) -> dict[str, Any]:
    what = {"case": episode.number} | {name: getattr(episode, name) for name in _WHAT}
    made = {"error": error, "wall_time": wall_time, **versions(), "spec": episode.to_json()}
    return {**what, **outcome, **made}
