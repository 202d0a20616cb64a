"""Test of physical consistency: nearest parameters of rigid bodies, from a conic program."""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse, special

from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    matrix_square_root,
)
from testbed.core.parameters.pseudo_inertia import standard_from_coordinates
from testbed.core.parameters.symbols import parameter_scale

REJECTION_SIGMAS = 5.0
"""Significance of the tests, as standard deviations of a normal variable."""

RELATIVE_MODEL_ERROR = 0.01
"""Default error of the model, as a fraction of each parameter."""

MIN_RELATIVE_MAGNITUDE = 0.1
"""Smallest assumed magnitude of a parameter, relative to the largest of its unit."""

LENGTH_UNIT = 0.3
"""Unit of length in which a robot's masses and moments have similar magnitudes [m]."""


@dataclass(frozen=True, eq=False)
class RigidBodyTest:
    """Distance of an estimate from the parameters of physically consistent robots.

    Attributes:
        distance: Smallest Mahalanobis distance, for a covariance that includes model errors.
        limit: Largest distance that noise explains, the square root of a chi-squared quantile.
        nearest: Minimal parameters of the nearest consistent robot, (N,).
        gap: Difference of each parameter from `nearest`, relative to its magnitude, (N,).
    """

    distance: float
    limit: float
    nearest: Array
    gap: Array

    @property
    def impossible(self) -> bool:
        """True if the distance from all consistent robots exceeds the limit."""
        return self.distance > self.limit


def rigid_body_test(
    estimate: Estimate,
    sigmas: float = REJECTION_SIGMAS,
    model_error: float = RELATIVE_MODEL_ERROR,
) -> RigidBodyTest:
    """Test whether rigid bodies can have an estimate's minimal parameters.

    Pseudo-inertias of rigid bodies are positive semidefinite. Among the planes that separate the
    cone of such parameters from the estimate, the one at the largest distance is found, and its
    distance is compared with a chi-squared quantile.

    Args:
        estimate: Estimate by either method. Rotors regrouped with a body's inertia may have any
            nonnegative inertia.
        sigmas: Significance, as standard deviations of a normal variable.
        model_error: Error of the model as a fraction of each parameter, added to sigma.
    """
    base = estimate.base
    scale = parameter_scale(base.values, base.units, MIN_RELATIVE_MAGNITUDE)
    covariance = base.covariance + np.diag((model_error * scale) ** 2)
    inverse_sigma = 1 / np.sqrt(np.maximum(np.diagonal(covariance), SMALLEST_POSITIVE))
    limit = float(np.sqrt(special.chdtri(len(scale), 2 * special.ndtr(-sigmas))))
    forms, rotors = (
        _pseudo_inertia_forms(estimate.minimal.standard_matrix),
        _rotor_columns(estimate),
    )
    root = matrix_square_root(covariance * np.outer(inverse_sigma, inverse_sigma))
    normal = _separating_normal(
        inverse_sigma[:, None] * forms,
        inverse_sigma[:, None] * rotors,
        inverse_sigma * base.values,
        root,
    )
    distance = max(0.0, float(normal @ (inverse_sigma * base.values)))
    gap = -distance * (covariance @ (inverse_sigma * normal))
    relative = np.abs(gap) / np.where(scale > 0, scale, 1.0)
    return RigidBodyTest(distance, limit, base.values + gap, relative)


def _rotor_columns(estimate: Estimate) -> Array:
    """Change of the minimal parameters per unit inertia of each regrouped rotor, (N, rotors)."""
    regrouped = {} if estimate.drives is None else estimate.drives.regrouped
    columns = [column[: estimate.minimal.count] for column in regrouped.values()]
    return np.array(columns).reshape(len(columns), estimate.minimal.count).T


def _pseudo_inertia_forms(standard: Array) -> Array:
    """Coefficients of the minimal parameters as linear forms in the pseudo-inertias J, (N, 10 n).

    The unit of length in J is LENGTH_UNIT (0.3 m), which improves the scaling of the solver's
    numbers.

    Args:
        standard: Coefficients of the minimal parameters as linear forms in (m, h, Ixx, Ixy, Iyy,
            Ixz, Iyz, Izz), body by body, (N, 10 n).
    """
    scaled = standard_from_coordinates(
        np.diag([LENGTH_UNIT, LENGTH_UNIT, LENGTH_UNIT, 1.0])
    )
    by_body = standard.reshape(len(standard), -1, 10) @ scaled
    return by_body.reshape(len(standard), -1)


def _separating_normal(
    forms: Array, rotors: Array, parameters: Array, root: Array
) -> Array:
    """Normal of the plane that best separates the parameters from all consistent robots, (N,).

    The length of the normal is one standard deviation.

    Args:
        forms: Coefficients of the parameters as linear forms in the pseudo-inertias J, (N, 10 n).
        rotors: Change of the parameters per unit inertia of each rotor, (N, m).
        parameters: Estimated parameters, (N,).
        root: Square root R of the covariance R R', (N, N).
    """
    # scale of the distance, which makes the solver's numbers near one
    distance_scale = float(np.linalg.norm(np.linalg.solve(root, parameters))) or 1.0
    count = len(parameters)
    rows = np.vstack([np.zeros(count), -root.T, forms.T, rotors.T])
    cones = [
        clarabel.SecondOrderConeT(1 + count),
        *[clarabel.PSDTriangleConeT(4)] * (forms.shape[1] // 10),
        *([clarabel.NonnegativeConeT(rotors.shape[1])] if rotors.size else []),
    ]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    program = clarabel.DefaultSolver(
        sparse.csc_matrix((count, count)),  # no quadratic part
        -parameters / distance_scale,
        sparse.csc_matrix(rows),
        np.eye(1, len(rows))[0],
        cones,
        settings,
    )
    return np.array(program.solve().x)
