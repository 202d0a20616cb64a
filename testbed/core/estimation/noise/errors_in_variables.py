"""Noise in the columns of the equations, from encoders and their counts, and the bias it makes."""

from __future__ import annotations

from dataclasses import dataclass, replace

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

COUNTS_SEED = 1948
"""Of the zeros: the same recording gives the same estimate."""

BLOCK = 1024
"""Samples of made noise that are drawn at once, from a seed of their own."""


class PositionNoise:
    """Noise and whole counts of encoders at a plan's rows, the same for any order of windows."""

    def __init__(self, plan: Plan, sigma: Array, count: Array) -> None:
        """Ready for any window.

        Args:
            plan: The rows.
            sigma: Standard deviations of white noise, (n,) [rad or m].
            count: Least counts of encoders that have counts instead, zero for others, (n,)
                [rad or m].
        """
        self._plan, self._sigma, self._count = plan, sigma, count
        self._coarse = np.flatnonzero(count)
        self._kernels = np.stack(
            [np.convolve(taps, plan.weights) for taps in plan.taps]
        )

    @property
    def least_counts(self) -> tuple[float, ...]:
        """Joint by joint; nothing where none has any."""
        return tuple(self._count.tolist()) if len(self._coarse) else ()

    def noisy_columns(self, combined: Array) -> Columns | None:
        """Effect of noise on combinations of the columns; nothing without noise.

        Args:
            combined: How the unknowns' columns are combined, (p, q).
        """
        basis = self._plan.layout.basis @ combined

        def columns(signals: Signals, first: int) -> Array:
            noise = self.white(first, signals.number)
            if len(self._coarse):
                smooth, begin = self._smooth(signals), first * self._plan.step
                # samples after which zeros of encoders that change do so
                blocks = np.arange(begin, begin + len(smooth)) // 1024
                zeros = [
                    self._zeros(COUNTS_SEED, k)
                    for k in range(blocks[0], blocks[-1] + 1)
                ]
                noise = noise + self._rounded(
                    smooth, np.array(zeros)[blocks - blocks[0]]
                )
            return changed(self._plan, at_rows(signals), noise, basis)

        return columns if self._sigma.any() else None

    def replicas(self, values: Array) -> Columns | None:
        """Effect of counts from other zeros on an estimate's rows; nothing without counts.

        Zeros stay: what repeats in the motion repeats in the errors.

        Args:
            values: Of the unknowns, (p,).
        """
        basis = self._plan.layout.basis @ values[:, None]

        def columns(signals: Signals, first: int) -> Array:
            del first
            motion, smooth = at_rows(signals), self._smooth(signals)
            # replicas of errors of whole counts: the spread of what they do is found to 15 %
            zeros = (self._zeros(COUNTS_SEED + 1, k) for k in range(24))
            each = (self._rounded(smooth, zero) for zero in zeros)
            return np.concatenate(
                [changed(self._plan, motion, error, basis) for error in each], axis=2
            )

        return columns if len(self._coarse) else None

    def white(self, first: int, count: int) -> Array:
        """Made noise of positions, velocities and accelerations, filtered, (3, rows, n).

        Args:
            first: Number of the first row.
            count: How many rows.
        """
        step, middle = self._plan.step, self._kernels.shape[1] // 2
        # samples of made noise from row to row, at least: slow noise, behind the filter on rows
        strides = range(1, step // 5 + 1)
        stride = max((d for d in strides if step % d == 0), default=1)
        kernels = self._kernels[:, middle % stride :: stride].T * np.sqrt(stride)
        begin, end = (
            first * step // stride,
            (first + count - 1) * step // stride + len(kernels),
        )
        # of the made noise: the same recording gives the same estimate
        white = np.concatenate(
            [
                np.random.default_rng([1997, block]).normal(
                    size=(BLOCK, len(self._sigma))
                )
                for block in range(begin // BLOCK, -(-end // BLOCK))
            ]
        )[begin % BLOCK :][: end - begin]
        around = np.lib.stride_tricks.sliding_window_view(white, len(kernels), axis=0)
        made = around[:: step // stride] @ kernels
        return np.asarray(
            np.moveaxis(made, 2, 0) * np.where(self._count > 0, 0.0, self._sigma)
        )

    def _smooth(self, signals: Signals) -> Array:
        """Positions of coarse encoders around the rows, without counts, (samples, coarse)."""
        last = signals.start + (signals.number - 1) * signals.step
        half, around = self._kernels.shape[1] // 2, len(signals.weights) // 2
        shown = signals.position[signals.start - half : last + half + 1, self._coarse]
        ends = np.pad(shown, ((around, around), (0, 0)), "reflect", reflect_type="odd")
        return np.stack(
            [np.convolve(own, signals.weights, "valid") for own in ends.T], axis=1
        )

    def _rounded(self, smooth: Array, zeros: Array) -> Array:
        """Errors of whole counts, behind the filters, (3, rows, n).

        Args:
            smooth: Positions, (samples, coarse).
            zeros: In counts, (samples, coarse) or (coarse,).
        """
        size = self._count[self._coarse]
        counts = smooth / size + zeros
        off = (np.round(counts) - counts) * size
        around = np.lib.stride_tricks.sliding_window_view(
            off, self._kernels.shape[1], axis=0
        )
        part = around[:: self._plan.step] @ self._kernels.T
        every = np.zeros((3, len(part), len(self._count)))
        every[:, :, self._coarse] = np.moveaxis(part, 2, 0)
        return every

    def _zeros(self, *seed: int) -> Array:
        return np.random.default_rng(seed).uniform(size=len(self._coarse))


def at_rows(signals: Signals) -> Array:
    """Measured positions, velocities and accelerations at the rows, (3, rows, n)."""
    motion = motion_of(signals, signals.start, signals.number, signals.step)
    return np.stack([motion.q, motion.qd, motion.qdd])


def changed(plan: Plan, motion: Array, noise: Array, basis: Array) -> Array:
    """By how much noise changes combinations of the columns, to second order, (C, rows, q).

    Args:
        plan: The rows.
        motion: Positions, velocities, accelerations, (3, rows, n).
        noise: Of these, (3, rows, n).
        basis: How the columns are combined, (P, q).
    """
    moved = np.concatenate([motion + noise, motion - noise], axis=1)
    more, less = np.split(motion_rows(plan, *moved), 2, axis=1)
    return plan.layout.combined((more - less) / 2, basis)


MOST = 0.5
"""Part of the square of a combination of columns that may be noise: more is not taken back."""

NAMED = 0.25
"""Part of what identifies a parameter that may be noise: corrected, how well is not in sigma."""


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
        # part of what identifies an unknown that noise is at most: all of it would leave no sigma
        rest = 1 - np.clip(self.share, 0.0, 0.999)
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
    taken = (
        directions.T
        @ taken
        * np.where(share > MOST, MOST / np.maximum(share, MOST), 1.0)
    )
    spread = directions / (1 - kept)
    back = spread @ np.linalg.inv(directions)
    better = replace(
        fit,
        values=fit.values + spread @ taken,
        covariance=back @ fit.covariance @ back.T,
        inverse=spread @ directions.T,
    )
    return AttenuationCorrection(better, directions, share)
