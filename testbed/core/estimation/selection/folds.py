"""Cross-validation over products of rows: consecutive folds, each predicted from the others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.regression.normal_equations import scaled_solve
from testbed.core.kernel.records import Ints

DEPENDENT = 1e-10
"""Part of a column's square beyond all others, below which it is a sum of those."""


@dataclass(frozen=True, eq=False)
class Folds:
    """Consecutive parts of rows.

    Attributes:
        ends: Number of each fold's first row, and of the row after the last, (folds + 1,).
        reach: Rows beside a fold that share samples with it, and do not predict it.
    """

    ends: Ints
    reach: int = 0

    @classmethod
    def even(cls, rows: int, count: int, reach: int = 0) -> Folds:
        """Folds of one size but for rounding.

        Args:
            rows: Number of rows.
            count: Number of folds.
            reach: Rows beside a fold that share samples with it.
        """
        return cls(np.linspace(0, rows, count + 1).round().astype(int), reach)

    def cut(self, first: int, rows: int, reach: int = 0) -> Iterator[tuple[int, slice]]:
        """Folds that have rows in a block, and which rows.

        Args:
            first: Number of the block's first row.
            rows: Rows of the block.
            reach: Rows beside each fold that are taken, too.
        """
        low = np.clip(self.ends[:-1] - reach - first, 0, rows).tolist()
        high = np.clip(self.ends[1:] + reach - first, 0, rows).tolist()
        for fold, span in enumerate(map(slice, low, high)):
            if span.start < span.stop:
                yield fold, span

    def products(self, blocks: Iterable[Array]) -> CrossProducts:
        """Products of the columns of rows, (C, k, m) a block, the last being the measurement.

        Args:
            blocks: All rows in order.
        """
        sums: dict[tuple[int, int], Any] = defaultdict(float)
        first, shape = 0, (0, 0, 0)
        for block in blocks:
            for reach in {0, self.reach}:
                for fold, span in self.cut(first, block.shape[1], reach):
                    rows = block[:, span]
                    sums[reach, fold] += rows.swapaxes(1, 2) @ rows
            shape = len(block), block.shape[2], block.shape[2]
            first += block.shape[1]
        unseen, near = (
            np.array(
                [
                    sums[reach, fold] + np.zeros(shape)
                    for fold in range(len(self.ends) - 1)
                ]
            )
            for reach in (0, self.reach)
        )
        return CrossProducts(unseen, unseen.sum(axis=0) - near)


@dataclass(frozen=True, eq=False)
class CrossProducts:
    """Products of columns fold by fold, channel by channel, the last being the measurement.

    Attributes:
        unseen: Of each fold, (folds, C, m, m).
        seen: Of all rows from which the fold is predicted, (folds, C, m, m).
    """

    unseen: Array
    seen: Array

    def weighted(self, weights: Array) -> CrossValidation:
        """Sums over the channels.

        Args:
            weights: Of the channels, (C,).
        """
        return CrossValidation(
            np.einsum("c,kcij->kij", weights, self.unseen),
            np.einsum("c,kcij->kij", weights, self.seen),
        )

    def residual_squares(
        self, validation: CrossValidation, columns: Sequence[int]
    ) -> Array:
        """Squares that fits of some columns leave of each channel in unseen folds, (C,).

        Args:
            validation: Weighted sums, which are fitted.
            columns: Which.
        """
        each = _residual_squares(self.unseen, columns, validation.values(columns))
        return np.asarray(each.sum(axis=0))


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Products of columns fold by fold, the last being the measurement.

    Attributes:
        unseen: Of each fold, (folds, m, m).
        seen: Of all rows from which the fold is predicted, (folds, m, m).
    """

    unseen: Array
    seen: Array

    def values(self, columns: Sequence[int]) -> Array:
        """Coefficients of some columns, fitted to the rows seen, (folds, k)."""
        own = list(columns)
        return np.array(
            [scaled_solve(s[np.ix_(own, own)], s[own, -1]) for s in self.seen]
        )

    def residual_squares(self, columns: Sequence[int]) -> Array:
        """Squares that fits of some columns leave of each fold, (folds,)."""
        return _residual_squares(self.unseen, columns, self.values(columns))

    def with_each(self, columns: Sequence[int], more: Sequence[int]) -> Array:
        """`residual_squares` with one more column, for each of several, (folds, more).

        Infinite where the column is a sum of the others.
        """
        own, new, y = list(columns), list(more), self.unseen.shape[1] - 1
        squares = np.empty((len(self.seen), len(new)))
        for k, (seen, unseen) in enumerate(zip(self.seen, self.unseen, strict=True)):
            solved = scaled_solve(seen[np.ix_(own, own)], seen[np.ix_(own, [y, *new])])
            values, shared = solved[:, 0], solved[:, 1:]
            whole = np.diagonal(seen)[new]
            beyond = whole - np.einsum("ij,ij->j", seen[np.ix_(own, new)], shared)
            independent = beyond > DEPENDENT * whole
            share = np.where(
                independent, seen[new, y] - seen[np.ix_(new, own)] @ values, 0.0
            )
            share = share / np.where(independent, beyond, 1.0)
            # residuals as combinations of the columns
            ends = np.zeros((y + 1, len(new)))
            ends[own] = share * shared - values[:, None]
            ends[new, np.arange(len(new))] -= share
            ends[y] = 1.0
            rest = np.einsum("ij,ij->j", ends, unseen @ ends)
            squares[k] = np.where(independent, np.maximum(rest, 0.0), np.inf)
        return squares


def _residual_squares(products: Array, columns: Sequence[int], values: Array) -> Array:
    """Squares that values, (folds, k), leave of products, (folds, ..., m, m)."""
    at = [*columns, products.shape[-1] - 1]
    ends = np.column_stack([-values, np.ones(len(values))])
    inner = products[..., at, :][..., at]
    return np.asarray(
        np.maximum(np.einsum("ki,k...ij,kj->k...", ends, inner, ends), 0.0)
    )
