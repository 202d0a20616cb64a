"""Information: what independent data say of one robot's parameters adds up.

An estimate is Gaussian in its parameters p = A x, which are combinations of the unknowns x of all
estimates: the largest minimal set among them and the joints' own coefficients, a name one unknown.
Its information is A' C^-1 A, and that of several estimates is the sum.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError
from testbed.core.base.summary_table import Summarized, SummaryTable, parameter_rows
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.robot.tree import Tree

SINGULAR = 1e-12
"""Eigenvalue of the scaled information matrix below which a direction is not determined."""

UNDETERMINED = 1e-4
"""Part of an unknown in such directions from which it is not determined itself."""


@runtime_checkable
class Evidence(Protocol):
    """An estimate, as a sum takes it."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its parameters, (q,)."""

    @property
    def values(self) -> Array:
        """(q,)."""

    @property
    def sigma(self) -> Array:
        """Standard deviations, (q,); infinite where the data leave a parameter open."""

    @property
    def covariance(self) -> Array:
        """(q, q)."""

    @property
    def minimal(self) -> MinimalSet:
        """The minimal set that comes first."""

    @property
    def drives(self) -> DriveSet | None:
        """That set with the joints' own terms."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the robot's joints."""

    @property
    def instrument(self) -> str:
        """What it was measured by."""


@dataclass(frozen=True, eq=False, repr=False)
class Information(Summarized):
    """Several estimates of one robot as one: `plate + torque`.

    Attributes:
        estimates: Of independent data, at least one.
    """

    estimates: tuple[Evidence, ...]

    def __post_init__(self) -> None:
        sizes = {each.minimal.matrix.shape[1] for each in self.estimates}
        if len({each.joints for each in self.estimates}) > 1 or len(sizes) > 1:
            raise SettingsError("estimates of different robots have no sum")

    def __add__(self, other: Information | Evidence) -> Information:
        if isinstance(other, Information):
            return Information((*self.estimates, *other.estimates))
        if isinstance(other, Evidence):
            return Information((*self.estimates, other))
        return NotImplemented

    @property
    def robot(self) -> Tree:
        """The robot."""
        return self._largest.minimal.robot

    @cached_property
    def _largest(self) -> Evidence:
        return max(self.estimates, key=lambda each: each.minimal.count)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns, (p,)."""
        return tuple(self._units)

    @property
    def units(self) -> tuple[str, ...]:
        """One an unknown."""
        return tuple(self._units.values())

    @cached_property
    def _units(self) -> dict[str, str]:
        minimal = self._largest.minimal
        units = dict(zip(minimal.names, minimal.units, strict=True))
        for each in self.estimates:
            drives = each.drives
            for term in () if drives is None else drives.asked:
                units[term.name(each.minimal.robot)] = term.unit(each.minimal.robot)
        return units

    def rows(self, estimate: Evidence) -> Array:
        """Parameters of an estimate as combinations of the unknowns, (q, p).

        Args:
            estimate: One of the sum.
        """
        lift, drives = self._largest.minimal.lift, estimate.drives
        matrix = np.zeros((len(estimate.names), len(self.names)))
        count = self._largest.minimal.count
        if drives is None:
            matrix[:, :count] = estimate.minimal.matrix @ lift
            return matrix
        bodies = estimate.minimal.matrix.shape[1]
        matrix[:, :count] = drives.matrix[:, :bodies] @ lift
        places = [self.names.index(term.name(estimate.minimal.robot)) for term in drives.asked]
        matrix[:, places] = drives.matrix[:, bodies:]
        return matrix

    @cached_property
    def _sums(self) -> tuple[Array, Array]:
        """Information matrix, (p, p), and that times the estimate, (p,)."""
        matrix, vector = np.zeros((len(self.names),) * 2), np.zeros(len(self.names))
        for each in self.estimates:
            known = np.isfinite(each.sigma)  # others are free, and are left out with no loss
            rows = self.rows(each)[known]
            weighted = np.linalg.solve(each.covariance[np.ix_(known, known)], rows)
            matrix += rows.T @ weighted
            vector += weighted.T @ each.values[known]
        return matrix, vector

    @property
    def matrix(self) -> Array:
        """Information matrix, the inverse of a covariance, (p, p)."""
        return self._sums[0]

    @cached_property
    def _solution(self) -> tuple[Array, Array, Array]:
        """Estimate, covariance, and whether each unknown is determined."""
        matrix, vector = self._sums
        scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
        powers, basis = np.linalg.eigh(matrix / np.outer(scale, scale))
        sure = powers > SINGULAR * powers[-1]
        inverse = (basis[:, sure] / powers[sure]) @ basis[:, sure].T
        determined = (np.abs(basis[:, ~sure]) < UNDETERMINED).all(axis=1)
        values = np.where(determined, inverse @ (vector / scale) / scale, np.nan)
        return values, inverse / np.outer(scale, scale), determined

    @property
    def values(self) -> Array:
        """Estimate of the unknowns, (p,)."""
        return self._solution[0]

    @property
    def covariance(self) -> Array:
        """Of the unknowns that are determined, (p, p)."""
        return self._solution[1]

    @property
    def sigma(self) -> Array:
        """Standard deviations, (p,); infinite where the data do not determine an unknown."""
        _, covariance, determined = self._solution
        spread = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        return np.where(determined, spread, np.inf)

    @property
    def summary(self) -> SummaryTable:
        """Names, values with sigmas, units."""
        sources = " + ".join(each.instrument for each in self.estimates)
        return SummaryTable(
            f"{len(self.names)} parameters by {sources}",
            parameter_rows(self.names, self.values, self.sigma, self.units),
        )
