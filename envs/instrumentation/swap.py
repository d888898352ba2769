"""How an instrumented model takes the place of the one that an environment made."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path
from types import FrameType, FunctionType, ModuleType, TracebackType
from typing import Any, Final

import gymnasium as gym
import mujoco
import numpy as np
from numpy.typing import NDArray

_STRUCTURE: Final = (
    "body_parentid",
    "body_jntnum",
    "body_mocapid",
    "jnt_type",
    "jnt_bodyid",
    "jnt_qposadr",
    "geom_type",
    "geom_bodyid",
    "site_bodyid",
    "actuator_trntype",
    "eq_type",
    "tendon_num",
)
"""Integer arrays that are equal in two models of the same robot."""

_FLAGS: Final = (
    "body_contype",
    "body_conaffinity",
    "geom_contype",
    "geom_conaffinity",
    "geom_condim",
    "geom_priority",
    "geom_group",
    "geom_matid",
    "geom_sameframe",
    "site_group",
    "jnt_limited",
    "jnt_actfrclimited",
    "actuator_ctrllimited",
    "actuator_forcelimited",
    "actuator_actlimited",
    "actuator_dyntype",
    "actuator_gaintype",
    "actuator_biastype",
    "tendon_limited",
    "eq_active0",
)
"""Integer arrays that an environment may change in its compiled model; float arrays are all carried over."""

_DERIVED: Final = ("sensor_", "bvh_", "oct_", "key_", "mesh_", "skin_", "tex_", "flex")
"""Prefixes of arrays that differ between the models, or that environments do not change."""

_DRAWN: Final = ("mesh_", "bvh_", "oct_", "tex_", "skin_")
"""Prefixes of arrays that only drawing and collisions with meshes need."""

_NAMED: Final = {
    "bodies": (mujoco.mjtObj.mjOBJ_BODY, "nbody"),
    "joints": (mujoco.mjtObj.mjOBJ_JOINT, "njnt"),
    "actuators": (mujoco.mjtObj.mjOBJ_ACTUATOR, "nu"),
}

_VIEWS: Final = ("MjOption", "MjVisual", "MjStatistic", "_MjContactList", "MjContact")
"""MuJoCo's types that point into a model or its data, besides those whose name ends in Views."""

_CLOSED: Final = (type, ModuleType, FrameType, TracebackType, gym.Space, str, bytes, int, float)
"""Types of objects that are not searched for references: they have none, or lead to the whole program."""

_MOST_OBJECTS: Final = 20_000
"""Most objects of an environment that are searched, in about 0.1 s; Humanoid-v5 has a dozen."""


def find_description(spec: str | Path | mujoco.MjSpec | None, env: Any) -> Path | mujoco.MjSpec | None:
    """Return the description of an innermost environment's robot: the one given, or its file, or None."""
    if isinstance(spec, mujoco.MjSpec):
        return spec
    path = spec if spec is not None else getattr(env, "fullpath", None)
    if spec is None and (not isinstance(path, str | Path) or not Path(path).is_file()):
        return None
    return Path(str(path))


def find_difference(old: mujoco.MjModel, new: mujoco.MjModel, prefix: str) -> str:
    """Describe how two models differ in structure, apart from the added parts; empty if they do not."""
    for name, (kind, number) in _NAMED.items():
        ours, theirs = (
            [mujoco.mj_id2name(m, kind, i) for i in range(getattr(m, number))] for m in (old, new)
        )
        # Added descriptions name what had no name.
        if len(ours) != len(theirs) or any(a not in (None, b) for a, b in zip(ours, theirs, strict=True)):
            return f"its {name} are {theirs}, the environment's {ours}"
    kept = original_ids(new, prefix)
    for name in _STRUCTURE:
        own, other = getattr(old, name), _rows(new, name, kept)
        if not np.array_equal(own, other):
            return f"its {name} is {other.tolist()}, the environment's {own.tolist()}"
    if (old.nq, old.nv, old.na) != (new.nq, new.nv, new.na):
        return "it has other sizes (nq, nv, na)"
    return ""


def carry_over(old: mujoco.MjModel, new: mujoco.MjModel, prefix: str) -> None:
    """Copy all numbers of an environment's model to another: options, masses, frictions and its changes.

    The other is the same robot, to which sites, sensors and geoms with names of ``prefix`` may have been
    added.
    """
    kept = original_ids(new, prefix)
    for name, value in changeable_arrays(old):
        put_array(new, name, value, kept)
    for key in range(min(old.nkey, new.nkey)):
        # A description may add a keyframe in which the robot stands.
        if old.key(key).name == new.key(key).name:
            for name in ("key_qpos", "key_qvel", "key_ctrl"):
                getattr(new, name)[key] = getattr(old, name)[key]
    for ours, theirs in zip(options(old), options(new), strict=True):
        for name, value in public(ours):
            if isinstance(value, np.ndarray):
                getattr(theirs, name)[...] = value
            elif isinstance(value, int | float):
                setattr(theirs, name, value)


def changeable_arrays(model: mujoco.MjModel) -> Iterator[tuple[str, NDArray[Any]]]:
    """List the arrays of a model that an environment may change, by their names."""
    for name, value in public(model):
        if (
            isinstance(value, np.ndarray)
            and not name.startswith(_DERIVED)
            and (value.dtype.kind == "f" or name in _FLAGS)
        ):
            yield name, value


def put_array(new: mujoco.MjModel, name: str, value: NDArray[Any], kept: dict[str, NDArray[np.intp]]) -> None:
    """Copy an array of a robot to the same robot with added parts, where ``kept`` are the original ones."""
    target = getattr(new, name)
    rows = kept.get(name.split("_")[0])
    if rows is not None and len(value) == len(rows):
        target[rows] = value
    elif target.shape == value.shape:
        target[...] = value


def differing_array(old: mujoco.MjModel, new: mujoco.MjModel) -> str:
    """Return the name of an array in which a robot differs from itself with boxes for meshes, or nothing.

    All numbers were carried over before.
    """
    for name, value in public(old):
        if isinstance(value, np.ndarray) and not name.startswith(_DRAWN):
            other = getattr(new, name)
            if not np.array_equal(value, other, equal_nan=value.dtype.kind == "f"):
                return name
    # Sensors of distances meet what is seen.
    rays = (mujoco.mjtSensor.mjSENS_RANGEFINDER, mujoco.mjtSensor.mjSENS_GEOMDIST)
    return "sensor_type" if np.isin(old.sensor_type, rays).any() else ""


def fingerprint(model: mujoco.MjModel) -> bytes:
    """Return a digest of a model."""
    buffer = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return blake2b(buffer.data).digest()


def find_holder(env: gym.Env[Any, Any]) -> str:
    """Return an attribute, besides the usual ones, that refers to the model or its data; empty if none."""
    base: Any = env.unwrapped
    old = (base.model, base.data)
    below: Any = env
    layers = [below]
    while below is not base:
        below = below.env
        layers.append(below)
    usual = {"model", "data", "mujoco_renderer"}
    seen = {id(layer) for layer in layers} | {id(getattr(base, name, None)) for name in usual}
    for layer in layers:
        for name, value in vars(layer).items():
            if not (layer is base and name in usual) and _reaches(value, old, seen):
                return f"{type(layer).__name__}.{name}"
    return ""


def swap_in(env: Any, new: mujoco.MjModel) -> None:
    """Replace the model of an innermost environment, which continues from its present state."""
    old, before = env.model, env.data
    data = mujoco.MjData(new)
    # Added sensors have a history behind that of the environment's own sensors and motors.
    kind = mujoco.mjtState.mjSTATE_INTEGRATION.value & ~mujoco.mjtState.mjSTATE_HISTORY.value
    state = np.empty(mujoco.mj_stateSize(old, kind))
    mujoco.mj_getState(old, before, state, kind)
    mujoco.mj_setState(new, data, state, kind)
    data.history[: before.history.size] = before.history
    # What was derived from the state goes along: some environments look at it before they step.
    for name, value in public(before):
        if isinstance(value, np.ndarray) and value.size:
            target = getattr(data, name)
            if target.shape == value.shape:
                target[...] = value
    put_in(env, new, data)


@contextmanager
def sensors_off(model: mujoco.MjModel, first: int) -> Iterator[None]:
    """Disable the sensors from number ``first``: some make MuJoCo compute forces that are zero otherwise."""
    stages = model.sensor_needstage[first:]
    on = stages.copy()
    stages[:] = 0
    try:
        yield
    finally:
        stages[:] = on


def put_in(env: Any, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Let the innermost environment simulate and show another model and its data."""
    env.model, env.data = model, data
    renderer = getattr(env, "mujoco_renderer", None)
    if renderer is not None:
        for holder in (renderer, *getattr(renderer, "_viewers", {}).values()):
            holder.model, holder.data = model, data


def original_ids(model: mujoco.MjModel, prefix: str) -> dict[str, NDArray[np.intp]]:
    """Number the geoms and sites that were not added."""
    kinds = {"geom": (mujoco.mjtObj.mjOBJ_GEOM, model.ngeom), "site": (mujoco.mjtObj.mjOBJ_SITE, model.nsite)}
    return {
        name: np.array(
            [i for i in range(n) if not (mujoco.mj_id2name(model, kind, i) or "").startswith(prefix)],
            dtype=np.intp,
        )
        for name, (kind, n) in kinds.items()
    }


def _rows(model: mujoco.MjModel, name: str, kept: dict[str, NDArray[np.intp]]) -> NDArray[Any]:
    value: NDArray[Any] = getattr(model, name)
    rows = kept.get(name.split("_")[0])
    return value if rows is None else value[rows]


def public(part: Any) -> Iterator[tuple[str, Any]]:
    """List the fields of a structure of MuJoCo, by their names."""
    for name in dir(part):
        if name[0] != "_":
            yield name, getattr(part, name)


def options(model: mujoco.MjModel) -> list[Any]:
    """List the structures of a model that hold single numbers."""
    parts = ("global_", "quality", "headlight", "map", "scale", "rgba")
    return [model.opt, model.stat, *(getattr(model.vis, part) for part in parts)]


def _reaches(value: Any, old: tuple[Any, Any], seen: set[int]) -> bool:
    """Return whether an object is, or leads to, a model or its data, or a view of them."""
    found = [value]
    while found and len(seen) < _MOST_OBJECTS:
        value = found.pop()
        if any(value is part for part in old):
            return True
        kind = type(value).__name__
        if isinstance(value, np.ndarray):
            if _is_view(value, old):
                return True
        elif type(value).__module__.startswith("mujoco"):
            if kind.endswith("Views") or kind in _VIEWS:
                return True
        elif id(value) not in seen and not isinstance(value, _CLOSED):
            seen.add(id(value))
            found += _parts(value)
    return False


def _is_view(array: NDArray[Any], old: tuple[Any, Any]) -> bool:
    """Return whether an array shares the memory of a model or its data."""
    root: Any = array
    while isinstance(root, np.ndarray) and root.base is not None:
        root = root.base
    # Only arrays of MuJoCo and of other libraries in C have such a base.
    return type(root).__name__ == "PyCapsule" and any(
        np.may_share_memory(array, part)
        for holder in old
        for _, part in public(holder)
        if isinstance(part, np.ndarray)
    )


def _parts(value: Any) -> list[Any]:
    """List the objects that an object refers to; of a function those in its closure and its defaults."""
    if isinstance(value, FunctionType):
        return [value.__closure__, value.__defaults__, value.__kwdefaults__]
    return gc.get_referents(value)
