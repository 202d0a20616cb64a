"""Evidence (marginal likelihood) of linear models with Gaussian priors and unknown noise variances.

Channel c measures y_c = A_c x + B_c u_c + e_c. Coefficients x are shared by all channels, and
coefficients u_c belong to channel c; both have Gaussian priors of unit variance. Gaussian noise e_c
of variance s_c^2 is correlated: a sample is equivalent to 1 / f_c independent samples. The
computation needs only products of columns and measurements, so that many models of one recording
can be evaluated at little cost. The variances s_c^2 are estimated by expectation maximisation.

Source    [Mac92]
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from testbed.core.base.arrays import Array

MIN_CHANNEL_SAMPLES = 10
"""Largest number of samples of a channel that is ignored."""

INITIAL_VARIANCE_FRACTION = 0.25
"""Initial noise variance of a channel, as a fraction of its mean square."""


@dataclass(frozen=True, eq=False)
class ChannelProducts:
    """Inner products of regressor columns and measurements, channel by channel.

    Each of the C channels has P shared columns and m local columns. The prediction from the prior
    means of the coefficients is subtracted from the measurements.

    Attributes:
        shared: Products of the P columns that channels share, (C, P, P).
        cross: Products of shared columns and each channel's m local columns, (C, P, m).
        local: Products of the local columns, (C, m, m).
        moment: Products of all columns, shared columns first, with the measurements, (C, P + m).
        square: Sum of squares of the measurements, (C,).
        count: Number of samples, (C,).
    """

    shared: Array
    cross: Array
    local: Array
    moment: Array
    square: Array
    count: Array

    def with_scaled_columns(self, factors: Array, mean: Array) -> ChannelProducts:
        """Products for shared columns that are scaled by one factor per channel.

        The measurements are unchanged, but the prior prediction that is subtracted from them is
        scaled with the columns.

        Args:
            factors: Scale factor of each channel, (C,).
            mean: Prior mean of the shared coefficients, (P,).
        """
        shared_count, excess = len(mean), factors[:, None] - 1
        prior_prediction = self.shared @ mean
        moment = self.moment.copy()
        moment[:, shared_count:] -= excess * (mean @ self.cross)
        moment[:, :shared_count] = factors[:, None] * (
            moment[:, :shared_count] - excess * prior_prediction
        )
        square = (excess[:, 0] * prior_prediction.T).T @ mean * excess[:, 0]
        square += self.square - 2 * excess[:, 0] * (
            self.moment[:, :shared_count] @ mean
        )
        scale = factors[:, None, None]
        return replace(
            self,
            shared=scale**2 * self.shared,
            cross=scale * self.cross,
            moment=moment,
            square=square,
        )

    def predicted_products(self, values: Array) -> Array:
        """Products of all columns with the signal predicted from given coefficients, (C, P + m).

        Args:
            values: Coefficients of each channel, (C, P + m).
        """
        shared_count = self.shared.shape[1]
        x, u = values[:, :shared_count, None], values[:, shared_count:, None]
        shared = self.shared @ x + self.cross @ u
        local = self.cross.transpose(0, 2, 1) @ x + self.local @ u
        return np.asarray(np.concatenate([shared, local], axis=1)[:, :, 0])

    def without_channel(self, channel: int) -> ChannelProducts:
        """Products that exclude one channel by setting its sample count to zero.

        Args:
            channel: Index of the channel.
        """
        count = np.where(np.arange(len(self.count)) == channel, 0.0, self.count)
        return replace(self, count=count)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Log marginal likelihood of a linear-Gaussian model, and its posterior coefficients.

    Attributes:
        log_evidence: Logarithm of the marginal likelihood [nats].
        variance: Noise variance of each channel, (C,).
        shared_mean: Posterior mean of the shared coefficients, relative to their prior mean, (P,).
        local_mean: Posterior mean of each channel's local coefficients, relative to their prior
            mean, (C, m).
        residual_squares: Sum of squared residuals at the posterior mean, (C,).
        cholesky_factor: Lower Cholesky factor of the shared coefficients' information matrix, (P,
            P).
        weight: Weight 1 / (f_c s_c^2) of one sample of each channel, (C,).
        cross: Weighted products of shared and local columns, (C, P, m).
        local_covariance: Posterior covariance of the local coefficients conditional on the shared
            coefficients, (C, m, m).
    """

    log_evidence: float
    variance: Array
    shared_mean: Array
    local_mean: Array
    residual_squares: Array
    cholesky_factor: Array
    weight: Array
    cross: Array
    local_covariance: Array

    @property
    def coefficients(self) -> Array:
        """Posterior mean of each channel's coefficients, shared then local, (C, P + m)."""
        shared = np.broadcast_to(
            self.shared_mean, (len(self.local_mean), len(self.shared_mean))
        )
        return np.concatenate([shared, self.local_mean], axis=1)

    def additional_gradient(
        self, cross: Array, gram: Array, moment: Array
    ) -> tuple[Array, Array]:
        """Gradient and Fisher information of the log evidence for additional coefficients.

        The E additional coefficients are shared by the channels, and the derivatives are evaluated
        where these coefficients are zero. All coefficients of the model are integrated out.

        Args:
            cross: Products of the model's columns with the additional columns, (C, P + m, E).
            gram: Products of the additional columns, (C, E, E).
            moment: Products of the additional columns with the residuals, (C, E).

        Returns:
            Gradient, (E,), and Fisher information, (E, E).
        """
        shared_count = len(self.shared_mean)
        weighted = self.weight[:, None, None] * cross
        local = weighted[:, shared_count:]
        projected = self.cross @ (self.local_covariance @ local)
        shared = (weighted[:, :shared_count] - projected).sum(axis=0)
        reduced = solve_triangular(
            self.cholesky_factor, shared, lower=True, check_finite=False
        )
        information = np.tensordot(self.weight, gram, 1) - reduced.T @ reduced
        information -= (local.transpose(0, 2, 1) @ self.local_covariance @ local).sum(0)
        return self.weight @ moment, information


def linear_evidence(
    products: ChannelProducts,
    floor: Array,
    inflation: Array,
    variance: Array | None = None,
    iterations: int = 6,
) -> Evidence:
    """Evidence of a linear-Gaussian model whose noise variances are estimated from the data.

    The variances are estimated by expectation maximisation. Channels with at most
    MIN_CHANNEL_SAMPLES (10) samples are ignored.

    Args:
        products: Products of columns and measurements.
        floor: Smallest standard deviation of each channel's noise, (C,).
        inflation: Number of each channel's samples that are equivalent to one independent sample,
            (C,).
        variance: Initial noise variances, (C,); None for a fraction of the mean squares.
        iterations: Number of E-steps; variances are updated after all but the last.
    """
    counted_channels = products.count > MIN_CHANNEL_SAMPLES
    samples = np.maximum(products.count, 1.0)
    if variance is None:
        variance = np.maximum(
            INITIAL_VARIANCE_FRACTION * products.square / samples, floor**2
        )
    for _ in range(iterations - 1):
        estimate = _posterior(
            products, variance, np.where(counted_channels, inflation, np.inf)
        )
        squares = estimate.residual_squares + _covariance_traces(products, estimate)
        updated = np.maximum(squares / samples, floor**2)
        variance = np.where(counted_channels, updated, variance)
    estimate = _posterior(
        products, variance, np.where(counted_channels, inflation, np.inf)
    )
    determinant = np.linalg.slogdet(estimate.local_covariance)[1]
    weighted = estimate.weight[:, None] * products.moment
    quadratic = estimate.weight @ products.square
    quadratic -= (weighted * estimate.coefficients).sum()
    noise = (products.count / inflation * np.log(2 * np.pi * variance))[
        counted_channels
    ].sum()
    volume = (
        2 * np.log(np.diag(estimate.cholesky_factor)).sum()
        - determinant[counted_channels].sum()
    )
    return replace(estimate, log_evidence=float(-0.5 * (noise + quadratic + volume)))


def _posterior(
    products: ChannelProducts, variance: Array, inflation: Array
) -> Evidence:
    """Compute the posterior for given noise variances by eliminating the local coefficients.

    The `log_evidence` of the result is nan.

    Args:
        products: Products of columns and measurements.
        variance: Noise variances, (C,).
        inflation: Number of samples equivalent to one independent sample, (C,); infinite for
            ignored channels.
    """
    shared_count = products.shared.shape[1]
    weight = 1 / (inflation * variance)
    moment = weight[:, None] * products.moment
    cross, local = (
        weight[:, None, None] * each for each in (products.cross, products.local)
    )
    covariance = np.asarray(np.linalg.inv(np.eye(local.shape[1]) + local), float)
    projected = cross @ covariance
    flat = projected.transpose(1, 0, 2).reshape(shared_count, -1)
    matrix = np.eye(shared_count) + np.tensordot(weight, products.shared, 1)
    matrix -= flat @ cross.transpose(1, 0, 2).reshape(shared_count, -1).T
    right_side = moment[:, :shared_count].sum(axis=0)
    right_side -= (projected @ moment[:, shared_count:, None]).sum(axis=0)[:, 0]
    factor = cholesky(matrix, lower=True, check_finite=False)
    shared = cho_solve((factor, True), right_side, check_finite=False)
    remainder = moment[:, shared_count:] - cross.transpose(0, 2, 1) @ shared
    local_mean = (covariance @ remainder[:, :, None])[:, :, 0]
    coefficients = np.concatenate(
        [np.broadcast_to(shared, (len(local_mean), shared_count)), local_mean], axis=1
    )
    fitted = products.predicted_products(coefficients)
    residual = products.square + ((fitted - 2 * products.moment) * coefficients).sum(
        axis=1
    )
    return Evidence(
        log_evidence=np.nan,
        variance=variance,
        shared_mean=shared,
        local_mean=local_mean,
        residual_squares=np.maximum(residual, 0.0),
        cholesky_factor=factor,
        weight=weight,
        cross=cross,
        local_covariance=covariance,
    )


def _covariance_traces(products: ChannelProducts, estimate: Evidence) -> Array:
    """Traces of each channel's Gram matrix times the posterior covariance, (C,).

    Each trace is the expected sum of squared prediction errors due to uncertain coefficients.
    """
    identity = np.eye(len(estimate.shared_mean))
    # posterior covariance of the shared coefficients
    shared = cho_solve((estimate.cholesky_factor, True), identity, check_finite=False)
    projected = estimate.cross @ estimate.local_covariance
    covariance_product = shared @ projected
    local_covariance = (
        estimate.local_covariance + projected.transpose(0, 2, 1) @ covariance_product
    )
    traces = products.shared.reshape(len(covariance_product), -1) @ shared.ravel()
    traces -= 2 * (products.cross * covariance_product).sum(axis=(1, 2))
    return np.asarray(traces + (products.local * local_covariance).sum(axis=(1, 2)))
