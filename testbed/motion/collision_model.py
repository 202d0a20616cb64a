"""MuJoCo collision model of a robot: shapes, pairs of bodies, bounds on approach speeds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, compress

import mujoco
import numpy as np
from numpy.typing import NDArray

from testbed.bodies.shapes.shapes import Shape
from testbed.core.base.arrays import Array
from testbed.core.base.errors import UnknownName
from testbed.core.robot.rotations import matrix_to_quaternion
from testbed.core.robot.tree import Tree
from testbed.motion.limits import Limits

PLATE_BODY, FLOOR_BODY, OBSTACLE_BODY = -1, -2, -3
"""Indices of fixed bodies: plate with pedestal; floor; obstacles around the robot."""

FIXED_BODY_NAMES = {PLATE_BODY: "plate", FLOOR_BODY: "floor", OBSTACLE_BODY: "obstacle"}
"""Names of the fixed bodies in lists of excluded pairs."""

_GEOM_TYPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}


@dataclass(frozen=True, eq=False)
class CollisionModel:
    """Shapes of all bodies, and the watched pairs of bodies, whose distances are computed.

    Attributes:
        tree: The robot.
        model: MuJoCo model of bodies and shapes.
        order: Index of each joint in MuJoCo's velocity vector, (n,).
        pairs: Pairs of body indices; negative indices are fixed bodies.
        geoms: Pairs of shape indices of each pair of bodies, (2, k).
    """

    tree: Tree
    model: mujoco.MjModel
    order: NDArray[np.int64]
    pairs: tuple[tuple[int, int], ...]
    geoms: tuple[NDArray[np.int64], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Labels of the pairs for messages."""
        phrases = {
            PLATE_BODY: "the pedestal or plate",
            FLOOR_BODY: "the floor",
            OBSTACLE_BODY: "an obstacle",
        }
        return tuple(
            f"'{second}' to " + phrases.get(a, f"'{first}'")
            for (a, _), (first, second) in zip(self.pairs, self.bodies, strict=True)
        )

    @property
    def bodies(self) -> tuple[tuple[str, str], ...]:
        """Names of the bodies of each pair; fixed bodies are named as in `FIXED_BODY_NAMES`."""
        joints = self.tree.joints
        return tuple(
            (FIXED_BODY_NAMES.get(a) or joints[a].body, joints[b].body)
            for a, b in self.pairs
        )

    def without_pairs(self, pairs: Iterable[tuple[str, str]]) -> CollisionModel:
        """Collision model without given pairs of bodies.

        Args:
            pairs: Names of the bodies of each excluded pair, in any order; fixed bodies are named
                as in `FIXED_BODY_NAMES`.

        Raises:
            UnknownName: No body has a given name.
        """
        excluded = [frozenset(pair) for pair in pairs]
        known = [
            *(joint.body for joint in self.tree.joints),
            *FIXED_BODY_NAMES.values(),
        ]
        for name in (name for pair in excluded for name in pair):
            if name not in known:
                raise UnknownName("body in excitation.exclude", name, known)
        return self.with_selected_pairs(
            [frozenset(pair) not in excluded for pair in self.bodies]
        )

    def with_selected_pairs(self, watched: Sequence[bool]) -> CollisionModel:
        """Collision model with the selected pairs only.

        Args:
            watched: True for each selected pair, in the order of `pairs`.
        """
        pairs = tuple(compress(self.pairs, watched))
        return replace(self, pairs=pairs, geoms=tuple(compress(self.geoms, watched)))


def collision_model(
    tree: Tree,
    shapes: Sequence[Shape],
    obstacles: Sequence[Shape] = (),
    floor: float | None = None,
) -> CollisionModel:
    """Build the collision model of a robot, obstacles and a floor, with all pairs watched.

    A pair consists of two bodies that no joint connects, at least one of which moves; a body
    carried by the bedplate is not paired with the floor. Meshes are replaced by their convex hulls;
    flat meshes are dropped.

    Args:
        tree: The robot.
        shapes: Shapes on the robot's bodies and on the bedplate.
        obstacles: Shapes around the robot, in the bedplate's frame.
        floor: Height of the floor in the bedplate's frame [m]; None for no floor.
    """
    spec = mujoco.MjSpec()
    bodies = _add_bodies(spec, tree)
    owners: dict[str, int] = {}
    owned = [*((each, max(each.body, PLATE_BODY)) for each in shapes)]
    owned += [(each, OBSTACLE_BODY) for each in obstacles]
    for number, (shape, owner) in enumerate(owned):
        _add_shape(spec, bodies[shape.body + 1], shape, f"shape {number}")
        owners[f"shape {number}"] = owner
    if floor is not None:
        plane, size = mujoco.mjtGeom.mjGEOM_PLANE, [0, 0, 1]
        spec.worldbody.add_geom(name="floor", type=plane, pos=[0, 0, floor], size=size)
        owners["floor"] = FLOOR_BODY
    model = spec.compile()
    order = np.array([model.joint(str(j)).dofadr[0] for j in range(tree.n)])
    pairs = _collision_pairs(
        tree, [owners[model.geom(geom).name] for geom in range(model.ngeom)]
    )
    return CollisionModel(tree, model, order, tuple(pairs), tuple(pairs.values()))


def _add_bodies(spec: mujoco.MjSpec, tree: Tree) -> list[mujoco.MjsBody]:
    """Add a body without shapes for each joint; return the world and the new bodies."""
    bodies = [spec.worldbody]
    kinds = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for j, joint in enumerate(tree.joints):
        pose = {"pos": joint.offset, "quat": matrix_to_quaternion(joint.rotation)}
        body = bodies[joint.parent + 1].add_body(**pose)
        body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), True
        body.add_joint(name=str(j), type=kinds[joint.revolute], axis=joint.axis)
        bodies.append(body)
    return bodies


def _collision_pairs(
    tree: Tree, owners: Sequence[int]
) -> dict[tuple[int, int], NDArray[np.int64]]:
    """Pairs of shapes, (2, k), keyed by the pairs of bodies that can collide.

    At least one body of a pair moves, and no joint connects the two bodies; a body carried by the
    bedplate is not paired with the floor. Keys and shapes have the lower body index first.

    Args:
        tree: The robot.
        owners: Body index of each shape.
    """
    connected = {(joint.parent, j) for j, joint in enumerate(tree.joints)}
    connected |= {
        (FLOOR_BODY, j) for parent, j in connected if parent < 0
    }  # a first body rests on the floor
    shape_pairs: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for a, b in combinations(range(len(owners)), 2):
        (first, first_shape), (second, second_shape) = sorted(
            ((owners[a], a), (owners[b], b))
        )
        if first != second and second >= 0 and (first, second) not in connected:
            shape_pairs.setdefault((first, second), []).append(
                (first_shape, second_shape)
            )
    return {pair: np.array(shape_pairs[pair]).T for pair in sorted(shape_pairs)}


def _add_shape(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, shape: Shape, name: str
) -> None:
    """Add a shape to a body, except a flat mesh, which has no convex hull."""
    pose = {
        "name": name,
        "pos": shape.position,
        "quat": matrix_to_quaternion(shape.rotation),
    }
    size = np.concatenate([shape.size, np.zeros(3)])[:3]
    if shape.kind == "mesh":
        hull = _convex_hull(shape.vertices)
        if hull is None:
            return
        mesh = spec.add_mesh(name=name)
        mesh.uservert, mesh.userface = (part.ravel() for part in hull)
        body.add_geom(type=_GEOM_TYPES["mesh"], meshname=mesh.name, **pose)
    else:
        is_sphere = shape.kind == "ellipsoid" and np.ptp(size) == 0
        kind = mujoco.mjtGeom.mjGEOM_SPHERE if is_sphere else _GEOM_TYPES[shape.kind]
        body.add_geom(type=kind, size=size, **pose)


def _convex_hull(vertices: Array) -> tuple[Array, NDArray[np.int64]] | None:
    """Vertices (v, 3) and triangles (f, 3) of the convex hull; None for flat meshes."""
    from scipy.spatial import ConvexHull, QhullError  # half a second to import

    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError):
        return None
    new_index = np.zeros(len(vertices), dtype=np.int64)
    new_index[hull.vertices] = np.arange(len(hull.vertices))
    return vertices[hull.vertices], new_index[hull.simplices]


def distance_rate_bounds(collision: CollisionModel, limits: Limits) -> Array:
    """Upper bounds of the distance change per joint displacement, (k, n) [m/rad or 1].

    Only joints between a body of the pair and the last common ancestor of both bodies contribute. A
    revolute joint moves a point of the body at most by the joint displacement times the largest
    distance of the point from the joint.

    Args:
        collision: Shapes and watched pairs.
        limits: Limits of the joint positions.
    """
    tree, reaches = collision.tree, _reaches(collision)
    max_travel = np.maximum(np.abs(limits.low), np.abs(limits.high))
    bounds = np.zeros((len(collision.pairs), tree.n))
    for k, (a, b) in enumerate(collision.pairs):
        common = set(tree.chain(a)) & set(tree.chain(b))
        for body in (a, b):
            max_distance = reaches.get(body, 0.0)
            for j in reversed(tree.chain(body)):
                if j in common:
                    break
                joint = tree.joints[j]
                bounds[k, j] = max_distance if joint.revolute else 1.0
                max_distance += float(np.linalg.norm(joint.offset))
                max_distance += 0.0 if joint.revolute else float(max_travel[j])
    return bounds


def _reaches(collision: CollisionModel) -> dict[int, float]:
    """Upper bounds of distances of shapes from body origins, keyed by moving body [m]."""
    model = collision.model
    reaches: dict[int, float] = {}
    for (a, b), geoms in zip(collision.pairs, collision.geoms, strict=True):
        for body, body_geoms in zip((a, b), geoms, strict=True):
            distances = (
                np.linalg.norm(model.geom_pos[body_geoms], axis=1)
                + model.geom_rbound[body_geoms]
            )
            if body >= 0:
                reaches[body] = max(reaches.get(body, 0.0), float(distances.max()))
    return reaches
