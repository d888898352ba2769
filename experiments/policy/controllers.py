"""Who controls the robot: controllers by name, policies from files, and functions of the user's own.

| Controller | Meaning |
|------------|------------|
| ``"zero"`` | zeros: the open-loop walker, or exercise |
| ``"stabiliser"`` | :class:`surefoot.controllers.Stabiliser` |
| ``"shipped"`` | the policy that comes with the package for the environment's task, trained on true feet |
| ``"shipped-randomised"`` | the one that was trained on randomised sensors |
| ``"path.npz"`` | a policy's weights, which are data and run no code |
| ``"module:function"`` | code of the user's, which is imported and **runs with the user's rights** |

A function either answers an observation itself, or, if its first parameter is called ``state_layout``, is
given the environment's and returns the controller. One with a ``reset`` is reset before every episode.
"""

import inspect
from collections.abc import Callable, Mapping
from hashlib import sha256
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from surefoot.controllers import Stabiliser
from surefoot.controllers.policy import PolicyNetwork
from surefoot.controllers.stabiliser import ACTION_SIZE
from surefoot.experiments.policy.tasks import TASKS, policy_file, shipped_policy, task_in

Controller = Callable[[Mapping[str, Any]], NDArray[np.float32]]  # answers an observation with an action

BUILT_IN = ("zero", "stabiliser")

_SHIPPED: Mapping[str, str] = {"shipped": "true", "shipped-randomised": "randomised"}
"""Policies that come with the package, and what they were trained on."""

_FILES = (".npz", ".zip")  # a zip of Stable-Baselines3 is refused, with what to do


def load_controller(name: str, env: gym.Env[Any, Any], *, same_task: bool = False) -> Controller:
    """Return a controller, named as above, for an environment with all wrappers, or raise ValueError.

    ``same_task`` refuses a policy that says it was made for another environment.
    """
    bare: Any = env.unwrapped
    if name == "zero":
        return lambda observation: np.zeros(env.action_space.shape or (), dtype=np.float32)
    if name == "stabiliser":
        if env.action_space.shape != (ACTION_SIZE,):
            raise ValueError(
                f"The stabiliser moves a NAO's {ACTION_SIZE} leg motors, and actions have shape "
                f"{env.action_space.shape} here; name 'zero', or a controller of your own, 'module:function'."
            )
        return Stabiliser(bare.state_layout)
    if name in _SHIPPED or name.endswith(_FILES):
        policy = _policy(name, _id_of(env))
        check_fits(policy, env, name, same_task=same_task)
        return policy
    function = _import_function(name)
    parameters = list(inspect.signature(function).parameters)
    made: Any = function(bare.state_layout) if parameters[:1] == ["state_layout"] else function
    if not callable(made):
        raise ValueError(f"'{name}' returned {type(made).__name__}, which answers no observation.")
    controller: Controller = made
    return controller


def check_fits(policy: Any, env: gym.Env[Any, Any], name: str = "", *, same_task: bool = True) -> None:
    """Raise ValueError if a policy was made for another robot or, if that counts, for another task.

    Its notes decide, as observations of two tasks may have the same sizes; without any nothing is refused.
    """
    notes = getattr(policy, "notes", None)
    made_for = notes.get("task") if isinstance(notes, Mapping) else None
    given = _id_of(env)
    task, here = task_in(made_for), task_in(given)
    let_in = made_for == given or (task is not None and here is not None and here.easier == task.name)
    if same_task and isinstance(made_for, str) and given and not let_in:
        way_out = "" if task is None else "; evaluate it there"
        who = f"Policy '{name}'" if name else "The policy"
        raise ValueError(f"{who} was made for '{made_for}', and this is '{given}'{way_out}.")
    if hasattr(policy, "fits"):
        policy.fits(env.observation_space, env.action_space)


def controller_hash(name: str, env_id: str = "") -> str:
    """Return 16 digits of a hash of the file behind a controller, or nothing; ValueError if not there.

    Of shipped policies the environment says which one is meant; without one, the hash is that of all of them.
    """
    if name in BUILT_IN:
        return ""
    if name in _SHIPPED:
        tasks = [task.name for task in TASKS.values() if env_id in ("", task.env_id)]
        found = [policy_file(task, _SHIPPED[name]) for task in tasks]
        content = b"".join(file.read_bytes() for file in found if file.is_file())
    elif name.endswith(_FILES):
        content = _file(name).read_bytes()
    else:
        path = Path(inspect.getsourcefile(inspect.unwrap(_import_function(name))) or "")
        if not path.is_file():
            return ""
        content = path.read_bytes()
    return sha256(content).hexdigest()[:16]


def short_name(name: str) -> str:
    """Return the name of a controller where space is short: a file's without its folder."""
    return Path(name).stem if name.endswith(_FILES) else name


def _id_of(env: gym.Env[Any, Any]) -> str:
    spec = env.unwrapped.spec
    return "" if spec is None else spec.id


def _policy(name: str, env_id: str) -> PolicyNetwork:
    if name not in _SHIPPED:
        return PolicyNetwork.load(_file(name))
    task = task_in(env_id)
    if task is None:
        tasks = ", ".join(repr(known.env_id) for known in TASKS.values())
        raise ValueError(f"No policy for '{env_id}' comes with the package: '{name}' is there for {tasks}.")
    return shipped_policy(_SHIPPED[name], task.name)


def _file(name: str) -> Path:
    path = Path(name)
    if not path.is_file():
        raise ValueError(f"There is no policy file '{name}'; give its path.")
    return path


def _import_function(name: str) -> Callable[..., Any]:
    module, _, function = name.partition(":")
    if not (module and function):
        available = ", ".join(map(repr, (*BUILT_IN, *_SHIPPED)))
        raise ValueError(
            f"There is no controller '{name}'. Available: {available}, a policy file 'path.npz', or "
            "'module:function'."
        )
    try:
        found = resolve_name(name)
    except (ImportError, AttributeError) as error:
        raise ValueError(
            f"Controller '{name}' cannot be imported ({error}); its module must be on the Python path; "
            "PYTHONPATH=. before the command adds this folder."
        ) from error
    if not callable(found):
        raise ValueError(f"Controller '{name}' is {type(found).__name__}, and no function.")
    imported: Callable[..., Any] = found
    return imported
