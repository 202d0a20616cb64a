"""The robot's shapes as a MuJoCo model: who may come near whom, and how fast at most."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from testbed.bodies.shapes.shapes import Shape
from testbed.core.base.arrays import Array
from testbed.core.base.errors import UnknownName
from testbed.core.robot.rotations import to_quaternion
from testbed.core.robot.tree import Tree
from testbed.motion.limits import Limits

STANDING, FLOOR, CELL = -1, -2, -3
"""What does not move: what stands on the plate, plate included; the floor; boxes around."""

NAMES = {STANDING: "plate", FLOOR: "floor", CELL: "obstacle"}
"""Their names, where pairs are left out."""

_KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}


@dataclass(frozen=True, eq=False)
class CollisionModel:
    """Shapes on bodies, and the pairs of bodies that are watched.

    Attributes:
        tree: The robot.
        model: MuJoCo's.
        order: For each joint of the tree, its index among MuJoCo's velocities, (n,).
        pairs: Bodies, by index; those below zero do not move.
        geoms: Of each pair, the pairs of shapes, (2, k).
    """

    tree: Tree
    model: mujoco.MjModel
    order: NDArray[np.int64]
    pairs: tuple[tuple[int, int], ...]
    geoms: tuple[NDArray[np.int64], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the pairs, for people."""
        words = {
            STANDING: "the pedestal or plate",
            FLOOR: "the floor",
            CELL: "an obstacle",
        }
        return tuple(
            f"'{second}' to " + words.get(a, f"'{first}'")
            for (a, _), (first, second) in zip(self.pairs, self.bodies, strict=True)
        )

    @property
    def bodies(self) -> tuple[tuple[str, str], ...]:
        """Of the pairs, by name; what does not move as NAMES has it."""
        joints = self.tree.joints
        return tuple(
            (NAMES.get(a) or joints[a].body, joints[b].body) for a, b in self.pairs
        )

    def without(self, pairs: Iterable[tuple[str, str]]) -> CollisionModel:
        """All but some pairs of bodies, by name.

        Raises:
            UnknownName: There is no such body.
        """
        left_out = [frozenset(pair) for pair in pairs]
        known = [*(joint.body for joint in self.tree.joints), *NAMES.values()]
        for name in (name for pair in left_out for name in pair):
            if name not in known:
                raise UnknownName("body in excitation.exclude", name, known)
        return self.only([frozenset(pair) not in left_out for pair in self.bodies])

    def only(self, watched: Sequence[bool]) -> CollisionModel:
        """Some of the pairs."""
        kept = [k for k, wanted in enumerate(watched) if wanted]
        pairs, geoms = (
            tuple(self.pairs[k] for k in kept),
            tuple(self.geoms[k] for k in kept),
        )
        return replace(self, pairs=pairs, geoms=geoms)


def collision_model(
    tree: Tree,
    shapes: Sequence[Shape],
    obstacles: Sequence[Shape] = (),
    floor: float | None = None,
) -> CollisionModel:
    """Put a robot's shapes on its bodies, and obstacles around it.

    Args:
        tree: The robot.
        shapes: On its bodies and on the bedplate.
        obstacles: Of the user's cell, in the bedplate's frame.
        floor: Height of the floor [m], bedplate frame; None for none.
    """
    spec = mujoco.MjSpec()
    bodies = [spec.worldbody]
    for j, joint in enumerate(tree.joints):
        place = {"pos": joint.offset, "quat": to_quaternion(joint.rotation)}
        body = bodies[joint.parent + 1].add_body(**place)
        body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), True
        kind = (
            mujoco.mjtJoint.mjJNT_HINGE
            if joint.revolute
            else mujoco.mjtJoint.mjJNT_SLIDE
        )
        body.add_joint(name=str(j), type=kind, axis=joint.axis)
        bodies.append(body)
    owners: dict[str, int] = {}
    owned = [*((each, max(each.body, STANDING)) for each in shapes)]
    owned += [(each, CELL) for each in obstacles]
    for number, (shape, owner) in enumerate(owned):
        _add(spec, bodies[shape.body + 1], shape, f"shape {number}")
        owners[f"shape {number}"] = owner
    if floor is not None:
        plane, size = mujoco.mjtGeom.mjGEOM_PLANE, [0, 0, 1]
        spec.worldbody.add_geom(name="floor", type=plane, pos=[0, 0, floor], size=size)
        owners["floor"] = FLOOR
    model = spec.compile()
    order = np.array([model.joint(str(j)).dofadr[0] for j in range(tree.n)])
    pairs = _pairs(tree, [owners[model.geom(geom).name] for geom in range(model.ngeom)])
    return CollisionModel(tree, model, order, tuple(pairs), tuple(pairs.values()))


def _pairs(
    tree: Tree, owners: Sequence[int]
) -> dict[tuple[int, int], NDArray[np.int64]]:
    """Pairs of bodies that may meet, and their shapes: no joint joins them, one of them moves."""
    joined = {(joint.parent, j) for j, joint in enumerate(tree.joints)}
    joined |= {(FLOOR, j) for parent, j in joined if parent < 0}  # it stands there
    found: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for a, b in combinations(range(len(owners)), 2):
        (first, one), (second, two) = sorted(((owners[a], a), (owners[b], b)))
        if first != second and second >= 0 and (first, second) not in joined:
            found.setdefault((first, second), []).append((one, two))
    return {pair: np.array(found[pair]).T for pair in sorted(found)}


def _add(spec: mujoco.MjSpec, body: mujoco.MjsBody, shape: Shape, name: str) -> None:
    """Put a shape on a body, but for flat meshes, which nothing can hit."""
    place = {"name": name, "pos": shape.position, "quat": to_quaternion(shape.rotation)}
    size = np.concatenate([shape.size, np.zeros(3)])[:3]
    if shape.kind == "mesh":
        hull = _hull(shape.vertices)
        if hull is None:
            return
        mesh = spec.add_mesh(name=name)
        mesh.uservert, mesh.userface = (part.ravel() for part in hull)
        body.add_geom(type=_KINDS["mesh"], meshname=mesh.name, **place)
    else:
        ball = shape.kind == "ellipsoid" and np.ptp(size) == 0
        kind = mujoco.mjtGeom.mjGEOM_SPHERE if ball else _KINDS[shape.kind]
        body.add_geom(type=kind, size=size, **place)


def _hull(vertices: Array) -> tuple[Array, NDArray[np.int64]] | None:
    """Corners and triangles of the convex hull; None of what is flat: nothing could hit it."""
    from scipy.spatial import ConvexHull, QhullError  # half a second to import

    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError):
        return None
    number = np.zeros(len(vertices), dtype=np.int64)
    number[hull.vertices] = np.arange(len(hull.vertices))
    return vertices[hull.vertices], number[hull.simplices]


def levers(collision: CollisionModel, limits: Limits) -> Array:
    """Bounds of how distances of pairs change with the joints' positions, (k, n) [m/rad or 1].

    Seen from the last body that carries both, a point of either moves by no more than each joint's
    own movement times how far from that joint it can be.

    Args:
        collision: Shapes, and the pairs.
        limits: Of the joints' positions.
    """
    tree, size = collision.tree, _sizes(collision)
    travel = np.maximum(np.abs(limits.low), np.abs(limits.high))
    found = np.zeros((len(collision.pairs), tree.n))
    for k, (a, b) in enumerate(collision.pairs):
        both = set(tree.chain(a)) & set(tree.chain(b))
        for body in (a, b):
            away = size.get(body, 0.0)
            for j in reversed(tree.chain(body)):
                if j in both:
                    break
                joint = tree.joints[j]
                found[k, j] = away if joint.revolute else 1.0
                away += float(np.linalg.norm(joint.offset))
                away += 0.0 if joint.revolute else float(travel[j])
    return found


def _sizes(collision: CollisionModel) -> dict[int, float]:
    """How far from a moving body's origin its shapes reach [m]."""
    model = collision.model
    found: dict[int, float] = {}
    for (a, b), geoms in zip(collision.pairs, collision.geoms, strict=True):
        for body, own in zip((a, b), geoms, strict=True):
            reach = np.linalg.norm(model.geom_pos[own], axis=1) + model.geom_rbound[own]
            if body >= 0:
                found[body] = max(found.get(body, 0.0), float(reach.max()))
    return found
