"""Find the source of ground truth below a wrapper, check the order of wrappers, and parse reset options."""

from collections.abc import Mapping
from typing import Any, Protocol, TypeVar, cast

import gymnasium as gym
import mujoco
from gymnasium import ObservationWrapper, spaces
from gymnasium.vector import VectorWrapper
from gymnasium.wrappers import FilterObservation

from surefoot.envs import InstrumentedEnv, RobotDrawing
from surefoot.robot.sensing.sensors import SensorsFace

OPTIONS = "surefoot"
"""Key of the reset options for wrappers. It is not passed to the environment."""

Sensors = TypeVar("Sensors")

CLOCK_TOLERANCE = 0.01
"""Maximum error of a step's duration, as a fraction of dt. A larger error would make rates wrong."""

_BLOWN_UP = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)
"""MuJoCo warnings about a state that is NaN, infinite or too large. A reset clears them."""

FRESH_OR_KEPT = ("fresh", "keep")


class Source(Protocol):
    """An environment that records ground truth: one of surefoot, or any other inside InstrumentedEnv."""

    truth: Any  # of the last control step, its class is the environment's
    drawing: RobotDrawing  # the manufacturer's drawing of the robot
    joint_names: tuple[str, ...]  # the J hinge joints
    dt: float  # duration of a control step in s
    model: mujoco.MjModel  # the simulated robot
    data: mujoco.MjData  # its state


def find_source(env: gym.Env[Any, Any]) -> Source | None:
    """Return the outermost environment or wrapper that records ground truth, or ``None``."""
    below: gym.Env[Any, Any] = env
    while True:
        if hasattr(type(below), "row_meaning") or "row_meaning" in vars(below):
            raise TypeError(
                "TruthRow shows truth to the wrappers of a vector environment: put it around each copy, and "
                f"VectorFootSensors around them all. Got {env}."
            )
        if hasattr(type(below), "drawing") or "drawing" in vars(below):
            return cast(Source, below)
        if not isinstance(below, gym.Wrapper):
            return None
        below = below.env


def find_sensors(env: Any, owner: type, sensors: type[Sensors], wrapper: type) -> Sensors:
    """Return the sensors whose counts a wrapper calibrates, from the wrappers below it.

    Args:
        env: The environment that the calibrating wrapper wraps.
        owner: Class of the calibrating wrapper, which may be used only once.
        sensors: Class of the wrapper with the sensors.
        wrapper: Base class of all wrappers.

    Raises:
        TypeError: If the sensors are missing or already calibrated.
    """
    mine, theirs, below = owner.__name__, sensors.__name__, env
    while isinstance(below, wrapper):
        if isinstance(below, owner):
            raise TypeError(
                f"{mine} found another {mine} below it; one is enough, wrap once: {mine}({theirs}(env)). "
                f"Got {env}."
            )
        if isinstance(below, sensors):
            return below
        below = below.env  # type: ignore[attr-defined]
    raise TypeError(
        f"{mine} calibrates the counts of {theirs} and found none below it; wrap in this order: "
        f"{mine}({theirs}(env)). Got {env}."
    )


def refuse_second(owner: str, env: Any) -> None:
    """Raise TypeError if the wrappers below a sensor wrapper already include sensors."""
    below: Any = env
    while below is not None:
        if isinstance(below, SensorsFace):
            found = type(below).__name__
            raise TypeError(
                f"{owner} found {found} below it, and a robot's feet are read once; leave the outer one out, "
                f"or put a calibrator around what is there. Got {env}."
            )
        wraps = isinstance(below, gym.Wrapper | VectorWrapper)
        below = below.env if wraps else vars(below).get("venv") if hasattr(below, "__dict__") else None


def with_source(env: gym.Env[Any, Any], **options: Any) -> gym.Env[Any, Any]:
    """Return an environment that records ground truth, after adding sensors to its model if necessary.

    Args:
        env: The environment.
        options: Options of :class:`~surefoot.envs.InstrumentedEnv`.

    Raises:
        TypeError: If the environment is not based on MuJoCo.
        ValueError: If its feet cannot be found or do not have space for the sensors, or if options are passed
            for an environment that already records ground truth.
    """
    if not isinstance(env, gym.Env):
        raise TypeError(
            f"FootSensors and TruthRow go around one environment, as gym.make(...) makes it, got {env!r}; "
            "for those that gym.make_vec(...) makes there is VectorFootSensors, for Stable-Baselines3's "
            "VecFootSensors in surefoot.wrappers.vector.sb3."
        )
    given = {name: value for name, value in options.items() if value is not None}
    if find_source(env) is None:
        return InstrumentedEnv(env, **given)
    if given:
        raise ValueError(
            f"{sorted(given)} are about putting sensors into a robot, but {env} records its truth already; "
            "leave them out, or give them to the InstrumentedEnv below."
        )
    return env


def warning_of_true_forces(env: gym.Env[Any, Any]) -> str:
    """Return a warning if the observation of a Gymnasium robot contains its true contact forces."""
    bare: Any = env.unwrapped
    if not getattr(bare, "observation_structure", {}).get("cfrc_ext"):
        return ""
    if spaces.flatdim(env.observation_space) < spaces.flatdim(bare.observation_space):
        return ""  # a wrapper has removed a part of the observation
    return (
        f"The observation of {bare} holds 'cfrc_ext', the true forces of its contacts, beside the sensors: a "
        "policy sees the truth that the sensors are to hide. Leave it out with gym.make(..., "
        "include_cfrc_ext_in_observation=False)."
    )


def check_order(owner: str, env: gym.Env[Any, Any], source: Any) -> None:
    """Raise TypeError if a wrapper changes an observation before ground truth is removed from it.

    Ground truth can only be removed if the environment has a ``state_layout``. Otherwise, the whole
    observation is passed on without a check.
    """
    below: Any = env
    while below is not source and getattr(source, "state_layout", None) is not None:
        filters = isinstance(below, FilterObservation)
        if _state(below) != _state(below.env) or (isinstance(below, ObservationWrapper) and not filters):
            raise TypeError(
                f"{owner} takes the truth out of an observation and must see it as the environment shows it, "
                f"but {type(below).__name__} below it makes something else of it; wrap in this order, and "
                f"whatever changes observations around all sensors: {owner}(env). Got {env}."
            )
        below = below.env


def _state(env: gym.Env[Any, Any]) -> spaces.Space[Any] | None:
    space = env.observation_space
    return space.spaces.get("state") if isinstance(space, spaces.Dict) else None


def check_clock(owner: str, env: Any, passed: float, dt: float, source: Any = None) -> bool:
    """Raise RuntimeError if a step did not last the environment's dt, which would make all rates wrong.

    If a simulation becomes unstable, MuJoCo resets it to its initial state and continues. This case is
    returned instead.

    Args:
        owner: Name of the wrapper, for the message.
        env: The environment, for the message.
        passed: Simulated time in s since the previous step.
        dt: Duration of a control step in s.
        source: The simulation whose warnings are read, if any.

    Returns:
        Whether the simulation became unstable during the step.
    """
    late = not abs(passed - dt) <= CLOCK_TOLERANCE * dt
    if late and source is not None and any(source.data.warning[kind].number for kind in _BLOWN_UP):
        return True
    if abs(passed - dt) > CLOCK_TOLERANCE * dt:
        raise RuntimeError(
            f"A step of {env} took {passed:g} s of simulated time, but its dt is {dt:g} s; put whatever "
            f"repeats or skips steps, or resets by itself, around {owner}. Each step of an environment of "
            "your own must make the same number of physics steps."
        )
    return late


def split_options(
    options: dict[str, Any] | None, *kinds: str
) -> tuple[dict[str, Any] | None, Mapping[str, str]]:
    """Split the options of a reset into those for the environment and those for the wrappers.

    Args:
        options: Options of the reset, which are not modified.
        kinds: Valid keys of the options for wrappers, from ``"sensors"`` and ``"calibration"``.

    Returns:
        Options for the environment, and ``"fresh"`` or ``"keep"`` by kind.

    Raises:
        TypeError: If the options are not a mapping.
        ValueError: If a kind or a choice does not exist.
    """
    if options is not None and not isinstance(options, Mapping):
        raise TypeError(f"'options' of a reset must be a mapping, got {options!r}.")
    if options is None or OPTIONS not in options:
        return options, {}
    rest = {key: value for key, value in options.items() if key != OPTIONS}
    asked = options[OPTIONS]
    if not isinstance(asked, Mapping) or not set(asked) <= set(kinds):
        raise ValueError(f"options['{OPTIONS}'] must be a mapping with keys among {kinds}, got {asked!r}.")
    for kind, choice in asked.items():
        if choice not in FRESH_OR_KEPT:
            raise ValueError(
                f"options['{OPTIONS}']['{kind}'] must be one of {FRESH_OR_KEPT}, got {choice!r}."
            )
    return rest or None, dict(asked)
