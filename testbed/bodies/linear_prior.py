"""The model file's bodies and the joints' own terms as a linear prior, and fits with it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from testbed.bodies.prior import Prior
from testbed.bodies.row_products import RowProducts
from testbed.core.base.arrays import Array
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import CENTRE, MASS, facts
from testbed.core.estimation.regression.normal_equations import TINY

PRIOR_ERROR = 0.5
"""Of the model file's bodies, in parts of themselves: before the data, as one coordinate counts."""

MOST_ERROR = 10.0
"""Error of a file that says nothing: evidence for a larger one is evidence against file or data."""

ITERATIONS = 50
"""Of the prior's error at most."""

SETTLED = 1e-3
"""Relative change of the prior's error that is none."""

DETERMINED = 0.9
"""Share of the prior's variance that the data remove of a parameter that they determine."""

WIDE = 1e3
"""Times a prior that is none, nearly."""

ROUNDS = 6
"""Times that the noise of the channels is estimated anew."""

FEWEST = 0.1
"""Part of a channel's rows that parameters leave at least to estimate its noise."""

LEAST = 0.1
"""Part of what the model file with its friction fitted leaves that noise is at least."""


@dataclass(frozen=True, eq=False)
class LinearPrior:
    """Unknowns before the data: mean + root z, z of independent numbers of variance one.

    Attributes:
        mean: (p,).
        root: (p, r), those of the bodies first.
        bodies: How many of z are of bodies.
        noise: Variance of each channel's noise at least, (C,) [N^2, N^2 m^2]; infinite where rows
            are too few: they count for nothing.
        least: Of z, (r,): friction is not negative; -inf for no bound.
    """

    mean: Array
    root: Array
    bodies: int
    noise: Array
    least: Array

    @property
    def variance(self) -> Array:
        """(p,)."""
        return np.asarray((self.root**2).sum(axis=1))

    def times(self, factor: float) -> LinearPrior:
        """The same with another error of the bodies.

        Args:
            factor: Over the one that it has.
        """
        of_bodies = np.arange(self.root.shape[1]) < self.bodies
        return replace(self, root=np.where(of_bodies, factor, 1.0) * self.root)


def linear_prior(problem: Problem, prior: Prior, error: float, rows: RowProducts) -> LinearPrior:
    """Gaussian prior of the unknowns by the model file; joint terms are nearly free.

    Args:
        problem: Says which unknowns.
        prior: The file's bodies.
        error: Of these, in parts of themselves.
        rows: Products of all rows.
    """
    count, drives = problem.minimal.count, problem.drives
    bodies = problem.minimal.standard_matrix
    mean, root = np.zeros(len(problem.names)), np.zeros((len(problem.names), 10 * problem.tree.n))
    mean[:count], root[:count] = bodies @ prior.standard.ravel(), error * bodies @ prior.root
    if drives is not None:
        equations = rows.equations(drives.columns, np.zeros(len(mean)))
        size = np.einsum("cii->ci", equations.normal)
        most = size.argmax(axis=0), np.arange(size.shape[1])  # the channel where each shows most
        scale = np.sqrt(equations.squares[most[0]] / np.where(size[most] > 0, size[most], np.inf))
        own = drives.values(np.zeros((problem.tree.n, 10)), problem.tree)
        mean += own
        root = np.hstack([root, drives.columns * np.hypot(scale, drives.columns.T @ own)])
    tiny = np.full(len(rows.channels), TINY)
    before = LinearPrior(mean, root, bodies.shape[1], tiny, _bounds(problem, mean, root))
    before = _with_facts(problem, before)
    left = refitted(rows, before)
    noise = LEAST**2 * rows.squares(left, rows.constants(left)) / np.maximum(rows.rows, 1.0)
    return replace(before, noise=np.where(rows.enough, np.maximum(noise, tiny), np.inf))


def _with_facts(problem: Problem, prior: LinearPrior) -> LinearPrior:
    """The same where something of the bodies is known (`Settings.known`), by the plate.

    It is as uncertain as it is said to be, whatever the error of the bodies.
    """
    names = {MASS, *problem.names}
    given = {k: v for k, v in problem.settings.facts.items() if k in names or k.startswith(CENTRE)}
    if problem.method != "external" or not given:
        return prior
    known = facts(problem.tree, problem.minimal, problem.names, (), given).around(prior.mean)
    rows = known.rows @ prior.root
    gain = np.linalg.solve(rows @ rows.T, rows).T
    added = prior.root @ gain
    return replace(
        prior,
        mean=prior.mean + added @ known.values,
        root=np.hstack([prior.root - added @ rows, added @ known.doubt(np.zeros(len(added)))]),
        least=np.append(prior.least, np.full(len(given), -np.inf)),
    )


def _bounds(problem: Problem, mean: Array, root: Array) -> Array:
    """Least coordinates, (r,), of mean + root z without negative friction."""
    least = np.full(root.shape[1], -np.inf)
    terms = () if problem.drives is None else problem.drives.terms
    for k, term in enumerate(terms, start=problem.minimal.count):
        (own,) = np.nonzero(root[k])
        if term.law.resists and len(own) == 1:  # else it is a sum with terms of other shafts
            least[own] = -mean[k] / root[k, own]
    return least


def with_prior(rows: RowProducts, prior: LinearPrior) -> tuple[Array, Array]:
    """Least squares with a prior, under noise that its own residuals show.

    A channel's noise is as strong as what is left, and (1 + r) / (1 - r) rows of a correlation r
    from one to the next say as much as one alone. Friction that would drive the motion is zero.

    Args:
        rows: Products of the rows that are used.
        prior: Of the unknowns.

    Returns:
        Values, (p,), and their covariance, (p, p): that without the bounds of friction.
    """
    z, after = _linear(rows, prior)
    return prior.mean + prior.root @ z, prior.root @ after @ prior.root.T


def _linear(rows: RowProducts, prior: LinearPrior) -> tuple[Array, Array]:
    """The same: z, (r,), and its covariance, (r, r)."""
    equations = rows.equations(prior.root, prior.mean)
    used = np.maximum(equations.used, 1.0)
    variance = np.maximum(equations.squares / used, prior.noise)
    floor = np.where(rows.enough, prior.noise, variance)  # few rows show no noise
    repeated, z = np.ones(len(used)), np.zeros(prior.root.shape[1])
    after: Array = np.eye(len(z))
    for _ in range(ROUNDS):
        weights = np.where(equations.used > 0, 1 / (variance * repeated), 0.0)
        normal = equations.matrix(weights) + np.eye(len(z))
        after = np.asarray(np.linalg.inv(normal))
        z = after @ equations.vector(weights)
        if (z < prior.least).any():
            root = np.linalg.cholesky(normal).T
            z = lsq_linear(root, root @ z, (prior.least, np.inf), method="bvls").x
        correlation = rows.correlation(prior.mean + prior.root @ z, prior.noise * used)
        repeated = (1 + correlation) / (1 - correlation)
        lost = np.einsum("cij,ji->c", equations.normal, after) / variance
        left = equations.residual(z) / np.maximum(used - lost, FEWEST * used)
        variance = np.maximum(left, floor)
    return z, after


def alone_determined(rows: RowProducts, prior: LinearPrior) -> NDArray[np.bool_]:
    """Which unknowns the data alone determine: nearly nothing else is known of any, (p,).

    The prior's bodies hold mass, centre and inertia together; what it carries from one parameter to
    another is not the data's.

    Args:
        rows: Products of the rows that are used.
        prior: Of the unknowns.
    """
    _, covariance = with_prior(rows, replace(prior, root=WIDE * prior.root))
    return np.diagonal(covariance) <= (1 - DETERMINED) * prior.variance


def refitted(rows: RowProducts, prior: LinearPrior) -> Array:
    """The model file's values, the joints' own terms fitted, (p,).

    Args:
        rows: Products of the rows that are used.
        prior: Of the unknowns.
    """
    return with_prior(rows, prior.times(0.0))[0]


def likeliest(rows: RowProducts, prior: LinearPrior) -> float:
    """The error of the bodies that makes data likeliest: the evidence's fixed point.

    Coordinates that the data determine have this error on average; `PRIOR_ERROR` counts as one.

    Source    [Mac92]

    Args:
        rows: Products of the rows that are used.
        prior: Of their unknowns, with `PRIOR_ERROR`.
    """
    error = PRIOR_ERROR
    for _ in range(ITERATIONS):
        z, after = (x[: prior.bodies] for x in _linear(rows, prior.times(error / PRIOR_ERROR)))
        square = PRIOR_ERROR**2 + error**2 * z @ z
        likely = float(np.sqrt(square / (1 + (1 - np.diagonal(after)).sum())))
        before, error = error, min(likely, MOST_ERROR)
        if abs(error - before) < SETTLED * before:
            break
    return error
