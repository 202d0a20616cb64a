"""Shapes on bodies."""

from __future__ import annotations

import numpy as np

from testbed.bodies.shapes.shapes import Shape
from testbed.core.base.arrays import Array

GREY = np.array([0.5, 0.5, 0.5, 1.0])


def ball(body: int, radius: float, place: Array) -> Shape:
    """A ball on a body, -1 for the pedestal, about a place in its frame."""
    return Shape(body, "ellipsoid", np.full(3, radius), place, np.eye(3), GREY)
