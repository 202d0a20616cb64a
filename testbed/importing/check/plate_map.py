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
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array, skew
from testbed.importing.check.instants import Instants

HALVES = (slice(0, 3), slice(3, 6))
"""Forces, moments."""

LASTS = 10.0
"""Instants over which what models leave lasts: it is no white noise."""

QUIET = 1e-3
"""Part of a channel's variance that counts as noise besides its own."""

NOISY, FREE = 0.1, 1e-3
"""Part of forces' or moments' variance from which they are noise; where neither are, the sigma of
what is left that leaves parameters free."""

SILENT = 0.02
"""Part of the mean variance of forces, or of moments, that a channel counts with at least."""

LATEST = 0.08
"""Delays beyond this are not small [s]."""

SHIFT, LATE, TURN, RATIO = (0, 1, 2), 3, (4, 5, 6), 7
"""Places of what may be fitted beside a map: [m], [s], [rad], moments over forces."""

EXTRAS = 8


def transform(turn: Array, place: Array) -> Array:
    """The wrench in the bedplate's frame of one in a sensor's, (6, 6).

    Args:
        turn: Of the sensor's frame, (3, 3).
        place: Of its origin, (3,) [m].
    """
    matrix: Array = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = turn
    matrix[3:, :3] = skew(place) @ turn
    return matrix


def rotation_vector(turn: Array) -> Array:
    """Of a turn, (3, 3), no longer than pi [rad], (3,)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(turn).as_rotvec())


def _slopes() -> Array:
    """How a map changes with what is fitted beside it, but for lateness, (8, 6, 6)."""
    slopes = np.zeros((EXTRAS, 6, 6))
    for axis, unit in enumerate(np.eye(3)):
        slopes[SHIFT[axis], 3:, :3] = skew(unit)
        slopes[TURN[axis]] = transform(skew(unit), np.zeros(3))
    slopes[RATIO, 3:, 3:] = np.eye(3)
    return slopes


SLOPES = _slopes()


def near_file(rows: Array, target: Array, sigma: Array) -> tuple[Array, Array]:
    """Parameters that explain signals, with any constants, and what they leave.

    Ridge regression: where the plate is noise, parameters remain near the model file's.

    Args:
        rows: On the parameters in sigmas of the prior, (T, 6, N).
        target: Less what the file predicts, (T, 6, k).
        sigma: Of what is left of the channels, (6,).

    Returns:
        Departures in sigmas of the prior, (N, k); what is left, (T, 6, k).
    """
    columns = ((rows - rows.mean(axis=0)) / sigma[:, None]).reshape(-1, rows.shape[2])
    varied = target - target.mean(axis=0)
    scaled = (varied / sigma[:, None]).reshape(len(columns), -1)
    normal = columns.T @ columns + np.eye(columns.shape[1])
    departure = np.linalg.solve(normal, columns.T @ scaled)
    return departure, varied - (columns @ departure).reshape(varied.shape) * sigma[:, None]


@dataclass(frozen=True, eq=False)
class MapFits:
    """What M maps leave.

    Attributes:
        unexplained: Part of each channel's variance that no parameters explain, (M, 6).
        extras: What was fitted beside the maps, zero for the others, (M, 8).
        sigma: Of them, if what is left is white, (M, 8).
        size: Times what the model file's masses make, by the variance; negative for the other
            sense, (M,).
    """

    unexplained: Array
    extras: Array
    sigma: Array
    size: Array


class PlateRows:
    """Products of the plate's channels that are left when the rows are projected out."""

    def __init__(self, rows: Array, expected: Array, instants: Instants) -> None:
        """The products.

        Args:
            rows: On the parameters in sigmas of the prior, (T, 6, N).
            expected: The wrench by the model file's masses, (T, 6) [N, N m].
            instants: With a wrench.
        """
        varied = expected - expected.mean(axis=0)
        size = np.sqrt([(varied[:, part] ** 2).mean() for part in HALVES])
        weight = np.repeat(1 / np.where(size > 0, size, 1.0), 3)
        channels = np.hstack([instants.wrench, instants.wrench_rate])  # (T, 12)
        count = len(channels)
        centred = channels - channels.mean(axis=0)
        self.expected = varied * weight
        sigma = _sigma(instants)
        certain = self.expected / sigma**2
        self._model = np.einsum("tc,tk,c->ck", certain, centred, weight).ravel()
        self._model_size = float((self.expected * certain).sum())
        signals = np.einsum("tk,cd->tcdk", channels, np.diag(weight)).reshape(count, 6, 72)
        # of each map's size, in which the file predicts
        signals -= self.expected[..., None] * (self._model / self._model_size)
        departure, signals = near_file(rows * weight[:, None], signals, sigma)
        self._departure = departure.T @ departure
        self._residual = np.einsum("tcx,tcy->cxy", signals, signals, optimize=True)
        self._whole = np.zeros((6, 72, 72))
        for channel in range(6):
            own = slice(12 * channel, 12 * channel + 12)
            self._whole[channel][own, own] = weight[channel] ** 2 * centred.T @ centred
        self.weight, self._count = weight, count
        self._noise = instants.wrench_noise * count

    def fit(
        self, maps: Sequence[Array], free: Sequence[int] = (*SHIFT, LATE), *, likely: bool = False
    ) -> MapFits:
        """What each map leaves, with what is free fitted beside it.

        Args:
            maps: From what was recorded to the bedplate's wrench, (6, 6) each.
            free: Places of what may be fitted.
            likely: Whether parameters far from the model file's count against what is fitted.
        """
        stacked = np.stack(maps)
        count, free = len(stacked), list(free)
        terms = np.zeros((count, 1 + len(free), 6, 12))
        terms[:, 0, :, :6] = stacked
        for place, extra in enumerate(free, 1):
            if extra == LATE:
                terms[:, place, :, 6:] = stacked
            else:
                terms[:, place, :, :6] = SLOPES[extra] @ stacked
        flat = terms.reshape(count, -1, 72)
        whole = _at_least(np.einsum("mx,cxy,my->mc", flat[:, 0], self._whole, flat[:, 0],
                                   optimize=True))  # fmt: skip
        residual = np.stack(
            [
                (flat.reshape(-1, 72) @ each).reshape(flat.shape) @ flat.transpose(0, 2, 1)
                for each in self._residual
            ],
            axis=1,
        )  # (M, 6, 1 + k, 1 + k)
        weight = QUIET / (QUIET + self._noise_variance(stacked) / whole)
        total = (residual * (weight / whole)[:, :, None, None]).sum(axis=1)
        if likely:
            departure = (flat.reshape(-1, 72) @ self._departure).reshape(flat.shape)
            part = QUIET / whole.mean(axis=1)
            total += part[:, None, None] * (departure @ flat.transpose(0, 2, 1))
        size = np.sqrt(np.einsum("maa->ma", total)[:, 1:]) + 1e-300
        normal = total[:, 1:, 1:] / size[:, :, None] / size[:, None, :] + 1e-9 * np.eye(len(free))
        best = -np.linalg.solve(normal, (total[:, 1:, 0] / size)[..., None])[..., 0] / size
        spread = np.sqrt(np.einsum("maa->ma", np.linalg.inv(normal))) / size
        if LATE in free:
            late = best[:, free.index(LATE)]
            late[np.abs(late) > LATEST] = 0.0
        weights = np.hstack([np.ones((count, 1)), best])
        shares = np.einsum("ma,mcab,mb->mc", weights, residual, weights, optimize=True) / whole
        along = np.einsum("ma,max->mx", weights, flat) @ self._model / self._model_size
        extras, sigma = np.zeros((count, EXTRAS)), np.zeros((count, EXTRAS))
        extras[:, free] = best
        left = (weight * shares).sum(axis=1, keepdims=True)
        sigma[:, free] = spread * np.sqrt(left / (6 * self._count))
        return MapFits(np.maximum(shares, 0.0), extras, sigma, along)

    def gain_ratio(self, each: Array) -> float:
        """Times that moments must grow to be as large beside the forces as the model file's.

        Args:
            each: The map, (6, 6).
        """
        varied = self._variance(each).reshape(2, 3).sum(axis=1)
        return float(np.sqrt(varied[0] / varied[1])) if varied.min() > 0 else 1.0

    def _variance(self, each: Array) -> Array:
        """Of each channel after a map, in parts of the model's, (6,)."""
        flat = np.hstack([each, np.zeros((6, 6))]).ravel()
        variance: Array = np.einsum("x,cxy,y->c", flat, self._whole, flat)
        return variance

    def noise_share(self, each: Array) -> Array:
        """Part of each channel's variance that is the plate's own noise after a map, (6,).

        Args:
            each: The map, (6, 6).
        """
        return self._noise_variance(each) / _at_least(self._variance(each))

    def _noise_variance(self, maps: Array) -> Array:
        """Of the plate's own noise after maps, (..., 6, 6), in parts of the model's, (..., 6)."""
        return self.weight**2 * (maps**2 @ self._noise)

    def least_share(self, *, late: bool = False) -> float:
        """What the best of all maps leaves, crosstalk and all.

        Args:
            late: Whether derivatives of the channels may be mixed in, as a late plate needs.
        """
        from scipy.linalg import eigh

        residual, whole = self._residual.sum(axis=0), self._whole.sum(axis=0)
        used = np.arange(72).reshape(6, 12)[:, : 12 if late else 6].ravel()
        used = used[np.diagonal(whole)[used] > 0]
        residual, whole = residual[np.ix_(used, used)], whole[np.ix_(used, used)]
        size = np.sqrt(np.diagonal(whole))
        size = np.outer(size, size)
        scaled = whole / size + 1e-10 * np.eye(len(size))
        least = eigh(residual / size, scaled, eigvals_only=True, subset_by_index=[0, 0])
        return max(float(least[0]), 1e-12)


def _sigma(instants: Instants) -> Array:
    """Of what is left of the channels, in parts of forces or moments, (6,)."""
    variance = instants.wrench.var(axis=0)
    noise = [instants.wrench_noise[k].sum() / max(variance[k].sum(), 1e-30) for k in HALVES]
    if max(noise) < NOISY:
        return np.full(6, FREE)
    return np.repeat(np.sqrt(QUIET + LASTS * np.array(noise)), 3)


def _at_least(variance: Array) -> Array:
    """Variances of channels, (..., 6), each at least a part of its neighbours' mean."""
    mean = variance.reshape(*variance.shape[:-1], 2, 3).mean(axis=-1)
    return np.maximum(variance, np.maximum(SILENT * np.repeat(mean, 3, axis=-1), 1e-300))
