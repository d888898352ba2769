"""Who controls the robot: controllers by name, policies from files, and functions of the user's own.

| Controller | What it is |
|------------|------------|
| ``"zero"`` | the open-loop walker |
| ``"stabiliser"`` | :class:`surefoot.controllers.Stabiliser` |
| ``"shipped"`` | the policy that comes with the package for the environment's task, trained on true feet |
| ``"shipped-randomised"`` | the one that was trained on randomised sensors |
| ``"path.npz"`` | a policy's weights, which are data and run no code |
| ``"module:function"`` | code of the user's, which is imported and **runs with the user's rights** |

A function either answers an observation itself, or, if its first parameter is called ``state_layout``, is
given the environment's and returns what answers. What has a ``reset`` is reset before every episode.
"""

import inspect
from collections.abc import Callable, Mapping
from hashlib import sha256
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from surefoot.controllers import Stabiliser, zero_action
from surefoot.controllers.policy import PolicyNetwork
from surefoot.experiments.policy.shipped import shipped_policy
from surefoot.experiments.policy.tasks import TASKS

__all__ = ["Controller", "controller_hash", "load_controller", "short_name", "trained_on"]

Controller = Callable[[Mapping[str, Any]], NDArray[np.float32]]
"""Answers an observation with an action."""

_BUILT_IN: Mapping[str, Callable[[Mapping[str, slice]], Controller]] = {
    "zero": lambda layout: zero_action,
    "stabiliser": Stabiliser,
}

_SHIPPED: Mapping[str, str] = {"shipped": "true", "shipped-randomised": "randomised"}
"""Policies that come with the package, and what they were trained on."""

_FILES = (".npz", ".zip")
"""Endings of files: a zip of Stable-Baselines3 is refused, with what to do, and not taken for a module."""


def load_controller(name: str, env: gym.Env[Any, Any]) -> Controller:
    """Make a controller ready for an episode.

    Args:
        name: As in the table above.
        env: What it will control, with all wrappers; ``state_layout`` is that of its ``unwrapped``.

    Raises:
        ValueError: If there is no such controller, file, module or function, or it is for another robot.
    """
    bare: Any = env.unwrapped
    state_layout = bare.state_layout
    if name in _BUILT_IN:
        return _BUILT_IN[name](state_layout)
    if name in _SHIPPED or name.endswith(_FILES):
        policy = _policy(name, "" if bare.spec is None else bare.spec.id)
        policy.fits(env.observation_space, env.action_space)
        return policy
    function = _imported(name)
    parameters = list(inspect.signature(function).parameters)
    made: Any = function(state_layout) if parameters[:1] == ["state_layout"] else function
    if not callable(made):
        raise ValueError(f"'{name}' returned {type(made).__name__}, which answers no observation.")
    reset = getattr(made, "reset", None)
    if callable(reset):
        reset()
    controller: Controller = made
    return controller


def controller_hash(name: str) -> str:
    """Tell controllers of one name apart: 16 digits of a hash of the file behind it, or nothing.

    Raises:
        ValueError: If there is no such file or module.
    """
    if name in _BUILT_IN:
        return ""
    if name in _SHIPPED:
        folder = files("surefoot.experiments.policy").joinpath("files")
        found = (folder.joinpath(f"{task}-{_SHIPPED[name]}", "policy.npz") for task in TASKS)
        packed = b"".join(file.read_bytes() for file in found if file.is_file())
        return sha256(packed).hexdigest()[:16]
    if name.endswith(_FILES):
        return sha256(_file(name).read_bytes()).hexdigest()[:16]
    path = inspect.getsourcefile(inspect.unwrap(_imported(name)))
    return sha256(Path(path).read_bytes()).hexdigest()[:16] if path and Path(path).is_file() else ""


def trained_on(name: str) -> str:
    """Say what a policy was trained on.

    Args:
        name: Of a controller.

    Returns:
        One of :data:`surefoot.experiments.policy.options.SENSORS`, or nothing where nobody wrote it down or
        the controller was not trained at all.
    """
    if name in _SHIPPED:
        return _SHIPPED[name]
    if not (name.endswith(_FILES) and Path(name).is_file()):
        return ""
    options = PolicyNetwork.load(name).notes.get("options", {})
    return str(options.get("sensors", "")) if isinstance(options, Mapping) else ""


def short_name(name: str) -> str:
    """Name a controller where space is short: a file without its folder."""
    return Path(name).stem if name.endswith(_FILES) else name


def _policy(name: str, env_id: str) -> PolicyNetwork:
    if name not in _SHIPPED:
        return PolicyNetwork.load(_file(name))
    for task in TASKS.values():
        if task.env_id == env_id:
            return shipped_policy(_SHIPPED[name], task.name)
    tasks = ", ".join(repr(task.env_id) for task in TASKS.values())
    raise ValueError(f"No policy for '{env_id}' comes with the package: '{name}' is there for {tasks}.")


def _file(name: str) -> Path:
    path = Path(name)
    if not path.is_file():
        raise ValueError(f"There is no policy file '{name}'; every worker must find it under this path.")
    return path


def _imported(name: str) -> Callable[..., Any]:
    module, colon, attribute = name.partition(":")
    if not (colon and module and attribute):
        raise ValueError(
            f"There is no controller '{name}'. Available: {', '.join(map(repr, (*_BUILT_IN, *_SHIPPED)))}, a "
            "policy file "
            "'path.npz', or 'module:function'."
        )
    try:
        found: Any = import_module(module)
    except ImportError as error:
        raise ValueError(
            f"Controller '{name}': module '{module}' cannot be imported ({error}); it must be on the Python "
            "path of every worker."
        ) from error
    for part in attribute.split("."):
        found = getattr(found, part, None)
    if not callable(found):
        raise ValueError(f"Controller '{name}': module '{module}' has no function '{attribute}'.")
    function: Callable[..., Any] = found
    return function
