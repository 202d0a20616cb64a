"""What a plate's channels can be: one linear map of what was recorded, judged by algebra.

For the right mapping the six channels w, in the bedplate's frame, are linear in ONE set of inertial
parameters: A w + b = Y(q, q', q'') delta_r at all instants. Units, senses, orders of columns, the
frame's turn and place, and what an unloaded plate shows are all in A (6x6) and b, and the equation
is linear in both. So the rows Y, and constants, are projected out once for positions as they are
read; with the products H of what is left, every A leaves vec(A)' H vec(A). A frame that lies
elsewhere by r (moments gain r x F), one that is turned a little more, and a wrench that is a little
late (A dw/dt) are linear as well: they are fitted beside each A, not searched.

What the least generalized eigenvector of H against the signal's own products G leaves, no mapping
of a plate can mend.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array, skew
from testbed.core.estimation.regression.normal_equations import (
    inverse_root,
    unit_diagonal,
)
from testbed.importing.check.instants import Instants

LASTS = 10.0
"""Instants over which what models leave lasts: it is no white noise."""

QUIET = 1e-3
"""Part of a channel's variance that counts as noise besides its own."""

NOISY, FREE = 0.1, 1e-3
"""Part of forces' or moments' variance from which they are noise; where neither are, the sigma of
what is left that leaves parameters free."""

SILENT = 0.02
"""Part of the mean variance of forces, or of moments, that a channel counts with at least."""

WIDE = np.repeat([0.2, 1.0, 0.02], [3, 4, 1])
"""Standard deviations of what is fitted before the data: of the place [m], of the delay [s], of the
turn [rad] and of the ratio."""

LOOSE = 1e-7
"""Weight of these beside the data where maps are compared."""

SHIFT, LATE, TURN, RATIO = [0, 1, 2], 3, [4, 5, 6], 7
"""Places of what may be fitted beside a map: [m], [s], [rad], moments over forces."""


def rotation_vector(turn: Array) -> Array:
    """Of a turn, (3, 3), no longer than pi [rad], (3,)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(turn).as_rotvec())


def _slopes() -> Array:
    """Derivatives of a map, to be multiplied by it, by what is fitted beside it, (8, 6, 6)."""
    slopes = np.zeros((8, 6, 6))
    slopes[SHIFT, 3:, :3] = slopes[TURN, :3, :3] = slopes[TURN, 3:, 3:] = skew(
        np.eye(3)
    )
    slopes[LATE] = np.eye(6)  # of the wrench's derivative
    slopes[RATIO, 3:, 3:] = np.eye(3)
    return slopes


SLOPES = _slopes()


def ridge_regression(
    rows: Array, target: Array, sigma: Array
) -> tuple[Array, Array, Array]:
    """Parameters that explain signals, with any constants, and what they leave.

    Where the plate is noise, parameters remain near the model file's.

    Args:
        rows: On the parameters in sigmas of the prior, (T, 6, N).
        target: Less what the file predicts, (T, 6, k).
        sigma: Of what is left of the channels, (6,).

    Returns:
        Departures in sigmas of the prior, (N, k); a root of their covariance, (N, N); what is
        left, (T, 6, k).
    """
    columns = ((rows - rows.mean(axis=0)) / sigma[:, None]).reshape(-1, rows.shape[2])
    varied = target - target.mean(axis=0)
    scaled = (varied / sigma[:, None]).reshape(len(columns), -1)
    root = inverse_root(columns.T @ columns + np.eye(columns.shape[1]))
    departure = root @ (root.T @ (columns.T @ scaled))
    left = varied - (columns @ departure).reshape(varied.shape) * sigma[:, None]
    return departure, root, left


class MapFit(NamedTuple):
    """What a map leaves.

    Attributes:
        unexplained: Part of each channel's variance that no parameters explain, (6,).
        noise: Part of it that is the channels' own noise, (6,).
        extras: What was fitted beside the map, zero for the others, (8,).
        sigma: Of them, if what is left is white, (8,).
        size: Times what the model file's masses make, by the variance; negative for the other
            sense.
    """

    unexplained: Array
    noise: Array
    extras: Array
    sigma: Array
    size: float


class PlateRows:
    """Products of the plate's channels that are left when the rows are projected out.

    Attributes:
        expected: The varying wrench by the model file's masses, of size one, (T, 6).
        weight: What forces and moments are multiplied by for that, (6,).
    """

    def __init__(self, rows: Array, expected: Array, instants: Instants) -> None:
        """The products.

        Args:
            rows: On the parameters in sigmas of the prior, (T, 6, N).
            expected: The wrench by the model file's masses, (T, 6) [N, N m].
            instants: With a wrench.
        """
        varied = expected - expected.mean(axis=0)
        size = np.sqrt(_halves((varied**2).mean(axis=0)))
        self.weight = np.repeat(1 / np.where(size > 0, size, 1.0), 3)
        self.expected = varied * self.weight
        self.channels = np.hstack([instants.wrench, instants.wrench_rate])
        self.channels -= self.channels.mean(axis=0)
        self._noise = instants.wrench_noise * len(varied)
        self._covariance = self.channels.T @ self.channels
        sigma = _sigma(instants)
        certain = self.expected / sigma**2
        model = (certain.T @ self.channels * self.weight[:, None]).ravel()
        self._model = model / (certain * self.expected).sum()
        signals = np.einsum("tk,cd->tcdk", self.channels, np.diag(self.weight))
        signals = signals.reshape(len(varied), 6, 72)
        signals -= self.expected[..., None] * self._model  # of each map's size
        departure, _, signals = ridge_regression(
            rows * self.weight[:, None], signals, sigma
        )
        self._departure = departure.T @ departure
        self._residual = np.einsum("tcx,tcy->cxy", signals, signals, optimize=True)

    def fit(self, each: Array, places: Sequence[int] = (*SHIFT, LATE)) -> MapFit:
        """What a map leaves, with what is free fitted beside it.

        Args:
            each: From what was recorded to the bedplate's wrench, (6, 6).
            places: Of what may be fitted.
        """
        places = list(places)
        terms = np.zeros((1 + len(SLOPES), 6, 12))
        terms[:, :, :6] = [each, *(SLOPES @ each)]
        terms[1 + LATE] = np.roll(terms[0], 6, axis=1)  # of the wrench's derivative
        flat = terms.reshape(-1, 72)[[0, *(1 + np.array(places))]]
        residual = flat @ self._residual @ flat.T  # (6, 1 + k, 1 + k)
        whole, noise = (
            _at_least(self._variance(each)),
            self.weight**2 * (each**2 @ self._noise),
        )
        weight = QUIET / (QUIET * whole + noise)
        total = np.tensordot(weight, residual, 1)
        total += QUIET / whole.mean() * (flat @ self._departure @ flat.T)
        inverse = np.linalg.inv(total[1:, 1:] + np.diag(LOOSE / WIDE[places] ** 2))
        best = np.array([1.0, *(-inverse @ total[1:, 0])])
        left = residual @ best @ best
        extras, sigma = np.zeros((2, len(SLOPES)))
        extras[places] = best[1:]
        variance = np.diagonal(inverse) * (weight @ left) / (6 * len(self.expected))
        sigma[places] = np.sqrt(variance)
        size = float(best @ flat @ self._model)
        return MapFit(np.maximum(left / whole, 0.0), noise / whole, extras, sigma, size)

    def gain_ratio(self, each: Array) -> float:
        """Times that moments must grow to be as large beside the forces as the model file's.

        Args:
            each: The map, (6, 6).
        """
        force, moment = _halves(self._variance(each))
        return float(np.sqrt(force / moment)) if min(force, moment) > 0 else 1.0

    def _variance(self, each: Array) -> Array:
        """Of each channel after a map, in parts of the model's, (6,)."""
        return np.asarray(
            self.weight**2 * ((each @ self._covariance[:6, :6]) * each).sum(axis=1)
        )

    @cached_property
    def least_share(self) -> float:
        """What the best of all maps leaves, crosstalk, derivatives of the channels and all."""
        from scipy.linalg import eigh as generalized

        whole = np.kron(np.diag(self.weight**2), self._covariance).astype(np.float64)
        scaled, size = unit_diagonal(whole)
        residual = self._residual.sum(axis=0) / np.outer(size, size)
        scaled += 1e-10 * np.eye(len(whole))
        least = generalized(residual, scaled, eigvals_only=True, subset_by_index=[0, 0])
        return max(float(least[0]), 1e-12)


def _sigma(instants: Instants) -> Array:
    """Of what is left of the channels, in parts of forces or moments, (6,)."""
    variance = _halves(instants.wrench.var(axis=0))
    noise = _halves(instants.wrench_noise) / np.maximum(variance, 1e-30)
    if noise.max() < NOISY:
        return np.full(6, FREE)
    return np.repeat(np.sqrt(QUIET + LASTS * noise), 3)


def _at_least(variance: Array) -> Array:
    """Variances of channels, (6,), each at least a part of its neighbours' mean."""
    mean = np.repeat(_halves(variance), 3)
    return np.maximum(variance, np.maximum(SILENT * mean, 1e-300))


def _halves(channels: Array) -> Array:
    """Means of forces' and of moments' values, (2,) of (6,)."""
    return np.asarray(channels.reshape(2, 3).mean(axis=1))
