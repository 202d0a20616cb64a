"""The boxes around the shapes of a robot's bodies."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from testbed.arrays import Array
from testbed.robot.visuals.shapes import Shape


def extents(shapes: Iterable[Shape], bodies: int) -> Array:
    """Least and greatest coordinates of every body's shapes in its own frame, (n, 2, 3) [m].

    Infinite where a body has no shapes.

    Args:
        shapes: Of all bodies.
        bodies: Their number, n.
    """
    least, greatest = np.full((bodies, 3), np.inf), np.full((bodies, 3), -np.inf)
    for shape in shapes:
        if shape.body >= 0:
            low, high = _box(shape)
            least[shape.body] = np.minimum(least[shape.body], low)
            greatest[shape.body] = np.maximum(greatest[shape.body], high)
    empty = ~np.isfinite(least[:, 0])
    least[empty], greatest[empty] = -np.inf, np.inf
    return np.stack([least, greatest], axis=1)


def _box(shape: Shape) -> tuple[Array, Array]:
    """Of one shape along its body's axes."""
    if shape.kind == "mesh":
        corners = shape.position + shape.vertices @ shape.rotation.T
        return corners.min(axis=0), corners.max(axis=0)
    turned = np.abs(shape.rotation)
    if shape.kind == "box":
        reach = turned @ shape.size
    elif shape.kind == "ellipsoid":
        reach = np.sqrt(turned**2 @ shape.size**2)
    else:
        radius, half = shape.size
        round_part = np.full(3, radius)
        if shape.kind == "cylinder":
            round_part = radius * np.sqrt(np.maximum(1 - turned[:, 2] ** 2, 0.0))
        reach = half * turned[:, 2] + round_part
    return shape.position - reach, shape.position + reach
