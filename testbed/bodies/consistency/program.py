"""Nonlinear program of physically consistent bodies, and an interior-point Newton method."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.linalg import null_space

from testbed.bodies.consistency.known_masses import KnownMasses
from testbed.bodies.consistency.likelihood import Likelihood
from testbed.bodies.prior import PriorBodies
from testbed.core.base.arrays import Array
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE
from testbed.core.parameters.pseudo_inertia import (
    COORDINATE_BASIS,
    matrices_from_coordinates,
    pseudo_inertia_coordinates,
    pseudo_inertias,
)
from testbed.core.robot.friction import ROTOR, JointTerm
from testbed.core.robot.tree import Tree

FINAL_TOLERANCE = 1e-12
"""Squared Newton decrement at which the last stage ends."""

STAGE_TOLERANCE_RATIO = 0.05
"""Squared Newton decrement at which other stages end, relative to the barrier's weight."""

MAX_STEPS = 100
"""Largest number of Newton steps in a stage; usually fewer than twelve."""

WEIGHT_RATIO = 10.0
"""Factor between the weights of consecutive stages."""

MIN_BARRIER = 1e-9
"""Weight of the logarithmic barriers in the last stage."""

ZERO_SIGMA = 1e-4
"""Standard deviation of combinations assumed to be zero, relative to the prior's bodies."""


@dataclass(frozen=True, eq=False)
class NonlinearProgram:
    """Nonlinear program in scaled unknowns z for consistent bodies.

    The m unknowns z are ten coordinates of a matrix Y for each body with mass, then the t joint
    terms divided by their scales. The pseudo-inertia of a body is J = U Y U', where U U' is the
    pseudo-inertia in the file; x = x_from_z z. The objective is |rows z - right_hand_side|^2 / 2 +
    w D(Y) + w |z - 1|^2 / 2 with the weight w of the prior. D(Y) is the sum of tr Y - log det Y - 4
    over the bodies; the last norm includes only the joint terms in the model file. The constraints
    are positive definite Y, non-negative joint terms, and exact linear constraints.

    Attributes:
        prior: Prior bodies.
        x_from_z: Matrix from z to standard parameters and joint terms x, (10 n + t, m).
        rows: Coefficients of the k whitened equations: those of the data, then those of known
            masses and assumed zeros, (k, m).
        right_hand_side: Right-hand side of the equations, (k,).
        data_row_count: Number of equations of the data.
        has_prior: 1 for joint terms in the model file, which have a prior, else 0, (t,).
        nonnegative_indices: Indices in z of joint terms that cannot be negative.
        constraint_rows: Rows of the e exact linear constraints on z, (e, m).
        start: Starting point z that satisfies the exact constraints, (m,).
    """

    prior: PriorBodies
    x_from_z: Array
    rows: Array
    right_hand_side: Array
    data_row_count: int
    has_prior: Array
    nonnegative_indices: NDArray[np.int64]
    constraint_rows: Array
    start: Array

    @property
    def body_count(self) -> int:
        """Number of bodies with mass."""
        return len(self.prior.massive_bodies)

    @cached_property
    def null_space_basis(self) -> Array:
        """Null-space basis of the exact constraints, (m, k)."""
        return (
            null_space(self.constraint_rows)
            if len(self.constraint_rows)
            else np.eye(len(self.start))
        )

    @cached_property
    def normal_matrix(self) -> Array:
        """Normal matrix of the equations, rows' rows, (m, m)."""
        return self.rows.T @ self.rows

    def matrices(self, z: Array) -> Array:
        """Matrix Y of each body with mass, (bodies, 4, 4).

        Args:
            z: Unknowns, (m,).
        """
        return matrices_from_coordinates(z[: 10 * self.body_count].reshape(-1, 10))

    def prior_hessian(self, z: Array) -> Array:
        """Hessian of the prior's divergence and penalties at unit weight, (m, m).

        Args:
            z: Unknowns in the interior of the constraints, (m,).
        """
        inverse = np.linalg.inv(self.matrices(z))
        products = np.einsum("nab,kbc,ncd->nkad", inverse, COORDINATE_BASIS, inverse)
        return np.asarray(
            linalg.block_diag(
                *pseudo_inertia_coordinates(products), np.diag(self.has_prior)
            )
        )

    def step(self, z: Array, weight: float, barrier: float) -> tuple[Array, float]:
        """Newton step within the exact constraints, (m,), and the squared Newton decrement.

        Args:
            z: Unknowns in the interior of the inequality constraints, (m,).
            weight: Weight w of the prior.
            barrier: Weight of the logarithmic barriers.
        """
        hessian, gradient = self._derivatives(z, weight, barrier)
        scale = 1 / np.sqrt(np.maximum(np.diagonal(hessian), SMALLEST_POSITIVE))
        factor = linalg.cho_factor(
            hessian * np.outer(scale, scale) + 1e-15 * np.eye(len(scale))
        )
        step = -scale * linalg.cho_solve(factor, scale * gradient)
        return self.null_space_basis @ step, float(-gradient @ step)

    def _derivatives(
        self, z: Array, weight: float, barrier: float
    ) -> tuple[Array, Array]:
        """Hessian, (k, k), and gradient, (k,), in the null space of the exact constraints.

        Args:
            z: Unknowns, (m,).
            weight: Weight of the prior.
            barrier: Weight of the logarithmic barriers.
        """
        positive, first_term = self.nonnegative_indices, 10 * self.body_count
        divergence_gradient = pseudo_inertia_coordinates(
            np.eye(4) - np.linalg.inv(self.matrices(z))
        )
        prior_gradient = np.concatenate(
            [divergence_gradient.ravel(), self.has_prior * (z[first_term:] - 1)]
        )
        gradient = (
            self.rows.T @ (self.rows @ z - self.right_hand_side)
            + weight * prior_gradient
        )
        gradient[positive] -= barrier / z[positive]
        hessian = self.normal_matrix + weight * self.prior_hessian(z)
        hessian[positive, positive] += barrier / z[positive] ** 2
        return (
            self.null_space_basis.T @ hessian @ self.null_space_basis,
            self.null_space_basis.T @ gradient,
        )

    def _value(self, z: Array, weight: float, barrier: float) -> float:
        """Objective with barriers; infinite outside of the constraints.

        A point is outside if a Y is not positive definite, or if a non-negative joint term is zero
        or less.

        Args:
            z: Unknowns, (m,).
            weight: Weight of the prior.
            barrier: Weight of the logarithmic barriers.
        """
        slack = z[self.nonnegative_indices]
        if (slack <= 0).any():
            return np.inf
        matrices, first_term = self.matrices(z), 10 * self.body_count
        try:
            roots = np.linalg.cholesky(matrices)
        except np.linalg.LinAlgError:
            return np.inf
        divergence = (
            np.einsum("nkk->", matrices) - 2 * np.log(np.einsum("nkk->nk", roots)).sum()
        )
        divergence += (self.has_prior * (z[first_term:] - 1) ** 2).sum() / 2
        fit = ((self.rows @ z - self.right_hand_side) ** 2).sum() / 2
        return float(fit + weight * divergence - barrier * np.log(slack).sum())

    def line_search(
        self, z: Array, step: Array, gain: float, weight: float, barrier: float
    ) -> Array | None:
        """Point of a backtracking line search, (m,); None if no step length reduces the objective.

        The step length is halved, from 1 to 1e-10, until the objective falls by at least 0.01 times
        the product of step length and `gain`.

        Args:
            z: Unknowns, (m,).
            step: Newton step, (m,).
            gain: Squared Newton decrement.
            weight: Weight of the prior.
            barrier: Weight of the logarithmic barriers.
        """
        value, length = self._value(z, weight, barrier), 1.0
        while length > 1e-10:
            point = z + length * step
            if self._value(point, weight, barrier) <= value - 0.01 * length * gain:
                return point
            length /= 2
        return None


def solve_program(program: NonlinearProgram, weight: float) -> tuple[Array, float]:
    """Minimiser of the program, (m,), and Newton decrement at the minimiser [sigma].

    Newton steps are short near singular bodies, and a fit of the data alone would soon reach
    singular bodies. The weight of the prior therefore starts large and falls to its final value;
    then the weight of the barriers falls.

    Args:
        program: Program of consistent bodies.
        weight: Final weight of the prior, 1 / prior_error^2.
    """
    z, squared_decrement = program.start, np.inf
    for stage_weight, barrier in _stages(program, z, weight):
        is_last = stage_weight == weight and barrier == MIN_BARRIER
        tolerance = (
            FINAL_TOLERANCE
            if is_last
            else STAGE_TOLERANCE_RATIO * max(barrier, MIN_BARRIER)
        )
        for _ in range(MAX_STEPS):
            step, squared_decrement = program.step(z, stage_weight, barrier)
            if squared_decrement <= tolerance:
                break
            point = program.line_search(
                z, step, squared_decrement, stage_weight, barrier
            )
            if point is None:  # rounding is all that is left
                break
            z = point
    return z, float(np.sqrt(max(squared_decrement, 0.0)))


def _stages(
    program: NonlinearProgram, start: Array, final_weight: float
) -> Iterator[tuple[float, float]]:
    """Yield the weights of the prior and of the barriers in each stage.

    Both weights fall together by the factor `WEIGHT_RATIO` (10) per stage, from a tenth of the
    squared Newton decrement at the start to the final weight of the prior. Then the weight of the
    barriers alone falls to `MIN_BARRIER`.

    Args:
        program: Program of consistent bodies.
        start: Starting point, (m,).
        final_weight: Final weight of the prior.
    """
    weight = max(final_weight, program.step(start, final_weight, final_weight)[1] / 10)
    while weight > final_weight:
        yield weight, weight
        weight = max(weight / WEIGHT_RATIO, final_weight)
    barrier = final_weight
    while program.nonnegative_indices.size and barrier > MIN_BARRIER:
        yield final_weight, barrier
        barrier /= WEIGHT_RATIO
    yield final_weight, MIN_BARRIER


def nonlinear_program(
    tree: Tree,
    prior: PriorBodies,
    likelihoods: Sequence[Likelihood],
    known: KnownMasses,
    terms: tuple[JointTerm, ...],
) -> NonlinearProgram:
    """Nonlinear program in scaled unknowns from likelihoods, prior and known masses.

    Exactly known masses are constraints; uncertain masses and assumed zeros are equations. The
    scale of a joint term is its rotor inertia in the file if there is one, else a typical rotor
    inertia, else the standard deviation that the data alone give to the term.

    Args:
        tree: Robot.
        prior: Prior bodies.
        likelihoods: Likelihoods of the estimates.
        known: Known masses.
        terms: Joint terms in the order of x.
    """
    measured = np.vstack([each.whitening @ each.rows for each in likelihoods])
    file_inertias = np.array([_file_rotor_inertia(tree, prior, term) for term in terms])
    term_norms = np.linalg.norm(measured[:, 10 * tree.n :], axis=0)
    sizes = [
        inertia
        or _typical_rotor_inertia(tree, prior, term)
        or (1 / norm if norm else 1.0)
        for inertia, term, norm in zip(file_inertias, terms, term_norms, strict=True)
    ]
    massive = prior.standard_from_coordinates[
        :, np.repeat(prior.standard[:, 0] > 0, 10)
    ]
    lead = linalg.block_diag(massive, np.diag(sizes))
    masses = known.rows @ lead[: 10 * tree.n : 10]
    is_uncertain, sigma = known.sigma > 0, known.sigma[known.sigma > 0]
    zeros = [_unit_rows(each.zero_rows @ lead) / ZERO_SIGMA for each in likelihoods]
    right = [each.whitening @ each.estimate.values for each in likelihoods]
    right += [known.values[is_uncertain] / sigma, np.zeros(sum(map(len, zeros)))]
    start = np.outer(
        known.prior_factors[list(prior.massive_bodies)],
        pseudo_inertia_coordinates(np.eye(4)),
    )
    return NonlinearProgram(
        prior=prior,
        x_from_z=lead,
        rows=np.vstack(
            [measured @ lead, masses[is_uncertain] / sigma[:, None], *zeros]
        ),
        right_hand_side=np.concatenate(right),
        data_row_count=len(measured),
        has_prior=(file_inertias > 0).astype(float),
        nonnegative_indices=massive.shape[1]
        + np.flatnonzero([term.nonnegative for term in terms]),
        constraint_rows=_unit_rows(masses[~is_uncertain]),
        start=np.concatenate([start.ravel(), np.ones(len(terms))]),
    )


def _file_rotor_inertia(tree: Tree, prior: PriorBodies, term: JointTerm) -> float:
    """Rotor inertia of a joint term in the model file [kg m^2 or kg]; 0 for other terms."""
    return (
        float(prior.rotors[term.joint])
        if term.law == ROTOR and term.joint < tree.n
        else 0.0
    )


def _typical_rotor_inertia(tree: Tree, prior: PriorBodies, term: JointTerm) -> float:
    """Scale of a rotor inertia that is missing in the file [kg m^2 or kg].

    The scale is the body's moment of inertia about the joint axis, or its mass for a prismatic
    joint; 0 for other terms and for massless bodies.
    """
    if term.law != ROTOR or term.joint not in prior.massive_bodies:
        return 0.0
    axis, body = (
        tree.joints[term.joint].axis,
        pseudo_inertias(prior.standard[term.joint]),
    )
    second_moments = body[:3, :3]
    inertia = float(np.trace(second_moments) - axis @ second_moments @ axis)
    return inertia if tree.joints[term.joint].revolute else float(body[3, 3])


def _unit_rows(rows: Array) -> Array:
    """Rows scaled to unit norm, (k, m); zero rows stay zero."""
    size = np.linalg.norm(rows, axis=1)
    return rows / np.where(size > 0, size, 1.0)[:, None]
