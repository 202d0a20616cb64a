"""Optimisation of Fourier coefficients by a primal-dual interior-point method.

Unknowns are normalised Fourier coefficients; objective and limits are functions of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, block_diag, cho_factor, cho_solve

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.parameters.rules import Signal
from testbed.motion.clearance import ClearanceTerm
from testbed.motion.fourier import Fourier, fourier_basis
from testbed.motion.information import DesignObjective
from testbed.motion.limits import Limits
from testbed.motion.samples import KernelForces, SampledRows, Stencil
from testbed.motion.terms import ForceTerm

INITIAL_BARRIER = 20.0
"""Initial barrier parameter, summed over all limits."""
BARRIER_REDUCTION = 0.3
"""Factor by which the barrier parameter is reduced near the minimum of the barrier function."""
FINAL_BARRIER = 3e-3
"""Final barrier parameter, summed over all limits; it bounds the loss in the objective."""
MAX_INNER_STEPS = 12
"""Largest number of steps with one barrier parameter."""
MAX_SEARCH_STEPS = 100
"""Largest number of steps of a search."""
MIN_SLACK_SHARE = 0.005
"""Smallest fraction of a limit's slack that remains after a step."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Values of the objective and of the limits at a point.

    Attributes:
        value: Value of the objective.
        limits: Values of the m limits, (m,); negative where limits are respected.
    """

    value: float
    limits: Array

    @property
    def is_feasible(self) -> bool:
        """True if the point is strictly inside all limits."""
        return bool(np.isfinite(self.value) and (self.limits < 0).all())


@dataclass(frozen=True, eq=False)
class Linearisation(Evaluation):
    """Values and derivatives of the objective and of the limits at a point.

    Attributes:
        x: Point with k unknowns, (k,).
        gradient: Gradient of the objective, (k,).
        jacobian: Jacobian of the limits.
    """

    x: Array
    gradient: Array
    jacobian: BlockJacobian


def interior_point_minimum(
    search: InteriorPointProblem,
    x: Array,
    stop: Callable[[float], bool] | None = None,
) -> Linearisation:
    """Minimise the objective within the limits by a primal-dual interior-point method.

    Args:
        search: Objective and limits.
        x: Initial point, strictly inside, (k,).
        stop: Callback with the objective after every step; True ends the search.

    Returns:
        Last point, strictly inside the limits.

    Raises:
        ValueError: The initial point is not inside the limits.
    """
    current = search.linearise(x)
    if not current.is_feasible:
        raise ValueError("the search starts outside the limits")
    count = len(current.limits)
    barrier, inner_steps = INITIAL_BARRIER / count, 0
    dual = barrier / -current.limits
    hessian = np.eye(len(x))
    for step in range(MAX_SEARCH_STEPS):
        newton_step = _newton_step(current, dual, hessian, barrier)
        if newton_step is None:
            break
        move, dual_move, slope = newton_step
        length = _step_length(search, current, move, slope, barrier)
        if length == 0:
            break
        following = search.linearise(current.x + length * move)
        dual = _updated_duals(dual, dual_move, following, barrier)
        hessian = _bfgs_update(hessian, current, following, dual, first=step == 0)
        current, inner_steps = following, inner_steps + 1
        if stop is not None and stop(current.value):
            break
        if -slope < 0.5 * barrier * np.sqrt(count) or inner_steps >= MAX_INNER_STEPS:
            if barrier <= FINAL_BARRIER / count:
                break
            barrier, inner_steps = (
                max(BARRIER_REDUCTION * barrier, FINAL_BARRIER / count),
                0,
            )
    return current


def _newton_step(
    current: Linearisation, dual: Array, hessian: Array, barrier: float
) -> tuple[Array, Array, float] | None:
    """Newton step of unknowns and duals, and slope of the barrier function along the step.

    None if the Newton matrix is numerically not positive definite, for example near a kink.

    Args:
        current: Linearisation at the current point.
        dual: Dual variables of the limits, (m,).
        hessian: Approximate Hessian of the Lagrangian, (k, k).
        barrier: Barrier parameter of each limit.
    """
    slack = -current.limits
    ratio = dual / slack
    descent = -(current.gradient + current.jacobian.rmatvec(barrier / slack))
    matrix = hessian + current.jacobian.weighted_gram(ratio)
    try:
        move = cho_solve(cho_factor(matrix, check_finite=False), descent)
    except LinAlgError:
        return None
    limit_changes = current.jacobian.matvec(move)
    return move, barrier / slack - dual + ratio * limit_changes, float(-descent @ move)


def _step_length(
    search: InteriorPointProblem,
    current: Linearisation,
    move: Array,
    slope: float,
    barrier: float,
) -> float:
    """Length of a feasible step with sufficient decrease of the barrier function (Armijo).

    The length is 0 if 25 bisections yield no feasible step with sufficient decrease.

    Args:
        search: Objective and limits.
        current: Linearisation at the current point.
        move: Step of the unknowns, (k,).
        slope: Slope of the barrier function along the step.
        barrier: Barrier parameter of each limit.
    """
    slack, limit_changes = -current.limits, current.jacobian.matvec(move)
    initial_value = current.value - barrier * float(np.log(slack).sum())
    length = min(1.0, 0.99 / max(float((limit_changes / slack).max()), 1e-30))
    for _ in range(25):
        trial = search.evaluate(current.x + length * move)
        if trial.is_feasible and (-trial.limits > MIN_SLACK_SHARE * slack).all():
            trial_value = trial.value - barrier * float(np.log(-trial.limits).sum())
            if trial_value <= initial_value + 1e-4 * length * slope:
                return length
        length /= 2
    return 0.0


def _updated_duals(
    dual: Array, move: Array, following: Linearisation, barrier: float
) -> Array:
    """Dual variables after a step, positive and near the central path.

    The duals stay within a factor of ten of barrier / slack after the step (`following`); `move` is
    the Newton step of the duals.
    """
    decreasing = move < 0
    max_length = (
        float((-dual[decreasing] / move[decreasing]).min())
        if decreasing.any()
        else np.inf
    )
    updated = np.maximum(dual + min(1.0, 0.99 * max_length) * move, 1e-12)
    central = barrier / -following.limits
    return np.clip(updated, central / 10, 10 * central)


def _bfgs_update(
    hessian: Array,
    current: Linearisation,
    following: Linearisation,
    dual: Array,
    *,
    first: bool,
) -> Array:
    """Damped BFGS update of the Hessian of the Lagrangian.

    Args:
        hessian: Approximate Hessian before the step, (k, k).
        current: Linearisation before the step.
        following: Linearisation after the step.
        dual: Dual variables of the limits, (m,).
        first: True for the first step, which sets the scale.
    """
    step = following.x - current.x
    change = following.gradient + following.jacobian.rmatvec(dual)
    change -= current.gradient + current.jacobian.rmatvec(dual)
    if first:
        hessian = hessian * max(abs(float(change @ step)) / float(step @ step), 1e-3)
    hessian_step = hessian @ step
    step_curvature, gradient_curvature = (
        float(step @ hessian_step),
        float(change @ step),
    )
    share = (
        1.0
        if gradient_curvature >= 0.2 * step_curvature
        else 0.8 * step_curvature / (step_curvature - gradient_curvature)
    )
    damped = share * change + (1 - share) * hessian_step
    removed, added = (
        np.outer(hessian_step, hessian_step) / step_curvature,
        np.outer(damped, damped),
    )
    return hessian - removed + added / float(damped @ step)


@dataclass(frozen=True, eq=False)
class Series:
    """Linear map from unknowns to a Fourier series, with `p = 2 harmonics + 1` unknowns per joint.

    Attributes:
        limits: Limits of the joints.
        fundamental: Fundamental frequency [Hz].
        harmonics: Number of harmonics.
        instants: Number G of samples of a period, more than twice the harmonics.
        margin: Usable fraction of the limits.
    """

    limits: Limits
    fundamental: float
    harmonics: int
    instants: int
    margin: float

    @cached_property
    def times(self) -> Array:
        """Sample times of a period, (G,) [s]."""
        return np.arange(self.instants) / (self.instants * self.fundamental)

    @property
    def joints(self) -> int:
        """Number n of joints."""
        return len(self.limits.low)

    @property
    def width(self) -> int:
        """Number p of unknowns per joint."""
        return 2 * self.harmonics + 1

    @cached_property
    def units(self) -> Array:
        """Fourier coefficients (offset, sines, cosines) per unit unknown, (n, p) [rad or m]."""
        frequencies = 2 * np.pi * self.fundamental * np.arange(1, self.harmonics + 1)
        amplitudes = np.tile(self.limits.velocity[:, None] / frequencies, 2)
        return np.hstack(
            [
                self.limits.half[:, None],
                np.minimum(amplitudes, self.limits.half[:, None]),
            ]
        )

    @cached_property
    def basis(self) -> Array:
        """Basis functions that map the unknowns to q, qd and qdd, (n, 3, G, p)."""
        order_bases = [
            fourier_basis(self.fundamental, self.harmonics, self.times, order)
            for order in range(3)
        ]
        return np.stack(order_bases)[None] * self.units[:, None, None, :]

    @cached_property
    def linear(self) -> Array:
        """Basis functions of q, qd and qdd divided by the joint limits, (n, 3 G, p).

        Positions are divided by half the width of the position range.
        """
        limits = self.limits
        limit = np.stack([limits.half, limits.velocity, limits.acceleration], axis=1)
        return (self.basis / limit[:, :, None, None]).reshape(
            self.joints, -1, self.width
        )

    def motion(self, x: Array) -> Fourier:
        """Fourier series of a vector of unknowns, (n p,)."""
        coefficients = self.units * x.reshape(self.joints, self.width)
        return Fourier.from_coefficients(self.fundamental, coefficients)

    def unknowns(self, motion: Fourier) -> Array:
        """Vector of unknowns of a Fourier series with the same frequencies, (n p,)."""
        return (motion.coefficients / self.units).ravel()

    def sampled_motion(self, x: Array) -> Motion:
        """Motion at the sample times from a vector of unknowns, (n p,)."""
        blocks = x.reshape(self.joints, self.width)
        return Motion(self.times, *np.einsum("jdgp,jp->dgj", self.basis, blocks))

    def limit_values(self, x: Array) -> Array:
        """Normalised excess over upper and lower limits of the joint motion, (n, 2, 3, G).

        The limits are reduced so that they hold between the samples, too.

        Args:
            x: Vector of unknowns, (n p,).
        """
        shares = self.linear @ x.reshape(self.joints, self.width, 1)
        shares = shares.reshape(self.joints, 3, self.instants)
        shares[:, 0] -= (self.limits.middle / self.limits.half)[:, None]
        bound = self.margin * np.cos(np.pi * self.harmonics / self.instants)
        return np.asarray(np.stack([shares, -shares], axis=1) - bound)

    def gradient_by_unknowns(self, slopes: Array) -> Array:
        """Gradient with respect to the unknowns, by the chain rule, summed over instants.

        Args:
            slopes: Derivatives with respect to q, then qd, then qdd, (..., 3 n, G).

        Returns:
            Derivatives with respect to the unknowns, (..., n p).
        """
        leading_shape = slopes.shape[:-2]
        by_joint = slopes.reshape(*leading_shape, 3, self.joints, self.instants)
        gradient = np.einsum("...djg,jdgp->...jp", by_joint, self.basis)
        return np.asarray(gradient.reshape(*leading_shape, -1))

    def jacobian_rows(self, slopes: Array, instants: NDArray[np.int64]) -> Array:
        """Gradients of r functions of single instants with respect to the unknowns, (r, n p).

        Args:
            slopes: Derivatives of the functions with respect to q, then qd, then qdd, (r, 3 n).
            instants: Index of the instant of each function, (r,).
        """
        by_joint = slopes.reshape(-1, 3, self.joints)
        rows = np.zeros((len(slopes), self.joints, self.width))
        for order in range(3):
            basis = self.basis[:, order, instants].transpose(1, 0, 2)  # (r, n, p)
            rows += by_joint[:, order, :, None] * basis
        return rows.reshape(len(slopes), -1)


@dataclass(frozen=True, eq=False)
class BlockJacobian:
    """Jacobian of all limits: blocks per joint for linear limits, dense rows for the others.

    Attributes:
        linear: Blocks of the linear limits, (n, 3 G, p), which apply with both signs.
        others: Number of other limits.
        place: Indices of the other limits with non-zero derivatives, (r,).
        dense: Rows of the Jacobian for these limits, (r, n p).
    """

    linear: Array
    others: int
    place: NDArray[np.int64]
    dense: Array

    def matvec(self, x: Array) -> Array:
        """Product of the Jacobian with a vector: changes of the m limits, (m,).

        Args:
            x: Change of the unknowns, (n p,).
        """
        n, _, p = self.linear.shape
        linear_changes = (self.linear @ x.reshape(n, p, 1))[:, :, 0]
        other_changes = np.zeros(self.others)
        other_changes[self.place] = self.dense @ x
        return np.concatenate(
            [np.stack([linear_changes, -linear_changes], axis=1).ravel(), other_changes]
        )

    def rmatvec(self, weights: Array) -> Array:
        """Product of the transposed Jacobian with a vector, (n p,).

        Args:
            weights: Weight of each limit, (m,).
        """
        (above, below), other_weights = self._split_weights(weights)
        blocks = (above - below)[:, None] @ self.linear
        return np.asarray(blocks.ravel() + other_weights @ self.dense)

    def weighted_gram(self, weights: Array) -> Array:
        """Weighted Gram matrix J' diag(weights) J, (n p, n p).

        Args:
            weights: Weight of each limit, (m,).
        """
        (above, below), other_weights = self._split_weights(weights)
        blocks = self.linear.transpose(0, 2, 1) @ (
            (above + below)[:, :, None] * self.linear
        )
        return np.asarray(
            block_diag(*blocks) + self.dense.T @ (other_weights[:, None] * self.dense)
        )

    def _split_weights(self, weights: Array) -> tuple[Array, Array]:
        """Weights of upper and lower linear limits, (2, n, 3 G), and of other limits, (r,)."""
        n, rows, _ = self.linear.shape
        first, other_weights = np.split(weights, [2 * n * rows])
        return first.reshape(n, 2, rows).swapaxes(0, 1), other_weights[self.place]


@dataclass(frozen=True, eq=False)
class InteriorPointProblem:
    """Design of a motion as a nonlinear program for the interior-point method.

    Attributes:
        series: Map from unknowns to the motion.
        information: Objective, an optimality criterion of the base parameters.
        terms: Nonlinear limits of forces and clearances.
        rows: Sampled rows of the signals that objective and limits use.
        stencil: Finite-difference stencil of the derivatives.
        names: Names of the joints.
    """

    series: Series
    information: DesignObjective
    terms: Sequence[ForceTerm | ClearanceTerm]
    rows: Mapping[Signal, SampledRows]
    stencil: Stencil
    names: tuple[str, ...]

    def evaluate(self, x: Array) -> Evaluation:
        """Values of objective and limits at a point, (n p,)."""
        samples = self._samples(x, None)
        return Evaluation(self.information.value(samples), self._limits(x, samples))

    def linearise(self, x: Array) -> Linearisation:
        """Values and derivatives of objective and limits at a point, (n p,)."""
        samples = self._samples(x, self.stencil)
        return Linearisation(
            x=x,
            value=self.information.value(samples),
            gradient=self.series.gradient_by_unknowns(self.information.slopes(samples)),
            limits=self._limits(x, samples),
            jacobian=self._jacobian(samples),
        )

    def most_critical_limit(self, x: Array) -> tuple[str, float, float]:
        """Label, time [s] and value of the largest limit at a point.

        The value is the excess over the usable fraction of the limit; negative if respected.
        """
        instants = self.series.instants
        joint_values = self.series.limit_values(x).max(axis=1)
        samples = self._samples(x, None)
        kinds = ("position", "velocity", "acceleration")
        labels = [f"{kind} of '{name}'" for name in self.names for kind in kinds]
        values = [joint_values.reshape(-1, instants)]
        for term in self.terms:
            labels += term.labels
            values.append(term.values(samples))
        all_values = np.concatenate(values)
        k, g = np.unravel_index(int(all_values.argmax()), all_values.shape)
        return labels[k], float(self.series.times[g]), float(all_values[k, g])

    def _jacobian(self, samples: KernelForces) -> BlockJacobian:
        """Jacobian of all limits with respect to the unknowns."""
        width = 3 * self.series.joints
        by_motion = [
            term.slopes(samples).transpose(0, 2, 1).reshape(-1, width)
            for term in self.terms
        ]
        all_slopes = np.concatenate([np.zeros((0, width)), *by_motion])
        indices = np.flatnonzero(all_slopes.any(axis=1))
        dense = self.series.jacobian_rows(
            all_slopes[indices], indices % self.series.instants
        )
        return BlockJacobian(self.series.linear, len(all_slopes), indices, dense)

    def _samples(self, x: Array, stencil: Stencil | None) -> KernelForces:
        """Samples of the motion at a point; derivatives require a stencil."""
        return KernelForces(self.series.sampled_motion(x), self.rows, stencil)

    def _limits(self, x: Array, samples: KernelForces) -> Array:
        """Values of all limits: linear limits of the joints, then other terms, (m,)."""
        values = [term.values(samples).ravel() for term in self.terms]
        return np.concatenate([self.series.limit_values(x).ravel(), *values])
