"""Inertial parameters of a payload from two recordings of a robot in motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.linalg import orth

from testbed.core.base.arrays import Array
from testbed.core.base.codec import schema_with_properties
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, make_diagnostic
from testbed.core.base.errors import SettingsError
from testbed.core.base.gaussian import Gaussian
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import (
    scaled_inverse,
    unit_diagonal,
)
from testbed.core.parameters.minimal_set import MinimalSet, minimal_set
from testbed.core.parameters.symbols import STANDARD_NAMES, barycentric_from_standard
from testbed.core.robot.tree import Tree

UNITS = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
"""Units of the ten standard parameters."""

SPACE_TOLERANCE = 1e-9
"""Largest distance of an identifiable parameter's axis from the row space of the influence."""

SINGULAR_VALUE_TOLERANCE = 1e-9
"""Singular values below this share of the largest count as zero."""

MIN_P_VALUE = 1e-6
"""Smallest p-value for which the residual of the difference is explained by noise."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PayloadEstimate(Diagnosed, Gaussian):
    """Estimate of a payload's ten inertial parameters in the carrying link's frame.

    The order is m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz (`STANDARD_NAMES`): mass, first
    moments, and inertia about the frame's origin. For a tool, the frame is that of the force
    sensor.

    Attributes:
        joint: Name of the joint that moves the carrying link.
        rank: Number of identifiable combinations of the ten parameters.
        p_value: P-value of the chi-square test of the fit's residual; small if no payload explains
            the measured difference within its noise.
        diagnostics: Warnings about the estimate.
    """

    joint: str
    rank: int
    p_value: float
    diagnostics: tuple[Diagnostic, ...] = ()

    __get_pydantic_core_schema__ = schema_with_properties(
        "sigma", "identifiable", "centre"
    )

    @property
    def centre(self) -> tuple[Array, Array] | None:
        """Centre of mass in the carrying link's frame with standard deviation, (3,) each [m].

        Components that are not identifiable are nan. The result is None if the mass is not
        identifiable, or below 5 standard deviations.
        """
        if not self.identifiable[0] or self.values[0] < 5 * self.sigma[0]:
            return None
        return _centre(self.values, self.covariance, self.identifiable)


def _centre(
    values: Array, covariance: Array, identifiable: ArrayLike
) -> tuple[Array, Array]:
    """Centre of mass with standard deviation, (3,) each [m]; nan where not identifiable.

    Args:
        values: Ten standard parameters, (10,).
        covariance: Covariance of the parameters, (10, 10).
        identifiable: True for each identifiable parameter, (10,).
    """
    mass, centre = values[0], values[1:4] / values[0]
    jacobian = np.column_stack([-centre / mass, np.eye(3) / mass])
    sigma = np.sqrt(np.diagonal(jacobian @ covariance[:4, :4] @ jacobian.T))
    centre_and_sigma = np.where(np.asarray(identifiable)[1:4], [centre, sigma], np.nan)
    return centre_and_sigma[0], centre_and_sigma[1]


def payload_influence(tree: Tree, minimal: MinimalSet, joint: str) -> Array:
    """Matrix from a payload's ten standard parameters to p base parameters, (p, 10).

    Args:
        tree: The robot.
        minimal: Minimal set with the p base parameters.
        joint: Name of the joint that moves the carrying link.

    Raises:
        UnknownName: The robot has no such joint.
    """
    link = tree.index(joint)
    unit_bodies = np.zeros((tree.n, 10, 10))
    unit_bodies[link] = np.eye(10)
    theta = barycentric_from_standard(tree, unit_bodies)
    return np.array([minimal.values(theta[..., k]) for k in range(10)]).T


def payload(
    tree: Tree, without: Estimate, loaded: Estimate, joint: str | None = None
) -> PayloadEstimate:
    """Estimate a payload from the difference of two estimates of base parameters.

    For estimates from joint torques, the result has the diagnostic "payload.scale".

    Args:
        tree: The robot; only its geometry is used.
        without: Estimate of the robot alone, from plate or joint torques. A scale error of the
            torques becomes a scale error of the payload (see `torque_scales`).
        loaded: Estimate of the robot with the payload, from the same signal and with the same
            parameters.
        joint: Name of the joint that moves the carrying link; default the last.

    Raises:
        SettingsError: The estimates differ in signal, parameters or gravity, or have known zeros.
        UnknownName: The robot has no such joint.
    """
    joint = tree.names[-1] if joint is None else joint
    minimal, count = without.minimal, without.minimal.count
    if without.method != loaded.method or loaded.names[:count] != without.names[:count]:
        raise SettingsError(
            "a payload is the difference of two estimates by one method, of the same robot, "
            "gravity, zeros and rotors"
        )
    if (without.gravity != loaded.gravity).any():
        raise SettingsError("the two recordings are under different gravity")
    if (
        minimal.names
        != minimal_set(tree.with_gravity(without.gravity), minimal.model).names
    ):
        raise SettingsError(
            "a payload breaks the symmetry of links: estimate without known zeros"
        )
    influence = payload_influence(tree, minimal, joint)
    difference = loaded.values[:count] - without.values[:count]
    covariance = (loaded.covariance + without.covariance)[:count, :count]
    estimate = payload_from_influence(joint, influence, difference, covariance)
    if without.method == "wrench":
        return estimate
    return replace(
        estimate,
        diagnostics=(*estimate.diagnostics, make_diagnostic("payload.scale", joint)),
    )


def payload_from_influence(
    joint: str,
    influence: Array,
    difference: Array,
    noise: Array,
    subject: str = "payload",
) -> PayloadEstimate:
    """Estimate a payload's ten standard parameters by generalised least squares.

    Unidentifiable combinations are zero (minimum-norm solution). If the residual's chi-square
    exceeds its degrees of freedom, the covariance is multiplied by their ratio.

    Args:
        joint: Name of the joint that moves the carrying link.
        influence: Matrix from the ten parameters to the measured combinations of parameters, (p,
            10); (4, 10) if mass and first moments were measured.
        difference: Measured combinations, (p,), such as `loaded - unloaded` base parameters.
        noise: Covariance of the measured combinations, (p, p).
        subject: Subject of the diagnostics: "payload" for two recordings, or "tool" for one.
    """
    unit, scale = unit_diagonal(noise)
    whitening = np.linalg.inv(np.linalg.cholesky(unit)) / scale
    identifiable_axes = orth(influence.T, rcond=SINGULAR_VALUE_TOLERANCE)
    columns = whitening @ influence @ identifiable_axes
    inverse = scaled_inverse(columns.T @ columns)
    coordinates = inverse @ columns.T @ whitening @ difference
    residual = whitening @ difference - columns @ coordinates
    degrees_of_freedom = max(len(influence) - len(coordinates), 1)
    chance = float(special.chdtrc(degrees_of_freedom, residual @ residual))
    # weights prefer the directions along which an estimated covariance happens to be small
    covariance = (
        max(1.0, residual @ residual / degrees_of_freedom)
        * identifiable_axes
        @ inverse
        @ identifiable_axes.T
    )
    identifiable = (
        np.abs(np.linalg.norm(identifiable_axes, axis=1) - 1) < SPACE_TOLERANCE
    )
    payload = PayloadEstimate(
        names=STANDARD_NAMES,
        units=UNITS,
        values=identifiable_axes @ coordinates,
        covariance=covariance,
        unidentifiable=tuple(compress(STANDARD_NAMES, ~identifiable)),
        joint=joint,
        rank=len(coordinates),
        p_value=chance,
    )
    mass, sigma = float(payload.values[0]), float(payload.sigma[0])
    return replace(
        payload, diagnostics=tuple(_diagnostics(joint, chance, mass, sigma, subject))
    )


def _diagnostics(
    joint: str, chance: float, mass: float, sigma: float, what: str
) -> Iterator[Diagnostic]:
    """Yield diagnostics of an unexplained difference and of a significantly negative mass.

    Args:
        joint: Name of the joint that moves the carrying link.
        chance: P-value of the residual; a diagnostic is given below `MIN_P_VALUE`.
        mass: Estimated mass [kg]; a diagnostic is given below -5 standard deviations.
        sigma: Standard deviation of the mass [kg].
        what: Prefix of the diagnostic's code: "payload" or "tool".
    """
    if chance < MIN_P_VALUE:
        yield make_diagnostic("payload.unexplained", joint, chance)
    if mass < -5 * sigma:
        yield make_diagnostic(f"{what}.negative-mass", joint, mass, sigma=sigma)
