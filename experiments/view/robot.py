"""A robot of MuJoCo in the browser: a mesh a body, drawn once and moved by poses."""

from typing import Any

import mujoco
import numpy as np
import trimesh
import viser

from surefoot.arrays import Floats

VISIBLE_GROUPS = 3  # geoms of groups below this one are drawn, as MuJoCo's viewers do

_GEOM = mujoco.mjtGeom


class RobotMeshes:
    """The bodies of a model, without planes and height fields: the page has a ground of its own."""

    def __init__(self, server: viser.ViserServer, model: mujoco.MjModel) -> None:
        self._handles: list[tuple[int, Any]] = []
        for body in range(model.nbody):
            start = int(model.body_geomadr[body])
            geoms = range(start, start + int(model.body_geomnum[body]))
            meshes = [mesh for geom in geoms if (mesh := _mesh(model, geom)) is not None]
            if meshes:
                handle = server.scene.add_mesh_trimesh(f"/robot/{body}", trimesh.util.concatenate(meshes))
                self._handles.append((body, handle))

    def move(self, data: mujoco.MjData, origin: Floats) -> None:
        """Move the bodies to where they are, seen from an origin on the ground in m, shape (3,)."""
        for body, handle in self._handles:
            handle.position = data.xpos[body] - origin
            handle.wxyz = data.xquat[body]


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """Return a geom in its body's frame, in its colour; ``None`` if it is not drawn."""
    colour = _colour(model, geom)
    if model.geom_group[geom] >= VISIBLE_GROUPS or colour[3] == 0.0:
        return None
    shape = _shape(model, geom)
    if shape is None:
        return None
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, model.geom_quat[geom])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes.reshape(3, 3), model.geom_pos[geom]
    shape.apply_transform(pose)
    rgba = np.tile((255 * colour).astype(np.uint8), (len(shape.vertices), 1))
    shape.visual = trimesh.visual.ColorVisuals(shape, vertex_colors=rgba)
    return shape


def _shape(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    size = model.geom_size[geom]
    match int(model.geom_type[geom]):
        case _GEOM.mjGEOM_SPHERE:
            return trimesh.creation.icosphere(subdivisions=2, radius=size[0])
        case _GEOM.mjGEOM_ELLIPSOID:
            ball = trimesh.creation.icosphere(subdivisions=2)
            ball.apply_scale(size)
            return ball
        case _GEOM.mjGEOM_CAPSULE:
            return trimesh.creation.capsule(height=2.0 * size[1], radius=size[0], count=(16, 16))
        case _GEOM.mjGEOM_CYLINDER:
            return trimesh.creation.cylinder(radius=size[0], height=2.0 * size[1], sections=24)
        case _GEOM.mjGEOM_BOX:
            return trimesh.creation.box(extents=2.0 * size)
        case _GEOM.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
            vertices = model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[mesh])]
            faces = model.mesh_face[face : face + int(model.mesh_facenum[mesh])]
            return trimesh.Trimesh(vertices.copy(), faces.copy(), process=False)
    return None


def _colour(model: mujoco.MjModel, geom: int) -> Floats:
    """Return RGBA from 0 to 1: a material's, unless the geom has a colour of its own."""
    material, own = int(model.geom_matid[geom]), np.asarray(model.geom_rgba[geom], dtype=np.float64)
    if material < 0 or not np.allclose(own, (0.5, 0.5, 0.5, 1.0)):
        return own
    return np.asarray(model.mat_rgba[material], dtype=np.float64)
