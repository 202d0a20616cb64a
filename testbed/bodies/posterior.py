"""Posterior of the parameters: least squares with the model file's bodies as a Gaussian prior.

The pseudo-inertia of every body is J = U Y U', where U U' is the pseudo-inertia in the file. All
coordinates of Y have the same standard deviation, as in the linearised prior of consistent bodies.
The relative error of the file is estimated from held-out parts of the recording. The joint terms
are nearly free, but friction is not negative. If the data alone determine all parameters, the prior
is left out, and the result is the generalised least-squares estimate, which accounts for correlated
noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np

from testbed.bodies.linear_prior import (
    MIN_DETERMINED_SHARE,
    LinearPrior,
    determined_by_data,
    file_with_fitted_terms,
    linear_prior,
)
from testbed.bodies.model_average import (
    PRIOR_ERRORS,
    REFERENCE_PRIOR_ERROR,
    ModelAverage,
    model_average,
)
from testbed.bodies.prediction_errors import (
    CONSISTENT,
    FILE,
    LEAST_SQUARES,
    POSTERIOR,
    REFITTED,
    PredictionErrors,
    fitted_predictions,
    prediction_errors,
)
from testbed.bodies.prior import PriorBodies
from testbed.bodies.row_products import RowParts, RowProducts, row_parts
from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.codec import schema_with_properties
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.estimation.estimate import Estimate, EstimateSummary, instrument_label
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    solve_scaled,
)
from testbed.core.estimation.regression.solvers import noise_weights
from testbed.sensors.corrected import corrected

WELL_CONDITIONED = 100.0
"""Condition number of equations with unit columns that excite all unknowns."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Posterior(EstimateSummary):
    """Estimate from a recording and a model file; `sigma` includes the uncertainty of the prior.

    Attributes:
        instrument: Name of the instrument in reports.
        count: Number of minimal parameters of the bodies, which come before the joint terms.
        file: Values of the model file, (p,).
        refitted: Values of the model file with the joint terms fitted to the data, (p,).
        prior_sigma: Prior standard deviations, (p,).
        share: Fraction of the prior variance that the data remove, (p,).
        alone: True for parameters that the data determine without the prior, to a variance of at
            most a tenth of the prior variance, (p,).
        prior_error: Relative error of the model file's bodies, as stated or as estimated from
            held-out parts.
        used: True if the prior is needed; else the values are those of least squares.
        by_part: Rms residual of each of the C channels in consecutive parts of the recording,
            (parts, C) [N, N m].
        duration: Duration of the recording [s].
        errors: Prediction errors of the posterior and its rivals on held-out parts.
        consistent: Values from physically consistent bodies, (p,); None if these were not
            requested.
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

    __get_pydantic_core_schema__ = schema_with_properties("sigma", "determined")

    def __post_init__(self) -> None:
        super().__post_init__()
        p = len(self.names)
        freeze_arrays(
            self,
            file=(p,),
            refitted=(p,),
            prior_sigma=(p,),
            share=(p,),
            by_part=(None, None),
        )

    @property
    def models(self) -> dict[str, Array]:
        """Values of the unknowns, (p,), keyed by name of the prediction.

        The names are "file", "refitted" and "posterior", and "consistent" if consistent bodies were
        requested.
        """
        models = {FILE: self.file, REFITTED: self.refitted, POSTERIOR: self.values}
        return (
            models
            if self.consistent is None
            else {**models, CONSISTENT: self.consistent}
        )

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of the bodies' minimal parameters that the data determine without the prior."""
        pairs = zip(self.names[: self.count], self.alone[: self.count], strict=True)
        return tuple(name for name, is_determined in pairs if is_determined)

    def worse_channels(self, reported: str) -> tuple[Diagnostic, ...]:
        """Diagnostics of held-out channels that the model file or least squares predict better.

        The reported estimate is compared with least squares. Both the reported estimate and the
        consistent bodies are compared with the model file with fitted joint terms. The thresholds
        are those of `PredictionErrors.worse_channels`.

        Args:
            reported: Name of the reported estimate: "posterior" or "plain".
        """
        pairs = (
            (reported, LEAST_SQUARES),
            (reported, REFITTED),
            (CONSISTENT, REFITTED),
        )
        return tuple(
            d
            for name, than in pairs
            for e in self.errors
            for d in e.worse_channels(name, than)
        )


@dataclass(frozen=True, eq=False)
class ReportedEstimate:
    """Reported estimate of one method, and the values of all candidates.

    Attributes:
        estimate: Estimate with the model file as prior if the prior is needed; otherwise the
            least-squares estimate.
        held: Name of the reported candidate: "posterior" or "plain".
        models: Values of the unknowns, (p,), keyed by candidate; {} if there is no posterior.
    """

    estimate: EstimateSummary
    held: str
    models: Mapping[str, Array]


def reported_estimate(
    least_squares: EstimateSummary | None,
    posterior_estimate: Posterior | None,
    *,
    plain: bool = False,
) -> ReportedEstimate:
    """Choose between the least-squares estimate and the posterior of one method.

    The posterior is reported if the data do not determine all parameters (`Posterior.used`) or if
    there is no least-squares estimate. Otherwise the least-squares estimate is reported. Sensor
    errors and settings are those of the least-squares estimate if it exists.

    Args:
        least_squares: Least-squares estimate; None if the data do not determine one.
        posterior_estimate: Posterior with the model file as prior; None if there is no prior.
        plain: True to report the least-squares estimate in any case.

    Raises:
        ValueError: Both are None, or their parameters differ.
    """
    if posterior_estimate is None:
        if least_squares is None:
            raise ValueError("there is no estimate")
        return ReportedEstimate(least_squares, LEAST_SQUARES, {})
    if least_squares is None:
        return ReportedEstimate(
            posterior_estimate, POSTERIOR, posterior_estimate.models
        )
    if least_squares.names != posterior_estimate.names:
        raise ValueError("least squares and the posterior are of other parameters")
    models = {**posterior_estimate.models, LEAST_SQUARES: least_squares.values}
    if plain or not posterior_estimate.used:
        return ReportedEstimate(least_squares, LEAST_SQUARES, models)
    common = {
        name: getattr(least_squares, name)
        for name in ("nuisances", "unidentifiable", "settings", "correction")
    }
    return ReportedEstimate(replace(posterior_estimate, **common), POSTERIOR, models)


def compute_posterior(
    rows: RowParts,
    prior: PriorBodies,
    estimate: Estimate | None = None,
    *,
    prior_error: float | None = None,
) -> Posterior:
    """Compute the posterior from a recording's rows, with the model file's bodies as prior.

    The values are a model average over the relative errors `PRIOR_ERRORS`, or the fit with the
    stated error. If the least-squares estimate is well conditioned, the fits are conditioned on
    this estimate instead of on the rows. If every channel has enough rows and the data determine
    all parameters (`determines_all`), the values are those of the least-squares estimate and `used`
    is False.

    Args:
        rows: Gram matrices of the recording's rows; the joint friction of the problem's robot is
            that of the file.
        prior: Bodies of the model file (`prior_of`).
        estimate: Least-squares estimate from the same rows; None if the data do not determine one.
        prior_error: Relative error of the file's bodies; None to estimate it from held-out parts.
    """
    problem, method, all_rows = rows.problem, rows.problem.method, rows.total
    with one_blas_thread():
        linear = linear_prior(problem, prior, all_rows)
        reference = linear.with_error_factor(REFERENCE_PRIOR_ERROR)
        errors = PRIOR_ERRORS if prior_error is None else (prior_error,)
        fit = model_average(rows, linear, errors)
        if is_well_conditioned(estimate):
            fit = fit.conditioned_on(estimate.values, _without_model_errors(estimate))
        is_determined = tuple(determined_by_data(all_rows, reference).tolist())
        result: ModelAverage | Estimate = fit
        if determines_all(estimate, reference) and all_rows.has_enough_rows.all():
            result, is_determined = estimate, (True,) * len(is_determined)
        file = file_values(problem, prior)
        fits: dict[str, Callable[[RowProducts], Array]] = {
            REFITTED: lambda rows: file_with_fitted_terms(rows, linear),
            POSTERIOR: fit.values_fitted_to if result is fit else _least_squares_values,
        }
        if estimate is not None:
            fits[LEAST_SQUARES] = _least_squares_values
        linear = linear.with_error_factor(
            prior_error or max(fit.prior_error, REFERENCE_PRIOR_ERROR)
        )
        covariance = np.array(result.covariance)
        if result is fit:
            covariance = covariance + _model_error_covariance(
                estimate, linear, covariance
            )
        constants = all_rows.mean_residuals(result.values)
        variance = np.maximum(linear.variance, SMALLEST_POSITIVE)
        return Posterior(
            method=method,
            instrument=instrument_label(problem.minimal, method),
            names=problem.names,
            units=problem.units,
            count=problem.minimal.count,
            file=file,
            refitted=file_with_fitted_terms(all_rows, linear),
            prior_sigma=np.sqrt(linear.variance),
            values=result.values,
            covariance=covariance,
            share=np.clip(1 - np.diagonal(covariance) / variance, 0.0, 1.0),
            alone=is_determined,
            prior_error=fit.prior_error,
            used=result is fit,
            residual=all_rows.rms_residual(result.values),
            by_part=np.array(
                [part.rms_residual(result.values, constants) for part in rows.parts]
            ),
            duration=problem.source.samples / problem.source.rate,
            gravity=problem.tree.gravity,
            settings=problem.settings,
            errors=held_out_errors(rows, fits, file),
        )


def _model_error_covariance(
    estimate: Estimate | None, prior: LinearPrior, covariance: Array
) -> Array | float:
    """Covariance that model errors add under a prior, (p, p); 0 without model errors.

    Args:
        estimate: Least-squares estimate; None if the data do not determine one.
        prior: Prior of the unknowns.
        covariance: Covariance of the unknowns without model errors, (p, p).
    """
    if estimate is None or estimate.model_error_effect is None:
        return 0.0
    root = estimate.model_error_effect.root(covariance, prior.root @ prior.root.T)
    return np.asarray(root @ root.T)


def _without_model_errors(estimate: Estimate) -> Array:
    """Covariance of an estimate without the contribution of model errors, (p, p)."""
    covariance = np.array(estimate.covariance)
    if estimate.model_error_effect is None:
        return covariance
    root = estimate.model_error_effect.root(covariance)
    return covariance - root @ root.T


def corrected_row_parts(problem: Problem, estimate: Estimate | None) -> RowParts:
    """Gram matrices of a problem's rows, with the estimated instrument faults corrected.

    Wrench channels have an unknown constant if the estimate includes the plate's bias, has
    unidentifiable parameters or is None. Channels of joint torques have no unknown constant.

    Args:
        problem: Problem with the terms and the filter of the estimate.
        estimate: Least-squares estimate; None if the data do not determine one.
    """
    source, free = problem.source, True
    if estimate is not None:
        source = corrected(source, problem.tree, estimate.sensor_errors)
        free = "bias" in problem.settings.nuisances or bool(estimate.unidentifiable)
    return row_parts(problem, source, free and problem.method == "wrench")


def file_values(problem: Problem, prior: PriorBodies) -> Array:
    """Values of the unknowns in the model file: minimal parameters, then joint terms, (p,).

    Args:
        problem: Problem with the unknowns; friction of its joints is that of the file.
        prior: Bodies of the model file.
    """
    minimal, drives = problem.minimal, problem.drives
    no_bodies = np.zeros((problem.tree.n, 10))
    values = (
        np.zeros(len(problem.names))
        if drives is None
        else drives.values(no_bodies, problem.tree)
    )
    values[: minimal.count] += minimal.standard_matrix @ prior.standard.ravel()
    return values


def is_well_conditioned(estimate: Estimate | None) -> TypeGuard[Estimate]:
    """Test whether an estimate is well conditioned and all its variances are positive.

    An estimate is well conditioned if the condition number of its equations, with columns of unit
    length, is below `WELL_CONDITIONED` (100). The noise model derived from its residuals is then
    reliable. The result is False if there is no estimate.

    Args:
        estimate: Least-squares estimate; None if the data do not determine one.
    """
    if estimate is None:
        return False
    return estimate.condition < WELL_CONDITIONED and bool((estimate.sigma > 0).all())


def determines_all(
    estimate: Estimate | None, prior: LinearPrior
) -> TypeGuard[Estimate]:
    """Test whether the data determine every parameter, so that no prior is needed.

    No prior is needed if each least-squares variance is below a ninth of the prior variance: the
    data then remove over `MIN_DETERMINED_SHARE` (90 %) of the prior variance. The result is False
    if there is no estimate.

    Args:
        estimate: Least-squares estimate; None if the data do not determine one.
        prior: Prior of the unknowns.
    """
    if estimate is None:
        return False
    most = (1 / MIN_DETERMINED_SHARE - 1) * prior.variance
    return bool((estimate.sigma**2 < most).all())


def held_out_errors(
    parts: RowParts,
    fits: Mapping[str, Callable[[RowProducts], Array]],
    file: Array | None = None,
) -> tuple[PredictionErrors, ...]:
    """Prediction errors of several fits on held-out parts, for each kind of split.

    The splits are those of `RowParts.splits`: "like" always, and "faster" if the speeds differ
    enough.

    Args:
        parts: Gram matrices of the rows of each part.
        fits: Functions from rows to values of the unknowns, (p,), keyed by name of the prediction.
        file: Values of the model file, (p,), as a further prediction; None to omit it.
    """
    errors = []
    for kind, split in parts.splits.items():
        pairs = []
        for training, held_out in split:
            models = {name: fit(training) for name, fit in fits.items()}
            if file is not None:
                models[FILE] = file
            pairs.append((fitted_predictions(training, models), held_out))
        errors.append(prediction_errors(parts.problem, kind, pairs))
    return tuple(errors)


def _least_squares_values(rows: RowProducts) -> Array:
    """Least-squares solution without a prior, weighted by inverse noise variances, (p,)."""
    p = len(rows.unknowns)
    equations = rows.equations(np.eye(p), np.zeros(p))
    weights = noise_weights(equations)
    return solve_scaled(equations.matrix(weights), equations.vector(weights))
