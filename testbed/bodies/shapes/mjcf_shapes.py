"""Visual shapes of an MJCF robot, read with MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from testbed.bodies.shapes.shapes import Shape, ShapeKind, VisualShapes
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.transform import Transform
from testbed.core.robot.formats.mjcf_compile import (
    compile_spec,
    drop_unreadable_meshes,
    extract_explicit_inertias,
    suppress_mujoco_warnings,
)
from testbed.core.robot.formats.mjcf_spec import open_spec
from testbed.core.robot.tree import ModelSource, Tree

_KINDS: dict[int, ShapeKind] = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_MESH): "mesh",
}
_VISIBLE_GROUPS = 3
"""Number of the geom groups that MuJoCo's viewers show: 0, 1 and 2."""


def read_shapes(model_file: ModelSource, tree: Tree) -> VisualShapes:
    """Read the geoms that MuJoCo's viewer shows, except planes and height fields.

    These are the geoms of the groups 0, 1 and 2. Meshes that cannot be read are left out and
    reported as diagnostics.

    Args:
        model_file: MJCF file, and the options it was read with.
        tree: Tree read from the file.

    Raises:
        ModelError: The file cannot be compiled.
    """
    spec, _ = open_spec(model_file)
    extract_explicit_inertias(spec)  # impossible inertias would prevent compilation
    diagnostics: tuple[Diagnostic, ...] = ()
    try:
        with suppress_mujoco_warnings():
            model = spec.compile()
    except ValueError:
        diagnostics = drop_unreadable_meshes(spec, model_file.path)
        model = compile_spec(spec, model_file.path)
    return VisualShapes(tuple(_visible_shapes(model, tree)), diagnostics)


def _visible_shapes(model: mujoco.MjModel, tree: Tree) -> Iterator[Shape]:
    """Yield shapes of the visible geoms, in the frames of the tree's bodies.

    Args:
        model: Compiled MuJoCo model.
        tree: Tree read from the same file.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    poses = [*tree.zero_poses, Transform()]  # last: pose of the bedplate
    for g in range(model.ngeom):
        kind = _KINDS.get(int(model.geom_type[g]))
        if kind is None or model.geom_group[g] >= _VISIBLE_GROUPS:
            continue
        body = _body_index(model, int(model.geom_bodyid[g]), tree)
        X_WG = Transform(data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g])
        X_BG = poses[body].inverse @ X_WG
        vertices, faces = (
            _mesh_arrays(model, g) if kind == "mesh" else (np.zeros((0, 3)),) * 2
        )
        size = _shape_size(kind, model.geom_size[g], int(model.geom_type[g]))
        yield Shape(
            body,
            kind,
            size,
            X_BG.p_AB_A,
            X_BG.R_AB,
            _geom_colour(model, g),
            vertices,
            faces,
        )


def _body_index(model: mujoco.MjModel, body: int, tree: Tree) -> int:
    """Index of the tree's body that contains a MuJoCo body; -1 for the bedplate."""
    moving_body = int(model.body_weldid[body])
    if moving_body == 0:
        return -1
    last_joint = int(
        model.body_jntadr[moving_body] + model.body_jntnum[moving_body] - 1
    )
    return tree.index(model.joint(last_joint).name)


def _shape_size(kind: ShapeKind, size: Array, geom_type: int) -> Array:
    """Size of a shape as defined by `Shape.size`, converted from the size of a geom.

    Args:
        kind: Kind of the shape.
        size: Size of the geom, (3,) [m].
        geom_type: MuJoCo's type of the geom.
    """
    if geom_type == int(mujoco.mjtGeom.mjGEOM_SPHERE):
        return np.repeat(size[0], 3)
    return {"cylinder": size[:2], "capsule": size[:2], "mesh": size[:0]}.get(
        kind, size
    ).copy()


def _mesh_arrays(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    """Vertices, (V, 3) [m], and vertex indices of the faces, (F, 3), of a geom's mesh."""
    mesh = model.mesh(int(model.geom_dataid[geom]))
    v, f = int(mesh.vertadr[0]), int(mesh.faceadr[0])
    vertices = model.mesh_vert[v : v + int(mesh.vertnum[0])]
    faces = model.mesh_face[f : f + int(mesh.facenum[0])]
    return vertices.astype(np.float64), faces.astype(np.float64)


def _geom_colour(model: mujoco.MjModel, geom: int) -> Array:
    """Colour of a geom: red, green, blue, opacity, (4,).

    If the geom has a material, the colour of the material is used.
    """
    material = int(model.geom_matid[geom])
    colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    return np.array(colour, dtype=np.float64)
