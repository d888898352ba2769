"""One walker on feet of different kinds: the same robot, pattern and controller behind another wrapper.

What is fed back as the centre of pressure is named by a *feed*: ``"true"``, ``"none"`` for drifting raw
readings by the sensors' nominal map, or a calibration method.
"""

from typing import Any

import gymnasium as gym

from surefoot.calibration.online import METHODS, method_name
from surefoot.envs.nao.env import CONTROL_STEP
from surefoot.sensors import LoadCells
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers.foot_sensors import FootSensors
from surefoot.wrappers.self_calibration import SelfCalibration

__all__ = ["FEEDS", "STAND_TIME", "TruthTap", "check_study", "make_walker"]

FEEDS = ("true", "none", *(name for name in reversed(METHODS) if name != "none"))
"""What the controller may be given for the centre of pressure."""

STAND_TIME = 4.0
"""Time in s that the robot stands before it walks: a standing start needs three, and the filters a while."""


def check_study(study: Any, *counts: str) -> None:
    """Refuse a study of walks that cannot be done.

    Args:
        study: Its options, ``settle`` and ``duration`` in s among them.
        counts: Names of those that count something.

    Raises:
        ValueError: If a count is below one, or errors count from no moment of the walk on.
    """
    for name in counts:
        if getattr(study, name) < 1:
            raise ValueError(f"'{name}' must be at least 1, got {getattr(study, name)}.")
    if not STAND_TIME < study.settle < study.duration:
        raise ValueError(
            f"'settle' must lie between {STAND_TIME:g} s of standing and the walk's end at "
            f"{study.duration:g} s, got {study.settle:g} s."
        )


class TruthTap(gym.Wrapper[Any, Any, Any, Any]):
    """Keep the last true observation within reach of who scores; nothing that is observed changes.

    Attributes:
        seen: The true observation that sensors stand in front of.
    """

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset, and keep what is seen."""
        self.seen, info = self.env.reset(seed=seed, options=options)
        return self.seen, info

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Step, and keep what is seen."""
        self.seen, reward, terminated, truncated, info = self.env.step(action)
        return self.seen, float(reward), terminated, truncated, info


def make_walker(
    feed: str,
    *,
    speed: float,
    duration: float,
    cells: LoadCells = HX711_LOAD_CELLS,
    render_mode: str | None = None,
    **env_options: Any,
) -> tuple[gym.Env[Any, Any], TruthTap]:
    """Put a walker on feet of a kind.

    Args:
        feed: One of :data:`FEEDS`.
        speed: Forward speed in m/s.
        duration: Duration of the walk, standing included, in s.
        cells: The load cells.
        render_mode: As in :class:`~surefoot.envs.NaoEnv`.
        **env_options: Further options of :class:`~surefoot.envs.nao.walk.NaoWalkEnv`.

    Returns:
        The environment to step, and the tap that sees the truth beneath its sensors.

    Raises:
        ValueError: If there is no such feed, or the environment refuses an option.
    """
    feed = method_name(feed)
    if feed not in FEEDS:
        raise ValueError(f"There is no feed '{feed}'. Available: {', '.join(map(repr, FEEDS))}.")
    # The walk is cut off before the pattern stops: what is scored is standing first and then walking.
    bare = gym.make(
        "surefoot/NaoWalk-v0",
        max_episode_steps=round(duration / CONTROL_STEP),
        disable_env_checker=True,
        speed=speed,
        duration=duration + 2 * STAND_TIME,
        stand_time=STAND_TIME,
        render_mode=render_mode,
        **env_options,
    )
    tap = TruthTap(bare)
    if feed == "true":
        return tap, tap
    return SelfCalibration(FootSensors(tap, cells), feed), tap
