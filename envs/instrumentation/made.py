"""Instrumented models for environments: made once, and copied for all environments alike.

To compile a humanoid's meshes takes seconds, and they take most of its memory. Environments that are not
drawn get boxes in the place of meshes that are only seen; each has a copy of its own, whose numbers it may
change.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import mujoco
import numpy as np

from surefoot.envs.instrumentation.meshes import box_meshes
from surefoot.envs.instrumentation.robot import joint_name
from surefoot.envs.instrumentation.soles import put_soles
from surefoot.envs.instrumentation.spec import Instrumentation, instrument_as
from surefoot.envs.instrumentation.swap import carry_over, differing_array, find_difference, fingerprint

Value = TypeVar("Value")

MOST_KEPT: Final = 4  # robots that are kept for more environments of the same kind


@dataclass(frozen=True, eq=False)
class Made:
    """A robot for environments that have the same description and the same numbers."""

    different: str = ""  # why the description is of another robot; empty if it is not
    model: mujoco.MjModel | None = None  # the instrumented robot
    instrumentation: Instrumentation | None = None  # the added sensors
    boxed: mujoco.MjModel | None = None
    """The bare robot with boxes for meshes, if it has any that are only seen."""


_KEPT: dict[tuple[Any, ...], Made] = {}


def make(
    description: Path | mujoco.MjSpec,
    bare: mujoco.MjModel,
    feet: Sequence[str] | None,
    *,
    soles: bool | Mapping[str, Sequence[float]],
    boxes: bool,
    **given: Any,
) -> Made:
    """Make the instrumented robot with the numbers of a bare model, or take that of another like it.

    Of a specification nothing is kept. ``feet`` and ``soles`` are those of
    :class:`~surefoot.envs.InstrumentedEnv`; with ``boxes`` meshes that are only seen become boxes; the others
    are those of :func:`~surefoot.envs.instrumentation.spec.instrument_as`.
    """
    if isinstance(description, mujoco.MjSpec):
        return _make(description.copy(), bare, feet, soles, boxes, given)
    cells = {body: np.asarray(places).tolist() for body, places in (given["cells"] or {}).items()}
    options = repr((feet, soles, boxes, {**given, "cells": cells}))
    key = (str(description.resolve()), description.stat().st_mtime_ns, options, fingerprint(bare))
    file = str(description)
    return keep(_KEPT, key, lambda: _make(mujoco.MjSpec.from_file(file), bare, feet, soles, boxes, given))


def keep(store: dict[tuple[Any, ...], Value], key: tuple[Any, ...], make: Callable[[], Value]) -> Value:
    """Make what a key stands for, if it is not stored, in the place of the oldest of :data:`MOST_KEPT`."""
    if key not in store:
        value = make()
        while len(store) >= MOST_KEPT:
            del store[next(iter(store))]
        store[key] = value
    return store[key]


def _make(
    description: mujoco.MjSpec,
    bare: mujoco.MjModel,
    feet: Sequence[str] | None,
    soles: bool | Mapping[str, Sequence[float]],
    boxes: bool,
    given: dict[str, Any],
) -> Made:
    prefix = given["prefix"]
    boxes = boxes and bare.nmesh > 0
    if boxes:
        boxed = description.copy()
        box_meshes(boxed, bare)
        measured = boxed.compile()
        alike = not find_difference(bare, measured, prefix)
        if alike:
            carry_over(bare, measured, prefix)
        boxes = alike and not differing_array(bare, measured)
        description = boxed if boxes else description
    if soles:
        # The description may have a keyframe to stand in that the environment's file lacks.
        standing = description.copy().compile()
        if not find_difference(bare, standing, prefix):
            carry_over(bare, standing, prefix)
        put_soles(description, standing, soles, feet, prefix)
    named = description.copy()
    measured = named.compile()
    for joint, compiled in zip(description.joints, named.joints, strict=True):
        joint.name = joint_name(measured, compiled.id)
    different = find_difference(bare, measured, prefix)
    if different:
        return Made(different=different)
    carry_over(bare, measured, prefix)
    made = instrument_as(description, measured, feet, **given)
    model = made.spec.compile()
    carry_over(bare, model, prefix)
    return Made(model=model, instrumentation=made, boxed=measured if boxes else None)
