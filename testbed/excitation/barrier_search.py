"""Minimise a smooth function within smooth limits; every iterate is strictly inside them.

A primal-dual barrier method: Newton's steps on the barrier, the function's own curvature by
damped BFGS, the limits' exactly to first order. A search may be stopped at any time: what it has
is a point that respects all limits.

Source    [NW06] chapters 18 (damped BFGS) and 19 (barrier methods)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from testbed.arrays import Array

WEIGHT = 20.0
"""Of the barrier at first, in all: its share of each limit is this over their number."""
SHRINK = 0.3
"""By which the barrier's weight falls whenever its own minimum is near."""
LAST = 3e-3
"""Of the barrier's weight in all: what it may still cost of the criterion."""
INNER = 12
"""Steps at most for one weight."""
STEPS = 100
"""Of a search at most."""
NEAREST = 0.005
"""Part of the way to a limit that a step must leave."""


class Jacobian(Protocol):
    """Derivatives J of the limits, (m, k), by their products."""

    def times(self, x: Array) -> Array:
        """J x, (m,)."""

    def transposed(self, weights: Array) -> Array:
        """J' w, (k,)."""

    def squared(self, weights: Array) -> Array:
        """J' diag(w) J, (k, k)."""


@dataclass(frozen=True, eq=False)
class Inside:
    """A function and its limits at a point: strictly inside, all are negative.

    Attributes:
        value: Of the function.
        limits: (m,).
    """

    value: float
    limits: Array

    @property
    def holds(self) -> bool:
        """Whether the point is strictly inside."""
        return bool(np.isfinite(self.value) and (self.limits < 0).all())


@dataclass(frozen=True, eq=False)
class Point(Inside):
    """The same with derivatives.

    Attributes:
        x: Where, (k,).
        gradient: Of the function, (k,).
        jacobian: Of the limits.
    """

    x: Array
    gradient: Array
    jacobian: Jacobian


class Search(Protocol):
    """What is to be minimised."""

    def inside(self, x: Array) -> Inside:
        """Without derivatives."""

    def point(self, x: Array) -> Point:
        """With them."""


def minimise(
    search: Search, x: Array, iterations: int = STEPS, stop: Callable[[float], bool] | None = None
) -> Point:
    """A point strictly inside the limits where the function is small.

    Args:
        search: The function and its limits.
        x: Where to start, strictly inside, (k,).
        iterations: Steps at most.
        stop: Asked after every step, with the value reached.

    Raises:
        ValueError: The start is not inside.
    """
    here = search.point(x)
    if not here.holds:
        raise ValueError("the search starts outside the limits")
    count = len(here.limits)
    barrier, inner = WEIGHT / count, 0
    dual = barrier / -here.limits
    curvature = np.eye(len(x))
    for step in range(iterations):
        newton = _newton(here, dual, curvature, barrier)
        if newton is None:
            break
        move, dual_move, slope = newton
        length = _length(search, here, move, slope, barrier)
        if length == 0:
            break
        there = search.point(here.x + length * move)
        dual = _inside_duals(dual, dual_move, there, barrier)
        curvature = _bfgs(curvature, here, there, dual, first=step == 0)
        here, inner = there, inner + 1
        if stop is not None and stop(here.value):
            break
        if -slope < 0.5 * barrier * np.sqrt(count) or inner >= INNER:
            if barrier <= LAST / count:
                break
            barrier, inner = max(SHRINK * barrier, LAST / count), 0
    return here


def _newton(
    here: Point, dual: Array, curvature: Array, barrier: float
) -> tuple[Array, Array, float] | None:
    """Steps of the unknowns and of the duals, and the barrier function's slope along them.

    None where numbers are too coarse for a step: as near to a kink of the limits as can be.
    """
    slack = -here.limits
    ratio = dual / slack
    downhill = -(here.gradient + here.jacobian.transposed(barrier / slack))
    move = _solve(curvature + here.jacobian.squared(ratio), downhill)
    if move is None:
        return None
    along = here.jacobian.times(move)
    return move, barrier / slack - dual + ratio * along, float(-downhill @ move)


def _solve(matrix: Array, right: Array) -> Array | None:
    from scipy.linalg import cho_factor, cho_solve  # half a second to import

    try:
        return np.asarray(cho_solve(cho_factor(matrix, check_finite=False), right))
    except np.linalg.LinAlgError:
        return None


def _length(search: Search, here: Point, move: Array, slope: float, barrier: float) -> float:
    """How far to go so that the barrier function falls; 0 if nowhere."""
    slack, along = -here.limits, here.jacobian.times(move)
    before = here.value - barrier * float(np.log(slack).sum())
    length = min(1.0, 0.99 / max(float((along / slack).max()), 1e-30))
    for _ in range(25):
        there = search.inside(here.x + length * move)
        if there.holds and (-there.limits > NEAREST * slack).all():
            after = there.value - barrier * float(np.log(-there.limits).sum())
            if after <= before + 1e-4 * length * slope:
                return length
        length /= 2
    return 0.0


def _inside_duals(dual: Array, move: Array, there: Point, barrier: float) -> Array:
    """The duals a step on, positive and near what the barrier says."""
    falling = move < 0
    most = float((-dual[falling] / move[falling]).min()) if falling.any() else np.inf
    moved = np.maximum(dual + min(1.0, 0.99 * most) * move, 1e-12)
    central = barrier / -there.limits
    return np.asarray(np.clip(moved, central / 10, 10 * central))


def _bfgs(curvature: Array, here: Point, there: Point, dual: Array, *, first: bool) -> Array:
    """Curvature after a step: of the function and of the limits with their duals."""
    step = there.x - here.x
    change = there.gradient + there.jacobian.transposed(dual)
    change -= here.gradient + here.jacobian.transposed(dual)
    if first:
        curvature = curvature * max(abs(float(change @ step)) / float(step @ step), 1e-3)
    along = curvature @ step
    own, found = float(step @ along), float(change @ step)
    share = 1.0 if found >= 0.2 * own else 0.8 * own / (own - found)
    damped = share * change + (1 - share) * along
    lost, won = np.outer(along, along) / own, np.outer(damped, damped)
    return np.asarray(curvature - lost + won / float(damped @ step))
