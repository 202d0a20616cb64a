"""What consistent bodies leave of data that they have not seen, beside what others leave."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from testbed.bodies.consistency.consistent import Consistent, consistent
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.linear_prior import WIDE, linear_prior, refitted, with_prior
from testbed.bodies.posterior import Posterior, held_out_errors
from testbed.bodies.prediction_errors import CONSISTENT, REFITTED
from testbed.bodies.prior import Prior
from testbed.bodies.row_products import RowParts, RowProducts
from testbed.core.base.arrays import Array
from testbed.core.base.errors import TestbedError
from testbed.core.estimation.estimate import Estimate, Method
from testbed.core.estimation.problem import Problem


def with_likely_error(
    options: ConsistencyOptions, posteriors: Iterable[Posterior]
) -> ConsistencyOptions:
    """Conditions with the least error of the model file that its posteriors have.

    Args:
        options: What is asked.
        posteriors: Of one recording.
    """
    errors = [each.prior_error for each in posteriors if each.used]
    return replace(options, prior_error=min(errors, default=options.prior_error))


def beside_consistent(
    posteriors: Mapping[Method, Posterior],
    bodies: Consistent,
    rows: Mapping[Method, RowParts],
    prior: Prior,
    estimates: Mapping[Method, Estimate],
    options: ConsistencyOptions,
) -> dict[Method, Posterior]:
    """Posteriors with consistent bodies beside them: of the recording, and of held-out parts.

    Bodies of the parts are those of the one method.

    Args:
        posteriors: By method.
        bodies: Of the whole recording.
        rows: Of the recording, by method.
        prior: The bodies of the model file.
        estimates: By least squares; a method without one stays as it is.
        options: What was asked of the bodies.
    """

    def beside(found: Posterior, estimate: Estimate) -> Posterior:
        parts = rows[found.method]
        problem = parts.problem
        before = linear_prior(problem, prior, parts.whole)

        def of_rows(some: RowProducts) -> Array:
            values, covariance = with_prior(some, before.times(WIDE))
            own = replace(estimate, values=values, covariance=covariance)
            try:
                return unknowns_of(
                    consistent(problem.tree, [own], prior, options), problem
                )
            except TestbedError:  # too few rows: those of the file
                return found.file

        fits = {REFITTED: lambda some: refitted(some, before), CONSISTENT: of_rows}
        pairs = zip(held_out_errors(parts, fits), found.errors, strict=True)
        return replace(
            found,
            consistent=unknowns_of(bodies, problem),
            errors=tuple(known.beside(own) for own, known in pairs),
        )

    return {
        method: beside(found, estimates[method]) if method in estimates else found
        for method, found in posteriors.items()
    }


def unknowns_of(bodies: Consistent, problem: Problem) -> Array:
    """Consistent bodies and their joints' terms as unknowns of a problem, (p,).

    Args:
        bodies: Of its robot.
        problem: By either method.
    """
    count, drives = problem.minimal.count, problem.drives
    found = np.zeros(len(problem.names))
    found[:count] = problem.minimal.standard_matrix @ bodies.standard.ravel()
    if drives is not None:
        values = dict(zip(bodies.terms, bodies.coefficients.tolist(), strict=True))
        found += drives.columns @ np.array([values[term] for term in drives.asked])
    return found
