"""Canonical frames: the fewest numbers that say how bodies hang together.

Every body gets a frame with z along its joint, turned about z so that the first joint it
carries leans about x only. What then leads from a body to the next is an offset, a turn
about x, and the joint's own turn about z; where several joints lean in different
directions, a resting frame between takes the turn about z.

Source    [KK86], as Denavit and Hartenberg's modified parameters; here for any tree
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.parameters.barycentric import TENSOR, UPPER
from testbed.parameters.rules import across
from testbed.robot.tree import Tree

STRAIGHT = 1e-14
"""Sine of a lean that is none."""


@dataclass(frozen=True, eq=False)
class Link:
    """One step outward: an offset, a turn about x, then the joint along or about z.

    Attributes:
        joint: Index of the tree's joint; -1 for a resting frame.
        parent: Index of the link that carries it, -1 for the bedplate.
        slides: Whether the joint is prismatic, or the frame rests.
        offset: (3,) [m], in the carrying link's frame.
        lean: Cosine and sine of the turn about x.
        turn: Constant part of the turn about z [rad].
    """

    joint: int
    parent: int
    slides: bool
    offset: Array
    lean: tuple[float, float]
    turn: float


@dataclass(frozen=True, eq=False)
class Canonical:
    """A tree in canonical frames.

    Attributes:
        links: Parents first.
        place: Index of each joint's link, (n,).
        frames: Orientation of each body's canonical frame in its own, (n, 3, 3).
        bedplate: Orientation of the bedplate's canonical frame, (3, 3).
    """

    links: tuple[Link, ...]
    place: tuple[int, ...]
    frames: Array
    bedplate: Array

    def to_canonical(self) -> Array:
        """Barycentric parameters about canonical axes from those about the bodies', (n, 10, 10)."""
        return np.stack([_turned(frame) for frame in self.frames])


def canonical(tree: Tree) -> Canonical:
    """The tree's canonical frames.

    Args:
        tree: The robot; only its geometry matters.
    """
    frames = [np.eye(3), *(_upright(joint.axis) for joint in tree.joints)]  # bedplate first
    for i in range(-1, tree.n):
        leans = [_lean(_between(tree, frames, j)) for j in tree.children(i)]
        first = next((angle for angle in leans if angle is not None), None)
        if first:
            frames[i + 1] = frames[i + 1] @ _about_z(first)
    links: list[Link] = []
    place: list[int] = []
    for j, joint in enumerate(tree.joints):
        parent = place[joint.parent] if joint.parent >= 0 else -1
        turn, offset = _between(tree, frames, j), frames[joint.parent + 1].T @ joint.offset
        aside = _lean(turn)
        if aside:
            links.append(Link(-1, parent, True, np.zeros(3), (1.0, 0.0), aside))
            back = _about_z(-aside)
            parent, turn, offset = len(links) - 1, back @ turn, back @ offset
        lean = (float(turn[2, 2]), float(-turn[1, 2]))
        rest = _about_x(*lean).T @ turn
        angle = float(np.arctan2(rest[1, 0], rest[0, 0]))
        place.append(len(links))
        links.append(Link(j, parent, not joint.revolute, offset, lean, angle))
    return Canonical(tuple(links), tuple(place), np.stack(frames[1:]), frames[0])


def _upright(axis: Array) -> Array:
    """A frame with its z along a unit vector."""
    x = across(axis).axes[0]
    return np.column_stack([x, np.cross(axis, x), axis])


def _between(tree: Tree, frames: list[Array], j: int) -> Array:
    """From joint j's canonical frame at rest to its carrier's, (3, 3)."""
    joint = tree.joints[j]
    turn: Array = frames[joint.parent + 1].T @ joint.rotation @ frames[j + 1]
    return turn


def _lean(turn: Array) -> float | None:
    """The turn about z before which `turn` leans about x only; None if it does not lean."""
    if np.hypot(turn[0, 2], turn[1, 2]) < STRAIGHT:
        return None
    angle = float(np.arctan2(turn[0, 2], -turn[1, 2]))
    return 0.0 if abs(angle) < STRAIGHT else angle


def _about_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _about_x(c: float, s: float) -> Array:
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _turned(frame: Array) -> Array:
    """What barycentric parameters become in a frame of this orientation, (10, 10)."""
    matrix = np.zeros((10, 10))
    matrix[0, 0] = 1.0
    matrix[1:4, 1:4] = frame.T
    for k in range(6):
        tensor = frame.T @ TENSOR[:, :, k] @ frame
        matrix[4:, 4 + k] = tensor[UPPER]
    matrix[np.abs(matrix) < STRAIGHT] = 0.0
    return matrix
