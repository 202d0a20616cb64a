"""Newton's method for bodies near a prior's, inside what bodies can be.

    |B z - b|^2 / 2 + w sum over bodies D(Y) + penalties of the joints' terms

over y with z = z0 + N y, Y the matrices whose coordinates z holds, one at the prior. D is the
log-determinant divergence tr Y - log det Y, which is its own barrier, or half the Frobenius
norm of Y - 1, squared, which has a barrier -log det Y that fades; bounds rows z >= least have
such a one, too.

Source    [LWP20] for the divergence; barriers and Newton's method with line search as in S. Boyd
          and L. Vandenberghe, Convex optimization (2004), sections 9.5 and 11.3
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from testbed.arrays import Array
from testbed.identification.consistency.options import Metric
from testbed.parameters.pseudo_inertia import OF_COORDINATES, coordinates, of_coordinates

DONE = 1e-12
"""Newton's decrement, squared, of the last step."""

ROUGH = 0.05
"""The same of steps on the way, in parts of the weight."""

STEPS = 100
"""Most steps with one weight; a dozen is much."""

FALL = 10.0
"""By which weights fall."""

FADED = 1e-9
"""The last weight of the barriers."""

EDGE = 1e-6
"""Eigenvalue of Y at which the Frobenius norm's barrier stands."""


@dataclass(frozen=True, eq=False)
class Program:
    """What is to be minimised, in coordinates near one.

    Attributes:
        metric: Which D.
        bodies: z begins with ten coordinates of so many Y.
        rows: B, (k, m).
        right: b, (k,).
        weight: w, of each body's divergence.
        pull: Weight of (z - 1)^2 / 2, of the joints' terms, (m - 10 bodies,).
        free: N, (m, k): what exact conditions leave free.
        bound_rows: (c, m).
        bounds: (c,).
    """

    metric: Metric
    bodies: int
    rows: Array
    right: Array
    weight: float
    pull: Array
    free: Array
    bound_rows: Array
    bounds: Array

    @cached_property
    def square(self) -> Array:
        """B' B, (m, m)."""
        return np.asarray(self.rows.T @ self.rows)

    @property
    def fades(self) -> bool:
        """Whether there are barriers that are no part of the program."""
        return bool(len(self.bounds)) or self.metric == "frobenius"

    def matrices(self, z: Array) -> Array:
        """Y, (bodies, 4, 4)."""
        return of_coordinates(z[: 10 * self.bodies].reshape(-1, 10))

    def prior_hessian(self, z: Array, barrier: float = 0.0) -> Array:
        """Of divergence and penalties at z, (m, m).

        Args:
            z: Inside, (m,).
            barrier: Weight of the Frobenius norm's barrier.
        """
        found = np.zeros((len(z), len(z)))
        plain, curved, shift = self._shares(barrier)
        inverse = np.linalg.inv(self.matrices(z) - shift * np.eye(4))
        turned = np.einsum("nab,kbc,ncd->nkad", inverse, OF_COORDINATES, inverse)
        for body, block in enumerate(curved * coordinates(turned)):
            at = slice(10 * body, 10 * body + 10)
            found[at, at] = block + plain * np.eye(10)
        rest = np.arange(10 * self.bodies, len(z))
        found[rest, rest] = self.pull
        return found

    def _shares(self, barrier: float) -> tuple[float, float, float]:
        """Weights of the square and of -log det, and where the latter stands."""
        if self.metric == "log-det":
            return 0.0, self.weight, 0.0
        return self.weight, barrier, EDGE

    def _prior_slope(self, z: Array, barrier: float) -> Array:
        rest = 10 * self.bodies
        slope = np.empty_like(z)
        plain, curved, shift = self._shares(barrier)
        own = self.matrices(z)
        gap = -curved * np.linalg.inv(own - shift * np.eye(4))
        gap += curved * np.eye(4) if not plain else plain * (own - np.eye(4))
        slope[:rest] = coordinates(np.asarray(gap)).ravel()
        slope[rest:] = self.pull * (z[rest:] - 1)
        return slope

    def _value(self, z: Array, barrier: float) -> float:
        """Infinite where z is not inside."""
        slack = self.bound_rows @ z - self.bounds
        if (slack <= 0).any():
            return np.inf
        plain, curved, shift = self._shares(barrier)
        own = self.matrices(z)
        try:
            roots = np.linalg.cholesky(own - shift * np.eye(4))
        except np.linalg.LinAlgError:
            return np.inf
        rest = 10 * self.bodies
        spread = -2 * curved * np.log(np.einsum("nkk->nk", roots)).sum()
        away = curved * np.einsum("nkk->", own) if not plain else 0.0
        away += plain * ((own - np.eye(4)) ** 2).sum() / 2
        terms = (self.pull * (z[rest:] - 1) ** 2).sum() / 2
        fit = ((self.rows @ z - self.right) ** 2).sum() / 2
        return float(fit + spread + away + terms - barrier * np.log(slack).sum())

    def step(self, z: Array, barrier: float) -> tuple[Array, float]:
        """Newton's step, (m,), and its decrement squared."""
        slack = self.bound_rows @ z - self.bounds
        scaled = self.bound_rows / slack[:, None]
        slope = self.rows.T @ (self.rows @ z - self.right) + self._prior_slope(z, barrier)
        slope -= barrier * scaled.sum(axis=0)
        hessian = self.square + self.prior_hessian(z, barrier) + barrier * scaled.T @ scaled
        inner = self.free.T @ hessian @ self.free
        across = self.free.T @ slope
        size = 1 / np.sqrt(np.maximum(np.diagonal(inner), np.finfo(float).tiny))
        factor = linalg.cho_factor(inner * np.outer(size, size) + 1e-15 * np.eye(len(size)))
        move = -size * linalg.cho_solve(factor, size * across)
        return self.free @ move, float(-across @ move)

    def along(self, z: Array, move: Array, gain: float, barrier: float) -> Array | None:
        """The point a line search finds; None where no step gains any more."""
        here, length = self._value(z, barrier), 1.0
        while length > 1e-10:
            there = z + length * move
            if self._value(there, barrier) <= here - 0.01 * length * gain:
                return there
            length /= 2
        return None


def nearest(program: Program, start: Array) -> tuple[Array, float]:
    """Where the program is least, (m,), and how many sigmas are left to be gained there.

    Data alone would throw the bodies at once to the edge of what can be, along which Newton's
    steps are short. So the prior has a large weight first, which then falls to its own.

    Args:
        program: What is to be minimised.
        start: Inside: all Y positive definite, bounds and exact conditions obeyed, (m,).
    """
    z, gain = start, np.inf
    for weight, barrier in _stages(program, start):
        stage = replace(program, weight=weight, pull=program.pull * weight / program.weight)
        last = weight == program.weight and barrier == FADED
        enough = DONE if last else ROUGH * max(barrier, FADED)
        for _ in range(STEPS):
            move, gain = stage.step(z, barrier)
            if gain <= enough:
                break
            there = stage.along(z, move, gain, barrier)
            if there is None:  # rounding is all that is left
                break
            z = there
    return z, float(np.sqrt(max(gain, 0.0)))


def _stages(program: Program, start: Array) -> Iterator[tuple[float, float]]:
    """Weights of the prior and of the barriers, one pair after the other."""
    weight = max(program.weight, program.step(start, program.weight)[1] / 10)
    while weight > program.weight:
        yield weight, weight
        weight = max(weight / FALL, program.weight)
    barrier = program.weight
    while program.fades and barrier > FADED:
        yield program.weight, barrier
        barrier /= FALL
    yield program.weight, FADED
