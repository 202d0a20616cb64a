"""Prediction errors of consistent bodies on held-out data, added to posteriors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from testbed.bodies.consistency.consistent import Consistent, consistent
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.linear_prior import (
    UNINFORMATIVE_FACTOR,
    file_with_fitted_terms,
    fit_with_prior,
    linear_prior,
)
from testbed.bodies.posterior import Posterior, held_out_errors
from testbed.bodies.prediction_errors import CONSISTENT, REFITTED
from testbed.bodies.prior import PriorBodies
from testbed.bodies.row_products import RowParts, RowProducts
from testbed.core.base.arrays import Array
from testbed.core.base.errors import TestbedError
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.parameters.rules import Signal


def with_estimated_prior_error(
    options: ConsistencyOptions, posteriors: Iterable[Posterior]
) -> ConsistencyOptions:
    """Options with the smallest prior error of the posteriors that need a prior.

    The options are unchanged if no posterior needs a prior (`Posterior.used`).

    Args:
        options: Options of consistent bodies.
        posteriors: Posteriors from one recording.
    """
    errors = [each.prior_error for each in posteriors if each.used]
    return replace(options, prior_error=min(errors, default=options.prior_error))


def with_consistent_predictions(
    posteriors: Mapping[Signal, Posterior],
    bodies: Consistent,
    rows: Mapping[Signal, RowParts],
    prior: PriorBodies,
    estimates: Mapping[Signal, Estimate],
    options: ConsistencyOptions,
) -> dict[Signal, Posterior]:
    """Add the values and held-out prediction errors of consistent bodies to posteriors.

    For each held-out part, the consistent bodies are computed from the training data of one method
    only; if that fails, the values of the model file are used.

    Args:
        posteriors: Posteriors, keyed by method.
        bodies: Consistent bodies from the whole recording.
        rows: Gram matrices of the recording's rows, keyed by method.
        prior: Bodies of the model file.
        estimates: Least-squares estimates, keyed by method; a posterior without an estimate is
            unchanged.
        options: Options of the consistent bodies.
    """

    def with_consistent(posterior_estimate: Posterior, estimate: Estimate) -> Posterior:
        parts = rows[posterior_estimate.method]
        problem = parts.problem
        linear = linear_prior(problem, prior, parts.total)

        def consistent_values(training: RowProducts) -> Array:
            values, covariance = fit_with_prior(
                training, linear.with_error_factor(UNINFORMATIVE_FACTOR)
            )
            training_estimate = replace(estimate, values=values, covariance=covariance)
            try:
                return consistent_unknowns(
                    consistent(problem.tree, [training_estimate], prior, options),
                    problem,
                )
            except TestbedError:  # too few rows: values of the model file
                return posterior_estimate.file

        fits = {
            REFITTED: lambda training: file_with_fitted_terms(training, linear),
            CONSISTENT: consistent_values,
        }
        pairs = zip(
            held_out_errors(parts, fits), posterior_estimate.errors, strict=True
        )
        return replace(
            posterior_estimate,
            consistent=consistent_unknowns(bodies, problem),
            errors=tuple(
                rival_errors.merged_with(error) for error, rival_errors in pairs
            ),
        )

    return {
        method: with_consistent(posterior_estimate, estimates[method])
        if method in estimates
        else posterior_estimate
        for method, posterior_estimate in posteriors.items()
    }


def consistent_unknowns(bodies: Consistent, problem: Problem) -> Array:
    """Values of a problem's unknowns for given consistent bodies and joint terms, (p,).

    Args:
        bodies: Consistent bodies of the problem's robot.
        problem: Problem of either method.
    """
    count, drives = problem.minimal.count, problem.drives
    unknowns = np.zeros(len(problem.names))
    unknowns[:count] = problem.minimal.standard_matrix @ bodies.standard.ravel()
    if drives is not None:
        values = dict(zip(bodies.terms, bodies.coefficients.tolist(), strict=True))
        unknowns += drives.columns @ np.array([values[term] for term in drives.asked])
    return unknowns
