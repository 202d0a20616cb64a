"""Whether rigid bodies have an estimate's parameters: the conic program of the nearest robot."""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse, special

from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import TINY, square_root
from testbed.core.parameters.pseudo_inertia import standard_of_coordinates
from testbed.core.parameters.symbols import parameter_scale

SIGMAS = 5.0
"""What noise exceeds as rarely as this is no noise: a distance, or a wrong sign."""

MODEL_ERROR = 0.01
"""Models are never quite right by this part of each parameter, unless it is said otherwise."""

SMALL = 0.1
"""Parameters below this share of the largest of their unit are taken to be that large."""

LENGTH = 0.3
"""Unit of length in which a robot's masses and moments are of one order [m]."""


@dataclass(frozen=True, eq=False)
class RigidBodyTest:
    """How far an estimate is from those of possible robots.

    Attributes:
        distance: At least this far, in sigmas, model errors counted.
        limit: Distance beyond which it is no noise.
        nearest: Minimal parameters of the nearest possible robot, (N,).
        gap: How far each is from them, in parts of itself, (N,).
    """

    distance: float
    limit: float
    nearest: Array
    gap: Array

    @property
    def impossible(self) -> bool:
        """Whether no rigid bodies have the parameters, noise and model errors allowed."""
        return self.distance > self.limit


def rigid_body_test(
    estimate: Estimate, sigmas: float = SIGMAS, model_error: float = MODEL_ERROR
) -> RigidBodyTest:
    """Whether an estimate's minimal parameters can be those of rigid bodies.

    Args:
        estimate: Of either method. Rotors that are identifiable together with a body's inertia may
            have any inertia that is not negative.
        sigmas: An estimate is called impossible beyond a distance that noise exceeds as rarely
            as this.
        model_error: Part of each parameter, taken as an error besides sigma.
    """
    base = estimate.base
    scale = parameter_scale(base.values, base.units, SMALL)
    covariance = base.covariance + np.diag((model_error * scale) ** 2)
    unit = 1 / np.sqrt(np.maximum(np.diagonal(covariance), TINY))
    limit = float(np.sqrt(special.chdtri(len(scale), 2 * special.ndtr(-sigmas))))
    forms, rotors = _of_bodies(estimate.minimal.standard_matrix), _rotors(estimate)
    root = square_root(covariance * np.outer(unit, unit))
    normal = _separating(
        unit[:, None] * forms, unit[:, None] * rotors, unit * base.values, root
    )
    distance = max(0.0, float(normal @ (unit * base.values)))
    gap = -distance * (covariance @ (unit * normal))
    relative = np.abs(gap) / np.where(scale > 0, scale, 1.0)
    return RigidBodyTest(distance, limit, base.values + gap, relative)


def _rotors(estimate: Estimate) -> Array:
    """What a unit of each rotor identified with a body adds to the parameters, (N, rotors)."""
    regrouped = {} if estimate.drives is None else estimate.drives.regrouped
    columns = [column[: estimate.minimal.count] for column in regrouped.values()]
    return np.array(columns).reshape(len(columns), estimate.minimal.count).T


def _of_bodies(standard: Array) -> Array:
    """Forms of standard parameters as forms of every body's J, (N, 10 n), scaled for the solver.

    Args:
        standard: (N, 10 n), of (m, h, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) body by body.
    """
    scaled = standard_of_coordinates(np.diag([LENGTH, LENGTH, LENGTH, 1.0]))
    by_body = standard.reshape(len(standard), -1, 10) @ scaled
    return by_body.reshape(len(standard), -1)


def _separating(forms: Array, rotors: Array, wanted: Array, root: Array) -> Array:
    """The normal of the furthest plane between parameters and all robots, one sigma long, (N,).

    Args:
        forms: Of the coordinates of every body's J, (N, 10 n).
        rotors: Of every rotor's inertia, (N, m).
        wanted: The parameters, (N,).
        root: R, (N, N), their covariance R R'.
    """
    # for the solver: near one
    size = float(np.linalg.norm(np.linalg.solve(root, wanted))) or 1.0
    count = len(wanted)
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
        -wanted / size,
        sparse.csc_matrix(rows),
        np.eye(1, len(rows))[0],
        cones,
        settings,
    )
    return np.array(program.solve().x)
