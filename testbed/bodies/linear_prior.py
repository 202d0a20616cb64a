"""The model file's bodies and the joints' own terms as a linear prior, and fits with it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from testbed.bodies.prior import Prior
from testbed.bodies.row_products import RowProducts
from testbed.core.base.arrays import Array
from testbed.core.base.gaussian import Gaussian
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import CENTRE, MASS, facts
from testbed.core.estimation.regression.normal_equations import TINY, NormalEquations
from testbed.core.parameters.pseudo_inertia import matrices, parameters
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.rigid_matter import SMALL, nearest_body

DETERMINED = 0.9
"""Share of the prior's variance that the data remove of a parameter that they determine."""

WIDE = 1e3
"""Times a prior that is none, nearly."""

ROUNDS = 6
"""Times that the noise of the channels is estimated anew."""

REPEATED = 2.0
"""Rows that say as much as one: the filter on rows leaves half of them independent."""

FEWEST = 0.1
"""Part of a channel's rows that parameters leave at least to estimate its noise."""

LEAST = 0.1
"""Part of what the model file with its friction fitted leaves that noise is at least."""

DOUBTFUL = 3.0
"""Error of a placeholder in errors of other bodies."""

ROUNDEST = 0.05
"""Share of a body's greatest second moment that the others have at least, of the body by whose size
uncertainty is measured: the centre of a slender link may lie beside its axis."""


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
        """Variances of the unknowns, (p,)."""
        return np.asarray((self.root**2).sum(axis=1))

    def scale(self, error: float) -> Array:
        """Standard deviations of z, (r,), where the bodies have another error than one.

        Args:
            error: Relative error of the bodies.
        """
        return np.where(np.arange(self.root.shape[1]) < self.bodies, error, 1.0)

    def times(self, error: float) -> LinearPrior:
        """The same prior with another error of the bodies.

        Args:
            error: Over the one that it has.
        """
        return replace(self, root=self.scale(error) * self.root)


def linear_prior(problem: Problem, prior: Prior, rows: RowProducts) -> LinearPrior:
    """Gaussian prior of the unknowns by the model file; joint terms are nearly free.

    Bodies have a relative error of one. Friction is about zero and as wide as the torques: files
    state it by guess. Where rows are too few, friction of the file stands that is no placeholder,
    uncertain by itself.

    Args:
        problem: Says which unknowns.
        prior: The file's bodies.
        rows: Products of all rows.
    """
    bodies, count = problem.minimal.standard_matrix, problem.minimal.count
    width = np.ones((problem.tree.n, 10))
    width[list(prior.placeholders.bodies)] = DOUBTFUL
    mean, root = _terms_prior(problem, prior, rows)
    mean[:count] += bodies @ prior.standard.ravel()
    of_bodies = np.zeros((len(mean), 10 * problem.tree.n))
    of_bodies[:count] = bodies @ (width.ravel() * _thickened(prior).root)
    root = np.hstack([of_bodies, root])
    floor = np.full(len(rows.channels), TINY)
    before = LinearPrior(
        mean, root, bodies.shape[1], floor, _bounds(problem, mean, root)
    )
    before = _with_facts(problem, before)
    left = refitted(rows, before)
    noise = (
        LEAST**2 * rows.squares(left, rows.constants(left)) / np.maximum(rows.rows, 1.0)
    )
    return replace(
        before, noise=np.where(rows.enough, np.maximum(noise, floor), np.inf)
    )


def bodies_prior(problem: Problem, prior: Prior, error: float) -> Gaussian:
    """Minimal parameters of bodies by the model file, before any data.

    Args:
        problem: Says which parameters.
        prior: The file's bodies.
        error: Their relative error.
    """
    minimal = problem.minimal
    width = np.ones((problem.tree.n, 10))
    width[list(prior.placeholders.bodies)] = DOUBTFUL
    root = error * minimal.standard_matrix @ (width.ravel() * _thickened(prior).root)
    mean = minimal.standard_matrix @ prior.standard.ravel()
    return Gaussian(minimal.names, minimal.units, mean, root @ root.T)


def _terms_prior(
    problem: Problem, prior: Prior, rows: RowProducts
) -> tuple[Array, Array]:
    """Mean, (p,), and root of the covariance, (p, k), of the k joint terms."""
    drives, none = problem.drives, np.zeros(len(problem.names))
    if drives is None:
        return none, np.zeros((len(none), 0))
    equations = rows.equations(drives.columns, none)
    squares = np.einsum("cii->ci", equations.normal) * rows.enough[:, None]
    channel = squares.argmax(axis=0)  # where each term shows most
    most = squares[channel, np.arange(len(channel))]
    seen = most > 0
    scale = np.sqrt(equations.squares[channel] / np.where(seen, most, np.inf))
    stated = drives.values(np.zeros((problem.tree.n, 10)), problem.tree)
    doubtful = [
        each.law.parameter in prior.placeholders.friction for each in drives.asked
    ]
    believed = drives.columns[:, ~seen].any(axis=1)
    believed &= ~drives.columns[:, doubtful].any(axis=1)
    own = np.where(seen, scale, np.abs(drives.columns.T @ stated))
    return np.where(believed, stated, 0.0), drives.columns * own


def _thickened(prior: Prior) -> Prior:
    """Prior with bodies whose second moments are at least ROUNDEST of their greatest one."""
    bodies = np.array(prior.standard)
    for k in prior.massive:
        body = Inertia.of_pseudo(matrices(bodies[k]))
        bodies[k] = parameters(nearest_body(body, ROUNDEST, body.mass, SMALL).pseudo)
    return replace(prior, standard=bodies)


def _with_facts(problem: Problem, prior: LinearPrior) -> LinearPrior:
    """The same where something of the bodies is known (`Settings.known`), by the plate.

    It is as uncertain as it is said to be, whatever the error of the bodies.
    """
    names = {MASS, *problem.names}
    given = {
        k: v
        for k, v in problem.settings.facts.items()
        if k in names or k.startswith(CENTRE)
    }
    if problem.method != "external" or not given:
        return prior
    known = facts(problem.tree, problem.minimal, problem.names, (), given).around(
        prior.mean
    )
    rows = known.rows @ prior.root
    gain = np.linalg.solve(rows @ rows.T, rows).T
    added = prior.root @ gain
    return replace(
        prior,
        mean=prior.mean + added @ known.values,
        root=np.hstack(
            [prior.root - added @ rows, added @ known.doubt(np.zeros(len(added)))]
        ),
        least=np.append(prior.least, np.full(len(given), -np.inf)),
    )


def _bounds(problem: Problem, mean: Array, root: Array) -> Array:
    """Least coordinates, (r,), of mean + root z without negative friction."""
    least = np.full(root.shape[1], -np.inf)
    terms = () if problem.drives is None else problem.drives.terms
    for k, term in enumerate(terms, start=problem.minimal.count):
        (own,) = np.nonzero(root[k])
        # else it is a sum with terms of other shafts
        if term.law.resists and len(own) == 1:
            least[own] = -mean[k] / root[k, own]
    return least


def with_prior(rows: RowProducts, prior: LinearPrior) -> tuple[Array, Array]:
    """Least squares with a prior, under noise that its own residuals show.

    Friction that would drive the motion is zero.

    Args:
        rows: Products of the rows that are used.
        prior: Of the unknowns.

    Returns:
        Values, (p,), and their covariance, (p, p): that without the bounds of friction.
    """
    fit = fit_of_noise(rows.equations(prior.root, prior.mean), prior, rows.enough)
    return prior.mean + prior.root @ fit.z, prior.root @ fit.covariance @ prior.root.T


@dataclass(frozen=True, eq=False)
class PriorFit:
    """Posterior mean and covariance of a Gaussian prior's coordinates z, without units.

    Attributes:
        z: Estimate, (r,).
        covariance: Covariance of z without the bounds of friction, (r, r).
        noise: Variance of each channel's noise, (C,) [N^2, N^2 m^2].
    """

    z: Array
    covariance: Array
    noise: Array


def fit_of_noise(
    equations: NormalEquations, prior: LinearPrior, enough: NDArray[np.bool_]
) -> PriorFit:
    """Fit under the noise that its own residuals show, channel by channel.

    Args:
        equations: Normal equations in z.
        prior: Prior of z, with the least noise and the bounds.
        enough: Whether the rows of a channel show its noise, (C,).
    """
    used = np.maximum(equations.used, 1.0)
    noise = np.maximum(equations.squares / used, prior.noise)
    floor = np.where(enough, prior.noise, noise)  # few rows show no noise
    fit = fit_with_noise(equations, noise, prior.least)
    for _ in range(ROUNDS - 1):
        lost = np.einsum("cij,ji->c", equations.normal, fit.covariance) / noise
        left = equations.residual(fit.z) / np.maximum(used - lost, FEWEST * used)
        noise = np.maximum(left, floor)
        fit = fit_with_noise(equations, noise, prior.least)
    return fit


def fit_with_noise(equations: NormalEquations, noise: Array, least: Array) -> PriorFit:
    """Fit under given noise.

    Args:
        equations: Normal equations in z.
        noise: Variance of each channel's noise, (C,); infinite for rows that count for nothing.
        least: Least values of z, (r,).
    """
    weights = np.where(equations.used > 0, 1 / (REPEATED * noise), 0.0)
    normal, right = equations.matrix(weights), equations.vector(weights)
    return PriorFit(*conditioned(normal, right, least), noise)


def conditioned(normal: Array, right: Array, least: Array) -> tuple[Array, Array]:
    """Coordinates of a prior with data: likeliest z above its bounds, (r,); covariance, (r, r).

    Args:
        normal: Information of the data on z, (r, r).
        right: Information times the z that the data alone would have, (r,).
        least: Least values of z, (r,).
    """
    matrix = np.asarray(normal + np.eye(len(least)), dtype=np.float64)
    covariance = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    return _bounded(covariance @ right, covariance, least), covariance


def _bounded(free: Array, covariance: Array, least: Array) -> Array:
    """Likeliest z above its bounds, by a primal-dual active set.

    Source    [HIK02]
    """
    z, active = free, free < least
    for _ in range(len(z)):
        bound = np.flatnonzero(active)
        if not bound.size:
            break
        pull = np.linalg.solve(covariance[np.ix_(bound, bound)], (least - free)[bound])
        z = free + covariance[:, bound] @ pull
        z[bound] = least[bound]
        before, active = active, z < least
        active[bound] = pull > 0
        if (active == before).all():
            break
    return z


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
