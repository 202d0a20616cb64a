"""Evidence of linear models with Gaussian priors and unknown noise of each channel.

Channel c measures y_c = A_c x + B_c u_c + e_c. Coefficients x belong to all channels, u_c to one;
they are N(0, 1) about their means, and e_c ~ N(0, s_c^2), of which a sample counts 1 / f_c times:
what models leave is correlated. All follows from products of columns and measurements, so that many
models of one recording cost little. The variances s_c^2 are found by expectation maximisation.

Source    [Mac92]
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from testbed.core.base.arrays import Array

FEWEST = 10
"""Samples of a channel below which it does not count."""

START = 0.25
"""Part of a channel's mean square with which the search of its variance begins."""


@dataclass(frozen=True, eq=False)
class ChannelProducts:
    """Products of columns and measurements about their prior means, channel by channel.

    Attributes:
        shared: Of the P columns that channels share, (C, P, P).
        cross: Of these and of each channel's m own columns, (C, P, m).
        local: Of the latter, (C, m, m).
        moment: Of all columns, the shared ones first, and measurements, (C, P + m).
        square: Of the measurements, (C,).
        count: Samples, (C,).
    """

    shared: Array
    cross: Array
    local: Array
    moment: Array
    square: Array
    count: Array

    def scaled(self, factors: Array, mean: Array) -> ChannelProducts:
        """Products with each channel's shared columns multiplied by its scale factor.

        Args:
            factors: (C,).
            mean: Prior mean of the shared coefficients, (P,).
        """
        size, more = len(mean), factors[:, None] - 1
        bodies = self.shared @ mean
        moment = self.moment.copy()
        moment[:, size:] -= more * (mean @ self.cross)
        moment[:, :size] = factors[:, None] * (moment[:, :size] - more * bodies)
        square = (more[:, 0] * bodies.T).T @ mean * more[:, 0]
        square += self.square - 2 * more[:, 0] * (self.moment[:, :size] @ mean)
        wide = factors[:, None, None]
        return replace(
            self,
            shared=wide**2 * self.shared,
            cross=wide * self.cross,
            moment=moment,
            square=square,
        )

    def times(self, values: Array) -> Array:
        """Products of all columns with the predicted signal of coefficients, (C, P + m).

        Args:
            values: Coefficients of each channel, (C, P + m).
        """
        size = self.shared.shape[1]
        x, u = values[:, :size, None], values[:, size:, None]
        shared = self.shared @ x + self.cross @ u
        local = self.cross.transpose(0, 2, 1) @ x + self.local @ u
        return np.asarray(np.concatenate([shared, local], axis=1)[:, :, 0])

    def without(self, channel: int) -> ChannelProducts:
        """Products without the samples of one channel."""
        count = np.where(np.arange(len(self.count)) == channel, 0.0, self.count)
        return replace(self, count=count)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Log marginal likelihood of a linear-Gaussian model, and its posterior coefficients.

    Attributes:
        log: Logarithm of the marginal likelihood [nats].
        variance: Of each channel's noise, (C,).
        shared: Posterior mean of the shared coefficients about their prior mean, (P,).
        local: The same of each channel's own, (C, m).
        residual: Sums of squares at the posterior mean, (C,).
        factor: Cholesky factor of the shared coefficients' information, (P, P).
        weight: Of one sample of each channel, (C,).
        cross: Weighted products of shared and local columns, (C, P, m).
        local_covariance: Of the local coefficients where the shared ones are known, (C, m, m).
    """

    log: float
    variance: Array
    shared: Array
    local: Array
    residual: Array
    factor: Array
    weight: Array
    cross: Array
    local_covariance: Array

    @property
    def coefficients(self) -> Array:
        """All coefficients of each channel about their prior means, (C, p)."""
        shared = np.broadcast_to(self.shared, (len(self.local), len(self.shared)))
        return np.concatenate([shared, self.local], axis=1)

    def marginal(self, cross: Array, gram: Array, moment: Array) -> tuple[Array, Array]:
        """Gradient, (E,), and Fisher information, (E, E), of additional coefficients.

        All coefficients of the model are integrated out.

        Args:
            cross: Products of the model's columns with the further ones, (C, p, E).
            gram: Of the further columns, (C, E, E).
            moment: Of the further columns with the residuals, (C, E).
        """
        size = len(self.shared)
        weighted = self.weight[:, None, None] * cross
        local = weighted[:, size:]
        projected = self.cross @ (self.local_covariance @ local)
        shared = (weighted[:, :size] - projected).sum(axis=0)
        reduced = solve_triangular(self.factor, shared, lower=True, check_finite=False)
        information = np.tensordot(self.weight, gram, 1) - reduced.T @ reduced
        information -= (local.transpose(0, 2, 1) @ self.local_covariance @ local).sum(0)
        return self.weight @ moment, information


def evidence(
    products: ChannelProducts,
    floor: Array,
    inflation: Array,
    variance: Array | None = None,
    rounds: int = 6,
) -> Evidence:
    """Evidence of a linear-Gaussian model; estimate its channels' noise variances.

    Args:
        products: Of columns and measurements.
        floor: Least standard deviation of each channel's noise, (C,).
        inflation: Samples of each channel that count as one, (C,).
        variance: Where the search begins, (C,).
        rounds: Of expectation maximisation; the last one finds no variance.
    """
    live = products.count > FEWEST
    samples = np.maximum(products.count, 1.0)
    if variance is None:
        variance = np.maximum(START * products.square / samples, floor**2)
    for _ in range(rounds - 1):
        estimate = _posterior(products, variance, np.where(live, inflation, np.inf))
        residual = estimate.residual + _spread(products, estimate)
        updated = np.maximum(residual / samples, floor**2)
        variance = np.where(live, updated, variance)
    estimate = _posterior(products, variance, np.where(live, inflation, np.inf))
    determinant = np.linalg.slogdet(estimate.local_covariance)[1]
    weighted = estimate.weight[:, None] * products.moment
    quadratic = estimate.weight @ products.square
    quadratic -= (weighted * estimate.coefficients).sum()
    noise = (products.count / inflation * np.log(2 * np.pi * variance))[live].sum()
    volume = 2 * np.log(np.diag(estimate.factor)).sum() - determinant[live].sum()
    return replace(estimate, log=float(-0.5 * (noise + quadratic + volume)))


def _posterior(
    products: ChannelProducts, variance: Array, inflation: Array
) -> Evidence:
    """Posterior coefficients for given noise variances, local coefficients eliminated."""
    size = products.shared.shape[1]
    weight = 1 / (inflation * variance)
    moment = weight[:, None] * products.moment
    cross, local = (
        weight[:, None, None] * each for each in (products.cross, products.local)
    )
    covariance = np.asarray(np.linalg.inv(np.eye(local.shape[1]) + local), float)
    projected = cross @ covariance
    flat = projected.transpose(1, 0, 2).reshape(size, -1)
    matrix = np.eye(size) + np.tensordot(weight, products.shared, 1)
    matrix -= flat @ cross.transpose(1, 0, 2).reshape(size, -1).T
    right = moment[:, :size].sum(axis=0)
    right -= (projected @ moment[:, size:, None]).sum(axis=0)[:, 0]
    factor = cholesky(matrix, lower=True, check_finite=False)
    shared = cho_solve((factor, True), right, check_finite=False)
    rest = moment[:, size:] - cross.transpose(0, 2, 1) @ shared
    own = (covariance @ rest[:, :, None])[:, :, 0]
    both = np.concatenate([np.broadcast_to(shared, (len(own), size)), own], axis=1)
    fitted = products.times(both)
    residual = products.square + ((fitted - 2 * products.moment) * both).sum(axis=1)
    return Evidence(
        log=np.nan,
        variance=variance,
        shared=shared,
        local=own,
        residual=np.maximum(residual, 0.0),
        factor=factor,
        weight=weight,
        cross=cross,
        local_covariance=covariance,
    )


def _spread(products: ChannelProducts, estimate: Evidence) -> Array:
    """Traces of the Gram matrices times the posterior covariance, (C,)."""
    identity = np.eye(len(estimate.shared))
    # posterior covariance of the shared coefficients
    shared = cho_solve((estimate.factor, True), identity, check_finite=False)
    projected = estimate.cross @ estimate.local_covariance
    moved = shared @ projected
    own = estimate.local_covariance + projected.transpose(0, 2, 1) @ moved
    spread = products.shared.reshape(len(moved), -1) @ shared.ravel()
    spread -= 2 * (products.cross * moved).sum(axis=(1, 2))
    return np.asarray(spread + (products.local * own).sum(axis=(1, 2)))
