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

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import Array, readonly
from testbed.parameters.exact_recursion import NEW, told
from testbed.parameters.minimal_set import MinimalSet
from testbed.parameters.row_space import beyond
from testbed.robot.friction import OFFSET, ROTOR, JointLaw, JointTerm, joint_law, joint_terms
from testbed.robot.tree import Tree


@dataclass(frozen=True, eq=False)
class DriveSet:
    """The minimal parameters of bodies and drives together, for the joint torques.

    The unknowns are the minimal parameters of the bodies, to which regrouped terms may have
    been added, and then the terms with a column of their own.

    Attributes:
        minimal: The dynamic set.
        asked: All terms, law by law, each in tree order.
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
        return (*self.minimal.units, *(term.unit(self._tree) for term in self.terms))

    @cached_property
    def matrix(self) -> Array:
        """The unknowns on the 10 n barycentric parameters and the asked terms."""
        n = self.minimal.matrix.shape[1]
        matrix = np.zeros((self.count, n + len(self.asked)))
        matrix[: self.minimal.count, :n] = self.minimal.matrix
        matrix[:, n:] = self.columns
        return readonly(matrix, matrix.shape, "matrix")

    def values(self, theta: ArrayLike, tree: Tree) -> Array:
        """The unknowns, (count,).

        Args:
            theta: Barycentric parameters, (n, 10).
            tree: Gives the coefficients of the terms.
        """
        terms = [float(term.law.coefficients(tree)[term.joint]) for term in self.asked]
        found: Array = self.columns @ np.array(terms)
        found[: self.minimal.count] += self.minimal.values(theta)
        return found

    def name(self, term: JointTerm) -> str:
        """Name of a term: rotor/waist."""
        return term.name(self._tree)

    def _absorbed(self, unknown: int) -> Iterator[tuple[JointTerm, float]]:
        """Terms without a column of their own that add to an unknown, with their factors."""
        for term, column in self.regrouped.items():
            if column[unknown]:
                yield term, float(column[unknown])


def with_joint_terms(tree: Tree, minimal: MinimalSet, laws: Sequence[str | JointLaw]) -> DriveSet:
    """The minimal set of bodies and drives together, exact and before any data.

    Args:
        tree: The robot; only its geometry matters.
        minimal: Its dynamic set.
        laws: Of the joints' own torque, by name or as values; each holds at every joint.

    Raises:
        UnknownName: There is no such law.
        ValueError: The set is not the joint torques'.
    """
    if minimal.model != "dynamic":
        raise ValueError(f"joint terms belong to the dynamic set, this is the {minimal.model} one")
    wanted = dict.fromkeys(joint_law(law) if isinstance(law, str) else law for law in laws)
    asked = joint_terms(tree, wanted)
    lone = _lone(tree, minimal.gravity, OFFSET in wanted)
    terms = tuple(term for term in asked if term.law != ROTOR or term.joint not in lone)
    columns = np.zeros((minimal.count + len(terms), len(asked)))
    for k, term in enumerate(asked):
        if term in terms:
            columns[minimal.count + terms.index(term), k] = 1.0
        else:
            columns[minimal.axial.index(term.joint), k] = 1.0
            if lone[term.joint]:
                row = minimal.count + terms.index(JointTerm(OFFSET, term.joint))
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
