"""Information matrices: the sum of independent estimates of one robot.

The parameters of an estimate are Gaussian, with covariance C, and are linear combinations p = A x
of common unknowns x: the largest minimal set among the estimates and the coefficients of the joint
laws, one unknown per name. The information matrix of an estimate is A' C^-1 A; those of independent
estimates are added.
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
    """Combination of independent estimates of one robot, such as `plate + torque`.

    Attributes:
        estimates: Estimates of independent data, at least one.
        matrix: Sum of the estimates' information matrices, (p, p).
    """

    estimates: tuple[Estimate, ...]
    matrix: Array

    def __add__(self, other: Information | Estimate) -> Information:
        """Combine with another independent estimate by adding information matrices."""
        return information_sum(self.estimates, other)

    @property
    def summary(self) -> SummaryTable:
        """Table of names, values with sigmas and units."""
        table = super().summary
        sources = " + ".join(each.instrument for each in self.estimates)
        return replace(table, title=f"{table.title} by {sources}")


def information_sum(
    estimates: Sequence[Estimate], other: Information | Estimate
) -> Information:
    """Combination of independent estimates, or `NotImplemented` if `other` is no estimate.

    Args:
        estimates: Estimates of independent data.
        other: Estimate of other data, or a combination of estimates.
    """
    if not isinstance(other, Gaussian):
        return NotImplemented
    other_estimates = other.estimates if isinstance(other, Information) else (other,)
    return combine_estimates((*estimates, *other_estimates))


def combine_estimates(estimates: Sequence[Estimate]) -> Information:
    """Combine independent estimates of one robot by adding their information matrices.

    Unidentifiable parameters of an estimate are left out. Unknowns that the sum does not determine
    are nan.

    Args:
        estimates: Estimates, at least one.

    Raises:
        SettingsError: The estimates are of different robots.
    """
    if len({(each.joints, each.minimal.matrix.shape[1]) for each in estimates}) > 1:
        raise SettingsError("estimates of different robots have no sum")
    minimal = max((each.minimal for each in estimates), key=lambda item: item.count)
    units = dict(zip(minimal.names, minimal.units, strict=True))
    for each in estimates:
        for term in () if each.drives is None else each.drives.asked:
            units[term.name(minimal.robot)] = term.unit(minimal.robot)
    names = tuple(units)
    matrix, vector = np.zeros((len(names),) * 2), np.zeros(len(names))
    for each in estimates:
        identifiable = each.identifiable  # the others carry no information
        rows = combination_matrix(each, minimal, names)[identifiable]
        weighted = np.linalg.solve(
            each.covariance[np.ix_(identifiable, identifiable)], rows
        )
        matrix += rows.T @ weighted
        vector += weighted.T @ each.values[identifiable]
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
    """Solve the summed normal equations and mark undetermined unknowns.

    The matrix is scaled to unit diagonal. Directions with eigenvalues up to 1e-12 of the largest
    are undetermined, and unknowns with a component of at least 1e-4 in such a direction are nan.

    Args:
        matrix: Information matrix, (p, p).
        vector: Right-hand side, (p,).

    Returns:
        Values, (p,), covariance, (p, p), and a mask of the determined unknowns, (p,).
    """
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    eigenvalues, eigenvectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    # eigenvalue of the scaled information matrix below which a direction is not determined
    resolved = eigenvalues > 1e-12 * eigenvalues[-1]
    inverse = (eigenvectors[:, resolved] / eigenvalues[resolved]) @ eigenvectors[
        :, resolved
    ].T
    # part of an unknown in such directions from which it is not determined itself
    determined = (np.abs(eigenvectors[:, ~resolved]) < 1e-4).all(axis=1)
    values = np.where(determined, inverse @ (vector / scale) / scale, np.nan)
    return values, inverse / np.outer(scale, scale), determined


def combination_matrix(
    estimate: Estimate, minimal: MinimalSet, names: Sequence[str]
) -> Array:
    """Matrix from the common unknowns to the parameters of an estimate, (q, p).

    Args:
        estimate: One of the combined estimates, with q parameters.
        minimal: Largest minimal set of the combined estimates.
        names: Names of the unknowns, the parameters of that set first, (p,).
    """
    matrix, drives = np.zeros((len(estimate.names), len(names))), estimate.drives
    combinations = estimate.minimal.matrix if drives is None else drives.matrix
    body_count = estimate.minimal.matrix.shape[1]
    matrix[:, : minimal.count] = combinations[:, :body_count] @ minimal.lift
    if drives is not None:
        term_indices = [names.index(term.name(minimal.robot)) for term in drives.asked]
        matrix[:, term_indices] = combinations[:, body_count:]
    return matrix
