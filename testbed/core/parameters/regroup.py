"""Regrouping of parameters from the end bodies to the base, and the resulting formulas.

Parameters that the rules do not keep for a body migrate: they are added to the parameters of the
carrying body. The sums are called redefined parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array, skew
from testbed.core.base.transform import Transform
from testbed.core.parameters.pseudo_inertia import (
    standard_parameter_rate,
    standard_parameter_transform,
)
from testbed.core.parameters.rules import (
    MASSLESS_ROW,
    RuleRow,
    Signal,
    base_rule,
    joint_rule,
    mobilities,
    unit_twist,
)
from testbed.core.parameters.symbols import (
    STANDARD_PERMUTATION,
    TENSOR_FROM_SIX,
    Formula,
    Label,
    Symbol,
    Term,
    component_symbol,
)
from testbed.core.robot.tree import Joint, Tree


def orthogonal_part(vector: Array, basis: Array) -> Array:
    """Component of a vector orthogonal to a subspace.

    Args:
        vector: Vector, (N,).
        basis: Orthonormal rows that span the subspace, (k, N).
    """
    for _ in range(2):  # twice is enough against rounding
        vector = vector - basis.T @ (basis @ vector)
    return vector


INDEPENDENCE_TOLERANCE = 1e-8
"""Smallest norm, after projection, of a unit functional that is considered independent."""


@dataclass(frozen=True, eq=False)
class CompositeFunctionals:
    """Identifiable functionals of a composite body j at q = 0, as rows on (m, h, I).

    The composite body is body j with all bodies that it carries; m, h, I are its mass, first moment
    and inertia tensor (xx xy xz yy yz zz) in frame j, and S_j is the unit twist of joint j.

    Attributes:
        without_acceleration: Functionals identifiable without the acceleration of joint j and
            without the composite body's weight at q = 0, (k, 10).
        inertia: S_j . I_j S_j, the coefficient of qdd_j in the torque of joint j, (10,).
        weight: -g . I_j S_j for gravity g at q = 0, the constant part of that torque, (10,).
    """

    without_acceleration: Array
    inertia: Array
    weight: Array

    @property
    def basis(self) -> Array:
        """Orthonormal basis of all identifiable functionals, (k, 10)."""
        return row_space_basis(
            np.vstack([self.without_acceleration, self.inertia, self.weight])
        )


def composite_functionals(
    tree: Tree, model: Signal, gravity: Array, static: Array
) -> Iterator[CompositeFunctionals]:
    """Yield the identifiable functionals of every composite body, from the bedplate outwards.

    The functionals are row spaces made invariant under the operators of the joint twists; no
    samples of a motion are needed.

    Args:
        tree: The robot; only its geometry matters.
        model: "torque" for joint torques, "wrench" for the bedplate's wrench.
        gravity: Gravity, (3,) [m/s^2], bedplate frame.
        static: Identifiable functionals of all bodies on the bedplate together, (k, 10).
    """
    # index j + 1
    motions: list[Array] = [np.eye(6) if model == "wrench" else np.zeros((0, 6))]
    accelerations: list[Array] = [-np.concatenate([gravity, np.zeros(3)])]
    spans: list[Array] = [static]
    for j, joint in enumerate(tree.joints):
        screw, transform = unit_twist(joint), joint.X_PB.wrench_matrix
        rate = _reordered_matrix(standard_parameter_rate(screw))
        ad, momentum = _ad(screw).T, _momentum_functionals(screw)
        acceleration = accelerations[joint.parent + 1] @ transform
        carrier_motions = _invariant_closure(
            np.vstack([motions[joint.parent + 1] @ transform, acceleration @ ad]), ad
        )
        closure = _invariant_closure(
            spans[joint.parent + 1] @ inertia_transform(joint.X_PB), rate
        )
        other_functionals = row_space_basis(
            np.vstack([carrier_motions @ momentum, closure @ rate])
        )
        functionals = CompositeFunctionals(
            other_functionals, screw @ momentum, acceleration @ momentum
        )
        yield functionals
        motions.append(row_space_basis(np.vstack([carrier_motions, screw])))
        accelerations.append(acceleration)
        if tree.sensor is None or j >= tree.lead:
            spans.append(row_space_basis(np.vstack([closure, functionals.basis])))
        else:
            spans.append(static)


def base_functionals(tree: Tree, gravity: Array, *, is_tared: bool) -> Array:
    """Orthonormal functionals of a base's ten parameters that the wrench identifies, (k, 10).

    The wrench is I a + v x* I v, where v is the velocity of the base, and a its acceleration minus
    gravity. The second term is a combination of the six components of I v. The functionals
    therefore follow from the directions, in the base frame, in which the joints before the base can
    move the base and in which gravity can point.

    Args:
        tree: The robot; its first joints lead to the base.
        gravity: Gravity, (3,) [m/s^2], bedplate frame.
        is_tared: True if the static wrench in one posture has been subtracted.
    """
    twists, gravity_changes = np.zeros((0, 6)), np.zeros((0, 6))
    weight = -np.concatenate([gravity, np.zeros(3)])
    for joint in tree.joints[: tree.lead]:
        screw, transform = unit_twist(joint), joint.X_PB.wrench_matrix
        ad = _ad(screw).T
        weight = weight @ transform
        twists = row_space_basis(
            np.vstack([_invariant_closure(twists @ transform, ad), screw])
        )
        gravity_changes = _invariant_closure(
            np.vstack([gravity_changes @ transform, weight @ ad]), ad
        )
    gravity_directions = (
        gravity_changes if is_tared else np.vstack([gravity_changes, weight])
    )
    return row_space_basis(
        np.vstack(
            [
                _momentum_functionals(twist)
                for twist in (*twists, *row_space_basis(gravity_directions))
            ]
        )
    )


def _ad(screw: Array) -> Array:
    """Matrix of the operator ad of a twist on twists, linear part first, (6, 6)."""
    v, w = skew(screw[:3]), skew(screw[3:])
    return np.block([[w, v], [np.zeros((3, 3)), w]])


def _momentum_functionals(screw: Array) -> Array:
    """Momentum of a composite body at a given twist, as functionals of (m, h, I), (6, 10).

    The rows are linear momentum, then angular momentum about the frame's origin.

    Args:
        screw: Twist, linear part first, (6,).
    """
    v, w = screw[:3], screw[3:]
    linear = np.concatenate([v[:, None], skew(w), np.zeros((3, 6))], axis=1)
    angular = np.concatenate(
        [np.zeros((3, 1)), -skew(v), np.einsum("abk,b->ak", TENSOR_FROM_SIX, w)], axis=1
    )
    return np.vstack([linear, angular])


def inertia_transform(X_AB: Transform) -> Array:
    """Matrix that transforms inertial parameters (m, h, I) from frame B to A, (..., 10, 10).

    The tensor I is about the frame's origin, in the order xx xy xz yy yz zz; units are kg, kg m,
    kg m^2.

    Args:
        X_AB: Pose of frame B in A.
    """
    return _reordered_matrix(standard_parameter_transform(X_AB))


def _reordered_matrix(matrix: Array) -> Array:
    """Convert a matrix on standard parameters to a matrix on (m, h, I), (..., 10, 10).

    The tensor's components are reordered from xx xy yy xz yz zz to xx xy xz yy yz zz.
    """
    return matrix[..., STANDARD_PERMUTATION, :][..., STANDARD_PERMUTATION]


def _invariant_closure(rows: Array, operator: Array) -> Array:
    """Smallest row space that contains `rows` and is invariant under `operator`."""
    space = row_space_basis(rows)
    while True:
        larger_space = row_space_basis(np.vstack([space, space @ operator]))
        if len(larger_space) == len(space):
            return space
        space = larger_space


def row_space_basis(rows: Array) -> Array:
    """Orthonormal basis of the row space, by singular value decomposition, (rank, columns).

    The rows are not rescaled, because their norms are of order one or rounding errors of zero.
    Singular values up to `INDEPENDENCE_TOLERANCE` times the largest one, or times 1 if that is
    larger, are treated as zero.
    """
    if not rows.any():
        return rows[:0]
    _, singular_values, directions = np.linalg.svd(rows, full_matrices=False)
    return directions[
        : int(
            np.sum(
                singular_values > INDEPENDENCE_TOLERANCE * max(1.0, singular_values[0])
            )
        )
    ]


@dataclass(frozen=True, eq=False)
class RegroupedBody:
    """Regrouped body: kept parameters, and contribution to the parameters of the carrier.

    Attributes:
        row: Row of the rules, with the kept parameters.
        gain_by_offset: Matrices, (4, 10, 10), from the body's ten redefined parameters to those of
            its carrier: coefficients of (1, lx, ly, lz) for the offset l.
        gain: Resulting matrix for the model's offset, (10, 10).
    """

    row: RuleRow
    gain_by_offset: Array
    gain: Array


def regroup_bodies(
    tree: Tree, model: Signal, gravity: Array, *, tared: bool = False
) -> tuple[RegroupedBody, ...]:
    """Apply the regrouping rules to every joint.

    Massless bodies before a moving base keep no parameters. The base follows `base_rule`, all other
    bodies follow `joint_rule`.

    Args:
        tree: The robot.
        model: "torque" for joint torques, "wrench" for the bedplate's wrench.
        gravity: Gravity, (3,) [m/s^2], bedplate frame.
        tared: True if the static wrench in one posture has been subtracted.
    """
    bodies = []
    for j, (joint, mobility) in enumerate(
        zip(tree.joints, mobilities(tree, gravity), strict=True)
    ):
        if j < tree.massless:
            row = MASSLESS_ROW
        elif j == tree.lead - 1:
            row = base_rule(base_functionals(tree, gravity, is_tared=tared))
        else:
            row = joint_rule(joint, mobility, model)
        passing = migration_matrices(joint, row)
        gain = np.tensordot(np.concatenate([[1.0], joint.offset]), passing, 1)
        bodies.append(RegroupedBody(row, passing, gain))
    return tuple(bodies)


def redefined_parameter_rows(tree: Tree, bodies: Sequence[RegroupedBody]) -> Array:
    """Coefficients of redefined parameters on the barycentric parameters, (n, 10, 10 n).

    The recursion runs from the end bodies to the base. The array is dense; its size grows with the
    square of the number of bodies.
    """
    redefined = np.zeros((tree.n, 10, 10 * tree.n))
    for j in reversed(range(tree.n)):
        redefined[j, range(10), range(10 * j, 10 * j + 10)] += 1.0
        if tree.parents[j] >= 0:
            redefined[tree.parents[j]] += bodies[j].gain @ redefined[j]
    return redefined


def migration_matrices(joint: Joint, row: RuleRow) -> Array:
    """Matrices from redefined parameters of body j to parameters of its carrier i, (4, 10, 10).

    The four matrices are the coefficients of 1, lx, ly, lz for the offset l of joint j in frame i.
    Let b be the migrating component of mb^j in frame i, and x~ the cross-product matrix of x. Then
    mb*^i = mb^i + b and K*^i = K^i + (migrating components of K^j) - (l~ b~ + b~ l~), where
    l~ b~ + b~ l~ = b l' + l b' - 2 (l . b) 1.
    """
    # affine in the offset: zero offset, and unit offset along each axis
    X_AB = Transform(np.broadcast_to(joint.rotation, (4, 3, 3)), np.eye(4)[:, 1:])
    gains = inertia_transform(X_AB) @ row.migration_projector
    gains[1:] -= gains[0]
    gains[np.abs(gains) < 1e-15] = 0.0
    return gains


MIN_COEFFICIENT = 1e-12
"""Smallest printed coefficient; smaller values are rounding errors of zero."""

LengthNotation = Literal["symbols", "numbers"]


@dataclass(frozen=True, eq=False)
class FormulaWriter:
    """Writer of the formulas of a robot's redefined parameters.

    Attributes:
        tree: The robot.
        bodies: Regrouped bodies.
        known_zero: True for barycentric parameters known to be zero, (n, 10).
        lengths: "symbols" or "numbers", for the offsets in the formulas.
    """

    tree: Tree
    bodies: Sequence[RegroupedBody]
    known_zero: NDArray[np.bool_]
    lengths: LengthNotation = "symbols"

    @cached_property
    def nonzero(self) -> NDArray[np.bool_]:
        """Mask of redefined parameters that are not known to be zero, (n, 10)."""
        nonzero = ~self.known_zero
        for j in reversed(range(self.tree.n)):
            if self.tree.parents[j] >= 0:
                has_gain = (self.bodies[j].gain[:, nonzero[j]] != 0).any(axis=1)
                nonzero[self.tree.parents[j]] |= has_gain
        return nonzero

    def component(self, body: int, component: int) -> Symbol:
        """Symbol of a body's redefined parameter, with a star if the body carries other bodies.

        Args:
            body: Index of the body.
            component: Index of BARYCENTRIC_COMPONENTS.
        """
        return component_symbol(body, component, star=bool(self.tree.children(body)))

    def redefinition(self, body: int, component: int) -> Formula:
        """Formula of a body's redefined parameter; arguments as in `component`."""
        left = Label((Term(self.component(body, component)),))
        return self.formula(left, body, np.eye(10)[component])

    def formula(self, left: Label, body: int, form: Array) -> Formula:
        """Formula of a linear form on a body's redefined parameters.

        The right-hand side contains the parameters of the body and the parameters that migrate from
        its children. Body -1 is the bedplate, whose own parameters are left out; its masses and
        first moments are sums over its children at their offsets.

        Args:
            left: Name of the form.
            body: Index of the body.
            form: Coefficients on the ten redefined parameters, (10,).
        """
        terms: list[Term] = []
        if body >= 0:
            for c in np.flatnonzero(np.abs(form) > MIN_COEFFICIENT):
                if not self.known_zero[body, c]:
                    weight = ((float(form[c]), None),)
                    terms.append(Term(component_symbol(body, int(c)), weight))
        for child in self.tree.children(body):
            weights = np.tensordot(
                form, self.bodies[child].gain_by_offset, (0, 1)
            )  # (4, 10)
            if body < 0:
                weights[0, 0] += form[0]
                weights[1:, 0] += form[1:4]
            for c in np.flatnonzero(np.abs(weights).max(axis=0) > MIN_COEFFICIENT):
                factor = self._factor(weights[:, c], body, child)
                if factor and self.nonzero[child, c]:
                    terms.append(Term(self.component(child, int(c)), factor))
        return Formula(left, tuple(terms))

    def _factor(
        self, weights: Array, body: int, child: int
    ) -> tuple[tuple[float, Symbol | None], ...]:
        """Factor of a child's parameter: coefficients of 1, lx, ly, lz with symbols of lengths.

        The factor is empty if it is zero for the model's lengths.
        """
        offset = self.tree.joints[child].offset
        if self.lengths == "numbers":
            value = float(weights[0] + weights[1:] @ offset)
            return ((value, None),) if abs(value) > MIN_COEFFICIENT else ()
        factor: list[tuple[float, Symbol | None]] = []
        if abs(weights[0]) > MIN_COEFFICIENT:
            factor.append((float(weights[0]), None))
        for weight, axis, length in zip(weights[1:], "xyz", offset, strict=True):
            if min(abs(weight), abs(length)) > MIN_COEFFICIENT:
                factor.append((float(weight), length_symbol(body, child, axis)))
        return tuple(factor)


def length_symbol(body: int, child: int, axis: str) -> Symbol:
    """Symbol of an offset component from a body to a carried body: l23z, l9_10z.

    Args:
        body: Index of the carrying body, -1 for the bedplate.
        child: Index of the carried body.
        axis: "x", "y" or "z" of the carrying body.
    """
    return Symbol("l", (body + 1, child + 1), axis)
