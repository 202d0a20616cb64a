"""Linear maps from a force plate's channels to the wrench on a robot.

With the right mapping, the six channels w in the bedplate frame are linear in one set of inertial
parameters: A w + b = Y(q, q', q'') delta_r at all instants. A (6, 6) and b contain units, senses,
order of columns, rotation and origin of the frame, and the zero of the plate, and the equation is
linear in both. The regressor columns Y and constants are therefore projected out once, for
positions as recorded; with H, the products of the residuals, any A leaves the sum of squares
vec(A)' H vec(A). A shift of the frame by r (moments gain r x F), a small rotation, and a small
delay of the wrench (A dw/dt) are linear as well: they are fitted for each A instead of searched.

The least generalised eigenvalue of H and of G, the products of the signals, is the residual that no
mapping of a plate can reduce.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array, skew
from testbed.core.estimation.regression.normal_equations import (
    inverse_square_root,
    unit_diagonal,
)
from testbed.importing.check.instants import Instants

CORRELATION_LENGTH = 10.0
"""Correlation length of residuals in instants, from model errors."""

MODEL_ERROR_SHARE = 1e-3
"""Part of a channel's variance that counts as noise in addition to measured noise."""

NOISY_SHARE, FREE_SIGMA = 0.1, 1e-3
"""Noise share of forces or moments from which they are noisy; and relative standard deviation of
residuals without noisy channels, which leaves parameters free."""

MIN_VARIANCE_SHARE = 0.02
"""Least variance of a channel, relative to the mean variance of forces, or of moments."""

CORRECTION_SIGMAS = np.repeat([0.2, 1.0, 0.02], [3, 4, 1])
"""Prior standard deviations of the corrections of a map: origin [m], delay [s], rotation [rad],
ratio."""

PRIOR_WEIGHT = 1e-7
"""Weight of this prior in the comparison of maps."""

SHIFT_INDICES, DELAY_INDEX, ROTATION_INDICES, RATIO_INDEX = [0, 1, 2], 3, [4, 5, 6], 7
"""Indices of the corrections of a map: shift [m], delay [s], rotation [rad], ratio of moments to
forces."""


def rotation_vector(rotation: Array) -> Array:
    """Rotation vector of a rotation matrix, with a length of at most pi, (3,) [rad].

    Args:
        rotation: Rotation matrix, (3, 3).
    """
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())


def _map_derivatives() -> Array:
    """Derivatives of a map with respect to its corrections, as left factors, (8, 6, 6)."""
    derivatives = np.zeros((8, 6, 6))
    derivatives[SHIFT_INDICES, 3:, :3] = derivatives[
        ROTATION_INDICES, :3, :3
    ] = derivatives[ROTATION_INDICES, 3:, 3:] = skew(np.eye(3))
    derivatives[DELAY_INDEX] = np.eye(6)  # of the wrench's derivative
    derivatives[RATIO_INDEX, 3:, 3:] = np.eye(3)
    return derivatives


MAP_DERIVATIVES = _map_derivatives()
"""Derivatives of a map by its corrections, as left factors of the map, (8, 6, 6)."""


def ridge_regression(
    rows: Array, target: Array, sigma: Array
) -> tuple[Array, Array, Array]:
    """Linear regression with a Gaussian prior and free constants.

    If the plate measures only noise, the parameters remain close to those of the model file.

    Args:
        rows: Regressor of the parameters, scaled by prior standard deviations, (T, 6, N), where T
            is the number of instants and N the number of parameters.
        target: Signals with the prediction of the model file subtracted, (T, 6, k).
        sigma: Standard deviations of the channels' residuals, (6,).

    Returns:
        Deviations of the parameters in prior standard deviations, (N, k), a square root of their
        covariance, (N, N), and residuals, (T, 6, k).
    """
    columns = ((rows - rows.mean(axis=0)) / sigma[:, None]).reshape(-1, rows.shape[2])
    varied = target - target.mean(axis=0)
    scaled = (varied / sigma[:, None]).reshape(len(columns), -1)
    root = inverse_square_root(columns.T @ columns + np.eye(columns.shape[1]))
    departure = root @ (root.T @ (columns.T @ scaled))
    residual = varied - (columns @ departure).reshape(varied.shape) * sigma[:, None]
    return departure, root, residual


class MapFit(NamedTuple):
    """Residuals and fitted corrections of a map.

    Attributes:
        unexplained: Unexplained share of each channel's variance, (6,).
        noise: Noise share of each channel's variance, (6,).
        corrections: Corrections of the map, zero if not fitted, (8,).
        sigma: Standard deviations of the corrections for white residuals, (8,).
        mass_scale: Ratio of the wrench to the prediction from the model file's masses; negative for
            the opposite sense.
    """

    unexplained: Array
    noise: Array
    corrections: Array
    sigma: Array
    mass_scale: float


class PlateRows:
    """Products of a plate's channels, with parameters and constants projected out.

    Attributes:
        expected: Varying part of the wrench predicted from the model file, scaled to unit size, (T,
            6), where T is the number of instants.
        weight: Factors that scale forces and moments to unit size, (6,).
    """

    def __init__(self, rows: Array, expected: Array, instants: Instants) -> None:
        """Project out the parameters and compute the products.

        Args:
            rows: Regressor of the N parameters, scaled by prior standard deviations, (T, 6, N).
            expected: Wrench predicted from the model file's masses, (T, 6) [N, N m].
            instants: Low-pass filtered signals, with a wrench.
        """
        varied = expected - expected.mean(axis=0)
        size = np.sqrt(_force_moment_means((varied**2).mean(axis=0)))
        self.weight = np.repeat(1 / np.where(size > 0, size, 1.0), 3)
        self.expected = varied * self.weight
        self.channels = np.hstack([instants.wrench, instants.wrench_rate])
        self.channels -= self.channels.mean(axis=0)
        self._noise = instants.wrench_noise * len(varied)
        self._covariance = self.channels.T @ self.channels
        sigma = _residual_sigma(instants)
        weighted = self.expected / sigma**2
        model = (weighted.T @ self.channels * self.weight[:, None]).ravel()
        self._model = model / (weighted * self.expected).sum()
        signals = np.einsum("tk,cd->tcdk", self.channels, np.diag(self.weight))
        signals = signals.reshape(len(varied), 6, 72)
        signals -= (
            self.expected[..., None] * self._model
        )  # in proportion to each map's size
        departure, _, signals = ridge_regression(
            rows * self.weight[:, None], signals, sigma
        )
        self._departure = departure.T @ departure
        self._residual = np.einsum("tcx,tcy->cxy", signals, signals, optimize=True)

    def fit(
        self, matrix: Array, places: Sequence[int] = (*SHIFT_INDICES, DELAY_INDEX)
    ) -> MapFit:
        """Fit corrections of a map by least squares, and compute the residuals.

        Args:
            matrix: Map from the recorded wrench to the wrench in the bedplate frame, (6, 6).
            places: Indices of the corrections to be fitted.
        """
        places = list(places)
        terms = np.zeros((1 + len(MAP_DERIVATIVES), 6, 12))
        terms[:, :, :6] = [matrix, *(MAP_DERIVATIVES @ matrix)]
        terms[1 + DELAY_INDEX] = np.roll(
            terms[0], 6, axis=1
        )  # of the wrench's derivative
        flat = terms.reshape(-1, 72)[[0, *(1 + np.array(places))]]
        residual = flat @ self._residual @ flat.T  # (6, 1 + k, 1 + k)
        variances, noise = (
            _limited_variance(self._variance(matrix)),
            self.weight**2 * (matrix**2 @ self._noise),
        )
        weight = MODEL_ERROR_SHARE / (MODEL_ERROR_SHARE * variances + noise)
        total = np.tensordot(weight, residual, 1)
        total += (
            MODEL_ERROR_SHARE / variances.mean() * (flat @ self._departure @ flat.T)
        )
        inverse = np.linalg.inv(
            total[1:, 1:] + np.diag(PRIOR_WEIGHT / CORRECTION_SIGMAS[places] ** 2)
        )
        coefficients = np.array([1.0, *(-inverse @ total[1:, 0])])
        squares = residual @ coefficients @ coefficients
        extras, sigma = np.zeros((2, len(MAP_DERIVATIVES)))
        extras[places] = coefficients[1:]
        variance = np.diagonal(inverse) * (weight @ squares) / (6 * len(self.expected))
        sigma[places] = np.sqrt(variance)
        size = float(coefficients @ flat @ self._model)
        return MapFit(
            np.maximum(squares / variances, 0.0), noise / variances, extras, sigma, size
        )

    def moment_factor(self, matrix: Array) -> float:
        """Factor on moments that yields the model file's rms ratio of moments to forces.

        Args:
            matrix: Map of the channels, (6, 6).
        """
        force, moment = _force_moment_means(self._variance(matrix))
        return float(np.sqrt(force / moment)) if min(force, moment) > 0 else 1.0

    def _variance(self, matrix: Array) -> Array:
        """Variance of each mapped channel, relative to the variance of the model's wrench, (6,)."""
        return np.asarray(
            self.weight**2 * ((matrix @ self._covariance[:6, :6]) * matrix).sum(axis=1)
        )

    @cached_property
    def least_residual_share(self) -> float:
        """Least residual share over all linear maps of channels and their derivatives.

        It is the least generalised eigenvalue of the products of residuals and of signals.
        """
        from scipy.linalg import eigh as generalized

        total = np.kron(np.diag(self.weight**2), self._covariance).astype(np.float64)
        scaled, size = unit_diagonal(total)
        residual = self._residual.sum(axis=0) / np.outer(size, size)
        scaled += 1e-10 * np.eye(len(total))
        least = generalized(residual, scaled, eigvals_only=True, subset_by_index=[0, 0])
        return max(float(least[0]), 1e-12)


def _residual_sigma(instants: Instants) -> Array:
    """Standard deviations of the channels' residuals, relative to forces or moments, (6,).

    They are 1e-3 if the noise is below 10 % of the variance of forces and of moments; otherwise
    they account for model errors and correlated noise.
    """
    variance = _force_moment_means(instants.wrench.var(axis=0))
    noise = _force_moment_means(instants.wrench_noise) / np.maximum(variance, 1e-30)
    if noise.max() < NOISY_SHARE:
        return np.full(6, FREE_SIGMA)
    return np.repeat(np.sqrt(MODEL_ERROR_SHARE + CORRELATION_LENGTH * noise), 3)


def _limited_variance(variance: Array) -> Array:
    """Variances of channels, (6,), bounded below by 2 % of the mean over forces or moments."""
    mean = np.repeat(_force_moment_means(variance), 3)
    return np.maximum(variance, np.maximum(MIN_VARIANCE_SHARE * mean, 1e-300))


def _force_moment_means(channels: Array) -> Array:
    """Mean over the forces and mean over the moments, (2,), of values for six channels."""
    return np.asarray(channels.reshape(2, 3).mean(axis=1))
