"""Everything that decides an episode but its policy, feed, severity and seed."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pkgutil import resolve_name
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from surefoot.controllers.policy import PolicyNetwork
from surefoot.experiments.evaluate.feet import FedFeet, put_on
from surefoot.experiments.evaluate.policies import fingerprint
from surefoot.experiments.evaluate.scenarios import Scenario, scenario_of
from surefoot.robot.foot_view import DEFAULT, PARTS

_ID = re.compile(r"^(?:[\w.]+:)?(?:[\w-]+/)?[\w.-]+-v\d+$")  # an id of Gymnasium, perhaps with its package

Observe = Callable[[Mapping[str, Any]], Any]


@dataclass(frozen=True)
class Setup:
    """How an environment is made, worn and observed.

    Attributes:
        make_env: An id of Gymnasium, a function, or ``"module:function"``.
        env_options: Options of ``make_env``.
        cells: The instruments under the feet, a preset's name or a configuration.
        sensors: Further options of :class:`~surefoot.wrappers.FootSensors`, such as ``soles``.
        calibration: Options of :class:`~surefoot.wrappers.SelfCalibration`, such as ``errors``.
        faults: What breaks when, or how likely, ``{"dies": 0.02}``.
        scenario: What differs from the training, see :mod:`surefoot.experiments.evaluate.scenarios`.
        observe: How foot quantities enter the policy's observation: names of parts, joined to one vector, or
            a function of the sensors' observation. By default the policy gets what its own space names, or
            the environment's own observation unchanged.
        wrap: A function that wraps the environment with its sensors as in training.
        settle: Time in s before the policy is asked; by default the task's own quiet stand.
        duration: Longest duration of an episode in s; by default the environment's.
        metrics: Names in ``info``, or a function of it, whose means become columns.

    Raises:
        ValueError: If there is no such environment, or a value has no meaning.
    """

    make_env: Any
    env_options: Mapping[str, Any] = field(default_factory=dict)
    cells: Any = None
    sensors: Mapping[str, Any] = field(default_factory=dict)
    calibration: Mapping[str, Any] = field(default_factory=dict)
    faults: Any = ()
    scenario: Any = None
    observe: Any = None
    wrap: Any = None
    settle: float | None = None
    duration: float | None = None
    metrics: Any = ()

    def __post_init__(self) -> None:
        """Resolve names where they are given, so that workers need no registration of the caller's."""
        if isinstance(self.make_env, str) and _ID.match(self.make_env):
            object.__setattr__(self, "make_env", _spec_of(self.make_env))
        elif isinstance(self.make_env, str):
            object.__setattr__(self, "make_env", import_named("environment", self.make_env))
        if not (isinstance(self.make_env, gym.envs.registration.EnvSpec) or callable(self.make_env)):
            raise ValueError(
                "'make_env' must be an id of Gymnasium, a function that makes an environment, or "
                f"'module:function', got {self.make_env!r}."
            )
        if isinstance(self.wrap, str):
            object.__setattr__(self, "wrap", import_named("wrapper", self.wrap))
        if isinstance(self.scenario, str | list | tuple):
            words = [self.scenario] if isinstance(self.scenario, str) else self.scenario
            object.__setattr__(self, "scenario", scenario_of(words))
        if isinstance(self.observe, str):
            one = import_named("function", self.observe) if ":" in self.observe else (self.observe,)
            object.__setattr__(self, "observe", one)
        for name in ("settle", "duration"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < float("inf"):
                raise ValueError(f"'{name}' must be a time in s from 0 on, got {value!r}.")

    @property
    def env_id(self) -> str:
        """The id of the environment, or the name of the function that makes it."""
        return str(getattr(self.make_env, "id", "") or getattr(self.make_env, "__qualname__", "environment"))

    @property
    def show(self) -> tuple[str, ...] | None:
        """Parts that the sensors' observation needs beyond the default ones; ``None`` for these alone."""
        asked = [] if self.observe is None or callable(self.observe) else self.observe
        more = [part for part in asked if part in PARTS and part not in DEFAULT]
        if more:
            return (*DEFAULT, *more)
        return None

    def bare(self, **drawing: Any) -> gym.Env[Any, Any]:
        """Make the bare environment; drawing options change nothing but pictures."""
        options = {**self.env_options, **drawing}
        if isinstance(self.make_env, gym.envs.registration.EnvSpec):
            options = {"disable_env_checker": True, **options}
            if "include_cfrc_ext_in_observation" in _keywords(self.make_env):
                options.setdefault("include_cfrc_ext_in_observation", False)
            if self.duration is not None:
                options["max_episode_steps"] = -1
            return gym.make(self.make_env, **options)
        env = self.make_env(**options)
        if not isinstance(env, gym.Env):
            raise ValueError(f"'make_env' must return an environment of Gymnasium, got {env!r}.")
        return env

    def feet(self, feed: str, severity: float, **drawing: Any) -> FedFeet:
        """Make the environment on the feet of a feed."""
        given: Any = {name: getattr(self, name) for name in ("cells", "sensors", "calibration", "faults")}
        return put_on(self.bare(**drawing), feed, severity, show=self.show, scenario=self.scenario, **given)

    def describe(self) -> dict[str, Any]:
        """Return plain data that differ wherever an episode could."""
        return {name: _plain(getattr(self, name)) for name in self.__dataclass_fields__}


def observer(setup: Setup, policy: Any, env: FedFeet) -> Observe:
    """Return the function from the sensors' observation to that of the policy.

    Without ``observe`` a policy gets the parts that its own space names, or the environment's own observation
    unchanged. ValueError if the environment does not show what the policy was trained on.
    """
    shown: Any = env.observation_space
    wanted: Any = getattr(policy, "observation_space", None)
    if callable(setup.observe):
        found: Observe = setup.observe
        return found
    keys = setup.observe
    if keys is None and isinstance(wanted, spaces.Dict):
        keys = list(wanted.spaces)
    if keys is not None:
        if lacking := [key for key in keys if key not in shown.spaces]:
            raise ValueError(
                f"The policy observes '{lacking[0]}', and the environment with its sensors shows "
                f"{sorted(shown.spaces)}; name what it was trained on with 'observe'."
            )
        if isinstance(wanted, spaces.Dict):
            return lambda seen: {key: seen[key] for key in keys}
        return lambda seen: np.concatenate([np.ravel(seen[key]) for key in keys]).astype(np.float32)
    # A policy file of the package names the parts that it looks at itself.
    if isinstance(env.source.observation_space, spaces.Dict) or isinstance(policy, PolicyNetwork):
        return lambda seen: seen
    return lambda seen: seen["state"]


def check_observation(policy: Any, observation: Any, action_space: Any) -> None:
    """Raise ValueError if a policy was trained on observations of another shape, or moves something else."""
    wanted = getattr(policy, "observation_space", None)
    if isinstance(wanted, spaces.Box) and np.shape(observation) != wanted.shape:
        raise ValueError(
            f"The policy was trained on observations of shape {wanted.shape}, and is shown one of shape "
            f"{np.shape(observation)}: give the environment that it was trained in (without true contact "
            "forces), or name the parts with 'observe'."
        )
    if hasattr(policy, "reset"):
        policy.reset()
    answer = np.asarray(policy(observation))
    if answer.shape != (action_space.shape or ()):
        raise ValueError(
            f"The policy answers with actions of shape {answer.shape}, and the environment takes "
            f"{action_space.shape}: it is a policy for another robot."
        )
    if not np.isfinite(answer).all():
        raise ValueError("The policy answers its first observation with numbers that are not finite.")


def import_named(what: str, name: str) -> Any:
    """Return a function or class by 'module:name'; ValueError says how to make it importable."""
    if ":" not in name:
        raise ValueError(
            f"There is no {what} '{name}'; give an id such as 'Humanoid-v5', or 'module:function'."
        )
    try:
        return resolve_name(name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(
            f"'{name}' cannot be imported ({error}); its module must be on the Python path; PYTHONPATH=. "
            "before the command adds this folder."
        ) from error


def _spec_of(name: str) -> Any:
    module, _, rest = name.rpartition(":")
    try:
        if module:
            __import__(module)
        return gym.spec(rest)
    except (gym.error.Error, ImportError) as error:
        raise ValueError(
            f"There is no environment '{name}' ({error}); register it, or name its package as in "
            "'package:Name-v0'."
        ) from error


def _keywords(spec: Any) -> set[str]:
    import inspect

    entry = spec.entry_point
    made = gym.envs.registration.load_env_creator(entry) if isinstance(entry, str) else entry
    return set(inspect.signature(made).parameters)


def _plain(value: Any) -> Any:
    if isinstance(value, gym.envs.registration.EnvSpec):
        return (
            value.to_json()
            if isinstance(value.entry_point, str)
            else f"{value.id} {fingerprint(value.entry_point)}"
        )
    if isinstance(value, Scenario):
        return {"scenario": repr(value)}
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, str | int | float | bool | None):
        return value
    if isinstance(value, Sequence):
        return [_plain(one) for one in value]
    return f"{getattr(value, '__qualname__', type(value).__name__)} {fingerprint(value)}"
