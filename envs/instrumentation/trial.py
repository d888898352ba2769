"""Trials on copies of an environment: how long a step takes, and whether it would notice added sensors."""

import random
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import copy, deepcopy
from typing import Any, Final

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium.wrappers import HumanRendering, RecordVideo, RenderCollection

from surefoot.envs.instrumentation.swap import put_in, sensors_off, swap_in

STEPS: Final = 10  # control steps with random actions that a copy takes
SEED: Final = 0  # of the copies' episode and of the actions

_PICTURES: Final = (HumanRendering, RecordVideo, RenderCollection)
"""Wrappers that draw or write and change nothing that an agent sees: copies go without them."""

Shown = list[tuple[Any, ...]]
"""What an episode shows: observation and info of the reset, then what each step returns."""


def measure_duration(env: gym.Env[Any, Any]) -> float:
    """Return the simulated time in s that a step of a copy takes; 0 if the copy cannot be stepped."""
    try:
        with _own_randomness():
            tried = _copy(env)
            tried.reset(seed=SEED)
            tried.action_space.seed(SEED)
            start = float(tried.unwrapped.data.time)
            tried.step(tried.action_space.sample())
            return float(tried.unwrapped.data.time) - start
    except Exception:
        # A user's environment may raise anything on its copy.
        return 0.0


def find_notice(env: gym.Env[Any, Any], model: mujoco.MjModel) -> str:
    """Return how an environment would notice another model in the place of its own; empty if it would not.

    Two copies with all wrappers take the same steps, one of them with the new model. Observations, rewards,
    ends and numbers in ``info`` must be equal to the last bit. Neither the environment nor the global random
    states of Python and NumPy change. Attributes that cannot be copied, such as a network's session, are
    shared.
    """
    try:
        with _own_randomness():
            shown = _play(env, None)
            different = _difference(shown, _play(env, model))
            if different and _difference(shown, _play(env, None)):
                return "it is not the same twice, so that nobody can tell whether it would notice"
    except Exception as error:
        # A user's environment may raise anything on its copy. Its model is then left alone.
        return f"a copy of it could not be stepped ({type(error).__name__}: {error})"
    return f"with sensors in its model its {different}" if different else ""


@contextmanager
def _own_randomness() -> Iterator[None]:
    """Restore the global random states of Python and NumPy afterwards."""
    state, python_state = np.random.get_state(), random.getstate()  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(state)  # noqa: NPY002
        random.setstate(python_state)


def _play(env: gym.Env[Any, Any], model: mujoco.MjModel | None) -> Shown:
    """Step a copy of an environment, with another model or its own."""
    tried = _copy(env)
    own = tried.unwrapped.model.nsensor
    if model is not None:
        swap_in(tried.unwrapped, copy(model))
    tried.action_space.seed(SEED)
    with sensors_off(tried.unwrapped.model, own):
        shown: Shown = [deepcopy(tried.reset(seed=SEED))]
    for _ in range(STEPS):
        shown.append(deepcopy(tried.step(tried.action_space.sample())))
        if shown[-1][2] or shown[-1][3]:
            break
    return shown


def _copy(env: gym.Env[Any, Any]) -> Any:
    """Copy an environment and its wrappers; parts that cannot be copied are shared."""
    base: Any = env.unwrapped
    model = copy(base.model)
    data = mujoco.MjData(model)
    mujoco.mj_copyData(data, model, base.data)
    # Keys are the originals' numbers: references to them become references to the copies.
    memo: dict[int, Any] = {id(base.model): model, id(base.data): data}
    below: Any = env
    layers = []
    while below is not base:
        layers.append(below)
        below = below.env
    own = memo[id(base)] = object.__new__(type(base))
    _copy_attributes(base, own, memo)
    put_in(own, model, data)
    for layer in reversed(layers):
        if not isinstance(layer, _PICTURES):
            above = memo[id(layer)] = object.__new__(type(layer))
            above.env = own
            _copy_attributes(layer, above, memo)
            own = above
        memo[id(layer)] = own
    return own


def _copy_attributes(original: Any, new: Any, memo: dict[int, Any]) -> None:
    for name, value in vars(original).items():
        if name == "render_mode":
            new.__dict__[name] = None
        elif name not in vars(new):
            try:
                new.__dict__[name] = deepcopy(value, memo)
            except Exception:
                new.__dict__[name] = value


def _difference(one: Shown, other: Shown) -> str:
    """Return the first thing in which two episodes differ; empty if they do not."""
    parts = "observation", "reward", "end", "end", "info"
    for mine, theirs in zip(one, other, strict=False):
        names = ("observation", "info") if len(mine) == 2 else parts
        for name, a, b in zip(names, mine, theirs, strict=True):
            if not _same(a, b):
                return f"{name} differs"
    return "" if len(one) == len(other) else "end differs"


def _same(one: Any, other: Any) -> bool:
    """Return whether two parts hold the same numbers; objects that are no numbers count as the same."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_same(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, np.ndarray | np.generic | float | int):
        a, b = np.asarray(one), np.asarray(other)
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")
    return not isinstance(one, str) or one == other
