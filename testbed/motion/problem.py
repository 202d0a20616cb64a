"""One search: Fourier coefficients as unknowns, a criterion and limits as functions of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, block_diag, cho_factor, cho_solve

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.parameters.rules import Model
from testbed.motion.clearance import ClearanceTerm
from testbed.motion.fourier import Fourier, terms
from testbed.motion.information import DesignObjective
from testbed.motion.limits import Limits
from testbed.motion.samples import SampledRows, Samples, Stencil
from testbed.motion.terms import ForceTerm

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
    jacobian: BlockJacobian


def minimise(
    search: InteriorPointProblem,
    x: Array,
    stop: Callable[[float], bool] | None = None,
) -> Point:
    """A point strictly inside the limits where the function is small.

    Args:
        search: The function and its limits.
        x: Where to start, strictly inside, (k,).
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
    for step in range(STEPS):
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
    matrix = curvature + here.jacobian.squared(ratio)
    try:
        move = cho_solve(cho_factor(matrix, check_finite=False), downhill)
    except LinAlgError:
        return None
    along = here.jacobian.times(move)
    return move, barrier / slack - dual + ratio * along, float(-downhill @ move)


def _length(
    search: InteriorPointProblem, here: Point, move: Array, slope: float, barrier: float
) -> float:
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
    return np.clip(moved, central / 10, 10 * central)


def _bfgs(
    curvature: Array, here: Point, there: Point, dual: Array, *, first: bool
) -> Array:
    """Curvature after a step: of the function and of the limits with their duals."""
    step = there.x - here.x
    change = there.gradient + there.jacobian.transposed(dual)
    change -= here.gradient + here.jacobian.transposed(dual)
    if first:
        curvature = curvature * max(
            abs(float(change @ step)) / float(step @ step), 1e-3
        )
    along = curvature @ step
    own, found = float(step @ along), float(change @ step)
    share = 1.0 if found >= 0.2 * own else 0.8 * own / (own - found)
    damped = share * change + (1 - share) * along
    lost, won = np.outer(along, along) / own, np.outer(damped, damped)
    return curvature - lost + won / float(damped @ step)


@dataclass(frozen=True, eq=False)
class Series:
    """How unknowns make a motion: one block of 2 harmonics + 1 unknowns a joint.

    Attributes:
        limits: Of the robot.
        fundamental: Frequency at which the motion repeats [Hz].
        harmonics: Number of harmonics.
        instants: Samples G of a period, more than twice the harmonics.
        margin: Share of the limits that may be used.
    """

    limits: Limits
    fundamental: float
    harmonics: int
    instants: int
    margin: float

    @cached_property
    def times(self) -> Array:
        """The instants, (G,) [s]."""
        return np.arange(self.instants) / (self.instants * self.fundamental)

    @property
    def joints(self) -> int:
        """Number n of joints."""
        return len(self.limits.low)

    @property
    def width(self) -> int:
        """Unknowns p of a joint."""
        return 2 * self.harmonics + 1

    @cached_property
    def units(self) -> Array:
        """What an unknown of one is as a coefficient, (n, p) [rad or m]."""
        pulses = 2 * np.pi * self.fundamental * np.arange(1, self.harmonics + 1)
        swing = np.tile(self.limits.velocity[:, None] / pulses, 2)
        return np.hstack(
            [self.limits.half[:, None], np.minimum(swing, self.limits.half[:, None])]
        )

    @cached_property
    def motion_of(self) -> Array:
        """What q, qd and qdd have of each unknown, (n, 3, G, p)."""
        basis = [
            terms(self.fundamental, self.harmonics, self.times, order)
            for order in range(3)
        ]
        return np.stack(basis)[None] * self.units[:, None, None, :]

    @cached_property
    def linear(self) -> Array:
        """Shares of position, velocity and acceleration limits, (n, 3 G, p), the middle aside."""
        limits = self.limits
        limit = np.stack([limits.half, limits.velocity, limits.acceleration], axis=1)
        return (self.motion_of / limit[:, :, None, None]).reshape(
            self.joints, -1, self.width
        )

    def motion(self, x: Array) -> Fourier:
        """The motion of unknowns, (n p,)."""
        coefficients = self.units * x.reshape(self.joints, self.width)
        return Fourier.of(self.fundamental, coefficients)

    def unknowns(self, motion: Fourier) -> Array:
        """The unknowns of a motion of these frequencies, (n p,)."""
        return (motion.coefficients / self.units).ravel()

    def at(self, x: Array) -> Motion:
        """The motion at the instants."""
        each = x.reshape(self.joints, self.width)
        return Motion(self.times, *np.einsum("jdgp,jp->dgj", self.motion_of, each))

    def linear_values(self, x: Array) -> Array:
        """Shares of the linear limits less what is allowed, (n, 2, 3, G): above, below.

        What is allowed at the instants is so much less that the margin holds between them, too.
        """
        share = self.linear @ x.reshape(self.joints, self.width, 1)
        share = share.reshape(self.joints, 3, self.instants)
        share[:, 0] -= (self.limits.middle / self.limits.half)[:, None]
        most = self.margin * np.cos(np.pi * self.harmonics / self.instants)
        return np.asarray(np.stack([share, -share], axis=1) - most)

    def pulled(self, slopes: Array) -> Array:
        """Derivatives by the unknowns, (..., n p), of derivatives by motion, (..., 3 n, G).

        Summed over the instants.
        """
        lead = slopes.shape[:-2]
        by_joint = slopes.reshape(*lead, 3, self.joints, self.instants)
        found = np.einsum("...djg,jdgp->...jp", by_joint, self.motion_of)
        return np.asarray(found.reshape(*lead, -1))

    def each(self, slopes: Array, instants: NDArray[np.int64]) -> Array:
        """The same instant by instant: of (r, 3 n) at the instants (r,), (r, n p).

        Args:
            slopes: Derivatives by motion, (r, 3 n).
            instants: Number of the instant of each, (r,).
        """
        by_joint = slopes.reshape(-1, 3, self.joints)
        found = np.zeros((len(slopes), self.joints, self.width))
        for order in range(3):
            there = self.motion_of[:, order, instants].transpose(1, 0, 2)  # (r, n, p)
            found += by_joint[:, order, :, None] * there
        return found.reshape(len(slopes), -1)


@dataclass(frozen=True, eq=False)
class BlockJacobian:
    """Derivatives of all limits: blocks joint by joint for linear ones, rows for others.

    Attributes:
        linear: (n, 3 G, p); each counts twice, above and below.
        others: How many other limits there are.
        place: Which of them have derivatives, (r,): a pair of bodies that is far apart has none.
        dense: Those, (r, n p).
    """

    linear: Array
    others: int
    place: NDArray[np.int64]
    dense: Array

    def times(self, x: Array) -> Array:
        """Of a direction, (n p,): how all limits change."""
        n, _, p = self.linear.shape
        along = (self.linear @ x.reshape(n, p, 1))[:, :, 0]
        rest = np.zeros(self.others)
        rest[self.place] = self.dense @ x
        return np.concatenate([np.stack([along, -along], axis=1).ravel(), rest])

    def transposed(self, weights: Array) -> Array:
        """Sum of the limits' derivatives with weights, (n p,)."""
        (above, below), rest = self._split(weights)
        blocks = (above - below)[:, None] @ self.linear
        return np.asarray(blocks.ravel() + rest @ self.dense)

    def squared(self, weights: Array) -> Array:
        """J' diag(weights) J, (n p, n p)."""
        (above, below), rest = self._split(weights)
        blocks = self.linear.transpose(0, 2, 1) @ (
            (above + below)[:, :, None] * self.linear
        )
        return np.asarray(
            block_diag(*blocks) + self.dense.T @ (rest[:, None] * self.dense)
        )

    def _split(self, weights: Array) -> tuple[Array, Array]:
        """Weights above and below, (2, n, 3 G), and those of the others with derivatives, (r,)."""
        n, rows, _ = self.linear.shape
        first, rest = np.split(weights, [2 * n * rows])
        return first.reshape(n, 2, rows).swapaxes(0, 1), rest[self.place]


@dataclass(frozen=True, eq=False)
class InteriorPointProblem:
    """Design of a motion as a problem for the interior point method.

    Attributes:
        series: How unknowns make a motion.
        information: What is wanted of it.
        terms: Limits besides those of the series.
        rows: Of the models that information and limits look at.
        stencil: For derivatives.
        names: Of the joints.
    """

    series: Series
    information: DesignObjective
    terms: Sequence[ForceTerm | ClearanceTerm]
    rows: Mapping[Model, SampledRows]
    stencil: Stencil
    names: tuple[str, ...]

    def inside(self, x: Array) -> Inside:
        """Criterion and limits at x."""
        samples = self._samples(x, None)
        return Inside(self.information.value(samples), self._limits(x, samples))

    def point(self, x: Array) -> Point:
        """The same with derivatives."""
        samples = self._samples(x, self.stencil)
        return Point(
            x=x,
            value=self.information.value(samples),
            gradient=self.series.pulled(self.information.slopes(samples)),
            limits=self._limits(x, samples),
            jacobian=self._jacobian(samples),
        )

    def worst(self, x: Array) -> tuple[str, float, float]:
        """The limit that is nearest or most exceeded: its label, instant [s], share over it."""
        instants = self.series.instants
        linear = self.series.linear_values(x).max(axis=1)
        samples = self._samples(x, None)
        kinds = ("position", "velocity", "acceleration")
        labels = [f"{kind} of '{name}'" for name in self.names for kind in kinds]
        values = [linear.reshape(-1, instants)]
        for term in self.terms:
            labels += term.labels
            values.append(term.values(samples))
        every = np.concatenate(values)
        k, g = np.unravel_index(int(every.argmax()), every.shape)
        return labels[k], float(self.series.times[g]), float(every[k, g])

    def _jacobian(self, samples: Samples) -> BlockJacobian:
        width = 3 * self.series.joints
        by_motion = [
            term.slopes(samples).transpose(0, 2, 1).reshape(-1, width)
            for term in self.terms
        ]
        every = np.concatenate([np.zeros((0, width)), *by_motion])
        place = np.flatnonzero(every.any(axis=1))
        dense = self.series.each(every[place], place % self.series.instants)
        return BlockJacobian(self.series.linear, len(every), place, dense)

    def _samples(self, x: Array, stencil: Stencil | None) -> Samples:
        return Samples(self.series.at(x), self.rows, stencil)

    def _limits(self, x: Array, samples: Samples) -> Array:
        values = [term.values(samples).ravel() for term in self.terms]
        return np.concatenate([self.series.linear_values(x).ravel(), *values])
