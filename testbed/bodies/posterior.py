"""What a recording adds to its model file: least squares with the file's bodies as a prior.

Every body's pseudo-inertia is J = U Y U' with that of the file U U'; the coordinates of Y are
those of one with the same standard deviation each: the linear form of the prior of consistent
bodies. How wrong the file is, held-out parts say. The joints' own terms are free, but friction is
not negative. Where the data alone determine all parameters the prior is left out, and the estimate
is that of least squares, which weighs correlated noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np

from testbed.bodies.linear_prior import (
    DETERMINED,
    LinearPrior,
    alone_determined,
    linear_prior,
    refitted,
)
from testbed.bodies.model_average import (
    PRIOR_ERRORS,
    REFERENCE,
    ModelAverage,
    model_average,
)
from testbed.bodies.prediction_errors import (
    CONSISTENT,
    FILE,
    PLAIN,
    POSTERIOR,
    REFITTED,
    PredictionErrors,
    prediction_errors,
    predictions_of,
)
from testbed.bodies.prior import Prior
from testbed.bodies.row_products import RowParts, RowProducts, products_of
from testbed.core.base.arrays import Array, freeze
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.codec import with_properties
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.estimation.estimate import Estimate, EstimateSummary, instrument_of
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import TINY, scaled_solve
from testbed.core.estimation.regression.solvers import noise_weights
from testbed.sensors.corrected import corrected

WELL_CONDITIONED = 100.0
"""Condition number of equations with unit columns that excite all unknowns."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Posterior(EstimateSummary):
    """Estimate by a recording and its model file together; its sigma counts the prior's doubt.

    Attributes:
        instrument: What a person calls it.
        count: How many parameters are of bodies.
        file: By the model file, (p,).
        refitted: The same with the joints' own terms fitted to the data, (p,).
        prior_sigma: Standard deviations before the data, (p,).
        share: Part of the prior's variance that the data remove, (p,).
        alone: Which of them the data alone determine: with nothing else known of any, their
            variance is at most a tenth of the prior's, (p,).
        prior_error: Relative error of the model file's bodies, by held-out parts.
        used: Whether the prior is needed; else the values are those of least squares.
        by_part: Rms of what it leaves of consecutive parts of the recording, (parts, C) [N, N m].
        duration: Of the recording [s].
        errors: What it leaves of held-out parts, and what others do.
        consistent: Of consistent bodies, (p,); None where they were not asked for.
    """

    instrument: str
    count: int
    file: Array
    refitted: Array
    prior_sigma: Array
    share: Array
    alone: tuple[bool, ...]
    prior_error: float
    used: bool
    by_part: Array
    duration: float
    errors: tuple[PredictionErrors, ...]
    consistent: Array | None = None

    __get_pydantic_core_schema__ = with_properties("sigma", "determined")

    def __post_init__(self) -> None:
        super().__post_init__()
        p = len(self.names)
        freeze(
            self,
            file=(p,),
            refitted=(p,),
            prior_sigma=(p,),
            share=(p,),
            by_part=(None, None),
        )

    @property
    def models(self) -> dict[str, Array]:
        """Values of the unknowns by what says them, for predictions."""
        found = {FILE: self.file, REFITTED: self.refitted, POSTERIOR: self.values}
        return (
            found if self.consistent is None else {**found, CONSISTENT: self.consistent}
        )

    @property
    def determined(self) -> tuple[str, ...]:
        """Minimal parameters of bodies that the data alone determine."""
        pairs = zip(self.names[: self.count], self.alone[: self.count], strict=True)
        return tuple(name for name, alone in pairs if alone)

    def worse(self, shown: str) -> tuple[Diagnostic, ...]:
        """Channels of held-out parts that the model file or least squares predict better.

        Args:
            shown: The estimate that counts: "posterior" or "plain".
        """
        pairs = ((shown, PLAIN), (shown, REFITTED), (CONSISTENT, REFITTED))
        return tuple(
            d for name, than in pairs for e in self.errors for d in e.worse(name, than)
        )


@dataclass(frozen=True, eq=False)
class ReportedEstimate:
    """Estimate that a result reports for one method, and its rivals.

    Attributes:
        estimate: With the model file as prior, where that is needed; else by least squares.
        held: Which of the candidates it is: "posterior" or "plain".
        models: Values of its unknowns by candidate; {} where there are no others.
    """

    estimate: EstimateSummary
    held: str
    models: Mapping[str, Array]


def reported_estimate(
    own: EstimateSummary | None, found: Posterior | None, *, plain: bool = False
) -> ReportedEstimate:
    """Choose between least squares and posterior of one method.

    Args:
        own: By least squares; None where the data determine none.
        found: With the model file as prior; None where there is no such.
        plain: Whether least squares count all the same.

    Raises:
        ValueError: There is neither, or they are of other parameters.
    """
    if found is None:
        if own is None:
            raise ValueError("there is no estimate")
        return ReportedEstimate(own, PLAIN, {})
    if own is None:
        return ReportedEstimate(found, POSTERIOR, found.models)
    if own.names != found.names:
        raise ValueError("least squares and the posterior are of other parameters")
    models = {**found.models, PLAIN: own.values}
    if plain or not found.used:
        return ReportedEstimate(own, PLAIN, models)
    known = {
        name: getattr(own, name)
        for name in ("nuisances", "unidentifiable", "settings", "correction")
    }
    return ReportedEstimate(replace(found, **known), POSTERIOR, models)


def posterior(
    rows: RowParts,
    prior: Prior,
    estimate: Estimate | None = None,
    *,
    prior_error: float | None = None,
) -> Posterior:
    """What a recording adds to a model file.

    Args:
        rows: Of the recording; friction that the joints of its robot state is the file's.
        prior: The bodies of the model file (`prior_of`).
        estimate: By least squares, of the same rows; None where the data determine none.
        prior_error: Relative error of the file's bodies; None for what held-out parts say.
    """
    problem, method, whole = rows.problem, rows.problem.method, rows.whole
    with one_blas_thread():
        before = linear_prior(problem, prior, whole)
        reference = before.times(REFERENCE)
        errors = PRIOR_ERRORS if prior_error is None else (prior_error,)
        fit = model_average(rows, before, errors)
        if well_conditioned(estimate):
            fit = fit.conditioned_on(estimate.values, _without_model_errors(estimate))
        alone = tuple(alone_determined(whole, reference).tolist())
        answer: ModelAverage | Estimate = fit
        if determines(estimate, reference) and whole.enough.all():
            answer, alone = estimate, (True,) * len(alone)
        file = file_values(problem, prior)
        fits: dict[str, Callable[[RowProducts], Array]] = {
            REFITTED: lambda rows: refitted(rows, before),
            POSTERIOR: fit.values_of if answer is fit else _plain,
        }
        if estimate is not None:
            fits[PLAIN] = _plain
        before = before.times(prior_error or max(fit.prior_error, REFERENCE))
        covariance = np.array(answer.covariance)
        if answer is fit:
            covariance = covariance + _of_model_errors(estimate, before, covariance)
        constants = whole.constants(answer.values)
        variance = np.maximum(before.variance, TINY)
        return Posterior(
            method=method,
            instrument=instrument_of(problem.minimal, method),
            names=problem.names,
            units=problem.units,
            count=problem.minimal.count,
            file=file,
            refitted=refitted(whole, before),
            prior_sigma=np.sqrt(before.variance),
            values=answer.values,
            covariance=covariance,
            share=np.clip(1 - np.diagonal(covariance) / variance, 0.0, 1.0),
            alone=alone,
            prior_error=fit.prior_error,
            used=answer is fit,
            residual=whole.residual(answer.values),
            by_part=np.array(
                [part.residual(answer.values, constants) for part in rows.each]
            ),
            duration=problem.source.samples / problem.source.rate,
            gravity=problem.tree.gravity,
            settings=problem.settings,
            errors=held_out_errors(rows, fits, file),
        )


def _of_model_errors(
    estimate: Estimate | None, prior: LinearPrior, covariance: Array
) -> Array | float:
    """Covariance that model errors add beside a prior, (p, p).

    Args:
        estimate: By least squares; None where the data determine none.
        prior: Of the unknowns.
        covariance: Of the unknowns otherwise, (p, p).
    """
    if estimate is None or estimate.model_error_effect is None:
        return 0.0
    root = estimate.model_error_effect.root(covariance, prior.root @ prior.root.T)
    return np.asarray(root @ root.T)


def _without_model_errors(estimate: Estimate) -> Array:
    """Covariance of an estimate without what model errors add, (p, p)."""
    covariance = np.array(estimate.covariance)
    if estimate.model_error_effect is None:
        return covariance
    root = estimate.model_error_effect.root(covariance)
    return covariance - root @ root.T


def rows_of(problem: Problem, estimate: Estimate | None) -> RowParts:
    """Rows of a problem, faults of the instrument that an estimate found taken back.

    Args:
        problem: With the terms and the filter of the estimate.
        estimate: By least squares; None where the data determine none.
    """
    source, free = problem.source, True
    if estimate is not None:
        source = corrected(source, problem.tree, estimate.sensor_errors)
        free = "bias" in problem.settings.nuisances or bool(estimate.unidentifiable)
    return products_of(problem, source, free and problem.method == "external")


def file_values(problem: Problem, prior: Prior) -> Array:
    """Values of the unknowns as the model file states them, (p,).

    Args:
        problem: Says which unknowns.
        prior: The file's bodies.
    """
    minimal, drives = problem.minimal, problem.drives
    none = np.zeros((problem.tree.n, 10))
    values = (
        np.zeros(len(problem.names))
        if drives is None
        else drives.values(none, problem.tree)
    )
    values[: minimal.count] += minimal.standard_matrix @ prior.standard.ravel()
    return values


def well_conditioned(estimate: Estimate | None) -> TypeGuard[Estimate]:
    """Whether data excite all unknowns, so that least squares know the noise's correlation.

    Args:
        estimate: By least squares; None where the data determine none.
    """
    if estimate is None:
        return False
    return estimate.condition < WELL_CONDITIONED and bool((estimate.sigma > 0).all())


def determines(estimate: Estimate | None, prior: LinearPrior) -> TypeGuard[Estimate]:
    """Whether the data alone determine every parameter: then no prior is needed.

    Args:
        estimate: By least squares; None where the data determine none.
        prior: Of its unknowns.
    """
    if estimate is None:
        return False
    most = (1 / DETERMINED - 1) * prior.variance
    return bool((estimate.sigma**2 < most).all())


def held_out_errors(
    parts: RowParts,
    fits: Mapping[str, Callable[[RowProducts], Array]],
    file: Array | None = None,
) -> tuple[PredictionErrors, ...]:
    """What fits of some parts leave of others, split by split.

    Args:
        parts: Of the rows.
        fits: By name, what finds values of the unknowns by rows.
        file: The model file's values, (p,), to be beside them.
    """
    found = []
    for kind, split in parts.splits.items():
        pairs = []
        for seen, rest in split:
            models = {name: fit(seen) for name, fit in fits.items()}
            if file is not None:
                models[FILE] = file
            pairs.append((predictions_of(seen, models), rest))
        found.append(prediction_errors(parts.problem, kind, pairs))
    return tuple(found)


def _plain(rows: RowProducts) -> Array:
    """Least squares, (p,)."""
    p = len(rows.unknowns)
    equations = rows.equations(np.eye(p), np.zeros(p))
    weights = noise_weights(equations)
    return scaled_solve(equations.matrix(weights), equations.vector(weights))
