"""Gram matrices of a recording's regressor rows, part by part, for cross-validation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    NormalEquations,
)
from testbed.core.estimation.regression.passes import ColumnFunction
from testbed.core.estimation.regression.windows import DENSE_ROWS_PER_CUTOFF
from testbed.core.estimation.selection.folds import CrossProducts, Folds
from testbed.core.kernel.records import SignalWindow
from testbed.core.recordings.source import Source

PARTS = 8
"""Number of consecutive parts of a recording."""

GAP_DURATION = 0.3
"""Time between a held-out part and its training rows [s]: noise and filters correlate rows."""

MIN_SPEED_RATIO = 1.5
"""Smallest ratio of rms speeds of the faster to the slower half for a split by speed."""

ROUNDING_RATIO = 1e-13
"""Largest ratio of a constant column's squares about the mean to its squares about zero."""

MIN_EXCESS_ROWS = 8
"""Smallest number of rows beyond a channel's own unknowns for an estimate of its noise."""


@dataclass(frozen=True, eq=False)
class RowProducts:
    """Gram matrices of regressor columns, a constant and the measurement.

    Attributes:
        unknowns: Names of the p regressor columns, (p,).
        channels: Names of the C measured channels, (C,).
        products: Sums of the outer products of rows, (C, p + 2, p + 2); a row consists of the
            entries of the p columns, the constant 1 and the measurement at one time.
        has_offset: True if each channel has an unknown constant.
    """

    unknowns: tuple[str, ...]
    channels: tuple[str, ...]
    products: Array
    has_offset: bool

    @property
    def rows(self) -> Array:
        """Number of rows of each channel, without rows near reversals of a joint, (C,)."""
        return self.products[:, -2, -2]

    @property
    def has_enough_rows(self) -> NDArray[np.bool_]:
        """Mask of the channels with enough rows for an estimate of the noise, (C,).

        A channel has enough rows if their number exceeds the number of unknowns that no other
        channel excites by at least `MIN_EXCESS_ROWS` (8).
        """
        is_excited = np.einsum("cii->ci", self.products)[:, :-2] > 0
        own_unknowns = (is_excited & (is_excited.sum(axis=0) == 1)).sum(axis=1)
        return np.asarray(self.rows >= own_unknowns + MIN_EXCESS_ROWS)

    def equations(self, lead: Array, start: Array) -> NormalEquations:
        """Normal equations in combinations of columns for the residuals of given unknowns.

        If the channels have an unknown constant, their means are subtracted, and columns that are
        constant in a channel up to rounding become zero.

        Args:
            lead: Coefficients of the k combinations of columns, (p, k).
            start: Values of the unknowns whose prediction is subtracted, (p,).
        """
        coefficients = np.zeros((len(start) + 2, lead.shape[1] + 1))
        coefficients[:-2, :-1], coefficients[:-2, -1], coefficients[-1, -1] = (
            lead,
            -start,
            1.0,
        )
        gram = coefficients.T @ self.products @ coefficients
        if self.has_offset:
            sums = self.products[:, -2] @ coefficients
            squares = np.einsum("cii->ci", gram)
            gram = (
                gram
                - sums[:, :, None]
                * (sums / np.maximum(self.rows, 1.0)[:, None])[:, None]
            )
            varies = np.einsum("cii->ci", gram) > ROUNDING_RATIO * squares
            gram = np.where(varies[:, :, None] & varies[:, None], gram, 0.0)
        names = tuple(map(str, range(lead.shape[1])))
        normal, right = gram[:, :-1, :-1], gram[:, :-1, -1]
        square = np.maximum(gram[:, -1, -1], 0.0)
        return NormalEquations(names, self.channels, self.rows, normal, right, square)

    def mean_residuals(self, values: Array) -> Array:
        """Mean residual of each channel for given unknowns, (C,).

        The result is zero if the channels have no unknown constant.

        Args:
            values: Values of the unknowns, (p,).
        """
        rows = np.maximum(self.rows, 1.0)
        mean = (self.products[:, -2, -1] - self.products[:, -2, :-2] @ values) / rows
        return mean if self.has_offset else np.zeros(len(rows))

    def residual_squares(self, values: Array, constants: Array) -> Array:
        """Sum of squared residuals for given unknowns and constants, (C,).

        Args:
            values: Values of the unknowns, (p,).
            constants: Constants of the channels, (C,).
        """
        return np.maximum(
            _quadratic_forms(self.products, _residual_coefficients(values, constants)),
            0.0,
        )

    def rms_residual(self, values: Array, constants: Array | None = None) -> Array:
        """Rms residual of each channel for given unknowns, (C,).

        Args:
            values: Values of the unknowns, (p,).
            constants: Constants of the channels, (C,); None for the mean residual.
        """
        known = self.mean_residuals(values) if constants is None else constants
        return np.sqrt(
            self.residual_squares(values, known) / np.maximum(self.rows, 1.0)
        )


def _residual_coefficients(values: Array, constants: Array) -> Array:
    """Coefficients of columns, constant and measurement in the residuals, (C, p + 2)."""
    coefficients = np.ones((len(constants), len(values) + 2))
    coefficients[:, :-2], coefficients[:, -2] = -values, -constants
    return coefficients


def _quadratic_forms(products: Array, coefficients: Array) -> Array:
    """Quadratic form of each channel's Gram matrix, (C,).

    Args:
        products: Gram matrices, (C, p + 2, p + 2).
        coefficients: Coefficients, (C, p + 2).
    """
    return np.asarray(np.einsum("ci,cij,cj->c", coefficients, products, coefficients))


@dataclass(frozen=True, eq=False)
class RowParts:
    """Gram matrices of regressor and measurement for consecutive parts of a recording.

    Attributes:
        problem: Estimation problem of the recording.
        cross: Gram matrices of each part, and of all rows at least `GAP_DURATION` (0.3 s) away from
            the part.
        offset: True if each channel has an unknown constant.
        speed: Mean square speed of each joint in each part, (parts, n) [rad^2/s^2, m^2/s^2].
    """

    problem: Problem
    cross: CrossProducts
    offset: bool
    speed: Array

    @property
    def parts(self) -> list[RowProducts]:
        """Gram matrices of each part."""
        return self._row_products(self.cross.test)

    @property
    def total(self) -> RowProducts:
        """Sum of the Gram matrices of all parts."""
        return sum_row_products(self.parts)

    @cached_property
    def folds(self) -> list[tuple[RowProducts, RowProducts]]:
        """Training rows and held-out part of each fold of the cross-validation.

        The training rows belong to other parts and are at least `GAP_DURATION` (0.3 s) away from
        the held-out part.
        """
        return [*zip(self._row_products(self.cross.training), self.parts, strict=True)]

    def blocks(
        self, length: int
    ) -> Iterator[tuple[RowProducts, list[tuple[int, RowProducts]]]]:
        """Yield the training rows and the numbered held-out parts of each block.

        A block consists of consecutive parts; the training rows are those of all other parts. With
        a length of 1, the rows within 0.3 s of the held-out part are left out.

        Args:
            length: Number of parts that are held out together.
        """
        parts = [*enumerate(self.parts)]
        for first in range(0, len(parts), length):
            block = parts[first : first + length]
            training = [part for k, part in parts if not first <= k < first + length]
            yield (
                self.folds[first][0] if length == 1 else sum_row_products(training),
                block,
            )

    @property
    def splits(self) -> dict[str, list[tuple[RowProducts, list[RowProducts]]]]:
        """Pairs of training rows and held-out parts, keyed by kind of split.

        In the split "like", each part is predicted from all other parts. In the split "faster", the
        faster half of the parts is predicted from the slower half; this split exists if the rms
        speeds differ by a factor over `MIN_SPEED_RATIO` (1.5).
        """
        parts = self.parts
        splits = {"like": [(training, [part]) for training, part in self.folds]}
        mean_square = np.maximum(self.speed.mean(axis=0), SMALLEST_POSITIVE)
        relative_speed = (self.speed / mean_square).mean(axis=1)
        slow, fast = np.split(np.argsort(relative_speed, kind="stable"), 2)
        if (
            relative_speed[fast].mean()
            > MIN_SPEED_RATIO**2 * relative_speed[slow].mean()
        ):
            splits["faster"] = [
                (sum_row_products([parts[k] for k in slow]), [parts[k] for k in fast])
            ]
        return splits

    def _row_products(self, products: Array) -> list[RowProducts]:
        """Gram matrices of several parts as `RowProducts` of this problem.

        Args:
            products: Gram matrices, (parts, C, p + 2, p + 2).
        """
        names, channels = self.problem.names, self.problem.channels
        return [RowProducts(names, channels, each, self.offset) for each in products]


def sum_row_products(parts: Sequence[RowProducts]) -> RowProducts:
    """Sum of the Gram matrices of several parts.

    Args:
        parts: Gram matrices of the parts, at least one.
    """
    return replace(parts[0], products=np.sum([part.products for part in parts], axis=0))


def row_parts(
    problem: Problem,
    source: Source,
    offset: bool,
    whole: bool = False,
    per_cutoff: float = DENSE_ROWS_PER_CUTOFF,
) -> RowParts:
    """Gram matrices of regressor and measurement for the parts of a recording.

    Args:
        problem: Robot, recording and method.
        source: Recording, with instrument faults corrected.
        offset: True if each channel has an unknown constant.
        whole: True to include rows near reversals of a joint, unless the settings define
            `reversal_reach`.
        per_cutoff: Number of rows per second for each Hz of the low-pass cutoff of the rows.
    """
    width = len(problem.channels)
    passes = problem.passes(1, source, whole, per_cutoff)
    folds = Folds.equal_size(
        passes.plan.rows, PARTS, round(GAP_DURATION * source.rate / passes.plan.step)
    )
    speed, count = np.zeros((PARTS, problem.tree.n)), np.zeros((PARTS, 1))

    def blocks() -> Iterator[Array]:
        first = 0
        identity = np.eye(len(problem.names))
        for columns, speeds, measurement in passes.rows_with_columns(
            identity, _speed_columns(source.rate, width)
        ):
            constant = columns.any(
                axis=2, keepdims=True
            )  # rows near a reversal are zero
            yield np.concatenate([columns, constant, measurement[..., None]], axis=2)
            for fold, rows in folds.overlaps(first, speeds.shape[1]):
                speed[fold] += (speeds[0, rows] ** 2).sum(axis=0)
                count[fold] += len(speeds[0, rows])
            first += speeds.shape[1]

    cross = folds.products(blocks())
    return RowParts(problem, cross, offset, speed / np.maximum(count, 1))


def _speed_columns(rate: float, channels: int) -> ColumnFunction:
    """Function that computes the joint speeds at the rows by central differences, (C, rows, n).

    Args:
        rate: Sampling rate [1/s].
        channels: Number of channels C.
    """

    def speeds(signals: SignalWindow, row: int) -> Array:
        samples = signals.start + signals.step * np.arange(signals.row_count)
        q, last = signals.position, len(signals.position) - 1
        following, preceding = (
            np.clip(samples + signals.step, 0, last),
            np.clip(samples - signals.step, 0, last),
        )
        qd = (q[following] - q[preceding]) * rate / (2 * signals.step)
        return np.broadcast_to(qd, (channels, *qd.shape))

    return speeds
