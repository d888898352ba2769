"""Meshes that are only seen: they take most of a robot's memory, and nothing that moves needs them."""

from itertools import product

import mujoco
import numpy as np

from surefoot.envs.instrumentation.geometry import colliding

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
