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
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from testbed.core.base.arrays import AnyArray, Array
from testbed.core.parameters.regroup import length_symbol
from testbed.core.parameters.symbols import UPPER, Label, component_symbol, point_mass
from testbed.core.robot.tree import Tree
from testbed.equations.expression import (
    ZERO,
    Budget,
    Expression,
    Factor,
    Nature,
    expression,
    factor,
    of,
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
    changes = {
        joint.name: max(_change(joint.rotation), _change(joint.axis))
        for joint in tree.joints
    }
    return {name: change for name, change in changes.items() if change > EXACT}


def _change(values: Array) -> float:
    """Largest change by `_squared`."""
    return float(np.abs(_squared(values) - values).max())


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
class SymbolicRobot:
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


def draw(tree: Tree, gravity: Array) -> SymbolicRobot:
    """The robot on paper.

    Args:
        tree: Gives the geometry.
        gravity: (3,) [m/s^2], bedplate frame.
    """
    values: dict[Factor, float] = {}

    def constant(name: str, value: float) -> Expression:
        made = symbol(Nature.CONSTANT, name)
        values[factor(made)] = float(value)
        return made

    joints = []
    for j, joint in enumerate(tree.joints):
        offset = np.zeros(3, dtype=object)
        for k in np.flatnonzero(np.abs(joint.offset) > EXACT):
            name = length_symbol(joint.parent, j, "xyz"[k]).text
            offset[k] = constant(name, joint.offset[k])
        axes = _exact(joint.axis), offset, _exact(joint.rotation)
        joints.append(PaperJoint(joint.parent, joint.revolute, *axes))
    q, qd, qdd = (
        _objects([symbol(nature, f"{letter}{j + 1}", j) for j in range(tree.n)])
        for nature, letter in (
            (Nature.POSITION, "q"),
            (Nature.VELOCITY, "qp"),
            (Nature.ACCELERATION, "qpp"),
        )
    )
    weight = _gravity(gravity, constant)
    return SymbolicRobot(
        tree.n, tuple(joints), q, qd, qdd, weight, values, *_parallel(tree, q)
    )


def _parallel(
    tree: Tree, q: AnyArray
) -> tuple[tuple[Group, ...], tuple[Followers, ...]]:
    """Groups of parallel axes, and where they follow each other directly; see `SymbolicRobot`."""
    groups: list[Group] = []
    followers: list[list[tuple[int, int]]] = [[] for _ in tree.joints]
    bodies: dict[int, tuple[Group, int, list[Expression]]] = {}  # group, sense, angles
    for j, joint in enumerate(tree.joints):
        if not joint.revolute:
            continue
        i, axis = joint.parent, joint.carried_axis
        while i >= 0 and not tree.joints[i].revolute:  # a sliding joint turns nothing
            i, axis = tree.parents[i], tree.joints[i].rotation @ axis
        cosine = float(axis @ tree.joints[i].axis) if i >= 0 else 0.0
        sign = 1 if cosine >= 0 else -1
        group, sense, angles = (
            bodies[i] if abs(cosine) > 1.0 - EXACT else (([], []), 1, [ZERO])
        )
        if len(angles) == 1:
            groups.append(group)
        elif joint.parent == i:
            followers[i].append((j, sign))
        angle = angles[-1] + q[j] * (sense * sign)
        group[0].append(factor(q[j]))
        group[1].extend(angle - each for each in angles)
        bodies[j] = group, sense * sign, [*angles, angle]
    return tuple(groups), tuple(map(tuple, followers))


Constant = Callable[[str, float], Expression]


def _gravity(gravity: Array, constant: Constant) -> AnyArray:
    """(0, 0, -g), or gx gy gz for a direction that is no axis."""
    vector = np.zeros(3, dtype=object)
    if np.count_nonzero(gravity) == 1:
        vector += np.sign(gravity).astype(int) * constant("g", np.abs(gravity).max())
        return vector
    for axis in np.flatnonzero(gravity):
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

    @property
    def name(self) -> str:
        """As in the minimal set; or the barycentric parameter's."""
        return self.label.text

    @property
    def times(self) -> int:
        """How many times the symbol it is."""
        return self.label.times


def parameters(
    labels: Sequence[Label], units: Sequence[str], bodies: Iterable[int], lift: Array
) -> tuple[Parameter, ...]:
    """Parameters that equations take; in symbols a star becomes an s.

    Args:
        labels: (N,).
        units: (N,).
        bodies: Index of the body of each.
        lift: (10 n, N), the barycentric parameters on these; a column of zeros is left out.
    """
    names = distinct([label.stem.text for label in labels])
    symbols = (
        factor(parameter_symbol(name, body)) if column.any() else None
        for name, body, column in zip(names, bodies, lift.T, strict=True)
    )
    return tuple(map(Parameter, labels, units, symbols))


def barycentric(
    parameters: Sequence[Parameter], lift: Array, *, by_column: bool
) -> AnyArray:
    """Barycentric parameters in symbols, (n, 10, 1), or on unit columns, (n, 10, N).

    Args:
        parameters: What they are made of.
        lift: (10 n, N).
        by_column: Whether on unit columns.
    """
    theta = lift.astype(object)
    if not by_column:
        symbols = [
            of(each.symbol) * each.times if each.symbol else 0 for each in parameters
        ]
        theta = (theta @ _objects(symbols))[:, None]
    return theta.reshape(-1, 10, theta.shape[1])


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
    tree: Tree, robot: SymbolicRobot, known_zero: AnyArray, budget: Budget
) -> list[tuple[str, Expression]]:
    """Name and meaning of every barycentric parameter that is not known to be zero.

    Args:
        tree: The robot.
        robot: The same on paper.
        known_zero: Which are known to be zero, (n, 10). Where a body's own are, so are the
            components of its centre of mass and central inertia that are zero in the file.
        budget: Counts terms.
    """
    masses = [symbol(Nature.PARAMETER, f"m{j + 1}", j) for j in range(tree.n)]
    for j in reversed(range(tree.n)):
        if tree.parents[j] >= 0:
            masses[tree.parents[j]] += masses[j]
    ring = Ring(budget=budget)
    found = []
    for j in range(tree.n):
        values = _own(tree, j, bool(known_zero[j].any()))
        for child in tree.children(j):
            mass = parameter_symbol(f"mbar{child + 1}", child)
            values += point_mass(robot.joints[child].offset) * mass
        values[0] = masses[j]
        for component in np.flatnonzero(~known_zero[j]):
            value = expression(values[component])
            shown = simplify(ring, ring.expand(value), frozenset())
            budget.write(len(shown.terms))
            found.append((component_symbol(j, int(component)).text, shown))
    # as in the paper's listing
    return sorted(found, key=lambda pair: -_degree(pair[0]))


def _own(tree: Tree, j: int, by_file: bool) -> AnyArray:
    """A body's own ten parameters about its frame, of mass, centre and central inertia."""
    inertia = tree.inertias[j]
    least = TINY if by_file else 0.0
    centre = [
        symbol(Nature.CONSTANT, length_symbol(j, j, axis).text)
        if abs(length) >= least
        else 0
        for axis, length in zip("xyz", inertia.com, strict=True)
    ]
    least *= np.abs(inertia.central).max()
    central = [
        symbol(Nature.PARAMETER, f"J{j + 1}{'xyz'[a]}{'xyz'[b]}", j)
        if abs(size) >= least
        else 0
        for a, b, size in zip(*UPPER, inertia.central[UPPER], strict=True)
    ]
    own: AnyArray = point_mass(_objects(centre)) * symbol(
        Nature.PARAMETER, f"m{j + 1}", j
    )
    own[4:] += _objects(central)
    return own
