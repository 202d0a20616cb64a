"""A robot on paper: the tree's geometry, coordinates and parameters as symbols.

Lengths are symbols; so are the angles of a constant rotation that is no quarter turn, and
the direction of an axis that is no axis of its body. What is zero, or a quarter turn, in
the model file is so in the equations.

Names     q2 qp2 qpp2; l23z; g; roll3 pitch3 yaw3, turn4 lean4; parameters in docs/conventions.md
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from testbed.arrays import AnyArray, Array, skew
from testbed.parameters.formulas import length_name
from testbed.symbolic.algebra import auxiliary, component, cosine, sine
from testbed.symbolic.expression import Expression, Factor, Nature, symbol
from testbed.tree.tree import Tree

EXACT = 1e-14
"""Parts of a rotation this close to 0, 1 or -1 are; below it is rounding."""


Group: TypeAlias = tuple[list[Factor], list[Expression]]
Followers: TypeAlias = tuple[tuple[int, int], ...]


@dataclass(frozen=True, eq=False)
class PaperJoint:
    """A joint whose axis, offset and rotation are arrays of numbers and expressions."""

    parent: int
    revolute: bool
    axis: AnyArray
    offset: AnyArray
    rotation: AnyArray


@dataclass(frozen=True, eq=False)
class Robot:
    """The geometry and coordinates of a tree, as symbols.

    Attributes:
        n: Number of joints.
        joints: As in a tree.
        q: Joint positions, (n,); likewise velocities qd and accelerations qdd.
        gravity: (3,), bedplate frame.
        values: What the constants' symbols stand for [m, rad, m/s^2].
        parallel: Groups of joints with parallel axes: their coordinates, and the angles
            between bodies that these can turn against each other.
        continued: For each revolute joint, the revolute joints that the body carries whose
            axes are parallel to its own, with 1 or -1 for their sense.
    """

    n: int
    joints: tuple[PaperJoint, ...]
    q: AnyArray
    qd: AnyArray
    qdd: AnyArray
    gravity: AnyArray
    values: dict[Factor, float]
    parallel: tuple[Group, ...]
    continued: tuple[Followers, ...]

    @property
    def weightless(self) -> Robot:
        """The same without gravity."""
        return replace(self, gravity=np.zeros(3, dtype=object))


def draw(tree: Tree, gravity: Array) -> Robot:
    """The robot on paper.

    Args:
        tree: Gives the geometry.
        gravity: (3,) [m/s^2], bedplate frame.
    """
    values: dict[Factor, float] = {}

    def constant(name: str, value: float) -> Expression:
        made = symbol(Nature.CONSTANT, name)
        values[made.terms[0][0][0]] = float(value)
        return made

    joints = []
    for j, joint in enumerate(tree.joints):
        offset = [
            constant(length_name(joint.parent, j, axis), length) if abs(length) > EXACT else 0
            for axis, length in zip("xyz", joint.offset, strict=True)
        ]
        rotation = _named(f"A{j + 1}", _rotation(joint.rotation, j + 1, constant))
        axis = _named(f"e{j + 1}", _axis(joint.axis, j + 1, constant))
        joints.append(PaperJoint(joint.parent, joint.revolute, axis, _objects(offset), rotation))
    q, qd, qdd = (
        _objects([symbol(nature, f"{letter}{j + 1}", j) for j in range(tree.n)])
        for nature, letter in (
            (Nature.POSITION, "q"),
            (Nature.VELOCITY, "qp"),
            (Nature.ACCELERATION, "qpp"),
        )
    )
    parallel, continued = _parallel(tree, q)
    weight = _gravity(gravity, constant)
    return Robot(tree.n, tuple(joints), q, qd, qdd, weight, values, parallel, continued)


def _parallel(tree: Tree, q: AnyArray) -> tuple[tuple[Group, ...], tuple[Followers, ...]]:
    """Groups of parallel axes, and where they follow each other directly; see `Robot`."""
    groups: list[Group] = []
    followers: list[list[tuple[int, int]]] = [[] for _ in tree.joints]
    bodies: dict[int, tuple[int, int, tuple[Expression, ...]]] = {}  # group, sense, angles
    for j, joint in enumerate(tree.joints):
        if not joint.revolute:
            continue
        i, axis = joint.parent, joint.carried_axis
        while i >= 0 and not tree.joints[i].revolute:  # a sliding joint turns nothing
            i, axis = tree.parents[i], tree.joints[i].rotation @ axis
        cosine = float(axis @ tree.joints[i].axis) if i >= 0 else 0.0
        if abs(cosine) > 1.0 - EXACT:
            sign = 1 if cosine > 0 else -1
            group, sense, angles = bodies[i]
            bodies[j] = (group, sense * sign, (*angles, angles[-1] + q[j] * (sense * sign)))
            if joint.parent == i:
                followers[i].append((j, sign))
        else:
            groups.append(([], []))
            bodies[j] = (len(groups) - 1, 1, (q[j],))
        group, _, angles = bodies[j]
        groups[group][0].append(q[j].terms[0][0][0])
        groups[group][1].extend([angles[-1], *(angles[-1] - each for each in angles[:-1])])
    return tuple(groups), tuple(tuple(each) for each in followers)


Constant = Callable[[str, float], Expression]


def _gravity(gravity: Array, constant: Constant) -> AnyArray:
    """(0, 0, -g), or gx gy gz for a direction that is no axis."""
    there = np.flatnonzero(gravity)
    vector = np.zeros(3, dtype=object)
    for axis in there:
        if len(there) == 1:
            size = abs(gravity[axis])
            vector[axis] = constant("g", size) * (1 if gravity[axis] > 0 else -1)
        else:
            vector[axis] = constant("g" + "xyz"[axis], gravity[axis])
    return vector


def _rotation(matrix: Array, label: int, constant: Constant) -> AnyArray:
    """Whole numbers if it is made of quarter turns, else Rz(yaw) Ry(pitch) Rx(roll)."""
    whole = np.round(matrix)
    if np.abs(matrix - whole).max() < EXACT:
        return _whole(whole)
    level = np.hypot(matrix[0, 0], matrix[1, 0])
    pitch = np.arctan2(-matrix[2, 0], level)
    if level > EXACT:
        roll, yaw = np.arctan2(matrix[2, 1], matrix[2, 2]), np.arctan2(matrix[1, 0], matrix[0, 0])
    else:  # straight up or down: only one of the two turns counts
        roll, yaw = 0.0, np.arctan2(-matrix[0, 1], matrix[1, 1])
    product = _whole(np.eye(3))
    for name, angle, axis in (("yaw", yaw, 2), ("pitch", pitch, 1), ("roll", roll, 0)):
        c, s = _turn(f"{name}{label}", float(angle), constant)
        e = np.zeros(3, dtype=object)
        e[axis] = 1
        axial = np.outer(e, e)
        product = product @ (axial + c * (_whole(np.eye(3)) - axial) + s * skew(e))
    return product


def _axis(axis: Array, label: int, constant: Constant) -> AnyArray:
    """Whole numbers if it is an axis of the body, else by the angles turn and lean."""
    whole = np.round(axis)
    if np.abs(axis - whole).max() < EXACT:
        return _whole(whole)
    c, s = _turn(f"turn{label}", float(np.arctan2(axis[1], axis[0])), constant)
    level, up = _turn(
        f"lean{label}", float(np.arctan2(axis[2], np.hypot(axis[0], axis[1]))), constant
    )
    return _objects([level * c, level * s, up])


def _turn(name: str, angle: float, constant: Constant) -> tuple[Any, Any]:
    """Cosine and sine of a constant angle: whole numbers if it is a quarter turn."""
    quarters = round(angle / (np.pi / 2))
    if abs(angle - quarters * np.pi / 2) < EXACT:
        return (1, 0, -1, 0)[quarters % 4], (0, 1, 0, -1)[quarters % 4]
    made = constant(name, angle)
    return cosine(made), sine(made)


def _named(name: str, values: AnyArray) -> AnyArray:
    named = np.empty(values.shape, dtype=object)
    for place in np.ndindex(values.shape):
        named[place] = auxiliary(component(name, place, values.shape), values[place])
    return named


def _whole(values: Array) -> AnyArray:
    return values.astype(int).astype(object)


def _objects(values: list[Any]) -> AnyArray:
    array = np.empty(len(values), dtype=object)
    array[:] = values
    return array
