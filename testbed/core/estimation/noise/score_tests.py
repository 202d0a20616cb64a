"""Score tests of the residuals for faults of the instrument.

A fault shows, to first order, as more columns of the equations. If the model is right they
explain no more of the residuals than chance: an F test for every kind of fault. The noise is
found beside all of them together, so that none can hide in it, and the statistics are held
against those of made noise: found noise is whiter than it is, and the tests would see faults
that are not there.

Constants and trends are always beside the parameters: slow noise looks like a drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import linalg, special

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.base.stages import stage
from testbed.core.estimation.noise.fits import whitened_fits
from testbed.core.estimation.noise.lagged_products import (
    Autoregression,
    LaggedProducts,
    Whitened,
)
from testbed.core.estimation.noise.replicas import Replicas
from testbed.core.estimation.noise.whitening import WhitenedRows
from testbed.core.estimation.regression.normal_equations import TINY

IMITATED = 1e-9
"""Share of a column's square that others leave of it if they imitate it."""

PRIOR = 24.0
"""Weight of the mean over all kinds in each one's calibration, in degrees of freedom."""


class SingleEffect(NamedTuple):
    """One coefficient of a fault, the others zero.

    Attributes:
        square: Part of the residuals' squares it explains, in units of the noise's variance.
        place: Among the fault's coefficients.
        size: In its own unit.
        sigma: Of the size.
    """

    square: float
    place: int
    size: float
    sigma: float


@dataclass(frozen=True, eq=False)
class ScoreTest:
    """Score test of one kind of fault in the residuals.

    Attributes:
        square: Part of the residuals' squares it explains, in units of the noise's variance.
        count: Independent columns k.
        free: Degrees of freedom of the noise.
        size: Coefficients of the fault, (k',) in their own units.
        shift: Change of the unknowns if the coefficients were estimated, (m,).
        alone: The coefficient that explains most.
    """

    square: float
    count: int
    free: int
    size: Array
    shift: Array
    alone: SingleEffect

    def chance(self, scale: float) -> float:
        """Probability of a square as large in noise.

        Args:
            scale: Mean of square / count in noise.
        """
        if not self.count:
            return 1.0
        return float(
            special.fdtrc(self.count, self.free, self.square / self.count / scale)
        )


@dataclass(frozen=True, eq=False)
class TestedColumns:
    """Order of the products' columns.

    Attributes:
        base: Number of columns that come first: unknowns and trends.
        kinds: Numbers of the columns of each kind of fault, which follow.
    """

    base: int
    kinds: tuple[int, ...]

    def testable(self, products: LaggedProducts) -> bool:
        """Whether there are kinds to test, and rows enough."""
        channels = products.products.shape[1]
        # times as many rows, of all channels, as columns that the tests need
        least = 2 * (self.base + sum(self.kinds) + channels)
        return bool(self.kinds) and bool(products.rows * channels > least)


def score_tests(
    products: LaggedProducts,
    independent: Array,
    columns: TestedColumns,
    order: int | None = None,
    *,
    quick: bool = False,
) -> list[tuple[list[ScoreTest], Autoregression]]:
    """Tests of each kind of fault in each response, and the noise beside all of them.

    Args:
        products: Of the tested columns, a constant of every channel, residuals and ones.
        independent: Independent combinations of columns and constants, (q, r).
        columns: Their order.
        order: Of the noise; None for the best.
        quick: As for `whitened_fits`.
    """
    channels, responses = products.products.shape[1], products.responses
    basis = linalg.block_diag(independent, np.eye(responses + 1))
    noises = [
        fit.noise for fit in whitened_fits(products, order, quick=quick, basis=basis)
    ]
    white = Whitened(products, np.stack([noise.coefficients for noise in noises]))
    squares = white.sums(np.stack([noise.sigma for noise in noises]) ** -2.0)
    rows = products.after(noises[0].order) - noises[0].order
    free = max(rows * channels - independent.shape[1], 1)
    tests = []
    for response, each in enumerate(squares, start=products.unknowns):
        # constants first
        at = [
            *np.roll(np.arange(products.unknowns), channels),
            response,
        ]
        tests.append(
            _tests(each[np.ix_(at, at)], columns, columns.base + channels, free)
        )
    return list(zip(tests, noises, strict=True))


def independent_columns(products: LaggedProducts, columns: TestedColumns) -> Array:
    """Combinations of columns and constants that none of the others make up, orthonormal, (q, r).

    Args:
        products: Of the tested columns, a constant of every channel, residuals and ones.
        columns: Their order.
    """
    q, channels = products.unknowns, products.products.shape[1]
    base = channels + columns.base  # constants come first
    squares = np.roll(
        products.products[0, :, :q, :q].sum(axis=0), channels, axis=(0, 1)
    )
    scale = _scales(squares)
    first, across, rest_squares = _beside(squares * np.outer(scale, scale), base)
    rest = _orthonormal(rest_squares)
    combinations = np.zeros((q, first.shape[1] + rest.shape[1]))
    combinations[:base, : first.shape[1]] = first
    combinations[base:, first.shape[1] :] = rest
    combinations[:base, first.shape[1] :] = -first @ across @ rest
    return np.roll(scale[:, None] * combinations, -channels, axis=0)


def _beside(squares: Array, base: int) -> tuple[Array, Array, Array]:
    """Orthonormal combinations of the base; what the others share with them; and what they do not.

    Args:
        squares: Products of columns of length one, (q, q).
        base: How many come first.
    """
    first = _orthonormal(squares[:base, :base])
    across = first.T @ squares[:base, base:]
    return first, across, squares[base:, base:] - across.T @ across


def _scales(squares: Array) -> Array:
    """What makes columns of length one; zero columns stay."""
    length = np.sqrt(np.maximum(np.diagonal(squares), 0.0))
    return 1 / np.where(length > 0, length, 1.0)


def _orthonormal(squares: Array) -> Array:
    """T with T' squares T = 1, of the directions that are no combinations of others."""
    spread, axes = eigh((squares + squares.T) / 2)
    identifiable = spread > IMITATED
    return axes[:, identifiable] / np.sqrt(spread[identifiable])


def _tests(
    squares: Array, columns: TestedColumns, base: int, free: int
) -> list[ScoreTest]:
    """All kinds', from products of the base's columns, the kinds' and the residuals."""
    scale = _scales(squares)
    scale[-1] = 1.0
    first, across, rest = _beside(squares * np.outer(scale, scale), base)
    whole = _orthonormal(rest[:-1, :-1]).T @ rest[:-1, -1]
    variance = max((rest[-1, -1] - float(whole @ whole)) / free, TINY)
    tests, end = [], 0
    for kind in columns.kinds:
        own, size = slice(end, end + kind), scale[base + end : base + end + kind]
        end += kind
        basis = _orthonormal(rest[own, own])
        part = basis.T @ rest[own, -1]
        shift = -first @ (across[:, own] @ (basis @ part))
        tests.append(
            ScoreTest(
                square=float(part @ part) / variance,
                count=basis.shape[1],
                free=free,
                size=basis @ part * size,
                shift=(shift * scale[:base])[base - columns.base :],
                alone=_alone(rest[own, own], rest[own, -1], size, variance),
            )
        )
    return tests


def _alone(
    squares: Array, across: Array, scale: Array, variance: float
) -> SingleEffect:
    """Of products of a kind's columns, (k, k), and with the residuals, (k,), beside the base."""
    length = np.diagonal(squares)
    known = length > IMITATED
    explained = np.divide(across**2, length, out=np.zeros(len(length)), where=known)
    k = int(explained.argmax())
    if not known[k]:
        return SingleEffect(0.0, k, 0.0, np.inf)
    size, sigma = (
        np.array([across[k], np.sqrt(variance * length[k])]) * scale[k] / length[k]
    )
    return SingleEffect(float(explained[k]) / variance, k, float(size), float(sigma))


def calibrated(
    tests: Sequence[ScoreTest], replicas: Sequence[Sequence[ScoreTest]]
) -> tuple[float, ...]:
    """Probabilities of tests, calibrated by those of made noise.

    Args:
        tests: Of the residuals.
        replicas: Of made noise, replica by replica.
    """
    each = [[(test.square, test.count) for test in replica] for replica in replicas]
    squares, counts = np.moveaxis(np.array(each, dtype=float), 2, 0)
    pooled = squares.sum() / max(counts.sum(), 1.0)
    scales = (squares.sum(axis=0) + PRIOR * pooled) / (counts.sum(axis=0) + PRIOR)
    return tuple(t.chance(max(1.0, s)) for t, s in zip(tests, scales, strict=True))


class ScoreTests:
    """Score tests of the residuals, calibrated by replicas of their noise where one is clear."""

    def __init__(
        self, products: LaggedProducts, columns: TestedColumns, basis: Array
    ) -> None:
        """Test the residuals, if rows suffice.

        Args:
            products: Of the tested columns, residuals and ones.
            columns: Their order.
            basis: Parameters from the unknowns that come first, (p, m).
        """
        self._columns, self._basis, self._replicas = columns, basis, None
        self._tests = list[ScoreTest]()
        if columns.testable(products):
            self._constants = np.eye(products.products.shape[1])
            whole = products.with_constants(self._constants)
            self._independent = independent_columns(whole, columns)
            ((self._tests, noise),) = score_tests(whole, self._independent, columns)
            self._order = noise.order
            # chance by the F test above which it is not held against made noise, which raises it
            # only
            if any(test.chance(1.0) < 1e-3 for test in self._tests):
                self._replicas = Replicas(noise)

    def add(self, rows: WhitenedRows) -> None:
        """Go on with consecutive rows."""
        if self._replicas is not None:
            if rows.tested:
                self._replicas.add(rows.columns, rows.ones)
            else:
                self._replicas.pause()

    @stage("tests for faults")
    def result(self) -> tuple[tuple[ScoreTest, float], ...]:
        """Tests of each kind, with shifts of the parameters, and their probabilities in noise."""
        chances = tuple(test.chance(1.0) for test in self._tests)
        if self._replicas is not None:
            products = self._replicas.products.with_constants(self._constants)
            asked = products, self._independent, self._columns, self._order
            made = [tests for tests, _ in score_tests(*asked, quick=True)]
            chances = calibrated(self._tests, made)
        m = self._basis.shape[1]
        moved = (
            replace(test, shift=self._basis @ test.shift[:m]) for test in self._tests
        )
        return tuple(zip(moved, chances, strict=True))
