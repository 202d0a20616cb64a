"""A robot on paper: the tree's geometry, coordinates and parameters as symbols.

Lengths that are not zero are symbols. Constant rotations and axes are numbers: whole ones
where they are made of quarter turns, as on most robots.

Names     q2 qp2 qpp2; l23z; g; parameters in docs/conventions.md
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from testbed.arrays import AnyArray, Array
from testbed.parameters.formulas import length_symbol
from testbed.robot.tree import Tree
from testbed.symbolic.angles import EXACT
from testbed.symbolic.expression import Expression, Factor, Nature, symbol

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
        values: What the constants' symbols stand for [m, m/s^2].
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
            constant(length_symbol(joint.parent, j, axis).text, length)
            if abs(length) > EXACT
            else 0
            for axis, length in zip("xyz", joint.offset, strict=True)
        ]
        rotation, axis = _exact(joint.rotation), _exact(joint.axis)
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


def _exact(values: Array) -> AnyArray:
    """Numbers as objects, whole ones where they are whole but for rounding."""
    whole = np.round(values)
    exact = np.abs(values - whole) < EXACT
    return np.where(exact, whole.astype(int).astype(object), values.astype(object))


def _objects(values: list[Any]) -> AnyArray:
    array = np.empty(len(values), dtype=object)
    array[:] = values
    return array
