"""Barycentric parameters: what a body and all it carries look like from its joint.

Everything a body carries counts as a point mass at the joint that carries it; the ten
numbers are constant in the body frame and the equations of motion are linear in them.

Order     (mbar, mbx, mby, mbz, Kxx, Kxy, Kxz, Kyy, Kyz, Kzz), body by body
Signs     K holds tensor components: Kyz = -integral y z dm
Source    [FRS96] eqs. (3)-(5)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.arrays import AnyArray, Array, readonly, skew
from testbed.parameters.symbols import Symbol
from testbed.robot.inertia import Inertia
from testbed.robot.tree import Tree

_PARTS = (
    ("mbar", ""),
    *(("mb", axis) for axis in "xyz"),
    *(("K", pair) for pair in ("xx", "xy", "xz", "yy", "yz", "zz")),
)

COMPONENTS = tuple(head + tail for head, tail in _PARTS)
"""Order of a body's barycentric parameters: mbar, mbx, mby, mbz, Kxx, Kxy, ... Kzz."""

STANDARD = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Order of a body's standard parameters, about and along its frame (Pinocchio's order)."""

UNIT_OF = {"mbar": "kg", "mb": "kg m", "K": "kg m^2"}
"""Units of masses, moments and tensors."""

UNITS = tuple(UNIT_OF[head] for head, _ in _PARTS)
"""Units of a body's ten, barycentric or standard."""

UPPER = np.triu_indices(3)
"""Where the six numbers of a tensor stand in it, row by row."""

TENSOR_INDEX = ((0, 1, 2), (1, 3, 4), (2, 4, 5))
"""Where the component (a, b) of a tensor stands among its six numbers, barycentric order."""

TENSOR: Array = np.eye(6)[np.array(TENSOR_INDEX)]
"""The tensor of six numbers, (3, 3, 6): K[a, b] = sum over k of TENSOR[a, b, k] K6[k]."""

_TO_STANDARD_ORDER = (0, 1, 2, 3, 4, 5, 7, 6, 8, 9)  # swaps Kxz and Kyy; its own inverse


def standard(tree: Tree) -> Array:
    """Standard parameters of every body, (n, 10) in the order STANDARD [kg, kg m, kg m^2]."""
    rows = [
        (inertia.mass, *inertia.first_moment, *inertia.tensor[UPPER]) for inertia in tree.inertias
    ]
    return readonly(np.array(rows)[:, _TO_STANDARD_ORDER], (tree.n, 10), "standard")


def with_standard(tree: Tree, standard: Array) -> Tree:
    """The same tree with bodies of other standard parameters.

    Args:
        tree: The robot.
        standard: (n, 10) in the order STANDARD [kg, kg m, kg m^2].
    """
    tensors = standard[:, _TO_STANDARD_ORDER][:, 4:] @ np.moveaxis(TENSOR, 2, 0).reshape(6, 9)
    bodies = [
        Inertia(own[0], own[1:4], tensor.reshape(3, 3))
        for own, tensor in zip(standard, tensors, strict=True)
    ]
    return replace(tree, inertias=tuple(bodies))


def barycentric(tree: Tree) -> Array:
    """Barycentric parameters theta of every body, (n, 10) [kg, kg m, kg m^2].

    [FRS96] eqs. (3)-(5). Row j is in body j's frame, in the order COMPONENTS.
    """
    return readonly(to_barycentric(tree, standard(tree)), (tree.n, 10), "theta")


def to_barycentric(tree: Tree, standard: AnyArray) -> AnyArray:
    """Augment every body by what it carries, set as point masses at the joints.

    [FRS96] eqs. (3)-(5), as a recursion over children; linear in the argument.

    Args:
        tree: Gives parents and offsets.
        standard: (n, 10, ...) in the order STANDARD, numbers or symbols.

    Returns:
        theta, (n, 10, ...) in the order COMPONENTS.
    """
    theta = standard[:, _TO_STANDARD_ORDER].copy()
    for j in reversed(range(tree.n)):
        if tree.parents[j] >= 0:
            mass = point_mass(tree.joints[j].offset)
            theta[tree.parents[j]] += np.multiply.outer(mass, theta[j, 0])
    return theta


def on_standard(tree: Tree, rows: Array) -> Array:
    """Rows on the barycentric parameters as rows on the standard ones, (k, 10 n) both.

    The transpose of `to_barycentric`: rows theta = on_standard(rows) standard.
    """
    own = rows.reshape(-1, tree.n, 10).copy()
    for j in range(tree.n):
        if tree.parents[j] >= 0:
            own[:, j, 0] += own[:, tree.parents[j]] @ point_mass(tree.joints[j].offset)
    return own[:, :, _TO_STANDARD_ORDER].reshape(rows.shape)


def to_standard(tree: Tree, theta: AnyArray) -> AnyArray:
    """The inverse of `to_barycentric`: (n, 10, ...) COMPONENTS -> (n, 10, ...) STANDARD."""
    own = theta.copy()
    for j in range(tree.n):
        if tree.parents[j] >= 0:
            mass = point_mass(tree.joints[j].offset)
            own[tree.parents[j]] -= np.multiply.outer(mass, theta[j, 0])
    standard: AnyArray = own[:, _TO_STANDARD_ORDER]
    return standard


def parameter_symbols(tree: Tree) -> tuple[Symbol, ...]:
    """The 10 n barycentric parameters, body 1 first: mbar1, mb1x, ... K1zz, mbar2, ..."""
    return tuple(component_symbol(body, c) for body in range(tree.n) for c in range(10))


def parameter_names(tree: Tree) -> tuple[str, ...]:
    """Their names."""
    return tuple(symbol.text for symbol in parameter_symbols(tree))


def component_symbol(body: int, component: int, star: bool = False) -> Symbol:
    """One of the ten parameters of a body.

    Args:
        body: Index of the body, from 0; its number is one more.
        component: Index of COMPONENTS.
        star: The redefined parameter; a mass is never redefined.
    """
    head, tail = _PARTS[component]
    return Symbol(head, (body + 1,), tail, star and head != "mbar")


def point_mass(offset: AnyArray) -> AnyArray:
    """Ten barycentric parameters of a unit point mass, (10,) in the order COMPONENTS.

    Args:
        offset: Where it is, (3,) [m], numbers or symbols.
    """
    tensor = -skew(offset) @ skew(offset)
    return np.concatenate([[1.0], offset, tensor[UPPER]])
