"""Weighted least squares with scaled columns; weights from the residuals themselves.

Source    [FRS96] eq. (14), by QR instead of the normal equations
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.errors import UnseenParameters
from testbed.identification.prepare import Equations

REWEIGHTINGS = 3
"""Passes in which the channels' noise levels are estimated from the residuals."""

RANK_TOLERANCE = 1e-6
"""Singular values of the scaled equations below this share of the largest count as zero."""

_PART = 0.1  # an unknown with a larger part in a direction that the data miss is named
_FLOOR = 1e-15  # least noise level of a channel, relative to the largest measurement


@dataclass(frozen=True, eq=False)
class Solution:
    """Least-squares solution of `Equations`.

    Attributes:
        values: (p,).
        noise: Noise level of each channel, (channels,) in its own unit.
        residuals: measured - columns @ values, one (M',) a channel.
        normal: Inverse of the weighted normal matrix, (p, p).
        condition: Of the weighted equations with unit columns.
        rank: Their numerical rank.
    """

    values: Array
    noise: Array
    residuals: tuple[Array, ...]
    normal: Array
    condition: float
    rank: int


def solve(equations: Equations) -> Solution:
    """Solve, re-estimating each channel's noise level from its residuals.

    Raises:
        UnseenParameters: The equations do not determine all unknowns; names them.
    """
    noise = np.ones(len(equations.channels))
    solution = _weighted(equations, noise)
    for _ in range(REWEIGHTINGS):
        noise = _levels(equations, solution.residuals)
        solution = _weighted(equations, noise)
    return solution


def _weighted(equations: Equations, noise: Array) -> Solution:
    stack = zip(equations.channels, noise, strict=True)
    rows = [(c.columns[c.used] / level, c.measured[c.used] / level) for c, level in stack]
    a, b = np.vstack([r[0] for r in rows]), np.concatenate([r[1] for r in rows])
    scale = np.linalg.norm(a, axis=0)
    scale[scale == 0] = 1.0
    q, r = np.linalg.qr(a / scale)
    _, spread, directions = np.linalg.svd(r)
    _check_rank(equations, spread, directions, len(b))
    inverse = np.linalg.inv(r)
    scaled = inverse @ (q.T @ b)
    scaled += inverse @ (q.T @ (b - (a / scale) @ scaled))  # one refinement
    values = scaled / scale
    return Solution(
        values=values,
        noise=noise,
        residuals=tuple(c.measured - c.columns @ values for c in equations.channels),
        normal=(inverse @ inverse.T) / np.outer(scale, scale),
        condition=float(spread[0] / spread[-1]),
        rank=len(spread),
    )


def _check_rank(equations: Equations, spread: Array, directions: Array, rows: int) -> None:
    p = len(equations.unknowns)
    spread = np.pad(spread, (0, p - len(spread)))
    rank = int(np.sum(spread > RANK_TOLERANCE * spread[0]))
    if rank < p:
        parts = np.abs(directions[rank:]).max(axis=0)
        unseen = [
            name for name, part in zip(equations.unknowns, parts, strict=True) if part > _PART
        ]
        raise UnseenParameters(unseen, rank, p, rows)


def _levels(equations: Equations, residuals: Sequence[Array]) -> Array:
    """Noise level of every channel, (channels,); never below rounding."""
    share = len(equations.unknowns) / len(equations.channels)
    pairs = list(zip(equations.channels, residuals, strict=True))
    free = np.array([max(c.used.sum() - share, 1.0) for c, _ in pairs])
    spread = np.sqrt([np.sum(r[c.used] ** 2) for c, r in pairs] / free)
    largest = max(float(np.abs(c.measured).max()) for c, _ in pairs)
    levels: Array = np.maximum(spread, _FLOOR * largest or 1.0)
    return levels
