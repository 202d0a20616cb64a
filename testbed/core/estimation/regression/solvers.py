"""Ways to solve weighted least squares, the quickest first, and how they refuse."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from scipy import linalg

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.base.errors import UnknownName, UnseenParameters
from testbed.core.estimation.regression.normal_equations import NormalEquations, unit_diagonal

REWEIGHTINGS = 4
"""Times that the channels' noise is estimated anew from the residuals."""

PRECISION = 1e-7
"""Least noise of a channel relative to its measurement: what sums of products can resolve."""


def noise_weights(
    equations: NormalEquations, covariance: Array | None, full: bool = False
) -> Array:
    """W, (C, C): the inverse of the noise's covariance.

    Args:
        equations: Of all rows.
        covariance: Of the noise, if it is known.
        full: Whether channels are taken as correlated.
    """
    if covariance is not None:
        return np.asarray(np.linalg.inv(covariance))
    rms = np.sqrt(equations.squares) / np.sqrt(np.maximum(equations.used, 1.0))
    floor = np.maximum(PRECISION * rms, PRECISION**2 * (rms.max() or 1.0))
    weights = np.eye(len(equations.channels))
    for _ in range(REWEIGHTINGS):
        values = _rough(equations, weights)
        weights = _from_residuals(equations, equations.residual(values), floor, full)
    return weights


def _from_residuals(equations: NormalEquations, squares: Array, floor: Array, full: bool) -> Array:
    share = len(equations.unknowns) / len(equations.channels)
    free = np.maximum(equations.used - share, 1.0)
    spread = squares / np.sqrt(np.outer(free, free))
    variance = np.maximum(np.diagonal(spread), floor**2)
    if not full:
        return np.diag(1 / variance)
    correlation = spread / np.sqrt(np.outer(variance, variance))
    np.fill_diagonal(correlation, 1 + PRECISION)
    return np.linalg.inv(correlation) / np.sqrt(np.outer(variance, variance))


def _rough(equations: NormalEquations, weights: Array) -> Array:
    """A solution good enough for weights, whatever the condition."""
    matrix, vector = equations.matrix(weights), equations.vector(weights)
    unit, scale = unit_diagonal(matrix)
    values: Array = np.linalg.lstsq(unit, vector / scale, rcond=1e-13)[0] / scale
    return values


WINDOW = 0.5
"""Longest time over which residuals are taken to be correlated [s]."""

BINS = 6
"""Least number of bins in a window."""


def bin_size(rate: float) -> int:
    """Rows whose scores are added up at once: a power of two up to 64.

    Args:
        rate: Rows a second [Hz].
    """
    size = 1
    while size < 64 and 2 * size * BINS <= WINDOW * rate:
        size *= 2
    return size


class ScoreSquares:
    """Sum over all pairs of scores of one window, with Bartlett's weights, as they come."""

    def __init__(self, columns: int, rate: float) -> None:
        """Nothing yet.

        Args:
            columns: Number p of columns.
            rate: Rows a second [Hz].
        """
        self.lags = max(int(WINDOW * rate / bin_size(rate)), 1)
        self.total = np.zeros(columns)
        self._recent = np.zeros((self.lags, columns))
        self._sum = np.zeros((columns, columns))

    def add(self, scores: Array) -> None:
        """Go on with scores of consecutive bins, (bins, p)."""
        self.total += scores.sum(axis=0)
        self._slide(scores)

    def finish(self) -> Array:
        """The weighted sum, (p, p)."""
        self._slide(np.zeros_like(self._recent))
        return self._sum / (self.lags + 1)

    def _slide(self, scores: Array) -> None:
        run = np.vstack([self._recent, scores])
        sums = np.cumsum(np.vstack([np.zeros(run.shape[1]), run]), axis=0)
        windows = sums[self.lags + 1 :] - sums[: -self.lags - 1]
        self._sum += windows.T @ windows
        self._recent = run[len(run) - self.lags :]


def sandwich(inverse: Array, squares: Array) -> Array:
    """Covariance of the unknowns, (p, p).

    Args:
        inverse: Of X' W X, (p, p).
        squares: Of the scores, (p, p).
    """
    return inverse @ squares @ inverse


def hidden(weights: Array, step: int, rate: float) -> float:
    """Factor on variances for what Bartlett's weights take from filtered white noise.

    Args:
        weights: Of the filter on rows, (2 L + 1,).
        step: Samples from row to row.
        rate: Rows a second [Hz].
    """
    together = np.correlate(weights, weights, "full")[len(weights) - 1 :: step]
    lags = np.arange(len(together))
    size = bin_size(rate)
    longest = (max(int(WINDOW * rate / size), 1) + 1) * size
    share = np.maximum(1 - lags / longest, 0.0)
    both = np.where(lags == 0, 1.0, 2.0) * together
    return float(both.sum() / (share * both).sum())


Rows = Callable[[Array], Iterator[tuple[Array, Array]]]
"""Starts a pass over all rows, with columns combined by a matrix, (p, q): blocks of combined
columns, (C, k, q), and of measurements, (C, k)."""

_PART = 0.1  # an unknown with a larger part in a direction that the data miss is named


@dataclass(frozen=True, eq=False)
class Fit:
    """A weighted least-squares solution.

    Attributes:
        values: (p,); nan for what no weighted channel sees.
        inverse: Inverse of X' W X, (p, p); nan likewise.
        weights: W, (C, C).
        condition: Of the weighted equations with columns of unit length.
        correctable: Whether one correction by the rows' own residuals makes it better.
    """

    values: Array
    inverse: Array
    weights: Array
    condition: float
    correctable: bool


Solver = Callable[[NormalEquations, Array, Rows], Fit]
"""A way to solve weighted least squares: of equations, weights W, (C, C), and the rows.

It raises UnseenParameters, naming them, where the equations do not determine the unknowns."""


def refuse(names: tuple[str, ...], directions: Array, rows: int) -> NoReturn:
    """Raise with the names of the unknowns that have a part in directions, (k, p), unseen."""
    parts = abs(directions).max(axis=0)
    unseen = [name for name, part in zip(names, parts, strict=True) if part > _PART]
    raise UnseenParameters(unseen, len(names) - len(directions), len(names), rows)


def by_normal_equations(equations: NormalEquations, weights: Array, rows: Rows) -> Fit:
    """The solution for given weights; errors grow with the square of the condition.

    Args:
        equations: Of all rows.
        weights: W, (C, C).
        rows: Not looked at.

    Raises:
        UnseenParameters: The equations do not determine all they see; names them.
    """
    del rows
    matrix, vector = equations.matrix(weights), equations.vector(weights)
    scale = np.sqrt(np.diagonal(matrix))
    seen = scale > 0
    if not seen.any():
        names = equations.unknowns
        raise UnseenParameters(names, 0, len(names), int(equations.used.sum()))
    values, inverse = np.full(len(scale), np.nan), np.full(matrix.shape, np.nan)
    unit = matrix[np.ix_(seen, seen)] / np.outer(scale[seen], scale[seen])
    spread, directions = eigh(unit)
    lost = spread <= len(spread) * np.finfo(float).eps * spread[-1]
    names, used = tuple(np.array(equations.unknowns)[seen]), int(equations.used.sum())
    if lost.any():
        refuse(names, directions[:, lost].T, used)
    try:
        factor = linalg.cho_factor(unit)
    except linalg.LinAlgError:  # as near to lost as rounding shows
        refuse(names, directions[:, :1].T, used)
    scaled = linalg.cho_solve(factor, np.eye(len(unit))) / np.outer(scale[seen], scale[seen])
    inverse[np.ix_(seen, seen)] = scaled
    values[seen] = linalg.cho_solve(factor, vector[seen] / scale[seen]) / scale[seen]
    condition = float(np.sqrt(spread[-1] / spread[0]))
    return Fit(values, inverse, weights, condition, correctable=True)


TRIANGLE = 1e6
"""Condition up to which normal equations suffice to make columns orthonormal."""

RANK_TOLERANCE = 1e-10
"""Singular values of the scaled equations below this share of the largest count as zero."""


def by_orthogonal_columns(equations: NormalEquations, weights: Array, rows: Rows) -> Fit:
    """The solution for given weights; errors grow with the condition, not with its square.

    The triangle that makes the columns orthonormal comes from the normal equations, or, above
    TRIANGLE, from a QR of all rows.

    Args:
        equations: Of all rows.
        weights: W, (C, C).
        rows: Passed over twice, or three times.

    Raises:
        UnseenParameters: The equations do not determine all unknowns; names them.
    """
    matrix: Array = equations.matrix(weights)
    root: Array = np.asarray(np.linalg.cholesky(weights), dtype=np.float64)
    unit, scale = unit_diagonal(matrix)
    factor, failed = linalg.lapack.dpotrf(unit)
    if failed or np.linalg.cond(unit) >= TRIANGLE**2:
        triangle = _triangle(root, scale, rows)
    else:
        triangle = np.triu(factor)
    _, spread, directions = np.linalg.svd(triangle)
    lost = spread <= RANK_TOLERANCE * spread[0]
    if lost.any():
        refuse(equations.unknowns, directions[lost], int(equations.used.sum()))
    lead = linalg.inv(triangle) / scale[:, None]
    values = np.zeros(len(scale))
    for _ in range(2):  # the second time on what the first has left
        gram, vector = np.zeros_like(matrix), np.zeros(len(scale))
        for columns, left in _white(root, lead, values, rows):
            gram += columns.T @ columns
            vector += columns.T @ left
        values = values + lead @ np.linalg.solve(gram, vector)
    inverse = lead @ np.linalg.inv(gram) @ lead.T
    condition = float(spread[0] / spread[-1])
    return Fit(values, inverse, weights, condition, correctable=False)


def _triangle(root: Array, scale: Array, rows: Rows) -> Array:
    """R of a QR of all rows, block after block onto one triangle, (p, p)."""
    triangle = np.zeros((0, len(scale)))
    for columns, _ in _white(root, np.diag(1 / scale), np.zeros(len(scale)), rows):
        triangle = np.asarray(np.linalg.qr(np.vstack([triangle, columns]), mode="r"))
    missing = len(scale) - len(triangle)
    return np.vstack([triangle, np.zeros((missing, len(scale)))])


def _white(root: Array, lead: Array, values: Array, rows: Rows) -> Iterator[tuple[Array, Array]]:
    """Rows with noise of unit covariance: columns @ lead, (k, p), and what values leave, (k,)."""
    for columns, measured in rows(np.column_stack([lead, values])):
        left = measured - columns[..., -1]
        stack = np.concatenate([columns[..., :-1], left[..., None]], axis=2)
        white = np.tensordot(root.T, stack, 1).reshape(-1, stack.shape[2])
        yield white[:, :-1], white[:, -1]


SQUARED = 1e4
"""Condition up to which normal equations and one correction are as good as a QR."""

SOLVERS: tuple[tuple[Solver, float], ...] = (
    (by_normal_equations, SQUARED),
    (by_orthogonal_columns, np.inf),
)
"""Solvers, and the condition up to which each is trusted."""


def solve(equations: NormalEquations, weights: Array, rows: Rows) -> Fit:
    """The solution by the first solver that can be trusted with the equations' condition.

    Args:
        equations: Of all rows.
        weights: W, (C, C).
        rows: Starts a pass over all rows.

    Raises:
        UnseenParameters: The equations do not determine all unknowns; names them.
    """
    *quick, (last, _) = SOLVERS
    for solver, limit in quick:
        try:
            found = solver(equations, weights, rows)
        except UnseenParameters:  # to the precision of sums; the rows may know better
            continue
        if found.condition <= limit and not np.isnan(found.values).any():
            return found
    return last(equations, weights, rows)


def fit(equations: NormalEquations, weights: Mapping[str, float] | None = None) -> Fit:
    """Fit some of the channels, with weights of one's own.

    One channel alone, all but one, or any others: no pass over the samples.

    Args:
        equations: Of a recording; `Estimate.normal_equations`.
        weights: By channel, one over the variance of its noise [N^-2, (N m)^-2]; channels
            that are not named are left out. Default all, by their residuals.

    Raises:
        UnknownName: There is no such channel.
        UnseenParameters: The channels see parameters that they cannot distinguish.
    """
    if weights is None:
        chosen = noise_weights(equations, None)
    else:
        for name in weights:
            if name not in equations.channels:
                raise UnknownName("channel", name, equations.channels)
        chosen = np.diag([float(weights.get(c, 0.0)) for c in equations.channels])
    return by_normal_equations(equations, chosen, lambda combined: iter(()))
