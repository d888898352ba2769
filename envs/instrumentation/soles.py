"""Flat soles for feet that touch the ground at one point or along one line."""

from collections.abc import Mapping, Sequence
from typing import Final

import mujoco
import numpy as np

from surefoot.envs.instrumentation.feet import find_feet, standing_pose
from surefoot.envs.instrumentation.geometry import FootGeometry, below, colliding, measure_foot

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
