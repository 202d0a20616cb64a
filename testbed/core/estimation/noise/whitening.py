"""Rows in units in which all noise is one and the robot's columns are orthonormal.

Unknowns of the instrument stand beside the robot's; what is known of the unknowns leaves fewer of
them free.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import linalg

from testbed.core.base.arrays import Array
from testbed.core.base.stages import stage
from testbed.core.estimation.noise.errors_in_variables import PositionNoise
from testbed.core.estimation.noise.lagged_products import LaggedProducts, LaggedSums
from testbed.core.estimation.regression import solvers
from testbed.core.estimation.regression.constraints import (
    LinearConstraints,
    NullSpace,
    free,
)
from testbed.core.estimation.regression.normal_equations import square_root
from testbed.core.estimation.regression.passes import Columns, Passes
from testbed.core.kernel.layout import Layout


@dataclass(frozen=True, eq=False)
class NuisanceColumns:
    """Columns beside the robot's.

    Attributes:
        columns: Makes them; None for none.
        unknown: How many.
        facts: About what is still to be added to the robot's unknowns and to these; None for none.
    """

    columns: Columns | None = None
    unknown: int = 0
    facts: LinearConstraints | None = None


class WhitenedRows(NamedTuple):
    """Block of regressor rows and residuals, whitened to unit noise, and as measured.

    Attributes:
        columns: The robot's and those beside, (C, k, q).
        white: Residuals of the values, (C, k).
        ones: Where a row counts, (C, k).
        measured: Residuals of the values as measured, (C, k) [N, N m].
        sensors: Columns beside as measured, (C, k, s) [N or N m per unit].
        made: Columns from made noise of the encoders, (C, k, r).
    """

    columns: Array
    white: Array
    ones: Array
    measured: Array
    sensors: Array
    made: Array


class Products(NamedTuple):
    """Sums of products of rows.

    Attributes:
        every: Of the unknowns' columns, residuals and ones, of all rows.
        noise: Of made noise of the encoders in the places of `every`; None if none is made.
    """

    every: LaggedProducts
    noise: LaggedProducts | None


def counted(columns: Array, measured: Array) -> Array:
    """Ones where a row counts, zeros where it was dropped, (C, k).

    Args:
        columns: Of the rows, (C, k, q).
        measured: Of the rows, (C, k).
    """
    return np.asarray(((columns != 0).any(axis=2) | (measured != 0)).astype(float))


@dataclass(frozen=True, eq=False)
class Whitening:
    """Units in which all noise is one and the robot's columns are orthonormal.

    Attributes:
        root: Of the channels' weights, (C,).
        white: The robot's unknowns of its columns, (p, p).
        beside: Columns beside.
        offset: The columns' unknowns where what is free is zero, (p + s,).
        free: What facts leave free of the columns' unknowns; None for all.
    """

    root: Array
    white: Array
    beside: NuisanceColumns
    offset: Array
    free: NullSpace | None = None

    @cached_property
    def grown(self) -> Array:
        """All unknowns of the columns, (p + s, p + s)."""
        return np.asarray(linalg.block_diag(self.white, np.eye(self.beside.unknown)))

    @cached_property
    def basis(self) -> Array:
        """All unknowns of the columns of what is free, (p + s, m)."""
        if self.free is None:
            return self.grown
        expanded = self.grown @ self.free.lead
        size = np.abs(self.grown).max(axis=1, keepdims=True)
        # part of its size that is left of an unknown which is known, by rounding
        return np.where(np.abs(expanded) > 1e-12 * size, expanded, 0.0)

    @property
    def fixed(self) -> Array:
        """All unknowns where what is free is zero, (p + s,)."""
        return self.grown @ self.offset

    def of_free(self, columns: Array) -> Array:
        """Columns of what is free, and those after the unknowns', of all columns, (C, k, q)."""
        if self.free is None:
            return columns
        m = len(self.grown)
        return np.concatenate(
            [columns[..., :m] @ self.free.lead, columns[..., m:]], axis=2
        )

    def as_free(self, every: LaggedProducts) -> LaggedProducts:
        """The same for products; what the facts account for is taken off the residuals."""
        if self.free is None:
            return every
        m = len(self.grown)
        whole = linalg.block_diag(self.free.lead, np.eye(every.products.shape[2] - m))
        whole[:m, -2] = -self.offset
        return every.combined(whole)

    def rows(
        self, passes: Passes, values: Array, made: Columns | None
    ) -> Iterator[WhitenedRows]:
        """Rows, block by block.

        Args:
            passes: Over all rows.
            values: Of the robot's unknowns.
            made: Columns from made noise of the encoders.
        """
        combined, root = np.column_stack([self.white, values]), self.root[:, None]
        blocks = passes.rows_beside(combined, made, self.beside.columns)
        for columns, noise, sensors, measured in blocks:
            residual, ones = measured - columns[..., -1], counted(columns, measured)
            yield WhitenedRows(
                columns=np.concatenate([columns[..., :-1], sensors], axis=2)
                * root[..., None],
                white=root * residual,
                ones=ones,
                measured=residual,
                sensors=sensors,
                made=noise * (root * ones)[..., None],
            )

    @stage("columns of the instrument")
    def products(
        self,
        passes: Passes,
        values: Array,
        lags: int,
        encoders: PositionNoise | None = None,
    ) -> Products:
        """Products of columns, of what values leave, and of ones, with so many rows before.

        Args:
            passes: Over all rows.
            values: Of the robot's unknowns.
            lags: How many rows before.
            encoders: Their noise; None where none is to be made.
        """
        plate = passes.plan.layout.model == "reaction"
        every = LaggedSums(lags)
        # rows of joints have gaps: none is whitened
        noise = LaggedSums(lags if plate else 0)
        combined = np.column_stack([self.white, values])
        made = None if encoders is None else encoders.noisy_columns(combined)
        for rows in self.rows(passes, values, made):
            last = np.stack([rows.white, rows.ones], axis=2)
            every.add(np.concatenate([rows.columns, last], axis=2))
            if made is not None:
                noise.add(self._of_noise(rows.made))
        return Products(every.finish(), None if made is None else noise.finish())

    def _of_noise(self, noise: Array) -> Array:
        """In the places of all unknowns, of the residuals and of the ones, (C, k, p + s + 2)."""
        columns, predicted = noise[..., :-1], noise[..., -1:]
        exact = np.zeros((*noise.shape[:2], self.beside.unknown))
        return np.concatenate(
            [columns, exact, -predicted, np.zeros_like(predicted)], axis=2
        )


def whitening_of(
    start: solvers.Fit, beside: NuisanceColumns, layout: Layout
) -> Whitening:
    """Units that a weighted solution suggests.

    Columns are made orthonormal from the bedplate outward, so that a joint's row still holds those
    of its subtree only, or few more: the last ones.

    Args:
        start: The solution, and the weights in whose units rows are taken.
        beside: Columns beside the robot's.
        layout: Of the rows.
    """
    involved = np.stack([layout.basis[own].any(axis=0) for own in layout.channels])
    inward = np.argsort(np.argmax(involved[::-1], axis=0), kind="stable")
    white = np.empty_like(start.inverse)
    white[inward] = square_root(start.inverse[np.ix_(inward, inward)])[:, ::-1]
    units = Whitening(
        np.sqrt(start.weights), white, beside, np.zeros(len(white) + beside.unknown)
    )
    facts = beside.facts
    if facts is None or not len(facts):
        return units
    space = free(replace(facts, rows=facts.rows @ units.grown))
    return replace(units, offset=space.fixed @ facts.values, free=space)
