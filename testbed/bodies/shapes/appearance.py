"""A robot as it is drawn: by its model file, else of sticks; on a plate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from testbed.bodies.shapes.shapes import DrawnShapes, Shape, bounds, sticks
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.robot.model_file import ModelFile, model_format
from testbed.core.robot.tree import ModelSource, Tree

STEEL = (0.62, 0.64, 0.68, 1.0)
"""Colour of a plate that the model file does not draw."""

CLEAR = 0.05
"""How far beside the plate arrows stand, as part of the robot's reach."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """What a robot looks like.

    Attributes:
        tree: The robot.
        shapes: On its bodies and on the bedplate.
        diagnostics: What the model file gives to be seen but cannot be shown.
    """

    tree: Tree
    shapes: tuple[Shape, ...]
    diagnostics: tuple[Diagnostic, ...] = ()

    @cached_property
    def tips(self) -> dict[int, Array]:
        """A point on each last body, in its frame [m]: the centre of its farthest shape."""
        found = {}
        for j in range(self.tree.n):
            if self.tree.children(j):
                continue
            own = [shape.position for shape in self.shapes if shape.body == j]
            own.append(self.tree.inertias[j].com)
            found[j] = max(own, key=lambda point: float(np.linalg.norm(point)))
        return found

    @cached_property
    def reach(self) -> float:
        """A length that fits the robot: the sum of its offsets [m]."""
        lengths = sum(float(np.linalg.norm(joint.offset)) for joint in self.tree.joints)
        ends = max(float(np.linalg.norm(point)) for point in self.tips.values())
        return max(lengths / max(1, len(self.tree.children(-1))) + ends, 0.1)

    @cached_property
    def corner(self) -> Array:
        """A place on the bedplate's plane clear of all that stands on it, (3,) [m]."""
        boxes = [bounds(shape) for shape in self.shapes if shape.body < 0]
        beside = CLEAR * self.reach
        right = max((float(high[0]) for _, high in boxes), default=0.0) + beside
        front = min((float(low[1]) for low, _ in boxes), default=0.0) - beside
        return np.array([right, front, 0.0])

    @cached_property
    def deck(self) -> float:
        """Height of the plate's upper side: of the widest shape on the bedplate [m]."""
        boxes = [bounds(shape) for shape in self.shapes if shape.body < 0]
        widest = max(
            boxes, key=lambda box: float(np.prod((box[1] - box[0])[:2])), default=None
        )
        return 0.0 if widest is None else float(widest[1][2])


def load_shapes(model: ModelSource, tree: Tree) -> DrawnShapes:
    """What the model file gives to be seen of the robot, and what of it cannot be shown.

    Args:
        model: The model file, and how the tree was read from it.
        tree: The tree read from it.

    Raises:
        ModelError: The file cannot be read.
    """
    if model_format(model.path) == "mjcf":
        from testbed.bodies.shapes.mjcf_shapes import read_shapes as read
    else:
        from testbed.bodies.shapes.urdf_shapes import read_shapes as read
    return read(model, tree)


def load_appearance(tree: Tree, model: ModelFile | None = None) -> Appearance:
    """What a robot looks like: as its model file draws it, else as sticks.

    Args:
        tree: The robot.
        model: Its model file; None if it came from no file.

    Raises:
        ModelError: The file cannot be read.
    """
    drawing = DrawnShapes(())
    if model is not None:
        drawing = load_shapes(model, tree)
    shapes = drawing.shapes or tuple(sticks(tree))
    return Appearance(tree, _with_plate(tree, shapes), drawing.diagnostics)


def _with_plate(tree: Tree, shapes: tuple[Shape, ...]) -> tuple[Shape, ...]:
    """The shapes, and a plate under the robot where the model file draws none that wide."""
    span = sum(float(np.linalg.norm(joint.offset)) for joint in tree.joints)
    half = max(0.3 * span / max(1, len(tree.children(-1))), 0.1)
    for shape in shapes:
        if shape.body < 0 and shape.kind == "box" and min(shape.size[:2]) > 0.5 * half:
            return shapes
    size, below = (
        np.array([half, half, 0.04 * half]),
        np.array([0.0, 0.0, -0.04 * half]),
    )
    return (*shapes, Shape(-1, "box", size, below, np.eye(3), np.array(STEEL)))
