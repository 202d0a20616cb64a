"""One search: Fourier coefficients as unknowns, a criterion and limits as functions of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.excitation.barrier_search import Inside, Point
from testbed.excitation.fourier import Fourier, terms
from testbed.excitation.information import Information
from testbed.excitation.limit_terms import LimitTerm
from testbed.excitation.limits import Limits
from testbed.excitation.samples import SampledRows, Samples, Stencil
from testbed.parameters.rules import Model


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
        return np.hstack([self.limits.half[:, None], np.minimum(swing, self.limits.half[:, None])])

    @cached_property
    def motion_of(self) -> Array:
        """What q, qd and qdd have of each unknown, (n, 3, G, p)."""
        basis = [terms(self.fundamental, self.harmonics, self.times, order) for order in range(3)]
        return np.stack(basis)[None] * self.units[:, None, None, :]

    @cached_property
    def linear(self) -> Array:
        """Shares of position, velocity and acceleration limits, (n, 3 G, p), the middle aside."""
        limit = np.stack([self.limits.half, self.limits.velocity, self.limits.acceleration], axis=1)
        return (self.motion_of / limit[:, :, None, None]).reshape(self.joints, -1, self.width)

    @cached_property
    def linear_offset(self) -> Array:
        """What the middle of the ranges takes off them, (n, 3 G)."""
        found = np.zeros((self.joints, 3, self.instants))
        found[:, 0] = (self.limits.middle / self.limits.half)[:, None]
        return found.reshape(self.joints, -1)

    @property
    def linear_most(self) -> float:
        """Largest share at the instants for which `margin` holds between them, too."""
        return float(self.margin * np.cos(np.pi * self.harmonics / self.instants))

    def motion(self, x: Array) -> Fourier:
        """The motion of unknowns, (n p,)."""
        coefficients = self.units * x.reshape(self.joints, self.width)
        return Fourier.of(self.fundamental, coefficients)

    def unknowns(self, motion: Fourier) -> Array:
        """The unknowns of a motion of these frequencies, (n p,)."""
        return np.asarray((motion.coefficients / self.units).ravel())

    def at(self, x: Array) -> Array:
        """q, qd and qdd at the instants, (3, G, n)."""
        each = x.reshape(self.joints, self.width)
        return np.asarray(np.einsum("jdgp,jp->dgj", self.motion_of, each))

    def linear_values(self, x: Array) -> Array:
        """Shares of the linear limits less what is allowed, (n, 2, 3 G): above, below."""
        each = x.reshape(self.joints, self.width)
        share = np.einsum("jrp,jp->jr", self.linear, each) - self.linear_offset
        return np.stack([share, -share], axis=1) - self.linear_most

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
        by_joint = slopes.reshape(len(slopes), 3, self.joints)
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
        along = np.einsum("jrp,jp->jr", self.linear, x.reshape(n, p))
        rest = np.zeros(self.others)
        rest[self.place] = self.dense @ x
        return np.concatenate([np.stack([along, -along], axis=1).ravel(), rest])

    def transposed(self, weights: Array) -> Array:
        """Sum of the limits' derivatives with weights, (n p,)."""
        first, rest = self._split(weights)
        blocks = np.einsum("jrp,jr->jp", self.linear, first[:, 0] - first[:, 1])
        return np.asarray(blocks.ravel() + self.dense.T @ rest)

    def squared(self, weights: Array) -> Array:
        """J' diag(weights) J, (n p, n p)."""
        first, rest = self._split(weights)
        p = self.linear.shape[2]
        found = self.dense.T @ (rest[:, None] * self.dense)
        for j, weight in enumerate(first.sum(axis=1)):
            own = slice(j * p, (j + 1) * p)
            found[own, own] += self.linear[j].T @ (weight[:, None] * self.linear[j])
        return np.asarray(found)

    def _split(self, weights: Array) -> tuple[Array, Array]:
        n, rows, _ = self.linear.shape
        return weights[: 2 * n * rows].reshape(n, 2, rows), weights[2 * n * rows :][self.place]


@dataclass(frozen=True, eq=False)
class Problem:
    """What an interior point method is asked.

    Attributes:
        series: How unknowns make a motion.
        information: What is wanted of it.
        terms: Limits besides those of the series.
        rows: Of the models that information and limits look at.
        stencil: For derivatives.
        names: Of the joints.
    """

    series: Series
    information: Information
    terms: Sequence[LimitTerm]
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
        instants, joints = self.series.instants, self.series.joints
        linear = self.series.linear_values(x).reshape(joints, 2, 3, instants).max(axis=1)
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
            term.slopes(samples).transpose(0, 2, 1).reshape(-1, width) for term in self.terms
        ]
        every = np.concatenate([np.zeros((0, width)), *by_motion])
        place = np.flatnonzero(every.any(axis=1))
        dense = self.series.each(every[place], place % self.series.instants)
        return BlockJacobian(self.series.linear, len(every), place, dense)

    def _samples(self, x: Array, stencil: Stencil | None) -> Samples:
        q, qd, qdd = self.series.at(x)
        return Samples(q, qd, qdd, self.rows, stencil)

    def _limits(self, x: Array, samples: Samples) -> Array:
        values = [term.values(samples).ravel() for term in self.terms]
        return np.concatenate([self.series.linear_values(x).ravel(), *values])
