"""Appearance of a robot: shapes of its model file, or sticks, on a plate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from testbed.bodies.shapes.shapes import Shape, VisualShapes, shape_bounds, stick_figure
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.robot.model_file import ModelFile, model_format
from testbed.core.robot.tree import ModelSource, Tree

PLATE_COLOUR = (0.62, 0.64, 0.68, 1.0)
"""Colour of a plate that is not in the model file: red, green, blue, opacity."""

CLEARANCE_RATIO = 0.05
"""Distance of arrows from the shapes on the bedplate, relative to the robot's reach."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """Visual shapes of a robot and its bedplate.

    Attributes:
        tree: Robot.
        shapes: Shapes on the bodies and on the bedplate.
        diagnostics: Diagnostics of the model file's shapes that cannot be shown.
    """

    tree: Tree
    shapes: tuple[Shape, ...]
    diagnostics: tuple[Diagnostic, ...] = ()

    @cached_property
    def tip_points(self) -> dict[int, Array]:
        """Farthest shape centre or centre of mass of each terminal body [m].

        The points, (3,), are in the body frame and keyed by the index of the body. Distances are
        measured from the origin of the body frame.
        """
        points = {}
        for j in range(self.tree.n):
            if self.tree.children(j):
                continue
            candidates = [shape.position for shape in self.shapes if shape.body == j]
            candidates.append(self.tree.inertias[j].com)
            points[j] = max(candidates, key=lambda point: float(np.linalg.norm(point)))
        return points

    @cached_property
    def reach(self) -> float:
        """Approximate reach of the robot [m], at least 0.1.

        The reach is the sum of the lengths of all joint offsets, divided by the number of joints on
        the bedplate, plus the largest distance of a tip point from its body's origin.
        """
        lengths = sum(float(np.linalg.norm(joint.offset)) for joint in self.tree.joints)
        ends = max(float(np.linalg.norm(point)) for point in self.tip_points.values())
        return max(lengths / max(1, len(self.tree.children(-1))) + ends, 0.1)

    @cached_property
    def clear_corner(self) -> Array:
        """Point in the plane z = 0 outside the bounds of the bedplate's shapes, (3,) [m].

        The point lies beyond the largest x and the smallest y of the shapes, with a clearance of
        `CLEARANCE_RATIO` times the reach.
        """
        boxes = [shape_bounds(shape) for shape in self.shapes if shape.body < 0]
        clearance = CLEARANCE_RATIO * self.reach
        right = max((float(high[0]) for _, high in boxes), default=0.0) + clearance
        front = min((float(low[1]) for low, _ in boxes), default=0.0) - clearance
        return np.array([right, front, 0.0])

    @cached_property
    def plate_height(self) -> float:
        """Largest z of the bedplate's widest shape [m]; 0 without shapes.

        The widest shape has the bounding box with the largest area in the x-y plane.
        """
        boxes = [shape_bounds(shape) for shape in self.shapes if shape.body < 0]
        widest = max(
            boxes, key=lambda box: float(np.prod((box[1] - box[0])[:2])), default=None
        )
        return 0.0 if widest is None else float(widest[1][2])


def load_shapes(model: ModelSource, tree: Tree) -> VisualShapes:
    """Load the visual shapes of a model file, with diagnostics of unreadable shapes.

    Args:
        model: Model file, and the options it was read with.
        tree: Tree read from the file.

    Raises:
        ModelError: The file cannot be read.
    """
    if model_format(model.path) == "mjcf":
        from testbed.bodies.shapes.mjcf_shapes import read_shapes as read
    else:
        from testbed.bodies.shapes.urdf_shapes import read_shapes as read
    return read(model, tree)


def load_appearance(tree: Tree, model: ModelFile | None = None) -> Appearance:
    """Load the appearance of a robot from its model file, or make a stick figure.

    A stick figure is made if there is no file or if the file contains no shape. A plate is added if
    the bedplate has no wide box.

    Args:
        tree: Robot.
        model: Model file of the robot; None for a robot without a file.

    Raises:
        ModelError: The file cannot be read.
    """
    drawing = VisualShapes(())
    if model is not None:
        drawing = load_shapes(model, tree)
    shapes = drawing.shapes or tuple(stick_figure(tree))
    return Appearance(tree, _with_plate(tree, shapes), drawing.diagnostics)


def _with_plate(tree: Tree, shapes: tuple[Shape, ...]) -> tuple[Shape, ...]:
    """Shapes with a plate under the robot, unless the bedplate has a wide box already.

    The plate is a square box with its upper side at z = 0. A box is wide if it is over half as wide
    as this plate in both directions.
    """
    span = sum(float(np.linalg.norm(joint.offset)) for joint in tree.joints)
    half = max(0.3 * span / max(1, len(tree.children(-1))), 0.1)
    for shape in shapes:
        if shape.body < 0 and shape.kind == "box" and min(shape.size[:2]) > 0.5 * half:
            return shapes
    size, position = (
        np.array([half, half, 0.04 * half]),
        np.array([0.0, 0.0, -0.04 * half]),
    )
    return (
        *shapes,
        Shape(-1, "box", size, position, np.eye(3), np.array(PLATE_COLOUR)),
    )
