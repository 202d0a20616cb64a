"""Shapes on bodies."""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.robot.visuals.shapes import Shape

GREY = np.array([0.5, 0.5, 0.5, 1.0])


def ball(body: int, radius: float, place: Array) -> Shape:
    """A ball on a body, -1 for the pedestal, about a place in its frame."""
    return Shape(body, "ellipsoid", np.full(3, radius), place, np.eye(3), GREY)
