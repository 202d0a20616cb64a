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
    """Test of the change of the plate's estimate when joint torques are added.

    Attributes:
        names: The k parameters whose variance is reduced by the joint torques, (k,).
        z: Change of each parameter divided by the standard deviation of the change, (k,).
        p_value: P-value of the change under the hypothesis that both signals are consistent.
    """

    names: tuple[str, ...]
    z: Array
    p_value: float

    def __post_init__(self) -> None:
        freeze_arrays(self, z=(len(self.names),))

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostic with the three parameters that change most, in standard deviations.

        The result is empty if the signals are consistent: a p-value of at least `MIN_P_VALUE`.
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
    """Base parameters of the wrench, estimated from plate and joint torques together.

    Attributes:
        constants: Torque constants of the joints: ratios of reported to true torque.
        disagreement: Test of agreement between plate and joint torques.
    """

    constants: Gaussian
    disagreement: Disagreement


def combined(
    torques: TorqueRegressionData,
    bodies: Estimate,
    regressions: tuple[JointRegression, ...],
) -> CombinedEstimate:
    """Estimate base parameters from the plate's estimate and the joint torques together.

    The least-squares problem is nonlinear, since the unknown torque constants multiply the unknown
    parameters; iteration starts at the plate's estimate. Parameters that the plate leaves
    undetermined are given a wide prior. They are unidentifiable unless the torques reduce its
    standard deviation at least by the factor `PRIOR_SIGMA_RATIO`.

    Args:
        torques: Regression data of the recording's joint torques.
        bodies: Estimate from the plate's wrench.
        regressions: Regression of each joint's torque on the torque predicted by the estimate, for
            initial values and noise level.
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
    """Least-squares solution for plate parameters and joint coefficients, with covariance.

    The plate parameters are `plate + root @ coordinates`; the coordinates have unit covariance in
    the plate's estimate.

    Args:
        torques: Regression data of the recording's joint torques.
        plate: The N_r base parameters estimated from the plate, (N_r,).
        root: Square root of the covariance of these parameters, (N_r, r).
        regressions: Regression of each joint, for initial values and noise.

    Returns:
        Solution, (m,), with the r coordinates first, then torque constant and term coefficients of
        each joint; and its covariance, (m, m).
    """
    ends = np.cumsum(
        [root.shape[1], *(len(values.values) for values in regressions[:-1])]
    )
    joint_rows = [_joint_rows(torques, values) for values in regressions]

    def residuals(unknowns: Array) -> Array:
        """Residuals of the plate's estimate and of all joints' rows, in standard deviations."""
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
    """Matrix square root R of a covariance R R', (p, r).

    It has one column for each of the r relative eigenvalues above `EXACT_VARIANCE_SHARE`.
    """
    unit, scale = unit_diagonal(covariance)
    variances, axes = eigh(unit)
    is_uncertain = variances > EXACT_VARIANCE_SHARE
    return scale[:, None] * axes[:, is_uncertain] * np.sqrt(variances[is_uncertain])


def _joint_rows(
    torques: TorqueRegressionData, regression: JointRegression
) -> tuple[Array, Array, Array]:
    """Compressed regression rows of one joint, in units of noise: R, y and term columns.

    R, (r, p), and y, (r,), give the same normal equations in the p unknowns of the torques as all
    rows do. The term columns, (p, q), map the q coefficients of the joint to these unknowns.

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
    """Test the change of the plate's estimate when joint torques are added.

    The covariance of the change is the difference of the two covariances. Only parameters and
    directions whose variance falls by more than `MIN_VARIANCE_REDUCTION` are tested. The p-value is
    the smaller of those of the chi-square test of all directions and of the largest z (Bonferroni).

    Args:
        bodies: Estimate from the plate's wrench.
        plate_covariance: Covariance of the parameters from the plate alone, (N_r, N_r).
        values: Parameters from both signals, (N_r,).
        covariance: Covariance of the parameters from both signals, (N_r, N_r).
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
    """Results of drive identification: torque constants, joint terms, curves, combined estimate.

    Attributes:
        estimates: Torque constant and terms of each joint.
        curves: Friction curve of each joint over velocity.
        combined: Base parameters estimated from plate and joint torques together.
    """

    estimates: tuple[DriveEstimate, ...]
    curves: tuple[FrictionCurve, ...]
    combined: CombinedEstimate

    @property
    def gears(self) -> dict[str, float]:
        """Ratios of true to reported torque, the inverse torque constants, keyed by joint name."""
        return {estimate.joint: 1 / estimate.constant for estimate in self.estimates}

    __get_pydantic_core_schema__ = schema_with_properties("diagnostics")

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of disagreement between plate and joint torques (`Disagreement`)."""
        return self.combined.disagreement.diagnostics


def with_identified_drives(tree: Tree, findings: DriveIdentification) -> Tree:
    """Robot with the identified friction and rotor inertias of its joints.

    Only laws that the robot model can represent are used, such as Coulomb friction, viscous
    friction and rotor inertia. Negative coefficients are replaced by zero.

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
    """Identify torque constants, joint terms and friction curves, and a combined estimate.

    Args:
        tree: The robot; its inertias are not used, except for `settings.zeros`.
        recording: Recording with joint torques, as for `identify`.
        bodies: Estimate from the plate's wrench, of this recording or another. For an estimate from
            a force sensor in the robot that carries all links beyond it, only the joints beyond are
            identified.
        gravity: Gravity, (3,) [m/s^2], bedplate frame; default as for `identify`.
        settings: Signal processing and joint terms.
        choose: True to select each joint's terms by cross-validation; of the terms in the settings,
            only the rotor inertia is then used.
        threads: Number of threads; default one per processor.
        progress: Called with the numbers of processed samples and of all samples.

    Raises:
        RecordingError: The recording has no torques, or is from another robot.
        SettingsError: The estimate is not from the plate's wrench, or has other parameters.
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
