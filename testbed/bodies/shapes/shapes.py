"""Visual shapes on a robot's bodies: bounds, stick figures and inertia ellipsoids."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.parameters.rules import triad_about
from testbed.core.robot.tree import Tree

ShapeKind = Literal["box", "ellipsoid", "cylinder", "capsule", "mesh"]


@dataclass(frozen=True, eq=False)
class Shape:
    """Visual shape that is fixed to a body.

    Attributes:
        body: Index of the body, -1 for the bedplate.
        kind: "box", "ellipsoid", "cylinder", "capsule" or "mesh".
        size: Half lengths of a box, radii of an ellipsoid, radius and half length of a cylinder or
            capsule (along z, without the hemispheres), (k,) [m].
        position: Position of the centre in the body frame, (3,) [m].
        rotation: Rotation matrix from the shape's axes to the body's axes, (3, 3).
        colour: Red, green, blue, opacity, 0 ... 1, (4,).
        vertices: The V vertices of a mesh in the shape's axes, (V, 3) [m].
        faces: Vertex indices of the F faces of a mesh, counter-clockwise seen from outside, (F, 3).
    """

    body: int
    kind: ShapeKind
    size: Array
    position: Array
    rotation: Array
    colour: Array
    vertices: Array = field(default_factory=lambda: np.zeros((0, 3)))
    faces: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        freeze_arrays(self, size=(None,), position=(3,), rotation=(3, 3), colour=(4,))
        freeze_arrays(self, vertices=(None, 3), faces=(None, 3))


@dataclass(frozen=True)
class VisualShapes:
    """Visual shapes of a model file.

    Attributes:
        shapes: Shapes in the file.
        diagnostics: Diagnostics of the file's shapes that cannot be shown.
    """

    shapes: tuple[Shape, ...]
    diagnostics: tuple[Diagnostic, ...] = ()


def stick_figure(tree: Tree) -> Iterator[Shape]:
    """Stick figure of a robot: capsules between the joints, cylinders on their axes.

    Args:
        tree: Robot.
    """
    longest = (
        max((float(np.linalg.norm(j.offset)) for j in tree.joints), default=0.0) or 0.3
    )
    radius = longest / 30
    grey, dark = np.array([0.72, 0.74, 0.78, 1.0]), np.array([0.25, 0.28, 0.33, 1.0])
    for j, joint in enumerate(tree.joints):
        ends = {joint.parent: joint.offset}
        if not tree.children(j):
            ends[j] = tree.inertias[j].com
        for body, end in ends.items():
            length = float(np.linalg.norm(end))
            if length > radius:
                size, axes = (
                    np.array([radius, length / 2]),
                    triad_about(end / length).R_BT,
                )
                yield Shape(body, "capsule", size, end / 2, axes, grey)
        size = np.array([1.6 * radius, 2.4 * radius])
        yield Shape(
            j, "cylinder", size, np.zeros(3), triad_about(joint.axis).R_BT, dark
        )


def equivalent_ellipsoids(tree: Tree, colour: Sequence[float]) -> tuple[Shape, ...]:
    """Homogeneous ellipsoids with the inertias of the bodies; impossible bodies are left out.

    An ellipsoid with mass m and semi-axes a has the principal second moments m a^2 / 5.

    Args:
        tree: Robot.
        colour: Red, green, blue, opacity, 0 ... 1.
    """
    ellipsoids = []
    for body, inertia in enumerate(tree.inertias):
        if inertia.mass <= 0:
            continue
        matrix, com = inertia.pseudo, inertia.com
        second_moments, axes = np.linalg.eigh(
            matrix[:3, :3] - inertia.mass * np.outer(com, com)
        )
        if second_moments[0] < -1e-9 * abs(second_moments[2]):
            continue
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        half = np.sqrt(5 * np.maximum(second_moments, 0.0) / inertia.mass)
        ellipsoids.append(Shape(body, "ellipsoid", half, com, axes, np.array(colour)))
    return tuple(ellipsoids)


def shape_bounds(shape: Shape) -> tuple[Array, Array]:
    """Smallest and largest coordinates of a shape in the body frame, (3,) each [m]."""
    if shape.kind == "mesh":
        corners = shape.vertices @ shape.rotation.T + shape.position
        return corners.min(axis=0), corners.max(axis=0)
    rotation = shape.rotation
    if shape.kind == "box":
        half = np.abs(rotation) @ shape.size
    elif shape.kind == "ellipsoid":
        half = np.sqrt(rotation**2 @ shape.size**2)
    else:
        radius, length = shape.size
        cap = (
            np.sqrt(np.maximum(1 - rotation[:, 2] ** 2, 0))
            if shape.kind == "cylinder"
            else 1.0
        )
        half = length * np.abs(rotation[:, 2]) + radius * cap
    return shape.position - half, shape.position + half
