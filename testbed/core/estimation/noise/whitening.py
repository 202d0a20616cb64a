"""Whitened regression rows: unit noise in all channels, orthonormal robot columns.

Sensor unknowns are estimated together with the robot unknowns; linear constraints reduce the number
of free unknowns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import linalg

from testbed.core.base.arrays import Array
from testbed.core.base.stages import timed_stage
from testbed.core.estimation.noise.errors_in_variables import PositionNoise
from testbed.core.estimation.noise.lagged_products import LaggedProducts, LaggedSums
from testbed.core.estimation.regression import solvers
from testbed.core.estimation.regression.constraints import (
    LinearConstraints,
    NullSpace,
    free,
)
from testbed.core.estimation.regression.normal_equations import matrix_square_root
from testbed.core.estimation.regression.passes import ColumnFunction, Passes
from testbed.core.kernel.layout import Layout


@dataclass(frozen=True, eq=False)
class NuisanceColumns:
    """Regressor columns of the sensor unknowns, with constraints on all unknowns.

    Attributes:
        columns: Function that computes the columns; None without sensor unknowns.
        count: Number of sensor unknowns, s.
        constraints: Linear constraints on robot and sensor unknowns, yet to be imposed; None
            without constraints.
    """

    columns: ColumnFunction | None = None
    count: int = 0
    constraints: LinearConstraints | None = None


class WhitenedRows(NamedTuple):
    """Block of k regressor rows and residuals, whitened to unit noise and in measured units.

    Attributes:
        columns: Whitened columns of robot and sensor unknowns, (C, k, q).
        white: Whitened residuals, (C, k).
        ones: Row indicators, one for rows that are used, else zero, (C, k).
        measured: Residuals in measured units, (C, k) [N, N m].
        sensors: Columns of the sensor unknowns in measured units, (C, k, s) [N or N m per unit].
        noise_columns: Columns from simulated encoder noise, (C, k, r).
    """

    columns: Array
    white: Array
    ones: Array
    measured: Array
    sensors: Array
    noise_columns: Array


class ProductsWithNoise(NamedTuple):
    """Lagged products of rows, and of the encoder noise in the rows.

    Attributes:
        measured: Products of the unknowns' columns, residuals and row indicators, over all rows.
        noise: Products of simulated encoder noise in these columns; None if none is simulated.
    """

    measured: LaggedProducts
    noise: LaggedProducts | None


def row_indicators(columns: Array, measured: Array) -> Array:
    """Row indicators: one for rows that are used, zero for dropped rows, (C, k).

    Args:
        columns: Columns of the rows, (C, k, q).
        measured: Measurements of the rows, (C, k).
    """
    return np.asarray(((columns != 0).any(axis=2) | (measured != 0)).astype(float))


@dataclass(frozen=True, eq=False)
class Whitening:
    """Scaling to unit noise and to orthonormal columns of the robot unknowns.

    Attributes:
        root: Square roots of the channels' weights, (C,).
        white: Map from whitened to robot unknowns, (p, p).
        nuisances: Columns of the sensor unknowns.
        offset: Whitened unknowns for free unknowns of zero, (p + s,).
        free: Null space of the constraints on the whitened unknowns; None without constraints.
    """

    root: Array
    white: Array
    nuisances: NuisanceColumns
    offset: Array
    free: NullSpace | None = None

    @cached_property
    def full_map(self) -> Array:
        """Map from whitened unknowns to robot and sensor unknowns, (p + s, p + s)."""
        return np.asarray(linalg.block_diag(self.white, np.eye(self.nuisances.count)))

    @cached_property
    def basis(self) -> Array:
        """Map from free whitened unknowns to robot and sensor unknowns, (p + s, m)."""
        if self.free is None:
            return self.full_map
        expanded = self.full_map @ self.free.basis
        size = np.abs(self.full_map).max(axis=1, keepdims=True)
        # smaller entries are rounding errors of known unknowns
        return np.where(np.abs(expanded) > 1e-12 * size, expanded, 0.0)

    @property
    def fixed_values(self) -> Array:
        """Robot and sensor unknowns for free unknowns of zero, (p + s,)."""
        return self.full_map @ self.offset

    def free_columns(self, columns: Array) -> Array:
        """Columns of the free unknowns, followed by any additional columns, (C, k, q).

        Args:
            columns: Columns of all whitened unknowns, followed by any additional columns,
                (C, k, q).
        """
        if self.free is None:
            return columns
        m = len(self.full_map)
        return np.concatenate(
            [columns[..., :m] @ self.free.basis, columns[..., m:]], axis=2
        )

    def free_products(self, products: LaggedProducts) -> LaggedProducts:
        """Lagged products for the free unknowns, with the fixed part of the residuals subtracted.

        The fixed part is the prediction from `fixed_values`.

        Args:
            products: Lagged products of all unknowns' columns, residuals and row indicators.
        """
        if self.free is None:
            return products
        m = len(self.full_map)
        transform = linalg.block_diag(
            self.free.basis, np.eye(products.products.shape[2] - m)
        )
        transform[:m, -2] = -self.offset
        return products.combine_columns(transform)

    def rows(
        self, passes: Passes, values: Array, noise_columns: ColumnFunction | None
    ) -> Iterator[WhitenedRows]:
        """Yield whitened rows, block by block.

        Residuals are measurements minus the prediction from `values`, with sensor unknowns of zero.

        Args:
            passes: Passes over all rows.
            values: Robot unknowns whose prediction is subtracted, (p,).
            noise_columns: Function that simulates encoder noise in the columns; None for no noise.
        """
        combinations, root = np.column_stack([self.white, values]), self.root[:, None]
        blocks = passes.rows_with_columns(
            combinations, noise_columns, self.nuisances.columns
        )
        for columns, noise, sensors, measured in blocks:
            residual, ones = (
                measured - columns[..., -1],
                row_indicators(columns, measured),
            )
            yield WhitenedRows(
                columns=np.concatenate([columns[..., :-1], sensors], axis=2)
                * root[..., None],
                white=root * residual,
                ones=ones,
                measured=residual,
                sensors=sensors,
                noise_columns=noise * (root * ones)[..., None],
            )

    @timed_stage("columns of the instrument")
    def products(
        self,
        passes: Passes,
        values: Array,
        lags: int,
        encoders: PositionNoise | None = None,
    ) -> ProductsWithNoise:
        """Sum lagged products of columns, residuals and row indicators, in one pass.

        Args:
            passes: Passes over all rows.
            values: Robot unknowns whose prediction is subtracted, (p,).
            lags: Largest lag.
            encoders: Encoder noise to simulate in the columns; None for no noise.
        """
        is_wrench = passes.plan.layout.model == "wrench"
        sums = LaggedSums(lags)
        # joint torque rows have gaps and are not whitened
        noise_sums = LaggedSums(lags if is_wrench else 0)
        combinations = np.column_stack([self.white, values])
        noise_columns = (
            None if encoders is None else encoders.noisy_columns(combinations)
        )
        for rows in self.rows(passes, values, noise_columns):
            responses = np.stack([rows.white, rows.ones], axis=2)
            sums.add(np.concatenate([rows.columns, responses], axis=2))
            if noise_columns is not None:
                noise_sums.add(self._noise_block(rows.noise_columns))
        return ProductsWithNoise(
            sums.lagged_products(),
            None if noise_columns is None else noise_sums.lagged_products(),
        )

    def _noise_block(self, noise: Array) -> Array:
        """Encoder noise of columns and residuals, in the layout of rows, (C, k, p + s + 2).

        The order is: p robot columns, s sensor columns, residual, row indicator. Sensor columns and
        row indicators have no noise.

        Args:
            noise: Noise of the robot's columns and of the prediction, (C, k, p + 1).
        """
        columns, predicted = noise[..., :-1], noise[..., -1:]
        sensors = np.zeros((*noise.shape[:2], self.nuisances.count))
        return np.concatenate(
            [columns, sensors, -predicted, np.zeros_like(predicted)], axis=2
        )


def whitening_of(
    start: solvers.Fit, nuisances: NuisanceColumns, layout: Layout
) -> Whitening:
    """Whitening from the weights and the normal matrix of a weighted solution.

    Columns are orthonormalised from the bedplate outward, so that the row of a joint has nonzero
    entries only in the last columns, mainly the columns of its subtree. Constraints reduce the
    number of free unknowns.

    Args:
        start: Weighted solution, whose weights scale the rows.
        nuisances: Columns of the sensor unknowns.
        layout: Layout of the rows.
    """
    involved = np.stack(
        [layout.basis[own].any(axis=0) for own in layout.channel_columns]
    )
    inward = np.argsort(np.argmax(involved[::-1], axis=0), kind="stable")
    white = np.empty_like(start.inverse)
    white[inward] = matrix_square_root(start.inverse[np.ix_(inward, inward)])[:, ::-1]
    units = Whitening(
        np.sqrt(start.weights),
        white,
        nuisances,
        np.zeros(len(white) + nuisances.count),
    )
    facts = nuisances.constraints
    if facts is None or not len(facts):
        return units
    space = free(replace(facts, rows=facts.rows @ units.full_map))
    return replace(units, offset=space.right_inverse @ facts.values, free=space)
