"""Shapes as triangles, for those who draw them."""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.robot.visuals.shapes import Shape

ROUND = 32
"""Corners of a circle."""


def triangles(shape: Shape) -> Array:
    """A shape's surface in its body's frame, (T, 3 corners, 3) [m]; the winding is of no matter.

    Args:
        shape: Of any kind.
    """
    if shape.kind == "mesh":
        own = shape.vertices[shape.faces.astype(int)]
    elif shape.kind == "box":
        own = _box(shape.size)
    else:
        own = _turned(*_profile(shape))
        if shape.kind == "ellipsoid":
            own = own * shape.size
    return np.asarray(own @ shape.rotation.T + shape.position)


def _box(half: Array) -> Array:
    """Two triangles a face."""
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, 8).T
    quads = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return np.asarray((corners * half)[np.array(faces)], dtype=np.float64)


def _profile(shape: Shape) -> tuple[Array, Array]:
    """Radius and height along a half section, from pole to pole; an ellipsoid's of radius one."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, ROUND // 2 + 1)
    if shape.kind == "ellipsoid":
        return np.cos(angle), np.sin(angle)
    radius, half = shape.size
    if shape.kind == "cylinder":
        return np.array([0.0, radius, radius, 0.0]), np.array([-half, -half, half, half])
    height = radius * np.sin(angle) + np.where(angle < 0, -half, half)
    return radius * np.cos(angle), height


def _turned(radius: Array, height: Array) -> Array:
    """The surface that a half section draws when it turns about z."""
    turn = np.linspace(0, 2 * np.pi, ROUND + 1)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    points = np.empty((len(radius), ROUND + 1, 3))
    points[..., :2] = radius[:, None, None] * ring
    points[..., 2] = height[:, None]
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    both = np.stack([np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)])
    return both.reshape(-1, 3, 3)
