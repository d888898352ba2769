"""Observations of some moments ago: a stack that counts in seconds and not in steps."""

from collections import deque
from collections.abc import Sequence
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.checks import as_number
from surefoot.wrappers.source import find_source


class SampleHistory(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Observe parts of a ``Dict`` as they were at evenly spaced moments, the oldest first.

    A policy that was trained on a robot of 80 Hz finds the same moments in a robot of 50 Hz, and a converter
    that delivers ten readings a second is not stacked eight times over. A moment between two control steps is
    taken at the nearest of them. After a reset the first observation stands for all that came before.

    Each part of shape (...) becomes one of shape (samples, ...); all other parts stay.

    Args:
        env: An environment with :class:`~surefoot.wrappers.FootSensors` around it.
        keys: Names of the parts.
        samples: How many moments, the present one included.
        period: Time between two of them in s.

    Raises:
        TypeError: If the observation is no ``Dict`` or ``keys`` a single name.
        ValueError: If a part does not exist, fewer than two moments are asked for, or they lie closer than
            control steps.
    """

    def __init__(
        self, env: gym.Env[Any, Any], keys: Sequence[str] = ("cop", "cop_valid"), samples: int = 4,
        period: float = 0.05,
    ) -> None:  # fmt: skip
        gym.utils.RecordConstructorArgs.__init__(self, keys=list(keys), samples=samples, period=period)
        gym.Wrapper.__init__(self, env)
        space, source = env.observation_space, find_source(env)
        if not isinstance(space, spaces.Dict) or isinstance(keys, str) or source is None:
            raise TypeError(
                "SampleHistory stacks some parts (a sequence of names) of a Dict of observations such as "
                f"FootSensors shows; got keys={keys!r} and {type(space).__name__} of {env}."
            )
        unknown = [key for key in keys if key not in space.spaces]
        if unknown or not keys:
            raise ValueError(f"'keys' must name parts of {list(space.spaces)}, got {list(keys)}.")
        if isinstance(samples, bool) or not isinstance(samples, int) or samples < 2:
            raise ValueError(f"'samples' must be a whole number from 2 on, got {samples!r}.")
        dt, period = float(source.dt), as_number("period", period)
        if not dt * (1.0 - 1e-9) <= period < float("inf"):
            raise ValueError(f"'period' must be at least a control step, {dt:g} s here, got {period}.")
        self.keys = tuple(keys)
        self._back = [round(i * period / dt) for i in reversed(range(samples))]
        self._seen: deque[dict[str, NDArray[Any]]] = deque(maxlen=self._back[0] + 1)
        stacked = {key: _stack(space[key], samples) for key in self.keys}
        self.observation_space = spaces.Dict(dict(space.spaces) | stacked)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset, and take the first observation for all that came before."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._seen.clear()
        return self._observe(observation), info

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Step, and look back."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._observe(observation), reward, terminated, truncated, info

    def _observe(self, observation: dict[str, Any]) -> dict[str, Any]:
        self._seen.append({key: observation[key] for key in self.keys})
        newest = len(self._seen) - 1
        rows = [self._seen[max(newest - back, 0)] for back in self._back]
        return observation | {key: np.stack([row[key] for row in rows]) for key in self.keys}


def _stack(space: spaces.Space[Any], samples: int) -> spaces.Space[Any]:
    if isinstance(space, spaces.Box):
        low, high = (np.repeat(end[None], samples, axis=0) for end in (space.low, space.high))
        return spaces.Box(low, high, dtype=space.dtype)
    raise TypeError(f"SampleHistory stacks Box spaces, got {space}.")
