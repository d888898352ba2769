"""The walker on true, drifting and calibrated feet: who falls, and when.

The controller is the same; what differs is the centre of pressure that it observes. The same seed gives the
same starting state, ground, pushes and sensors whatever is fed back.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from surefoot.controllers import Stabiliser, zero_action
from surefoot.experiments.arrays import Floats
from surefoot.experiments.walks.score import rms
from surefoot.experiments.walks.walkers import STAND_TIME, TruthTap, make_walker
from surefoot.sensors import LoadCells
from surefoot.sensors.presets import HX711_LOAD_CELLS


class Moment(NamedTuple):
    """An episode after one control step."""

    time: float  # since the reset in s
    bare: Any  # the environment beneath all wrappers
    observation: dict[str, Any]
    true_observation: dict[str, Any]  # without sensors in between
    fell: bool  # the episode ends then
    action: Any = None  # answered to the observation before
    reward: float = 0.0
    asked: bool = True  # the controller was, and not the quiet stand's zero action

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


@dataclass(frozen=True)
class LoopRun:
    """How one walk went."""

    severity: float
    speed: float  # in m/s
    seed: int
    feed: str
    fell: bool
    time: float  # on its feet in s
    cop_error: float  # rmse of the CoP fed back against the truth in m
    tracking: float  # rmse of the true CoP against its plan in m


def cells_of(severity: float) -> LoadCells:
    """Scale the errors and drift of ``hx711-load-cells``; severity 1 is the preset, 3 three times as bad."""
    scaled = ("initial_scale_std", "initial_offset_std", "scale_drift", "offset_drift")
    preset = HX711_LOAD_CELLS
    return replace(preset, **{name: severity * getattr(preset, name) for name in scaled})


def moments(
    env: gym.Env[Any, Any],
    tap: TruthTap,
    controller: Callable[[dict[str, Any]], Any],
    seed: int,
    settle: float = 0.0,
    change: Callable[[dict[str, Any]], dict[str, Any]] = lambda observation: observation,
) -> Iterator[Moment]:
    """Run an episode by control steps, and close it; ``settle`` s of quiet stand come before control."""
    bare: Any = env.unwrapped
    waiting, steps, done = round(settle / bare.dt), 0, False
    try:
        observation, _ = env.reset(seed=seed)
        while not done:
            if steps == waiting and hasattr(controller, "reset"):
                controller.reset()
            asked = steps >= waiting
            action = np.asarray(controller(change(observation)) if asked else zero_action(observation))
            observation, reward, fell, truncated, _ = env.step(action)
            steps += 1
            done = fell or truncated
            yield Moment(steps * bare.dt, bare, observation, tap.seen, fell, action, float(reward), asked)
    finally:
        env.close()


def walk_moments(
    feed: str, *, speed: float, seed: int, duration: float, severity: float = 1.0, **env_options: Any
) -> Iterator[Moment]:
    """Walk for a duration in s, standing included, a moment a control step, at a speed in m/s."""
    env, tap = make_walker(feed, speed=speed, duration=duration, cells=cells_of(severity), **env_options)
    bare: Any = env.unwrapped
    # Calibrators need a quiet stand to begin with: until then nobody is moved by what they say.
    return moments(env, tap, Stabiliser(bare.state_layout, engage_after=STAND_TIME), seed)


def run_loop(feed: str, *, speed: float, seed: int, duration: float, severity: float = 1.0) -> LoopRun:
    """Walk once and say how it went; arguments as in :func:`walk_moments`."""
    errors = []
    for moment in walk_moments(feed, speed=speed, seed=seed, duration=duration, severity=severity):
        errors.append((moment.cop_error, moment.tracking))
    error, tracking = map(rms, zip(*errors, strict=True))
    return LoopRun(severity, speed, seed, feed, moment.fell, moment.time, error, tracking)
