"""Bodies and drives together: which term of a joint has a column of its own.

The joint torques hold, besides the bodies' dynamics, terms of the joints themselves: a rotor
adds qdd_j to row j, an offset a constant, friction functions of qd_j. Friction always has
columns of its own, because without it the torques are even in the velocities. A rotor has
one unless nothing but the joint's own acceleration tells the inertia it adds to; then
both are one number, the minimal parameter of that inertia. An offset has one always; where
a rotor is regrouped with a mass of constant weight, the offset takes up the weight.

Source    derived for this project (docs/minimal-sets.md)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from testbed.arrays import Array, readonly
from testbed.errors import UnknownName
from testbed.parameters.exact_recursion import NEW, told
from testbed.parameters.minimal_set import MinimalSet
from testbed.parameters.row_space import beyond
from testbed.robot.tree import Tree

Kind = Literal["coulomb", "viscous", "offset", "rotor"]
KINDS: tuple[Kind, ...] = ("coulomb", "viscous", "offset", "rotor")
"""A joint's own columns: sign(qd), qd, 1, qdd."""

UNITS = {
    "coulomb": ("N m", "N"),
    "viscous": ("N m s/rad", "N s/m"),
    "offset": ("N m", "N"),
    "rotor": ("kg m^2", "kg"),
}
"""Of a term's coefficient, at a revolute and at a prismatic joint."""


@dataclass(frozen=True)
class JointTerm:
    """One term of one joint.

    Attributes:
        kind: One of KINDS.
        joint: Index of the joint.
    """

    kind: Kind
    joint: int


@dataclass(frozen=True, eq=False)
class DriveSet:
    """The minimal parameters of bodies and drives together, for the joint torques.

    The unknowns are the minimal parameters of the bodies, to which regrouped terms may have
    been added, and then the terms with a column of their own.

    Attributes:
        minimal: The dynamic set.
        asked: All terms, kind by kind, each in tree order.
        terms: Those with a column of their own, in the same order.
        columns: What a unit of every asked term adds to the unknowns, (count, asked).
    """

    minimal: MinimalSet
    asked: tuple[JointTerm, ...]
    terms: tuple[JointTerm, ...]
    columns: Array
    _tree: Tree

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return self.minimal.count + len(self.terms)

    @cached_property
    def regrouped(self) -> Mapping[JointTerm, Array]:
        """Terms without a column of their own: what each adds to the unknowns, (count,)."""
        return {
            term: self.columns[:, k] for k, term in enumerate(self.asked) if term not in self.terms
        }

    @cached_property
    def names(self) -> tuple[str, ...]:
        """One an unknown: K3yy, K*1zz+rotor/waist, coulomb/waist, ..."""
        plain = (*self.minimal.names, *(self.name(term) for term in self.terms))
        joined = [list(self._absorbed(k)) for k in range(self.count)]
        return tuple(
            "+".join((name, *(self.name(term) for term, _ in terms)))
            for name, terms in zip(plain, joined, strict=True)
        )

    @property
    def units(self) -> tuple[str, ...]:
        """One an unknown."""
        own = (UNITS[t.kind][not self._tree.joints[t.joint].revolute] for t in self.terms)
        return (*self.minimal.units, *own)

    @cached_property
    def matrix(self) -> Array:
        """The unknowns on the 10 n barycentric parameters and the asked terms."""
        n = self.minimal.matrix.shape[1]
        matrix = np.zeros((self.count, n + len(self.asked)))
        matrix[: self.minimal.count, :n] = self.minimal.matrix
        matrix[:, n:] = self.columns
        return readonly(matrix, matrix.shape, "matrix")

    def name(self, term: JointTerm) -> str:
        """Name of a term: rotor/waist."""
        return f"{term.kind}/{self._tree.names[term.joint]}"

    def _absorbed(self, unknown: int) -> Iterator[tuple[JointTerm, float]]:
        """Terms without a column of their own that add to an unknown, with their factors."""
        for term, column in self.regrouped.items():
            if column[unknown]:
                yield term, float(column[unknown])


def with_joint_terms(tree: Tree, minimal: MinimalSet, kinds: Sequence[Kind]) -> DriveSet:
    """The minimal set of bodies and drives together, exact and before any data.

    Args:
        tree: The robot; only its geometry matters.
        minimal: Its dynamic set.
        kinds: Of terms, each for every joint.

    Raises:
        UnknownName: There is no such kind of term.
        ValueError: The set is not the joint torques'.
    """
    for kind in kinds:
        if kind not in KINDS:
            raise UnknownName("joint term", kind, KINDS)
    if minimal.model != "dynamic":
        raise ValueError(f"joint terms belong to the dynamic set, this is the {minimal.model} one")
    asked = tuple(JointTerm(kind, j) for kind in dict.fromkeys(kinds) for j in range(tree.n))
    lone = _lone(tree, minimal.gravity, "offset" in kinds)
    terms = tuple(term for term in asked if term.kind != "rotor" or term.joint not in lone)
    columns = np.zeros((minimal.count + len(terms), len(asked)))
    for k, term in enumerate(asked):
        if term in terms:
            columns[minimal.count + terms.index(term), k] = 1.0
        else:
            columns[minimal.axial.index(term.joint), k] = 1.0
            if lone[term.joint]:
                row = minimal.count + terms.index(JointTerm("offset", term.joint))
                columns[row, k] = -lone[term.joint]
    return DriveSet(minimal, asked, terms, readonly(columns, columns.shape, "columns"), tree)


def _lone(tree: Tree, gravity: Array, offsets: bool) -> dict[int, float]:
    """Joints whose own acceleration alone tells the inertia that it moves.

    Returns:
        By joint, the constant force per unit of that inertia which an offset takes up.
    """
    found = {}
    for j, each in enumerate(told(tree, "dynamic", gravity, np.zeros((0, 10)))):
        known = each.aside
        inertia, weight = beyond(each.inertia, known), beyond(each.weight, known)
        size, heavy = float(np.linalg.norm(inertia)), float(np.linalg.norm(weight))
        if size <= NEW * np.linalg.norm(each.inertia):
            continue
        if heavy <= NEW * max(1.0, float(np.linalg.norm(each.weight))):
            found[j] = 0.0
        elif offsets:
            found[j] = float(weight @ inertia) / size**2
    return found
