r"""The part of a foot that meets the ground: its frame, its support polygon, and places for four cells.

The geoms that can touch are reduced to the points that can bear on a flat floor: the corners of boxes, the
vertices of meshes, the rims of cylinders, and the lowest points of round parts. The sole is the largest
face of their convex hull among those that look down, to within 30 degrees, in the pose in which the robot
stands. Its frame has z up out of the ground and x to the toes; its origin lies in that face, straight below
the ankle.

One sphere touches at a point and one capsule along a line. Their force has a line of action, too, but the
point where it meets the floor says nothing about a sole, and four cells under it cannot be distinguished:
such a foot has a flaw instead of a polygon.
"""

from dataclasses import dataclass, field
from itertools import product
from typing import Final

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from surefoot.arrays import Floats

FACE_SLOPE: Final = float(np.cos(np.radians(30.0)))
"""Cosine of the largest angle between a sole and the ground in the pose in which the robot stands."""

NO_HEADING: Final = 0.9
"""Share of the vertical in an axis of the torso above which it says nothing of where the robot faces."""

FACE_DEPTH: Final = 0.002  # height in m above a sole's lowest point up to which a point still belongs to it
NARROWEST: Final = 0.001  # least distance in m of a cell from the middle of its rectangle
THINNEST: Final = 0.005  # spread in m below which the points of a foot lie on one line


_SHAPES: Final = tuple(
    getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")
    for kind in ("BOX", "MESH", "CYLINDER", "CAPSULE", "ELLIPSOID", "SPHERE")
)
"""Kinds of geoms of which :func:`_bearing_points` knows the points."""


@dataclass(frozen=True, eq=False)
class FootGeometry:
    """One foot, measured."""

    body: str  # its body's name
    position_ankle_foot: Floats  # where the ankle's joint sits in the body's frame in m, shape (3,)
    position_sole_foot: Floats  # origin of the sole's frame in the body's in m, shape (3,)
    R_foot_sole: Floats  # rotation from the sole's frame to the body's, shape (3, 3)
    polygon: Floats
    """Corners of the support polygon in the sole's frame in m, counter-clockwise, shape (n, 2); n = 0 for a
    foot with a flaw."""
    flaw: str = ""  # why the foot has no polygon, or empty
    round: Floats = field(default_factory=lambda: np.zeros((0, 4)))
    """Of a foot with a flaw, centres in the sole's frame and radii in m of the parts that may touch: spheres,
    ends of capsules, points of radius 0; shape (m, 4), and m = 0 for others."""

    def layout(self, margin: float) -> Floats:
        """Place four cells in the corners of the largest rectangle inside the polygon, drawn in by a margin.

        Places are front-left, front-right, rear-left, rear-right in the sole's frame in m, (4, 2). A foot
        with a flaw, and a margin that is negative or leaves nothing, are refused with a ValueError.
        """
        if self.flaw:
            raise ValueError(self.flaw)
        rear, front, right, left = _largest_rectangle(self.polygon)
        room = min(front - rear, left - right) / 2.0
        if not 0.0 <= margin <= room - NARROWEST:
            raise ValueError(
                f"'margin' must be at least 0 and leave {NARROWEST} m of {room:.4f} m, half the width of the "
                f"sole of '{self.body}'; got {margin!r}."
            )
        x, y = (front - margin, rear + margin), (left - margin, right + margin)
        return np.array(list(product(x, y)))


def measure_foot(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> FootGeometry:
    """Measure a foot in the pose of ``data``, in which its sole looks down and the robot's x axis forward.

    The kinematics were evaluated. ValueError says that nothing of the foot can touch.
    """
    name = model.body(body).name
    geoms = np.flatnonzero(colliding(model) & below(model, body)[model.geom_bodyid])
    if not len(geoms):
        raise ValueError(
            f"No geom of the foot '{name}' or of what hangs on it can touch anything (contype, conaffinity "
            f"and contact pairs); bodies whose geoms can are {bodies_that_touch(model)}."
        )
    R_world_foot = data.xmat[body].reshape(3, 3)
    up, flaw = np.array([0.0, 0.0, 1.0]), ""
    # What is round bears elsewhere once the normal is known, hence twice.
    for _ in range(2):
        points = np.concatenate([_bearing_points(model, data, int(geom), up) for geom in geoms])
        normal = _sole_normal(points, up)
        if normal is None:
            flaw = _flaw(model, name, geoms)
            break
        up = normal
    torso = data.xmat[model.body_rootid[body]].reshape(3, 3)
    # The torso of a robot that was drawn lying on its back looks along z when it stands.
    forward = torso[:, 0] if abs(torso[2, 0]) < NO_HEADING else torso[:, 2]
    # A foot that toes out keeps its own axis.
    axes = np.concatenate([R_world_foot.T, -R_world_foot.T])
    nearest = axes[np.argmax(axes @ forward)]
    forward = nearest if nearest @ forward > np.cos(np.pi / 4) else forward
    x = forward - (forward @ up) * up
    x /= np.linalg.norm(x)
    R_world_sole = np.stack([x, np.cross(up, x), up], axis=1)

    jointed = model.body_jntnum[body] > 0
    ankle = model.jnt_pos[model.body_jntadr[body]] if jointed else np.zeros(3)
    above = data.xpos[body] + R_world_foot @ ankle
    height = (points - above) @ up
    origin = above + height.min() * up
    low = ((points - origin) @ R_world_sole)[height < height.min() + FACE_DEPTH, :2]
    if not flaw and _spread(low) < THINNEST:
        flaw = _flaw(model, name, geoms)
    return FootGeometry(
        body=name,
        position_ankle_foot=ankle.copy(),
        position_sole_foot=R_world_foot.T @ (origin - data.xpos[body]),
        R_foot_sole=R_world_foot.T @ R_world_sole,
        polygon=np.zeros((0, 2)) if flaw else low[ConvexHull(low).vertices],
        flaw=flaw,
        round=_round_parts(model, data, geoms, origin, R_world_sole) if flaw else np.zeros((0, 4)),
    )


def colliding(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Return which geoms can touch anything: by their bits or in a pair of contacts, shape (ngeom,)."""
    can: NDArray[np.bool_] = (model.geom_contype | model.geom_conaffinity) != 0
    can[model.pair_geom1] = True
    can[model.pair_geom2] = True
    return can


def bodies_that_touch(model: mujoco.MjModel) -> list[str]:
    """Return the names of moving bodies of which a geom can touch anything, in model order."""
    bodies = sorted(set(model.geom_bodyid[colliding(model)].tolist()) - {0})
    return [model.body(body).name for body in bodies]


def lowest_points(model: mujoco.MjModel, data: mujoco.MjData) -> Floats:
    """Find the lowest point of each body that can touch in m, shape (nbody,); inf of one that cannot.

    Of geoms without a shape of their own, such as planes, it is the centre.
    """
    lowest = np.full(model.nbody, np.inf)
    for geom in np.flatnonzero(colliding(model)):
        shaped = mujoco.mjtGeom(int(model.geom_type[geom])) in _SHAPES
        points = (
            _bearing_points(model, data, int(geom), np.array([0.0, 0.0, 1.0]))
            if shaped
            else data.geom_xpos[geom : geom + 1]
        )
        body = model.geom_bodyid[geom]
        lowest[body] = min(lowest[body], points[:, 2].min())
    return lowest


def below(model: mujoco.MjModel, body: int) -> NDArray[np.bool_]:
    """Return which bodies are a body or hang on it, shape (nbody,)."""
    hangs: NDArray[np.bool_] = np.arange(model.nbody) == body
    # A parent's number is less than its children's.
    for other in range(body + 1, model.nbody):
        hangs[other] = hangs[model.body_parentid[other]]
    return hangs


def check_layout(foot: FootGeometry, cells: ArrayLike) -> Floats:
    """Return four places of cells; ValueError if they are not four, not finite, or far from the sole."""
    places = np.asarray(cells, dtype=np.float64)
    if places.shape != (4, 2) or not np.isfinite(places).all():
        raise ValueError(
            f"The cells of '{foot.body}' must be four finite places (x, y) in its sole's frame in m, "
            f"front-left, front-right, rear-left, rear-right, got shape {places.shape}: {places.tolist()}."
        )
    low, high = foot.polygon.min(axis=0), foot.polygon.max(axis=0)
    # Cells may stand out from under a sole, but no farther than it is long or wide.
    if np.any((places < 2.0 * low - high) | (places > 2.0 * high - low)):
        raise ValueError(
            f"The cells of '{foot.body}' must be no farther beside its sole than that is long and wide, from "
            f"{low.round(3).tolist()} to {high.round(3).tolist()}, got {places.tolist()}; give m, "
            "in the sole's frame."
        )
    return places


def _bearing_points(model: mujoco.MjModel, data: mujoco.MjData, geom: int, up: Floats) -> Floats:
    """List the points of a geom in the world that can bear on a floor of a normal, shape (n, 3)."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    R = data.geom_xmat[geom].reshape(3, 3)
    drop = np.zeros(3)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        local = np.array(list(product((-1.0, 1.0), repeat=3))) * size
    elif kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        local = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(np.float64)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        angle = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
        rim = size[0] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        local = np.concatenate([np.insert(rim, 2, z, axis=1) for z in (-size[1], size[1])])
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        local = np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]])
        drop = size[0] * up
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        local = np.zeros((1, 3))
        drop = R @ (size**2 * (R.T @ up)) / np.linalg.norm(size * (R.T @ up))
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        local = np.zeros((1, 3))
        drop = size[0] * up
    else:
        body = model.body(int(model.geom_bodyid[geom])).name
        raise ValueError(
            f"Geom {geom} of the foot '{body}' is a {kind.name[7:].lower()}, of which no sole can be "
            "measured; a foot is made of boxes, meshes, capsules, cylinders, "
            "ellipsoids or spheres."
        )
    points: Floats = data.geom_xpos[geom] + local @ R.T - drop
    return points


def _round_parts(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.intp], origin: Floats, R_world_sole: Floats
) -> Floats:
    """Return centres and radii of the parts that may touch, of spheres and capsules if any, shape (m, 4)."""
    round_kinds = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE
    radius = np.where(np.isin(model.geom_type[geoms], round_kinds), model.geom_size[geoms, 0], 0.0)
    parts = []
    for geom, r in zip(geoms.tolist(), radius.tolist(), strict=True):
        up = R_world_sole[:, 2]
        if r or not radius.any():
            centre = (_bearing_points(model, data, geom, up) + r * up - origin) @ R_world_sole
            parts.append(np.column_stack([centre, np.full(len(centre), r)]))
    return np.concatenate(parts)


def _sole_normal(points: Floats, up: Floats) -> Floats | None:
    """Find the upward normal of the largest face that looks down; None if there is no area."""
    across = points - np.outer(points @ up, up)
    if _spread(across) < THINNEST:
        return None
    # Points in one plane have no hull: an apex gives them one, whose other faces do not look down.
    hull = ConvexHull(np.vstack([points, points.mean(axis=0) + np.ptp(points, axis=0).max() * up]))
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
    corners = hull.points[hull.simplices]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    down = -(normals @ up)
    areas = np.where(down > FACE_SLOPE, areas, 0.0)
    if not areas.any():
        return None
    alike = (normals @ normals.T > np.cos(np.radians(2.0))) & (
        np.abs(offsets[:, None] - offsets) < FACE_DEPTH
    )
    normal = -(areas * alike[np.argmax(alike @ areas)]) @ normals
    return np.asarray(normal / np.linalg.norm(normal))


def _spread(points: Floats) -> float:
    """Return how far points reach across their longest direction, in m."""
    centred = points - points.mean(axis=0)
    across = centred @ np.linalg.svd(centred)[2][1]
    return float(np.ptp(across))


def _largest_rectangle(polygon: Floats) -> tuple[float, float, float, float]:
    """Find the largest rectangle along the axes in a convex polygon: rear, front, right, left in m."""
    x = np.unique(np.concatenate([polygon[:, 0], np.linspace(polygon[:, 0].min(), polygon[:, 0].max(), 101)]))
    following = np.roll(polygon, -1, axis=0)
    low, high = np.full(len(x), np.inf), np.full(len(x), -np.inf)
    for (x0, y0), (x1, y1) in zip(polygon, following, strict=True):
        if x0 == x1:
            ends, y = x == x0, np.array([y0, y1])
            low[ends] = np.minimum(low[ends], y.min())
            high[ends] = np.maximum(high[ends], y.max())
            continue
        inside = (x >= min(x0, x1)) & (x <= max(x0, x1))
        edge = y0 + (y1 - y0) / (x1 - x0) * (x[inside] - x0)
        low[inside] = np.minimum(low[inside], edge)
        high[inside] = np.maximum(high[inside], edge)
    # A convex polygon is narrowest at an end of any interval.
    right = np.maximum(low[:, None], low)
    left = np.minimum(high[:, None], high)
    area = np.maximum(x - x[:, None], 0.0) * np.maximum(left - right, 0.0)
    i, j = np.unravel_index(np.argmax(area), area.shape)
    return float(x[i]), float(x[j]), float(right[i, j]), float(left[i, j])


def _flaw(model: mujoco.MjModel, name: str, geoms: NDArray[np.intp]) -> str:
    """Return why a foot has no area."""
    kinds = [mujoco.mjtGeom(int(model.geom_type[geom])).name[7:].lower() for geom in geoms]
    return (
        f"The foot '{name}' has no area: it touches the ground with {' and '.join(kinds)} only, at one point "
        "or along one line, so that it has no centre of pressure of its own and no four cells. Its total "
        "force and torque are measured; for the rest give it a flat geom: InstrumentedEnv(env, soles=True)."
    )
