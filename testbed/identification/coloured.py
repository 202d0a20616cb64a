"""The fit under coloured noise: unknowns, an honest covariance, and what the noise is like.

Two passes after the one that has found the weighted solution: residuals with columns made
orthonormal, so that nothing is lost to the equations' condition; then replicas of the noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import stats

from testbed.arrays import Array
from testbed.identification.noise.autoregression import HIGHEST
from testbed.identification.noise.biases import constants, square_of_last, with_constants
from testbed.identification.noise.fits import Fit, NoiseFit, weighted_fit, whitened_fit
from testbed.identification.noise.found_noise import FoundNoise
from testbed.identification.noise.lagged_products import LaggedProducts, LaggedSums
from testbed.identification.noise.replicas import Replicas
from testbed.identification.passes import Passes
from testbed.identification.solvers import least_squares

ROUNDING = 1e-9
"""Part of a channel in a constant that is none but for rounding."""

FEW = 50
"""Rows below which constants are not looked for."""

IMITATES = 0.1
"""An unknown with a larger part than this in what imitates a constant is named."""


@dataclass(frozen=True, eq=False)
class Refined:
    """A solution after the passes that look at the residuals themselves.

    Attributes:
        fit: The solution before.
        values: Of the unknowns, (p,).
        covariance: (p, p).
        squares: Sums of the squares of each channel's residuals, (C,).
        noise: What they are like; None where they are taken as white.
    """

    fit: least_squares.Fit
    values: Array
    covariance: Array
    squares: Array
    noise: FoundNoise | None = None


def under_coloured_noise(
    start: least_squares.Fit, passes: Passes, names: tuple[str, ...]
) -> Refined:
    """Go on from a weighted solution.

    Args:
        start: The solution, and the weights in whose units rows are taken.
        passes: Over all rows.
        names: Of the unknowns.
    """
    plan, p = passes.plan, len(names)
    root, lead = (_cholesky(matrix) for matrix in (start.weights, start.inverse))
    units = _Units(root, lead)
    sums = LaggedSums(HIGHEST)
    for columns, left, counts, _ in units.rows(passes, start.values):
        sums.add(np.concatenate([columns, left[..., None], counts[..., None]], axis=2))
    fit, found, directions, hidden = _fit(sums.finish(), plan.layout.model == "reaction")
    values = start.values + units.lead @ found.values[:p]
    replicas, squares = Replicas(found, HIGHEST), np.zeros(len(units.root))
    back = np.linalg.inv(units.root.T) @ directions
    back[np.abs(back) < ROUNDING * np.abs(back).max(initial=0.0)] = 0.0
    bias = back @ found.values[p:]
    for columns, _, counts, own in units.rows(passes, values):
        ones = counts[..., None] * directions[:, None]
        replicas.add(np.concatenate([columns, ones], axis=2), counts)
        squares += ((own - bias[:, None]) ** 2 * counts).sum(axis=1)
    factor = replicas.factor(fit, units.lead)
    covariance, count = factor**2 * found.covariance, directions.shape[1]
    spread = np.sqrt(np.einsum("ci,ij,cj->c", back, covariance[p:, p:], back))
    part = np.abs(hidden @ units.lead.T)
    imitates = part > IMITATES * part.max(axis=1, keepdims=True, initial=0.0)
    return Refined(
        fit=start,
        values=values,
        covariance=units.lead @ covariance[:p, :p] @ units.lead.T,
        squares=squares,
        noise=FoundNoise(
            order=found.noise.order,
            memory=tuple(float(m) / plan.rate for m in found.noise.memory),
            factor=factor,
            bias=bias,
            bias_sigma=spread,
            bias_chance=_chance(square_of_last(found, count) / factor**2, count),
            hidden=tuple(n for n, seen in zip(names, imitates.any(axis=0), strict=True) if seen),
        ),
    )


def _fit(given: LaggedProducts, whole: bool) -> tuple[Fit, NoiseFit, Array, Array]:
    """How it was fitted, the fit, the constants that it took, and unknowns that imitate others.

    Args:
        given: Products of unknowns' columns, residuals and ones.
        whole: Whether no rows are missing.
    """
    none = np.zeros((len(given.first), 0))
    if not whole:
        unknowns = given.products.shape[2] - 2
        return weighted_fit, weighted_fit(given, None), none, np.zeros((0, unknowns))
    there = constants(given)
    if given.rows < FEW:
        return whitened_fit, whitened_fit(given, None), none, there.hidden
    biased = with_constants(whitened_fit, there.directions)
    found = biased(given, None)
    count = there.directions.shape[1]
    if square_of_last(found, count) > 2 * count:  # Akaike's criterion
        return whitened_fit, found, there.directions, there.hidden
    return whitened_fit, whitened_fit(given, None), none, there.hidden


def _chance(square: float, count: int) -> float:
    return float(stats.chi2.sf(square, count)) if count else 1.0


def _cholesky(matrix: Array) -> Array:
    return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class _Units:
    """Units in which all noise is one and columns are orthonormal.

    Attributes:
        root: Of the weights, (C, C): W = root root'.
        lead: Unknowns of the columns, (p, p).
    """

    root: Array
    lead: Array

    def rows(self, passes: Passes, values: Array) -> Iterator[tuple[Array, Array, Array, Array]]:
        """Rows, block by block.

        Columns, (C, k, p), and what values leave, (C, k), in these units; ones where a row
        counts, (C, k); and what values leave in N and N m, (C, k).
        """
        alone = not np.any(self.root - np.diag(np.diagonal(self.root)))
        for columns, measured in passes.rows(np.column_stack([self.lead, values])):
            own = measured - columns[..., -1]
            counts = ((columns != 0).any(axis=2) | (measured != 0)).astype(float)
            if not alone:  # each is then a mixture of all
                counts = np.broadcast_to(counts.max(axis=0), counts.shape)
            stack = np.concatenate([columns[..., :-1], own[..., None]], axis=2)
            units = np.tensordot(self.root.T, stack, 1)
            yield units[..., :-1], units[..., -1], counts, own
