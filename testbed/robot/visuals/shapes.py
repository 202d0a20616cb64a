"""What a robot looks like: shapes on its bodies, whichever language the file is written in."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from testbed.arrays import Array, readonly
from testbed.robot.tree import Tree

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
        shapes: dict[str, tuple[int | None, ...]] = {
            "size": (None,),
            "position": (3,),
            "rotation": (3, 3),
            "colour": (4,),
            "vertices": (None, 3),
            "faces": (None, 3),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))


@dataclass(frozen=True)
class DrawnShapes:
    """What there is to see of a robot.

    Attributes:
        shapes: Those that the model file gives.
        warnings: What the file gives but cannot be shown, a line each.
    """

    shapes: tuple[Shape, ...]
    warnings: tuple[str, ...] = ()


def poses_at_zero(tree: Tree) -> list[tuple[Array, Array]]:
    """Rotation to the bedplate's axes and position of every body at q = 0."""
    poses: list[tuple[Array, Array]] = []
    for joint in tree.joints:
        rotation, position = (np.eye(3), np.zeros(3)) if joint.parent < 0 else poses[joint.parent]
        poses.append((rotation @ joint.rotation, position + rotation @ joint.offset))
    return poses


def upright(direction: Array) -> Array:
    """A rotation that takes z to a direction, (3, 3)."""
    z = direction / np.linalg.norm(direction)
    other = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(other, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
