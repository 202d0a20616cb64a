"""Model average: fits with priors of several relative errors, weighted by held-out losses.

A short recording does not determine the relative error of a model file, and any fixed value is
wrong for some files. Therefore fits that held-out parts cannot distinguish are averaged. The
average is again an estimate, because torques and wrenches are linear in the unknowns.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from testbed.bodies.linear_prior import (
    ROWS_PER_INDEPENDENT_ROW,
    LinearPrior,
    PriorFit,
    bounded_posterior,
    fit_with_estimated_noise,
    fit_with_noise,
)
from testbed.bodies.row_products import RowParts, RowProducts
from testbed.core.base.arrays import Array
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    NormalEquations,
    scaled_inverse,
)

PRIOR_ERRORS = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Relative errors of the bodies: from an exact model file to an uninformative one."""

DEFAULT_PRIOR_ERROR = 0.3
"""Relative error of the bodies where there are too few parts for weights."""

REFERENCE_PRIOR_ERROR = 0.5
"""Relative error of a model file of unknown quality; parameters count as determined if the data
reduce their variance to a tenth of that under this error."""

BLOCK_LENGTHS = (1, 2, 4)
"""Numbers of consecutive parts that are held out together; longer blocks test extrapolation."""

MIN_PARTS = 3
"""Smallest number of parts for weights by losses."""

MIN_LOSS_ERROR, MAX_LOSS_ERROR = 0.01, 0.2
"""Bounds of the standard error of a difference of logarithmic losses."""

PRIOR_ERROR_EXPONENT = 0.15
"""Exponent by which a weight falls with the prior's error, in favour of the file."""


@dataclass(frozen=True, eq=False)
class ModelAverage:
    """Weighted mean and covariance of fits whose priors have different relative errors.

    Attributes:
        prior: Prior with a relative error of one.
        errors: Relative error of the bodies in each of the k fits, (k,).
        weights: Weights of the fits, (k,).
        noise: Noise variance of each of the C channels in each fit, (k, C) [N^2, N^2 m^2].
        values: Values of the unknowns, (p,).
        covariance: Covariance of the mixture of the fits, (p, p), which includes the differences
            between the fits.
        prior_error: Relative error of the file's bodies: rms deviation from the file of the
            coordinates that the data determine, or the only error in `errors`.
        by_rows: Values of the fits, (k, p), keyed by training rows of the held-out parts.
    """

    prior: LinearPrior
    errors: Array
    weights: Array
    noise: Array
    values: Array
    covariance: Array
    prior_error: float
    by_rows: Mapping[RowProducts, Array] = field(default_factory=dict)

    def values_fitted_to(self, rows: RowProducts) -> Array:
        """Values of the unknowns fitted to other rows, with the same weights and noise, (p,).

        Fits that are stored in `by_rows` are not repeated.

        Args:
            rows: Gram matrices of the rows.
        """
        if rows not in self.by_rows:
            return self.weights @ _values_by_fit(
                rows, self.prior, self.errors, self.noise
            )
        return self.weights @ self.by_rows[rows]

    def conditioned_on(self, values: Array, covariance: Array) -> ModelAverage:
        """Model average conditioned on a generalised least-squares estimate instead of the rows.

        The covariance of the estimate accounts for correlated noise; the weights of the fits are
        unchanged.

        Args:
            values: Generalised least-squares estimate of the same unknowns, (p,).
            covariance: Covariance of this estimate, (p, p).
        """
        information = scaled_inverse(covariance)
        deviation = values - self.prior.mean

        def fit(error: float) -> tuple[Array, Array]:
            root = self.prior.with_error_factor(error).root
            normal, right = (
                root.T @ information @ root,
                root.T @ information @ deviation,
            )
            z, covariance = bounded_posterior(normal, right, self.prior.lower_bounds)
            return self.prior.mean + root @ z, root @ covariance @ root.T

        values = np.array([fit(error)[0] for error in self.errors.tolist()])
        spreads = np.array(
            [fit(error)[1] for error in _errors_without_data(self.errors).tolist()]
        )
        mean, covariance = _mixture(self.weights, values, spreads)
        return replace(self, values=mean, covariance=covariance)


def model_average(
    parts: RowParts, prior: LinearPrior, errors: Sequence[float]
) -> ModelAverage:
    """Average fits with different prior errors, weighted by losses on held-out parts.

    The loss of a part is the logarithm of the ratio of its mean squared prediction error to the
    noise variance of the fit with the weakest prior (last error). The weight of a fit falls with
    the difference between its loss and the smallest loss, in standard errors over the parts. The
    covariance is computed with relative errors of at least `REFERENCE_PRIOR_ERROR`, and with noise
    variances that are increased according to the scatter over the parts.

    Args:
        parts: Gram matrices of the recording's rows, part by part.
        prior: Prior with a relative error of one.
        errors: Relative errors of the bodies, ascending; a single error gives a single fit.
    """
    whole, error_array = parts.total, np.array(errors)
    equations = whole.equations(prior.root, prior.mean)
    fits = [
        fit_with_estimated_noise(
            _scaled_equations(equations, prior, e), prior, whole.has_enough_rows
        )
        for e in errors
    ]
    noise = np.array([fit.noise for fit in fits])
    by_rows, weights = dict[RowProducts, Array](), np.ones(1)
    if len(error_array) > 1:
        by_rows = {
            training: _values_by_fit(training, prior, error_array, noise)
            for training, _ in parts.folds
        }
        weights = _fit_weights(
            _held_out_losses(parts, prior, error_array, noise, by_rows), error_array
        )
    best = int(weights.argmax())
    inflated_noise = noise * _noise_inflation(
        parts, equations, prior, fits[best], errors[best]
    )
    file_error = errors[0]
    if len(error_array) > 1:
        inflated_fits = _fits_under_noise(equations, prior, error_array, inflated_noise)
        file_error = _file_error(inflated_fits, error_array, weights, prior)
    errors_without_data = _errors_without_data(error_array)
    roots = [
        prior.with_error_factor(each).root for each in errors_without_data.tolist()
    ]
    inflated_fits = _fits_under_noise(
        equations, prior, errors_without_data, inflated_noise
    )
    spreads = [
        root @ fit.covariance @ root.T
        for root, fit in zip(roots, inflated_fits, strict=True)
    ]
    pairs = zip(errors, fits, strict=True)
    values = [prior.mean + prior.with_error_factor(e).root @ fit.z for e, fit in pairs]
    mean, covariance = _mixture(weights, np.array(values), np.array(spreads))
    return ModelAverage(
        prior, error_array, weights, noise, mean, covariance, file_error, by_rows
    )


def _errors_without_data(errors: Array) -> Array:
    """Relative errors for parameters that the data do not determine, (k,).

    They are at least `REFERENCE_PRIOR_ERROR` (0.5). A single error was requested and stays
    unchanged.

    Args:
        errors: Relative errors of the bodies in the k fits, (k,).
    """
    return errors if len(errors) == 1 else np.maximum(errors, REFERENCE_PRIOR_ERROR)


def _mixture(weights: Array, values: Array, covariances: Array) -> tuple[Array, Array]:
    """Mean, (p,), and covariance, (p, p), of a mixture of k Gaussian distributions.

    Args:
        weights: Weights, (k,), with a sum of one.
        values: Means, (k, p).
        covariances: Covariances, (k, p, p).
    """
    mean = weights @ values
    deviations = values - mean
    within = np.einsum("k,kij->ij", weights, covariances)
    return mean, within + (weights * deviations.T) @ deviations


def _fits_under_noise(
    equations: NormalEquations, prior: LinearPrior, errors: Array, noise: Array
) -> list[PriorFit]:
    """Fits for given relative errors of the bodies and given noise variances.

    Args:
        equations: Normal equations in the coordinates z of the prior.
        prior: Prior with a relative error of one.
        errors: Relative errors of the bodies, (k,).
        noise: Noise variance of each of the C channels in each fit, (k, C).
    """
    return [
        fit_with_noise(
            _scaled_equations(equations, prior, error), variances, prior.lower_bounds
        )
        for error, variances in zip(errors.tolist(), noise, strict=True)
    ]


def _noise_inflation(
    parts: RowParts,
    equations: NormalEquations,
    prior: LinearPrior,
    fit: PriorFit,
    error: float,
) -> Array:
    """Ratio of the scatter of scores over parts to the scatter for white noise, (C,).

    A score is the derivative of half the sum of squared residuals of a part with respect to z. The
    ratio of each channel is at least one; correlated noise and model errors increase it.

    Source    [LZ86]

    Args:
        parts: Gram matrices of the recording's rows, part by part.
        equations: Normal equations of all rows in the coordinates z of the prior.
        prior: Prior with a relative error of one.
        fit: Fit with the relative error `error`.
        error: Relative error of the bodies in the fit.
    """
    root, whole = prior.with_error_factor(error).root, parts.total
    values = prior.mean + root @ fit.z
    constants = whole.mean_residuals(values)[:, None]
    ones = np.ones_like(constants)
    residual = np.hstack([-values * ones, -constants, ones])
    means = whole.products[:, -2, :-2] / np.maximum(whole.rows, 1.0)[:, None]
    scores = []
    for part in parts.parts:
        sums = np.einsum("cij,cj->ci", part.products[:, :-1], residual)
        part_scores = sums[:, :-1] - parts.offset * means * sums[:, -1:]
        scores.append(part_scores @ root)
    scatter = np.einsum("kci,ij,kcj->c", scores, fit.covariance, scores)
    normal = _scaled_equations(equations, prior, error).normal
    white_scatter = ROWS_PER_INDEPENDENT_ROW * np.einsum(
        "cij,ji->c", normal, fit.covariance
    )
    ratio = (
        np.where(
            white_scatter > SMALLEST_POSITIVE,
            scatter / np.maximum(white_scatter, SMALLEST_POSITIVE),
            0.0,
        )
        / fit.noise
    )
    return np.asarray(np.maximum(ratio, 1.0))


def _file_error(
    fits: Sequence[PriorFit], errors: Array, weights: Array, prior: LinearPrior
) -> float:
    """Rms deviation of the bodies from the file, in coordinates that the data determine.

    Each coordinate contributes the fraction of its prior variance that the data remove to the
    number of coordinates. `REFERENCE_PRIOR_ERROR` is the deviation of one additional coordinate.

    Source    [Mac92]

    Args:
        fits: Fits, one for each relative error of the bodies.
        errors: Relative errors of the bodies, (k,).
        weights: Weights of the fits, (k,).
        prior: Prior with a relative error of one.
    """
    z = np.array([fit.z[: prior.body_coordinate_count] for fit in fits])
    posterior_variance = np.array(
        [np.diagonal(fit.covariance)[: prior.body_coordinate_count] for fit in fits]
    )
    squares = weights @ (errors[:, None] * z) ** 2
    determined = weights @ (1 - posterior_variance)
    return float(
        np.sqrt((REFERENCE_PRIOR_ERROR**2 + squares.sum()) / (1 + determined.sum()))
    )


def _scaled_equations(
    equations: NormalEquations, prior: LinearPrior, error: float
) -> NormalEquations:
    """Normal equations in the coordinates z for another relative error of the bodies."""
    scale = prior.coordinate_sigmas(error)
    normal = equations.normal * np.outer(scale, scale)
    return replace(equations, normal=normal, right=equations.right * scale)


def _values_by_fit(
    rows: RowProducts, prior: LinearPrior, errors: Array, noise: Array
) -> Array:
    """Values of the unknowns in k fits to given rows with given noise, (k, p).

    Args:
        rows: Gram matrices of the rows.
        prior: Prior with a relative error of one.
        errors: Relative errors of the bodies, (k,).
        noise: Noise variance of each of the C channels in each fit, (k, C).
    """
    equations, values = rows.equations(prior.root, prior.mean), []
    for error, variances in zip(errors.tolist(), noise, strict=True):
        z = fit_with_noise(
            _scaled_equations(equations, prior, error), variances, prior.lower_bounds
        ).z
        values.append(prior.mean + prior.with_error_factor(error).root @ z)
    return np.array(values)


def _held_out_losses(
    parts: RowParts,
    prior: LinearPrior,
    errors: Array,
    noise: Array,
    by_rows: Mapping[RowProducts, Array],
) -> Array:
    """Losses of k fits on held-out parts, (parts, k), averaged over block lengths.

    Blocks of 1, 2 and 4 consecutive parts are held out together. Parts without rows are left out.

    Args:
        parts: Gram matrices of the recording's rows, part by part.
        prior: Prior with a relative error of one.
        errors: Relative errors of the bodies, (k,).
        noise: Noise variance of each of the C channels in each fit, (k, C).
        by_rows: Values of the fits, (k, p), keyed by training rows, if they are already computed.
    """
    losses = defaultdict[int, list[Array]](list)
    for block_length in BLOCK_LENGTHS:
        for training, block in parts.blocks(block_length):
            values = by_rows.get(training)
            if values is None:
                values = _values_by_fit(training, prior, errors, noise)
            for k, part in block:
                if part.rows.any():
                    losses[k].append(_part_losses(part, values, noise[-1]))
    return np.array([np.mean(each, axis=0) for each in losses.values()])


def _part_losses(part: RowProducts, values: Array, noise: Array) -> Array:
    """Logarithms of mean squared prediction errors relative to the noise variance, (k,).

    Args:
        part: Gram matrices of the held-out rows.
        values: Values of the unknowns in each of the k fits, (k, p).
        noise: Noise variance of each of the C channels, (C,).
    """
    squares = np.array(
        [part.residual_squares(each, part.mean_residuals(each)) for each in values]
    )
    loss: Array = np.log(
        np.maximum((squares / noise).sum(axis=1) / part.rows.sum(), SMALLEST_POSITIVE)
    )
    return loss


def _fit_weights(losses: Array, errors: Array) -> Array:
    """Weights of the fits according to losses on held-out parts, (k,).

    The weights have a sum of one and are proportional to exp(-d^2 / 2) max(error, 0.03)^-0.15. Here
    d is the mean difference from the loss of the best fit divided by its standard error, which is
    bounded to 0.01 ... 0.2. With fewer than `MIN_PARTS` (3) parts, only the fit with
    `DEFAULT_PRIOR_ERROR` (0.3) has a weight.

    Args:
        losses: Losses, (parts, k).
        errors: Relative errors of the bodies, (k,).
    """
    if len(losses) < MIN_PARTS:
        return np.asarray((errors == DEFAULT_PRIOR_ERROR) / 1.0)
    differences = losses - losses[:, [losses.mean(axis=0).argmin()]]
    error = differences.std(axis=0, ddof=1) / np.sqrt(len(differences))
    z = differences.mean(axis=0) / np.clip(error, MIN_LOSS_ERROR, MAX_LOSS_ERROR)
    weights = (
        np.exp(-0.5 * z**2)
        * np.maximum(errors, PRIOR_ERRORS[1]) ** -PRIOR_ERROR_EXPONENT
    )
    return np.asarray(weights / weights.sum())
