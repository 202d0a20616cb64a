"""One search: a criterion and limits as functions of the unknowns, with derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.excitation.barrier_search import Inside, Point
from testbed.excitation.information import Information
from testbed.excitation.limit_terms import LimitTerm
from testbed.excitation.sampled_rows import SampledRows
from testbed.excitation.samples import Samples
from testbed.excitation.series import Series
from testbed.excitation.stencil import Stencil
from testbed.parameters.rules import Model


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
