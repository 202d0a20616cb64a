"""Cross-validation over products of rows: consecutive folds, each predicted from the others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.regression.normal_equations import solve_scaled
from testbed.core.kernel.records import Ints

MIN_INDEPENDENT_SHARE = 1e-10
"""Smallest share of a column's square that is independent of the other columns; below it the column
is a linear combination of these."""


@dataclass(frozen=True, eq=False)
class Folds:
    """Folds of consecutive rows for cross-validation.

    Attributes:
        ends: Index of each fold's first row, then the index after the last row, (folds + 1,).
        reach: Number of rows on either side of a fold that share samples with it and are left out
            of its training rows.
    """

    ends: Ints
    reach: int = 0

    @classmethod
    def equal_size(cls, rows: int, count: int, reach: int = 0) -> Folds:
        """Folds of equal size, except for rounding.

        Args:
            rows: Number of rows.
            count: Number of folds.
            reach: Number of rows on either side of a fold that share samples with it.
        """
        return cls(np.linspace(0, rows, count + 1).round().astype(int), reach)

    def overlaps(
        self, first: int, rows: int, reach: int = 0
    ) -> Iterator[tuple[int, slice]]:
        """Yield indices of folds that overlap a block of rows, with slices of the block.

        Args:
            first: Index of the block's first row.
            rows: Number of rows of the block.
            reach: Number of rows on either side of each fold that are also included.
        """
        low = np.clip(self.ends[:-1] - reach - first, 0, rows).tolist()
        high = np.clip(self.ends[1:] + reach - first, 0, rows).tolist()
        for fold, span in enumerate(map(slice, low, high)):
            if span.start < span.stop:
                yield fold, span

    def products(self, blocks: Iterable[Array]) -> CrossProducts:
        """Products of the columns of each fold's test rows and training rows.

        Training rows are all rows except those of the fold and `reach` rows on either side.

        Args:
            blocks: Blocks of consecutive rows: values of m columns in k rows of C channels, (C, k,
                m); the last column is the measurement.
        """
        sums: dict[tuple[int, int], Any] = defaultdict(float)
        first, shape = 0, (0, 0, 0)
        for block in blocks:
            for reach in {0, self.reach}:
                for fold, span in self.overlaps(first, block.shape[1], reach):
                    rows = block[:, span]
                    sums[reach, fold] += rows.swapaxes(1, 2) @ rows
            shape = len(block), block.shape[2], block.shape[2]
            first += block.shape[1]
        test, excluded = (
            np.array(
                [
                    sums[reach, fold] + np.zeros(shape)
                    for fold in range(len(self.ends) - 1)
                ]
            )
            for reach in (0, self.reach)
        )
        return CrossProducts(test, test.sum(axis=0) - excluded)


@dataclass(frozen=True, eq=False)
class CrossProducts:
    """Products of columns for each fold and channel; the last column is the measurement.

    There are C channels and m columns, including the measurement.

    Attributes:
        test: Products of each fold's test rows, (folds, C, m, m).
        training: Products of each fold's training rows, (folds, C, m, m).
    """

    test: Array
    training: Array

    def weighted_sums(self, weights: Array) -> CrossValidation:
        """Weighted sums of the products over the channels.

        Args:
            weights: Weights of the channels, (C,).
        """
        return CrossValidation(
            np.einsum("c,kcij->kij", weights, self.test),
            np.einsum("c,kcij->kij", weights, self.training),
        )

    def residual_squares(
        self, validation: CrossValidation, columns: Sequence[int]
    ) -> Array:
        """Sum of squared test residuals of each channel, (C,), for fits of the given columns.

        Args:
            validation: Weighted sums of these products, which determine the fits.
            columns: Indices of the fitted columns.
        """
        squares = _residual_squares(self.test, columns, validation.values(columns))
        return np.asarray(squares.sum(axis=0))


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Products of columns for each fold, summed over channels; the last column is the measurement.

    Attributes:
        test: Products of each fold's test rows, (folds, m, m).
        training: Products of each fold's training rows, (folds, m, m).
    """

    test: Array
    training: Array

    def values(self, columns: Sequence[int]) -> Array:
        """Coefficients of k given columns, fitted to each fold's training rows, (folds, k)."""
        indices = list(columns)
        return np.array(
            [
                solve_scaled(products[np.ix_(indices, indices)], products[indices, -1])
                for products in self.training
            ]
        )

    def residual_squares(self, columns: Sequence[int]) -> Array:
        """Sum of squared test residuals of each fold, (folds,), for fits of the given columns."""
        return _residual_squares(self.test, columns, self.values(columns))

    def squares_with_candidates(
        self, columns: Sequence[int], candidates: Sequence[int]
    ) -> Array:
        """Sum of squared test residuals with one more column, (folds, candidates).

        Each candidate column is added alone, and all coefficients are fitted to the training rows.
        The sum is infinite if the candidate is a linear combination of the columns in the training
        rows.

        Args:
            columns: Indices of the columns of all fits.
            candidates: Indices of the candidate columns.
        """
        base, added, y = (
            list(columns),
            list(candidates),
            self.test.shape[1] - 1,
        )
        squares = np.empty((len(self.training), len(added)))
        for k, (training, test) in enumerate(
            zip(self.training, self.test, strict=True)
        ):
            solution = solve_scaled(
                training[np.ix_(base, base)],
                training[np.ix_(base, [y, *added])],
            )
            values, shared = solution[:, 0], solution[:, 1:]
            squared_norms = np.diagonal(training)[added]
            remaining_squares = squared_norms - np.einsum(
                "ij,ij->j", training[np.ix_(base, added)], shared
            )
            independent = remaining_squares > MIN_INDEPENDENT_SHARE * squared_norms
            gain_factor = np.where(
                independent,
                training[added, y] - training[np.ix_(added, base)] @ values,
                0.0,
            )
            gain_factor = gain_factor / np.where(independent, remaining_squares, 1.0)
            # residuals as combinations of the columns
            combinations = np.zeros((y + 1, len(added)))
            combinations[base] = gain_factor * shared - values[:, None]
            combinations[added, np.arange(len(added))] -= gain_factor
            combinations[y] = 1.0
            residual = np.einsum("ij,ij->j", combinations, test @ combinations)
            squares[k] = np.where(independent, np.maximum(residual, 0.0), np.inf)
        return squares


def _residual_squares(products: Array, columns: Sequence[int], values: Array) -> Array:
    """Sums of squared residuals for given coefficients, from products of the columns, (folds, ...).

    Args:
        products: Products of all columns, the measurement last, (folds, ..., m, m).
        columns: Indices of the fitted columns.
        values: Coefficients of each fold, (folds, k).
    """
    indices = [*columns, products.shape[-1] - 1]
    combination = np.column_stack([-values, np.ones(len(values))])
    products_of_columns = products[..., indices, :][..., indices]
    return np.asarray(
        np.maximum(
            np.einsum(
                "ki,k...ij,kj->k...", combination, products_of_columns, combination
            ),
            0.0,
        )
    )
