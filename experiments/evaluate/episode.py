"""One seeded episode of any environment with any policy, and one row about how it went.

Columns of a row, besides those of the grid (``case``, ``policy``, ``training``, ``feed``, ``severity``,
``fault``, ``seed``):

* ``return``, ``length``: sum of rewards and number of the policy's steps, after the quiet stand if there is
  one; ``time``: the duration of these steps in s.
* ``fell``: whether the environment terminated the episode; a truncated one is censored.
* ``cop_error``, ``cop_error_FOOT``: rms distance of the fed from the true centre of pressure in m, of all
  feet together and of each.
* one column for each of ``metrics``: its mean over the steps.
* ``digest``: a hash of all actions, rewards and centres of pressure: equal if and only if the episode was the
  same to the last bit.
* ``error``: empty, or the traceback of an episode that failed; ``wall_time`` in s; versions.
"""

import platform
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

import surefoot
from surefoot.arrays import Floats
from surefoot.experiments.evaluate.feet import FedFeet
from surefoot.experiments.evaluate.policies import ready
from surefoot.experiments.evaluate.setup import Observe, Setup, check_observation, observer
from surefoot.experiments.study.sources import source_hash

OUTCOME = ("return", "length", "time", "fell", "cop_error", "digest")
"""What a repetition must bring out again to the last digit."""

VERSIONS = ("surefoot", "python", "numpy", "mujoco", "gymnasium", "code")  # with what a row was made

_DIGEST_DIGITS = 32
_TRIED = 3  # steps after which a repeated reset must start the same episode


class EpisodeStep(NamedTuple):
    """An episode after one step of the policy."""

    time: float  # since the reset in s
    feet: FedFeet  # what was fed, and the truth
    env: gym.Env[Any, Any]  # as the policy sees it
    fell: bool  # the environment terminated the episode
    action: Any
    reward: float
    info: Mapping[str, Any]
    asked: bool  # the policy was, and not the quiet stand's zero action

    @property
    def true_cop_world(self) -> Floats:
        """The true centre of pressure in the world in m, shape (2,); NaN where there is none."""
        cop: Floats = self.feet.source.truth.cop_world()
        return cop

    @property
    def fed_cop_world(self) -> Floats:
        """The fed centre of pressure, placed under the true soles, in the world in m, shape (2,)."""
        truth = self.feet.source.truth
        sole = truth.position_sole[-1, :, :2].mean(axis=0)
        ahead = truth.R_world_sole[-1, :, :2, 0].sum(axis=0)
        x, y = ahead / np.linalg.norm(ahead)
        placed: Floats = sole + np.array([[x, -y], [y, x]]) @ self.feet.seen["cop"]
        return placed


@dataclass(eq=False)
class Stage:
    """An environment on the feet of a feed, and a policy in it; it serves one episode after another."""

    setup: Setup
    feet: FedFeet
    env: gym.Env[Any, Any]
    policy: Callable[[Any], Any]
    observe: Observe

    @classmethod
    def make(
        cls, setup: Setup, policy: Any, feed: str, severity: float, name: str = "", **drawing: Any
    ) -> "Stage":
        """Make the environment, and the policy from its name; ValueError if one is refused."""
        feet = setup.feet(feed, severity, **drawing)
        env = feet if setup.wrap is None else setup.wrap(feet)
        acting = ready(policy, env, name)
        observe: Observe = observer(setup, acting, feet) if setup.wrap is None else lambda seen: seen
        return cls(setup, feet, env, acting, observe)

    @property
    def settle(self) -> float:
        """Time in s for which the action is zero before the policy is asked."""
        given = self.setup.settle
        return float(getattr(self.env.unwrapped, "stand_time", 0.0)) if given is None else given

    def check(self, seed: int) -> None:
        """Raise ValueError if the policy does not fit, or a seed does not start the same episode again."""
        still, starts = np.zeros(self.env.action_space.shape or (), dtype=np.float32), []
        for _ in range(2):
            observation, _ = self.env.reset(seed=seed)
            starts.append(_bytes_of(observation))
            for _ in range(_TRIED):
                self.env.step(still)
        if starts[0] != starts[1]:
            raise ValueError(
                f"{self.env.unwrapped} does not start the same episode again by reset(seed={seed}), so that "
                "feeds cannot be compared on the same episodes; draw everything random from self.np_random."
            )
        check_observation(self.policy, self.observe(observation), self.env.action_space)

    def steps(self, seed: int) -> Iterator[EpisodeStep]:
        """Run an episode to its end."""
        env, feet, dt = self.env, self.feet, float(self.feet.source.dt)
        waiting = round(self.settle / dt)
        longest = float("inf") if self.setup.duration is None else round(self.setup.duration / dt)
        still = np.zeros(env.action_space.shape or (), dtype=np.float32)
        observation, _ = env.reset(seed=seed)
        started = done = False
        while not done:
            asked = len(feet.fed) >= waiting
            if asked and not started and hasattr(self.policy, "reset"):
                self.policy.reset()
            started = asked
            action = self.policy(self.observe(observation)) if asked else still
            observation, reward, fell, truncated, info = env.step(action)
            passed = len(feet.fed)
            done = fell or truncated or passed >= longest
            yield EpisodeStep(passed * dt, feet, env, bool(fell), action, float(reward), info, asked)

    def row(self, seed: int) -> dict[str, Any]:
        """Run an episode, and return its outcome."""
        began = time.perf_counter()
        total, length, before = 0.0, 0, 0.0
        digest, sums = sha256(), dict[str, float]()
        read = _reader(self.setup.metrics)
        for step in self.steps(seed):
            if step.asked:
                total += step.reward
                length += 1
                for name, value in read(step.info).items():
                    sums[name] = sums.get(name, 0.0) + float(value)
            else:
                before = step.time
            digest.update(np.asarray(step.action, dtype=np.float32).tobytes())
            digest.update(np.float64(step.reward).tobytes() + self.feet.fed[-1].tobytes())
        return {
            "return": total,
            "length": length,
            "time": step.time - before,
            "fell": step.fell,
            **self.feet.errors(),
            **{name: value / length for name, value in sums.items()},
            "digest": digest.hexdigest()[:_DIGEST_DIGITS],
            "error": "",
            "wall_time": time.perf_counter() - began,
        }


def run_episode(setup: Setup, policy: Any, feed: str, severity: float, seed: int) -> dict[str, Any]:
    """Run one episode, and return one row about it.

    >>> import numpy as np
    >>> setup = Setup("surefoot/NaoStand-v0", env_options={"duration": 0.2})
    >>> row = run_episode(setup, lambda observation: np.zeros(11), "raw", 1.0, seed=3)
    >>> row["length"], row["fell"], row["cop_error"] > 0.0
    (16, False, True)
    """
    stage = Stage.make(setup, policy, feed, severity)
    try:
        what = {"feed": feed, "severity": severity, "seed": seed}
        return {**what, **stage.row(seed), **versions()}
    finally:
        stage.env.close()


def outcome_of_failure(error: str) -> dict[str, Any]:
    """Return the outcome of an episode that could not be run through."""
    nothing: dict[str, Any] = dict.fromkeys(OUTCOME, float("nan"))
    return nothing | {"length": 0, "fell": False, "digest": "", "error": error, "wall_time": float("nan")}


@cache
def versions() -> dict[str, str]:
    """Return the versions of this process; ``code`` is a hash of surefoot's own sources."""
    packages = {name: version(name) for name in ("numpy", "mujoco", "gymnasium")}
    code = source_hash()
    found = {"surefoot": surefoot.__version__, "python": platform.python_version(), **packages, "code": code}
    return {name: found[name] for name in VERSIONS}


def _reader(metrics: Any) -> Callable[[Mapping[str, Any]], Mapping[str, float]]:
    """Return the function from a step's ``info`` to metrics by name."""
    if callable(metrics):
        read: Callable[[Mapping[str, Any]], Mapping[str, float]] = metrics
        return read
    names = (metrics,) if isinstance(metrics, str) else tuple(metrics)
    return lambda info: {name: info[name] for name in names}


def _bytes_of(observation: Any) -> bytes:
    if isinstance(observation, Mapping):
        return b"".join(_bytes_of(observation[key]) for key in sorted(observation))
    return np.asarray(observation).tobytes()
