"""Gaussian prior of bodies and joint terms from the model file, and regularised fits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from testbed.bodies.prior import PriorBodies
from testbed.bodies.row_products import RowProducts
from testbed.core.base.arrays import Array
from testbed.core.base.gaussian import Gaussian
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import (
    CENTRE_OF_MASS_PREFIX,
    TOTAL_MASS,
    known_value_constraints,
)
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    NormalEquations,
)
from testbed.core.parameters.pseudo_inertia import parameters, pseudo_inertias
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.rigid_matter import (
    POINT_MASS_RADIUS_RATIO,
    nearest_consistent_inertia,
)

MIN_DETERMINED_SHARE = 0.9
"""Smallest share of the prior variance that the data remove of a parameter they determine."""

UNINFORMATIVE_FACTOR = 1e3
"""Factor on the prior's root that makes the prior nearly uninformative."""

NOISE_ITERATIONS = 6
"""Number of fits, each with the noise variances of the residuals before."""

ROWS_PER_INDEPENDENT_ROW = 2.0
"""Number of filtered rows that carry the information of one independent row."""

MIN_FREEDOM_RATIO = 0.1
"""Smallest degrees of freedom of a channel's residuals, relative to its number of rows."""

MIN_NOISE_RATIO = 0.1
"""Smallest noise, relative to the rms residual of the model file with fitted friction."""

PLACEHOLDER_ERROR = 3.0
"""Relative error of placeholder bodies over that of other bodies."""

MIN_MOMENT_RATIO = 0.05
"""Smallest ratio of a body's principal second moments where they scale the prior's uncertainty: the
centre of mass of a slender link may lie beside its axis."""


@dataclass(frozen=True, eq=False)
class LinearPrior:
    """Gaussian prior of the unknowns, `mean + root z` with standard normal z.

    Attributes:
        mean: Prior mean of the unknowns, (p,).
        root: Root of the prior covariance root root', (p, r); the columns of the bodies come first.
        body_coordinate_count: Number of coordinates z that belong to bodies, ten per body.
        min_noise_variance: Smallest noise variance of each of the C channels, (C,) [N^2, N^2 m^2];
            infinite for channels with too few rows, which are ignored.
        lower_bounds: Lower bounds of z, (r,), which keep friction from becoming negative; -inf
            where there is no bound.
    """

    mean: Array
    root: Array
    body_coordinate_count: int
    min_noise_variance: Array
    lower_bounds: Array

    @property
    def variance(self) -> Array:
        """Variances of the unknowns, (p,)."""
        return np.asarray((self.root**2).sum(axis=1))

    def coordinate_sigmas(self, error: float) -> Array:
        """Standard deviations of z for another relative error of the bodies, (r,).

        They are `error` for the coordinates of bodies and one for all other coordinates.

        Args:
            error: Relative error of the bodies.
        """
        return np.where(
            np.arange(self.root.shape[1]) < self.body_coordinate_count, error, 1.0
        )

    def with_error_factor(self, error: float) -> LinearPrior:
        """Prior with the relative error of the bodies multiplied by a factor.

        Args:
            error: Factor on the relative error of the bodies.
        """
        return replace(self, root=self.coordinate_sigmas(error) * self.root)


def linear_prior(
    problem: Problem, prior: PriorBodies, rows: RowProducts
) -> LinearPrior:
    """Gaussian prior of the unknowns from the model file, with nearly free joint terms.

    The relative error is one for bodies and three for bodies with placeholder numbers. Because the
    joint terms in files are often guesses, a joint term has mean zero and a sigma for which the
    term alone would explain the rms torque. If no channel with enough rows excites a term, the
    value in the file is its sigma and, unless that value is a placeholder, also its mean. In wrench
    problems, the prior is conditioned on the values of `Settings.known`.

    Args:
        problem: Problem with the unknowns.
        prior: Bodies of the model file.
        rows: Products of all rows.
    """
    bodies, count = problem.minimal.standard_matrix, problem.minimal.count
    width = np.ones((problem.tree.n, 10))
    width[list(prior.placeholders.bodies)] = PLACEHOLDER_ERROR
    mean, root = _terms_prior(problem, prior, rows)
    mean[:count] += bodies @ prior.standard.ravel()
    body_root = np.zeros((len(mean), 10 * problem.tree.n))
    body_root[:count] = bodies @ (
        width.ravel() * _with_bounded_slenderness(prior).standard_from_coordinates
    )
    root = np.hstack([body_root, root])
    noise_floor = np.full(len(rows.channels), SMALLEST_POSITIVE)
    linear = LinearPrior(
        mean, root, bodies.shape[1], noise_floor, _lower_bounds(problem, mean, root)
    )
    linear = _conditioned_on_facts(problem, linear)
    values = file_with_fitted_terms(rows, linear)
    noise = (
        MIN_NOISE_RATIO**2
        * rows.residual_squares(values, rows.mean_residuals(values))
        / np.maximum(rows.rows, 1.0)
    )
    return replace(
        linear,
        min_noise_variance=np.where(
            rows.has_enough_rows, np.maximum(noise, noise_floor), np.inf
        ),
    )


def bodies_prior(problem: Problem, prior: PriorBodies, error: float) -> Gaussian:
    """Gaussian prior of the bodies' minimal parameters from the model file.

    Args:
        problem: Problem with the minimal parameters.
        prior: Bodies of the model file.
        error: Relative error of the bodies; three times as large for placeholder bodies.
    """
    minimal = problem.minimal
    width = np.ones((problem.tree.n, 10))
    width[list(prior.placeholders.bodies)] = PLACEHOLDER_ERROR
    root = (
        error
        * minimal.standard_matrix
        @ (width.ravel() * _with_bounded_slenderness(prior).standard_from_coordinates)
    )
    mean = minimal.standard_matrix @ prior.standard.ravel()
    return Gaussian(minimal.names, minimal.units, mean, root @ root.T)


def _terms_prior(
    problem: Problem, prior: PriorBodies, rows: RowProducts
) -> tuple[Array, Array]:
    """Prior mean, (p,), and root of the prior covariance, (p, k), of k joint terms.

    For an excited term, the mean is zero and sigma is the ratio of the rms torque to the rms of the
    term's regressor column, in the channel where this column is largest. For other terms, sigma is
    the value in the file, which is also the mean unless it is a placeholder.
    """
    drives, zeros = problem.drives, np.zeros(len(problem.names))
    if drives is None:
        return zeros, np.zeros((len(zeros), 0))
    equations = rows.equations(drives.columns, zeros)
    column_squares = (
        np.einsum("cii->ci", equations.normal) * rows.has_enough_rows[:, None]
    )
    channel = column_squares.argmax(
        axis=0
    )  # channel with the largest signal of each term
    excitation = column_squares[channel, np.arange(len(channel))]
    is_excited = excitation > 0
    scale = np.sqrt(
        equations.squares[channel] / np.where(is_excited, excitation, np.inf)
    )
    stated = drives.values(np.zeros((problem.tree.n, 10)), problem.tree)
    is_placeholder = [
        each.law.parameter in prior.placeholders.friction for each in drives.asked
    ]
    is_as_stated = drives.columns[:, ~is_excited].any(axis=1)
    is_as_stated &= ~drives.columns[:, is_placeholder].any(axis=1)
    sigma = np.where(is_excited, scale, np.abs(drives.columns.T @ stated))
    return np.where(is_as_stated, stated, 0.0), drives.columns * sigma


def _with_bounded_slenderness(prior: PriorBodies) -> PriorBodies:
    """Prior with lower bounds on the bodies' principal second moments.

    The bound is `MIN_MOMENT_RATIO` times the largest principal second moment of the body.
    """
    bodies = np.array(prior.standard)
    for k in prior.massive_bodies:
        body = Inertia.of_pseudo(pseudo_inertias(bodies[k]))
        bodies[k] = parameters(
            nearest_consistent_inertia(
                body, MIN_MOMENT_RATIO, body.mass, POINT_MASS_RADIUS_RATIO
            ).pseudo
        )
    return replace(prior, standard=bodies)


def _conditioned_on_facts(problem: Problem, prior: LinearPrior) -> LinearPrior:
    """Prior of a wrench problem conditioned on the known values in `Settings.known`.

    The known values are masses, centres of mass and parameters. Their uncertainty is the stated
    uncertainty, whatever the relative error of the bodies. The priors of other problems are
    returned unchanged.
    """
    names = {TOTAL_MASS, *problem.names}
    given_facts = {
        k: v
        for k, v in problem.settings.facts.items()
        if k in names or k.startswith(CENTRE_OF_MASS_PREFIX)
    }
    if problem.method != "wrench" or not given_facts:
        return prior
    known = known_value_constraints(
        problem.tree, problem.minimal, problem.names, (), given_facts
    ).on_corrections(prior.mean)
    rows = known.rows @ prior.root
    gain = np.linalg.solve(rows @ rows.T, rows).T
    parameter_gain = prior.root @ gain
    return replace(
        prior,
        mean=prior.mean + parameter_gain @ known.values,
        root=np.hstack(
            [
                prior.root - parameter_gain @ rows,
                parameter_gain @ known.covariance_root(np.zeros(len(parameter_gain))),
            ]
        ),
        lower_bounds=np.append(prior.lower_bounds, np.full(len(given_facts), -np.inf)),
    )


def _lower_bounds(problem: Problem, mean: Array, root: Array) -> Array:
    """Lower bounds of z, (r,), at which friction in mean + root z is zero.

    The bound is -inf for coordinates of bodies, of terms that are not dissipative, and of friction
    that is part of a coefficient together with terms of other shafts.

    Args:
        problem: Problem with the unknowns.
        mean: Prior mean of the unknowns, (p,).
        root: Root of the prior covariance, (p, r).
    """
    least = np.full(root.shape[1], -np.inf)
    terms = () if problem.drives is None else problem.drives.terms
    for k, term in enumerate(terms, start=problem.minimal.count):
        (coordinates,) = np.nonzero(root[k])
        # otherwise the coefficient is a sum with terms of other shafts
        if term.law.dissipative and len(coordinates) == 1:
            least[coordinates] = -mean[k] / root[k, coordinates]
    return least


def fit_with_prior(rows: RowProducts, prior: LinearPrior) -> tuple[Array, Array]:
    """Least squares with a prior, with noise variances estimated from the residuals.

    Friction coefficients are not negative (`LinearPrior.lower_bounds`).

    Args:
        rows: Products of the rows that are used.
        prior: Prior of the unknowns.

    Returns:
        Values of the unknowns, (p,), and their covariance if friction had no bounds, (p, p).
    """
    fit = fit_with_estimated_noise(
        rows.equations(prior.root, prior.mean), prior, rows.has_enough_rows
    )
    return prior.mean + prior.root @ fit.z, prior.root @ fit.covariance @ prior.root.T


@dataclass(frozen=True, eq=False)
class PriorFit:
    """Posterior mode and covariance of the dimensionless coordinates z of a Gaussian prior.

    Attributes:
        z: Estimate, (r,).
        covariance: Covariance of z if friction had no bounds, (r, r).
        noise: Noise variance of each of the C channels, (C,) [N^2, N^2 m^2].
    """

    z: Array
    covariance: Array
    noise: Array


def fit_with_estimated_noise(
    equations: NormalEquations, prior: LinearPrior, has_enough_rows: NDArray[np.bool_]
) -> PriorFit:
    """Posterior of z with the noise variance of each channel estimated from the residuals.

    Fit and noise variances are computed in turn, as in iteratively reweighted least squares, with
    `NOISE_ITERATIONS` (6) fits. For a channel with too few rows, the noise variance is at least the
    mean square deviation of the measurement from the prediction of the prior mean.

    Args:
        equations: Normal equations in z.
        prior: Prior of z, with the smallest noise variances and the lower bounds.
        has_enough_rows: True for channels with enough rows to estimate the noise, (C,).
    """
    used = np.maximum(equations.used, 1.0)
    noise = np.maximum(equations.squares / used, prior.min_noise_variance)
    floor = np.where(
        has_enough_rows, prior.min_noise_variance, noise
    )  # few rows do not determine the noise
    fit = fit_with_noise(equations, noise, prior.lower_bounds)
    for _ in range(NOISE_ITERATIONS - 1):
        parameter_freedom = (
            np.einsum("cij,ji->c", equations.normal, fit.covariance) / noise
        )
        variance = equations.residual(fit.z) / np.maximum(
            used - parameter_freedom, MIN_FREEDOM_RATIO * used
        )
        noise = np.maximum(variance, floor)
        fit = fit_with_noise(equations, noise, prior.lower_bounds)
    return fit


def fit_with_noise(
    equations: NormalEquations, noise: Array, lower_bounds: Array
) -> PriorFit:
    """Posterior of z for given noise variances.

    Two filtered rows count as one independent row (`ROWS_PER_INDEPENDENT_ROW`).

    Args:
        equations: Normal equations in z.
        noise: Noise variance of each of the C channels, (C,); infinite for channels that are
            ignored.
        lower_bounds: Lower bounds of z, (r,).
    """
    weights = np.where(equations.used > 0, 1 / (ROWS_PER_INDEPENDENT_ROW * noise), 0.0)
    normal, right = equations.matrix(weights), equations.vector(weights)
    return PriorFit(*bounded_posterior(normal, right, lower_bounds), noise)


def bounded_posterior(
    normal: Array, right: Array, lower_bounds: Array
) -> tuple[Array, Array]:
    """Posterior mode of z within bounds, (r,), and posterior covariance without bounds, (r, r).

    The prior of z has zero mean and unit covariance.

    Args:
        normal: Information matrix of the data on z, (r, r).
        right: Information matrix times the least-squares estimate of z, (r,).
        lower_bounds: Lower bounds of z, (r,).
    """
    matrix = np.asarray(normal + np.eye(len(lower_bounds)), dtype=np.float64)
    covariance = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    return _bounded_mode(covariance @ right, covariance, lower_bounds), covariance


def _bounded_mode(free: Array, covariance: Array, least: Array) -> Array:
    """Mode of a Gaussian within lower bounds, (r,), by a primal-dual active-set method.

    Source    [HIK02]

    Args:
        free: Mode without bounds, (r,).
        covariance: Covariance, (r, r).
        least: Lower bounds, (r,).
    """
    z, active = free, free < least
    for _ in range(len(z)):
        bound = np.flatnonzero(active)
        if not bound.size:
            break
        multipliers = np.linalg.solve(
            covariance[np.ix_(bound, bound)], (least - free)[bound]
        )
        z = free + covariance[:, bound] @ multipliers
        z[bound] = least[bound]
        previous, active = active, z < least
        active[bound] = multipliers > 0
        if (active == previous).all():
            break
    return z


def determined_by_data(rows: RowProducts, prior: LinearPrior) -> NDArray[np.bool_]:
    """Mask of the unknowns that the data determine without the prior, (p,).

    An unknown is determined if a fit with a nearly uninformative prior reduces its variance to at
    most a tenth of the variance of `prior` (`MIN_DETERMINED_SHARE`). The sigmas of the
    uninformative prior are a thousand times as large, because correlations of mass, centre of mass
    and inertia in the model file must not count as data.

    Args:
        rows: Products of the rows that are used.
        prior: Prior of the unknowns.
    """
    _, covariance = fit_with_prior(
        rows, replace(prior, root=UNINFORMATIVE_FACTOR * prior.root)
    )
    return np.diagonal(covariance) <= (1 - MIN_DETERMINED_SHARE) * prior.variance


def file_with_fitted_terms(rows: RowProducts, prior: LinearPrior) -> Array:
    """Unknowns with the model file's bodies and joint terms fitted to rows, (p,).

    Args:
        rows: Products of the rows that are used.
        prior: Prior of the unknowns.
    """
    return fit_with_prior(rows, prior.with_error_factor(0.0))[0]
