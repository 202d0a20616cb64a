"""Estimation of sensor coefficients together with the robot's parameters, by Gauss-Newton.

The columns of sensor errors are first-order effects. Each iteration corrects the recording with the
current coefficients and estimates the remaining error. The last fit contains these columns together
with those of the robot, so that its covariance accounts for both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import SettingsError, shortened_list
from testbed.core.estimation.noise.coloured_noise import (
    GlsFit,
    white_noise_sensor_estimate,
)
from testbed.core.estimation.noise.whitening import NuisanceColumns
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import (
    LinearConstraints,
    known_value_constraints,
)
from testbed.core.estimation.regression.normal_equations import (
    NormalEquations,
    standard_deviations,
)
from testbed.core.estimation.regression.passes import Passes
from testbed.core.estimation.regression.solvers import Fit
from testbed.core.estimation.regression.windows import Plan
from testbed.core.estimation.sensor.correction import CalibrationCovariance
from testbed.core.estimation.sensor.estimates import NuisanceEstimate
from testbed.core.estimation.sensor.predicted_wrench import row_filter
from testbed.core.estimation.sensor.unknowns import (
    NonIdentifiable,
    SensorErrorColumns,
    SensorUnknowns,
    explain_nonidentifiable,
    identifiable_subset,
    sensor_unknowns,
)
from testbed.core.estimation.settings import Settings
from testbed.core.recordings.source import Source
from testbed.core.robot.tree import Tree
from testbed.sensors.catalogue import estimable_errors
from testbed.sensors.corrected import CorrectedSource
from testbed.sensors.errors.plate_bias import PlateBias
from testbed.sensors.errors.plate_tare import PlateTare
from testbed.sensors.systematic_error import SystematicError

MAX_ITERATIONS = 8
"""Largest number of Gauss-Newton iterations."""

MIN_OWN_SHARE = 0.1
"""Smallest share of a coefficient's effect that is independent of other unknowns; below it, columns
computed from noisy encoders do not determine the coefficient."""


class LinearFit(NamedTuple):
    """Weighted least-squares solution of a recording.

    Attributes:
        passes: Passes over the rows of the recording.
        equations: Normal equations of all rows.
        fit: Solution.
    """

    passes: Passes
    equations: NormalEquations
    fit: Fit


@dataclass(frozen=True, eq=False)
class SensorModel:
    """Sensor coefficients of an estimate, unknown or calibrated, and known values.

    Attributes:
        settings: Settings of the estimate.
        unknowns: Unknown sensor coefficients.
        nonidentifiable: Requested coefficients that are collinear with other unknowns.
        known: Known values of the robot's unknowns and of the unknown coefficients.
        calibrated_names: Names of coefficients that the plate calibration has corrected; only their
            covariance is used.
    """

    settings: Settings
    unknowns: SensorUnknowns
    nonidentifiable: tuple[NonIdentifiable, ...]
    known: LinearConstraints
    calibrated_names: frozenset[str] = frozenset()

    @classmethod
    def from_problem(
        cls, problem: Problem, doubt: CalibrationCovariance | None = None
    ) -> SensorModel:
        """Set up the identifiable sensor coefficients of a problem, without using its data.

        Args:
            problem: Robot and recording; its settings state the sensor errors.
            doubt: Covariance of the plate calibration; None without a calibration.

        Raises:
            SettingsError: The wrench is a difference of two sensors, for which an error cannot be
                estimated; or known values do not fix the scale of a crosstalk matrix.
        """
        settings, names, tree = problem.settings, problem.names, problem.layout.tree
        plate = problem.method == "wrench"
        terms = settings.nuisances if plate else ()
        requested = [error for error in estimable_errors() if error.term in terms]
        calibrated = (
            doubt.calibrated_errors(tree, requested)
            if plate and doubt is not None
            else []
        )
        requested = [
            error
            for error in estimable_errors()
            if error in requested or error in calibrated
        ]
        _check_sensor_difference(tree, requested)
        all_coefficients = sensor_unknowns(tree, requested)
        known_values = {
            name: value
            for name, value in settings.facts.items()
            if plate or name in names
        }
        known = known_value_constraints(
            tree, problem.minimal, names, all_coefficients.names, known_values
        )
        neutral_values = {
            coefficient.name: coefficient.neutral
            for error in calibrated
            for coefficient in error.coefficients(tree)
        }
        if doubt is not None and neutral_values:
            known = doubt.with_calibration(
                known, neutral_values, (*names, *all_coefficients.names)
            )
        unknowns, nonidentifiable = identifiable_subset(problem, requested, known)
        _check_joint_identifiability(all_coefficients, nonidentifiable, settings)
        return cls(
            settings=settings,
            unknowns=unknowns,
            nonidentifiable=nonidentifiable,
            known=known.restricted_to(
                [
                    *range(len(names)),
                    *(len(names) + k for k in unknowns.unknown_indices),
                ]
            ),
            calibrated_names=frozenset(neutral_values),
        )

    @property
    def collinear_with_bias(self) -> tuple[str, ...]:
        """Parameters that are collinear with a requested bias or tare of the plate."""
        terms = (PlateBias.term, PlateTare.term)
        return tuple(
            name
            for item in self.nonidentifiable
            if item.name.partition("/")[0] in terms
            for name in item.collinear_names
        )

    def columns(
        self, plan: Plan, values: Array, coefficients: Array
    ) -> NuisanceColumns:
        """Linearised columns of the sensor errors, with known values as constraints.

        Args:
            plan: Plan of the rows.
            values: Minimal parameters, (p,).
            coefficients: Sensor coefficients used to correct the recording, (s,).
        """
        constraints = self.known.on_corrections(np.concatenate([values, coefficients]))
        if not self.unknowns.unknown_indices:
            return NuisanceColumns(constraints=constraints)
        cutoff = self.settings.row_low_pass
        assert cutoff is not None, (
            "settings refuse nuisances of rows that are not filtered"
        )
        exact = any(error.jointly for error in self.unknowns.nuisances)
        filtered = row_filter(plan, cutoff, exact=exact)
        sensed = plan.source.senses_kinematics
        position_cutoff = 0.0 if sensed else self.settings.position_low_pass or 0.0
        return NuisanceColumns(
            columns=SensorErrorColumns(
                plan,
                filtered,
                values,
                self.unknowns,
                self.unknowns.unmixing(coefficients),
                unfolded=row_filter(
                    plan, cutoff, exact=exact, position_cutoff=position_cutoff
                ),
            ),
            count=len(self.unknowns.unknown_indices),
            constraints=constraints,
        )

    def estimates(self, values: Array, fit: GlsFit) -> tuple[NuisanceEstimate, ...]:
        """Estimates of the sensor coefficients, without coefficients from the plate calibration.

        Args:
            values: Coefficients used to correct the recording, (s,).
            fit: Last fit, which estimates the remaining error.
        """
        sigmas = standard_deviations(fit.sensor_covariance)
        unknowns = self.unknowns
        estimates = zip(
            unknowns.terms,
            unknowns.names,
            unknowns.units,
            values + fit.sensor_values,
            sigmas,
            strict=True,
        )
        return tuple(
            NuisanceEstimate(kind, name, unit, float(value), float(sigma))
            for kind, name, unit, value, sigma in estimates
            if name not in self.calibrated_names
        )

    def covariance(self, fit: GlsFit) -> Array:
        """Covariance of the sensor coefficients, (s, s), in the order of `estimates`.

        Args:
            fit: Last fit.
        """
        indices = [
            k
            for k, name in enumerate(self.unknowns.names)
            if name not in self.calibrated_names
        ]
        return fit.sensor_covariance[np.ix_(indices, indices)]

    def diagnostics(self, result: GaussNewtonResult) -> Iterator[Diagnostic]:
        """Diagnostics of collinear and weakly determined coefficients, and of convergence.

        A coefficient is weakly determined if less than MIN_OWN_SHARE (0.1) of its effect is
        independent of the other unknowns. A lack of convergence after MAX_ITERATIONS is reported.

        Args:
            result: Result of the Gauss-Newton iterations.
        """
        groups: dict[tuple[str, ...], list[str]] = {}
        for item in self.nonidentifiable:
            groups.setdefault(item.collinear_names, []).append(item.name)
        for by, names in groups.items():
            verb = "is" if len(names) == 1 else "are"
            yield make_diagnostic(
                "plate.collinear",
                ", ".join(names),
                verb=verb,
                others=shortened_list(by),
            )
        if result.weak:
            verb = "is" if len(result.weak) == 1 else "are"
            yield make_diagnostic(
                "plate.uncertain",
                shortened_list(result.weak),
                verb=verb,
                share=MIN_OWN_SHARE,
            )
        if not result.converged:
            yield make_diagnostic("plate.not-converged", value=MAX_ITERATIONS)


def _check_sensor_difference(
    tree: Tree, requested: Sequence[type[SystematicError]]
) -> None:
    """Raise SettingsError for sensor errors that a difference of two sensors cannot identify.

    Only additive errors, zeros and trends, are identifiable from such a difference.
    """
    unsupported = [
        error.term
        for error in requested
        if tree.cuts and (not error.added or error.jointly)
    ]
    if unsupported:
        raise SettingsError(
            f"{', '.join(unsupported)}: of a wrench that is a difference of two sensors' only "
            "zeros and trends can be estimated; calibrate each sensor with all that it carries"
        )


def _check_joint_identifiability(
    coefficients: SensorUnknowns,
    nonidentifiable: Sequence[NonIdentifiable],
    settings: Settings,
) -> None:
    """Check sensor errors that are useful only if all their coefficients are identifiable.

    An example is the crosstalk matrix of the plate.

    Raises:
        SettingsError: Some coefficients are not identifiable; the message lists remedies.
    """
    joint_terms = {error.term for error in coefficients.nuisances if error.jointly}
    terms = dict(zip(coefficients.names, coefficients.terms, strict=True))
    unresolved = [item for item in nonidentifiable if terms[item.name] in joint_terms]
    if unresolved:
        raise SettingsError(
            explain_nonidentifiable(unresolved, settings.known, settings.nuisances)
        )


class GaussNewtonResult(NamedTuple):
    """Sensor coefficients, and the weighted solution of the corrected recording.

    Attributes:
        solution: Weighted solution of the recording corrected with the values.
        values: Values of the coefficients, (s,).
        converged: True if the last step was below 0.05 sigma.
        weak: Names of coefficients with less than MIN_OWN_SHARE of their effect independent of the
            other unknowns.
    """

    solution: LinearFit
    values: Array
    converged: bool
    weak: tuple[str, ...]


def gauss_newton(
    source: Source, solve: Callable[[Source], LinearFit], model: SensorModel
) -> GaussNewtonResult:
    """Estimate sensor coefficients by Gauss-Newton iterations that correct the recording.

    The iterations end when all steps are below 0.05 sigma, or after MAX_ITERATIONS.

    Args:
        source: Recording.
        solve: Function that returns the weighted solution of a recording.
        model: Unknown coefficients and known values.
    """
    values, solution = model.unknowns.neutral, solve(source)
    weak: tuple[str, ...] = ()
    if not len(values):
        return GaussNewtonResult(solution, values, True, weak)
    for _ in range(MAX_ITERATIONS):
        plan = solution.passes.plan
        columns = model.columns(plan, solution.fit.values, values)
        step, sigma, shares = white_noise_sensor_estimate(
            solution.fit, solution.passes, columns
        )
        # with a full crosstalk matrix all coefficients are correlated, yet sigma was found to hold
        if not any(error.jointly for error in model.unknowns.nuisances):
            named_shares = zip(model.unknowns.names, shares, strict=True)
            weak = tuple(
                name
                for name, share in named_shares
                if share < MIN_OWN_SHARE and name not in model.calibrated_names
            )
        values = values + step
        solution = solve(
            CorrectedSource(source, model.unknowns.by_error(values), plan.layout.tree)
        )
        # converged: the step is small relative to sigma or to the value
        if np.all(np.abs(step) <= 0.05 * sigma + 1e-7 * np.abs(values)):
            return GaussNewtonResult(solution, values, True, weak)
    return GaussNewtonResult(solution, values, False, weak)
