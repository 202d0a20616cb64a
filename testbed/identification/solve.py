"""Weighted least squares from products; weights from the residuals themselves.

Source    [FRS96] eq. (14); columns are scaled to unit length first
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from testbed.arrays import Array
from testbed.errors import UnknownName, UnseenParameters
from testbed.identification.normal_equations import Products
from testbed.kernel.layout import Layout

REWEIGHTINGS = 4
"""Times that the channels' noise is estimated anew from the residuals."""

SQUARED = 1e4
"""Condition up to which normal equations and one correction are as good as a QR."""

TRIANGLE = 1e6
"""Condition up to which products tell how to make columns orthonormal."""

RANK_TOLERANCE = 1e-10
"""Singular values of the scaled equations below this share of the largest count as zero."""

PRECISION = 1e-7
"""Least noise of a channel relative to its measurement: what products can resolve."""

_PART = 0.1  # an unknown with a larger part in a direction that the data miss is named


@dataclass(frozen=True, eq=False)
class Fit:
    """A weighted least-squares solution.

    Attributes:
        values: (p,); nan for what no weighted channel sees.
        inverse: Inverse of X' W X, (p, p); nan likewise.
        weights: W, (C, C).
        condition: Of the weighted equations with columns of unit length.
    """

    values: Array
    inverse: Array
    weights: Array
    condition: float


def fit(products: Products, weights: Mapping[str, float] | None = None) -> Fit:
    """Fit some of the channels, with weights of one's own.

    One channel alone, all but one, or any others: no pass over the samples.

    Args:
        products: Of a recording; `Estimate.products`.
        weights: By channel, one over the variance of its noise [N^-2, (N m)^-2]; channels
            that are not named are left out. Default all, by their residuals.

    Raises:
        UnknownName: There is no such channel.
        UnseenParameters: The channels see parameters that they cannot tell apart.
    """
    if weights is None:
        return solved(products, noise_weights(products, None))
    for name in weights:
        if name not in products.channels:
            raise UnknownName("channel", name, products.channels)
    return solved(products, np.diag([float(weights.get(c, 0.0)) for c in products.channels]))


def solved(products: Products, weights: Array) -> Fit:
    """The solution for given weights, (C, C), by scaled normal equations.

    Raises:
        UnseenParameters: The equations do not determine all they see; names them.
    """
    matrix, vector = products.matrix(weights), products.vector(weights)
    scale = np.sqrt(np.diagonal(matrix))
    seen = scale > 0
    if not seen.any():
        names = products.unknowns
        raise UnseenParameters(names, 0, len(names), int(products.used.sum()))
    values, inverse = np.full(len(scale), np.nan), np.full(matrix.shape, np.nan)
    unit = matrix[np.ix_(seen, seen)] / np.outer(scale[seen], scale[seen])
    spread, directions = np.linalg.eigh(unit)
    lost = spread <= len(spread) * np.finfo(float).eps * spread[-1]
    if lost.any():
        names = tuple(np.array(products.unknowns)[seen])
        refuse(names, directions[:, lost].T, int(products.used.sum()))
    factor = linalg.cho_factor(unit)
    scaled = linalg.cho_solve(factor, np.eye(len(unit))) / np.outer(scale[seen], scale[seen])
    inverse[np.ix_(seen, seen)] = scaled
    values[seen] = linalg.cho_solve(factor, vector[seen] / scale[seen]) / scale[seen]
    return Fit(values, inverse, weights, float(np.sqrt(spread[-1] / spread[0])))


def noise_weights(products: Products, covariance: Array | None, full: bool = False) -> Array:
    """W, (C, C): the inverse of the noise's covariance.

    Args:
        products: Of all rows.
        covariance: Of the noise, if it is known.
        full: Whether channels are taken as correlated.
    """
    if covariance is not None:
        return np.asarray(np.linalg.inv(covariance))
    rms = np.sqrt(np.diagonal(products.square) if products.joined else products.square)
    rms = rms / np.sqrt(np.maximum(products.used, 1.0))
    floor = np.maximum(PRECISION * rms, PRECISION**2 * (rms.max() or 1.0))
    weights = np.eye(len(products.channels))
    for _ in range(REWEIGHTINGS):
        values = _rough(products, weights)
        weights = _from_residuals(products, products.residual(values), floor, full)
    return weights


def _from_residuals(products: Products, squares: Array, floor: Array, full: bool) -> Array:
    share = len(products.unknowns) / len(products.channels)
    free = np.maximum(products.used - share, 1.0)
    spread = squares / np.sqrt(np.outer(free, free))
    variance = np.maximum(np.diagonal(spread), floor**2)
    if not full:
        return np.diag(1 / variance)
    correlation = spread / np.sqrt(np.outer(variance, variance))
    np.fill_diagonal(correlation, 1 + PRECISION)
    return np.linalg.inv(correlation) / np.sqrt(np.outer(variance, variance))


def _rough(products: Products, weights: Array) -> Array:
    """A solution good enough for weights, whatever the condition."""
    matrix, vector = products.matrix(weights), products.vector(weights)
    scale = np.sqrt(np.diagonal(matrix))
    scale[scale == 0] = 1.0
    unit = matrix / np.outer(scale, scale)
    values: Array = np.linalg.lstsq(unit, vector / scale, rcond=1e-13)[0] / scale
    return values


def orthogonal(
    layout: Layout, products: Products, weights: Array, rows: Callable[[], Iterator[Array]]
) -> Fit:
    """The solution from columns made orthonormal before they are summed.

    For equations whose products have lost what tells parameters apart: errors grow with the
    condition, not with its square. The triangle that makes the columns orthonormal comes from
    the products, or, above TRIANGLE, from a QR of all rows.

    Args:
        layout: The rows.
        products: Of all rows.
        weights: W, (C, C).
        rows: Starts a pass over blocks of (slots, rows).

    Raises:
        UnseenParameters: The equations do not determine all unknowns; names them.
    """
    matrix: Array = products.matrix(weights)
    root: Array = np.asarray(np.linalg.cholesky(weights), dtype=np.float64)
    scale = np.sqrt(np.diagonal(matrix))
    scale[scale == 0] = 1.0
    unit = matrix / np.outer(scale, scale)
    if np.linalg.cond(unit) < TRIANGLE**2:
        triangle = linalg.cholesky(unit)
    else:
        triangle = _triangle(layout, root, scale, rows())
    _, spread, directions = np.linalg.svd(triangle)
    lost = spread <= RANK_TOLERANCE * spread[0]
    if lost.any():
        refuse(products.unknowns, directions[lost], int(products.used.sum()))
    lead = linalg.inv(triangle) / scale[:, None]
    values = np.zeros(len(scale))
    for _ in range(2):  # the second time on what the first has left
        gram, vector = np.zeros_like(matrix), np.zeros(len(scale))
        for columns, left in _dense(
            layout, root, layout.basis @ lead, layout.basis @ values, rows()
        ):
            gram += columns.T @ columns
            vector += columns.T @ left
        values = values + lead @ np.linalg.solve(gram, vector)
    inverse = lead @ np.linalg.inv(gram) @ lead.T
    return Fit(values, inverse, weights, float(spread[0] / spread[-1]))


def _triangle(layout: Layout, root: Array, scale: Array, rows: Iterator[Array]) -> Array:
    """R of a QR of all rows, block after block onto one triangle, (p, p)."""
    triangle = np.zeros((0, len(scale)))
    lead = layout.basis / scale
    for columns, _ in _dense(layout, root, lead, np.zeros(len(lead)), rows):
        triangle = np.asarray(np.linalg.qr(np.vstack([triangle, columns]), mode="r"))
    missing = len(scale) - len(triangle)
    return np.vstack([triangle, np.zeros((missing, len(scale)))])


def _dense(
    layout: Layout, root: Array, lead: Array, values: Array, rows: Iterator[Array]
) -> Iterator[tuple[Array, Array]]:
    """Rows with noise of unit covariance: columns @ lead, (k, p), and what values leave, (k,)."""
    for block in rows:
        stack = np.empty((len(layout.channels), block.shape[1], lead.shape[1] + 1))
        for c, columns in enumerate(layout.channels):
            at = layout.rows.start[c]
            own = block[at : at + len(columns)].T
            stack[c, :, :-1] = own @ lead[columns]
            stack[c, :, -1] = block[layout.rows.measured[c]] - own @ values[columns]
        white = np.tensordot(root.T, stack, 1).reshape(-1, lead.shape[1] + 1)
        yield white[:, :-1], white[:, -1]


def refuse(names: tuple[str, ...], directions: Array, rows: int) -> None:
    """Raise with the names of the unknowns that have a part in directions, (k, p), unseen."""
    parts = np.abs(directions).max(axis=0)
    unseen = [name for name, part in zip(names, parts, strict=True) if part > _PART]
    raise UnseenParameters(unseen, len(names) - len(directions), len(names), rows)
