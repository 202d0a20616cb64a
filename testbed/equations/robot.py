"""Symbolic robot: geometry, joint coordinates and parameters as symbols.

Lengths that are not zero are symbols. Constant rotations and axes are numbers: integers if they
consist of quarter turns, as on most robots. Quarter turns with few digits in a model file (1.5708
for pi / 2) would give many terms with coefficients of about a millionth; `with_right_angles` rounds
these rotations.

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
from testbed.core.parameters.symbols import (
    UPPER_TRIANGLE,
    Label,
    component_symbol,
    point_mass_parameters,
)
from testbed.core.robot.tree import Tree
from testbed.equations.expression import (
    ZERO,
    Budget,
    Expression,
    Factor,
    FactorKind,
    expression,
    factor_expression,
    single_factor,
    symbol,
)
from testbed.equations.polynomial import PolynomialRing
from testbed.equations.simplify import simplify

RIGHT_ANGLE_TOLERANCE = 1e-4
"""Deviation from a right angle below which a rotation is rounded to it [rad]."""
ROUNDING_TOLERANCE = 1e-14
"""Deviation from a whole number below which it is a rounding error."""
ZERO_TOLERANCE = 1e-12
"""Length [m], or inertia relative to the body's largest, below which it is zero."""


def with_right_angles(tree: Tree) -> Tree:
    """Tree in which almost right angles between joint frames are rounded to right angles.

    A joint's rotation or axis is rounded if all its entries are within 1e-4 of whole numbers.
    """
    joints = tuple(
        replace(
            joint,
            rotation=_rounded_turns(joint.rotation),
            axis=_rounded_turns(joint.axis),
        )
        for joint in tree.joints
    )
    return replace(tree, joints=joints)


def near_right_angles(tree: Tree) -> dict[str, float]:
    """Deviations from right angles [rad], keyed by joint.

    Only joints that `with_right_angles` changes are included.
    """
    changes = {
        joint.name: max(
            _largest_rounding(joint.rotation), _largest_rounding(joint.axis)
        )
        for joint in tree.joints
    }
    return {
        name: change for name, change in changes.items() if change > ROUNDING_TOLERANCE
    }


def _largest_rounding(values: Array) -> float:
    """Largest change of an entry that `_rounded_turns` makes."""
    return float(np.abs(_rounded_turns(values) - values).max())


def _rounded_turns(values: Array) -> Array:
    """Array rounded to whole numbers if all its entries are almost whole; else unchanged."""
    rounded = np.round(values)
    return rounded if np.abs(values - rounded).max() < RIGHT_ANGLE_TOLERANCE else values


ParallelGroup: TypeAlias = tuple[list[Factor], list[Expression]]
ParallelChildren: TypeAlias = tuple[tuple[int, int], ...]


@dataclass(frozen=True, eq=False)
class SymbolicJoint:
    """Joint with axis, offset and rotation as arrays of numbers and expressions.

    Attributes:
        parent: Index of the carrying body; -1 for the bedplate.
        revolute: True for a revolute, False for a prismatic joint.
        axis: Unit vector of the joint axis in the moved body's frame, as numbers, (3,).
        offset: Offset from the carrying body's origin, in the carrying body's frame, as symbols or
            zero, (3,).
        rotation: Rotation matrix from the moved body's frame at q = 0 to the carrying body's frame,
            (3, 3).
    """

    parent: int
    revolute: bool
    axis: AnyArray
    offset: AnyArray
    rotation: AnyArray


@dataclass(frozen=True, eq=False)
class SymbolicRobot:
    """Geometry and joint coordinates of a tree, as symbols.

    Attributes:
        n: Number of joints.
        joints: Joints in tree order.
        q: Joint positions, (n,).
        qd: Joint velocities, (n,).
        qdd: Joint accelerations, (n,).
        gravity: Gravity in the bedplate frame, (3,).
        values: Values of the constants' symbols [m, m/s^2].
        parallel_groups: Groups of joints with parallel axes: the coordinates of the joints, and the
            angles between pairs of the joints' bodies.
        parallel_children: For each revolute joint, the revolute child joints with a parallel axis:
            joint index, and 1 or -1 for the same or opposite direction.
    """

    n: int
    joints: tuple[SymbolicJoint, ...]
    q: AnyArray
    qd: AnyArray
    qdd: AnyArray
    gravity: AnyArray
    values: dict[Factor, float]
    parallel_groups: tuple[ParallelGroup, ...]
    parallel_children: tuple[ParallelChildren, ...]


def symbolic_robot(tree: Tree, gravity: Array) -> SymbolicRobot:
    """Symbolic robot of a tree.

    Args:
        tree: The robot.
        gravity: Gravity in the bedplate frame, (3,) [m/s^2].
    """
    values: dict[Factor, float] = {}

    def constant(name: str, value: float) -> Expression:
        constant_symbol = symbol(FactorKind.CONSTANT, name)
        values[single_factor(constant_symbol)] = float(value)
        return constant_symbol

    joints = []
    for j, joint in enumerate(tree.joints):
        offset = np.zeros(3, dtype=object)
        for k in np.flatnonzero(np.abs(joint.offset) > ROUNDING_TOLERANCE):
            name = length_symbol(joint.parent, j, "xyz"[k]).text
            offset[k] = constant(name, joint.offset[k])
        geometry = _with_integers(joint.axis), offset, _with_integers(joint.rotation)
        joints.append(SymbolicJoint(joint.parent, joint.revolute, *geometry))
    q, qd, qdd = (
        _object_array([symbol(nature, f"{letter}{j + 1}", j) for j in range(tree.n)])
        for nature, letter in (
            (FactorKind.POSITION, "q"),
            (FactorKind.VELOCITY, "qp"),
            (FactorKind.ACCELERATION, "qpp"),
        )
    )
    gravity_vector = _symbolic_gravity(gravity, constant)
    return SymbolicRobot(
        tree.n,
        tuple(joints),
        q,
        qd,
        qdd,
        gravity_vector,
        values,
        *_parallel_joints(tree, q),
    )


def _parallel_joints(
    tree: Tree, q: AnyArray
) -> tuple[tuple[ParallelGroup, ...], tuple[ParallelChildren, ...]]:
    """Groups of parallel joints, and parallel child joints; see `SymbolicRobot`."""
    groups: list[ParallelGroup] = []
    followers: list[list[tuple[int, int]]] = [[] for _ in tree.joints]
    bodies: dict[
        int, tuple[ParallelGroup, int, list[Expression]]
    ] = {}  # group, sense, angles
    for j, joint in enumerate(tree.joints):
        if not joint.revolute:
            continue
        i, axis = joint.parent, joint.carried_axis
        while (
            i >= 0 and not tree.joints[i].revolute
        ):  # a prismatic joint does not rotate
            i, axis = tree.parents[i], tree.joints[i].rotation @ axis
        cosine = float(axis @ tree.joints[i].axis) if i >= 0 else 0.0
        sign = 1 if cosine >= 0 else -1
        group, sense, angles = (
            bodies[i]
            if abs(cosine) > 1.0 - ROUNDING_TOLERANCE
            else (([], []), 1, [ZERO])
        )
        if len(angles) == 1:
            groups.append(group)
        elif joint.parent == i:
            followers[i].append((j, sign))
        angle = angles[-1] + q[j] * (sense * sign)
        group[0].append(single_factor(q[j]))
        group[1].extend(angle - each for each in angles)
        bodies[j] = group, sense * sign, [*angles, angle]
    return tuple(groups), tuple(map(tuple, followers))


ConstantFactory = Callable[[str, float], Expression]


def _symbolic_gravity(gravity: Array, constant: ConstantFactory) -> AnyArray:
    """Symbolic gravity, (3,): g or -g along an axis, such as (0, 0, -g); else (gx, gy, gz)."""
    vector = np.zeros(3, dtype=object)
    if np.count_nonzero(gravity) == 1:
        vector += np.sign(gravity).astype(int) * constant("g", np.abs(gravity).max())
        return vector
    for axis in np.flatnonzero(gravity):
        vector[axis] = constant("g" + "xyz"[axis], gravity[axis])
    return vector


def _with_integers(values: Array) -> AnyArray:
    """Object array of numbers, with integers for entries that are almost whole."""
    rounded = np.round(values)
    is_whole = np.abs(values - rounded) < ROUNDING_TOLERANCE
    return np.where(is_whole, rounded.astype(int).astype(object), values.astype(object))


def _object_array(values: list[Any]) -> AnyArray:
    """One-dimensional object array of values."""
    array = np.empty(len(values), dtype=object)
    array[:] = values
    return array


@dataclass(frozen=True)
class Parameter:
    """Entry of the parameter vector of equations.

    Attributes:
        label: Name as a multiple of a sum of symbols, such as 2*K3d.
        unit: "kg", "kg m" or "kg m^2".
        symbol: Symbol of the parameter without its multiple; None for a parameter that is known to
            be zero.
    """

    label: Label
    unit: str
    symbol: Factor | None

    @property
    def name(self) -> str:
        """Name of the minimal or barycentric parameter."""
        return self.label.text

    @property
    def multiple(self) -> int:
        """Multiple of the symbol, such as 2 for 2*K3d."""
        return self.label.multiple


def parameters(
    labels: Sequence[Label], units: Sequence[str], bodies: Iterable[int], lift: Array
) -> tuple[Parameter, ...]:
    """Entries of the parameter vector of equations, with their symbols.

    Args:
        labels: Names of the parameters, (N,).
        units: Units of the parameters, (N,).
        bodies: Body index of each parameter.
        lift: Matrix from the N parameters to the barycentric parameters, (10 n, N); a parameter
            with a zero column gets no symbol.
    """
    names = unique_identifiers([label.without_multiple.text for label in labels])
    symbols = (
        single_factor(parameter_symbol(name, body)) if column.any() else None
        for name, body, column in zip(names, bodies, lift.T, strict=True)
    )
    return tuple(map(Parameter, labels, units, symbols))


def barycentric(
    parameters: Sequence[Parameter], lift: Array, *, by_column: bool
) -> AnyArray:
    """Barycentric parameters as symbols, (n, 10, 1), or as columns, (n, 10, N).

    For each body, they are mbar, mb x y z and K xx xy xz yy yz zz in the body frame.

    Args:
        parameters: Entries of the parameter vector.
        lift: Matrix from the N parameters to the barycentric parameters, (10 n, N).
        by_column: True for one column per parameter, as for a regressor; False for symbols.
    """
    theta = lift.astype(object)
    if not by_column:
        symbols = [
            factor_expression(each.symbol) * each.multiple if each.symbol else 0
            for each in parameters
        ]
        theta = (theta @ _object_array(symbols))[:, None]
    return theta.reshape(-1, 10, theta.shape[1])


def unique_identifiers(names: Sequence[str]) -> list[str]:
    """Unique identifiers of parameter names, in order; underscores are appended to duplicates."""
    identifiers: dict[str, None] = {}
    for name in names:
        candidate = identifier(name)
        while candidate in identifiers:
            candidate += "_"
        identifiers[candidate] = None
    return list(identifiers)


def identifier(name: str) -> str:
    """Parameter name without special characters: mbs2z for mb*2z, 2K3d for 2*K3d."""
    text = re.sub(r"^2\*", "2", name).replace("*", "s")
    return re.sub(r"\W", "_", text, flags=re.ASCII)


def parameter_symbol(name: str, body: int) -> Expression:
    """Symbol of a parameter, ranked by kind and body.

    Within a term, second moments come first, then first moments, then masses.

    Args:
        name: Name in the equations.
        body: Body index.
    """
    return symbol(FactorKind.PARAMETER, name, 100_000 * _kind_rank(name) + body)


def _kind_rank(name: str) -> int:
    """Rank of a parameter by kind: second moments 0, first moments 1, masses 2."""
    return 2 if name.startswith("mbar") else 1 if name.startswith("mb") else 0


def barycentric_definitions(
    tree: Tree, robot: SymbolicRobot, known_zero: AnyArray, budget: Budget
) -> list[tuple[str, Expression]]:
    """Names and definitions of the barycentric parameters that are not known to be zero.

    Second moments come first, then first moments, then masses, as in the listing of [FRS96].

    Args:
        tree: The robot.
        robot: Symbolic robot of the tree.
        known_zero: Mask of the parameters known to be zero, (n, 10). For a body with known
            zeros, components of centre of mass and central inertia that are zero in the model
            file are zero in the definitions, too.
        budget: Counter of terms.
    """
    masses = [symbol(FactorKind.PARAMETER, f"m{j + 1}", j) for j in range(tree.n)]
    for j in reversed(range(tree.n)):
        if tree.parents[j] >= 0:
            masses[tree.parents[j]] += masses[j]
    ring = PolynomialRing(budget=budget)
    definitions = []
    for j in range(tree.n):
        components = _standard_parameters(tree, j, bool(known_zero[j].any()))
        for child in tree.children(j):
            mass = parameter_symbol(f"mbar{child + 1}", child)
            components += point_mass_parameters(robot.joints[child].offset) * mass
        components[0] = masses[j]
        for component in np.flatnonzero(~known_zero[j]):
            value = expression(components[component])
            definition = simplify(ring, ring.expand(value), frozenset())
            budget.write(len(definition.terms))
            definitions.append((component_symbol(j, int(component)).text, definition))
    # order of the listing in [FRS96]
    return sorted(definitions, key=lambda pair: -_kind_rank(pair[0]))


def _standard_parameters(tree: Tree, j: int, by_file: bool) -> AnyArray:
    """Standard parameters of a body in symbols, (10,).

    They are m mx my mz Ixx Ixy Ixz Iyy Iyz Izz in the body frame, as functions of mass, centre of
    mass and central inertia.

    Args:
        tree: The robot.
        j: Body index.
        by_file: True to use zero for components that are zero in the model file.
    """
    inertia = tree.inertias[j]
    tolerance = ZERO_TOLERANCE if by_file else 0.0
    centre = [
        symbol(FactorKind.CONSTANT, length_symbol(j, j, axis).text)
        if abs(length) >= tolerance
        else 0
        for axis, length in zip("xyz", inertia.com, strict=True)
    ]
    tolerance *= np.abs(inertia.central).max()
    central = [
        symbol(FactorKind.PARAMETER, f"J{j + 1}{'xyz'[a]}{'xyz'[b]}", j)
        if abs(moment) >= tolerance
        else 0
        for a, b, moment in zip(
            *UPPER_TRIANGLE, inertia.central[UPPER_TRIANGLE], strict=True
        )
    ]
    parameters: AnyArray = point_mass_parameters(_object_array(centre)) * symbol(
        FactorKind.PARAMETER, f"m{j + 1}", j
    )
    parameters[4:] += _object_array(central)
    return parameters
