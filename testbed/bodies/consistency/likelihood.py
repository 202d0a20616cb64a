"""Gaussian likelihoods of standard parameters from estimates: whitened linear equations.

Minimal parameters are linear in the standard parameters and in the joint terms. Parameters that an
estimate assumes to be zero give equations as well, as far as the measured forces identify them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space

from testbed.core.base.arrays import Array
from testbed.core.dynamics.drive_set import make_drive_set
from testbed.core.estimation.diagnostics.rigid_bodies import MIN_RELATIVE_MAGNITUDE
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import (
    inverse_square_root,
    unit_diagonal,
)
from testbed.core.parameters.minimal_set import minimal_set, selection
from testbed.core.parameters.rules import SIGNALS
from testbed.core.parameters.symbols import forms_on_standard, parameter_scale
from testbed.core.robot.friction import JointTerm
from testbed.core.robot.tree import Tree

MIN_RELATIVE_SIGMA = 1e-7
"""Smallest relative standard deviation of a parameter; smaller values are rounding."""


UNIDENTIFIABLE_SIGMA = 10.0
"""Relative standard deviation of parameters that are not identifiable."""

EIGENVALUE_TOLERANCE = 1e-14
"""Largest ratio of a negative eigenvalue of a covariance to the greatest that is rounding."""


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Gaussian likelihood of x from one estimate.

    The vector x consists of the standard parameters, then the joint terms.

    Attributes:
        estimate: Estimate.
        rows: Matrix from the m entries of x to the p parameters of the estimate, (p, m).
        whitening: Whitening matrix of the estimate's errors, (p, p).
        zero_rows: Matrix from x to the k linear combinations that the estimate assumes to be zero,
            (k, m).
        sigma_factor: Factor on the estimate's sigmas that accounts for a contradiction with another
            estimate.
    """

    estimate: Estimate
    rows: Array
    whitening: Array
    zero_rows: Array
    sigma_factor: float = 1.0

    def whitened_residuals(self, x: Array) -> Array:
        """Whitened residuals of the estimate for given parameters, (p,).

        Args:
            x: Standard parameters and joint terms, (m,).
        """
        return self.whitening @ (self.rows @ x - self.estimate.values)


def has_valid_covariance(estimate: Estimate) -> bool:
    """Test whether an estimate's covariance is positive semidefinite up to rounding.

    With hardly more rows than unknowns the noise cannot be estimated, and variances of some
    combinations become zero or negative.

    Args:
        estimate: Estimate of either method.
    """
    variance = np.diagonal(estimate.covariance)
    if (variance < 0).any():
        return False
    size = np.linalg.eigvalsh(unit_diagonal(estimate.covariance)[0])
    return bool(size[0] >= -EIGENVALUE_TOLERANCE * size[-1])


def joint_terms_of(estimates: Sequence[Estimate]) -> tuple[JointTerm, ...]:
    """Joint torque terms of several estimates, without duplicates.

    Args:
        estimates: Estimates of one robot.
    """
    asked = (t for e in estimates if e.drives is not None for t in e.drives.asked)
    return tuple(dict.fromkeys(asked))


def likelihood_of(
    tree: Tree, estimate: Estimate, terms: tuple[JointTerm, ...]
) -> Likelihood:
    """Gaussian likelihood of standard parameters and joint terms from an estimate.

    The variance of each parameter is increased by the square of 1e-7 times its magnitude, or of ten
    times its magnitude if the parameter is not identifiable.

    Args:
        tree: Robot; its inertias are not used.
        estimate: Estimate of either method.
        terms: Joint terms in the order of x.
    """
    parameter_rows, zero_rows = _estimate_and_zero_rows(tree, estimate)
    drives = estimate.drives
    asked = () if drives is None else drives.asked
    term_columns = [10 * tree.n + terms.index(term) for term in asked]

    def coefficients_on_x(rows: Array) -> Array:
        coefficients = np.zeros((len(rows), 10 * tree.n + len(terms)))
        coefficients[:, : 10 * tree.n] = forms_on_standard(tree, rows[:, : 10 * tree.n])
        coefficients[:, term_columns] = rows[:, 10 * tree.n :]
        return coefficients

    size = parameter_scale(estimate.values, estimate.units, MIN_RELATIVE_MAGNITUDE)
    is_unidentifiable = [name in estimate.unidentifiable for name in estimate.names]
    min_variance = (
        np.where(is_unidentifiable, UNIDENTIFIABLE_SIGMA, MIN_RELATIVE_SIGMA) * size
    ) ** 2
    white = inverse_square_root(estimate.covariance + np.diag(min_variance)).T
    return Likelihood(
        estimate, coefficients_on_x(parameter_rows), white, coefficients_on_x(zero_rows)
    )


def with_widened_torques(likelihoods: Sequence[Likelihood]) -> list[Likelihood]:
    """Likelihoods with the sigmas of joint torques widened for contradictions with the plate.

    Errors of torque constants and of the friction law bias the bodies that torques identify, but
    the sigmas of the torque estimate do not include this bias. The sigmas are therefore multiplied
    by the rms normalised difference of the parameters that both methods determine, if it exceeds
    one. The likelihood of a single method is unchanged.

    Args:
        likelihoods: Likelihoods from one method or from both methods.
    """
    by_method = {each.estimate.method: each for each in likelihoods}
    if len(by_method) < len(SIGNALS):
        return list(likelihoods)
    torque_likelihood = by_method["torque"]
    inflation = _rms_difference(
        by_method["wrench"].estimate, torque_likelihood.estimate
    )
    widened = replace(
        torque_likelihood,
        whitening=torque_likelihood.whitening / inflation,
        sigma_factor=inflation,
    )
    return [widened if each is torque_likelihood else each for each in likelihoods]


def _rms_difference(plate: Estimate, torques: Estimate) -> float:
    """Rms normalised difference of parameters that both methods determine; at least one.

    Parameters that contain a rotor inertia are left out. The result is one if the plate does not
    determine the parameters of the torques, because the known zeros differ or the tare is unknown.

    Args:
        plate: Estimate from the force plate.
        torques: Estimate from joint torques.
    """
    try:
        torque_selection = selection(torques.minimal, plate.minimal)
    except ValueError:  # other zeros, or a plate that measures changes only
        return 1.0
    torque_parameters = torques.base
    difference = torque_selection @ plate.base.values - torque_parameters.values
    covariance = (
        torque_selection @ plate.base.covariance @ torque_selection.T
        + torque_parameters.covariance
    )
    covariance += np.diag(
        (
            MIN_RELATIVE_SIGMA
            * parameter_scale(
                torque_parameters.values,
                torque_parameters.units,
                MIN_RELATIVE_MAGNITUDE,
            )
        )
        ** 2
    )
    rotor_columns = () if torques.drives is None else torques.drives.regrouped.values()
    is_without_rotor = np.array(
        [not any(column[k] for column in rotor_columns) for k in range(len(difference))]
    )
    white = (
        inverse_square_root(covariance[np.ix_(is_without_rotor, is_without_rotor)]).T
        @ difference[is_without_rotor]
    )
    return (
        max(1.0, float(np.sqrt(np.mean(white**2)))) if is_without_rotor.any() else 1.0
    )


def _estimate_and_zero_rows(tree: Tree, estimate: Estimate) -> tuple[Array, Array]:
    """Coefficients of estimated and assumed-zero parameters in the barycentric parameters.

    With known zeros, the minimal parameters are combinations of fewer barycentric parameters than
    the forces identify. The full minimal parameters are a linear map of the estimated parameters;
    the orthogonal complement of this map gives the combinations that are assumed to be zero.

    Args:
        tree: Robot.
        estimate: Estimate of either method.

    Returns:
        Coefficients of the p estimated parameters, (p, 10 n + terms), and of the k combinations
        that are assumed to be zero, (k, 10 n + terms), in the 10 n barycentric parameters and the
        joint terms; k is 0 without known zeros.
    """
    minimal, drives = estimate.minimal, estimate.drives
    estimate_rows = minimal.matrix if drives is None else drives.matrix
    if not minimal.known_zero.any():
        return estimate_rows, np.zeros((0, estimate_rows.shape[1]))
    full_set = minimal_set(tree, minimal.model, minimal.gravity, tared=minimal.tared)
    full_rows = full_set.matrix
    if drives is not None:
        laws = tuple(dict.fromkeys(term.law for term in drives.asked))
        full_rows = make_drive_set(tree, full_set, laws).matrix
    size = np.linalg.norm(full_rows, axis=1, keepdims=True)
    full_rows = full_rows / size
    nonzero_rows = np.array(full_rows)
    nonzero_rows[:, : minimal.known_zero.size][:, minimal.known_zero.ravel()] = 0.0
    map_to_full = nonzero_rows @ np.linalg.pinv(estimate_rows)
    return np.linalg.pinv(map_to_full) @ full_rows, null_space(
        map_to_full.T
    ).T @ full_rows
