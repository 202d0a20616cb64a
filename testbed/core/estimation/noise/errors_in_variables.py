"""Errors in variables: encoder noise in the regressor columns, and its attenuation bias."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.estimation.noise.fits import NoiseFit
from testbed.core.estimation.noise.lagged_products import LaggedProducts
from testbed.core.estimation.regression.normal_equations import matrix_square_root
from testbed.core.estimation.regression.passes import ColumnFunction, motion_rows
from testbed.core.estimation.regression.windows import Plan
from testbed.core.kernel.numpy_engine import window_motion
from testbed.core.kernel.records import SignalWindow

COUNTS_SEED = 1948
"""Seed of the encoder zeros: the same recording gives the same estimate."""

NOISE_BLOCK = 1024
"""Samples of simulated noise that are drawn at once, each block from its own seed."""


class PositionNoise:
    """Simulated encoder noise and quantisation at the rows of a plan.

    The noise of a row does not depend on the order in which windows are processed.
    """

    def __init__(self, plan: Plan, sigma: Array, count: Array) -> None:
        """Compute the kernels from position samples to rows.

        Args:
            plan: Plan of the rows.
            sigma: Standard deviations of white noise, (n,) [rad or m].
            count: Least counts of quantised encoders, zero for others, (n,) [rad or m].
        """
        self._plan, self._sigma, self._count = plan, sigma, count
        self._coarse = np.flatnonzero(count)
        self._kernels = np.stack(
            [np.convolve(taps, plan.weights) for taps in plan.motion_kernels]
        )

    @property
    def least_counts(self) -> tuple[float, ...]:
        """Least count of each joint's encoder; empty if no encoder is quantised."""
        return tuple(self._count.tolist()) if len(self._coarse) else ()

    def noisy_columns(self, combinations: Array) -> ColumnFunction | None:
        """Function that simulates encoder noise in combinations of columns; None without noise.

        The function returns the change of the columns, (C, rows, q), due to white noise or, for
        quantised encoders, due to rounding with encoder zeros that are redrawn every 1024 samples.

        Args:
            combinations: Combinations of the unknowns' columns, (p, q).
        """
        basis = self._plan.layout.basis @ combinations

        def columns(signals: SignalWindow, first: int) -> Array:
            noise = self.white_noise(first, signals.row_count)
            if len(self._coarse):
                smooth, begin = self._smooth_positions(signals), first * self._plan.step
                # samples after which the encoder zeros change
                blocks = np.arange(begin, begin + len(smooth)) // 1024
                zeros = [
                    self._random_zeros(COUNTS_SEED, k)
                    for k in range(blocks[0], blocks[-1] + 1)
                ]
                noise = noise + self._rounding_errors(
                    smooth, np.array(zeros)[blocks - blocks[0]]
                )
            return column_changes(self._plan, motion_at_rows(signals), noise, basis)

        return columns if self._sigma.any() else None

    def replicas(self, values: Array) -> ColumnFunction | None:
        """Function that predicts row errors due to quantisation; None without quantised encoders.

        The function rounds the positions anew and returns one column for each of 24 replicas,
        (C, rows, 24). Each replica has  its own constant encoder zeros, so that errors repeat with
        the motion.

        Args:
            values: Unknowns, (p,).
        """
        basis = self._plan.layout.basis @ values[:, None]

        def columns(signals: SignalWindow, first: int) -> Array:
            del first
            motion, smooth = motion_at_rows(signals), self._smooth_positions(signals)
            # 24 replicas: the variance of their effect is accurate to 15 %
            zeros = (self._random_zeros(COUNTS_SEED + 1, k) for k in range(24))
            each = (self._rounding_errors(smooth, zero) for zero in zeros)
            return np.concatenate(
                [column_changes(self._plan, motion, error, basis) for error in each],
                axis=2,
            )

        return columns if len(self._coarse) else None

    def white_noise(self, first: int, count: int) -> Array:
        """Filtered white noise of position, velocity and acceleration, (3, rows, n).

        Its standard deviations are those of the encoders, zero for quantised encoders. Samples are
        drawn in blocks with fixed seeds, and simulated at a reduced rate where rows are far apart.

        Args:
            first: Index of the first row.
            count: Number of rows.
        """
        step, middle = self._plan.step, self._kernels.shape[1] // 2
        # at least five samples of simulated noise from row to row, before the filter on rows
        strides = range(1, step // 5 + 1)
        stride = max((d for d in strides if step % d == 0), default=1)
        kernels = self._kernels[:, middle % stride :: stride].T * np.sqrt(stride)
        begin, end = (
            first * step // stride,
            (first + count - 1) * step // stride + len(kernels),
        )
        # fixed seed: the same recording gives the same estimate
        white = np.concatenate(
            [
                np.random.default_rng([1997, block]).normal(
                    size=(NOISE_BLOCK, len(self._sigma))
                )
                for block in range(begin // NOISE_BLOCK, -(-end // NOISE_BLOCK))
            ]
        )[begin % NOISE_BLOCK :][: end - begin]
        around = np.lib.stride_tricks.sliding_window_view(white, len(kernels), axis=0)
        simulated = around[:: step // stride] @ kernels
        return np.asarray(
            np.moveaxis(simulated, 2, 0) * np.where(self._count > 0, 0.0, self._sigma)
        )

    def _smooth_positions(self, signals: SignalWindow) -> Array:
        """Low-passed positions of quantised encoders around the rows, (samples, coarse) [rad or m].

        `coarse` is the number of quantised encoders. The low-pass is the plan's filter on rows,
        with odd reflection at the ends; the samples extend half a kernel beyond the first and the
        last row.

        Args:
            signals: Signals of the window.
        """
        last = signals.start + (signals.row_count - 1) * signals.step
        half, around = self._kernels.shape[1] // 2, len(signals.weights) // 2
        positions = signals.position[
            signals.start - half : last + half + 1, self._coarse
        ]
        ends = np.pad(
            positions, ((around, around), (0, 0)), "reflect", reflect_type="odd"
        )
        return np.stack(
            [np.convolve(own, signals.weights, "valid") for own in ends.T], axis=1
        )

    def _rounding_errors(self, smooth: Array, zeros: Array) -> Array:
        """Filtered rounding errors of position, velocity and acceleration, (3, rows, n).

        They are zero for encoders without quantisation.

        Args:
            smooth: Positions before rounding, (samples, coarse) [rad or m].
            zeros: Encoder zeros in counts, (samples, coarse) or (coarse,).
        """
        size = self._count[self._coarse]
        counts = smooth / size + zeros
        errors = (np.round(counts) - counts) * size
        around = np.lib.stride_tricks.sliding_window_view(
            errors, self._kernels.shape[1], axis=0
        )
        part = around[:: self._plan.step] @ self._kernels.T
        all_joints = np.zeros((3, len(part), len(self._count)))
        all_joints[:, :, self._coarse] = np.moveaxis(part, 2, 0)
        return all_joints

    def _random_zeros(self, *seed: int) -> Array:
        """Random zeros of the quantised encoders, in counts, (coarse,)."""
        return np.random.default_rng(seed).uniform(size=len(self._coarse))


def motion_at_rows(signals: SignalWindow) -> Array:
    """Measured positions, velocities and accelerations at the rows, (3, rows, n)."""
    motion = window_motion(signals, signals.start, signals.row_count, signals.step)
    return np.stack([motion.q, motion.qd, motion.qdd])


def column_changes(plan: Plan, motion: Array, noise: Array, basis: Array) -> Array:
    """Change of combined columns due to noise in the motion, to second order, (C, rows, q).

    It is half the difference of the columns with the noise added and subtracted.

    Args:
        plan: Plan of the rows.
        motion: Positions, velocities, accelerations, (3, rows, n).
        noise: Noise of the motion, (3, rows, n).
        basis: Combinations of the P regressor columns, (P, q).
    """
    disturbed = np.concatenate([motion + noise, motion - noise], axis=1)
    above, below = np.split(motion_rows(plan, *disturbed), 2, axis=1)
    return plan.layout.combine_columns((above - below) / 2, basis)


MAX_NOISE_SHARE = 0.5
"""Largest part of a column's square, in a combination, that is subtracted as noise."""

REPORTED_NOISE_SHARE = 0.25
"""Part of a parameter's information that is noise, above which the parameter is reported: sigma
does not count the error of its correction."""


@dataclass(frozen=True, eq=False)
class AttenuationCorrection:
    """Fit corrected for the attenuation by noise in the columns.

    Attributes:
        fit: Corrected values and covariance.
        directions: Combinations of the unknowns with unit normal matrix before the correction, (m,
            m).
        share: Noise fraction of each combination's squared column, (m,).
    """

    fit: NoiseFit
    directions: Array
    share: Array

    def noise_limited(self, basis: Array) -> NDArray[np.bool_]:
        """Mask of parameters whose information contains more noise than REPORTED_NOISE_SHARE, (p,).

        The information is the inverse variance. Its noise is the relative decrease when the
        expected noise is subtracted from the normal matrix.

        Args:
            basis: Map from the unknowns to the parameters, (p, m).
        """
        parts = (basis @ self.directions) ** 2
        # upper limit of the noise's share, which keeps sigma finite
        signal_share = 1 - np.clip(self.share, 0.0, 0.999)
        return np.asarray(
            parts.sum(axis=1)
            < (1 - REPORTED_NOISE_SHARE) * (parts / signal_share).sum(axis=1)
        )


def correct_attenuation(fit: NoiseFit, noise: LaggedProducts) -> AttenuationCorrection:
    """Correct a fit for the attenuation by noise in its columns.

    The expected noise, at most MAX_NOISE_SHARE of each direction, is subtracted from the normal
    matrix along its generalised eigenvectors.

    Args:
        fit: Fit with noise in its columns.
        noise: Lagged products of the noise in the columns and residuals, and of row indicators.
    """
    m = len(fit.values)
    white, root = fit.normal(noise), matrix_square_root(fit.inverse)
    share, axes = eigh(root.T @ white[:m, :m] @ root)
    directions, subtracted = root @ axes, np.clip(share, 0.0, MAX_NOISE_SHARE)
    bias = white[:m, :m] @ fit.values - white[:m, m]
    bias = (
        directions.T
        @ bias
        * np.where(
            share > MAX_NOISE_SHARE,
            MAX_NOISE_SHARE / np.maximum(share, MAX_NOISE_SHARE),
            1.0,
        )
    )
    spread = directions / (1 - subtracted)
    correction = spread @ np.linalg.inv(directions)
    corrected = replace(
        fit,
        values=fit.values + spread @ bias,
        covariance=correction @ fit.covariance @ correction.T,
        inverse=spread @ directions.T,
    )
    return AttenuationCorrection(corrected, directions, share)
