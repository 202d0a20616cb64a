"""Bodies as the ellipsoids of even density that have their mass, centre and inertia."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.robot.tree import Tree
from testbed.robot.visuals.shapes import Shape


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
