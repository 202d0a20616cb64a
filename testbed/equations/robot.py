"""A robot on paper: its geometry, coordinates and parameters as symbols.

Lengths that are not zero are symbols. Constant rotations and axes are numbers: whole ones
where they are made of quarter turns, as on most robots. A model file that gives quarter turns
with few digits (1.5708 for half of pi) would fill the equations with terms of a millionth;
`right_angles` takes such turns for what they are meant to be.

Names     q2 qp2 qpp2; l23z offset; g; m2 mass; l22y centre of mass in the body's frame; J2yz
          central inertia; parameters in docs/conventions.md
Source    [FRS96] eqs. (3)-(5), and the first part of its listing
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from testbed.core.base.arrays import AnyArray, Array
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.regroup import length_symbol
from testbed.core.parameters.symbols import (
    UPPER,
    Label,
    component_symbol,
    parameter_names,
    point_mass,
)
from testbed.core.robot.tree import Tree
from testbed.equations.expression import (
    Budget,
    Expression,
    Factor,
    Nature,
    collect,
    expression,
    symbol,
)
from testbed.equations.polynomial import Ring
from testbed.equations.simplify import simplify

MEANT = 1e-4
"""A turn this close to quarter turns [rad] is meant to be one."""
EXACT = 1e-14
"""Below this it is one, but for rounding."""
TINY = 1e-12
"""Of a length [m], or as part of the largest inertia: zero in the file but for rounding."""


def right_angles(tree: Tree) -> Tree:
    """The tree with rotations and axes made of quarter turns where they almost are."""
    joints = tuple(
        replace(joint, rotation=_squared(joint.rotation), axis=_squared(joint.axis))
        for joint in tree.joints
    )
    return replace(tree, joints=joints)


def almost_right(tree: Tree) -> dict[str, float]:
    """Joints with a rotation or axis that `right_angles` would change, and by how much [rad]."""
    found = {}
    for joint, squared in zip(tree.joints, right_angles(tree).joints, strict=True):
        off = max(
            float(np.abs(squared.rotation - joint.rotation).max()),
            float(np.abs(squared.axis - joint.axis).max()),
        )
        if off > EXACT:
            found[joint.name] = off
    return found


def _squared(values: Array) -> Array:
    """Whole numbers, if all of them almost are."""
    whole = np.round(values)
    return whole if np.abs(values - whole).max() < MEANT else values


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


@dataclass(frozen=True)
class Parameter:
    """One entry of the vector of parameters that equations take.

    Attributes:
        label: Its name as a value, such as 2*K3d.
        unit: kg, kg m or kg m^2.
        symbol: What stands for it, or for what it is a multiple of, in the equations; None
            if it is known to be zero.
    """

    label: Label
    unit: str
    symbol: Factor | None

    @classmethod
    def of(cls, label: Label, unit: str, value: Expression | int) -> Parameter:
        """Whose symbol `value` is a multiple of."""
        ((factor,), _) = value.terms[0] if isinstance(value, Expression) else ((None,), 0)
        return cls(label, unit, factor)

    @property
    def name(self) -> str:
        """As in the minimal set; or the barycentric parameter's."""
        return self.label.text

    @property
    def times(self) -> int:
        """How many times the symbol it is."""
        return self.label.times


def columns(known_zero: AnyArray) -> AnyArray:
    """A column a barycentric parameter, (n, 10, 10 n); of zeros where it is known to be zero."""
    units = np.diag((~known_zero).ravel().astype(int)).astype(object)
    return units.reshape(*known_zero.shape, known_zero.size)


def all_parameters(tree: Tree, known_zero: AnyArray) -> AnyArray:
    """Symbols of the barycentric parameters, (n, 10, 1); 0 where known to be zero."""
    theta = np.zeros(10 * tree.n, dtype=object)
    for k, name in enumerate(parameter_names(tree)):
        if not known_zero.ravel()[k]:
            theta[k] = parameter_symbol(name, k // 10)
    return theta.reshape(tree.n, 10, 1)


def minimal_parameters(minimal: MinimalSet) -> AnyArray:
    """Symbols of the minimal parameters, each with its number: delta, (N,).

    2*K3d is twice the symbol K3d; a star becomes an s.
    """
    delta = np.zeros(minimal.count, dtype=object)
    safe = distinct([label.stem.text for label in minimal.labels])
    for k, (label, body) in enumerate(zip(minimal.labels, minimal.bodies, strict=True)):
        delta[k] = parameter_symbol(safe[k], body) * label.times
    return delta


def distinct(names: Sequence[str]) -> list[str]:
    """Identifiers for names, no two alike."""
    found: dict[str, None] = {}
    for name in names:
        safe = identifier(name)
        while safe in found:
            safe += "_"
        found[safe] = None
    return list(found)


def identifier(name: str) -> str:
    """A parameter's name as programs can have it: mb*2z becomes mbs2z, 2*K3d 2K3d."""
    text = re.sub(r"^2\*", "2", name).replace("*", "s")
    return re.sub(r"\W", "_", text, flags=re.ASCII)


def lift(minimal: MinimalSet, columns: AnyArray, n: int) -> AnyArray:
    """Lift times columns, (n, 10, p): barycentric parameters that stand for minimal ones.

    Args:
        minimal: The minimal set.
        columns: (N, p), numbers or symbols.
        n: Number of joints.
    """
    theta = np.zeros((10 * n, columns.shape[1]), dtype=object)
    for row, column in zip(*np.nonzero(minimal.lift), strict=True):
        theta[row] += float(minimal.lift[row, column]) * columns[column]
    return theta.reshape(n, 10, columns.shape[1])


def parameter_symbol(name: str, body: int) -> Expression:
    """The symbol of a parameter; in terms, tensors come first, then moments, then masses.

    Args:
        name: As it stands in equations.
        body: Index of its body.
    """
    return symbol(Nature.PARAMETER, name, 100_000 * _degree(name) + body)


def _degree(name: str) -> int:
    """Tensors 0, moments 1, masses 2."""
    return 2 if name.startswith("mbar") else 1 if name.startswith("mb") else 0


def barycentric_definitions(
    tree: Tree, robot: Robot, known_zero: AnyArray, budget: Budget
) -> list[tuple[str, Expression]]:
    """Name and meaning of every barycentric parameter that is not known to be zero.

    Args:
        tree: The robot.
        robot: The same on paper.
        known_zero: Which are known to be zero, (n, 10). Where a body's own are, so are the
            components of its centre of mass and central inertia that are zero in the file.
        budget: Counts terms.
    """
    masses = _total_masses(tree)
    ring = Ring(budget=budget)
    found = []
    for j in range(tree.n):
        values = _own(tree, j, bool(known_zero[j].any()))
        for child in tree.children(j):
            mass = parameter_symbol(f"mbar{child + 1}", child)
            values[1:] = values[1:] + point_mass(robot.joints[child].offset)[1:] * mass
        values[0] = masses[j]
        for component, (value, zero) in enumerate(zip(values, known_zero[j], strict=True)):
            if not zero:
                shown = simplify(ring, ring.expand(expression(value)), frozenset())
                budget.write(len(shown.terms))
                found.append((component_symbol(j, component).text, shown))
    return sorted(found, key=lambda pair: -_degree(pair[0]))  # as in the paper's listing


def _total_masses(tree: Tree) -> list[Expression]:
    """Of each body, the sum of its mass and of all that it carries."""
    totals = [symbol(Nature.PARAMETER, f"m{j + 1}", j) for j in range(tree.n)]
    for j in reversed(range(tree.n)):
        carried = (term for child in tree.children(j) for term in totals[child].terms)
        totals[j] = collect((*totals[j].terms, *carried))
    return totals


def _own(tree: Tree, j: int, by_file: bool) -> AnyArray:
    """A body's own ten parameters about its frame, of mass, centre and central inertia."""
    inertia, mass = tree.inertias[j], symbol(Nature.PARAMETER, f"m{j + 1}", j)
    centre = np.zeros(3, dtype=object)
    for axis, length in zip(range(3), inertia.com, strict=True):
        if not (by_file and abs(length) < TINY):
            centre[axis] = symbol(Nature.CONSTANT, length_symbol(j, j, "xyz"[axis]).text)
    central = np.zeros(6, dtype=object)
    scale = np.abs(inertia.central).max()
    for k, (a, b) in enumerate(zip(*UPPER, strict=True)):
        if not (by_file and abs(inertia.central[a, b]) < TINY * scale):
            central[k] = symbol(Nature.PARAMETER, f"J{j + 1}{'xyz'[a]}{'xyz'[b]}", j)
    own: AnyArray = point_mass(centre) * mass
    own[4:] = own[4:] + central
    return own
