"""Shapes of an MJCF robot, through MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from testbed.bodies.shapes.shapes import DrawnShapes, Kind, Shape
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.transform import Transform
from testbed.core.robot.formats.mjcf_compile import (
    compile_spec,
    drop_unreadable_meshes,
    no_mujoco_warnings,
    stated_inertias,
)
from testbed.core.robot.formats.mjcf_spec import open_spec
from testbed.core.robot.tree import ModelSource, Tree

_KINDS: dict[int, Kind] = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_MESH): "mesh",
}
_SEEN_GROUPS = 3
"""MuJoCo's viewers show geoms of groups 0, 1 and 2."""


def read_shapes(model_file: ModelSource, tree: Tree) -> DrawnShapes:
    """What MuJoCo's own viewer shows, but for floors; arguments are those of `load_shapes`."""
    spec, _ = open_spec(model_file)
    stated_inertias(spec)  # impossible ones would keep it from being compiled
    said: tuple[Diagnostic, ...] = ()
    try:
        with no_mujoco_warnings():
            model = spec.compile()
    except ValueError:
        said = drop_unreadable_meshes(spec, model_file.path)
        model = compile_spec(spec, model_file.path)
    return DrawnShapes(tuple(_shapes(model, tree)), said)


def _shapes(model: mujoco.MjModel, tree: Tree) -> Iterator[Shape]:
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    poses = [*tree.zero_poses, Transform()]  # the last is the bedplate's
    for g in range(model.ngeom):
        kind = _KINDS.get(int(model.geom_type[g]))
        if kind is None or model.geom_group[g] >= _SEEN_GROUPS:
            continue
        body = _owner(model, int(model.geom_bodyid[g]), tree)
        X_WG = Transform(data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g])
        X_BG = poses[body].inverse @ X_WG
        vertices, faces = _mesh(model, g) if kind == "mesh" else (np.zeros((0, 3)),) * 2
        size = _size(kind, model.geom_size[g], int(model.geom_type[g]))
        yield Shape(
            body, kind, size, X_BG.p_AB_A, X_BG.R_AB, _colour(model, g), vertices, faces
        )


def _owner(model: mujoco.MjModel, body: int, tree: Tree) -> int:
    """Our body that a MuJoCo body is part of."""
    moving = int(model.body_weldid[body])
    if moving == 0:
        return -1
    last = int(model.body_jntadr[moving] + model.body_jntnum[moving] - 1)
    return tree.index(model.joint(last).name)


def _size(kind: Kind, size: Array, form: int) -> Array:
    if form == int(mujoco.mjtGeom.mjGEOM_SPHERE):
        return np.repeat(size[0], 3)
    return {"cylinder": size[:2], "capsule": size[:2], "mesh": size[:0]}.get(
        kind, size
    ).copy()


def _mesh(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    mesh = model.mesh(int(model.geom_dataid[geom]))
    v, f = int(mesh.vertadr[0]), int(mesh.faceadr[0])
    vertices = model.mesh_vert[v : v + int(mesh.vertnum[0])]
    faces = model.mesh_face[f : f + int(mesh.facenum[0])]
    return vertices.astype(np.float64), faces.astype(np.float64)


def _colour(model: mujoco.MjModel, geom: int) -> Array:
    material = int(model.geom_matid[geom])
    colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    return np.array(colour, dtype=np.float64)
