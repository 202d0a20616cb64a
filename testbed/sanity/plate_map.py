"""What a plate's channels can be: one linear map of what was recorded, judged by algebra.

For the right mapping the six channels w, in the bedplate's frame, are linear in ONE set of inertial
parameters: A w + b = Y(q, q', q'') delta_r at all instants. Units, senses, orders of columns, the
frame's turn and place, and what an unloaded plate shows are all in A (6x6) and b, and the equation
is linear in both. So the rows Y, and constants, are projected out once for positions as they are
taken; with the products H of what is left, every A leaves vec(A)' H vec(A). A frame that lies
elsewhere by r (moments gain r x F), one that is turned a little more, and a wrench that is a little
late (A dw/dt) are linear as well: they are fitted beside each A, not searched.

What the least generalized eigenvector of H against the signal's own products G leaves, no mapping
of a plate can mend.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import permutations, product

import numpy as np

from testbed.arrays import Array, skew
from testbed.sanity.instants import Instants, directions

SILENT = 0.02
"""Part of the mean variance of forces, or of moments, that a channel counts with at least."""

LATEST = 0.08
"""Delays beyond this are not small [s]."""

SHIFT, LATE, TURN, RATIO = (0, 1, 2), 3, (4, 5, 6), 7
"""Places of what may be fitted beside a map: [m], [s], [rad], moments over forces."""

EXTRAS = 8


@cache
def quarter_turns() -> tuple[Array, ...]:
    """The 24 turns that take axes to axes, (3, 3), the identity first."""
    found = []
    for places, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        turn = np.zeros((3, 3))
        turn[range(3), places] = signs
        if np.linalg.det(turn) > 0:
            found.append(turn)
    return tuple(sorted(found, key=lambda turn: -float(np.trace(turn))))


def both(turn: Array) -> Array:
    """A turn of forces and of moments, (6, 6).

    Args:
        turn: (3, 3).
    """
    found: Array = np.zeros((6, 6))
    found[:3, :3] = found[3:, 3:] = turn
    return found


def placed(turn: Array, place: Array) -> Array:
    """The wrench in the bedplate's frame of one in a sensor's, (6, 6).

    Args:
        turn: Of the sensor's frame, (3, 3).
        place: Of its origin, (3,) [m].
    """
    found = both(turn)
    found[3:, :3] = skew(place) @ turn
    return found


def _slopes() -> Array:
    """How a map changes with what is fitted beside it, but for lateness, (8, 6, 6)."""
    found = np.zeros((EXTRAS, 6, 6))
    for axis, unit in enumerate(np.eye(3)):
        found[SHIFT[axis], 3:, :3] = skew(unit)
        found[TURN[axis]] = both(skew(unit))
    found[RATIO, 3:, 3:] = np.eye(3)
    return found


SLOPES = _slopes()


@dataclass(frozen=True, eq=False)
class Judged:
    """What M maps leave.

    Attributes:
        left: Part of each channel's variance that no parameters explain, (M, 6).
        extras: What was fitted beside the maps, zero for the others, (M, 8).
        sigma: Of them, if what is left is white, (M, 8).
        size: Times what the model file's masses make, by the variance; negative for the other
            sense, (M,).
    """

    left: Array
    extras: Array
    sigma: Array
    size: Array


class PlateRows:
    """Products of the plate's channels that are left when the rows are projected out."""

    def __init__(self, rows: Array, foretold: Array, taken: Instants) -> None:
        """The products.

        Args:
            rows: On the parameters that the base's wrench tells, (T, 6, N).
            foretold: The wrench by the model file's masses, (T, 6) [N, N m].
            taken: With a wrench.
        """
        assert taken.wrench is not None
        assert taken.wrench_rate is not None
        varied = foretold - foretold.mean(axis=0)
        size = np.sqrt([(varied[:, part] ** 2).mean() for part in (slice(0, 3), slice(3, 6))])
        weight = np.repeat(1 / np.where(size > 0, size, 1.0), 3)
        channels = np.hstack([taken.wrench, taken.wrench_rate])  # (T, 12)
        count = len(channels)
        fixed = np.broadcast_to(np.eye(6), (count, 6, 6))
        columns = np.concatenate([rows * weight[:, None], fixed], axis=2).reshape(6 * count, -1)
        basis = directions(columns).reshape(count, 6, -1)
        weighted = np.einsum("tcr,tk->rck", basis * weight[:, None], channels, optimize=True)
        known = weighted.reshape(basis.shape[2], 72)
        self._left, self._whole = np.zeros((6, 72, 72)), np.zeros((6, 72, 72))
        centred = channels - channels.mean(axis=0)
        for channel in range(6):
            own = slice(12 * channel, 12 * channel + 12)
            left = -basis[:, channel] @ known
            left[:, own] += weight[channel] * channels
            self._left[channel] = left.T @ left
            self._whole[channel][own, own] = weight[channel] ** 2 * centred.T @ centred
        self.foretold = varied * weight
        self._model = np.einsum("tc,tk,c->ck", self.foretold, centred, weight).ravel()
        self._model_size = float((self.foretold**2).sum())
        self.weight, self._count = weight, count
        noise = taken.noise[-6:]
        self._noise = np.where(np.isfinite(noise), noise, 0.0) * count

    def judge(self, maps: Sequence[Array], free: Sequence[int] = (*SHIFT, LATE)) -> Judged:
        """What each map leaves, with what is free fitted beside it.

        Args:
            maps: From what was recorded to the bedplate's wrench, (6, 6) each.
            free: Places of what may be fitted.
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
        whole = np.einsum("mx,cxy,my->mc", flat[:, 0], self._whole, flat[:, 0], optimize=True)
        least = SILENT * np.repeat(whole.reshape(count, 2, 3).mean(axis=2), 3, axis=1)
        whole = np.maximum(whole, np.maximum(least, 1e-300))
        left = np.stack(
            [
                (flat.reshape(-1, 72) @ each).reshape(flat.shape) @ flat.transpose(0, 2, 1)
                for each in self._left
            ],
            axis=1,
        )  # (M, 6, 1 + k, 1 + k)
        total = (left / whole[:, :, None, None]).sum(axis=1)
        size = np.sqrt(np.einsum("maa->ma", total)[:, 1:]) + 1e-300
        normal = total[:, 1:, 1:] / size[:, :, None] / size[:, None, :] + 1e-9 * np.eye(len(free))
        best = -np.linalg.solve(normal, (total[:, 1:, 0] / size)[..., None])[..., 0] / size
        spread = np.sqrt(np.einsum("maa->ma", np.linalg.inv(normal))) / size
        if LATE in free:
            late = best[:, free.index(LATE)]
            late[np.abs(late) > LATEST] = 0.0
        all_terms = np.hstack([np.ones((count, 1)), best])
        found = np.einsum("ma,mcab,mb->mc", all_terms, left, all_terms, optimize=True) / whole
        along = np.einsum("ma,max->mx", all_terms, flat) @ self._model / self._model_size
        extras, sigma = np.zeros((count, EXTRAS)), np.zeros((count, EXTRAS))
        extras[:, free] = best
        sigma[:, free] = spread * np.sqrt(found.sum(axis=1, keepdims=True) / (6 * self._count))
        return Judged(np.maximum(found, 0.0), extras, sigma, along)

    def gain_ratio(self, each: Array) -> float:
        """Times that moments must grow to be as large beside the forces as the model file's.

        Args:
            each: The map, (6, 6).
        """
        varied = self._variance(each).reshape(2, 3).sum(axis=1)
        return float(np.sqrt(varied[0] / varied[1])) if varied.min() > 0 else 1.0

    def _variance(self, each: Array) -> Array:
        """Of each channel after a map, in parts of the model's, (6,)."""
        flat = np.zeros((6, 12))
        flat[:, :6] = each
        found: Array = np.einsum("x,cxy,y->c", flat.ravel(), self._whole, flat.ravel())
        return found

    def noise_share(self, each: Array) -> Array:
        """Part of each channel's variance that is the plate's own noise after a map, (6,).

        Args:
            each: The map, (6, 6).
        """
        whole = self._variance(each)
        least = SILENT * np.repeat(whole.reshape(2, 3).mean(axis=1), 3)
        noise = self.weight**2 * (each**2 @ self._noise)
        share: Array = noise / np.maximum(whole, np.maximum(least, 1e-300))
        return share

    def least_share(self, *, late: bool = False) -> float:
        """What the best of all maps leaves, crosstalk and all.

        Args:
            late: Whether derivatives of the channels may be mixed in, as a late plate needs.
        """
        from scipy.linalg import eigh

        left, whole = self._left.sum(axis=0), self._whole.sum(axis=0)
        used = np.arange(72).reshape(6, 12)[:, : 12 if late else 6].ravel()
        used = used[np.diagonal(whole)[used] > 0]
        left, whole = left[np.ix_(used, used)], whole[np.ix_(used, used)]
        size = np.sqrt(np.diagonal(whole))
        scaled = whole / np.outer(size, size) + 1e-10 * np.eye(len(size))
        found = eigh(left / np.outer(size, size), scaled, eigvals_only=True, subset_by_index=[0, 0])
        return max(float(found[0]), 1e-12)
