"""Information: what independent data say of one robot's parameters adds up.

An estimate is Gaussian in its parameters p = A x, which are combinations of the unknowns x of all
estimates: the largest minimal set among them and the joints' own coefficients, a name one unknown.
Its information is A' C^-1 A, and that of several estimates is the sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError
from testbed.core.base.gaussian import Gaussian
from testbed.core.base.summary_table import SummaryTable
from testbed.core.parameters.minimal_set import MinimalSet

if TYPE_CHECKING:
    from testbed.core.estimation.estimate import Estimate


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Information(Gaussian):
    """Several estimates of one robot as one: `plate + torque`.

    Attributes:
        estimates: Of independent data, at least one.
        matrix: Sum of their information matrices, (p, p).
    """

    estimates: tuple[Estimate, ...]
    matrix: Array

    def __add__(self, other: Information | Estimate) -> Information:
        return added(self.estimates, other)

    @property
    def summary(self) -> SummaryTable:
        """Names, values with sigmas, units."""
        table = super().summary
        sources = " + ".join(each.instrument for each in self.estimates)
        return replace(table, head=f"{table.head} by {sources}")


def added(estimates: Sequence[Estimate], other: Information | Estimate) -> Information:
    """Sum of information; for `__add__`, `NotImplemented` where the other is no estimate.

    Args:
        estimates: Of independent data.
        other: An estimate of other data, or several.
    """
    if not isinstance(other, Gaussian):
        return NotImplemented
    more = other.estimates if isinstance(other, Information) else (other,)
    return information_of((*estimates, *more))


def information_of(estimates: Sequence[Estimate]) -> Information:
    """Sum of what independent estimates of one robot say.

    Args:
        estimates: At least one.

    Raises:
        SettingsError: They are of different robots.
    """
    if len({(each.joints, each.minimal.matrix.shape[1]) for each in estimates}) > 1:
        raise SettingsError("estimates of different robots have no sum")
    minimal = max((each.minimal for each in estimates), key=lambda own: own.count)
    units = dict(zip(minimal.names, minimal.units, strict=True))
    for each in estimates:
        for term in () if each.drives is None else each.drives.asked:
            units[term.name(minimal.robot)] = term.unit(minimal.robot)
    names = tuple(units)
    matrix, vector = np.zeros((len(names),) * 2), np.zeros(len(names))
    for each in estimates:
        known = each.identifiable  # others are free, and are left out with no loss
        rows = combinations(each, minimal, names)[known]
        weighted = np.linalg.solve(each.covariance[np.ix_(known, known)], rows)
        matrix += rows.T @ weighted
        vector += weighted.T @ each.values[known]
    values, covariance, determined = _solution(matrix, vector)
    return Information(
        names=names,
        units=tuple(units.values()),
        values=values,
        covariance=covariance,
        unidentifiable=tuple(np.array(names)[~determined].tolist()),
        estimates=tuple(estimates),
        matrix=matrix,
    )


def _solution(matrix: Array, vector: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Estimate, (p,), covariance, (p, p), and whether each unknown is determined, (p,)."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    powers, basis = np.linalg.eigh(matrix / np.outer(scale, scale))
    # eigenvalue of the scaled information matrix below which a direction is not determined
    sure = powers > 1e-12 * powers[-1]
    inverse = (basis[:, sure] / powers[sure]) @ basis[:, sure].T
    # part of an unknown in such directions from which it is not determined itself
    determined = (np.abs(basis[:, ~sure]) < 1e-4).all(axis=1)
    values = np.where(determined, inverse @ (vector / scale) / scale, np.nan)
    return values, inverse / np.outer(scale, scale), determined


def combinations(
    estimate: Estimate, minimal: MinimalSet, names: Sequence[str]
) -> Array:
    """Parameters of an estimate as combinations of a sum's unknowns, (q, p).

    Args:
        estimate: One of the sum.
        minimal: The largest minimal set of the sum.
        names: Of the unknowns, those of that set first, (p,).
    """
    found, drives = np.zeros((len(estimate.names), len(names))), estimate.drives
    whole = estimate.minimal.matrix if drives is None else drives.matrix
    bodies = estimate.minimal.matrix.shape[1]
    found[:, : minimal.count] = whole[:, :bodies] @ minimal.lift
    if drives is not None:
        places = [names.index(term.name(minimal.robot)) for term in drives.asked]
        found[:, places] = whole[:, bodies:]
    return found
