"""The boxes around the shapes of a robot's bodies."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from testbed.arrays import Array
from testbed.robot.visuals.appearance import bounds
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
            low, high = bounds(shape)
            least[shape.body] = np.minimum(least[shape.body], low)
            greatest[shape.body] = np.maximum(greatest[shape.body], high)
    empty = ~np.isfinite(least[:, 0])
    least[empty], greatest[empty] = -np.inf, np.inf
    return np.stack([least, greatest], axis=1)
