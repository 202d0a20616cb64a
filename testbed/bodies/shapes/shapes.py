"""Shapes on a robot's bodies: bounds, surfaces; and those that a tree has without a file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.parameters.rules import across
from testbed.core.robot.tree import Tree

Kind = Literal["box", "ellipsoid", "cylinder", "capsule", "mesh"]


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape of a body.

    Attributes:
        body: Index of the body, -1 for the bedplate.
        kind: "box", "ellipsoid", "cylinder", "capsule" or "mesh".
        size: Half lengths of a box, radii of an ellipsoid, radius and half length of a
            cylinder or capsule (along z, hemispheres not counted), (k,) [m].
        position: Of its centre in the body's frame, (3,) [m].
        rotation: From its own axes to the body's, (3, 3).
        colour: Red, green, blue, opacity, 0 ... 1, (4,).
        vertices: Of a mesh, in its own frame, (V, 3) [m].
        faces: Of a mesh, counter-clockwise from outside, (F, 3).
    """

    body: int
    kind: Kind
    size: Array
    position: Array
    rotation: Array
    colour: Array
    vertices: Array = field(default_factory=lambda: np.zeros((0, 3)))
    faces: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        freeze(self, size=(None,), position=(3,), rotation=(3, 3), colour=(4,))
        freeze(self, vertices=(None, 3), faces=(None, 3))


@dataclass(frozen=True)
class DrawnShapes:
    """What there is to see of a robot.

    Attributes:
        shapes: Those that the model file gives.
        diagnostics: What the file gives but cannot be shown.
    """

    shapes: tuple[Shape, ...]
    diagnostics: tuple[Diagnostic, ...] = ()


def sticks(tree: Tree) -> Iterator[Shape]:
    """A figure of sticks for a robot that no file draws: every body from its joint to the next.

    Args:
        tree: The robot.
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
                size, axes = np.array([radius, length / 2]), across(end / length).R_BT
                yield Shape(body, "capsule", size, end / 2, axes, grey)
        size = np.array([1.6 * radius, 2.4 * radius])
        yield Shape(j, "cylinder", size, np.zeros(3), across(joint.axis).R_BT, dark)


def equivalent_ellipsoids(tree: Tree, colour: Sequence[float]) -> tuple[Shape, ...]:
    """One a body that can exist; an ellipsoid of half lengths a has second moments m a^2 / 5.

    Args:
        tree: The robot.
        colour: Red, green, blue, opacity, 0 ... 1.
    """
    found = []
    for body, inertia in enumerate(tree.inertias):
        if inertia.mass <= 0:
            continue
        matrix, com = inertia.pseudo, inertia.com
        size, axes = np.linalg.eigh(matrix[:3, :3] - inertia.mass * np.outer(com, com))
        if size[0] < -1e-9 * abs(size[2]):
            continue
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        half = np.sqrt(5 * np.maximum(size, 0.0) / inertia.mass)
        found.append(Shape(body, "ellipsoid", half, com, axes, np.array(colour)))
    return tuple(found)


def bounds(shape: Shape) -> tuple[Array, Array]:
    """Least and largest coordinates of a shape in its body's frame, (3,) each [m]."""
    if shape.kind == "mesh":
        corners = shape.vertices @ shape.rotation.T + shape.position
        return corners.min(axis=0), corners.max(axis=0)
    turn = shape.rotation
    if shape.kind == "box":
        half = np.abs(turn) @ shape.size
    elif shape.kind == "ellipsoid":
        half = np.sqrt(turn**2 @ shape.size**2)
    else:
        radius, length = shape.size
        ends = (
            np.sqrt(np.maximum(1 - turn[:, 2] ** 2, 0))
            if shape.kind == "cylinder"
            else 1.0
        )
        half = length * np.abs(turn[:, 2]) + radius * ends
    return shape.position - half, shape.position + half
