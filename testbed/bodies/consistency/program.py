"""The program of physically consistent bodies, and Newton's method for those near a prior's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.linalg import null_space

from testbed.bodies.consistency.likelihood import Likelihood
from testbed.bodies.consistency.options import Conditions, Metric
from testbed.bodies.prior import (
    OF_COORDINATES,
    Prior,
    coordinates,
    matrices,
    of_coordinates,
)
from testbed.core.base.arrays import Array
from testbed.core.base.errors import WIDTH, SettingsError, few
from testbed.core.estimation.diagnostics.rigid_bodies import Cone, minimise
from testbed.core.estimation.regression.normal_equations import TINY
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

EDGE = 1e-6
"""Eigenvalue of Y at which the Frobenius norm's barrier stands."""


@dataclass(frozen=True, eq=False)
class Program:
    """What is to be minimised, in coordinates near one.

    Attributes:
        metric: Which D.
        bodies: z begins with ten coordinates of so many Y.
        rows: B, (k, m).
        right: b, (k,).
        weight: w, of each body's divergence.
        pull: Weight of (z - 1)^2 / 2, of the joints' terms, (m - 10 bodies,).
        free: N, (m, k): what exact conditions leave free.
        bound_rows: (c, m).
        bounds: (c,).
    """

    metric: Metric
    bodies: int
    rows: Array
    right: Array
    weight: float
    pull: Array
    free: Array
    bound_rows: Array
    bounds: Array

    @cached_property
    def square(self) -> Array:
        """B' B, (m, m)."""
        return self.rows.T @ self.rows

    @property
    def fades(self) -> bool:
        """Whether there are barriers that are no part of the program."""
        return bool(len(self.bounds)) or self.metric == "frobenius"

    def matrices(self, z: Array) -> Array:
        """Y, (bodies, 4, 4)."""
        return of_coordinates(z[: 10 * self.bodies].reshape(-1, 10))

    def prior_hessian(self, z: Array, barrier: float = 0.0) -> Array:
        """Of divergence and penalties at z, (m, m).

        Args:
            z: Inside, (m,).
            barrier: Weight of the Frobenius norm's barrier.
        """
        found = np.zeros((len(z), len(z)))
        plain, curved, shift = self._shares(barrier)
        inverse = np.linalg.inv(self.matrices(z) - shift * np.eye(4))
        turned = np.einsum("nab,kbc,ncd->nkad", inverse, OF_COORDINATES, inverse)
        for body, block in enumerate(curved * coordinates(turned)):
            at = slice(10 * body, 10 * body + 10)
            found[at, at] = block + plain * np.eye(10)
        rest = np.arange(10 * self.bodies, len(z))
        found[rest, rest] = self.pull
        return found

    def _shares(self, barrier: float) -> tuple[float, float, float]:
        """Weights of the square and of -log det, and where the latter stands."""
        if self.metric == "log-det":
            return 0.0, self.weight, 0.0
        return self.weight, barrier, EDGE

    def _prior_slope(self, z: Array, barrier: float) -> Array:
        rest = 10 * self.bodies
        slope = np.empty_like(z)
        plain, curved, shift = self._shares(barrier)
        own = self.matrices(z)
        gap = -curved * np.linalg.inv(own - shift * np.eye(4))
        gap += curved * np.eye(4) if not plain else plain * (own - np.eye(4))
        slope[:rest] = coordinates(np.asarray(gap)).ravel()
        slope[rest:] = self.pull * (z[rest:] - 1)
        return slope

    def _value(self, z: Array, barrier: float) -> float:
        """Infinite where z is not inside."""
        slack = self.bound_rows @ z - self.bounds
        if (slack <= 0).any():
            return np.inf
        plain, curved, shift = self._shares(barrier)
        own = self.matrices(z)
        try:
            roots = np.linalg.cholesky(own - shift * np.eye(4))
        except np.linalg.LinAlgError:
            return np.inf
        rest = 10 * self.bodies
        spread = -2 * curved * np.log(np.einsum("nkk->nk", roots)).sum()
        away = curved * np.einsum("nkk->", own) if not plain else 0.0
        away += plain * ((own - np.eye(4)) ** 2).sum() / 2
        terms = (self.pull * (z[rest:] - 1) ** 2).sum() / 2
        fit = ((self.rows @ z - self.right) ** 2).sum() / 2
        return float(fit + spread + away + terms - barrier * np.log(slack).sum())

    def step(self, z: Array, barrier: float) -> tuple[Array, float]:
        """Newton's step, (m,), and its decrement squared."""
        slack = self.bound_rows @ z - self.bounds
        scaled = self.bound_rows / slack[:, None]
        slope = self.rows.T @ (self.rows @ z - self.right) + self._prior_slope(z, barrier)
        slope -= barrier * scaled.sum(axis=0)
        hessian = self.square + self.prior_hessian(z, barrier) + barrier * scaled.T @ scaled
        inner = self.free.T @ hessian @ self.free
        across = self.free.T @ slope
        size = 1 / np.sqrt(np.maximum(np.diagonal(inner), TINY))
        factor = linalg.cho_factor(inner * np.outer(size, size) + 1e-15 * np.eye(len(size)))
        move = -size * linalg.cho_solve(factor, size * across)
        return self.free @ move, float(-across @ move)

    def along(self, z: Array, move: Array, gain: float, barrier: float) -> Array | None:
        """The point a line search finds; None where no step gains any more."""
        here, length = self._value(z, barrier), 1.0
        while length > 1e-10:
            there = z + length * move
            if self._value(there, barrier) <= here - 0.01 * length * gain:
                return there
            length /= 2
        return None


def nearest(program: Program, start: Array) -> tuple[Array, float]:
    """Where the program is least, (m,), and how many sigmas are left to be gained there.

    Data alone would throw the bodies at once to the edge of what can be, along which Newton's
    steps are short. So the prior has a large weight first, which then falls to its own.

    Args:
        program: What is to be minimised.
        start: Inside: all Y positive definite, bounds and exact conditions obeyed, (m,).
    """
    z, gain = start, np.inf
    for weight, barrier in _stages(program, start):
        stage = replace(program, weight=weight, pull=program.pull * weight / program.weight)
        last = weight == program.weight and barrier == FADED
        enough = DONE if last else ROUGH * max(barrier, FADED)
        for _ in range(STEPS):
            move, gain = stage.step(z, barrier)
            if gain <= enough:
                break
            there = stage.along(z, move, gain, barrier)
            if there is None:  # rounding is all that is left
                break
            z = there
    return z, float(np.sqrt(max(gain, 0.0)))


def _stages(program: Program, start: Array) -> Iterator[tuple[float, float]]:
    """Weights of the prior and of the barriers, one pair after the other."""
    weight = max(program.weight, program.step(start, program.weight)[1] / 10)
    while weight > program.weight:
        yield weight, weight
        weight = max(weight / FALL, program.weight)
    barrier = program.weight
    while program.fades and barrier > FADED:
        yield program.weight, barrier
        barrier /= FALL
    yield program.weight, FADED


ZERO = 1e-4
"""Sigma of what was taken to be zero, in parts of the prior's bodies."""

ROOM = 1e-9
"""Part of the prior by which some bodies must be able to obey all conditions."""

PRICED = 1e-6
"""Part of the highest price of a condition that counts, where no bodies obey all."""


@dataclass(frozen=True, eq=False)
class Scaled:
    """Everything in scaled unknowns z: x = lead z.

    Attributes:
        prior: What the bodies are compared with.
        lead: Of x, standard parameters and terms, (10 n + t, m).
        data: The evidence's rows on z, (k, m), noise of sigma one.
        right: What they are, (k,).
        facts: Rows of what is known besides, noise of sigma one, (f, m).
        fact_values: What they are, (f,).
        own: Whether the file states each term, (t,): it is then drawn to it.
        positive: Places in z of terms that cannot be negative.
        conditions: As they are on z, each of norm one.
    """

    prior: Prior
    lead: Array
    data: Array
    right: Array
    facts: Array
    fact_values: Array
    own: Array
    positive: NDArray[np.int64]
    conditions: Conditions

    @property
    def bodies(self) -> int:
        """Number of bodies with matter."""
        return len(self.prior.massive)

    def matrices(self, z: Array) -> Array:
        """Y of every body with matter, (bodies, 4, 4), at unknowns z."""
        return of_coordinates(z[: 10 * self.bodies].reshape(-1, 10))

    def program(self, metric: Metric, weight: float) -> Program:
        """What is to be minimised.

        Args:
            metric: Of the distance to the prior.
            weight: Of that distance.
        """
        exact, bounds = self.conditions.exact, self.conditions.bounds
        free = null_space(exact.rows) if exact.names else np.eye(self.lead.shape[1])
        return Program(
            metric,
            self.bodies,
            np.vstack([self.data, self.facts]),
            np.concatenate([self.right, self.fact_values]),
            weight,
            weight * self.own,
            free,
            bounds.rows,
            bounds.values,
        )


def scaled(
    tree: Tree,
    prior: Prior,
    likelihoods: Sequence[Likelihood],
    asked: Conditions,
    terms: tuple[JointTerm, ...],
) -> Scaled:
    """The problem in numbers near one.

    Args:
        tree: The robot.
        prior: Its bodies before the data.
        likelihoods: What estimates say.
        asked: Conditions on x.
        terms: Of the joints' torque, in the order of x.
    """
    count, known = len(prior.massive), np.zeros(len(terms))
    sizes = np.zeros(len(terms))
    for k, term in enumerate(terms):
        joints_own = term.law == ROTOR and term.joint < tree.n
        known[k] = prior.rotors[term.joint] if joints_own else 0.0
        column = np.concatenate(
            [each.white @ each.rows[:, 10 * tree.n + k] for each in likelihoods]
        )
        steep = float(np.linalg.norm(column))
        sizes[k] = known[k] or _usual(tree, prior, term) or (1 / steep if steep else 1.0)
    lead = np.zeros((10 * tree.n + len(terms), 10 * count + len(terms)))
    lead[: 10 * tree.n, : 10 * count] = prior.root[:, np.repeat(prior.standard[:, 0] > 0, 10)]
    lead[10 * tree.n :, 10 * count :] = np.diag(sizes)
    data = np.vstack([each.white @ each.rows @ lead for each in likelihoods])
    right = np.concatenate([each.white @ each.estimate.values for each in likelihoods])
    doubtful = asked.doubtful
    facts = [doubtful.rows @ lead / doubtful.sigma[:, None]]
    facts += [_unit(each.zero @ lead)[0] / ZERO for each in likelihoods]
    values = np.concatenate([doubtful.values / doubtful.sigma, np.zeros(sum(map(len, facts[1:])))])
    rows, size = _unit(asked.rows @ lead)
    on = Conditions(asked.names, rows, asked.values / size, asked.sigma / size, asked.least)
    own = np.where(known > 0, 1.0, 0.0)
    positive = np.array([k for k, term in enumerate(terms) if term.positive], dtype=np.int64)
    at = 10 * count + positive
    return Scaled(prior, lead, data, right, np.vstack(facts), values, own, at, on)


def solve(problem: Scaled, metric: Metric, weight: float) -> tuple[Array, float]:
    """The unknowns z, (m,), and how many sigmas are left to be gained there.

    Args:
        problem: In numbers near one.
        metric: Of the distance to the prior.
        weight: Of that distance.

    Raises:
        SettingsError: No bodies obey all conditions; names those that contradict each other.
    """
    return nearest(problem.program(metric, weight), _inside(problem))


def _usual(tree: Tree, prior: Prior, term: JointTerm) -> float:
    """Size of a rotor of which the file says nothing: of the body's own inertia."""
    if term.law != ROTOR or term.joint not in prior.massive:
        return 0.0
    axis, body = tree.joints[term.joint].axis, matrices(prior.standard[term.joint])
    second = body[:3, :3]
    turning = float(np.trace(second) - axis @ second @ axis)
    return turning if tree.joints[term.joint].revolute else float(body[3, 3])


def _unit(rows: Array) -> tuple[Array, Array]:
    """Rows of norm one, and their norms, (k,)."""
    size = np.linalg.norm(rows, axis=1)
    size = np.where(size > 0, size, 1.0)
    return rows / size[:, None], size


def _inside(problem: Scaled) -> Array:
    """Unknowns that obey all conditions with room, (m,): the prior, or else others."""
    asked, m = problem.conditions, problem.lead.shape[1]
    one = np.ones(m)
    one[: 10 * problem.bodies] = np.tile(coordinates(np.eye(4)), problem.bodies)
    exact, bounds = asked.exact, asked.bounds
    kept = not exact.names or np.abs(exact.rows @ one - exact.values).max() <= ROOM
    if kept and (bounds.rows @ one - bounds.values > ROOM).all():
        return one
    # unknowns: z and the room that all conditions leave
    room = np.zeros((10 * problem.bodies, 1))
    room[:, 0] = one[: 10 * problem.bodies]
    bodies = np.eye(10 * problem.bodies, m)
    cones = [
        Cone("zero", np.pad(exact.rows, ((0, 0), (0, 1))), exact.values),
        Cone(
            "positive", np.hstack([-bounds.rows, np.ones((len(bounds.names), 1))]), -bounds.values
        ),
        Cone("matrices", np.hstack([-bodies, room]), np.zeros(len(bodies))),
        Cone("positive", np.eye(1, m + 1, m), np.array([0.5])),
    ]
    found = minimise(-np.eye(1, m + 1, m)[0], cones)
    if not found.solved or found.x[-1] <= ROOM:
        prices = np.abs(np.concatenate(found.prices[:2]))
        names = np.array([*exact.names, *bounds.names])[prices > PRICED * prices.max(initial=0.0)]
        raise SettingsError(
            f"no bodies obey all that is asked: {few(list(dict.fromkeys(names)), WIDTH, '; ')}"
        )
    z = found.x[:-1]
    return (
        z if not exact.names else z - np.linalg.pinv(exact.rows) @ (exact.rows @ z - exact.values)
    )
