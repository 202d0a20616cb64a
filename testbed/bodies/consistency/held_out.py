"""What consistent bodies leave of data that they have not seen, beside what others leave."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from testbed.bodies.consistency.consistent import Consistent, consistent
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.linear_prior import (
    WIDE,
    linear_prior,
    refitted,
    with_prior,
)
from testbed.bodies.posterior import Posterior, held_out_errors, parts_of
from testbed.bodies.prior import Prior
from testbed.core.base.arrays import Array
from testbed.core.base.errors import TestbedError
from testbed.core.estimation.estimate import Estimate, Method
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.selection.prediction_errors import CONSISTENT, REFITTED
from testbed.core.estimation.selection.row_products import RowProducts
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.recordings.source import RecordingLike
from testbed.core.robot.tree import Tree


def with_likely_error(
    options: ConsistencyOptions, posteriors: Iterable[Posterior]
) -> ConsistencyOptions:
    """Conditions with the least error of the model file that its posteriors have.

    Args:
        options: What is asked.
        posteriors: Of one recording.
    """
    used = [each.prior_error for each in posteriors if each.used]
    return replace(options, prior_error=min(used, default=options.prior_error))


def beside_consistent(
    posteriors: Mapping[Method, Posterior],
    bodies: Consistent,
    tree: Tree,
    recording: RecordingLike,
    prior: Prior,
    estimates: Sequence[Estimate],
    options: ConsistencyOptions,
    settings: Settings = DEFAULTS,
) -> dict[Method, Posterior]:
    """Posteriors with consistent bodies beside them: of the recording, and of held-out parts.

    Bodies of the parts are those of the one method.

    Args:
        posteriors: By method.
        bodies: Of the whole recording.
        tree: The robot.
        recording: As for `posterior`.
        prior: The bodies of the model file.
        estimates: By least squares; a method without one stays as it is.
        options: What was asked of the bodies.
        settings: As for `identify`.
    """

    def beside(found: Posterior, estimate: Estimate) -> Posterior:
        method, gravity = estimate.method, estimate.gravity
        problem, parts = parts_of(tree, recording, method, [estimate], gravity, settings, None)
        before = linear_prior(problem, prior, found.prior_error, parts.whole)

        def of_rows(rows: RowProducts) -> Array:
            values, covariance = with_prior(rows, before.times(WIDE))
            sigma = np.sqrt(np.diagonal(covariance))
            own = replace(estimate, values=values, sigma=sigma, covariance=covariance)
            try:
                return unknowns_of(consistent(tree, [own], prior, options), problem)
            except TestbedError:  # too few rows: those of the file
                return found.file

        fits = {REFITTED: lambda rows: refitted(rows, before), CONSISTENT: of_rows}
        errors = held_out_errors(problem, parts, fits)
        pairs = zip(errors, found.errors, strict=True)
        return replace(
            found,
            consistent=unknowns_of(bodies, problem),
            errors=tuple(known.beside(own) for own, known in pairs),
        )

    made = {each.method: each for each in estimates}
    return {
        method: beside(found, made[method]) if method in made else found
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
