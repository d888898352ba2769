"""Which bodies of a robot are its feet, in the pose in which it stands."""

import re
from collections.abc import Sequence
from copy import copy
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.envs.instrumentation.geometry import below, bodies_that_touch, colliding, lowest_points

STANDING: Final = ("home", "stand", "standing")
"""Names of keyframes in which a robot stands; the first that a model has is taken, else its zero pose."""

SAME_HEIGHT: Final = 0.1
"""Two leaves are both feet if their lowest points differ by less than this share of the height of the robot's
centre of mass above them."""

BEARS: Final = 0.015
"""A body above a leaf belongs to the same foot if it reaches as low, to this share of the height of the
centre of mass: 1.4 cm on a person. A shank that ends in a ball around its ankle stays 2 cm off the ground."""

SHORT: Final = 0.5
"""Greatest distance between the bodies of a foot, as a share of the height of the centre of mass. All bodies
of a robot that lies are on the ground."""

SETTLING: Final = 0.15
"""Time in s in which a robot that is put on the ground comes to rest; its load is averaged as long again."""

HELD: Final = 1e4
"""Inertia in kg m^2 that holds a joint meanwhile: a humanoid's weight turns it by less than a milliradian."""

LEAST_SHARE_ON_FEET: Final = 0.95
"""Least share of the weight that guessed feet must carry: what lacks is half of what a toe or heel bears."""

UPRIGHT: Final = 0.5
"""Least height of a standing robot's centre of mass above its feet, as a share of its distance from them."""


def standing_pose(model: mujoco.MjModel) -> mujoco.MjData:
    """Put a robot into its keyframe "home", "stand" or "standing", or else its zero pose, evaluated."""
    data = mujoco.MjData(model)
    keys = {model.key(i).name: i for i in range(model.nkey)}
    for name in STANDING:
        if name in keys:
            mujoco.mj_resetDataKeyframe(model, data, keys[name])
            break
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def find_feet(
    model: mujoco.MjModel, data: mujoco.MjData, names: Sequence[str] | None = None
) -> tuple[int, ...]:
    """Find the numbers of the feet's bodies: those that are named, or the two lowest leaves that can touch.

    A foot is a body and all that hangs on it. From a leaf that can touch it reaches up to the highest body
    that stands on the ground as well: a heel above its toes, or the first of several bodies that are welded
    together. A body without a joint belongs to the body that it is welded to if nothing of that can touch: a
    sole plate is part of its foot. The left one of two comes first, by its name (left, l_, L...) or else by
    its place. ``data`` has the pose in which the robot stands, with its kinematics evaluated.

    TypeError if ``names`` is a single name, or holds something else; ValueError if a body does not exist, is
    named twice or hangs on another foot, the feet hang on different robots, no pair of feet can be found, the
    robot does not stand on them, or feet that were guessed do not bear its weight.
    """
    if names is None:
        return _guess(model, data)
    check_names(names)
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    if not names or len(set(names)) != len(names) or not set(names) <= set(bodies):
        raise ValueError(
            f"'feet' must name bodies of the model, each once, got {list(names)!r}; the model's bodies are "
            f"{bodies}."
        )
    feet = tuple(int(model.body(name).id) for name in names)
    for foot in feet:
        inside = [model.body(other).name for other in feet if other != foot and below(model, foot)[other]]
        if inside:
            raise ValueError(f"The foot {inside[0]!r} hangs on the foot {model.body(foot).name!r}: name one.")
    if len({int(model.body_rootid[foot]) for foot in feet}) > 1:
        raise ValueError(f"The feet {list(names)!r} belong to different robots: instrument one at a time.")
    root = int(model.body_rootid[feet[0]])
    # The origin of the floating body may be anywhere, for instance on the ground between the feet.
    soles = data.xpos[list(feet)].mean(axis=0)
    soles[2] = min(
        soles[2], lowest_points(model, data)[np.any([below(model, foot) for foot in feet], axis=0)].min()
    )
    to_com = data.subtree_com[root] - soles
    if root not in feet and to_com[2] < UPRIGHT * np.linalg.norm(to_com):
        raise ValueError(
            f"The soles of {list(names)!r} cannot be measured, as the robot does not stand on them in its "
            f"{pose_name(model)}: its centre of mass is {to_com[2]:.2f} m above them and "
            f"{np.linalg.norm(to_com[:2]):.2f} m to the side. {_KEYFRAME}"
        )
    return feet


_KEYFRAME: Final = (
    "Soles are measured where it stands: give its description with a keyframe 'home', 'stand' or 'standing', "
    "InstrumentedEnv(env, feet=(left, right), spec=...)."
)


def check_names(names: Sequence[str]) -> None:
    """Raise TypeError if names of feet are not a sequence of strings."""
    if isinstance(names, str):
        raise TypeError(f"'feet' must be a sequence of names of bodies, such as ({names!r},); got a string.")
    if not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise TypeError(f"'feet' must be a sequence of names of bodies, got {names!r}.")


def _guess(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[int, ...]:
    height = lowest_points(model, data)
    feet = _candidates(model, data, height)
    why = "none of them can touch anything (contype, conaffinity and contact pairs)."
    if feet:
        lowest = np.array([height[below(model, body)].min() for body in feet])
        com = data.subtree_com[model.body_rootid[feet[int(np.argmin(lowest))]]][2]
        # A leaf that is the whole robot, such as a ball, is not a foot.
        near = SAME_HEIGHT * max(float(com - lowest.min()), 1e-3)
        low = lowest < lowest.min() + near
        pair = [body for body, is_low in zip(feet, low, strict=True) if is_low and model.body_parentid[body]]
        ordered = _order_left_right(model, data, pair) if len(pair) == 2 else ()
        why = _doubt(model, data, pair, ordered, height, near)
        if not why:
            _check_weight(model, data, ordered, height)
            return ordered
    raise ValueError(
        f"No left and right foot could be found among the model's lowest leaves: {why} "
        f"Leaves that can touch the ground: {_names(model, feet)}; all bodies that can: "
        f"{bodies_that_touch(model)}."
    )


def _candidates(model: mujoco.MjModel, data: mujoco.MjData, height: Floats) -> list[int]:
    """List the bodies that may be feet, each with all that hangs on it.

    ``height`` is the lowest point of each body that can touch in m, inf of others, shape (nbody,).
    """
    touching = np.isfinite(height)
    feet = set()
    for leaf in np.flatnonzero(touching[1:]) + 1:
        root, hanging = int(model.body_rootid[leaf]), below(model, int(leaf))
        # The torso is the floating body with all bodies welded to it, as URDF converters leave them.
        torso = model.body_weldid == model.body_weldid[root]
        # A torso is no foot where nothing else can touch.
        if (touching & hanging).sum() > 1 or (leaf == root and hanging.sum() > 1):
            continue
        tall = max(float(data.subtree_com[root][2] - height[leaf]), 0.0)
        foot = body = int(leaf)
        while not torso[body] and not torso[body := int(model.body_parentid[body])]:
            near = np.linalg.norm(data.xpos[body] - data.xpos[leaf]) < SHORT * tall
            if near and height[body] < height[leaf] + BEARS * tall:
                foot = body
        while not torso[foot] and model.body_jntnum[foot] == 0 and not touching[model.body_parentid[foot]]:
            foot = int(model.body_parentid[foot])
        if foot:
            feet.add(foot)
    return sorted(foot for foot in feet if not any(below(model, other)[foot] for other in feet - {foot}))


def _check_weight(model: mujoco.MjModel, data: mujoco.MjData, feet: tuple[int, ...], height: Floats) -> None:
    """Raise ValueError if a robot that is put on the ground with its joints held does not rest on its feet.

    Nothing is checked where nothing carries it: without a floor, or of a robot that cannot sink.
    """
    root = int(model.body_rootid[feet[0]])
    robot = below(model, root)
    held = copy(model)
    sinks = _vertical_joint(model, data, root)
    place = data.xpos[list(feet)].mean(axis=0)
    place[2] = lowest = float(height[robot].min())
    floor = _floor(model, data, robot, place)
    if sinks is None or floor is None:
        return
    moving = robot[model.dof_bodyid] & (model.dof_bodyid != root)
    held.dof_armature[moving] = HELD
    held.jnt_stiffness[robot[model.jnt_bodyid]] = 0.0
    held.opt.gravity[:] = 0.0, 0.0, -np.linalg.norm(model.opt.gravity)
    held.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    tried = mujoco.MjData(held)
    tried.qpos[:] = data.qpos
    tried.qpos[sinks] -= lowest - floor
    on_feet = np.any([below(model, foot) for foot in feet], axis=0)
    load, wrench, steps = np.zeros(2), np.zeros(6), round(SETTLING / held.opt.timestep)
    for step in range(2 * steps):
        mujoco.mj_step(held, tried)
        for k in range(tried.ncon if step >= steps else 0):
            geoms = tried.contact.geom[k]
            first, second = model.geom_bodyid[geoms] * (geoms >= 0)
            if robot[first] == robot[second]:
                continue
            mujoco.mj_contactForce(held, tried, k, wrench)
            up = (1.0 if robot[second] else -1.0) * float(wrench[:3] @ tried.contact.frame[k][2::3])
            load += up * np.array([1.0, on_feet[first] or on_feet[second]])
    everything, borne = load / steps
    weight = float(model.body_subtreemass[root] * np.linalg.norm(model.opt.gravity))
    if everything > 0.5 * weight and borne < LEAST_SHARE_ON_FEET * everything:
        names = " and ".join(f"'{name}'" for name in _names(model, list(feet)))
        raise ValueError(
            f"{names} look like the feet, but put on the ground in its {pose_name(model)} the robot, which "
            f"weighs {weight:.1f} N, has {borne:.1f} N on them. Name its feet: feet=(left, right)."
        )


def _vertical_joint(model: mujoco.MjModel, data: mujoco.MjData, root: int) -> int | None:
    """Return which number of ``qpos`` moves a robot straight up; None if none does."""
    first = int(model.body_jntadr[root])
    for joint in range(first, first + int(model.body_jntnum[root])):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            return int(model.jnt_qposadr[joint]) + 2
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE and data.xaxis[joint][2] > 0.99:
            return int(model.jnt_qposadr[joint])
    return None


def _floor(
    model: mujoco.MjModel, data: mujoco.MjData, robot: NDArray[np.bool_], place: Floats
) -> float | None:
    """Find the height in m of the highest fixed horizontal plane, or of another thing below a place."""
    fixed = colliding(model) & (model.body_weldid[model.geom_bodyid] == 0) & ~robot[model.geom_bodyid]
    planes = fixed & (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (data.geom_xmat[:, 8] > 0.99)
    if planes.any():
        return float(data.geom_xpos[planes][:, 2].max())
    if not fixed.any():
        return None
    hit, above = np.full(1, -1, dtype=np.int32), place + np.array([0.0, 0.0, 0.5])
    down = mujoco.mj_ray(model, data, above, np.array([0.0, 0.0, -1.0]), None, 1, -1, hit)
    return float(above[2] - down) if hit[0] >= 0 and fixed[hit[0]] else None


def _doubt(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    pair: list[int],
    ordered: tuple[int, ...],
    height: Floats,
    near: float,
) -> str:
    """Return why the lowest leaves are not the two feet of a robot that stands, and the way out."""
    name_them = "If they are its feet, name them: feet=(left, right)."
    if not pair:
        return "they are whole robots, or lie about: a foot hangs on another body."
    if len(pair) == 1:
        foot = _names(model, pair)[0]
        return (
            f"only '{foot}' is at the ground. InstrumentedEnv(env, feet=({foot!r},)) tells what that feels."
        )
    if len(pair) != 2:
        return (
            f"{len(pair)} of them are equally low, and no more than two feet are guessed. Name the robot's "
            "feet: feet=(first, second, ...)."
        )
    names = " and ".join(f"'{name}'" for name in _names(model, pair))
    roots = {int(model.body_rootid[body]) for body in pair}
    if len(roots) > 1:
        return f"{names} belong to different robots. Name two feet of one: feet=(left, right)."
    robot = below(model, roots.pop())
    joints = [_joints_above(model, body) for body in pair]
    if joints[0] != joints[1]:
        return (
            f"{names} are no pair, as the one hangs on {joints[0]} joints and the other on {joints[1]}. "
            f"{name_them}"
        )
    if not ordered:
        return f"{names} do not lie side by side, and their names tell no left and right. {name_them}"
    deepest = min(height[below(model, body)].min() for body in pair)
    lowest = int(np.argmin(np.where(robot, height, np.inf)))
    if height[lowest] < deepest - near:
        other = model.body(lowest).name
        return f"'{other}' is lower than {names}. {name_them}"
    places = data.xpos[robot]
    left, right = data.xpos[list(ordered)]
    across = (left - right)[:2]
    if np.linalg.norm(across) < 0.01:
        across = data.xmat[model.body_rootid[ordered[0]]].reshape(3, 3)[:2, 1]
    forward = np.array([-across[1], across[0]]) / max(float(np.linalg.norm(across)), 1e-9)
    depth, tall = float(np.ptp(places[:, :2] @ forward)), float(np.ptp(places[:, 2]))
    if depth > tall:
        return (
            f"{names} are lowest, but in its {pose_name(model)} the robot lies: it reaches {depth:.2f} m "
            f"along the ground and {tall:.2f} m up. {_KEYFRAME}"
        )
    return ""


def _names(model: mujoco.MjModel, bodies: list[int]) -> list[str]:
    """Return the names of bodies, or their numbers."""
    return [model.body(body).name or f"body {body} without a name" for body in bodies]


def _joints_above(model: mujoco.MjModel, body: int) -> int:
    """Count the joints between a body and the world."""
    count = 0
    while body:
        count, body = count + int(model.body_jntnum[body]), int(model.body_parentid[body])
    return count


def pose_name(model: mujoco.MjModel) -> str:
    """Return how the pose is called in which a robot is measured."""
    named = {model.key(i).name for i in range(model.nkey)}
    return next((f"keyframe '{name}'" for name in STANDING if name in named), "zero pose")


def _order_left_right(model: mujoco.MjModel, data: mujoco.MjData, pair: list[int]) -> tuple[int, ...]:
    """Order a pair as left and right, by names before places; empty if neither decides."""
    names = [model.body(body).name for body in pair]
    sides = [_side(name) for name in names]
    differ = [a + b for a, b in zip(*names, strict=False) if a != b]
    if len(names[0]) == len(names[1]) and len(differ) == 1 and differ[0].lower() in ("lr", "rl"):
        sides = [1, -1] if differ[0][0].lower() == "l" else [-1, 1]
    if set(sides) in ({1, -1}, {1, 0}, {-1, 0}):
        return tuple(pair) if sides[0] > sides[1] else tuple(reversed(pair))
    root = int(model.body_rootid[pair[0]])
    y = [float((data.xpos[body] - data.xpos[root]) @ data.xmat[root].reshape(3, 3)[:, 1]) for body in pair]
    if abs(y[0] - y[1]) < 0.01:
        return ()
    return tuple(pair) if y[0] > y[1] else tuple(reversed(pair))


def _side(name: str) -> int:
    """Return 1 for a left, -1 for a right foot by its name; 0 if it has neither word."""
    for side, word in ((1, "left"), (-1, "right")):
        letter = word[0]
        alone = rf"(^|[^a-z]){letter}([^a-z]|$)"
        capital = rf"^{letter.upper()}[A-Z]"
        if word in name.lower() or re.search(alone, name.lower()) or re.search(capital, name):
            return side
    return 0
