"""Mistakes that mappings hold: what the data would be without each, and which to try."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.robot.free_base import FREE, coordinates, poses
from testbed.robot.tree import Tree

Kind = Literal[
    "position_sign", "torque_sign", "wrench_sense", "degrees", "radians", "zero",
    "position_order", "torque_order", "joint_order", "force_unit", "moment_unit", "plate_order",
    "base_unit", "quaternion_order",
]  # fmt: skip

QUARTERS = (np.pi / 2, -np.pi / 2, np.pi)
"""Zeros that model files and controllers put elsewhere [rad]."""

SCANNED = tuple(np.deg2rad(angle) for angle in range(-165, 180, 15) if angle % 90)
"""Other zeros to try [rad]."""

BEYOND = 2 * np.pi
"""Positions below this are no degrees taken for radians: nobody moves so little [rad]."""

LITTLE = np.deg2rad(2 * BEYOND)
"""Excursions below this may be radians that were taken for degrees [rad]."""

PLATE_UNITS = (1e-3, 1e3)
"""Times that forces or moments are taken too small or too large: N mm for N m, kN for N."""

PLATE_ORDERS = (
    (3, 4, 5, 0, 1, 2), (1, 0, 2, 4, 3, 5), (0, 2, 1, 3, 5, 4), (2, 1, 0, 5, 4, 3),
    (1, 2, 0, 4, 5, 3), (2, 0, 1, 5, 3, 4),
)  # fmt: skip
"""Moments before forces, and axes in another order."""

BASE_UNITS = (1e-3, 1e-2, 1e2, 1e3)
"""Times that a base's positions are taken too small or too large: mm or cm for m."""

SCALAR_LAST = (3, 0, 1, 2)
"""Where w, x, y, z of a quaternion stand that is x, y, z, w."""

MERGED = ("position_sign", "torque_sign", "degrees", "zero")
"""Kinds of which there is one line in a mapping for all joints."""

MOST_JOINTS = 12
"""Joints of a robot up to which orders and zeros are tried: their number grows fast."""


@dataclass(frozen=True, eq=False)
class Signals:
    """What a recording's estimates are made of.

    Attributes:
        position: (M, n) [rad or m].
        torque: (M, n) [N m or N], if measured.
        wrench: (M, 6) [N, N m], if measured.
        offset: What the mapping has added to the positions, (n,) [rad or m].
    """

    position: Array
    torque: Array | None
    wrench: Array | None
    offset: Array | float = 0.0


@dataclass(frozen=True)
class Mistake:
    """One mistake that a mapping may hold.

    Attributes:
        kind: What is wrong.
        joints: Indices of the joints that it is about.
        angles: Of zeros that are missing, one a joint [rad].
        order: Of orders: the k-th joint's, or the plate's k-th, column stands in place order[k].
        factor: Of units of plate or base: what is measured is so many times too large.
    """

    kind: Kind
    joints: tuple[int, ...] = ()
    angles: tuple[float, ...] = ()
    order: tuple[int, ...] = ()
    factor: float = 1.0

    def undone(self, signals: Signals) -> Signals:
        """What the data would be without it.

        Args:
            signals: As they were read.
        """
        position, torque, wrench = signals.position, signals.torque, signals.wrench
        here = list(self.joints)
        if self.kind in ("position_order", "joint_order"):
            position = position[:, list(self.order)]
        if self.kind in ("torque_order", "joint_order") and torque is not None:
            torque = torque[:, list(self.order)]
        if self.kind == "torque_sign" and torque is not None:
            torque = _times(torque, here, -1.0)
        if wrench is not None:
            wrench = self._plate(wrench)
        if self.kind == "radians":
            position = _times(position - signals.offset, here, 180 / np.pi) + signals.offset
        if self.kind == "position_sign":
            position = _times(position, here, -1.0)
        if self.kind == "degrees":
            position = _times(position, here, np.pi / 180)
        if self.kind == "zero":
            position = position.copy()
            position[:, here] += self.angles
        if self.kind == "base_unit":
            position = _times(position, [0, 1, 2], 1 / self.factor)
        if self.kind == "quaternion_order":
            pose = poses(position[:, :FREE])
            pose[:, 3:] = pose[:, 3:][:, list(self.order)]
            position = np.hstack([_upright(pose), position[:, FREE:]])
        return replace(signals, position=position, torque=torque, wrench=wrench)

    def _plate(self, wrench: Array) -> Array:
        """The plate's channels without it."""
        if self.kind == "wrench_sense":
            return -wrench
        if self.kind == "plate_order":
            return wrench[:, list(self.order)]
        if self.kind in ("force_unit", "moment_unit"):
            part = [0, 1, 2] if self.kind == "force_unit" else [3, 4, 5]
            return _times(wrench, part, 1 / self.factor)
        return wrench


def merged(mistakes: Sequence[Mistake]) -> list[Mistake]:
    """Signs and zeros of several joints, each kind as one mistake.

    Args:
        mistakes: In any order; those of columns' orders stay as they are.
    """
    found: list[Mistake] = []
    for kind in ("position_sign", "torque_sign", "degrees"):
        alike = [m for m in mistakes if m.kind == kind]
        joints = sorted({j for m in alike for j in m.joints})
        odd = [j for j in joints if sum(j in m.joints for m in alike) % 2]
        found += [replace(alike[0], joints=tuple(odd))] if odd else []
    zeros: dict[int, float] = {}
    for mistake in mistakes:
        if mistake.kind == "zero":
            for joint, angle in zip(mistake.joints, mistake.angles, strict=True):
                zeros[joint] = zeros.get(joint, 0.0) + angle
    if zeros:
        found.append(Mistake("zero", tuple(zeros), tuple(zeros.values())))
    return found + [m for m in mistakes if m.kind not in MERGED]


def mistakes_of_all(tree: Tree, signals: Signals) -> Iterator[Mistake]:
    """Mistakes that concern all joints alike.

    Args:
        tree: The robot.
        signals: What there is.
    """
    everyone = tuple(own_joints(tree))
    large = [k for k in _turning(tree, everyone) if np.abs(signals.position[:, k]).max() > BEYOND]
    if signals.torque is not None:
        yield Mistake("torque_sign", everyone)
    if signals.wrench is not None:
        yield Mistake("wrench_sense")
        yield from (Mistake("force_unit", factor=factor) for factor in PLATE_UNITS)
        yield from (Mistake("moment_unit", factor=factor) for factor in PLATE_UNITS)
        yield from (Mistake("plate_order", order=order) for order in PLATE_ORDERS)
    if large:
        yield Mistake("degrees", tuple(_turning(tree, everyone)))
    span = np.ptp(signals.position[:, _turning(tree, everyone)], axis=0)
    if span.size and span.max() < LITTLE:
        yield Mistake("radians", tuple(_turning(tree, everyone)))
    if tree.floating:
        yield from (Mistake("base_unit", factor=factor) for factor in BASE_UNITS)
        yield Mistake("quaternion_order", order=SCALAR_LAST)
    rolled = [tuple(np.roll(everyone, k).tolist()) for k in range(1, len(everyone))]
    base = tuple(range(tree.n - len(everyone)))
    for order in ((*base, *each) for each in (*rolled, everyone[::-1])):
        if 2 < tree.n <= MOST_JOINTS:
            yield from _orders(tree, signals, order)


def mistakes_of_joints(tree: Tree, signals: Signals, doubted: Sequence[int]) -> Iterator[Mistake]:
    """Mistakes that concern a joint or two.

    Args:
        tree: The robot.
        signals: What there is.
        doubted: Joints about which something is odd.
    """
    near = own_joints(tree) if tree.n <= MOST_JOINTS else doubted
    for joint in near:  # a position shows in the torques of its carriers
        yield Mistake("position_sign", (joint,))
        if signals.torque is not None and joint in doubted:
            yield Mistake("torque_sign", (joint,))
        if _turning(tree, [joint]) and tree.n <= MOST_JOINTS:
            if np.abs(signals.position[:, joint]).max() > BEYOND:
                yield Mistake("degrees", (joint,))
            yield from (Mistake("zero", (joint,), (angle,)) for angle in QUARTERS)
        for other in own_joints(tree) if tree.n <= MOST_JOINTS and joint in doubted else ():
            if other < joint or (other > joint and other not in doubted):
                order = list(range(tree.n))
                order[joint], order[other] = other, joint
                yield from _orders(tree, signals, tuple(order))


def rarer_mistakes(tree: Tree, doubted: Sequence[int]) -> Iterator[Mistake]:
    """Zeros of neighbours that are wrong together, and zeros by any angle.

    Args:
        tree: The robot.
        doubted: Joints about which something is odd.
    """
    for joint in _turning(tree, doubted):
        beside = (tree.parents[joint], *tree.children(joint))
        for other in _turning(tree, [k for k in beside if k >= 0]):
            for angles in product(QUARTERS, repeat=2):
                yield Mistake("zero", (joint, other), angles)
        yield from (Mistake("zero", (joint,), (angle,)) for angle in SCANNED)


def own_joints(tree: Tree) -> range:
    """The robot's own joints: all, but for the coordinates of a free base.

    Args:
        tree: The robot.
    """
    return range(FREE if tree.floating else 0, tree.n)


def _upright(pose: Array) -> Array:
    """Coordinates of poses, (M, 6); as if the base lay still where it stands on its head."""
    try:
        return coordinates(pose)
    except RecordingError:
        return np.zeros((len(pose), FREE))


def _orders(tree: Tree, signals: Signals, order: tuple[int, ...]) -> Iterator[Mistake]:
    """An order of columns, of positions, torques, or both."""
    joints = tuple(k for k, place in enumerate(order) if place != k)
    if any(tree.joints[k].kind != tree.joints[order[k]].kind for k in joints):
        return
    if signals.torque is not None:
        yield Mistake("torque_order", joints, order=order)
        yield Mistake("joint_order", joints, order=order)
    yield Mistake("position_order", joints, order=order)


def _turning(tree: Tree, joints: Sequence[int]) -> list[int]:
    return [k for k in joints if tree.joints[k].revolute]


def _times(signal: Array, columns: list[int], factor: float) -> Array:
    changed = signal.copy()
    changed[:, columns] *= factor
    return changed
