"""The program of physically consistent bodies: made, started inside, solved.

Unknowns are scaled: a body's J is U Y U' with U a root of the prior's, so that Y is one at the
prior for grams and for tonnes; a joint's term is counted in parts of a usual size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from testbed.arrays import Array
from testbed.errors import WIDTH, SettingsError, few
from testbed.identification.consistency.conic import Cone, minimise
from testbed.identification.consistency.interior_point import Program, nearest
from testbed.identification.consistency.likelihood import Likelihood
from testbed.identification.consistency.linear_constraints import Conditions
from testbed.identification.consistency.options import Metric
from testbed.parameters.prior import Prior
from testbed.parameters.pseudo_inertia import (
    coordinates,
    matrices,
    of_coordinates,
    standard_of_coordinates,
)
from testbed.robot.friction import ROTOR, JointTerm
from testbed.robot.inertia import upper_root
from testbed.robot.tree import Tree

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
        conditions: As they are on z, each of norm one.
    """

    prior: Prior
    lead: Array
    data: Array
    right: Array
    facts: Array
    fact_values: Array
    own: Array
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
    bodies = prior.standard[list(prior.massive)]
    roots = np.array([upper_root(each) for each in matrices(bodies)]).reshape(count, 4, 4)
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
    for k, (body, own) in enumerate(
        zip(prior.massive, standard_of_coordinates(roots), strict=True)
    ):
        lead[10 * body : 10 * body + 10, 10 * k : 10 * k + 10] = own
    lead[10 * tree.n :, 10 * count :] = np.diag(sizes)
    data = np.vstack([each.white @ each.rows @ lead for each in likelihoods])
    right = np.concatenate([each.white @ each.estimate.values for each in likelihoods])
    doubtful = asked.doubtful
    facts = [doubtful.rows @ lead / doubtful.sigma[:, None]]
    facts += [_unit(each.zero @ lead)[0] / ZERO for each in likelihoods]
    values = np.concatenate([doubtful.values / doubtful.sigma, np.zeros(sum(map(len, facts[1:])))])
    rows, size = _unit(asked.rows @ lead)
    on = Conditions(asked.names, rows, asked.values / size, asked.sigma / size, asked.least)
    return Scaled(
        prior, lead, data, right, np.vstack(facts), values, np.where(known > 0, 1.0, 0.0), on
    )


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
