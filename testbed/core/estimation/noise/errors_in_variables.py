"""Noise in the columns of the equations, from encoders and their counts, and the bias it makes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.estimation.noise.fits import NoiseFit
from testbed.core.estimation.noise.lagged_products import LaggedProducts
from testbed.core.estimation.regression.normal_equations import square_root
from testbed.core.estimation.regression.passes import Columns, motion_rows
from testbed.core.estimation.regression.windows import Plan
from testbed.core.kernel.numpy_engine import motion_of
from testbed.core.kernel.records import Signals

HELD = 1024
"""Samples after which zeros that change do so."""

COUNTS_SEED = 1948
"""Of the zeros: the same recording gives the same estimate."""


class Quantization:
    """Errors of encoders that show whole counts, at the rows of a window."""

    def __init__(self, plan: Plan, count: Array) -> None:
        """Ready for any window.

        Args:
            plan: The rows; they pass a low-pass.
            count: Least counts, (n,) [rad or m]; zero for encoders without such errors.
        """
        self._plan, self._coarse = plan, np.flatnonzero(count)
        self._joints, self._count = len(count), count[self._coarse]
        self._kernels = np.stack([np.convolve(taps, plan.weights) for taps in plan.taps])

    def changing(self, signals: Signals, first: int) -> Array:
        """Of positions, velocities and accelerations, from ever other zeros, (3, rows, n).

        Args:
            signals: The window's.
            first: Number of its first row.
        """
        smooth = self.smooth(signals)
        begin = first * self._plan.step
        blocks = np.arange(begin, begin + len(smooth)) // HELD
        samples = [
            self._drawn(COUNTS_SEED, int(block)) for block in range(blocks[0], blocks[-1] + 1)
        ]
        return self.error(smooth, np.array(samples)[blocks - blocks[0]])

    def lasting(self, signals: Signals, replicas: int) -> list[Array]:
        """From zeros that stay: what repeats in the motion repeats in them, (3, rows, n) each.

        Args:
            signals: The window's.
            replicas: How many zeros.
        """
        smooth = self.smooth(signals)
        return [self.error(smooth, self._drawn(COUNTS_SEED + 1, k)) for k in range(replicas)]

    def smooth(self, signals: Signals) -> Array:
        """Positions of coarse encoders around the rows, without counts, (samples, coarse)."""
        last = signals.start + (signals.number - 1) * signals.step
        half = self._kernels.shape[1] // 2
        shown = signals.position[signals.start - half : last + half + 1, self._coarse]
        around = len(signals.weights) // 2
        ends = np.pad(shown, ((around, around), (0, 0)), "reflect", reflect_type="odd")
        return np.stack([np.convolve(own, signals.weights, "valid") for own in ends.T], axis=1)

    def error(self, smooth: Array, zeros: Array) -> Array:
        """What counts from some zeros add, behind the filters, (3, rows, n).

        Args:
            smooth: Positions, (samples, coarse).
            zeros: In counts, (samples, coarse) or (coarse,).
        """
        counts = smooth / self._count + zeros
        off = (np.round(counts) - counts) * self._count
        around = np.lib.stride_tricks.sliding_window_view(off, self._kernels.shape[1], axis=0)
        found = around[:: self._plan.step] @ self._kernels.T
        every = np.zeros((3, len(found), self._joints))
        every[:, :, self._coarse] = np.moveaxis(found, 2, 0)
        return every

    def _drawn(self, *seed: int) -> Array:
        return np.random.default_rng(seed).uniform(size=len(self._count))


PER_ROW = 5
"""Samples of made noise from row to row, at least: slow noise, behind the filter on rows."""

ZEROS = 24
"""Replicas of errors of whole counts: the spread of what they do is found to 15 %."""

BLOCK = 1024
"""Samples of made noise that are drawn at once, from a seed of their own."""

SEED = 1997
"""Of the made noise: the same recording gives the same estimate."""


class Made(NamedTuple):
    """Columns that made noise gives.

    Attributes:
        columns: Makes those of a window; None for none.
        width: How many they are.
    """

    columns: Columns | None = None
    width: int = 0


@dataclass(frozen=True, eq=False)
class PositionNoise:
    """What is wrong with positions, beside what an instrument's faults do to them.

    Attributes:
        sigma: Standard deviations of white noise, (n,) [rad or m].
        count: Least counts of encoders that have counts instead, zero for others, (n,) [rad or m].
    """

    sigma: Array
    count: Array

    @property
    def least_counts(self) -> tuple[float, ...]:
        """Joint by joint; nothing where none has any."""
        return tuple(map(float, self.count)) if self.count.any() else ()

    def made(self, plan: Plan, combined: Array) -> Made:
        """What such noise does to combinations of the columns; nothing without noise.

        Args:
            plan: The rows.
            combined: How the unknowns' columns are combined, (p, q).
        """
        if not self.sigma.any():
            return Made()
        return Made(NoisyColumns(plan, self, combined), combined.shape[1])

    def again(self, plan: Plan, values: Array) -> Made:
        """What counts from other zeros do to an estimate's rows; nothing without counts.

        Args:
            plan: The rows.
            values: Of the unknowns, (p,).
        """
        if not self.count.any():
            return Made()
        return Made(QuantizationReplicas(plan, self.count, values), ZEROS)


class NoisyColumns:
    """Noise in columns of rows, window by window, the same for any order of them."""

    def __init__(self, plan: Plan, encoders: PositionNoise, combined: Array) -> None:
        """Ready for any window.

        Args:
            plan: The rows.
            encoders: Their noise.
            combined: How the unknowns' columns are combined, (p, q).
        """
        self._plan, self._sigma = plan, np.where(encoders.count > 0, 0.0, encoders.sigma)
        self._counts = Quantization(plan, encoders.count) if encoders.count.any() else None
        self._lead = plan.layout.basis @ combined
        divisors = [d for d in range(1, plan.step + 1) if plan.step % d == 0]
        stride = max([d for d in divisors if d * PER_ROW <= plan.step], default=1)
        kernels = np.stack([np.convolve(taps, plan.weights) for taps in plan.taps])
        middle = kernels.shape[1] // 2
        self._per_row = plan.step // stride
        self._kernels = kernels[:, middle % stride :: stride].T * np.sqrt(stride)

    def __call__(self, signals: Signals, first: int) -> Array:
        """Of a window's rows, (C, rows, q).

        Args:
            signals: The window's.
            first: Number of its first row.
        """
        noise = self.coordinates(first, signals.number)
        if self._counts:
            noise = noise + self._counts.changing(signals, first)
        return changed(self._plan, at_rows(signals), noise, self._lead)

    def coordinates(self, first: int, count: int) -> Array:
        """Made noise of positions, velocities and accelerations, filtered, (3, rows, n).

        Args:
            first: Number of the first row.
            count: How many rows.
        """
        begin = first * self._per_row
        end = (first + count - 1) * self._per_row + len(self._kernels)
        white = np.concatenate(
            [
                np.random.default_rng([SEED, block]).normal(size=(BLOCK, len(self._sigma)))
                for block in range(begin // BLOCK, -(-end // BLOCK))
            ]
        )[begin % BLOCK :][: end - begin]
        around = np.lib.stride_tricks.sliding_window_view(white, len(self._kernels), axis=0)
        made = around[:: self._per_row] @ self._kernels
        return np.asarray(np.moveaxis(made, 2, 0) * self._sigma)


class QuantizationReplicas:
    """What counts from other zeros do to the rows of an estimate, window by window."""

    def __init__(self, plan: Plan, count: Array, values: Array) -> None:
        """Ready for any window.

        Args:
            plan: The rows.
            count: Least counts, zero for encoders without, (n,) [rad or m].
            values: Of the unknowns, (p,).
        """
        self._plan, self._counts = plan, Quantization(plan, count)
        self._lead = plan.layout.basis @ values[:, None]

    def __call__(self, signals: Signals, first: int) -> Array:
        """Of a window's rows, replica by replica, (C, rows, ZEROS)."""
        del first
        motion = at_rows(signals)
        each = self._counts.lasting(signals, ZEROS)
        return np.concatenate([changed(self._plan, motion, e, self._lead) for e in each], axis=2)


def at_rows(signals: Signals) -> Array:
    """Measured positions, velocities and accelerations at the rows, (3, rows, n)."""
    motion = motion_of(signals, signals.start, signals.number, signals.step)
    return np.stack([motion.q, motion.qd, motion.qdd])


def changed(plan: Plan, motion: Array, noise: Array, lead: Array) -> Array:
    """By how much noise changes combinations of the columns, to second order, (C, rows, q).

    Args:
        plan: The rows.
        motion: Positions, velocities, accelerations, (3, rows, n).
        noise: Of these, (3, rows, n).
        lead: How the columns are combined, (P, q).
    """
    moved = np.concatenate([motion + noise, motion - noise], axis=1)
    more, less = np.split(motion_rows(plan, *moved), 2, axis=1)
    return plan.layout.combined((more - less) / 2, lead)


MOST = 0.5
"""Part of the square of a combination of columns that may be noise: more is not taken back."""

NAMED = 0.25
"""Part of what identifies a parameter that may be noise: corrected, how well is not in sigma."""

ALL = 0.999
"""Part of what identifies an unknown that noise is at most: all of it would leave no sigma."""


@dataclass(frozen=True, eq=False)
class AttenuationCorrection:
    """Unknowns as they were without noise in the columns.

    Attributes:
        fit: Values and covariance.
        directions: Combinations of the unknowns, of normal matrix one before, (m, m).
        share: Part of the square of each one's column that is noise, (m,).
    """

    fit: NoiseFit
    directions: Array
    share: Array

    def noise_limited(self, basis: Array) -> NDArray[np.bool_]:
        """Parameters that columns identify of which more than `NAMED` is noise, (p,).

        Args:
            basis: Parameters from the unknowns, (p, m).
        """
        parts = (basis @ self.directions) ** 2
        rest = 1 - np.clip(self.share, 0.0, ALL)
        return np.asarray(parts.sum(axis=1) < (1 - NAMED) * (parts / rest).sum(axis=1))


def correct_attenuation(fit: NoiseFit, noise: LaggedProducts) -> AttenuationCorrection:
    """Take noise in the columns back.

    Args:
        fit: With noise in its columns.
        noise: Products of noise in the same unknowns' columns, of what it leaves in the
            residuals, and of ones, as the rows' own.
    """
    m = len(fit.values)
    white, root = fit.normal(noise), square_root(fit.inverse)
    share, axes = eigh(root.T @ white[:m, :m] @ root)
    directions, kept = root @ axes, np.clip(share, 0.0, MOST)
    taken = white[:m, :m] @ fit.values - white[:m, m]
    taken = directions.T @ taken * np.where(share > MOST, MOST / np.maximum(share, MOST), 1.0)
    spread = directions / (1 - kept)
    back = spread @ np.linalg.inv(directions)
    better = replace(
        fit,
        values=fit.values + spread @ taken,
        covariance=back @ fit.covariance @ back.T,
        inverse=spread @ directions.T,
    )
    return AttenuationCorrection(better, directions, share)
