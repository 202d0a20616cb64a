"""The program of physically consistent bodies, and Newton's method for those near a prior's."""

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
from testbed.bodies.prior import Prior
from testbed.core.base.arrays import Array
from testbed.core.estimation.regression.normal_equations import TINY
from testbed.core.parameters.pseudo_inertia import (
    OF_COORDINATES,
    coordinates,
    matrices,
    of_coordinates,
)
from testbed.core.robot.friction import ROTOR, JointTerm
from testbed.core.robot.tree import Tree

DONE = 1e-12
"""Newton's decrement, squared, of the last step."""

ROUGH = 0.05
"""The same of steps on the way, in parts of the weight."""

STEPS = 100
"""Most steps with one weight; a dozen is much."""

FALL = 10.0
"""By which weights fall."""

FADED = 1e-9
"""The last weight of the barriers."""

ZERO = 1e-4
"""Sigma of what was taken to be zero, in parts of the prior's bodies."""


@dataclass(frozen=True, eq=False)
class NonlinearProgram:
    """What is to be minimised, in scaled unknowns z: x = lead z.

    |rows z - right|^2 / 2 + w D(Y) + w |z - 1|^2 / 2 of the joints' terms that the file states,
    with D(Y) = tr Y - log det Y - 4 of every body, under the conditions.

    Attributes:
        prior: What the bodies are compared with.
        lead: Of x, standard parameters and terms, (10 n + t, m).
        rows: What is known, noise of sigma one: first by the data, then besides, (k, m).
        right: What they are, (k,).
        measured: How many of the rows are of data.
        own: Whether the file states each term, (t,): it is then drawn to it.
        positive: Places in z of terms that cannot be negative.
        exact: Rows on z whose values hold exactly, (e, m).
        start: z that obeys them, (m,).
    """

    prior: Prior
    lead: Array
    rows: Array
    right: Array
    measured: int
    own: Array
    positive: NDArray[np.int64]
    exact: Array
    start: Array

    @property
    def bodies(self) -> int:
        """Number of bodies with matter."""
        return len(self.prior.massive)

    @cached_property
    def free(self) -> Array:
        """N, (m, k): what exact conditions leave free."""
        return null_space(self.exact) if len(self.exact) else np.eye(len(self.start))

    @cached_property
    def square(self) -> Array:
        """Products of the rows, (m, m)."""
        return self.rows.T @ self.rows

    def matrices(self, z: Array) -> Array:
        """Y of every body with matter, (bodies, 4, 4), at unknowns z."""
        return of_coordinates(z[: 10 * self.bodies].reshape(-1, 10))

    def prior_hessian(self, z: Array) -> Array:
        """Of divergence and penalties at z with a weight of one, (m, m).

        Args:
            z: Inside, (m,).
        """
        inverse = np.linalg.inv(self.matrices(z))
        turned = np.einsum("nab,kbc,ncd->nkad", inverse, OF_COORDINATES, inverse)
        return np.asarray(linalg.block_diag(*coordinates(turned), np.diag(self.own)))

    def step(self, z: Array, weight: float, barrier: float) -> tuple[Array, float]:
        """Newton's step, (m,), and its decrement squared."""
        inner, across = self._derivatives(z, weight, barrier)
        size = 1 / np.sqrt(np.maximum(np.diagonal(inner), TINY))
        factor = linalg.cho_factor(
            inner * np.outer(size, size) + 1e-15 * np.eye(len(size))
        )
        move = -size * linalg.cho_solve(factor, size * across)
        return self.free @ move, float(-across @ move)

    def _derivatives(
        self, z: Array, weight: float, barrier: float
    ) -> tuple[Array, Array]:
        """Second and first derivatives along what is free, (k, k) and (k,)."""
        at, rest = self.positive, 10 * self.bodies
        gap = coordinates(np.eye(4) - np.linalg.inv(self.matrices(z)))
        away = np.concatenate([gap.ravel(), self.own * (z[rest:] - 1)])
        slope = self.rows.T @ (self.rows @ z - self.right) + weight * away
        slope[at] -= barrier / z[at]
        hessian = self.square + weight * self.prior_hessian(z)
        hessian[at, at] += barrier / z[at] ** 2
        return self.free.T @ hessian @ self.free, self.free.T @ slope

    def _value(self, z: Array, weight: float, barrier: float) -> float:
        """Infinite where z is not inside."""
        slack = z[self.positive]
        if (slack <= 0).any():
            return np.inf
        own, rest = self.matrices(z), 10 * self.bodies
        try:
            roots = np.linalg.cholesky(own)
        except np.linalg.LinAlgError:
            return np.inf
        away = np.einsum("nkk->", own) - 2 * np.log(np.einsum("nkk->nk", roots)).sum()
        away += (self.own * (z[rest:] - 1) ** 2).sum() / 2
        fit = ((self.rows @ z - self.right) ** 2).sum() / 2
        return float(fit + weight * away - barrier * np.log(slack).sum())

    def along(
        self, z: Array, move: Array, gain: float, weight: float, barrier: float
    ) -> Array | None:
        """The point a line search finds; None where no step gains any more."""
        here, length = self._value(z, weight, barrier), 1.0
        while length > 1e-10:
            there = z + length * move
            if self._value(there, weight, barrier) <= here - 0.01 * length * gain:
                return there
            length /= 2
        return None


def solve(program: NonlinearProgram, weight: float) -> tuple[Array, float]:
    """Where the program is least, (m,), and how many sigmas are left to be gained there.

    Data alone would throw the bodies at once to the edge of what can be, along which Newton's
    steps are short. So the prior has a large weight first, which then falls to its own.

    Args:
        program: What is to be minimised.
        weight: Of the prior.
    """
    z, gain = program.start, np.inf
    for stage, barrier in _stages(program, z, weight):
        last = stage == weight and barrier == FADED
        enough = DONE if last else ROUGH * max(barrier, FADED)
        for _ in range(STEPS):
            move, gain = program.step(z, stage, barrier)
            if gain <= enough:
                break
            there = program.along(z, move, gain, stage, barrier)
            if there is None:  # rounding is all that is left
                break
            z = there
    return z, float(np.sqrt(max(gain, 0.0)))


def _stages(
    program: NonlinearProgram, start: Array, last: float
) -> Iterator[tuple[float, float]]:
    """Weights of the prior and of the barriers, one pair after the other."""
    weight = max(last, program.step(start, last, last)[1] / 10)
    while weight > last:
        yield weight, weight
        weight = max(weight / FALL, last)
    barrier = last
    while program.positive.size and barrier > FADED:
        yield last, barrier
        barrier /= FALL
    yield last, FADED


def program_of(
    tree: Tree,
    prior: Prior,
    likelihoods: Sequence[Likelihood],
    known: KnownMasses,
    terms: tuple[JointTerm, ...],
) -> NonlinearProgram:
    """The problem in numbers near one.

    Args:
        tree: The robot.
        prior: Its bodies before the data.
        likelihoods: What estimates say.
        known: Masses of bodies.
        terms: Of the joints' torque, in the order of x.
    """
    measured = np.vstack([each.white @ each.rows for each in likelihoods])
    stated = np.array([_stated(tree, prior, term) for term in terms])
    steep = np.linalg.norm(measured[:, 10 * tree.n :], axis=0)
    sizes = [
        known or _usual(tree, prior, term) or (1 / each if each else 1.0)
        for known, term, each in zip(stated, terms, steep, strict=True)
    ]
    massive = prior.root[:, np.repeat(prior.standard[:, 0] > 0, 10)]
    lead = linalg.block_diag(massive, np.diag(sizes))
    masses = known.rows @ lead[: 10 * tree.n : 10]
    doubtful, sigma = known.sigma > 0, known.sigma[known.sigma > 0]
    zeros = [_unit(each.zero @ lead) / ZERO for each in likelihoods]
    right = [each.white @ each.estimate.values for each in likelihoods]
    right += [known.values[doubtful] / sigma, np.zeros(sum(map(len, zeros)))]
    start = np.outer(known.scale[list(prior.massive)], coordinates(np.eye(4)))
    return NonlinearProgram(
        prior=prior,
        lead=lead,
        rows=np.vstack([measured @ lead, masses[doubtful] / sigma[:, None], *zeros]),
        right=np.concatenate(right),
        measured=len(measured),
        own=(stated > 0).astype(float),
        positive=massive.shape[1] + np.flatnonzero([term.positive for term in terms]),
        exact=_unit(masses[~doubtful]),
        start=np.concatenate([start.ravel(), np.ones(len(terms))]),
    )


def _stated(tree: Tree, prior: Prior, term: JointTerm) -> float:
    """Rotor inertia that the file states; 0 for other terms."""
    return (
        float(prior.rotors[term.joint])
        if term.law == ROTOR and term.joint < tree.n
        else 0.0
    )


def _usual(tree: Tree, prior: Prior, term: JointTerm) -> float:
    """Size of a rotor of which the file says nothing: of the body's own inertia."""
    if term.law != ROTOR or term.joint not in prior.massive:
        return 0.0
    axis, body = tree.joints[term.joint].axis, matrices(prior.standard[term.joint])
    second = body[:3, :3]
    turning = float(np.trace(second) - axis @ second @ axis)
    return turning if tree.joints[term.joint].revolute else float(body[3, 3])


def _unit(rows: Array) -> Array:
    """Rows of norm one, (k, m)."""
    size = np.linalg.norm(rows, axis=1)
    return rows / np.where(size > 0, size, 1.0)[:, None]
