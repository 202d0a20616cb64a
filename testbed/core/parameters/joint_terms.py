"""Bodies and drives together: which term of a joint has a column of its own.

The joint torques hold, besides the bodies' dynamics, terms of the joints themselves: a rotor
adds qdd_j to row j, an offset a constant, friction functions of qd_j. Friction always has
columns of its own, because without it the torques are even in the velocities. A rotor has
one unless nothing but the joint's own acceleration identifies the inertia it adds to; then
both are one number, the minimal parameter of that inertia. An offset has one always; where
a rotor is regrouped with a mass of constant weight, the offset takes up the weight.

Source    derived for this project (docs/minimal-sets.md)
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array, readonly
from testbed.core.base.codec import named
from testbed.core.base.summary_table import Value
from testbed.core.parameters.elimination import INDEPENDENT, echelon
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.regroup import NEW, Lengths, beyond, seen_wrenches
from testbed.core.parameters.symbols import DriveSymbol, Formula, Label, Term
from testbed.core.robot.friction import CONSTANTS, ROTOR, JointTerm, joint_terms
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.shafts import places
from testbed.core.robot.tree import Tree


@dataclass(frozen=True, eq=False)
class DriveSet(Value):
    """The minimal parameters of bodies and drives together, for the joint torques.

    The unknowns are the minimal parameters of the bodies, to which regrouped terms may have
    been added, and then the terms with a column of their own.

    Attributes:
        minimal: The dynamic set.
        asked: All terms, law by law, each in tree order.
        terms: Those with a column of their own, in the same order.
        columns: What a unit of every asked term adds to the unknowns, (count, asked).
        tree: The robot; only its geometry and its shafts matter.
    """

    minimal: MinimalSet
    asked: tuple[JointTerm, ...]
    terms: tuple[JointTerm, ...]
    columns: Array
    tree: Tree

    __get_pydantic_core_schema__ = named(
        lambda found: [term.name(found.tree) for term in found.asked]
    )

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return self.minimal.count + len(self.terms)

    @cached_property
    def regrouped(self) -> Mapping[JointTerm, Array]:
        """Terms without a column of their own: what each adds to the unknowns, (count,)."""
        own = set(self.terms)
        return {
            term: self.columns[:, k]
            for k, term in enumerate(self.asked)
            if term not in own
        }

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """Names as values: what each unknown is the sum of."""
        own = (Label((Term(self.symbol(term)),)) for term in self.terms)
        plain = (*self.minimal.labels, *own)
        return tuple(
            Label((*label.terms, *self._added(k))) for k, label in enumerate(plain)
        )

    @property
    def names(self) -> tuple[str, ...]:
        """One an unknown: K3yy, K*1zz+rotor/waist, coulomb/waist, ..."""
        return tuple(label.text for label in self.labels)

    @property
    def units(self) -> tuple[str, ...]:
        """One an unknown."""
        return (*self.minimal.units, *(term.unit(self.tree) for term in self.terms))

    @cached_property
    def matrix(self) -> Array:
        """The unknowns on the 10 n barycentric parameters and the asked terms."""
        n = self.minimal.matrix.shape[1]
        matrix = np.zeros((self.count, n + len(self.asked)))
        matrix[: self.minimal.count, :n] = self.minimal.matrix
        matrix[:, n:] = self.columns
        return readonly(matrix, matrix.shape, "matrix")

    @cached_property
    def formulas(self) -> tuple[Formula, ...]:
        """How each is made up: K*1zz + rotor/waist = K1zz + K*2xx/2 + ... + rotor/waist."""
        return self.formulas_with("symbols")

    def formulas_with(self, lengths: Lengths) -> tuple[Formula, ...]:
        """The formulas, with the model's lengths as symbols or as numbers.

        Args:
            lengths: "symbols" prints l12z, "numbers" its value.
        """
        own = ((Term(self.symbol(term)),) for term in self.terms)
        plain = (*(f.right for f in self.minimal.formulas_with(lengths)), *own)
        return tuple(
            Formula(label, (*right, *self._added(k)))
            for k, (label, right) in enumerate(zip(self.labels, plain, strict=True))
        )

    def values(
        self,
        theta: ArrayLike,
        tree: Tree,
        added: Mapping[JointLaw, Any] = MappingProxyType({}),
    ) -> Array:
        """The unknowns, (count,).

        Args:
            theta: Barycentric parameters, (n, 10).
            tree: Gives the coefficients of the terms.
            added: To a law's coefficients, one or (n,).
        """
        terms = [
            (term.law.coefficients(tree) + added.get(term.law, 0.0))[term.joint]
            if term.joint < tree.n
            else 0.0
            for term in self.asked
        ]
        found: Array = self.columns @ np.array(terms)
        found[: self.minimal.count] += self.minimal.values(theta)
        return found

    def symbol(self, term: JointTerm) -> DriveSymbol:
        """Name of a term as a value: rotor/waist."""
        return DriveSymbol(term.law.kind, places(self.tree)[term.joint])

    def _added(self, unknown: int) -> Iterator[Term]:
        """Terms without a column of their own that add to an unknown."""
        for term, column in self.regrouped.items():
            if column[unknown]:
                yield Term(self.symbol(term), ((float(column[unknown]), None),))


def with_joint_terms(
    tree: Tree, minimal: MinimalSet, laws: Sequence[str | JointLaw]
) -> DriveSet:
    """The minimal set of bodies and drives together, exact and before any data.

    Args:
        tree: The robot; only its geometry matters.
        minimal: Its dynamic set.
        laws: Of the joints' own torque, by name or as values; each holds at every joint, or, as
            "rotor/elbow", at one. Laws of one's own are taken for friction: functions of the
            velocity that are odd in it. Shafts are left out: see `drive_set`.

    Raises:
        UnknownName: There is no such law or joint.
        ValueError: The set is not the joint torques'.
    """
    if minimal.model != "dynamic":
        raise ValueError(
            f"joint terms belong to the dynamic set, this is the {minimal.model} one"
        )
    asked = tuple(term for term in joint_terms(tree, laws) if term.joint < tree.n)
    rotors = {term.joint for term in asked if term.law == ROTOR}
    offsets = {term.joint: term for term in asked if term.law in CONSTANTS}
    lone = _lone(tree, minimal.gravity, offsets) if rotors else {}
    lone = {joint: force for joint, force in lone.items() if joint in rotors}
    shares = _rotor_shares(minimal, list(lone))
    regrouped = {joint: k for k, joint in enumerate(lone) if shares[k, k]}
    terms = tuple(
        term for term in asked if term.law != ROTOR or term.joint not in regrouped
    )
    place = {term: minimal.count + k for k, term in enumerate(terms)}
    columns = np.zeros((minimal.count + len(terms), len(asked)))
    for column, term in zip(columns.T, asked, strict=True):
        if term in place:
            column[place[term]] = 1.0
            continue
        share = dict(zip(lone, shares[:, regrouped[term.joint]], strict=True))
        column[: minimal.count] = [share.get(joint, 0.0) for joint in minimal.axial]
        for joint, force in lone.items():
            if joint not in regrouped:
                column[place[JointTerm(ROTOR, joint)]] = -share[joint]
            if force:
                column[place[offsets[joint]]] = -force * share[joint]
    return DriveSet(
        minimal, asked, terms, readonly(columns, columns.shape, "columns"), tree
    )


def _rotor_shares(minimal: MinimalSet, lone: list[int]) -> Array:
    """Share of each lone joint's rotor that the inertia which another one moves holds.

    A rotor adds to the minimal parameter that is its joint's inertia. Where known zeros make
    this a combination of others, or others a combination of such, its rotors are identifiable.

    Returns:
        By joint that moves the inertia and joint of the rotor, (lone, lone); zero columns for
        rotors with a column of their own.
    """
    position = {joint: k for k, joint in enumerate(lone)}
    identifiable = np.zeros((len(minimal.dependent), len(lone)))
    for row, (joint, combination) in zip(identifiable, minimal.dependent, strict=True):
        if joint in position:
            row[position[joint]] = 1.0
        for k, share in combination.items():
            if minimal.axial[k] in position:
                row[position[minimal.axial[k]]] -= share
    rows = identifiable[identifiable.any(axis=1)]
    own, basis = echelon(np.hstack([rows, rows]), len(lone))
    shares = np.eye(len(lone))
    shares[own] = np.where(np.abs(basis) > INDEPENDENT, -basis, 0.0)[:, : len(lone)]
    shares[:, own] = 0.0
    return shares


def _lone(tree: Tree, gravity: Array, offsets: Collection[int]) -> dict[int, float]:
    """Joints whose own acceleration alone identifies the inertia that it moves.

    Returns:
        By joint, the constant force per unit of that inertia which an offset takes up.
    """
    found = {}
    for j, each in enumerate(
        seen_wrenches(tree, "dynamic", gravity, np.zeros((0, 10)))
    ):
        known = each.aside
        inertia, weight = beyond(each.inertia, known), beyond(each.weight, known)
        size, heavy = float(np.linalg.norm(inertia)), float(np.linalg.norm(weight))
        if size <= NEW * np.linalg.norm(each.inertia):
            continue
        if heavy <= NEW * max(1.0, float(np.linalg.norm(each.weight))):
            found[j] = 0.0
        elif j in offsets:
            found[j] = float(weight @ inertia) / size**2
    return found
