"""Which bodies of a robot are its feet, in the pose in which it stands."""

import re
from collections.abc import Sequence
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.envs.instrumentation.geometry import below, bodies_that_touch, colliding

STANDING: Final = ("home", "stand", "standing")
"""Names of keyframes in which a robot stands; the first that a model has is taken, else its zero pose."""

SAME_HEIGHT: Final = 0.1
"""Two leaves are both feet if their lowest points differ by less than this share of the torso's height."""

UPRIGHT: Final = 0.5
"""Least height of the torso above the feet as a share of its distance from them, of a robot that stands."""


def standing_pose(model: mujoco.MjModel) -> mujoco.MjData:
    """Put a robot into its keyframe "home", "stand" or "standing", or else into its zero pose.

    Returns:
        Fresh data, of which the kinematics were evaluated.
    """
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
    """Find the bodies of the feet: those that are named, or the two lowest leaves that can touch the ground.

    A leaf without a joint belongs to the body that it is welded to if nothing of that body can touch: a sole
    plate is part of its foot. The left one of two comes first, by its name (left, l_, L...) or else by its
    place.

    Args:
        model: The robot.
        data: The pose in which it stands, of which the kinematics were evaluated.
        names: The feet's bodies in the order in which they are to be read; None to guess.

    Returns:
        Their numbers.

    Raises:
        TypeError: If ``names`` is a single name.
        ValueError: If a body does not exist, is named twice or hangs on another foot, the feet hang on
            different robots, no pair of feet can be found, or the robot does not stand on them.
    """
    if names is None:
        return _guess(model, data)
    if isinstance(names, str):
        raise TypeError(f"'feet' must be a sequence of names of bodies, such as ({names!r},); got a string.")
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
    to_torso = data.xpos[root] - data.xpos[list(feet)].mean(axis=0)
    if root not in feet and to_torso[2] < UPRIGHT * np.linalg.norm(to_torso):
        raise ValueError(
            f"The soles of {list(names)!r} cannot be measured, as the robot does not stand on them in its "
            f"{pose_name(model)}: '{model.body(root).name}' is {to_torso[2]:.2f} m above them and "
            f"{np.linalg.norm(to_torso[:2]):.2f} m beside. {_KEYFRAME}"
        )
    return feet


_KEYFRAME: Final = (
    "Soles are measured where it stands: give its description with a keyframe 'home', 'stand' or 'standing', "
    "InstrumentedEnv(env, feet=(left, right), spec=...)."
)


def _guess(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[int, ...]:
    can_touch = colliding(model)
    leaves = _leaves(model, can_touch)
    why = "none of them can touch anything (contype, conaffinity and contact pairs)."
    if leaves:
        height = np.array([_lowest(model, data, body, can_touch) for body in leaves])
        torso = data.xpos[model.body_rootid[leaves[int(np.argmin(height))]]][2]
        # A leaf that is the whole robot, such as a ball, is no foot.
        near = SAME_HEIGHT * max(float(torso - height.min()), 1e-3)
        low = height < height.min() + near
        pair = [
            body for body, is_low in zip(leaves, low, strict=True) if is_low and model.body_parentid[body]
        ]
        ordered = _left_first(model, data, pair) if len(pair) == 2 else ()
        why = _doubt(model, data, pair, ordered, can_touch, near)
        if not why:
            return ordered
    raise ValueError(
        f"No left and right foot could be found among the model's lowest leaves: {why} "
        f"Leaves that can touch the ground: {_names(model, leaves)}; all bodies that can: "
        f"{bodies_that_touch(model)}."
    )


def _leaves(model: mujoco.MjModel, can_touch: NDArray[np.bool_]) -> list[int]:
    """List the leaves that can touch, each as the body to which it is welded if that cannot."""
    touching = np.bincount(model.geom_bodyid[can_touch], minlength=model.nbody) > 0
    parents = set(model.body_parentid[1:].tolist())
    leaves = []
    for leaf in range(1, model.nbody):
        if leaf not in parents and touching[leaf]:
            foot = leaf
            while model.body_jntnum[foot] == 0 and not touching[model.body_parentid[foot]]:
                foot = int(model.body_parentid[foot])
                if foot == 0:
                    break
            if foot:
                leaves.append(foot)
    return sorted(set(leaves))


def _doubt(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    pair: list[int],
    ordered: tuple[int, ...],
    can_touch: NDArray[np.bool_],
    near: float,
) -> str:
    """Return why the lowest leaves are not the two feet of a robot that stands, and what to do."""
    name_them = "If they are its feet, name them: feet=(left, right)."
    if not pair:
        return "they are whole robots, or lie about: a foot hangs on another body."
    if len(pair) == 1:
        foot = _names(model, pair)[0]
        return (
            f"only '{foot}' is at the ground. InstrumentedEnv(env, feet=({foot!r},)) tells what that feels; "
            "calibrators are for robots on two feet."
        )
    if len(pair) != 2:
        return (
            f"{len(pair)} of them are equally low, and calibrators are for robots on two feet. If two of "
            "them are feet, name these: feet=(left, right)."
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
    deepest = min(_lowest(model, data, body, can_touch) for body in pair)
    geoms = np.flatnonzero(can_touch & robot[model.geom_bodyid])
    lowest = geoms[np.argmin(data.geom_xpos[geoms][:, 2])]
    if data.geom_xpos[lowest][2] < deepest - near:
        other = model.body(int(model.geom_bodyid[lowest])).name
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


def _lowest(model: mujoco.MjModel, data: mujoco.MjData, body: int, can_touch: NDArray[np.bool_]) -> float:
    """Find the lowest centre of what can touch of a body and of what hangs on it, in m."""
    geoms = can_touch & below(model, body)[model.geom_bodyid]
    return float(data.geom_xpos[geoms][:, 2].min())


def _left_first(model: mujoco.MjModel, data: mujoco.MjData, pair: list[int]) -> tuple[int, ...]:
    """Order a pair as left and right, by names before places; empty if neither decides."""
    sides = [_side(model.body(body).name) for body in pair]
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
