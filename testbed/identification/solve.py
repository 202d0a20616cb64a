"""Weighted least squares with scaled columns; weights from the residuals themselves.

Source    [FRS96] eq. (14), by QR instead of the normal equations
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.errors import UnseenParameters
from testbed.identification.prepare import Channel, Equations

REWEIGHTINGS = 3
"""Passes in which the channels' noise levels are estimated from the residuals."""

RANK_TOLERANCE = 1e-6
"""Singular values of the scaled equations below this share of the largest count as zero."""

_PART = 0.1  # an unknown with a larger part in a direction that the data miss is named
_FLOOR = 1e-14  # least noise level of a channel, relative to the channel's rms


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
        noise = np.array(
            [
                _level(channel, residual, len(equations.unknowns) / len(equations.channels))
                for channel, residual in zip(equations.channels, solution.residuals, strict=True)
            ]
        )
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


def _level(channel: Channel, residual: Array, unknowns: float) -> float:
    """Noise level of a channel; never below rounding."""
    used = residual[channel.used]
    size = float(np.sqrt(np.mean(channel.measured[channel.used] ** 2))) if used.size else 1.0
    free = max(used.size - unknowns, 1.0)
    return max(float(np.sqrt(np.sum(used**2) / free)), _FLOOR * size, np.finfo(float).tiny)
