"""Canonical frames of a tree: joints along z, links twisted about x only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.transform import Transform
from testbed.core.parameters.regroup import inertia_transform
from testbed.core.parameters.rules import triad_about
from testbed.core.robot.tree import Tree

MIN_LEAN_SINE = 1e-14
"""Smallest sine of a twist angle (rotation about x) that is not a rounding error."""


@dataclass(frozen=True, eq=False)
class KernelLink:
    """Geometry of a link: offset, rotations about x and z, joint along the z axis.

    Attributes:
        joint: Index of the tree's joint; -1 for a fixed frame (a link without a joint).
        parent: Index of the link that carries this link, -1 for the bedplate.
        prismatic: True for a prismatic joint or a fixed frame.
        offset: Position of the joint in the carrying link's frame, (3,) [m].
        lean: Cosine and sine of the twist angle, the rotation about x.
        turn: Constant part of the rotation about z [rad].
    """

    joint: int
    parent: int
    prismatic: bool
    offset: Array
    lean: tuple[float, float]
    turn: float


@dataclass(frozen=True, eq=False)
class CanonicalFrames:
    """Links of a tree in canonical frames, with the joint along z.

    Attributes:
        links: Links, parents first.
        place: Index of the link of each joint, (n,).
        frames: Orientation of each body's canonical frame in the body frame, (n, 3, 3).
        bedplate: Orientation of the bedplate's canonical frame, (3, 3).
    """

    links: tuple[KernelLink, ...]
    place: tuple[int, ...]
    frames: Array
    bedplate: Array

    def to_canonical(self) -> Array:
        """Matrices that map barycentric parameters from body to canonical axes, (n, 10, 10)."""
        turned = np.stack(
            [inertia_transform(Transform(R_BC.T)) for R_BC in self.frames]
        )
        return np.where(np.abs(turned) < MIN_LEAN_SINE, 0.0, turned)


def canonical_frames(tree: Tree) -> CanonicalFrames:
    """Canonical frames of a tree.

    Each joint is along z. The rotation of a frame about z is chosen such that the first carried
    joint is twisted about x only. Fixed frames (links without a joint) are added for the other
    carried joints.

    Args:
        tree: The robot; only its geometry matters.
    """
    frames = [
        np.eye(3),
        *(triad_about(joint.axis).R_BT for joint in tree.joints),
    ]  # bedplate first
    for i in range(-1, tree.n):
        leans = [_lean_angle(_rest_rotation(tree, frames, j)) for j in tree.children(i)]
        first_angle = next((angle for angle in leans if angle is not None), None)
        if first_angle:
            frames[i + 1] = frames[i + 1] @ _rotation_z(first_angle)
    links: list[KernelLink] = []
    place: list[int] = []
    for j, joint in enumerate(tree.joints):
        parent = place[joint.parent] if joint.parent >= 0 else -1
        turn, offset = (
            _rest_rotation(tree, frames, j),
            frames[joint.parent + 1].T @ joint.offset,
        )
        angle_z = _lean_angle(turn)
        if angle_z:
            links.append(KernelLink(-1, parent, True, np.zeros(3), (1.0, 0.0), angle_z))
            back = _rotation_z(-angle_z)
            parent, turn, offset = len(links) - 1, back @ turn, back @ offset
        lean = (float(turn[2, 2]), float(-turn[1, 2]))
        residual_rotation = _rotation_x(*lean).T @ turn
        angle = float(np.arctan2(residual_rotation[1, 0], residual_rotation[0, 0]))
        place.append(len(links))
        links.append(KernelLink(j, parent, not joint.revolute, offset, lean, angle))
        if (
            j == tree.sensor_body
        ):  # a resting frame for the bodies that the sensor carries
            links.append(KernelLink(-1, place[j], True, np.zeros(3), (1.0, 0.0), 0.0))
            place[j] += 1
    return CanonicalFrames(tuple(links), tuple(place), np.stack(frames[1:]), frames[0])


def _rest_rotation(tree: Tree, frames: list[Array], j: int) -> Array:
    """Rotation from joint j's canonical frame at q = 0 to its carrier's canonical frame, (3, 3)."""
    joint = tree.joints[j]
    return frames[joint.parent + 1].T @ joint.rotation @ frames[j + 1]


def _lean_angle(turn: Array) -> float | None:
    """First of the z-x-z Euler angles of a rotation [rad].

    The result is None if the rotation is about z only.
    """
    if np.hypot(turn[0, 2], turn[1, 2]) < MIN_LEAN_SINE:
        return None
    angle = float(np.arctan2(turn[0, 2], -turn[1, 2]))
    return 0.0 if abs(angle) < MIN_LEAN_SINE else angle


def _rotation_z(angle: float) -> Array:
    """Rotation matrix about z by an angle [rad], (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _rotation_x(c: float, s: float) -> Array:
    """Rotation matrix about x by an angle with cosine c and sine s, (3, 3)."""
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
