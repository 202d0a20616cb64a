"""Minimal set of bodies and joint terms together, and regrouping of rotor inertias.

In addition to the dynamics of the bodies, joint torques contain joint terms. In row j of the
regressor, a rotor has the column qdd_j, an offset a constant, and friction has functions of qd_j.
Friction always has separate columns, because torques without friction are even functions of the
velocities. A rotor has a separate column unless the inertia to which it adds is identified by the
joint's own acceleration only; then rotor and inertia are regrouped into one minimal parameter. An
offset always has a separate column. If a rotor is regrouped with a mass of constant weight, the
offset contains this weight.

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

from testbed.core.base.arrays import Array, readonly_array
from testbed.core.base.codec import schema_by_name
from testbed.core.base.summary_table import Value
from testbed.core.parameters.elimination import PIVOT_TOLERANCE, reduced_row_echelon
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.regroup import (
    INDEPENDENCE_TOLERANCE,
    LengthNotation,
    composite_functionals,
    orthogonal_part,
)
from testbed.core.parameters.symbols import DriveSymbol, Formula, Label, Term
from testbed.core.robot.friction import CONSTANT_LAWS, ROTOR, JointTerm, joint_terms
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.shafts import joint_and_shaft_names
from testbed.core.robot.tree import Tree


@dataclass(frozen=True, eq=False)
class DriveSet(Value):
    """Minimal parameters of bodies and drives together, for the joint torques.

    The unknowns are the minimal parameters of the bodies, which may include regrouped terms, then
    the terms with a separate regressor column.

    Attributes:
        minimal: Minimal set of the bodies for joint torques.
        asked: All requested terms, law by law, each in tree order.
        terms: Requested terms with a separate column, in the same order.
        columns: Contribution of a unit of each requested term to the unknowns, (count, asked).
        tree: The robot; only its geometry and its shafts matter.
    """

    minimal: MinimalSet
    asked: tuple[JointTerm, ...]
    terms: tuple[JointTerm, ...]
    columns: Array
    tree: Tree

    __get_pydantic_core_schema__ = schema_by_name(
        lambda drive_set: [term.name(drive_set.tree) for term in drive_set.asked]
    )

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return self.minimal.count + len(self.terms)

    @cached_property
    def regrouped(self) -> Mapping[JointTerm, Array]:
        """Contribution of each term without a separate column to the unknowns, (count,)."""
        with_column = set(self.terms)
        return {
            term: self.columns[:, k]
            for k, term in enumerate(self.asked)
            if term not in with_column
        }

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """Symbolic names of the unknowns: sums of minimal parameters and regrouped terms."""
        own = (Label((Term(self.symbol(term)),)) for term in self.terms)
        plain = (*self.minimal.labels, *own)
        return tuple(
            Label((*label.terms, *self._regrouped_terms(k)))
            for k, label in enumerate(plain)
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns: K3yy, K*1zz+rotor/waist, coulomb/waist, ..."""
        return tuple(label.text for label in self.labels)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each unknown."""
        return (*self.minimal.units, *(term.unit(self.tree) for term in self.terms))

    @cached_property
    def matrix(self) -> Array:
        """Matrix of the unknowns on barycentric parameters and requested terms.

        The shape is (count, 10 n + requested terms); the terms are in the order of `asked`.
        """
        n = self.minimal.matrix.shape[1]
        matrix = np.zeros((self.count, n + len(self.asked)))
        matrix[: self.minimal.count, :n] = self.minimal.matrix
        matrix[:, n:] = self.columns
        return readonly_array(matrix, matrix.shape, "matrix")

    @cached_property
    def formulas(self) -> tuple[Formula, ...]:
        """Formulas of the unknowns: K*1zz + rotor/waist = K1zz + K*2xx/2 + ... + rotor/waist."""
        return self.formulas_with("symbols")

    def formulas_with(self, lengths: LengthNotation) -> tuple[Formula, ...]:
        """Formulas of the unknowns, with lengths as symbols or as numbers.

        Args:
            lengths: "symbols" prints l12z, "numbers" its value.
        """
        own = ((Term(self.symbol(term)),) for term in self.terms)
        plain = (*(f.right for f in self.minimal.formulas_with(lengths)), *own)
        return tuple(
            Formula(label, (*right, *self._regrouped_terms(k)))
            for k, (label, right) in enumerate(zip(self.labels, plain, strict=True))
        )

    def values(
        self,
        theta: ArrayLike,
        tree: Tree,
        added: Mapping[JointLaw, Any] = MappingProxyType({}),
    ) -> Array:
        """Values of the unknowns, (count,).

        Args:
            theta: Barycentric parameters, (n, 10).
            tree: Robot with the coefficients of the terms; terms of shafts have the value 0.
            added: Values added to the coefficients, keyed by law; a number or (n,) each.
        """
        terms = [
            (term.law.coefficients(tree) + added.get(term.law, 0.0))[term.joint]
            if term.joint < tree.n
            else 0.0
            for term in self.asked
        ]
        unknowns: Array = self.columns @ np.array(terms)
        unknowns[: self.minimal.count] += self.minimal.values(theta)
        return unknowns

    def symbol(self, term: JointTerm) -> DriveSymbol:
        """Symbol of a joint term, such as rotor/waist."""
        return DriveSymbol(term.law.kind, joint_and_shaft_names(self.tree)[term.joint])

    def _regrouped_terms(self, unknown: int) -> Iterator[Term]:
        """Terms without a separate column that are part of an unknown, with coefficients.

        Args:
            unknown: Index of the unknown.
        """
        for term, column in self.regrouped.items():
            if column[unknown]:
                yield Term(self.symbol(term), ((float(column[unknown]), None),))


def with_joint_terms(
    tree: Tree, minimal: MinimalSet, laws: Sequence[str | JointLaw]
) -> DriveSet:
    """Minimal set of bodies and joint terms together, from the model alone.

    A rotor inertia is added to the axial inertia of its joint if that inertia is identified by the
    joint's own acceleration only; all other terms have a separate regressor column.

    Args:
        tree: The robot; only its geometry matters.
        minimal: Minimal set of the joint torques.
        laws: Joint laws, as names or as values; a law applies to every joint or, in the form
            "rotor/elbow", to a single joint. User-defined laws are treated as friction, an odd
            function of the velocity. Terms of shafts are left out: see `drive_set`.

    Raises:
        UnknownName: A law or joint does not exist.
        ValueError: The set is not a minimal set of the joint torques.
    """
    if minimal.model != "torque":
        raise ValueError(
            f"joint terms belong to the dynamic set, this is the {minimal.model} one"
        )
    requested = tuple(term for term in joint_terms(tree, laws) if term.joint < tree.n)
    rotors = {term.joint for term in requested if term.law == ROTOR}
    offsets = {term.joint: term for term in requested if term.law in CONSTANT_LAWS}
    isolated = _isolated_joints(tree, minimal.gravity, offsets) if rotors else {}
    isolated = {joint: force for joint, force in isolated.items() if joint in rotors}
    shares = _rotor_shares(minimal, list(isolated))
    regrouped = {joint: k for k, joint in enumerate(isolated) if shares[k, k]}
    terms = tuple(
        term for term in requested if term.law != ROTOR or term.joint not in regrouped
    )
    positions = {term: minimal.count + k for k, term in enumerate(terms)}
    columns = np.zeros((minimal.count + len(terms), len(requested)))
    for column, term in zip(columns.T, requested, strict=True):
        if term in positions:
            column[positions[term]] = 1.0
            continue
        share = dict(zip(isolated, shares[:, regrouped[term.joint]], strict=True))
        column[: minimal.count] = [share.get(joint, 0.0) for joint in minimal.axial]
        for joint, force in isolated.items():
            if joint not in regrouped:
                column[positions[JointTerm(ROTOR, joint)]] = -share[joint]
            if force:
                column[positions[offsets[joint]]] = -force * share[joint]
    return DriveSet(
        minimal,
        requested,
        terms,
        readonly_array(columns, columns.shape, "columns"),
        tree,
    )


def _rotor_shares(minimal: MinimalSet, joints: list[int]) -> Array:
    """Contributions of rotors to the axial inertias of isolated joints, (joints, joints).

    A joint is isolated if its axial inertia is identified by its own acceleration only. Its rotor
    then adds to the minimal parameter that is this axial inertia. If known zeros make such an
    inertia a combination of other parameters, or another parameter a combination of such inertias,
    the corresponding combination of rotors is identifiable.

    Args:
        minimal: Minimal set of the joint torques.
        joints: Indices of the isolated joints with a rotor.

    Returns:
        Matrix with one row per joint of the inertia and one column per joint of the rotor; columns
        of rotors that have a separate regressor column are zero.
    """
    positions = {joint: k for k, joint in enumerate(joints)}
    identifiable = np.zeros((len(minimal.dependent), len(joints)))
    for row, (joint, combination) in zip(identifiable, minimal.dependent, strict=True):
        if joint in positions:
            row[positions[joint]] = 1.0
        for k, share in combination.items():
            if minimal.axial[k] in positions:
                row[positions[minimal.axial[k]]] -= share
    rows = identifiable[identifiable.any(axis=1)]
    pivots, basis = reduced_row_echelon(np.hstack([rows, rows]), len(joints))
    shares = np.eye(len(joints))
    shares[pivots] = np.where(np.abs(basis) > PIVOT_TOLERANCE, -basis, 0.0)[
        :, : len(joints)
    ]
    shares[:, pivots] = 0.0
    return shares


def _isolated_joints(
    tree: Tree, gravity: Array, offsets: Collection[int]
) -> dict[int, float]:
    """Joints whose axial inertia is identified by the joint's own acceleration only.

    If this inertia also adds a constant weight to the torque of its joint, the joint is included
    only if it has an offset, which then contains the weight.

    Args:
        tree: The robot.
        gravity: Gravity, (3,) [m/s^2], bedplate frame.
        offsets: Indices of joints with an offset.

    Returns:
        Constant force per unit of inertia that is part of the offset, keyed by joint index.
    """
    forces = {}
    for j, functionals in enumerate(
        composite_functionals(tree, "torque", gravity, np.zeros((0, 10)))
    ):
        others = functionals.without_acceleration
        inertia, weight = (
            orthogonal_part(functionals.inertia, others),
            orthogonal_part(functionals.weight, others),
        )
        size, weight_size = (
            float(np.linalg.norm(inertia)),
            float(np.linalg.norm(weight)),
        )
        if size <= INDEPENDENCE_TOLERANCE * np.linalg.norm(functionals.inertia):
            continue
        if weight_size <= INDEPENDENCE_TOLERANCE * max(
            1.0, float(np.linalg.norm(functionals.weight))
        ):
            forces[j] = 0.0
        elif j in offsets:
            forces[j] = float(weight @ inertia) / size**2
    return forces
