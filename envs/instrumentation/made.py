"""Instrumented models for environments: made once, and copied for all environments alike.

To compile a humanoid's meshes takes seconds, and they take most of its memory. Environments that are not
drawn get boxes in the place of meshes that are only seen; each has a copy of its own, whose numbers it may
change.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Final, TypeVar

import mujoco
import numpy as np

from surefoot.envs.instrumentation.feet import find_feet, standing_pose
from surefoot.envs.instrumentation.geometry import FootGeometry, below, colliding, measure_foot
from surefoot.envs.instrumentation.robot import joint_name
from surefoot.envs.instrumentation.spec import Instrumentation, instrument_as
from surefoot.envs.instrumentation.swap import carry_over, differing_array, find_difference, fingerprint

SOLE_LENGTH: Final = 0.2
"""Length of a sole as a share of the torso's height above it: a person's foot under a person's chest."""

SOLE_WIDTH: Final = 0.4  # width of a sole as a share of its length
SOLE_THICKNESS: Final = 0.01  # thickness of a sole in m
HEEL: Final = 0.3  # share of a sole's length behind the ankle


def put_soles(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    soles: bool | Mapping[str, Sequence[float]],
    feet: Sequence[str] | None,
    prefix: str,
) -> None:
    """Put boxes without mass under feet that have no area, or under those that are named.

    The box hangs right below the lowest point of the foot, touches as the foot's first geom does in the same
    way, and makes the robot taller by its thickness. The specification is changed; the model is the same,
    compiled. Sizes are (length, width, thickness) in m by the foot's body. ValueError if a body is no foot, a
    size is not positive, or the foot touches in pairs of geoms only.
    """
    data = standing_pose(model)
    measured = [measure_foot(model, data, body) for body in find_feet(model, data, feet)]
    if isinstance(soles, Mapping):
        names = [foot.body for foot in measured]
        unknown = sorted(set(soles) - set(names))
        if unknown:
            raise ValueError(f"'soles' names {unknown}, which are no feet here; the feet are {names}.")
    for foot in measured:
        if isinstance(soles, Mapping):
            size = soles.get(foot.body)
        else:
            size = _default(model, data, foot) if foot.flaw else None
        if size is not None:
            _put(spec, model, foot, size, prefix)


def _default(model: mujoco.MjModel, data: mujoco.MjData, foot: FootGeometry) -> tuple[float, float, float]:
    """Choose length, width and thickness in m by the robot's size."""
    body = model.body(foot.body).id
    sole = data.xpos[body] + data.xmat[body].reshape(3, 3) @ foot.position_sole_foot
    length = SOLE_LENGTH * float(data.xpos[model.body_rootid[body]][2] - sole[2])
    return length, SOLE_WIDTH * length, SOLE_THICKNESS


def _put(
    spec: mujoco.MjSpec, model: mujoco.MjModel, foot: FootGeometry, size: Sequence[float], prefix: str
) -> None:
    box = np.asarray(size, dtype=np.float64)
    if box.shape != (3,) or not np.isfinite(box).all() or not (box > 0.0).all():
        raise ValueError(
            f"The sole of '{foot.body}' needs a positive (length, width, thickness) in m, got {list(size)!r}."
        )
    geoms = np.flatnonzero(colliding(model) & below(model, model.body(foot.body).id)[model.geom_bodyid])
    like = int(geoms[0])
    if not (model.geom_contype[like] or model.geom_conaffinity[like]):
        raise ValueError(
            f"The foot '{foot.body}' touches in pairs of geoms only, in which a new sole would have no part; "
            "add the sole and its pairs to the robot's description."
        )
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, foot.R_foot_sole.ravel())
    centre = np.array([(0.5 - HEEL) * box[0], 0.0, -box[2] / 2.0])
    spec.body(foot.body).add_geom(
        name=f"{prefix}{foot.body}_sole",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=box / 2.0,
        pos=foot.position_sole_foot + foot.R_foot_sole @ centre,
        quat=quaternion,
        mass=0.0,
        contype=int(model.geom_contype[like]),
        conaffinity=int(model.geom_conaffinity[like]),
        condim=int(model.geom_condim[like]),
        priority=int(model.geom_priority[like]),
        friction=model.geom_friction[like],
        solref=model.geom_solref[like],
        solimp=model.geom_solimp[like],
        solmix=float(model.geom_solmix[like]),
        margin=float(model.geom_margin[like]),
        gap=float(model.geom_gap[like]),
    )


THINNEST = 1e-4  # what a box reaches beyond its mesh in m, as a flat one has no volume


def box_meshes(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Replace meshes that are only seen by boxes around them, and leave their mass to their bodies.

    Geoms, bodies and meshes keep their numbers and names. A mesh that something may collide with stays, and
    so does one whose shape, or whose flex or skin, is needed for anything else. The specification is changed;
    the model is the same, compiled with its meshes.
    """
    mesh_geoms = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    can_touch = colliding(model)
    needed = set(model.geom_dataid[mesh_geoms[can_touch[mesh_geoms]]].tolist())
    seen = set(model.geom_dataid[mesh_geoms].tolist()) - needed
    by_name = {model.mesh(i).name: i for i in seen}
    # A primitive is fitted to the mesh that its geom names.
    fitted = {
        geom.meshname for geom in spec.geoms if geom.meshname and geom.type != mujoco.mjtGeom.mjGEOM_MESH
    }
    boxed = set()
    for mesh in spec.meshes:
        number = by_name.get(mesh.name)
        if number is None or mesh.name in fitted:
            continue
        boxed.add(number)
        first = int(model.mesh_vertadr[number])
        vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[number])]
        low, high = vertices.min(axis=0) - THINNEST, vertices.max(axis=0) + THINNEST
        corners = np.array(list(product(*zip(low, high, strict=True))))
        mesh.file, mesh.uservert, mesh.userface = "", corners.ravel(), []
        mesh.usernormal, mesh.usertexcoord, mesh.userfacenormal, mesh.userfacetexcoord = [], [], [], []
        mesh.scale, mesh.refpos, mesh.refquat = np.ones(3), np.zeros(3), (1.0, 0.0, 0.0, 0.0)
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    heavy = {int(model.geom_bodyid[geom]) for geom in mesh_geoms if int(model.geom_dataid[geom]) in boxed}
    for number, body in enumerate(spec.bodies):
        if number in heavy - {0}:
            body.explicitinertial = True
            body.mass, body.inertia = float(model.body_mass[number]), model.body_inertia[number]
            body.ipos, body.iquat = model.body_ipos[number], model.body_iquat[number]
            body.fullinertia = np.full(6, np.nan)


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
