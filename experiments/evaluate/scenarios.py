"""Changes of any world in MuJoCo that the robot does not know of, as wrappers below the sensors.

=====================  =====================================================================================
in words               meaning
=====================  =====================================================================================
``payload=1.5``        mass in kg that is added to the torso, at its centre of mass
``slope=3``            degrees by which the ground falls off to the front
``friction=0.3``       coefficient of sliding friction of everything
``soft=0.05``          time constant in s of contacts, 0.02 being MuJoCo's
``push=2``             impulses in N s on the torso, once a second in directions that the seed draws
=====================  =====================================================================================
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any

import gymnasium as gym
import numpy as np

from surefoot.wrappers.source import find_source

_STREAM = 0x9054  # of directions and moments, apart from the streams of environments and sensors
PUSH_EVERY, PUSH_LASTS = 1.0, 0.1  # time in s between two pushes, and duration of one


@dataclass(frozen=True)
class Scenario:
    """What differs from the world that a policy was trained in."""

    payload: float = 0.0  # kg
    slope: float = 0.0  # degrees
    friction: float = field(default=float("nan"))
    soft: float = field(default=float("nan"))  # s
    push: float = 0.0  # N s

    def __post_init__(self) -> None:
        """Raise ValueError at a number that has no meaning."""
        for name, least in (("payload", 0.0), ("push", 0.0), ("friction", 0.0), ("soft", 1e-3)):
            if getattr(self, name) < least:
                raise ValueError(
                    f"The scenario's '{name}' must be {least:g} or more, got {getattr(self, name):g}."
                )
        if not abs(self.slope) < 45.0:
            raise ValueError(f"The scenario's 'slope' must be less than 45 degrees, got {self.slope:g}.")

    def __call__(self, env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
        """Change the world of an environment that records its truth, and push its robot."""
        source: Any = find_source(env)
        model, torso = source.model, source.model.body(source.drawing.torso).id
        if self.payload:
            mass = float(model.body_mass[torso])
            if not mass > 0.0:
                raise ValueError(
                    f"The scenario's 'payload' is {self.payload:g} kg on the torso "
                    f"'{source.drawing.torso}', which has no mass itself; leave it out, or change the model."
                )
            model.body_inertia[torso] *= 1.0 + self.payload / mass
            model.body_mass[torso] += self.payload
        angle, down = np.deg2rad(self.slope), float(np.linalg.norm(model.opt.gravity))
        if self.slope:
            model.opt.gravity[:] = down * np.array([np.sin(angle), 0.0, -np.cos(angle)])
        if not np.isnan(self.friction):
            model.geom_friction[:, 0] = self.friction
        if not np.isnan(self.soft):
            model.geom_solref[:, 0] = self.soft
        return Pushed(env, self.push, source, torso) if self.push else env


class Pushed(gym.Wrapper[Any, Any, Any, Any]):
    """Push the torso once a second with a horizontal impulse in N s, in a direction that the seed draws."""

    def __init__(self, env: gym.Env[Any, Any], impulse: float, source: Any, torso: int) -> None:
        gym.Wrapper.__init__(self, env)
        self._impulse, self._source, self._torso = impulse, source, torso

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Draw the pushes of an episode."""
        if seed is not None:
            self._rng = np.random.default_rng([_STREAM, seed])
        self._steps = 0
        self._source.data.xfrc_applied[self._torso, :2] = 0.0  # an episode may end during a push
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Push, and step."""
        every, lasts = (max(round(time / self._source.dt), 1) for time in (PUSH_EVERY, PUSH_LASTS))
        self._steps += 1
        if self._steps % every == 0:
            angle = self._rng.uniform(0.0, 2.0 * np.pi)
            size = self._impulse / (lasts * self._source.dt)
            self._source.data.xfrc_applied[self._torso, :2] = size * np.cos(angle), size * np.sin(angle)
        elif self._steps % every == lasts:
            self._source.data.xfrc_applied[self._torso, :2] = 0.0
        return self.env.step(action)


def scenario_of(words: Sequence[str]) -> Scenario | None:
    """Return the scenario of words such as "payload=1.5"; ``None`` for none, ValueError at a wrong one.

    >>> scenario_of(["slope=3", "push=2"]).slope
    3.0
    """

    def read(found: dict[str, float], word: str) -> dict[str, float]:
        name, _, value = word.partition("=")
        if name not in Scenario.__dataclass_fields__:
            known = ", ".join(Scenario.__dataclass_fields__)
            raise ValueError(f"There is no scenario '{name}'. Available: {known}, as in payload=1.5.")
        try:
            return found | {name: float(value)}
        except ValueError:
            raise ValueError(
                f"The scenario '{name}' needs a number, as in {name}=1.5, got '{word}'."
            ) from None

    nothing: dict[str, float] = {}
    return Scenario(**reduce(read, words, nothing)) if words else None
