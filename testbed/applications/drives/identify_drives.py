"""Identification of drives by plate and torques: constants, joint terms, friction curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.optimize import least_squares

from testbed.applications.drives.friction_curves import (
    DriveEstimate,
    FrictionCurve,
    chosen_terms,
    drive_estimate,
    friction_curves,
    offered,
    term_selection_matrices,
)
from testbed.applications.drives.joint_regression import (
    JointRegression,
    TorqueRegressionData,
    fit_joint_regressions,
    torque_regression_data,
)
from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.blas import eigh
from testbed.core.base.codec import schema_with_properties
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, make_diagnostic
from testbed.core.base.gaussian import Gaussian
from testbed.core.base.stages import Progress, ignore_progress
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    scaled_inverse,
    standard_deviations,
    unit_diagonal,
)
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.robot.tree import Tree

STEP_TOLERANCE = 1e-12
"""Relative step size at which the iteration stops."""

EXACT_VARIANCE_SHARE = 1e-14
"""Relative eigenvalue of a covariance below which a combination counts as exactly known."""

PRIOR_SIGMA_RATIO = 1e3
"""Prior standard deviation over value, for parameters confounded with the plate's zero."""

MIN_VARIANCE_REDUCTION = 1e-4
"""Smallest relative reduction of a variance by joint torques for a test of agreement."""

MIN_P_VALUE = 1e-6
"""Smallest p-value for agreement of plate and joint torques."""


@dataclass(frozen=True, eq=False)
class Disagreement(Diagnosed):
    """Change of the plate's estimate by added joint torques, tested for significance.

    Attributes:
        names: Parameters whose variance joint torques reduce, (k,).
        z: Change of each parameter over the standard deviation of the change, (k,).
        p_value: P-value of the change if both signals are consistent.
    """

    names: tuple[str, ...]
    z: Array
    p_value: float

    def __post_init__(self) -> None:
        freeze_arrays(self, z=(len(self.names),))

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostic with the three parameters that change most in sigmas.

        Empty for consistent signals: a p-value of at least `MIN_P_VALUE`.
        """
        if self.p_value >= MIN_P_VALUE:
            return ()
        worst = np.argsort(-np.abs(self.z))[:3]
        return (
            make_diagnostic(
                "drives.disagreement",
                "plate and torques",
                self.p_value,
                parameters=", ".join(
                    f"{self.names[k]} by {self.z[k]:+.1f} sigma" for k in worst
                ),
            ),
        )


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class CombinedEstimate(Gaussian):
    """Base parameters of the plate estimated from plate and joint torques together.

    Attributes:
        constants: Torque constants (reported over true torque) of the joints.
        disagreement: Test of agreement between plate and joint torques.
    """

    constants: Gaussian
    disagreement: Disagreement


def combined(
    torques: TorqueRegressionData,
    bodies: Estimate,
    regressions: tuple[JointRegression, ...],
) -> CombinedEstimate:
    """Estimate base parameters from the plate's estimate and joint torques together.

    Nonlinear least squares, since the unknown torque constant multiplies the unknown parameters;
    starts at the plate's estimate. Parameters that the plate leaves undetermined have a wide prior,
    and are unidentifiable unless torques reduce its standard deviation `PRIOR_SIGMA_RATIO`-fold.

    Args:
        torques: Regression data of the recording's joint torques.
        bodies: Estimate by the plate.
        regressions: Regression of each joint's torque on the estimate's prediction: initial values
            and noise level.
    """
    is_undetermined = np.isinf(bodies.sigma)
    prior_covariance = np.where(
        is_undetermined[:, None] | is_undetermined, 0.0, bodies.covariance
    )
    prior_sigma = PRIOR_SIGMA_RATIO * np.maximum(
        np.abs(bodies.values), np.sqrt(np.diagonal(bodies.covariance))
    )
    prior_covariance[is_undetermined, is_undetermined] = (
        prior_sigma[is_undetermined] ** 2
    )
    root = _covariance_root(prior_covariance)
    count = root.shape[1]
    solution, covariance = _joint_fit(torques, bodies.values, root, regressions)
    counts = [len(regression.values) for regression in regressions[:-1]]
    constant_indices = count + np.cumsum([0, *counts])
    values = bodies.values + root @ solution[:count]
    joint_covariance = root @ covariance[:count, :count] @ root.T
    is_unidentifiable = is_undetermined & (
        standard_deviations(joint_covariance) > prior_sigma / PRIOR_SIGMA_RATIO
    )
    names = tuple(bodies.joints[regression.joint] for regression in regressions)
    return CombinedEstimate(
        names=bodies.names,
        units=bodies.units,
        values=values,
        covariance=joint_covariance,
        unidentifiable=tuple(compress(bodies.names, is_unidentifiable)),
        constants=Gaussian(
            names=names,
            units=("",) * len(names),
            values=solution[constant_indices],
            covariance=covariance[np.ix_(constant_indices, constant_indices)],
        ),
        disagreement=_disagreement(bodies, prior_covariance, values, joint_covariance),
    )


def _joint_fit(
    torques: TorqueRegressionData,
    plate: Array,
    root: Array,
    regressions: Sequence[JointRegression],
) -> tuple[Array, Array]:
    """Least-squares solution for plate parameters and every joint's values, and covariance.

    Parameters are plate + root @ coordinates, with coordinates of unit covariance by the plate's
    estimate.

    Args:
        torques: Regression data of the recording's joint torques.
        plate: The N_r base parameters by the plate, (N_r,).
        root: Square root of the covariance of the base parameters, (N_r, r).
        regressions: Regression of each joint, for initial values and noise.

    Returns:
        Solution, (m,): r coordinates, then torque constant and term coefficients joint by joint;
            and covariance, (m, m).
    """
    ends = np.cumsum(
        [root.shape[1], *(len(values.values) for values in regressions[:-1])]
    )
    joint_rows = [_joint_rows(torques, values) for values in regressions]

    def residuals(unknowns: Array) -> Array:
        """Residuals of the plate's estimate and of every joint's rows, in standard deviations."""
        coordinates, *joint_values = np.split(unknowns, ends)
        torque = torques.plate_to_unknowns @ (plate + root @ coordinates)
        joint_residuals = [
            rows @ (values[0] * torque + terms @ values[1:]) - offset
            for values, (rows, offset, terms) in zip(
                joint_values, joint_rows, strict=True
            )
        ]
        return np.concatenate([coordinates, *joint_residuals])

    initial = np.concatenate(
        [np.zeros(root.shape[1]), *(values.values for values in regressions)]
    )
    fit = least_squares(
        residuals,
        initial,
        "3-point",
        x_scale="jac",
        ftol=None,
        gtol=None,
        xtol=STEP_TOLERANCE,
    )
    return fit.x, scaled_inverse(fit.jac.T @ fit.jac)


def _covariance_root(covariance: Array) -> Array:
    """Root R with R R' the covariance, (p, r); r eigenvalues above `EXACT_VARIANCE_SHARE`."""
    unit, scale = unit_diagonal(covariance)
    variances, axes = eigh(unit)
    is_uncertain = variances > EXACT_VARIANCE_SHARE
    return scale[:, None] * axes[:, is_uncertain] * np.sqrt(variances[is_uncertain])


def _joint_rows(
    torques: TorqueRegressionData, regression: JointRegression
) -> tuple[Array, Array, Array]:
    """Compressed regression rows of one joint, in units of noise: R, y and term columns.

    R, (r, p), and y, (r,), have the same normal equations as all rows, by the p unknowns of the
    torques; the matrix from the joint's q coefficients to these unknowns is (p, q).

    Args:
        torques: Regression data of the recording's joint torques.
        regression: Regression of the joint.
    """
    normal, vector, _ = torques.equations.of_channel(regression.joint)
    root = _covariance_root(normal)
    rows = root.T / regression.noise
    return (
        rows,
        np.linalg.pinv(root) @ vector / regression.noise,
        torques.drives.columns @ regression.terms,
    )


def _disagreement(
    bodies: Estimate, plate_covariance: Array, values: Array, covariance: Array
) -> Disagreement:
    """Test of the change of the plate's estimate by added joint torques.

    The covariance of the change is the difference of both covariances. Only parameters and
    directions are tested whose variance falls by more than `MIN_VARIANCE_REDUCTION`. P-value:
    smaller one of the chi-square test of all and the largest z (Bonferroni).

    Args:
        bodies: Estimate by the plate.
        plate_covariance: Covariance by the plate alone, (N_r, N_r).
        values: Parameters by both signals, (N_r,).
        covariance: Covariance by both signals, (N_r, N_r).
    """
    change, change_covariance = values - bodies.values, plate_covariance - covariance
    _, scale = unit_diagonal(plate_covariance)
    scaled_covariance = change_covariance / np.outer(scale, scale)
    is_informative = np.diagonal(scaled_covariance) > MIN_VARIANCE_REDUCTION
    z = (change[is_informative] / scale[is_informative]) / np.sqrt(
        np.diagonal(scaled_covariance)[is_informative]
    )
    eigenvalues, axes = eigh((scaled_covariance + scaled_covariance.T) / 2)
    is_significant = eigenvalues > MIN_VARIANCE_REDUCTION
    normalised = (
        (change / scale)
        @ axes[:, is_significant]
        / np.sqrt(eigenvalues[is_significant])
    )
    chance = float(
        special.chdtrc(max(int(is_significant.sum()), 1), normalised @ normalised)
    )
    if z.size:
        chance = min(chance, z.size * 2 * float(special.ndtr(-np.abs(z).max())))
    names = tuple(
        name
        for name, is_included in zip(bodies.names, is_informative, strict=True)
        if is_included
    )
    return Disagreement(names, z, min(chance, 1.0))


@dataclass(frozen=True, eq=False)
class DriveIdentification(Diagnosed):
    """Results of drive identification: torque constants, terms, curves, combined estimate.

    Attributes:
        estimates: Torque constant and terms of each joint.
        curves: Friction over velocity of each joint.
        combined: Base parameters by plate and joint torques together.
    """

    estimates: tuple[DriveEstimate, ...]
    curves: tuple[FrictionCurve, ...]
    combined: CombinedEstimate

    @property
    def gears(self) -> dict[str, float]:
        """True over reported torque by joint name: the inverse of the torque constant."""
        return {estimate.joint: 1 / estimate.constant for estimate in self.estimates}

    __get_pydantic_core_schema__ = schema_with_properties("diagnostics")

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of disagreement between plate and joint torques (`Disagreement`)."""
        return self.combined.disagreement.diagnostics


def with_identified_drives(tree: Tree, findings: DriveIdentification) -> Tree:
    """Robot with the identified friction and rotor inertias of its joints.

    Only laws with a parameter in the model are used, as Coulomb and viscous friction and rotor
    inertia; negative coefficients become zero.

    Args:
        tree: The robot.
        findings: Results of drive identification.
    """
    joint_parameters = {
        drive.joint: {
            term.law.parameter: max(term.value, 0.0)
            for term in drive.terms
            if term.law.parameter is not None
        }
        for drive in findings.estimates
    }
    return tree.with_joints(joint_parameters)


def identify_drives(
    tree: Tree,
    recording: Recording | Source | str,
    bodies: Estimate,
    *,
    gravity: ArrayLike | None = None,
    settings: Settings = DEFAULTS,
    choose: bool = False,
    threads: int | None = None,
    progress: Progress = ignore_progress,
) -> DriveIdentification:
    """Identify torque constants, joint terms and friction curves; combine plate and torques.

    Args:
        tree: The robot; its inertias are not used, except for `settings.zeros`.
        recording: Recording with joint torques, as for `identify`.
        bodies: Estimate by the plate, from this recording or another; or by a force sensor in the
            robot that carries all links beyond it: then only the joints beyond are identified.
        gravity: Gravity, (3,) [m/s^2], bedplate frame; default as for `identify`.
        settings: Signal processing, and the joint terms.
        choose: True to choose each joint's terms by cross-validation; of the terms in the settings
            only the rotor's inertia is then used.
        threads: Number of threads; default one per processor.
        progress: Called with the numbers of processed samples and of all samples.

    Raises:
        RecordingError: The recording has no torques, or is of another robot.
        SettingsError: The estimate is not by the plate, or of other parameters.
    """
    problem = Problem.from_recording(
        tree,
        recording,
        "torque",
        settings,
        gravity=gravity,
        threads=threads,
        progress=progress,
        knows_load=True,
    )
    settings = problem.settings
    laws = offered(settings.laws, problem.source.signals) if choose else None
    torques = torque_regression_data(problem, bodies, laws)
    choices = chosen_terms(problem.tree, torques, bodies) if choose else {}
    joint_regressions = fit_joint_regressions(
        torques, bodies, term_selection_matrices(torques, choices) if choose else None
    )
    drives = tuple(
        drive_estimate(problem.tree, torques, regression, choices.get(regression.joint))
        for regression in joint_regressions
    )
    curves = friction_curves(problem, bodies, drives)
    return DriveIdentification(
        drives, curves, combined(torques, bodies, joint_regressions)
    )
