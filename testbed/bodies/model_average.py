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
    """Weighted mean and covariance of estimates by priors of several relative errors.

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

    def conditioned_on(self, values: Array, covariance: Array) -> ModelAverage:
        """Average conditioned on a generalised least-squares estimate instead of the rows.

        Its information counts correlated noise; the weights of the fits stay.

        Args:
            values: Of the same unknowns by generalised least squares, (p,).
            covariance: Of these, (p, p).
        """
        information = scaled_inverse(covariance)
        left = values - self.prior.mean

        def fit(error: float) -> tuple[Array, Array]:
            root = self.prior.times(error).root
            normal, right = root.T @ information @ root, root.T @ information @ left
            z, covariance = conditioned(normal, right, self.prior.least)
            return self.prior.mean + root @ z, root @ covariance @ root.T

        values = np.array([fit(error)[0] for error in self.errors.tolist()])
        spreads = np.array([fit(error)[1] for error in _unseen(self.errors).tolist()])
        mean, covariance = _mixture(self.weights, values, spreads)
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
    best = int(weights.argmax())
    wider = noise * _excess(parts, equations, prior, fits[best], errors[best])
    error = errors[0]
    if len(sizes) > 1:
        wide = _refitted(equations, prior, sizes, wider)
        error = _file_error(wide, sizes, weights, prior)
    unseen = _unseen(sizes)
    roots = [prior.times(each).root for each in unseen.tolist()]
    wide = _refitted(equations, prior, unseen, wider)
    spreads = [
        root @ fit.covariance @ root.T for root, fit in zip(roots, wide, strict=True)
    ]
    pairs = zip(errors, fits, strict=True)
    values = [prior.mean + prior.times(e).root @ fit.z for e, fit in pairs]
    mean, covariance = _mixture(weights, np.array(values), np.array(spreads))
    return ModelAverage(prior, sizes, weights, noise, mean, covariance, error, by_rows)


def _unseen(errors: Array) -> Array:
    """Errors of bodies that no row shows, (k,): at least those of any file.

    A single error is the one that was asked for.
    """
    return errors if len(errors) == 1 else np.maximum(errors, REFERENCE)


def _mixture(weights: Array, values: Array, covariances: Array) -> tuple[Array, Array]:
    """Mean, (p,), and covariance, (p, p), of a mixture of k Gaussian distributions.

    Args:
        weights: Weights, (k,), whose sum is one.
        values: Means, (k, p).
        covariances: Covariances, (k, p, p).
    """
    mean = weights @ values
    apart = values - mean
    within = np.einsum("k,kij->ij", weights, covariances)
    return mean, within + (weights * apart.T) @ apart


def _refitted(
    equations: NormalEquations, prior: LinearPrior, errors: Array, noise: Array
) -> list[PriorFit]:
    """Fits with other errors of the bodies, (k,), and other variances of noise, (k, C)."""
    return [
        fit_with_noise(_scaled(equations, prior, error), own, prior.least)
        for error, own in zip(errors.tolist(), noise, strict=True)
    ]


def _excess(
    parts: RowParts,
    equations: NormalEquations,
    prior: LinearPrior,
    fit: PriorFit,
    error: float,
) -> Array:
    """Scatter of the parts' scores over that of white noise, by channel, (C,); at least one.

    Correlated noise and what the model leaves out make it larger.

    Source    [LZ86]

    Args:
        parts: Rows of the recording.
        equations: Normal equations of all rows in z of the prior with an error of one.
        prior: Prior with an error of one.
        fit: Fit with another error.
        error: Relative error of the bodies in that fit.
    """
    root, whole = prior.times(error).root, parts.whole
    values = prior.mean + root @ fit.z
    constants = whole.constants(values)[:, None]
    ones = np.ones_like(constants)
    left = np.hstack([-values * ones, -constants, ones])
    means = whole.products[:, -2, :-2] / np.maximum(whole.rows, 1.0)[:, None]
    scores = []
    for part in parts.each:
        sums = np.einsum("cij,cj->ci", part.products[:, :-1], left)
        own = sums[:, :-1] - parts.offset * means * sums[:, -1:]
        scores.append(own @ root)
    scatter = np.einsum("kci,ij,kcj->c", scores, fit.covariance, scores)
    normal = _scaled(equations, prior, error).normal
    white = REPEATED * np.einsum("cij,ji->c", normal, fit.covariance)
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
    """Losses of held-out parts by fit, (parts, k), averaged over the block lengths.

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
    """Logarithms of mean squared prediction errors over the noise's variance, by fit, (k,)."""
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
