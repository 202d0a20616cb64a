"""Model average: fits whose priors have several strengths, weighted by held-out parts.

How wrong a model file is cannot be seen in a short recording, and each single guess is a bad one
somewhere. Strengths that held-out parts cannot distinguish are averaged: torques and wrenches are
linear in the unknowns, so that the average is an estimate.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from testbed.bodies.linear_prior import (
    REPEATED,
    LinearPrior,
    PriorFit,
    conditioned,
    fit_of_noise,
    fit_with_noise,
)
from testbed.bodies.row_products import RowParts, RowProducts
from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import (
    TINY,
    NormalEquations,
    scaled_inverse,
)

PRIOR_ERRORS = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Relative errors of the bodies: from a file that is right to one that says next to nothing."""

PRIOR_ERROR = 0.3
"""The one that is taken where there are too few parts to weigh them."""

REFERENCE = 0.5
"""Error of a file of which nothing is known; data determine what they narrow to a tenth of its
variance."""

BLOCKS = (1, 2, 4)
"""Parts that are held out together: from the longer ones fits have to extrapolate."""

FEWEST_PARTS = 3

SURE, UNSURE = 0.01, 0.2
"""Least and greatest standard error of a difference of losses, in logarithms."""

SIZE = 0.15
"""Power of a prior's error by which its weight falls: the file counts a little."""


@dataclass(frozen=True, eq=False)
class ModelAverage:
    """Average of fits with priors of several strengths.

    Attributes:
        prior: Prior with an error of one.
        errors: Relative error of the bodies, by fit, (k,).
        weights: Weights of the fits, (k,).
        noise: Variance of each channel's noise by fit, (k, C).
        values: Values of the unknowns, (p,).
        covariance: Covariance of the mixture, within the fits and between them, (p, p).
        prior_error: Relative error of the file's bodies: rms deviation of what data determine.
        by_rows: Values by rows of the parts.
    """

    prior: LinearPrior
    errors: Array
    weights: Array
    noise: Array
    values: Array
    covariance: Array
    prior_error: float
    by_rows: Mapping[RowProducts, Array] = field(default_factory=dict)

    def values_of(self, rows: RowProducts) -> Array:
        """Values of the unknowns by other rows, with the same weights and noise, (p,).

        Args:
            rows: Products of the rows.
        """
        if rows not in self.by_rows:
            return self.weights @ _values(rows, self.prior, self.errors, self.noise)
        return self.weights @ self.by_rows[rows]

    def conditioned_on(self, estimate: Estimate) -> ModelAverage:
        """The same average by the information of least squares, which weigh correlated noise.

        Args:
            estimate: Estimate of the same unknowns by generalised least squares.
        """
        information = scaled_inverse(np.array(estimate.covariance))
        left = estimate.values - self.prior.mean

        def fit(error: float) -> tuple[Array, Array, Array]:
            root = self.prior.times(error).root
            normal, right = root.T @ information @ root, root.T @ information @ left
            return root, *conditioned(normal, right, self.prior.least)

        wide = (
            self.errors if len(self.errors) == 1 else np.maximum(self.errors, REFERENCE)
        )
        values = np.array([root @ z for root, z, _ in map(fit, self.errors.tolist())])
        apart = values - self.weights @ values
        covariance = (self.weights * apart.T) @ apart
        for weight, (root, _, own) in zip(
            self.weights, map(fit, wide.tolist()), strict=True
        ):
            covariance += weight * root @ own @ root.T
        mean = self.prior.mean + self.weights @ values
        return replace(self, values=mean, covariance=covariance)


def model_average(
    parts: RowParts, prior: LinearPrior, errors: Sequence[float]
) -> ModelAverage:
    """Fit with priors of several strengths and average them by what they leave of held-out parts.

    The loss of a part is the logarithm of its squares, in units of the noise that the weakest prior
    leaves; weights fall with the difference from the best in standard errors over the parts.

    Args:
        parts: Rows of the recording.
        prior: Prior with an error of one.
        errors: Relative errors of the bodies.
    """
    whole, sizes = parts.whole, np.array(errors)
    equations = whole.equations(prior.root, prior.mean)
    fits = [
        fit_of_noise(_scaled(equations, prior, e), prior, whole.enough) for e in errors
    ]
    noise = np.array([fit.noise for fit in fits])
    by_rows, weights = dict[RowProducts, Array](), np.ones(1)
    if len(sizes) > 1:
        by_rows = {seen: _values(seen, prior, sizes, noise) for seen, _ in parts.folds}
        weights = _weights(_losses(parts, prior, sizes, noise, by_rows), sizes)
    z = np.array([prior.scale(e) * fit.z for e, fit in zip(errors, fits, strict=True)])
    apart, best = z - weights @ z, int(weights.argmax())
    noise_of_scores = noise * _excess(parts, prior, fits[best], errors[best])
    wide = _refitted(equations, prior, sizes, noise_of_scores)
    error = _file_error(wide, sizes, weights, prior) if len(sizes) > 1 else errors[0]
    if len(sizes) > 1:  # no evidence says how wrong bodies are that no row shows
        sizes = np.maximum(sizes, REFERENCE)
        wide = _refitted(equations, prior, sizes, noise_of_scores)
    covariance = (weights * apart.T) @ apart
    for weight, size, fit in zip(weights, sizes.tolist(), wide, strict=True):
        covariance += weight * _unscaled(fit.covariance, prior, size)
    return ModelAverage(
        prior,
        np.array(errors),
        weights,
        noise,
        prior.mean + prior.root @ (weights @ z),
        prior.root @ covariance @ prior.root.T,
        error,
        by_rows,
    )


def _refitted(
    equations: NormalEquations, prior: LinearPrior, errors: Array, noise: Array
) -> list[PriorFit]:
    """Fits with other errors of the bodies and variances of noise, (k, C)."""
    return [
        fit_with_noise(_scaled(equations, prior, error), own, prior.least)
        for error, own in zip(errors.tolist(), noise, strict=True)
    ]


def _unscaled(covariance: Array, prior: LinearPrior, error: float) -> Array:
    """Covariance in z of the prior with an error of one, (r, r)."""
    scale = prior.scale(error)
    return np.outer(scale, scale) * covariance


def _excess(parts: RowParts, prior: LinearPrior, fit: PriorFit, error: float) -> Array:
    """Scatter of the parts' scores over that of white noise, by channel, (C,); at least one.

    Correlated noise and what the model leaves out make it larger.

    Source    [LZ86]
    """
    values = prior.mean + prior.root @ (prior.scale(error) * fit.z)
    constants = parts.whole.constants(values)[:, None]
    ones = np.ones_like(constants)
    left = np.hstack([-values * ones, -constants, ones])
    whole = parts.whole
    means = whole.products[:, -2, :-2] / np.maximum(whole.rows, 1.0)[:, None]
    scores = []
    for part in parts.each:
        sums = np.einsum("cij,cj->ci", part.products[:, :-1], left)
        own = sums[:, :-1] - parts.offset * means * sums[:, -1:]
        scores.append(own @ prior.root)
    covariance = _unscaled(fit.covariance, prior, error)
    scatter = np.einsum("kci,ij,kcj->c", scores, covariance, scores)
    normal = whole.equations(prior.root, prior.mean).normal
    white = REPEATED * np.einsum("cij,ji->c", normal, covariance)
    excess = np.where(white > TINY, scatter / np.maximum(white, TINY), 0.0) / fit.noise
    return np.asarray(np.maximum(excess, 1.0))


def _file_error(
    fits: Sequence[PriorFit], errors: Array, weights: Array, prior: LinearPrior
) -> float:
    """Rms deviation from the file of the bodies' coordinates that data determine.

    REFERENCE counts as one coordinate.

    Source    [Mac92]
    """
    z = np.array([fit.z[: prior.bodies] for fit in fits])
    left = np.array([np.diagonal(fit.covariance)[: prior.bodies] for fit in fits])
    square = weights @ (errors[:, None] * z) ** 2
    determined = weights @ (1 - left)
    return float(np.sqrt((REFERENCE**2 + square.sum()) / (1 + determined.sum())))


def _scaled(
    equations: NormalEquations, prior: LinearPrior, error: float
) -> NormalEquations:
    """Normal equations in z of the prior with another error of the bodies."""
    scale = prior.scale(error)
    normal = equations.normal * np.outer(scale, scale)
    return replace(equations, normal=normal, right=equations.right * scale)


def _values(
    rows: RowProducts, prior: LinearPrior, errors: Array, noise: Array
) -> Array:
    """Values of the unknowns by some rows under the noise of all, by fit, (k, p)."""
    equations, values = rows.equations(prior.root, prior.mean), []
    for error, own in zip(errors.tolist(), noise, strict=True):
        z = fit_with_noise(_scaled(equations, prior, error), own, prior.least).z
        values.append(prior.mean + prior.times(error).root @ z)
    return np.array(values)


def _losses(
    parts: RowParts,
    prior: LinearPrior,
    errors: Array,
    noise: Array,
    by_rows: Mapping[RowProducts, Array],
) -> Array:
    """Losses of held-out parts by fit, (parts, k): averages over blocks of all lengths.

    Parts without rows are left out.
    """
    losses = defaultdict[int, list[Array]](list)
    for length in BLOCKS:
        for seen, block in parts.blocks(length):
            values = by_rows.get(seen)
            if values is None:
                values = _values(seen, prior, errors, noise)
            for k, part in block:
                if part.rows.any():
                    losses[k].append(_loss(part, values, noise[-1]))
    return np.array([np.mean(each, axis=0) for each in losses.values()])


def _loss(part: RowProducts, values: Array, noise: Array) -> Array:
    """Logarithms of a part's mean squares in units of the noise, by fit, (k,)."""
    squares = np.array([part.squares(each, part.constants(each)) for each in values])
    loss: Array = np.log(
        np.maximum((squares / noise).sum(axis=1) / part.rows.sum(), TINY)
    )
    return loss


def _weights(losses: Array, errors: Array) -> Array:
    """Weights of fits by their losses on parts, (parts, k)."""
    if len(losses) < FEWEST_PARTS:
        return np.asarray((errors == PRIOR_ERROR) / 1.0)
    excess = losses - losses[:, [losses.mean(axis=0).argmin()]]
    error = excess.std(axis=0, ddof=1) / np.sqrt(len(excess))
    apart = excess.mean(axis=0) / np.clip(error, SURE, UNSURE)
    weights = np.exp(-0.5 * apart**2) * np.maximum(errors, PRIOR_ERRORS[1]) ** -SIZE
    return np.asarray(weights / weights.sum())
